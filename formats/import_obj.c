/* Wavefront OBJ: the text is cut into blocks that are read in parallel (import_obj_lines.c), then put together in file order.
 * Nothing depends on how it is cut. */
#include "import_obj.h"

#include <string.h>

#include "svo_task.h"

static void obj_init(obj_file *f, const import_context *c)
{
    memset(f, 0, sizeof *f);
    f->context = c;
    svo_buffer *all[] = {&f->groups, &f->slots, &f->libraries};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_init(all[i], c->allocator);
    f->current = SVO_NONE;
}

static void obj_free(obj_file *f)
{
    const svo_allocator *a = f->context->allocator;
    obj_group *group = (obj_group *)(void *)f->groups.data;
    for (uint64_t i = 0; i < f->groups.size / sizeof *group; i++) {
        svo_string_free(a, group[i].material);
        svo_free(a, group[i].corners, group[i].corner_count, sizeof *group[i].corners);
        svo_free(a, group[i].sizes, group[i].face_count, sizeof *group[i].sizes);
    }
    char **library = (char **)(void *)f->libraries.data;
    for (uint64_t i = 0; i < f->libraries.size / sizeof *library; i++) svo_string_free(a, library[i]);
    svo_buffer *all[] = {&f->groups, &f->slots, &f->libraries};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) svo_buffer_free(all[i]);
    svo_free(a, f->values.positions, f->values.count[OBJ_V], 3 * sizeof(double));
    svo_free(a, f->values.uvs, f->values.count[OBJ_VT], 2 * sizeof(float));
    svo_free(a, f->values.normals, f->values.count[OBJ_VN], 3 * sizeof(float));
    svo_free(a, f->colors, f->color_count, 3 * sizeof(float));
    if (f->store != NULL) store_free(f->store);
    svo_free(a, f->store, 1, sizeof *f->store);
}

/* --- groups by material name --- */

static uint32_t hash_name(const char *name, size_t n)
{
    uint32_t h = 2166136261u;
    for (size_t i = 0; i < n; i++) h = (h ^ (uint8_t)name[i]) * 16777619u;
    return h ^ h >> 15;
}

static svo_result grow_slots(obj_file *f, svo_error *err)
{
    uint64_t groups = f->groups.size / sizeof(obj_group), size = f->slots.size / sizeof(uint32_t);
    if (2 * (groups + 1) <= size) return SVO_OK;
    size = size == 0 ? 64 : 2 * size;
    f->slots.size = 0;
    uint32_t *slot = svo_buffer_append(&f->slots, NULL, (size_t)size * sizeof *slot);
    if (slot == NULL) return import_no_memory(err);
    memset(slot, 0xff, (size_t)size * sizeof *slot);
    const obj_group *group = (const obj_group *)(void *)f->groups.data;
    for (uint32_t i = 0; i < groups; i++) {
        const char *name = group[i].material != NULL ? group[i].material : "";
        uint64_t at = hash_name(name, strlen(name)) & (size - 1);
        while (slot[at] != SVO_NONE) at = (at + 1) & (size - 1);
        slot[at] = i;
    }
    return SVO_OK;
}

static svo_result use_material(obj_file *f, const char *name, size_t n, bool named, svo_error *err)
{
    SVO_TRY(grow_slots(f, err));
    const char *nul = memchr(name, '\0', n);
    if (nul != NULL) n = (size_t)(nul - name);
    uint32_t *slot = (uint32_t *)(void *)f->slots.data;
    uint64_t mask = f->slots.size / sizeof *slot - 1;
    uint64_t at = hash_name(name, n) & mask;
    for (; slot[at] != SVO_NONE; at = (at + 1) & mask) {
        const obj_group *g = (const obj_group *)(void *)f->groups.data + slot[at];
        if ((g->material != NULL) != named) continue;
        const char *other = g->material != NULL ? g->material : "";
        if (strlen(other) == n && memcmp(other, name, n) == 0) {
            f->current = slot[at];
            return SVO_OK;
        }
    }
    obj_group group = {.least_vt = SVO_NONE, .least_vn = SVO_NONE, .resolved = SVO_NONE};
    if (named) {
        group.material = svo_alloc(f->context->allocator, n + 1, 1);
        if (group.material == NULL) return import_no_memory(err);
        memcpy(group.material, name, n);
        group.material[n] = '\0';
    }
    if (svo_buffer_append(&f->groups, &group, sizeof group) == NULL) {
        svo_string_free(f->context->allocator, group.material);
        return import_no_memory(err);
    }
    f->current = slot[at] = (uint32_t)(f->groups.size / sizeof group - 1);
    return SVO_OK;
}

