#include "import_common.h"

#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "fmt_image.h"
#include "svo_soup.h"
#include "svo_task.h"

typedef struct import_image_key {
    char *text;
    uint32_t index;
    bool opaque; /* it has no alpha, and was asked for that alone: not decoded */
} import_image_key;

svo_result import_no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while reading a mesh"); }

/* --- files beside the model --- */

/* The reference with '/' only and without leading "./"; false when it does not fit. */
static bool clean_reference(const char *reference, char out[IMPORT_PATH_MAX])
{
    size_t n = strlen(reference);
    if (n == 0 || n >= IMPORT_PATH_MAX) return false;
    for (size_t i = 0; i <= n; i++) out[i] = reference[i] == '\\' ? '/' : reference[i];
    return true;
}

static bool leaves_folder(const char *p)
{
    if (p[0] == '/' || p[0] == '~') return true;
    for (const char *q = p; *q != '\0' && *q != '/'; q++)
        if (*q == ':') return true; /* drive letter or URL scheme */
    for (const char *q = p; *q != '\0';) {
        size_t n = strcspn(q, "/");
        if (n == 2 && q[0] == '.' && q[1] == '.') return true;
        q += n;
        while (*q == '/') q++;
    }
    return false;
}

static bool join(const import_context *c, const char *below, char path[IMPORT_PATH_MAX])
{
    int n = snprintf(path, IMPORT_PATH_MAX, "%s%s", c->folder, below);
    return n > 0 && n < IMPORT_PATH_MAX;
}

static bool note_opened(const import_context *c, const char *path, const fmt_bytes *file)
{
    if (c->opened == NULL) return true;
    import_opened o = {.path = svo_string_copy(NULL, path), .file = *file};
    o.file.data = NULL;
    if (o.path != NULL && svo_buffer_append(c->opened, &o, sizeof o) != NULL) return true;
    svo_string_free(NULL, o.path);
    return false;
}

svo_result import_open(const import_context *c, const char *path, fmt_bytes *out, svo_error *err)
{
    SVO_TRY(fmt_bytes_open(path, c->max_file_bytes, c->allocator, out, err));
    if (c->file_read != NULL) out->beside = c->file_read(c->file_read_user, path, out->data, out->size, out->mapped);
    if (!note_opened(c, path, out)) {
        fmt_bytes_close(out);
        return import_no_memory(err);
    }
    return SVO_OK;
}

svo_result import_unchanged(const import_context *c, svo_error *err)
{
    const import_opened *o = (const import_opened *)(const void *)c->opened->data;
    for (size_t i = 0; i < c->opened->size / sizeof *o; i++) SVO_TRY(fmt_bytes_unchanged(o[i].path, &o[i].file, err));
    return SVO_OK;
}

void import_opened_free(svo_buffer *opened)
{
    const import_opened *o = (const import_opened *)(const void *)opened->data;
    for (size_t i = 0; i < opened->size / sizeof *o; i++) svo_string_free(NULL, o[i].path);
    svo_buffer_free(opened);
}

svo_result import_resolve(const import_context *c, const char *reference, char path[IMPORT_PATH_MAX], svo_error *err)
{
    char clean[IMPORT_PATH_MAX];
    if (!clean_reference(reference, clean)) return svo_fail(err, SVO_INVALID_DATA, "%s: a file reference is empty or too long", c->path);
    if (leaves_folder(clean))
        return svo_fail(err, SVO_INVALID_DATA, "%s: refused to follow '%.100s': files must lie beside the model", c->path, reference);
    if (!join(c, clean, path)) return svo_fail(err, SVO_INVALID_DATA, "%s: a file reference is too long", c->path);
    return SVO_OK;
}

static bool is_file(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 && S_ISREG(s.st_mode);
}

/* Replace one component of a path by the entry of its folder that is equal but for case; the first in byte order
 * where there are several, so that the answer does not depend on the order of the folder. */
static bool match_component(const char *folder, const char *name, size_t name_length, char found[256])
{
    DIR *d = opendir(folder[0] != '\0' ? folder : ".");
    if (d == NULL) return false;
    bool any = false;
    for (struct dirent *e; (e = readdir(d)) != NULL;) {
        if (strlen(e->d_name) != name_length || strncasecmp(e->d_name, name, name_length) != 0) continue;
        if (!any || strcmp(e->d_name, found) < 0) snprintf(found, 256, "%s", e->d_name);
        any = true;
    }
    closedir(d);
    return any;
}

