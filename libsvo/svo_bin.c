#include "svo_bin.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svo_raster.h"
#include "svo_stream.h"
#include "svo_task.h"

enum { BLOCK = 8192, SPLIT_BLOCK = 1 << 16, MAX_WORKERS = 256, AHEAD = 12 }; /* triangles of a parallel block; svo_task's most workers; triangles fetched ahead */

static int32_t snap_one(double v, double most)
{
    double q = 2 * floor(v * 128) + 1;
    if (!(q >= 1)) q = 1;
    if (q > most) q = most;
    return (int32_t)q;
}

static double lattice_end(const svo_grid *g) { return (double)(((int64_t)1 << (g->depth + 8)) - 1); }

void svo_grid_snap(const svo_grid *g, svo_vec3 p, int32_t q[3])
{
    const double most = lattice_end(g);
    q[0] = snap_one((p.x - g->origin[0]) / g->size, most);
    q[1] = snap_one((p.y - g->origin[1]) / g->size, most);
    q[2] = snap_one((p.z - g->origin[2]) / g->size, most);
}

/* --- placement ------------------------------------------------------------------------------------------------ */

static bool is_identity(const svo_mat4 *m)
{
    const svo_mat4 one = svo_mat4_identity();
    return memcmp(m, &one, sizeof one) == 0;
}

svo_result svo_placement_create(const svo_mesh *mesh, const svo_allocator *a, svo_placement *out, svo_error *err)
{
    svo_placement p = {.mesh = mesh, .allocator = a};
    for (int pass = 0; pass < 2; pass++) {
        uint64_t groups = 0, triangles = 0;
        for (uint32_t i = 0; i < mesh->instance_count; i++) {
            const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
            for (uint32_t k = 0; k < shape->part_count; k++) {
                const svo_part *part = &shape->parts[k];
                if (part->triangle_count == 0) continue;
                if (pass == 1) p.groups[groups] = (svo_group){triangles, part, i, is_identity(&mesh->instances[i].transform)};
                groups++;
                triangles += part->triangle_count;
            }
        }
        if (groups >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu placed parts are more than one run can take", (unsigned long long)groups);
        p.group_count = groups;
        p.triangle_count = triangles;
        if (groups == 0) break;
        if (pass == 0) {
            p.groups = svo_alloc(a, groups, sizeof *p.groups);
            if (p.groups == NULL)
                return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %llu placed parts", (unsigned long long)groups);
        }
    }
    *out = p;
    return SVO_OK;
}

void svo_placement_free(svo_placement *p)
{
    svo_free(p->allocator, p->groups, p->group_count, sizeof *p->groups);
    p->groups = NULL;
}

uint32_t svo_placement_group(const svo_placement *p, uint64_t triangle)
{
    uint64_t low = 0, high = p->group_count; /* last group whose first <= triangle */
    while (high - low > 1) {
        uint64_t mid = low + (high - low) / 2;
        if (p->groups[mid].first <= triangle) low = mid;
        else high = mid;
    }
    return (uint32_t)low;
}

void svo_placement_world(const svo_placement *p, const svo_group *group, uint64_t local, svo_vec3 v[3])
{
    const svo_mat4 *m = &p->mesh->instances[group->instance].transform;
    const uint32_t *index = group->part->indices + 3 * local;
    for (int k = 0; k < 3; k++) {
        const double *at = group->part->positions + 3 * (uint64_t)index[k];
        /* The product would be equal (no negative zeros either), but for corners that are not finite. */
        v[k] = group->identity ? svo_v3(at[0] + 0.0, at[1] + 0.0, at[2] + 0.0) : svo_mat4_point(m, svo_v3(at[0], at[1], at[2]));
    }
}

static bool finite_triangle(const svo_vec3 v[3])
{
    /* 0 * x is NaN for infinities and NaNs, and sums of zeros are zero */
    double z = 0;
    for (int k = 0; k < 3; k++) z += v[k].x * 0 + v[k].y * 0 + v[k].z * 0;
    return z == 0;
}

/* Ask for the corners of a triangle that will be needed soon. */
static inline void fetch_corners(const svo_group *group, uint64_t local)
{
    if (local >= group->part->triangle_count) return;
    const uint32_t *index = group->part->indices + 3 * local;
    for (int k = 0; k < 3; k++) __builtin_prefetch(group->part->positions + 3 * (uint64_t)index[k]);
}

typedef struct bounds_job {
    const svo_placement *p;
    double low[MAX_WORKERS][3], high[MAX_WORKERS][3];
} bounds_job;

static svo_result bounds_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    bounds_job *job = user;
    const svo_placement *p = job->p;
    double *low = job->low[worker], *high = job->high[worker];
    uint64_t g = svo_placement_group(p, begin);
    for (uint64_t t = begin; t < end; t++) {
        while (t - p->groups[g].first >= p->groups[g].part->triangle_count) g++;
        svo_vec3 v[3];
        fetch_corners(&p->groups[g], t + AHEAD - p->groups[g].first);
        svo_placement_world(p, &p->groups[g], t - p->groups[g].first, v);
        if (!finite_triangle(v)) continue;
        for (int k = 0; k < 3; k++) {
            const double c[3] = {v[k].x, v[k].y, v[k].z};
            for (int i = 0; i < 3; i++) {
                if (c[i] < low[i]) low[i] = c[i];
                if (c[i] > high[i]) high[i] = c[i];
            }
        }
    }
    return SVO_OK;
}

