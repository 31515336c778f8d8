/* Skeletons of voxels: the octree is read once, at a level that is fine enough for omega; the closed surface around what is there becomes a mesh, and that goes the way of
 * every mesh. */
#include "skeli_voxels.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"

enum { MAX_LEVEL = 10 };                   /* 1024^3 cells: 128 MiB a bit set */
#define MAX_CELLS ((uint64_t)1 << 27)      /* occupied cells of the level read */
#define MAX_VOXELS ((uint64_t)1 << 32)     /* finest voxels: entries of the map */

/* `voxels` finest voxels in the cell with this code, which comes after all others or is the last one. */
static bool add_to_cell(cells *c, uint32_t code, uint32_t voxels, const float normal[3])
{
    if (c->count > 0 && codes(c)[c->count - 1] == code && counts(c)[c->count - 1] <= UINT32_MAX - voxels) {
        counts(c)[c->count - 1] += voxels;
        for (uint64_t k = 0; k < 3 && c->channel != SVO_NONE; k++) normals(c)[3 * (c->count - 1) + k] += normal[k] * (float)voxels;
        return true;
    }
    if (c->count == MAX_CELLS) {
        c->too_many = true;
        return false;
    }
    c->failed = svo_buffer_append(&c->code, &code, 4) == NULL || svo_buffer_append(&c->voxels, &voxels, 4) == NULL;
    const float sum[3] = {normal[0] * (float)voxels, normal[1] * (float)voxels, normal[2] * (float)voxels};
    c->failed = c->failed || (c->channel != SVO_NONE && svo_buffer_append(&c->normal, sum, sizeof sum) == NULL);
    c->count++;
    return !c->failed;
}

/* A voxel, or a full leaf of size^3 of them. */
static bool add_value(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    cells *c = user;
    float normal[3] = {0, 0, 0};
    if (c->channel != SVO_NONE && size == 1) svo_oct32_decode(c->chunk->channels[c->channel] + 4 * index, normal); /* full leaves are inside */
    const uint64_t voxels = (uint64_t)size * size * size;
    if (voxels > MAX_VOXELS || (c->total += voxels) > MAX_VOXELS) {
        c->too_many = true;
        return false;
    }
    const uint32_t first = (uint32_t)svo_morton_encode(low[0] >> c->shift, low[1] >> c->shift, low[2] >> c->shift); /* at most 30 bits */
    const uint32_t side = size >> c->shift, cell = 1u << 3 * (c->shift < 10 ? c->shift : 10);
    if (side <= 1) return add_to_cell(c, first, (uint32_t)(voxels < cell ? voxels : cell), normal);
    for (uint32_t i = 0; i < side * side * side; i++)
        if (!add_to_cell(c, first + i, cell, normal)) return false;
    return true;
}

static svo_result read_cells(const svo_chunk_source *source, cells *c, svo_error *err)
{
    svo_buffer packed, storage;
    svo_buffer_init(&packed, c->allocator);
    svo_buffer_init(&storage, c->allocator);
    svo_result result = SVO_OK;
    for (bool more = true; result == SVO_OK;) {
        svo_chunk chunk;
        result = source->fetch(source->user, &packed, &more, err);
        if (result != SVO_OK || !more) break;
        result = source->decode(source->user, &packed, &storage, &chunk, err);
        if (result != SVO_OK) break;
        c->chunk = &chunk;
        svo_chunk_values(&chunk, add_value, c);
        c->chunk = NULL;
        if (c->too_many) result = svo_fail(err, SVO_LIMIT, "the octree has more voxels than a skeleton is built from (2^32, and 2^27 at level %u)", c->level);
        else if (c->failed) result = skeli_no_memory(err);
    }
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    if (result == SVO_OK && c->count == 0) result = svo_fail(err, SVO_INVALID_DATA, "the octree has no voxels, so it has no skeleton");
    return result;
}

