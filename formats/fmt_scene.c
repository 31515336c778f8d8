/* Both directions of .svscene, and the rules that both obey (check_scene). */
#include "fmt_scene.h"

#include <math.h>
#include <string.h>
#define XXH_STATIC_LINKING_ONLY
#include <xxhash.h>

#include "fmt_utf8.h"
#include "fmti_scene.h"
#include "svo_deform.h"
#include "svo_task.h"

#define MAJOR 1
#define HEAD_BYTES 80u
#define CAMERA_BYTES 136u
#define HAS_CAMERA 1u
#define HAS_POSES 2u

/* The page table is used as it lies in the file. */
_Static_assert(sizeof(svo_scene_page) == 88 && offsetof(svo_scene_page, high) == 24 && offsetof(svo_scene_page, origin) == 48 &&
                   offsetof(svo_scene_page, first) == 72 && offsetof(svo_scene_page, count) == 80,
               "svo_scene_page must lie in memory as PAGE elements do");

/* "IXFM 5: what (SCN-07)": element 5 of the array in chunk IXFM. */
static svo_result bad(svo_error *err, svo_result code, uint32_t chunk, uint64_t index, const char *rule, const char *what)
{
    char name[5];
    fmt_fourcc_text(chunk, name);
    svo_fail(err, code, "%s %llu: %s (%s)", name, (unsigned long long)index, what, rule);
    if (err != NULL) err->chunk = chunk, err->index = index;
    return code;
}

/* ---- rules ---- */

static bool name_start(const svo_scene *s, uint64_t offset)
{
    return offset < s->names_size && (offset == 0 || s->names[offset - 1] == 0);
}

static svo_result check_names(const svo_scene *s, svo_result code, svo_rules *rules, svo_error *err)
{
    if (s->names_size == 0 || s->names_size > UINT32_MAX || s->names[0] != 0 || s->names[s->names_size - 1] != 0)
        return bad(err, code, NAME, 0, "SCN-03", "the table does not begin and end with a NUL");
    if (!fmt_utf8_valid(s->names, s->names_size)) return bad(err, code, NAME, 0, "SCN-03", "not UTF-8");
    for (uint64_t i = 0; s->instance_name != NULL && i < s->instance_count; i++)
        if (!name_start(s, s->instance_name[i])) SVO_TRY(svo_go_on(rules, bad(err, code, INAM, i, "SCN-03", "not the start of a name"), err));
    return SVO_OK;
}

typedef struct page_check {
    const svo_scene *scene;
    const svo_extent *extents;
    bool poses_hold; /* all of them: the bounds of what has one can be told */
    svo_result code;
    svo_rules *rules;
} page_check;

static svo_result check_instance(const page_check *c, uint32_t p, uint64_t i, svo_error *err)
{
    const svo_scene *s = c->scene;
    const svo_scene_page *page = &s->pages[p];
    svo_result code = c->code;
    uint32_t asset = s->instance_asset[i];
    if (asset >= s->asset_count) return bad(err, code, IAST, i, "SCN-06", "there is no such asset");
    if (s->instance_pose != NULL && s->instance_pose[i] != SVO_NO_POSE && s->instance_pose[i] >= s->poses.count)
        return bad(err, code, IPOS, i, "SCN-11", "there is no such pose");
    svo_mat4 m = svo_scene_instance_transform(s, p, i), inverse;
    bool finite = true;
    for (int k = 0; k < 12; k++) finite = finite && isfinite(m.m[k]);
    if (!finite || !svo_mat4_affine_inverse(&m, &inverse)) return bad(err, code, IXFM, i, "SCN-07", "the transform is not finite or not invertible");
    bool posed = svo_scene_instance_pose(s, i) != NULL;
    if (s->assets[asset]->empty || (posed && !c->poses_hold)) return SVO_OK; /* told where assets and poses are looked at */
    double low[3], high[3];
    bool good = svo_scene_instance_bounds(s, p, i, &c->extents[asset], low, high);
    for (int k = 0; k < 3; k++) {
        /* sines and cosines differ in their last bits between machines */
        double slack = posed ? 1e-9 * fmax(fabs(low[k]), fabs(high[k])) : 0;
        good = good && low[k] >= page->low[k] - slack && high[k] <= page->high[k] + slack;
    }
    return good ? SVO_OK : bad(err, code, PAGE, p, "SCN-10", "the bounds do not hold all instances of the page");
}