svo_result svo_placement_bounds(const svo_placement *p, uint32_t threads, bool *any, double low[3], double high[3], svo_error *err)
{
    bounds_job job = {.p = p};
    for (int w = 0; w < MAX_WORKERS; w++)
        for (int i = 0; i < 3; i++) job.low[w][i] = INFINITY, job.high[w][i] = -INFINITY;
    SVO_TRY(svo_parallel_for(threads, p->triangle_count, BLOCK, bounds_block, &job, err));
    for (int i = 0; i < 3; i++) low[i] = INFINITY, high[i] = -INFINITY;
    for (int w = 0; w < MAX_WORKERS; w++)
        for (int i = 0; i < 3; i++) {
            if (job.low[w][i] < low[i]) low[i] = job.low[w][i];
            if (job.high[w][i] > high[i]) high[i] = job.high[w][i];
        }
    *any = low[0] <= high[0];
    return SVO_OK;
}

/* --- the walk ------------------------------------------------------------------------------------------------- */

typedef struct node {
    uint64_t code;
    uint64_t begin; /* its list is lists[begin .. ): the rest of the array when it is on top of the stack */
    uint32_t level;
    bool empty; /* no triangle meets it */
} node;

struct svo_bins {
    const svo_placement *p;
    svo_grid grid;
    uint32_t level;
    uint64_t first, end; /* codes at `level` that are wanted */
    const svo_allocator *allocator;
    svo_record *records; /* or NULL: snapped again at each use */
    svo_buffer lists;    /* uint32_t triangle numbers of the nodes on the stack, bottom first */
    svo_buffer masks;    /* scratch of a split: octants of each triangle */
    svo_buffer starts;   /* the same: of each block, uint64_t[8] */
    uint32_t threads;
    node stack[8 * (SVO_MAX_DEPTH + 1)];
    uint32_t height;
    uint64_t gap, gap_end; /* of a gap: what has not been on the stack yet */
    svo_empty_fn empty; /* NULL: empty nodes are left out */
    void *empty_user;
};

typedef struct setup_job {
    svo_bins *b;
    uint8_t *finite; /* a byte a triangle */
    svo_bins_report *blocks;
} setup_job;