static svo_result add_library(obj_file *f, const char *p, const char *end, svo_error *err)
{
    char **have = (char **)(void *)f->libraries.data;
    size_t n = (size_t)(end - p), count = f->libraries.size / sizeof *have;
    for (size_t i = 0; i < count; i++)
        if (strlen(have[i]) == n && memcmp(have[i], p, n) == 0) return SVO_OK;
    if (count >= 256) return svo_fail(err, SVO_LIMIT, "%s: more than 256 material libraries", f->context->path);
    if (memchr(p, '\0', n) != NULL) return SVO_OK;
    char *name = svo_alloc(f->context->allocator, n + 1, 1);
    if (name == NULL) return import_no_memory(err);
    memcpy(name, p, n);
    name[n] = '\0';
    if (svo_buffer_append(&f->libraries, &name, sizeof name) == NULL) {
        svo_string_free(f->context->allocator, name);
        return import_no_memory(err);
    }
    return SVO_OK;
}

/* --- blocks --- */

typedef struct obj_blocks {
    obj_file *file;
    obj_block *list;
    uint64_t count, capacity;
} obj_blocks;

static svo_result cut_blocks(obj_blocks *b, const import_context *c, const char *p, const char *end, svo_error *err)
{
    uint64_t size = (uint64_t)(end - p), least = import_block_bytes(c, size);
    b->capacity = size / least + 1;
    b->list = svo_calloc(c->allocator, b->capacity, sizeof *b->list);
    if (b->list == NULL) return import_no_memory(err);
    const char *begin = p;
    while (p < end) {
        const char *stop = (uint64_t)(end - p) <= least ? end : obj_line_end(begin, p + least - 1, end);
        obj_block *n = &b->list[b->count++];
        obj_block_init(n, c);
        n->begin = p;
        n->end = stop;
        p = stop;
    }
    return SVO_OK;
}

static void free_blocks(obj_blocks *b)
{
    for (uint64_t i = 0; i < b->count; i++) obj_block_free(&b->list[i]);
    svo_free(b->file->context->allocator, b->list, b->capacity, sizeof *b->list);
}

static svo_result count_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    obj_blocks *b = user;
    for (uint64_t i = begin; i < end; i++) SVO_TRY(obj_block_count(&b->list[i], err));
    return SVO_OK;
}

static svo_result read_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    obj_blocks *b = user;
    for (uint64_t i = begin; i < end; i++) SVO_TRY(obj_block_read(&b->list[i], err));
    return SVO_OK;
}

/* Arrays for all numbers, and where those of each block go. */
static svo_result place_values(obj_blocks *b, svo_error *err)
{
    obj_file *f = b->file;
    obj_values *v = &f->values;
    const svo_allocator *a = f->context->allocator;
    uint64_t line = 1 + f->lines, count[OBJ_KINDS];
    memcpy(count, v->origin, sizeof count);
    for (uint64_t i = 0; i < b->count; i++) {
        obj_block *n = &b->list[i];
        n->values = v;
        n->first_line = line;
        line += n->lines;
        for (int k = 0; k < OBJ_KINDS; k++) {
            n->first[k] = count[k];
            count[k] += n->count[k];
        }
    }
    for (int k = 0; k < OBJ_KINDS; k++)
        if (count[k] >= SVO_NONE - 1)
            return svo_fail(err, SVO_INVALID_DATA, "%s: more than 2^32 vertices, texture coordinates or normals", f->context->path);
    v->positions = svo_alloc(a, count[OBJ_V] - v->origin[OBJ_V], 3 * sizeof(double));
    if (count[OBJ_V] != v->origin[OBJ_V] && v->positions == NULL) return import_no_memory(err);
    v->count[OBJ_V] = count[OBJ_V] - v->origin[OBJ_V];
    v->uvs = svo_alloc(a, count[OBJ_VT] - v->origin[OBJ_VT], 2 * sizeof(float));
    if (count[OBJ_VT] != v->origin[OBJ_VT] && v->uvs == NULL) return import_no_memory(err);
    v->count[OBJ_VT] = count[OBJ_VT] - v->origin[OBJ_VT];
    v->normals = svo_alloc(a, count[OBJ_VN] - v->origin[OBJ_VN], 3 * sizeof(float));
    if (count[OBJ_VN] != v->origin[OBJ_VN] && v->normals == NULL) return import_no_memory(err);
    v->count[OBJ_VN] = count[OBJ_VN] - v->origin[OBJ_VN];
    return SVO_OK;
}