static svo_result check_page(const page_check *c, uint32_t p, svo_error *err)
{
    const svo_scene_page *page = &c->scene->pages[p];
    for (int k = 0; k < 3; k++)
        if (!isfinite(page->low[k]) || !isfinite(page->high[k]) || !isfinite(page->origin[k]) || page->low[k] > page->high[k])
            return bad(err, c->code, PAGE, p, "SCN-05", "bounds or origin are not finite or not in order");
    for (uint64_t i = page->first; i < page->first + page->count; i++) SVO_TRY(svo_go_on(c->rules, check_instance(c, p, i, err), err));
    return SVO_OK;
}

static svo_result check_page_range(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    const page_check *c = user;
    for (uint64_t p = begin; p < end; p++) SVO_TRY(svo_go_on(c->rules, check_page(c, (uint32_t)p, err), err));
    return SVO_OK;
}

static svo_result check_pages(const svo_scene *s, const svo_extent *extents, bool *used, bool poses_hold, bool partial, svo_result code, svo_rules *rules, svo_error *err)
{
    uint64_t next = 0;
    for (uint32_t p = 0; p < s->page_count; p++) {
        if (s->pages[p].first != next || s->pages[p].count == 0 || s->pages[p].count > s->instance_count - next)
            return bad(err, code, PAGE, p, "SCN-04", "the page does not follow the one before it");
        next += s->pages[p].count;
    }
    if (next != s->instance_count) return bad(err, code, PAGE, s->page_count, "SCN-04", "the pages do not hold all instances");
    page_check check = {s, extents, poses_hold, code, rules};
    if (rules != NULL) SVO_TRY(check_page_range(&check, 0, s->page_count, 0, err)); /* in order */
    else SVO_TRY(svo_parallel_for(0, s->page_count, 4, check_page_range, &check, err));
    for (uint64_t i = 0; i < s->instance_count; i++)
        if (s->instance_asset[i] < s->asset_count) used[s->instance_asset[i]] = true;
    for (uint32_t a = 0; a < s->asset_count && !partial; a++)
        if (!used[a]) SVO_TRY(svo_go_on(rules, bad(err, code, ASET, a, "SCN-06", "no instance uses the asset"), err));
    return SVO_OK;
}

static svo_result check_poses(const svo_scene *s, svo_result code, svo_rules *rules, svo_error *err)
{
    for (uint64_t i = 0; i < 12 * s->poses.matrix_count; i++)
        if (!isfinite(s->poses.matrix[i])) SVO_TRY(svo_go_on(rules, bad(err, code, PMAT, i / 12, "SCN-12", "a matrix is not finite"), err));
    for (uint32_t i = 0; i < s->poses.count; i++) {
        const char *fault = svo_pose_fault(&s->poses, &s->poses.pose[i]);
        if (fault != NULL) SVO_TRY(svo_go_on(rules, bad(err, code, POSE, i, "SCN-12", fault), err));
    }
    return SVO_OK;
}

static svo_result check_camera(const svo_scene *s, svo_result code, svo_error *err)
{
    if (!s->has_camera) return SVO_OK;
    const double *m = s->camera_transform.m;
    svo_mat4 inverse;
    bool good = m[12] == 0 && m[13] == 0 && m[14] == 0 && m[15] == 1;
    for (int i = 0; i < 16; i++) good = good && isfinite(m[i]);
    good = good && svo_mat4_affine_inverse(&s->camera_transform, &inverse);
    /* (NaN fails both comparisons) */
    if (!good || !(s->camera_yfov > 0) || !(s->camera_yfov < 3.14159265358979312))
        return bad(err, code, CAMR, 0, "SCN-09", "the camera is not affine, invertible and with a field of view below pi");
    return SVO_OK;
}