static svo_result setup_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    setup_job *job = user;
    svo_bins *b = job->b;
    const svo_placement *p = b->p;
    svo_bins_report r = {0};
    const double most = lattice_end(&b->grid);
    uint64_t g = svo_placement_group(p, begin);
    for (uint64_t t = begin; t < end; t++) {
        while (t - p->groups[g].first >= p->groups[g].part->triangle_count) g++;
        svo_vec3 v[3];
        fetch_corners(&p->groups[g], t + AHEAD - p->groups[g].first);
        svo_placement_world(p, &p->groups[g], t - p->groups[g].first, v);
        job->finite[t] = finite_triangle(v);
        if (!job->finite[t]) {
            r.skipped++;
            continue;
        }
        svo_record record;
        record.group = (uint32_t)g;
        for (int k = 0; k < 3; k++) {
            const double at[3] = {(v[k].x - b->grid.origin[0]) / b->grid.size, (v[k].y - b->grid.origin[1]) / b->grid.size,
                                  (v[k].z - b->grid.origin[2]) / b->grid.size}; /* as svo_grid_snap */
            double square[3];
            for (int i = 0; i < 3; i++) {
                record.q[k][i] = snap_one(at[i], most);
                double move = at[i] - record.q[k][i] / 256.0;
                square[i] = move * move;
            }
            double d = sqrt(square[0] + square[1] + square[2]);
            r.snap_sum += d;
            if (d > r.snap_max) r.snap_max = d;
        }
        int64_t e[3], f[3];
        for (int k = 0; k < 3; k++) {
            e[k] = (int64_t)record.q[1][k] - record.q[0][k];
            f[k] = (int64_t)record.q[2][k] - record.q[0][k];
        }
        r.degenerate += e[1] * f[2] == e[2] * f[1] && e[2] * f[0] == e[0] * f[2] && e[0] * f[1] == e[1] * f[0];
        if (b->records != NULL) b->records[t] = record;
    }
    job->blocks[begin / BLOCK] = r;
    return SVO_OK;
}

static svo_result no_memory(const svo_placement *p, svo_error *err)
{
    return svo_fail(err, SVO_OUT_OF_MEMORY, "the working memory for %llu triangles (about %llu MB) cannot be had", (unsigned long long)p->triangle_count,
                    (unsigned long long)(p->triangle_count * 10 / 1000000 + 1));
}

svo_result svo_bins_create(const svo_placement *p, const svo_grid *g, uint32_t level, uint64_t keep_bytes, uint32_t threads,
                           const svo_allocator *a, svo_bins **out, svo_bins_report *report, svo_error *err)
{
    /* Triangle numbers are 32 bits: a mesh that needs more is better packed as instances than voxelized in one grid. */
    if (p->triangle_count >= UINT32_MAX)
        return svo_fail(err, SVO_LIMIT, "%llu placed triangles are more than can be worked on in memory (4294967294); give --memory so that they are "
                        "worked on in parts, split the input, or pack its instances with svo-pack", (unsigned long long)p->triangle_count);
    svo_bins *b = svo_calloc(a, 1, sizeof *b);
    if (b == NULL) return no_memory(p, err);
    uint64_t n = p->triangle_count, blocks = (n + BLOCK - 1) / BLOCK;
    b->p = p;
    b->grid = *g;
    b->level = level;
    b->end = UINT64_MAX;
    b->allocator = a;
    svo_buffer_init(&b->lists, a);
    svo_buffer_init(&b->masks, a);
    svo_buffer_init(&b->starts, a);
    b->threads = threads;
    memset(report, 0, sizeof *report);
    if (n == 0) {
        *out = b;
        return SVO_OK;
    }
    if (n <= keep_bytes / sizeof(svo_record)) b->records = svo_alloc(a, n, sizeof *b->records);
    setup_job job = {.b = b};
    job.finite = svo_alloc(a, n, 1);
    job.blocks = svo_calloc(a, blocks, sizeof *job.blocks);
    svo_result r = SVO_OK;
    if (job.finite == NULL || job.blocks == NULL) r = no_memory(p, err);
    if (r == SVO_OK) r = svo_parallel_for(threads, n, BLOCK, setup_block, &job, err);
    if (r == SVO_OK) {
        for (uint64_t i = 0; i < blocks; i++) { /* in order, so that the sum does not depend on threads */
            report->skipped += job.blocks[i].skipped;
            report->degenerate += job.blocks[i].degenerate;
            report->snap_sum += job.blocks[i].snap_sum;
            if (job.blocks[i].snap_max > report->snap_max) report->snap_max = job.blocks[i].snap_max;
        }
        if (!svo_buffer_reserve(&b->lists, (n - report->skipped) * 4)) r = no_memory(p, err);
    }
    if (r == SVO_OK) {
        uint32_t *list = (uint32_t *)(void *)b->lists.data;
        uint64_t count = 0;
        for (uint64_t t = 0; t < n; t++)
            if (job.finite[t]) list[count++] = (uint32_t)t;
        b->lists.size = count * 4;
        if (count != 0) b->stack[b->height++] = (node){0};
    }
    svo_free(a, job.finite, n, 1);
    svo_free(a, job.blocks, blocks, sizeof *job.blocks);
    if (r != SVO_OK) {
        svo_bins_free(b);
        return r;
    }
    *out = b;
    return SVO_OK;
}