static bool find_nocase(const import_context *c, const char *below, char path[IMPORT_PATH_MAX])
{
    char out[IMPORT_PATH_MAX];
    size_t used = strlen(c->folder);
    memcpy(out, c->folder, used + 1);
    for (const char *q = below; *q != '\0';) {
        size_t n = strcspn(q, "/");
        char found[256];
        if (n == 0 || (n == 1 && q[0] == '.')) {
            q += n + (q[n] == '/');
            continue;
        }
        if (n > 255 || !match_component(out, q, n, found)) return false;
        size_t m = strlen(found);
        if (used + m + 2 > IMPORT_PATH_MAX) return false;
        memcpy(out + used, found, m);
        used += m;
        q += n;
        if (*q == '/') out[used++] = '/', q++;
        out[used] = '\0';
    }
    if (!is_file(out)) return false;
    memcpy(path, out, used + 1);
    return true;
}

bool import_find(const import_context *c, const char *reference, char path[IMPORT_PATH_MAX])
{
    char clean[IMPORT_PATH_MAX];
    if (!clean_reference(reference, clean)) return false;
    if (!leaves_folder(clean)) {
        if (join(c, clean, path) && is_file(path)) return true;
        if (find_nocase(c, clean, path)) return true;
    }
    const char *last = strrchr(clean, '/');
    const char *colon = strrchr(clean, ':');
    const char *name = last != NULL ? last + 1 : clean;
    if (colon != NULL && colon + 1 > name) name = colon + 1;
    if (*name == '\0' || strcmp(name, "..") == 0 || strcmp(name, ".") == 0) return false;
    if (join(c, name, path) && is_file(path)) return true;
    return find_nocase(c, name, path);
}

uint64_t import_block_bytes(const import_context *c, uint64_t size)
{
    uint64_t least = c->block_bytes != 0 ? c->block_bytes : 1 << 20;
    return least < size / 2048 ? size / 2048 : least;
}

void import_forget(const import_context *c, const void *begin, const void *p)
{
    if (c->mapped && c->spilling) fmt_bytes_forget(begin, (uint64_t)((const uint8_t *)p - (const uint8_t *)begin));
}

/* --- images --- */

void import_images_init(import_images *images, const import_context *c)
{
    svo_buffer_init(&images->list, c->allocator);
    svo_buffer_init(&images->keys, c->allocator);
}

void import_images_free(import_images *images)
{
    const svo_allocator *a = images->list.allocator;
    svo_image *image = (svo_image *)(void *)images->list.data;
    for (size_t i = 0; i < images->list.size / sizeof *image; i++) fmt_image_free(a, &image[i]);
    import_image_key *key = (import_image_key *)(void *)images->keys.data;
    for (size_t i = 0; i < images->keys.size / sizeof *key; i++) svo_string_free(a, key[i].text);
    svo_buffer_free(&images->list);
    svo_buffer_free(&images->keys);
}

svo_result import_image_add(import_images *images, const import_context *c, const char *name, svo_image *image, uint32_t *index, svo_error *err)
{
    if (image->name != NULL) svo_string_free(c->allocator, image->name);
    image->name = svo_string_copy(c->allocator, name);
    if (image->name == NULL || svo_buffer_append(&images->list, image, sizeof *image) == NULL) {
        fmt_image_free(c->allocator, image);
        return import_no_memory(err);
    }
    *index = (uint32_t)(images->list.size / sizeof *image - 1);
    return SVO_OK;
}

typedef struct decoding { const import_context *c; import_image_job *jobs; } decoding;
static svo_result decode_range(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    const decoding *d = user;
    for (uint64_t i = begin; i < end; i++) {
        import_image_job *j = &d->jobs[i];
        j->result = fmt_image_decode_paged(j->bytes, j->size, j->mapped, d->c->max_image_pixels, d->c->allocator, d->c->pager, &j->image, &j->why);
    }
    return SVO_OK;
}

void import_images_decode(const import_context *c, import_image_job *jobs, uint64_t count)
{
    decoding d = {c, jobs};
    svo_error unused;
    if (c->pager != NULL || svo_parallel_for(c->threads, count, 1, decode_range, &d, &unused) != SVO_OK) decode_range(&d, 0, count, 0, &unused);
}