svo_result fmti_scene_check(const svo_scene *s, bool partial, svo_result code, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    SVO_TRY(svo_go_on(rules, check_names(s, code, rules, err), err));
    uint64_t before = rules != NULL ? rules->count : 0;
    SVO_TRY(check_poses(s, code, rules, err));
    bool poses_hold = rules == NULL || rules->count == before;
    SVO_TRY(svo_go_on(rules, check_camera(s, code, err), err));
    if (s->asset_count == 0 && s->instance_count != 0) return bad(err, code, HEAD, 0, "SCN-06", "instances without assets");
    if (s->asset_count == 0) return s->page_count == 0 ? SVO_OK : bad(err, code, PAGE, 0, "SCN-04", "a page without instances");
    svo_extent *extents = svo_calloc(a, s->asset_count, sizeof *extents);
    bool *used = svo_calloc(a, s->asset_count, sizeof *used), made = false;
    svo_result result = extents == NULL || used == NULL ? svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %u assets", s->asset_count) : SVO_OK;
    for (uint32_t i = 0; i < s->asset_count && !partial && result == SVO_OK; i++)
        if (s->assets[i]->empty) result = svo_go_on(rules, bad(err, code, ASET, i, "SCN-08", "the asset is empty"), err);
    if (result == SVO_OK) result = svo_scene_extents(s, a, extents, err);
    made = result == SVO_OK;
    if (result == SVO_OK) result = check_pages(s, extents, used, poses_hold, partial, code, rules, err);
    for (uint32_t i = 0; made && i < s->asset_count; i++) svo_extent_free(&extents[i]);
    svo_free(a, extents, s->asset_count, sizeof *extents);
    svo_free(a, used, s->asset_count, sizeof *used);
    return result;
}

/* ---- writing ---- */

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
            if (!fmt_utf8_valid(s->asset_names[a], size)) return bad(err, SVO_INVALID_ARGUMENT, NAME, a, "SCN-03", "an asset's name is not UTF-8");
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

static svo_result put_all(scene_writer *w, const svo_scene *s, const char *provenance, const svo_allocator *a, fmt_scene_bytes *bytes, uint64_t *each, svo_error *err)
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
    SVO_TRY(put_assets(w, s, a, bytes, each, err));
    return fmt_writer_meta(w->container, provenance, err);
}

svo_result fmt_scene_write(fmt_output *out, const svo_scene *scene, const char *provenance, const svo_allocator *a,
                           fmt_scene_bytes *bytes, uint64_t *asset_bytes, svo_error *err)
{
    fmt_scene_bytes sizes = {0};
    SVO_TRY(fmti_scene_check(scene, false, SVO_INVALID_ARGUMENT, a, NULL, err));
    uint64_t before = fmt_output_offset(out);
    scene_writer w = {.out = out};
    svo_buffer_init(&w.head, a);
    svo_buffer_init(&w.names, a);
    SVO_TRY(fmt_writer_begin(out, FMT_KIND_SCENE, MAJOR, 0, &w.container, err));
    svo_result result = put_all(&w, scene, provenance, a, &sizes, asset_bytes, err);
    if (result == SVO_OK) result = fmt_writer_end(w.container, err);
    else fmt_writer_discard(w.container);
    svo_buffer_free(&w.head);
    svo_buffer_free(&w.names);
    if (result != SVO_OK) return result;
    sizes.rest = fmt_output_offset(out) - before - sizes.assets - sizes.instances - sizes.pages - sizes.names - sizes.poses;
    if (bytes != NULL) *bytes = sizes;
    return SVO_OK;
}

/* ---- reading ---- */

static const uint32_t chunk_order[] = {HEAD, NAME, PAGE, PHSH, IAST, IXFM, IIDS, INAM, IPOS, POSE, PMAT, CAMR, ASET, META};
#define CHUNK_TYPES (sizeof chunk_order / sizeof chunk_order[0])

static svo_result check_order(const fmt_container *c, svo_rules *rules, svo_error *err)
{
    int last = 0;
    uint64_t assets = 0;
    for (uint32_t i = 0; i < c->chunk_count; i++) {
        const fmt_chunk *k = &c->chunks[i];
        SVO_TRY(fmt_chunk_known(k, chunk_order, CHUNK_TYPES, err));
        if (fmt_chunk_skip(k, chunk_order, CHUNK_TYPES)) continue;
        int rank = 1;
        while (chunk_order[rank - 1] != k->type) rank++;
        if (rank < last || (rank == last && k->type != ASET)) SVO_TRY(svo_go_on(rules, bad(err, SVO_INVALID_DATA, k->type, i, "SCN-01", "not in its place, or twice"), err));
        if (k->codec != FMT_CODEC_NONE || (k->type != META && (k->flags & FMT_CHUNK_CRITICAL) == 0))
            SVO_TRY(svo_go_on(rules, bad(err, SVO_INVALID_DATA, k->type, i, "SCN-01", "wrong codec or flags"), err));
        if (k->id != (k->type == ASET ? assets : 0)) SVO_TRY(svo_go_on(rules, bad(err, SVO_INVALID_DATA, k->type, i, "SCN-01", "wrong id"), err));
        if (k->type == ASET) assets++;
        last = rank;
    }
    return SVO_OK;
}