void svo_bins_limit(svo_bins *b, uint64_t first, uint64_t end)
{
    b->first = first;
    b->end = end;
    if (first >= end || (b->level == 0 && first > 0)) b->height = 0;
}

void svo_bins_free(svo_bins *b)
{
    if (b == NULL) return;
    svo_free(b->allocator, b->records, b->p->triangle_count, sizeof *b->records);
    svo_buffer_free(&b->lists);
    svo_buffer_free(&b->masks);
    svo_buffer_free(&b->starts);
    svo_free(b->allocator, b, 1, sizeof *b);
}

void svo_bins_fetch(const svo_bins *b, uint32_t triangle)
{
    if (b->records != NULL) __builtin_prefetch(&b->records[triangle]);
}

void svo_bins_record(const svo_bins *b, uint32_t triangle, svo_record *out)
{
    if (b->records != NULL) {
        *out = b->records[triangle];
        return;
    }
    svo_vec3 v[3];
    out->group = svo_placement_group(b->p, triangle);
    const svo_group *group = &b->p->groups[out->group];
    svo_placement_world(b->p, group, triangle - group->first, v);
    for (int k = 0; k < 3; k++) svo_grid_snap(&b->grid, v[k], out->q[k]);
}

static uint8_t octants(const int32_t q[3][3], const int32_t corner[3], int32_t size)
{
    int32_t low[3], high[3];
    svo_raster_bounds(q, low, high);
    return svo_raster_octants(q, low, high, corner, size);
}

/* Children of a node that hold wanted codes. */
static uint8_t wanted(const svo_bins *b, node n)
{
    uint32_t shift = 3 * (b->level - n.level - 1), mask = 0;
    for (uint32_t c = 0; c < 8; c++) {
        uint64_t low = (n.code * 8 + c) << shift, high = low + ((uint64_t)1 << shift);
        if (low < b->end && high > b->first) mask |= 1u << c;
    }
    return (uint8_t)mask;
}

/* Sorting a list into those of the children. A long one is sorted by all threads: the blocks count first, then each knows where
 * its triangles go, so the order stays. */
typedef struct split_job {
    const svo_bins *b;
    const uint32_t *list;
    uint8_t *masks;
    int32_t corner[3], size;
    uint8_t allowed;
    uint64_t (*at)[8]; /* of each block: how many go to each child, then where they begin */
    uint32_t *to;
} split_job;

static svo_result split_count(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    split_job *j = user;
    const svo_bins *b = j->b;
    uint64_t count[8] = {0};
    for (uint64_t i = begin; i < end; i++) {
        uint8_t mask;
        if (b->records != NULL) {
            if (i + AHEAD < end) __builtin_prefetch(&b->records[j->list[i + AHEAD]]);
            mask = octants(b->records[j->list[i]].q, j->corner, j->size);
        } else {
            svo_record r;
            svo_bins_record(b, j->list[i], &r);
            mask = octants(r.q, j->corner, j->size);
        }
        mask &= j->allowed;
        j->masks[i] = mask;
        for (uint32_t c = 0; c < 8; c++) count[c] += mask >> c & 1;
    }
    memcpy(j->at[begin / SPLIT_BLOCK], count, sizeof count);
    return SVO_OK;
}

static svo_result split_place(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    split_job *j = user;
    uint64_t at[8];
    memcpy(at, j->at[begin / SPLIT_BLOCK], sizeof at);
    for (uint64_t i = begin; i < end; i++)
        for (uint32_t mask = j->masks[i]; mask != 0; mask &= mask - 1) j->to[at[__builtin_ctz(mask)]++] = j->list[i];
    return SVO_OK;
}