static svo_result remember(import_images *images, const import_context *c, const char *reference, uint32_t index, svo_error *err)
{
    import_image_key key = {svo_string_copy(c->allocator, reference), index, false};
    if (key.text == NULL || svo_buffer_append(&images->keys, &key, sizeof key) == NULL) {
        svo_string_free(c->allocator, key.text);
        return import_no_memory(err);
    }
    return SVO_OK;
}

static import_image_key *known(const import_images *images, const char *reference)
{
    import_image_key *key = (import_image_key *)(void *)images->keys.data;
    for (size_t i = 0; i < images->keys.size / sizeof *key; i++)
        if (strcmp(key[i].text, reference) == 0) return &key[i];
    return NULL;
}

/* The file that a reference names, to be decoded; without bytes where it is not (told here), or has no alpha. */
static svo_result open_image(import_images *images, const import_context *c, const import_wish *w, fmt_bytes *bytes, svo_error *err)
{
    char path[IMPORT_PATH_MAX];
    memset(bytes, 0, sizeof *bytes);
    import_image_key *key = known(images, w->reference);
    if (key != NULL && !(key->opaque && !w->alpha_only)) return SVO_OK;
    if (key == NULL) SVO_TRY(remember(images, c, w->reference, SVO_NONE, err));
    key = known(images, w->reference);
    key->opaque = false;
    if (!import_find(c, w->reference, path)) {
        svo_warn(c->warnings, "%s: texture '%.120s' is missing; the material's colour is used alone", c->path, w->reference);
        return SVO_OK;
    }
    svo_error why = {0};
    const svo_result r = import_open(c, path, bytes, &why);
    if (r == SVO_OUT_OF_MEMORY) return svo_fail(err, r, "texture '%.80s': %s", w->reference, why.message);
    if (r != SVO_OK)
        svo_warn(c->warnings, "%s: texture '%.80s' could not be read (%.100s); the material's colour is used alone", c->path, w->reference, why.message);
    else if (bytes->size == 0)
        svo_warn(c->warnings, "%s: texture '%.80s' could not be read (the image is empty); the material's colour is used alone", c->path, w->reference);
    else if (w->alpha_only && !fmt_image_can_have_alpha(bytes->data, bytes->size))
        key->opaque = true;
    else
        return SVO_OK;
    fmt_bytes_close(bytes);
    memset(bytes, 0, sizeof *bytes);
    return SVO_OK;
}

static svo_result take_image(import_images *images, const import_context *c, const char *reference, import_image_job *j, svo_error *err)
{
    if (j->result == SVO_IO) return svo_fail(err, j->result, "%s", j->why.message); /* of temporary files */
    if (j->result == SVO_OUT_OF_MEMORY) return svo_fail(err, j->result, "texture '%.80s': %s", reference, j->why.message);
    if (j->result == SVO_OK) {
        j->result = SVO_INVALID_DATA; /* the image has another owner from here on */
        return import_image_add(images, c, reference, &j->image, &known(images, reference)->index, err);
    }
    svo_warn(c->warnings, "%s: texture '%.80s' could not be read (%.100s); the material's colour is used alone", c->path, reference, j->why.message);
    return SVO_OK;
}

svo_result import_images_read(import_images *images, const import_context *c, const import_wish *wishes, uint64_t count, svo_error *err)
{
    if (c->skip_images) return SVO_OK;
    const svo_allocator *a = c->allocator;
    import_image_job *jobs = svo_calloc(a, count, sizeof *jobs);
    fmt_bytes *bytes = svo_calloc(a, count, sizeof *bytes);
    uint64_t *wish = svo_calloc(a, count, sizeof *wish), n = 0;
    svo_result r = count == 0 || (jobs != NULL && bytes != NULL && wish != NULL) ? SVO_OK : import_no_memory(err);
    for (uint64_t i = 0; i < count && r == SVO_OK; i++) {
        r = open_image(images, c, &wishes[i], &bytes[n], err);
        if (r != SVO_OK || bytes[n].data == NULL) continue;
        jobs[n] = (import_image_job){.bytes = bytes[n].data, .size = bytes[n].size, .mapped = bytes[n].mapped};
        wish[n++] = i;
    }
    if (r == SVO_OK) import_images_decode(c, jobs, n);
    for (uint64_t k = 0; k < n && r == SVO_OK; k++) r = take_image(images, c, wishes[wish[k]].reference, &jobs[k], err);
    for (uint64_t k = 0; k < n; k++) {
        if (jobs[k].result == SVO_OK) fmt_image_free(a, &jobs[k].image);
        fmt_bytes_close(&bytes[k]);
    }
    svo_free(a, jobs, count, sizeof *jobs);
    svo_free(a, bytes, count, sizeof *bytes);
    svo_free(a, wish, count, sizeof *wish);
    return r;
}

