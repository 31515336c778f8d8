/* Which importer reads a file: by content where the content says it, else by extension. */
#include "fmt_import.h"

#include <string.h>
#include <strings.h>

#include "fmt_container.h"
#include "fmt_rig.h"
#include "import_common.h"
#include "import_text.h"

static bool starts(const uint8_t *bytes, uint64_t size, const char *text)
{
    size_t n = strlen(text);
    return size >= n && memcmp(bytes, text, n) == 0;
}

static const char *extension(const char *path)
{
    const char *slash = strrchr(path, '/'), *dot = strrchr(path, '.');
    return dot != NULL && (slash == NULL || dot > slash) ? dot + 1 : "";
}

static import_reader *by_extension(const char *path)
{
    static const struct { const char *extension; import_reader *reader; } table[] = {
        {"gltf", import_gltf}, {"glb", import_gltf}, {"obj", import_obj}, {"ply", import_ply},
        {"stl", import_stl},   {"off", import_off},  {"drc", import_drc},
    };
    for (size_t i = 0; i < sizeof table / sizeof *table; i++)
        if (strcasecmp(extension(path), table[i].extension) == 0) return table[i].reader;
    return NULL;
}

/* "OFF" with its prefixes, [ST][C][N][4][n]OFF, and no letter after it. */
static bool is_off_word(const char *p, const char *end)
{
    while (p < end && strchr("STCN4n", *p) != NULL && *p != '\0') p++;
    return end - p >= 3 && memcmp(p, "OFF", 3) == 0 && (end - p == 3 || import_space(p[3]) || import_digit(p[3]) || p[3] == '#');
}

/* A line that begins as OBJ lines do, among the first that are not comments. */
static bool looks_like_obj(const char *p, const char *end)
{
    static const char *const words[] = {"v", "vt", "vn", "f", "o", "g", "s", "mtllib", "usemtl"};
    for (int lines = 0; p < end && lines < 64; lines++) {
        const char *stop = memchr(p, '\n', (size_t)(end - p));
        if (stop == NULL) stop = end;
        const char *q = import_skip_blank(p, stop);
        if (q < stop && *q != '#') {
            for (size_t i = 0; i < sizeof words / sizeof *words; i++)
                if (import_word(q, stop, words[i]) != NULL) return true;
            return false;
        }
        p = stop < end ? stop + 1 : end;
    }
    return false;
}

static import_reader *by_content(const uint8_t *bytes, uint64_t size)
{
    const char *p = (const char *)bytes, *end = p + size;
    if (starts(bytes, size, "glTF")) return import_gltf;
    if (starts(bytes, size, "DRACO")) return import_drc;
    if (size >= 84 && size == 84 + 50 * (uint64_t)fmt_load32(bytes + 80)) return import_stl; /* binary, whatever its first words say */
    p = import_skip_space(p, end);
    if (import_word(p, end, "ply") != NULL) return import_ply;
    if (p < end && *p == '{') return import_gltf;
    if (is_off_word(p, end)) return import_off;
    if (import_word_nocase(p, end, "solid") != NULL) return import_stl;
    return NULL;
}

/* What no reader takes: a file of ours, whole or damaged, or something else. */
static svo_result no_reader(const char *path, const uint8_t *bytes, uint64_t size, svo_error *err)
{
    static const char *const ours[] = {"svo", "svdag", "svscene", "skel"};
    if (size == 0) return svo_fail(err, SVO_INVALID_DATA, "%s: the file is empty", path);
    if (starts(bytes, size, "\x89SVX\r\n\x1a\n")) {
        if (size < 64) return svo_fail(err, SVO_INVALID_DATA, "%s: the file was cut off after %llu bytes", path, (unsigned long long)size);
        return svo_fail(err, SVO_UNSUPPORTED, "%s: a svokit file, not a mesh (.gltf .glb .obj .ply .stl .off .drc)", path);
    }
    for (size_t i = 0; i < sizeof ours / sizeof *ours; i++)
        if (strcasecmp(extension(path), ours[i]) == 0)
            return svo_fail(err, SVO_INVALID_DATA, "%s: does not begin as a .%s file does; it is damaged or something else", path, ours[i]);
    return svo_fail(err, SVO_UNSUPPORTED, "%s: not a mesh format that is known (.gltf .glb .obj .ply .stl .off .drc)", path);
}