static svo_result join_colors(obj_blocks *b, svo_error *err)
{
    obj_file *f = b->file;
    const size_t color = 3 * sizeof(float);
    for (uint64_t i = 0; i < b->count; i++) {
        const obj_block *n = &b->list[i];
        if (n->colors.size != 0) f->color_count = n->first[OBJ_V] - f->values.origin[OBJ_V] + n->colors.size / color;
        f->large_colors |= n->large_colors;
    }
    if (f->color_count == 0) return SVO_OK;
    f->colors = svo_alloc(f->context->allocator, f->color_count, color);
    if (f->colors == NULL) return import_no_memory(err);
    for (uint64_t i = 0; i < 3 * f->color_count; i++) f->colors[i] = 1;
    for (uint64_t i = 0; i < b->count; i++) {
        obj_block *n = &b->list[i];
        if (n->colors.size != 0) memcpy(f->colors + 3 * (n->first[OBJ_V] - f->values.origin[OBJ_V]), n->colors.data, n->colors.size);
        svo_buffer_free(&n->colors);
    }
    return SVO_OK;
}

static void warn_oddities(const obj_blocks *b)
{
    static const char *const text[OBJ_ODDITIES] = {
        [OBJ_SHORT_FACES] = "%s: faces with fewer than three corners are left out",
        [OBJ_POINTS] = "%s: points and lines are left out",
        [OBJ_CURVES] = "%s: free-form curves and surfaces are left out",
    };
    bool *told = b->file->told;
    for (uint64_t i = 0; i < b->count; i++)
        for (uint32_t k = 0; k < b->list[i].odd_count; k++) {
            obj_oddity what = b->list[i].odd[k];
            if (!told[what]) svo_warn(b->file->context->warnings, text[what], b->file->context->path);
            told[what] = true;
        }
}

/* Faces and corners of a block between an event and the next. */
static void event_counts(const obj_block *b, uint64_t i, uint64_t *corners, uint64_t *faces)
{
    const obj_event *e = (const obj_event *)(const void *)b->events.data;
    bool last = i + 1 == b->events.size / sizeof *e;
    *corners = (last ? b->corners.size / sizeof(obj_corner) : e[i + 1].corners) - e[i].corners;
    *faces = (last ? b->sizes.size / sizeof(uint32_t) : e[i + 1].faces) - e[i].faces;
}

/* Groups, libraries, and the places of all corners in them. */
static svo_result replay_events(obj_blocks *b, svo_error *err)
{
    obj_file *f = b->file;
    for (uint64_t k = 0; k < b->count; k++) {
        obj_block *n = &b->list[k];
        obj_event *e = (obj_event *)(void *)n->events.data;
        for (uint64_t i = 0; i < n->events.size / sizeof *e; i++) {
            const char *name = (const char *)n->names.data + e[i].name;
            if (e[i].kind == OBJ_USEMTL) SVO_TRY(use_material(f, name, e[i].length, true, err));
            if (e[i].kind == OBJ_MTLLIB) SVO_TRY(add_library(f, name, name + e[i].length, err));
            uint64_t corners, faces;
            event_counts(n, i, &corners, &faces);
            if (faces == 0) continue;
            if (f->current == SVO_NONE) SVO_TRY(use_material(f, "", 0, false, err));
            obj_group *g = (obj_group *)(void *)f->groups.data + f->current;
            e[i].group = f->current;
            e[i].to_corner = g->corner_count;
            e[i].to_face = g->face_count;
            g->corner_count += corners;
            g->face_count += faces;
        }
    }
    obj_group *g = (obj_group *)(void *)f->groups.data;
    svo_result r = SVO_OK;
    for (uint64_t i = 0; i < f->groups.size / sizeof *g; i++) {
        /* Counts are what the arrays have, so that obj_free is right after a failure. */
        uint64_t corners = g[i].corner_count, faces = g[i].face_count;
        g[i].corner_count = g[i].face_count = 0;
        if (faces == 0 || r != SVO_OK) continue;
        g[i].corners = svo_alloc(f->context->allocator, corners, sizeof *g[i].corners);
        if (g[i].corners != NULL) g[i].corner_count = corners;
        g[i].sizes = svo_alloc(f->context->allocator, faces, sizeof *g[i].sizes);
        if (g[i].sizes != NULL) g[i].face_count = faces;
        if (g[i].corners == NULL || g[i].sizes == NULL) r = import_no_memory(err);
    }
    return r;
}

