/* Writing .svscene. */
#include <stdlib.h>
#include <string.h>
#define XXH_STATIC_LINKING_ONLY
#include <xxhash.h>

#include "fmt_utf8.h"
#include "fmti_scene.h"

/* The page table is used as it lies in the file. */
_Static_assert(sizeof(svo_scene_page) == 88 && offsetof(svo_scene_page, high) == 24 && offsetof(svo_scene_page, origin) == 48 &&
                   offsetof(svo_scene_page, first) == 72 && offsetof(svo_scene_page, count) == 80,
               "svo_scene_page must lie in memory as PAGE elements do");

typedef struct scene_writer {
    fmt_writer *container;
    fmt_output *out;
    svo_buffer head, names;
} scene_writer;

/* Write a chunk of `count` elements; its bytes in the file are added to *bytes. */
static svo_result put(scene_writer *w, uint32_t type, uint64_t id, const void *payload, uint64_t count, uint32_t stride, uint64_t *bytes, svo_error *err)
{
    uint64_t size = stride != 0 ? count * stride : count, before = fmt_output_offset(w->out);
    fmt_chunk chunk = {.type = type, .flags = type == META ? 0 : FMT_CHUNK_CRITICAL, .codec = FMT_CODEC_NONE, .stored_size = size,
                       .decoded_size = size, .element_count = stride != 0 ? count : 0, .element_stride = stride, .id = id};
    SVO_TRY(fmt_writer_chunk(w->container, &chunk, payload, err));
    *bytes += fmt_output_offset(w->out) - before;
    return SVO_OK;
}

/* HEAD, and NAME with those asset names that are not in the scene's table (a mapped scene has them there). */
static svo_result build_head(scene_writer *w, const svo_scene *s, svo_error *err)
{
    uint8_t h[HEAD_BYTES] = {0};
    bool stored = svo_buffer_append(&w->names, s->names, (size_t)s->names_size) != NULL && svo_buffer_append(&w->head, h, sizeof h) != NULL;
    for (uint32_t a = 0; a < s->asset_count && stored; a++) {
        uintptr_t name = (uintptr_t)s->asset_names[a], table = (uintptr_t)s->names;
        uint64_t offset = w->names.size, size = strlen(s->asset_names[a]) + 1;
        if (size == 1) offset = 0;
        else if (name >= table && name - table < s->names_size) offset = name - table;
        else {
            if (offset + size > UINT32_MAX) return svo_fail(err, SVO_LIMIT, "the names of assets and instances take more than 4 GiB");
            if (!fmt_utf8_valid(s->asset_names[a], size)) return fmti_scene_bad(err, SVO_INVALID_ARGUMENT, NAME, a, "SCN-03", "an asset's name is not UTF-8");
            stored = svo_buffer_append(&w->names, s->asset_names[a], (size_t)size) != NULL;
        }
        uint8_t number[4];
        fmt_store32(number, (uint32_t)offset);
        stored = stored && svo_buffer_append(&w->head, number, 4) != NULL;
    }
    if (!stored) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the names of a scene");
    double bounds[6] = {0};
    if (s->page_count != 0) svo_scene_bounds(s, bounds, bounds + 3);
    uint8_t *head = w->head.data;
    fmt_store32(head, s->asset_count);
    fmt_store32(head + 4, s->page_count);
    fmt_store64(head + 8, s->instance_count);
    fmt_store64(head + 16, w->names.size);
    fmt_store32(head + 24, (s->has_camera ? HAS_CAMERA : 0) | (s->instance_pose != NULL ? HAS_POSES : 0));
    memcpy(head + 32, bounds, sizeof bounds);
    return SVO_OK;
}

uint64_t fmti_scene_page_hash(const svo_scene *s, uint32_t page)
{
    uint64_t first = s->pages[page].first, n = s->pages[page].count;
    XXH3_state_t state;
    XXH3_64bits_reset(&state);
    XXH3_64bits_update(&state, &s->pages[page], sizeof s->pages[page]);
    XXH3_64bits_update(&state, s->instance_asset + first, n * 4);
    XXH3_64bits_update(&state, s->instance_transform + 12 * first, n * 48);
    XXH3_64bits_update(&state, s->instance_id + first, n * 8);
    if (s->instance_name != NULL) XXH3_64bits_update(&state, s->instance_name + first, n * 4);
    if (s->instance_pose != NULL) XXH3_64bits_update(&state, s->instance_pose + first, n * 4);
    return XXH3_64bits_digest(&state);
}