/* Replace the list on top by the lists of its children, child 0 on top. */
static bool split(svo_bins *b, node n)
{
    uint64_t count = b->lists.size / 4 - n.begin, blocks = (count + SPLIT_BLOCK - 1) / SPLIT_BLOCK, total = 0;
    svo_error unused;
    b->masks.size = b->starts.size = 0;
    split_job j = {.b = b, .size = (int32_t)1 << (b->grid.depth + 8 - n.level - 1), .allowed = wanted(b, n)};
    if (!svo_buffer_reserve(&b->masks, count) || !svo_buffer_reserve(&b->starts, blocks * sizeof *j.at)) return false;
    uint32_t x, y, z;
    svo_morton_decode(n.code, &x, &y, &z);
    j.corner[0] = (int32_t)x * 2 * j.size;
    j.corner[1] = (int32_t)y * 2 * j.size;
    j.corner[2] = (int32_t)z * 2 * j.size;
    j.list = (const uint32_t *)(const void *)b->lists.data + n.begin;
    j.masks = b->masks.data;
    j.at = (uint64_t(*)[8])(void *)b->starts.data;
    if (svo_parallel_for(b->threads, count, SPLIT_BLOCK, split_count, &j, &unused) != SVO_OK) return false;
    for (uint32_t c = 8; c-- > 0;) {
        uint64_t begin = total;
        for (uint64_t i = 0; i < blocks; i++) {
            uint64_t here = j.at[i][c];
            j.at[i][c] = total;
            total += here;
        }
        if (total != begin || (b->empty != NULL && (j.allowed >> c & 1)))
            b->stack[b->height++] = (node){n.code * 8 + c, n.begin + begin, n.level + 1, total == begin};
    }
    if (!svo_buffer_reserve(&b->lists, total * 4)) return false;
    uint32_t *old = (uint32_t *)(void *)b->lists.data + n.begin;
    j.list = old;
    j.to = old + count;
    if (svo_parallel_for(b->threads, count, SPLIT_BLOCK, split_place, &j, &unused) != SVO_OK) return false;
    memmove(old, j.to, total * 4);
    b->lists.size = (n.begin + total) * 4;
    return true;
}

void svo_bins_empty_nodes(svo_bins *b, svo_empty_fn fn, void *user)
{
    b->empty = fn;
    b->empty_user = user;
}

static void split_empty(svo_bins *b, node n)
{
    const uint8_t allowed = wanted(b, n);
    for (uint32_t c = 8; c-- > 0;)
        if (allowed >> c & 1) b->stack[b->height++] = (node){n.code * 8 + c, n.begin, n.level + 1, true};
}

void svo_bins_gap(svo_bins *b, uint64_t first, uint64_t end)
{
    b->gap = first;
    b->gap_end = end;
}

/* The largest node that begins where the gap does. */
static void push_gap(svo_bins *b)
{
    uint32_t up = 0;
    while (up < b->level && b->gap % ((uint64_t)8 << 3 * up) == 0 && b->gap_end - b->gap >= (uint64_t)8 << 3 * up) up++;
    b->stack[b->height++] = (node){.code = b->gap >> 3 * up, .level = b->level - up, .empty = true};
    b->gap += (uint64_t)1 << 3 * up;
}

svo_result svo_bins_next_node(svo_bins *b, uint64_t *code, uint32_t *level, bool *full, svo_buffer *list, bool *more, svo_error *err)
{
    for (;;) {
        if (b->height == 0) {
            if (b->gap >= b->gap_end) break;
            push_gap(b);
        }
        node n = b->stack[--b->height];
        *full = false;
        if (n.empty) {
            svo_bin_side side = b->empty(b->empty_user, n.code, n.level);
            if (side == SVO_BIN_SKIP) continue;
            if (side == SVO_BIN_SPLIT && n.level < b->level) {
                split_empty(b, n);
                continue;
            }
            *full = side == SVO_BIN_FULL;
        } else if (n.level < b->level) {
            if (!split(b, n)) return no_memory(b->p, err);
            continue;
        }
        list->size = 0;
        if (!n.empty && svo_buffer_append(list, b->lists.data + n.begin * 4, b->lists.size - n.begin * 4) == NULL) return no_memory(b->p, err);
        b->lists.size = n.begin * 4;
        *code = n.code;
        *level = n.level;
        *more = true;
        return SVO_OK;
    }
    *more = false;
    return SVO_OK;
}

svo_result svo_bins_next(svo_bins *b, uint64_t *code, svo_buffer *list, bool *more, svo_error *err)
{
    uint32_t level;
    bool full;
    return svo_bins_next_node(b, code, &level, &full, list, more, err);
}