/* The payload of the only chunk of a type, checked to hold `count` elements of `stride` bytes (stride 0: count bytes). Where
 * count is 0 the chunk must be missing, and *bytes is NULL. */
static svo_result take(const fmt_scene *f, uint32_t type, uint64_t count, uint32_t stride, const uint8_t **bytes, svo_error *err)
{
    const fmt_container *c = &f->container;
    const fmt_chunk *k = fmt_container_find(c, type, true, 0);
    *bytes = NULL;
    if (k == NULL && count == 0) return SVO_OK;
    if (k == NULL) return bad(err, SVO_INVALID_DATA, type, 0, "SCN-01", "missing");
    uint64_t size = k->stored_size;
    /* (divide, do not multiply: count is a claim) */
    bool fits = count != 0 && (stride == 0 ? size == count : size / stride == count && size % stride == 0);
    if (!fits || k->element_stride != stride || k->element_count != (stride != 0 ? count : 0))
        return bad(err, SVO_INVALID_DATA, type, 0, "SCN-02", "wrong size or element count");
    return fmt_container_payload(c, k, bytes, err);
}

/* The same for an array over instances. With `damage` its hash may be wrong: pages have hashes of their own. */
static svo_result take_instances(const fmt_scene *f, uint32_t type, uint32_t stride, fmti_scene_damage *damage, const uint8_t **bytes, svo_error *err)
{
    svo_result result = take(f, type, f->scene.instance_count, stride, bytes, err);
    const fmt_chunk *k = fmt_container_find(&f->container, type, true, 0);
    if (result == SVO_OK || damage == NULL || k == NULL || k->element_count != f->scene.instance_count || k->element_stride != stride ||
        k->stored_size / stride != k->element_count)
        return result;
    damage->arrays = true;
    *bytes = f->container.data + k->offset;
    return SVO_OK;
}

typedef struct head {
    uint32_t assets, flags;
    uint64_t names_size;
    double bounds[6];
    const uint8_t *asset_names; /* u32 each */
} head;

static svo_result read_head(fmt_scene *f, head *h, svo_error *err)
{
    const fmt_chunk *k = fmt_container_find(&f->container, HEAD, true, 0);
    if (k == NULL) return bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-01", "missing");
    if (k->stored_size < HEAD_BYTES || k->element_count != 0 || k->element_stride != 0)
        return bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "wrong size");
    const uint8_t *b;
    SVO_TRY(fmt_container_payload(&f->container, k, &b, err));
    h->assets = fmt_load32(b);
    f->scene.page_count = fmt_load32(b + 4);
    f->scene.instance_count = fmt_load64(b + 8);
    h->names_size = fmt_load64(b + 16);
    h->flags = fmt_load32(b + 24);
    memcpy(h->bounds, b + 32, sizeof h->bounds);
    h->asset_names = b + HEAD_BYTES;
    if ((k->stored_size - HEAD_BYTES) / 4 != h->assets || k->stored_size % 4 != 0) return bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "wrong size");
    if ((h->flags & ~(HAS_CAMERA | HAS_POSES)) != 0 || fmt_load32(b + 28) != 0)
        return bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "unknown flags, or a reserved field that is not 0");
    uint64_t stored = 0;
    for (uint32_t i = 0; i < f->container.chunk_count; i++) stored += f->container.chunks[i].type == ASET;
    if (stored != h->assets) return bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "the number of assets is not that of ASET chunks");
    return SVO_OK;
}