static svo_result make_context(const char *path, const fmt_import_options *o, import_context *c, svo_buffer *opened, svo_error *err)
{
    memset(c, 0, sizeof *c);
    svo_buffer_init(opened, NULL);
    c->opened = opened;
    c->path = path;
    c->allocator = o->allocator != NULL ? o->allocator : svo_default_allocator();
    c->warnings = o->warnings;
    c->max_file_bytes = o->max_file_bytes != 0 ? o->max_file_bytes : (uint64_t)16 << 30;
    c->max_image_pixels = o->max_image_pixels;
    c->skip_images = o->skip_images;
    c->without = o->without;
    c->threads = o->threads;
    c->block_bytes = o->block_bytes;
    c->file_read = o->file_read;
    c->file_read_user = o->file_read_user;
    c->spill = o->memory != 0 && o->rig == NULL ? o->spill : NULL;
    c->memory = o->memory;
    c->pager = o->pager;
    c->rig = o->rig;
    c->animation = o->animation;
    c->time = o->time;
    const char *slash = strrchr(path, '/');
    size_t n = slash != NULL ? (size_t)(slash - path) + 1 : 0;
    if (n >= sizeof c->folder) return svo_fail(err, SVO_INVALID_ARGUMENT, "%.100s...: the path is too long", path);
    memcpy(c->folder, path, n);
    return SVO_OK;
}

static bool can_spill(import_reader *reader) { return reader != import_drc; }

/* A file that is small beside the memory is read into it. Arrays grow by copying and text is shorter than numbers, so a file may take four times
 * its size while it is read. What turns out not to fit after all is read again, into the spill. */
static svo_result read_model(import_context *c, import_reader *reader, const fmt_bytes *bytes, svo_mesh *mesh, svo_error *err)
{
    c->mapped = bytes->mapped;
    if (c->spill == NULL || !can_spill(reader)) return reader(c, bytes->data, bytes->size, mesh, err);
    c->spilling = bytes->size > c->memory / 4;
    svo_result r = reader(c, bytes->data, bytes->size, mesh, err);
    if (r != SVO_OUT_OF_MEMORY || c->spilling) return r;
    svo_mesh_free(mesh);
    c->spilling = true;
    return reader(c, bytes->data, bytes->size, mesh, err);
}

svo_result fmt_import_mesh(const char *path, const fmt_import_options *options, svo_mesh *out, svo_error *err)
{
    fmt_import_options defaults = {0};
    import_context *c = svo_alloc(NULL, 1, sizeof *c);
    if (c == NULL) return import_no_memory(err);
    svo_buffer opened;
    svo_result r = make_context(path, options != NULL ? options : &defaults, c, &opened, err);
    fmt_bytes bytes = {0};
    if (r == SVO_OK) r = import_open(c, path, &bytes, err);
    if (r != SVO_OK) {
        import_opened_free(&opened);
        svo_free(NULL, c, 1, sizeof *c);
        return r;
    }
    svo_mesh mesh = {.allocator = c->allocator};
    bool empty = bytes.size == 0; /* and no bytes to point to */
    import_reader *reader = empty ? NULL : by_content(bytes.data, bytes.size);
    if (reader == NULL) reader = by_extension(path);
    if (reader == NULL && !empty && looks_like_obj((const char *)bytes.data, (const char *)bytes.data + bytes.size)) reader = import_obj;
    if (reader == NULL)
        r = no_reader(path, bytes.data, bytes.size, err);
    else if (empty)
        r = svo_fail(err, SVO_INVALID_DATA, "%s: the file is empty", path);
    else
        r = read_model(c, reader, &bytes, &mesh, err);
    if (r == SVO_OK || r == SVO_INVALID_DATA) {
        /* Of what a changing file gives, only that it changed is worth telling. */
        svo_result changed = import_unchanged(c, err);
        if (changed != SVO_OK) r = changed;
    }
    import_opened_free(&opened);
    fmt_bytes_close(&bytes);
    if (r == SVO_OK) {
        if (svo_mesh_count(&mesh).placed_triangles == 0) svo_warn(c->warnings, "%s: no triangles", path);
        *out = mesh;
    } else {
        svo_mesh_free(&mesh);
        fmt_rig_free(c->rig);
    }
    svo_free(NULL, c, 1, sizeof *c);
    return r;
}