static svo_result gather_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    obj_blocks *b = user;
    obj_group *group = (obj_group *)(void *)b->file->groups.data;
    for (uint64_t k = begin; k < end; k++) {
        obj_block *n = &b->list[k];
        const obj_event *e = (const obj_event *)(const void *)n->events.data;
        const obj_corner *corner = (const obj_corner *)(const void *)n->corners.data;
        const uint32_t *size = (const uint32_t *)(const void *)n->sizes.data;
        for (uint64_t i = 0; i < n->events.size / sizeof *e; i++) {
            uint64_t corners, faces;
            event_counts(n, i, &corners, &faces);
            if (faces == 0) continue;
            memcpy(group[e[i].group].corners + e[i].to_corner, corner + e[i].corners, (size_t)corners * sizeof *corner);
            memcpy(group[e[i].group].sizes + e[i].to_face, size + e[i].faces, (size_t)faces * sizeof *size);
        }
        obj_block_free(n);
    }
    return SVO_OK;
}

static svo_result read_text(obj_file *f, const char *p, const char *end, svo_error *err)
{
    const import_context *c = f->context;
    obj_blocks b = {.file = f};
    svo_result r = cut_blocks(&b, c, p, end, err);
    if (r == SVO_OK) r = svo_parallel_for(c->threads, b.count, 1, count_block, &b, err);
    if (r == SVO_OK) r = place_values(&b, err);
    if (r == SVO_OK) r = svo_parallel_for(c->threads, b.count, 1, read_block, &b, err);
    if (r == SVO_OK) {
        warn_oddities(&b);
        r = join_colors(&b, err);
    }
    if (r == SVO_OK) r = replay_events(&b, err);
    if (r == SVO_OK) r = svo_parallel_for(c->threads, b.count, 1, gather_block, &b, err);
    for (uint64_t i = 0; i < b.count; i++) f->lines += b.list[i].lines;
    free_blocks(&b);
    return r;
}

/* In windows, each of which goes to the store. */
static svo_result read_windows(obj_file *f, const char *p, const char *end, svo_error *err)
{
    const import_context *c = f->context;
    uint64_t bytes = c->memory / 32;
    f->store = svo_calloc(c->allocator, 1, sizeof *f->store);
    if (f->store == NULL) return import_no_memory(err);
    store_init(f->store, c, 3);
    for (const char *begin = p; p < end;) {
        const char *stop = (uint64_t)(end - p) <= bytes ? end : obj_line_end(begin, p + bytes, end);
        SVO_TRY(read_text(f, p, stop, err));
        SVO_TRY(obj_spill_window(f, err));
        import_forget(c, p, stop);
        p = stop;
    }
    return SVO_OK;
}

/* --- libraries --- */

static svo_result read_library(obj_file *f, mtl_set *materials, const char *name, bool *found, svo_error *err)
{
    const import_context *c = f->context;
    char path[IMPORT_PATH_MAX];
    *found = import_find(c, name, path);
    if (!*found) return SVO_OK;
    fmt_bytes bytes;
    svo_error why = {0};
    svo_result r = import_open(c, path, &bytes, &why);
    if (r == SVO_OUT_OF_MEMORY) return import_no_memory(err);
    if (r != SVO_OK) {
        svo_warn(c->warnings, "%s: material library '%.80s' could not be read: %.100s", c->path, name, why.message);
        return SVO_OK;
    }
    r = mtl_read(materials, c, bytes.data, bytes.size, err);
    fmt_bytes_close(&bytes);
    return r;
}