static svo_result read_arrays(fmt_scene *f, const head *h, fmti_scene_damage *damage, svo_error *err)
{
    const fmt_container *c = &f->container;
    svo_scene *s = &f->scene;
    const uint8_t *names, *pages, *hashes = NULL, *assets, *transforms, *ids, *name = NULL, *pose = NULL, *poses = NULL, *matrices = NULL, *camera;
    SVO_TRY(take(f, NAME, h->names_size, 1, &names, err));
    if (names == NULL) return bad(err, SVO_INVALID_DATA, NAME, 0, "SCN-03", "missing");
    SVO_TRY(take(f, PAGE, s->page_count, sizeof(svo_scene_page), &pages, err));
    if (fmt_container_find(c, PHSH, true, 0) != NULL) SVO_TRY(take(f, PHSH, s->page_count, 8, &hashes, err));
    else damage = NULL; /* no page can be told from another */
    SVO_TRY(take_instances(f, IAST, 4, damage, &assets, err));
    SVO_TRY(take_instances(f, IXFM, 48, damage, &transforms, err));
    SVO_TRY(take_instances(f, IIDS, 8, damage, &ids, err));
    if (fmt_container_find(c, INAM, true, 0) != NULL) SVO_TRY(take_instances(f, INAM, 4, damage, &name, err));
    const fmt_chunk *k = fmt_container_find(c, POSE, true, 0), *m = fmt_container_find(c, PMAT, true, 0);
    bool posed = (h->flags & HAS_POSES) != 0;
    if (posed && (k == NULL || k->element_count > UINT32_MAX)) return bad(err, SVO_INVALID_DATA, POSE, 0, "SCN-02", "missing, or too many");
    if (posed) {
        SVO_TRY(take_instances(f, IPOS, 4, damage, &pose, err));
        SVO_TRY(take(f, POSE, k->element_count, sizeof(svo_pose), &poses, err));
        if (m != NULL) SVO_TRY(take(f, PMAT, m->element_count, 48, &matrices, err));
        s->poses = (svo_poses){.count = (uint32_t)k->element_count, .pose = (const svo_pose *)(const void *)poses, .matrix_count = m != NULL ? m->element_count : 0,
                               .matrix = (const float *)(const void *)matrices};
        s->instance_pose = (const uint32_t *)(const void *)pose;
    } else if (k != NULL || m != NULL || fmt_container_find(c, IPOS, true, 0) != NULL) return bad(err, SVO_INVALID_DATA, POSE, 0, "SCN-02", "poses that HEAD does not have");
    SVO_TRY(take(f, CAMR, (h->flags & HAS_CAMERA) != 0 ? CAMERA_BYTES : 0, 0, &camera, err));
    f->page_hashes = hashes;
    s->names = (const char *)names;
    s->names_size = h->names_size;
    s->pages = (const svo_scene_page *)(const void *)pages;
    s->instance_asset = (const uint32_t *)(const void *)assets;
    s->instance_transform = (const float *)(const void *)transforms;
    s->instance_id = (const uint64_t *)(const void *)ids;
    s->instance_name = (const uint32_t *)(const void *)name;
    s->has_camera = camera != NULL;
    if (camera != NULL) {
        memcpy(s->camera_transform.m, camera, sizeof s->camera_transform.m);
        memcpy(&s->camera_yfov, camera + 128, 8);
    }
    return SVO_OK;
}

static svo_result check_page_hashes(const fmt_scene *f, fmti_scene_damage *damage, svo_rules *rules, svo_error *err)
{
    const svo_scene *s = &f->scene;
    uint64_t next = 0;
    for (uint32_t p = 0; p < s->page_count && f->page_hashes != NULL; p++) {
        const svo_scene_page *page = &s->pages[p];
        if (page->first != next || page->count == 0 || page->count > s->instance_count - next)
            return bad(err, SVO_INVALID_DATA, PAGE, p, "SCN-04", "the page does not follow the one before it");
        next += page->count;
        bool same = fmti_scene_page_hash(s, p) == fmt_load64(f->page_hashes + 8 * (uint64_t)p);
        if (same) continue;
        if (damage == NULL) {
            SVO_TRY(svo_go_on(rules, bad(err, SVO_INVALID_DATA, PHSH, p, "SCN-13", "the page is not what was written"), err));
            continue;
        }
        SVO_TRY(fmti_scene_damage_page(damage, s->page_count, p, err));
    }
    return SVO_OK;
}