/* Merge cells down to a coarser level. */
static void coarsen(cells *c, uint32_t level)
{
    uint32_t by = 3 * (c->level - level);
    uint64_t n = 0;
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t code = codes(c)[i] >> by;
        if (n > 0 && codes(c)[n - 1] == code && (uint64_t)counts(c)[n - 1] + counts(c)[i] <= UINT32_MAX) {
            counts(c)[n - 1] += counts(c)[i];
            for (uint64_t k = 0; k < 3 && c->channel != SVO_NONE; k++) normals(c)[3 * (n - 1) + k] += normals(c)[3 * i + k];
        } else {
            codes(c)[n] = code;
            if (c->channel != SVO_NONE) memmove(normals(c) + 3 * n, normals(c) + 3 * i, 3 * sizeof(float));
            counts(c)[n++] = counts(c)[i];
        }
    }
    c->count = n;
    c->shift += c->level - level;
    c->level = level;
}

/* The coarsest level whose cells are at most omega/2 of the longest side of what is occupied; omega/4 where the octree is as deep and normals say where in a cell the surface is. */
static svo_result choose_level(cells *c, double omega, uint32_t depth, svo_error *err)
{
    uint32_t low[3] = {UINT32_MAX, UINT32_MAX, UINT32_MAX}, high[3] = {0}, side = 0;
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t p[3];
        svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
        for (int k = 0; k < 3; k++) {
            low[k] = p[k] < low[k] ? p[k] : low[k];
            high[k] = p[k] + 1 > high[k] ? p[k] + 1 : high[k];
        }
    }
    for (int k = 0; k < 3; k++) side = high[k] - low[k] > side ? high[k] - low[k] : side;
    double cell = 1.0 / side; /* in units, about */
    if (cell > omega / 2 && c->level < depth)
        return svo_fail(err, SVO_LIMIT, "omega %g needs voxels of level %u and finer, which is beyond the limit of %d levels; choose at least %.3g", omega,
                        c->level + 1, MAX_LEVEL, 2 * cell);
    uint32_t level = c->level;
    while (level > 0 && 2 * cell <= (c->channel != SVO_NONE ? omega / 4 : omega / 2)) {
        cell *= 2;
        level--;
    }
    coarsen(c, level);
    return SVO_OK;
}

/* --- map ---------------------------------------------------------------------------------------------------------- */

static uint32_t nearest_joint(const skel_skeleton *s, const double *centre, const uint32_t *among, uint32_t count)
{
    uint32_t best = SVO_NONE;
    double best2 = INFINITY;
    for (uint32_t k = 0; k < count; k++) {
        uint32_t j = among != NULL ? among[k] : k;
        double d2 = 0;
        for (int e = 0; e < 3; e++) d2 += (s->joints[j].position[e] - centre[e]) * (s->joints[j].position[e] - centre[e]);
        if (d2 < best2 || (d2 == best2 && j < best)) {
            best2 = d2;
            best = j;
        }
    }
    return best;
}

/* Joint of each cell: the nearest of those its corners on the boundary are mapped to. Cells without such a corner take that of the cells
 * they touch, from outside inwards; what touches none, the nearest joint. */
static svo_result map_cells(skeli_pool *pool, const cells *c, const bits *grid, const boundary *b, const double *to_world, const skel_skeleton *s, uint32_t *joint,
                            svo_error *err)
{
    uint32_t *queue = skeli_take(pool, c->count, sizeof *queue);
    if (queue == NULL) return skeli_no_memory(err);
    uint64_t head = 0, tail = 0;
    double scale = ldexp(1, (int)c->shift);
    for (int pass = 0; pass < 2; pass++) {
        for (uint64_t i = 0; i < c->count; i++) {
            if (pass == 1 && joint[i] != SVO_NONE) continue;
            uint32_t p[3], among[24], points = 0, n = 0;
            svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
            double centre[3];
            for (int e = 0; e < 3; e++)
                centre[e] = (to_world[4 * e] * (p[0] + 0.5) + to_world[4 * e + 1] * (p[1] + 0.5) + to_world[4 * e + 2] * (p[2] + 0.5)) * scale + to_world[4 * e + 3];
            if (pass == 0) points = skeli_voxels_points(c, grid, b, p, among);
            for (uint32_t k = 0; k < points; k++)
                if (s->map[among[k]] != SVO_NONE) among[n++] = s->map[among[k]];
            joint[i] = pass == 1 ? nearest_joint(s, centre, NULL, s->joint_count) : n > 0 ? nearest_joint(s, centre, among, n) : SVO_NONE;
            if (joint[i] != SVO_NONE && pass == 0) queue[tail++] = (uint32_t)i;
        }
        while (pass == 0 && head < tail) {
            uint64_t i = queue[head++];
            uint32_t p[3];
            svo_morton_decode(codes(c)[i], &p[0], &p[1], &p[2]);
            for (int side = 0; side < 6; side++) {
                uint32_t x = p[0] + side_step[side][0], y = p[1] + side_step[side][1], z = p[2] + side_step[side][2], n = b->corner.side - 1;
                if (x >= n || y >= n || z >= n) continue;
                uint64_t k = find_cell(c, (uint32_t)svo_morton_encode(x, y, z));
                if (k == UINT64_MAX || joint[k] != SVO_NONE) continue;
                joint[k] = joint[i];
                queue[tail++] = (uint32_t)k;
            }
        }
    }
    return SVO_OK;
}

