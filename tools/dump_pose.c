#include "dump_pose.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "dump_cut.h"
#include "svo_bones.h"
#include "svo_deform.h"

enum {
    MOST_PAIRS = 1 << 13,
    NODES_IN_ALL = 1 << 24,
    NODES_A_PAIR = 1 << 21,
    CELLS_A_NODE = 64, /* fewer than svo-render's: a pose may stretch all nodes, and the page shows coarser ones then anyhow */
    NAME_ROOM = 24 /* " (pose 4294967295)" */
};

/* ---- pairs ---------------------------------------------------------------------------------------------------------- */

static dump_pair pair_of(const svo_scene *s, bool rest, uint64_t i)
{
    return (dump_pair){s->instance_asset[i], rest || svo_scene_instance_pose(s, i) == NULL ? SVO_NO_POSE : s->instance_pose[i]};
}

static int compare_pairs(const void *a, const void *b)
{
    const dump_pair *p = a, *q = b;
    if (p->asset != q->asset) return p->asset < q->asset ? -1 : 1;
    return p->pose < q->pose ? -1 : p->pose > q->pose;
}

svo_result dump_pairs_find(const svo_scene *s, bool rest, const svo_allocator *a, dump_pairs *out, svo_error *err)
{
    *out = (dump_pairs){.allocator = a, .capacity = s->instance_count};
    out->pair = svo_alloc(a, s->instance_count, sizeof *out->pair);
    if (out->pair == NULL && s->instance_count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the instances");
    for (uint64_t i = 0; i < s->instance_count; i++) out->pair[i] = pair_of(s, rest, i);
    if (s->instance_count != 0) qsort(out->pair, s->instance_count, sizeof *out->pair, compare_pairs);
    for (uint64_t i = 0; i < s->instance_count; i++)
        if (i == 0 || compare_pairs(&out->pair[i], &out->pair[out->count - 1]) != 0) out->pair[out->count++] = out->pair[i];
    return SVO_OK;
}

uint64_t dump_pairs_index(const dump_pairs *p, const svo_scene *s, bool rest, uint64_t instance)
{
    const dump_pair key = pair_of(s, rest, instance), *found = bsearch(&key, p->pair, p->count, sizeof key, compare_pairs);
    return (uint64_t)(found - p->pair);
}

void dump_pairs_free(dump_pairs *p)
{
    svo_free(p->allocator, p->pair, p->capacity, sizeof *p->pair);
    *p = (dump_pairs){0};
}

/* ---- one pose ------------------------------------------------------------------------------------------------------- */

/* The finest level with at most so many nodes. */
static uint32_t level_within(const svo_view *v, uint64_t nodes)
{
    uint32_t level = v->depth;
    while (level > 0 && v->nodes[level] > nodes) level--;
    return level;
}

static svo_result count_leaf(void *user, const dump_cut_node *n, svo_error *err)
{
    (void)err;
    if (n->leaf) ((uint64_t *)user)[n->level]++;
    return SVO_OK;
}

/* A box that a pose has squeezed flat makes cells many levels below those of all others. */
static svo_result find_finest(const svo_view *v, uint32_t *finest, svo_error *err)
{
    uint64_t leaves[SVO_MAX_DEPTH + 1] = {0}, all = 0, finer = 0;
    SVO_TRY(dump_cut(v, v->tree_depth, count_leaf, leaves, err));
    for (uint32_t l = 0; l <= v->tree_depth; l++) all += leaves[l];
    for (*finest = v->tree_depth; *finest > 2 && finer + leaves[*finest] <= all / 1000; --*finest) finer += leaves[*finest];
    return SVO_OK;
}

/* Octree `i` of the list; none where numbers do not reach. */
static svo_result pose_one(cli *c, const svo_scene *s, dump_baked *p, uint64_t i, bool *coarser, svo_error *err)
{
    const uint32_t zero = 0, asset = p->pairs.pair[i].asset;
    const svo_view *v = s->assets[asset];
    const float identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
    const uint64_t id = 0, most = NODES_IN_ALL / p->pairs.count;
    const uint32_t level = level_within(v, most > NODES_A_PAIR ? NODES_A_PAIR : most);
    svo_scene_page page = {.count = 1};
    const svo_scene one = {.asset_count = 1, .assets = &s->assets[asset], .asset_names = &s->asset_names[asset], .instance_count = 1, .instance_asset = &zero,
                           .instance_transform = identity, .instance_id = &id, .names = "", .names_size = 1, .instance_pose = &p->pairs.pair[i].pose, .poses = s->poses,
                           .page_count = 1, .pages = &page};
    svo_unpose_options o = {.select = {.width = 1, .height = 1, .delta = 1, .whole = true, .threads = (uint32_t)c->threads, .allocator = p->allocator}, .method = SVO_RESAMPLE_EMIT, .labels = true,
                            .most_cells = CELLS_A_NODE};
    svo_unpose_report report;
    svo_extent extent;
    *coarser = level < v->depth;
    SVO_TRY(svo_scene_extents(&one, p->allocator, &extent, err));
    const bool finite = svo_scene_instance_bounds(&one, 0, 0, &extent, page.low, page.high);
    svo_extent_free(&extent);
    const double size = svo_length(svo_sub(svo_v3(page.high[0], page.high[1], page.high[2]), svo_v3(page.low[0], page.low[1], page.low[2])));
    if (!finite || !isfinite(1e6 * size) || v->empty) return SVO_OK;
    /* Cells lie at multiples of their size from the eye. Nodes are as long as those of the level where the pose leaves them so; one that stretches them has more of them. */
    o.select.eye = (svo_eye){.position = svo_v3(0.5 * page.low[0] + 0.5 * page.high[0], 0.5 * page.low[1] + 0.5 * page.high[1], 0.5 * page.low[2] + 0.5 * page.high[2]),
                             .right = {1, 0, 0}, .up = {0, 1, 0}, .forward = {0, 0, -1}, .yfov = 1};
    if (*coarser) o.select.edge = 2 * ldexp(size, -(int)level);
    for (int k = 0; k < 3; k++) page.low[k] -= size, page.high[k] += size; /* boxes are cut to the page: what is left of them can be very flat */
    svo_result r = svo_unpose(&one, &o, &p->octree[i], &report, err);
    if (r == SVO_LIMIT) return SVO_OK;
    if (r == SVO_OK && report.select.overflowed != 0) {
        svo_unposed_free(p->octree[i]);
        p->octree[i] = NULL;
        return SVO_OK;
    }
    return r == SVO_OK ? find_finest(svo_unposed_view(p->octree[i]), &p->finest[i], err) : r;
}

/* ---- the scene ------------------------------------------------------------------------------------------------------ */

static svo_result allocate(dump_baked *p, const svo_scene *s, svo_error *err)
{
    const uint64_t n = p->pairs.count;
    if (n > UINT32_MAX - 1) return svo_fail(err, SVO_LIMIT, "%llu pairs of asset and pose are too many", (unsigned long long)n);
    p->scene = *s;
    p->octree = svo_calloc(p->allocator, n, sizeof *p->octree);
    p->view = svo_alloc(p->allocator, n, sizeof *p->view);
    p->finest = svo_alloc(p->allocator, n, sizeof *p->finest);
    p->name = svo_alloc(p->allocator, n, sizeof *p->name);
    p->asset = svo_alloc(p->allocator, s->instance_count, sizeof *p->asset);
    for (uint64_t i = 0; i < n; i++) p->names_size += strlen(s->asset_names[p->pairs.pair[i].asset]) + NAME_ROOM;
    p->names = svo_alloc(p->allocator, p->names_size, 1);
    return n == 0 || (p->octree != NULL && p->view != NULL && p->finest != NULL && p->name != NULL && p->asset != NULL && p->names != NULL) ? SVO_OK
                                                                                                                       : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the poses");
}

static void fill_assets(dump_baked *p, const svo_scene *s)
{
    char *at = p->names;
    for (uint64_t i = 0; i < p->pairs.count; i++) {
        const dump_pair q = p->pairs.pair[i];
        const size_t room = strlen(s->asset_names[q.asset]) + NAME_ROOM;
        p->view[i] = p->octree[i] != NULL ? svo_unposed_view(p->octree[i]) : s->assets[q.asset];
        if (p->octree[i] == NULL) p->finest[i] = p->view[i]->tree_depth;
        p->name[i] = at;
        if (q.pose == SVO_NO_POSE) snprintf(at, room, "%s", s->asset_names[q.asset]);
        else snprintf(at, room, "%s (pose %u)", s->asset_names[q.asset], q.pose);
        at += room;
    }
}

svo_result dump_bake(cli *c, const svo_scene *s, bool rest, const svo_allocator *a, dump_baked *out, svo_error *err)
{
    dump_baked p = {.allocator = a};
    bool *coarser = NULL;
    svo_result r = dump_pairs_find(s, rest, a, &p.pairs, err);
    if (r == SVO_OK && !rest && p.pairs.count > MOST_PAIRS) {
        rest = true;
        dump_pairs_free(&p.pairs);
        r = dump_pairs_find(s, true, a, &p.pairs, err);
    }
    if (r == SVO_OK) r = allocate(&p, s, err);
    if (r == SVO_OK && (coarser = svo_calloc(a, p.pairs.count, sizeof *coarser)) == NULL && p.pairs.count != 0) r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the poses");
    for (uint64_t i = 0; r == SVO_OK && i < p.pairs.count; i++) {
        if (p.pairs.pair[i].pose == SVO_NO_POSE) continue;
        cli_progress(c, "poses", (double)i / (double)p.pairs.count);
        r = pose_one(c, s, &p, i, &coarser[i], err);
    }
    if (r == SVO_OK) {
        fill_assets(&p, s);
        for (uint64_t i = 0; i < s->instance_count; i++) {
            const uint64_t n = dump_pairs_index(&p.pairs, s, rest, i);
            p.asset[i] = (uint32_t)n;
            if (svo_scene_instance_pose(s, i) == NULL) continue;
            p.posed += p.octree[n] != NULL, p.rested += p.octree[n] == NULL, p.coarser += p.octree[n] != NULL && coarser[n];
        }
        p.scene.asset_count = (uint32_t)p.pairs.count;
        p.scene.assets = p.view, p.scene.asset_names = p.name, p.scene.instance_asset = p.asset;
        p.scene.instance_pose = NULL, p.scene.poses = (svo_poses){0};
    }
    svo_free(a, coarser, p.pairs.count, sizeof *coarser);
    if (r == SVO_OK) *out = p;
    else dump_baked_free(&p);
    return r;
}

void dump_baked_free(dump_baked *p)
{
    const svo_allocator *a = p->allocator;
    for (uint64_t i = 0; p->octree != NULL && i < p->pairs.count; i++) svo_unposed_free(p->octree[i]);
    svo_free(a, p->octree, p->pairs.count, sizeof *p->octree);
    svo_free(a, p->view, p->pairs.count, sizeof *p->view);
    svo_free(a, p->finest, p->pairs.count, sizeof *p->finest);
    svo_free(a, p->name, p->pairs.count, sizeof *p->name);
    svo_free(a, p->names, p->names_size, 1);
    svo_free(a, p->asset, p->scene.instance_count, sizeof *p->asset);
    dump_pairs_free(&p->pairs);
    *p = (dump_baked){0};
}