static svo_result read_assets(fmt_scene *f, const head *h, fmti_scene_damage *damage, svo_error *err)
{
    if (h->assets == 0) return SVO_OK;
    /* The number is believed: that many ASET chunks are in the file. */
    f->assets = svo_calloc(f->allocator, h->assets, sizeof *f->assets);
    f->views = svo_calloc(f->allocator, h->assets, sizeof *f->views);
    f->asset_names = svo_calloc(f->allocator, h->assets, sizeof *f->asset_names);
    f->scene.asset_count = h->assets;
    f->scene.assets = f->views;
    f->scene.asset_names = f->asset_names;
    if (f->assets == NULL || f->views == NULL || f->asset_names == NULL)
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the tables of %u assets", h->assets);
    uint32_t a = 0;
    for (uint32_t i = 0; i < f->container.chunk_count; i++) {
        const fmt_chunk *k = &f->container.chunks[i];
        if (k->type != ASET) continue;
        uint32_t name = fmt_load32(h->asset_names + 4 * (uint64_t)a);
        if (!name_start(&f->scene, name)) return bad(err, SVO_INVALID_DATA, HEAD, a, "SCN-03", "an asset's name is not the start of a name");
        f->asset_names[a] = f->scene.names + name;
        const uint8_t *bytes;
        svo_error inner = {0};
        svo_result result = fmt_container_payload(&f->container, k, &bytes, &inner);
        if (result == SVO_OK) result = fmt_svdag_open(bytes, k->stored_size, f->allocator, &f->assets[a], &inner);
        if (result == SVO_INVALID_DATA && damage != NULL) {
            f->assets[a].view.empty = true; /* nothing is drawn of it */
            damage->assets++;
        } else if (result != SVO_OK) {
            svo_fail(err, result, "ASET %u: %s", a, inner.message);
            if (err != NULL) err->chunk = ASET, err->index = a, err->offset = k->offset + inner.offset;
            return result;
        }
        f->views[a] = &f->assets[a].view;
        a++;
    }
    return SVO_OK;
}

static svo_result read_all(fmt_scene *f, fmti_scene_damage *damage, svo_error *err)
{
    if (f->container.kind != FMT_KIND_SCENE) return svo_fail(err, SVO_INVALID_DATA, "not an .svscene file, but another kind of svokit file");
    if (f->container.major != MAJOR)
        return svo_fail(err, SVO_UNSUPPORTED, ".svscene version %u is newer than this program (it reads version %d)", f->container.major, MAJOR);
    head h;
    SVO_TRY(check_order(&f->container, NULL, err));
    SVO_TRY(read_head(f, &h, err));
    SVO_TRY(read_arrays(f, &h, damage, err));
    if (damage != NULL) SVO_TRY(check_page_hashes(f, damage, NULL, err));
    SVO_TRY(read_assets(f, &h, damage, err));
    SVO_TRY(fmt_container_meta(&f->container, f->allocator, &f->provenance, err));
    double bounds[6] = {0};
    if (f->scene.page_count != 0) svo_scene_bounds(&f->scene, bounds, bounds + 3);
    bool partial = damage != NULL && (damage->pages != 0 || damage->assets != 0);
    if (partial) SVO_TRY(fmti_scene_drop_damaged(f, damage, err));
    SVO_TRY(fmti_scene_check(&f->scene, partial, SVO_INVALID_DATA, f->allocator, NULL, err));
    for (int k = 0; k < 6; k++)
        if (h.bounds[k] != bounds[k]) return bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-05", "the bounds are not the union of the pages'");
    return damage != NULL ? SVO_OK : check_page_hashes(f, NULL, NULL, err);
}

static svo_result open_scene(const uint8_t *data, uint64_t size, const svo_allocator *a, fmti_scene_damage *damage, fmt_scene *out, svo_error *err)
{
    fmt_scene f;
    memset(&f, 0, sizeof f);
    f.allocator = a;
    SVO_TRY(fmt_container_open(data, size, a, &f.container, err));
    svo_result result = read_all(&f, damage, err);
    if (result != SVO_OK) {
        fmt_scene_close(&f);
        return result;
    }
    *out = f;
    return SVO_OK;
}

typedef struct asset_rules { svo_rules *all; uint64_t asset, offset; } asset_rules;

/* A violation inside an asset, as one of the scene. */
static bool found_in_asset(void *user, const svo_error *e)
{
    const asset_rules *r = user;
    svo_error outer = *e;
    svo_fail(&outer, e->code, "asset %llu (SCN-08): %.200s", (unsigned long long)r->asset, e->message);
    outer.chunk = e->chunk, outer.index = e->index, outer.offset = r->offset + e->offset;
    r->all->count++;
    return r->all->found(r->all->user, &outer);
}