svo_result import_image_find(import_images *images, const import_context *c, const char *reference, bool alpha_only, uint32_t *index, svo_error *err)
{
    const import_wish wish = {reference, alpha_only};
    *index = SVO_NONE;
    SVO_TRY(import_images_read(images, c, &wish, 1, err));
    const import_image_key *key = known(images, reference);
    if (key != NULL) *index = key->index;
    return SVO_OK;
}

svo_result import_images_finish(import_images *images, svo_mesh *mesh, svo_error *err)
{
    uint64_t count;
    void *list;
    SVO_TRY(import_exact(&images->list, sizeof(svo_image), &list, &count, err));
    mesh->images = list;
    mesh->image_count = (uint32_t)count;
    import_images_free(images);
    return SVO_OK;
}

/* --- arrays --- */

svo_result import_exact(svo_buffer *b, size_t elem, void **out, uint64_t *count, svo_error *err)
{
    uint64_t n = b->size / elem;
    void *p = NULL;
    if (n != 0 && b->capacity == n * elem) {
        p = b->data;
        svo_buffer_init(b, b->allocator);
    } else if (n != 0) {
        p = svo_alloc(b->allocator, n, elem);
        if (p == NULL) return import_no_memory(err);
        memcpy(p, b->data, (size_t)n * elem);
    }
    svo_buffer_free(b);
    *out = p;
    *count = n;
    return SVO_OK;
}

void import_part_free(const svo_allocator *a, svo_part *part)
{
    svo_soup_free(part->soup);
    if (part->soup != NULL) {
        part->soup = NULL;
        return;
    }
    svo_free(a, part->positions, part->vertex_count, 3 * sizeof(double));
    svo_free(a, part->normals, part->vertex_count, 3 * sizeof(float));
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) svo_free(a, part->uvs[u], part->vertex_count, 2 * sizeof(float));
    svo_free(a, part->colors, part->vertex_count, 4 * sizeof(float));
    svo_free(a, part->indices, part->triangle_count, 3 * sizeof(uint32_t));
    memset(part, 0, sizeof *part);
}

svo_result import_single_shape(const import_context *c, svo_part *parts, uint32_t part_count, svo_mesh *mesh, svo_error *err)
{
    const svo_allocator *a = c->allocator;
    const char *slash = strrchr(c->path, '/');
    mesh->allocator = a;
    svo_shape *shape = svo_calloc(a, 1, sizeof *shape);
    svo_instance *instance = svo_calloc(a, 1, sizeof *instance);
    char *shape_name = svo_string_copy(a, slash != NULL ? slash + 1 : c->path);
    char *instance_name = svo_string_copy(a, "");
    if (shape == NULL || instance == NULL || shape_name == NULL || instance_name == NULL) {
        svo_free(a, shape, 1, sizeof *shape);
        svo_free(a, instance, 1, sizeof *instance);
        svo_string_free(a, shape_name);
        svo_string_free(a, instance_name);
        for (uint32_t i = 0; i < part_count; i++) import_part_free(a, &parts[i]);
        svo_free(a, parts, part_count, sizeof *parts);
        return import_no_memory(err);
    }
    shape->name = shape_name;
    shape->parts = parts;
    shape->part_count = part_count;
    instance->name = instance_name;
    instance->transform = svo_mat4_identity();
    mesh->shapes = shape, mesh->shape_count = 1;
    mesh->instances = instance, mesh->instance_count = 1;
    return SVO_OK;
}

float import_srgb_to_linear(double v)
{
    if (isnan(v) || v >= 1) return 1;
    if (v <= 0) return 0;
    return (float)(v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4));
}