static svo_result map_voxels(skeli_pool *pool, const cells *c, const bits *grid, const boundary *b, const double *to_world, skel_skeleton *s, svo_error *err)
{
    uint32_t *joint = skeli_take(pool, c->count, sizeof *joint);
    uint32_t *map = svo_alloc(s->allocator, c->total, sizeof *map);
    svo_result result = joint == NULL || map == NULL ? skeli_no_memory(err) : map_cells(pool, c, grid, b, to_world, s, joint, err);
    if (result != SVO_OK) {
        svo_free(s->allocator, map, c->total, sizeof *map);
        return result;
    }
    uint64_t n = 0;
    for (uint64_t i = 0; i < c->count; i++)
        for (uint32_t k = 0; k < counts(c)[i]; k++) map[n++] = joint[i];
    SVO_ASSERT(n == c->total);
    svo_free(s->allocator, s->map, s->map_count, sizeof *s->map);
    s->map = map;
    s->map_count = s->report.input_count = s->report.mapped_count = c->total;
    return SVO_OK;
}

/* --- all ---------------------------------------------------------------------------------------------------------- */

static svo_result build(skeli_pool *pool, const svo_tree_info *info, cells *c, const skel_options *o, skel_skeleton *out, svo_error *err)
{
    double since = svo_seconds();
    SVO_TRY(choose_level(c, o->omega, info->depth, err));
    bits grid;
    boundary edge = {0};
    SVO_TRY(skeli_voxels_boundary(pool, c, info->voxel_to_world, o->max_vertices != 0 ? o->max_vertices : 8000000, &grid, &edge, err));
    skel_skeleton s;
    double boundary_seconds = svo_seconds() - since;
    SVO_TRY(skeli_pipeline(edge.position, edge.points, edge.triangle, edge.triangles, o, &s, err));
    s.report.source = SKEL_SOURCE_VOXELS;
    s.report.voxel_level = c->level;
    if (s.report.phase_count < SKEL_MAX_PHASES) s.report.phases[s.report.phase_count++] = (skel_phase){"boundary", boundary_seconds};
    s.report.voxel_depth = info->depth;
    svo_result result = map_voxels(pool, c, &grid, &edge, info->voxel_to_world, &s, err);
    if (result != SVO_OK) {
        skel_skeleton_free(&s);
        return result;
    }
    *out = s;
    return SVO_OK;
}

svo_result skel_build_voxels(const svo_tree_info *info, const svo_chunk_source *source, const skel_options *options, skel_skeleton *out, svo_error *err)
{
    SVO_TRY(skeli_check_options(options, err));
    cells c = {.allocator = options->allocator};
    c.level = info->depth < MAX_LEVEL ? info->depth : MAX_LEVEL;
    c.shift = info->depth - c.level;
    svo_buffer_init(&c.code, options->allocator);
    svo_buffer_init(&c.voxels, options->allocator);
    svo_buffer_init(&c.normal, options->allocator);
    c.channel = SVO_NONE;
    for (uint32_t k = 0; k < info->channel_count; k++)
        if (info->channels[k].kind == SVO_KIND_NORMAL_OCT32 && !info->channels[k].constant && strcmp(info->channels[k].name, "normal") == 0) c.channel = k;
    skeli_pool pool = {.allocator = options->allocator};
    svo_result result = read_cells(source, &c, err);
    if (result == SVO_OK) result = build(&pool, info, &c, options, out, err);
    skeli_pool_free(&pool);
    svo_buffer_free(&c.code);
    svo_buffer_free(&c.voxels);
    svo_buffer_free(&c.normal);
    return result;
}