static svo_result asset_violations(fmt_scene *f, svo_rules *rules, svo_error *err)
{
    uint64_t a = 0;
    for (uint32_t i = 0; i < f->container.chunk_count; i++) {
        const fmt_chunk *k = &f->container.chunks[i];
        const uint8_t *bytes;
        if (k->type != ASET) continue;
        asset_rules inner = {rules, a++, k->offset};
        svo_rules within = {found_in_asset, &inner, 0};
        svo_result result = fmt_container_payload(&f->container, k, &bytes, err);
        SVO_TRY(svo_go_on(rules, result, err));
        if (result == SVO_OK) SVO_TRY(fmt_svdag_violations(bytes, k->stored_size, f->allocator, &within, err));
    }
    return SVO_OK;
}

static svo_result violations(fmt_scene *f, svo_rules *rules, svo_error *err)
{
    head h;
    if (f->container.kind != FMT_KIND_SCENE || f->container.major != MAJOR) return read_all(f, NULL, err);
    SVO_TRY(check_order(&f->container, rules, err));
    SVO_TRY(asset_violations(f, rules, err));
    uint64_t before = rules->count;
    SVO_TRY(read_head(f, &h, err));
    SVO_TRY(read_arrays(f, &h, NULL, err));
    if (rules->count != before) return SVO_OK;
    fmti_scene_damage damage = {.allocator = f->allocator}; /* its assets were looked at above; here they may be missing */
    svo_result result = read_assets(f, &h, &damage, err);
    fmti_scene_damage_free(&damage);
    SVO_TRY(result);
    SVO_TRY(svo_go_on(rules, fmt_container_meta(&f->container, f->allocator, &f->provenance, err), err));
    double bounds[6] = {0};
    bool same = true;
    if (f->scene.page_count != 0) svo_scene_bounds(&f->scene, bounds, bounds + 3);
    for (int k = 0; k < 6; k++) same = same && h.bounds[k] == bounds[k];
    if (!same) SVO_TRY(svo_go_on(rules, bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-05", "the bounds are not the union of the pages'"), err));
    SVO_TRY(svo_go_on(rules, fmti_scene_check(&f->scene, damage.assets != 0, SVO_INVALID_DATA, f->allocator, rules, err), err));
    return check_page_hashes(f, NULL, rules, err);
}

svo_result fmt_scene_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    fmt_scene f;
    svo_error here = {0};
    if (err == NULL) err = &here;
    memset(&f, 0, sizeof f);
    f.allocator = a;
    svo_result result = fmt_container_open(data, size, a, &f.container, err);
    if (result == SVO_OK) result = violations(&f, rules, err);
    fmt_scene_close(&f);
    return svo_go_on(rules, result, err);
}

svo_result fmt_scene_open(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_scene *out, svo_error *err)
{
    return open_scene(data, size, a, NULL, out, err);
}

svo_result fmt_scene_open_partly(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_scene *out, fmt_scene_loss *loss, svo_error *err)
{
    fmti_scene_damage damage = {.allocator = a};
    svo_result result = open_scene(data, size, a, &damage, out, err);
    if (result == SVO_OK) *loss = (fmt_scene_loss){.pages = damage.pages, .assets = damage.assets, .instances = damage.instances};
    fmti_scene_damage_free(&damage);
    return result;
}

void fmt_scene_close(fmt_scene *s)
{
    if (s == NULL) return;
    for (uint32_t i = 0; s->assets != NULL && i < s->scene.asset_count; i++) fmt_svdag_close(&s->assets[i]);
    svo_free(s->allocator, s->assets, s->scene.asset_count, sizeof *s->assets);
    svo_free(s->allocator, s->views, s->scene.asset_count, sizeof *s->views);
    svo_free(s->allocator, s->asset_names, s->scene.asset_count, sizeof *s->asset_names);
    fmt_meta_free(s->allocator, s->provenance);
    for (int i = 0; i < FMT_SCENE_ARRAYS; i++) svo_buffer_free(&s->copies[i]);
    fmt_container_close(&s->container);
    memset(s, 0, sizeof *s);
}