static svo_result read_libraries(obj_file *f, mtl_set *materials, svo_error *err)
{
    char **name = (char **)(void *)f->libraries.data;
    for (uint64_t i = 0; i < f->libraries.size / sizeof *name; i++) {
        bool found = false;
        SVO_TRY(read_library(f, materials, name[i], &found, err));
        if (found) continue;
        /* Names with blanks are more common than several libraries on a line, so that was tried first. */
        bool any = false;
        char *p = name[i];
        for (char *q; *p != '\0'; p = q) {
            p += strspn(p, " \t");
            q = p + strcspn(p, " \t");
            char keep = *q;
            *q = '\0';
            bool one = false;
            svo_result r = *p != '\0' && !(p == name[i] && keep == '\0') ? read_library(f, materials, p, &one, err) : SVO_OK;
            any = any || one;
            *q = keep;
            SVO_TRY(r);
        }
        if (!any) svo_warn(f->context->warnings, "%s: material library '%.120s' is missing; its materials are white", f->context->path, name[i]);
    }
    return SVO_OK;
}

/* UTF-16 files exist (text editors wrote them); everything that matters in them is ASCII, the rest is names. */
static svo_result from_utf16(svo_buffer *to, const uint8_t *p, uint64_t size, bool big, svo_error *err)
{
    for (uint64_t i = 0; i + 1 < size; i += 2) {
        uint32_t u = big ? (uint32_t)(p[i] << 8 | p[i + 1]) : (uint32_t)(p[i + 1] << 8 | p[i]);
        if (u >= 0xd800 && u < 0xdc00 && i + 3 < size) {
            uint32_t w = big ? (uint32_t)(p[i + 2] << 8 | p[i + 3]) : (uint32_t)(p[i + 3] << 8 | p[i + 2]);
            if (w >= 0xdc00 && w < 0xe000) u = 0x10000 + ((u - 0xd800) << 10) + (w - 0xdc00), i += 2;
        }
        uint8_t out[4];
        size_t n = u < 0x80 ? 1 : u < 0x800 ? 2 : u < 0x10000 ? 3 : 4;
        if (n == 1) out[0] = (uint8_t)u;
        else {
            for (size_t k = n - 1; k > 0; k--, u >>= 6) out[k] = (uint8_t)(0x80 | (u & 0x3f));
            out[0] = (uint8_t)((n == 2 ? 0xc0 : n == 3 ? 0xe0 : 0xf0) | u);
        }
        if (svo_buffer_append(to, out, n) == NULL) return import_no_memory(err);
    }
    return SVO_OK;
}

svo_result import_obj(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    obj_file f;
    mtl_set materials;
    svo_buffer text;
    obj_init(&f, c);
    mtl_init(&materials, c);
    svo_buffer_init(&text, c->allocator);
    svo_result r = SVO_OK;
    const char *p = (const char *)bytes;
    if (size >= 2 && ((bytes[0] == 0xff && bytes[1] == 0xfe) || (bytes[0] == 0xfe && bytes[1] == 0xff))) {
        r = from_utf16(&text, bytes + 2, size - 2, bytes[0] == 0xfe, err);
        p = (const char *)text.data;
        size = text.size;
    } else if (size >= 3 && memcmp(bytes, "\xef\xbb\xbf", 3) == 0) {
        p += 3;
        size -= 3;
    }
    if (r == SVO_OK && size != 0) r = c->spilling ? read_windows(&f, p, p + size, err) : read_text(&f, p, p + size, err);
    if (r == SVO_OK) r = read_libraries(&f, &materials, err);
    if (r == SVO_OK) r = f.store != NULL ? obj_build_spilled(&f, &materials, mesh, err) : obj_build(&f, &materials, mesh, err);
    obj_free(&f);
    mtl_free(&materials);
    svo_buffer_free(&text);
    return r;
}