static svo_result put_page_hashes(scene_writer *w, const svo_scene *s, const svo_allocator *a, fmt_scene_bytes *bytes, svo_error *err)
{
    uint64_t *hash = svo_alloc(a, s->page_count, sizeof *hash);
    if (hash == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the pages of a scene");
    for (uint32_t p = 0; p < s->page_count; p++) hash[p] = fmti_scene_page_hash(s, p);
    svo_result result = put(w, PHSH, 0, hash, s->page_count, 8, &bytes->pages, err);
    svo_free(a, hash, s->page_count, sizeof *hash);
    return result;
}

static svo_result put_instances(scene_writer *w, const svo_scene *s, const svo_allocator *a, fmt_scene_bytes *bytes, svo_error *err)
{
    uint64_t n = s->instance_count;
    if (n == 0) return SVO_OK;
    SVO_TRY(put(w, PAGE, 0, s->pages, s->page_count, sizeof *s->pages, &bytes->pages, err));
    SVO_TRY(put_page_hashes(w, s, a, bytes, err));
    SVO_TRY(put(w, IAST, 0, s->instance_asset, n, 4, &bytes->instances, err));
    SVO_TRY(put(w, IXFM, 0, s->instance_transform, n, 48, &bytes->instances, err));
    SVO_TRY(put(w, IIDS, 0, s->instance_id, n, 8, &bytes->instances, err));
    if (s->instance_name != NULL) SVO_TRY(put(w, INAM, 0, s->instance_name, n, 4, &bytes->names, err));
    if (s->instance_pose == NULL) return SVO_OK;
    SVO_TRY(put(w, IPOS, 0, s->instance_pose, n, 4, &bytes->poses, err));
    SVO_TRY(put(w, POSE, 0, s->poses.pose, s->poses.count, sizeof *s->poses.pose, &bytes->poses, err));
    if (s->poses.matrix_count != 0) SVO_TRY(put(w, PMAT, 0, s->poses.matrix, s->poses.matrix_count, 48, &bytes->poses, err));
    return SVO_OK;
}

static svo_result put_assets(scene_writer *w, const svo_scene *s, const svo_allocator *a, fmt_scene_bytes *bytes, uint64_t *each, svo_error *err)
{
    svo_buffer image;
    svo_buffer_init(&image, a);
    svo_result result = SVO_OK;
    for (uint32_t i = 0; i < s->asset_count && result == SVO_OK; i++) {
        fmt_output *memory;
        result = fmt_output_open_memory(&image, &memory, err);
        if (result != SVO_OK) break;
        result = fmt_svdag_write(memory, s->assets[i], NULL, err);
        if (result == SVO_OK) result = fmt_output_commit(memory, err);
        else fmt_output_discard(memory);
        if (result == SVO_OK) result = put(w, ASET, i, image.data, image.size, 0, &bytes->assets, err);
        if (each != NULL) each[i] = image.size;
    }
    svo_buffer_free(&image);
    return result;
}

static svo_result put_all(scene_writer *w, const svo_scene *s, const svo_allocator *a, fmt_scene_bytes *bytes, uint64_t *each, svo_error *err)
{
    SVO_TRY(build_head(w, s, err));
    SVO_TRY(put(w, HEAD, 0, w->head.data, w->head.size, 0, &bytes->rest, err));
    SVO_TRY(put(w, NAME, 0, w->names.data, w->names.size, 1, &bytes->names, err));
    SVO_TRY(put_instances(w, s, a, bytes, err));
    if (s->has_camera) {
        double camera[17];
        memcpy(camera, s->camera_transform.m, sizeof s->camera_transform.m);
        camera[16] = s->camera_yfov;
        SVO_TRY(put(w, CAMR, 0, camera, sizeof camera, 0, &bytes->rest, err));
    }
    return put_assets(w, s, a, bytes, each, err);
}

typedef struct provenance_source {
    const char *text;       /* where tell is NULL */
    fmt_scene_tell_fn tell;
    void *user;
} provenance_source;

static svo_result put_provenance(scene_writer *w, const provenance_source *p, const uint64_t *each, svo_error *err)
{
    if (p->tell == NULL) return fmt_writer_meta(w->container, p->text, err);
    char *text = p->tell(p->user, each);
    if (text == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the provenance of a scene");
    const svo_result r = fmt_writer_meta(w->container, text, err);
    free(text);
    return r;
}

static svo_result write_scene(fmt_output *out, const svo_scene *scene, const provenance_source *provenance, const svo_allocator *a, fmt_scene_bytes *bytes, uint64_t *asset_bytes,
                              svo_error *err)
{
    fmt_scene_bytes sizes = {0};
    SVO_TRY(fmti_scene_check(scene, false, SVO_INVALID_ARGUMENT, a, NULL, err));
    uint64_t before = fmt_output_offset(out);
    scene_writer w = {.out = out};
    svo_buffer_init(&w.head, a);
    svo_buffer_init(&w.names, a);
    SVO_TRY(fmt_writer_begin(out, FMT_KIND_SCENE, MAJOR, 0, &w.container, err));
    svo_result result = put_all(&w, scene, a, &sizes, asset_bytes, err);
    if (result == SVO_OK) result = put_provenance(&w, provenance, asset_bytes, err);
    if (result == SVO_OK) result = fmt_writer_end(w.container, err);
    else fmt_writer_discard(w.container);
    svo_buffer_free(&w.head);
    svo_buffer_free(&w.names);
    if (result != SVO_OK) return result;
    sizes.rest = fmt_output_offset(out) - before - sizes.assets - sizes.instances - sizes.pages - sizes.names - sizes.poses;
    if (bytes != NULL) *bytes = sizes;
    return SVO_OK;
}

svo_result fmt_scene_write(fmt_output *out, const svo_scene *scene, const char *provenance, const svo_allocator *a,
                           fmt_scene_bytes *bytes, uint64_t *asset_bytes, svo_error *err)
{
    const provenance_source p = {.text = provenance};
    return write_scene(out, scene, &p, a, bytes, asset_bytes, err);
}

svo_result fmt_scene_write_telling(fmt_output *out, const svo_scene *scene, fmt_scene_tell_fn tell, void *user, const svo_allocator *a, fmt_scene_bytes *bytes,
                                   uint64_t *asset_bytes, svo_error *err)
{
    const provenance_source p = {.tell = tell, .user = user};
    return write_scene(out, scene, &p, a, bytes, asset_bytes, err);
}
