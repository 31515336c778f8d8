/* Reading .svscene. The rules are in fmt_scene_rules.c, writing is in fmt_scene_write.c. */
#include "fmt_scene.h"

#include <string.h>

#include "fmti_scene.h"
#include "svo_deform.h"

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
        if (rank < last || (rank == last && k->type != ASET)) SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, SVO_INVALID_DATA, k->type, i, "SCN-01", "not in its place, or twice"), err));
        if (k->codec != FMT_CODEC_NONE || (k->type != META && (k->flags & FMT_CHUNK_CRITICAL) == 0))
            SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, SVO_INVALID_DATA, k->type, i, "SCN-01", "wrong codec or flags"), err));
        if (k->id != (k->type == ASET ? assets : 0)) SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, SVO_INVALID_DATA, k->type, i, "SCN-01", "wrong id"), err));
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
    if (k == NULL) return fmti_scene_bad(err, SVO_INVALID_DATA, type, 0, "SCN-01", "missing");
    uint64_t size = k->stored_size;
    /* (divide, do not multiply: count is a claim) */
    bool fits = count != 0 && (stride == 0 ? size == count : size / stride == count && size % stride == 0);
    if (!fits || k->element_stride != stride || k->element_count != (stride != 0 ? count : 0))
        return fmti_scene_bad(err, SVO_INVALID_DATA, type, 0, "SCN-02", "wrong size or element count");
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
    if (k == NULL) return fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-01", "missing");
    if (k->stored_size < HEAD_BYTES || k->element_count != 0 || k->element_stride != 0)
        return fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "wrong size");
    const uint8_t *b;
    SVO_TRY(fmt_container_payload(&f->container, k, &b, err));
    h->assets = fmt_load32(b);
    f->scene.page_count = fmt_load32(b + 4);
    f->scene.instance_count = fmt_load64(b + 8);
    h->names_size = fmt_load64(b + 16);
    h->flags = fmt_load32(b + 24);
    memcpy(h->bounds, b + 32, sizeof h->bounds);
    h->asset_names = b + HEAD_BYTES;
    if ((k->stored_size - HEAD_BYTES) / 4 != h->assets || k->stored_size % 4 != 0) return fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "wrong size");
    if ((h->flags & ~(HAS_CAMERA | HAS_POSES)) != 0 || fmt_load32(b + 28) != 0)
        return fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "unknown flags, or a reserved field that is not 0");
    uint64_t stored = 0;
    for (uint32_t i = 0; i < f->container.chunk_count; i++) stored += f->container.chunks[i].type == ASET;
    if (stored != h->assets) return fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-02", "the number of assets is not that of ASET chunks");
    return SVO_OK;
}

static svo_result read_arrays(fmt_scene *f, const head *h, fmti_scene_damage *damage, svo_error *err)
{
    const fmt_container *c = &f->container;
    svo_scene *s = &f->scene;
    const uint8_t *names, *pages, *hashes = NULL, *assets, *transforms, *ids, *name = NULL, *pose = NULL, *poses = NULL, *matrices = NULL, *camera;
    SVO_TRY(take(f, NAME, h->names_size, 1, &names, err));
    if (names == NULL) return fmti_scene_bad(err, SVO_INVALID_DATA, NAME, 0, "SCN-03", "missing");
    SVO_TRY(take(f, PAGE, s->page_count, sizeof(svo_scene_page), &pages, err));
    if (fmt_container_find(c, PHSH, true, 0) != NULL) SVO_TRY(take(f, PHSH, s->page_count, 8, &hashes, err));
    else damage = NULL; /* no page can be told from another */
    SVO_TRY(take_instances(f, IAST, 4, damage, &assets, err));
    SVO_TRY(take_instances(f, IXFM, 48, damage, &transforms, err));
    SVO_TRY(take_instances(f, IIDS, 8, damage, &ids, err));
    if (fmt_container_find(c, INAM, true, 0) != NULL) SVO_TRY(take_instances(f, INAM, 4, damage, &name, err));
    const fmt_chunk *k = fmt_container_find(c, POSE, true, 0), *m = fmt_container_find(c, PMAT, true, 0);
    bool posed = (h->flags & HAS_POSES) != 0;
    if (posed && (k == NULL || k->element_count > UINT32_MAX)) return fmti_scene_bad(err, SVO_INVALID_DATA, POSE, 0, "SCN-02", "missing, or too many");
    if (posed) {
        SVO_TRY(take_instances(f, IPOS, 4, damage, &pose, err));
        SVO_TRY(take(f, POSE, k->element_count, sizeof(svo_pose), &poses, err));
        if (m != NULL) SVO_TRY(take(f, PMAT, m->element_count, 48, &matrices, err));
        s->poses = (svo_poses){.count = (uint32_t)k->element_count, .pose = (const svo_pose *)(const void *)poses, .matrix_count = m != NULL ? m->element_count : 0,
                               .matrix = (const float *)(const void *)matrices};
        s->instance_pose = (const uint32_t *)(const void *)pose;
    } else if (k != NULL || m != NULL || fmt_container_find(c, IPOS, true, 0) != NULL) return fmti_scene_bad(err, SVO_INVALID_DATA, POSE, 0, "SCN-02", "poses that HEAD does not have");
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
            return fmti_scene_bad(err, SVO_INVALID_DATA, PAGE, p, "SCN-04", "the page does not follow the one before it");
        next += page->count;
        bool same = fmti_scene_page_hash(s, p) == fmt_load64(f->page_hashes + 8 * (uint64_t)p);
        if (same) continue;
        if (damage == NULL) {
            SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, SVO_INVALID_DATA, PHSH, p, "SCN-13", "the page is not what was written"), err));
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
        if (!fmti_scene_name_start(&f->scene, name)) return fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, a, "SCN-03", "an asset's name is not the start of a name");
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
        if (h.bounds[k] != bounds[k]) return fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-05", "the bounds are not the union of the pages'");
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
    if (!same) SVO_TRY(svo_go_on(rules, fmti_scene_bad(err, SVO_INVALID_DATA, HEAD, 0, "SCN-05", "the bounds are not the union of the pages'"), err));
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
