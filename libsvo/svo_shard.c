#include "svo_shard.h"

#include <math.h>
#include <string.h>

#include "svo_bin.h"
#include "svo_morton.h"
#include "svo_raster.h"
#include "svo_soup.h"

/* Cost of a triangle in a node, in voxels: measured, a triangle much smaller than a voxel takes as long as about 8 voxels. */
enum { TRIANGLE_COST = 8, UNITS = 16 /* parts of a voxel that work is counted in */, NODES_PER_SHARD = 16, MAX_CORNERS = 9, MOST_STREAM_LEVEL = 7 };

typedef struct weight {
    uint64_t code, work;
} weight;

/* Keep the part of a polygon on one side of a plane across an axis; returns its corners, at most one more than before. */
static uint32_t clip(double (*from)[3], uint32_t count, int axis, double plane, bool above, double (*to)[3])
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < count; i++) {
        const double *p = from[i], *q = from[i + 1 < count ? i + 1 : 0];
        double dp = above ? p[axis] - plane : plane - p[axis], dq = above ? q[axis] - plane : plane - q[axis];
        if (dp >= 0) memcpy(to[n++], p, sizeof to[0]);
        if ((dp > 0 && dq < 0) || (dp < 0 && dq > 0)) {
            double t = dp / (dp - dq);
            for (int k = 0; k < 3; k++) to[n][k] = p[k] + t * (q[k] - p[k]);
            n++;
        }
    }
    return n;
}

/* Work of one triangle inside a cube (low corner and size in lattice units of 1/256 voxel). */
static uint64_t triangle_work(const svo_record *record, const int32_t corner[3], int32_t size)
{
    double a[MAX_CORNERS + 1][3], b[MAX_CORNERS + 1][3];
    double(*polygon)[3] = a, (*other)[3] = b;
    uint32_t count = 3;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) a[i][k] = ((double)record->q[i][k] - corner[k]) / 256;
    const double high = size / 256.0;
    for (int k = 0; k < 3; k++)
        for (int side = 0; side < 2 && count != 0; side++) {
            double plane = side == 0 ? 0 : high;
            bool cut = false;
            for (uint32_t i = 0; i < count; i++) cut |= side == 0 ? polygon[i][k] < 0 : polygon[i][k] > high;
            if (!cut) continue;
            count = clip(polygon, count, k, plane, side == 0, other);
            double(*swap)[3] = polygon;
            polygon = other;
            other = swap;
        }
    double area[3] = {0};
    for (uint32_t i = 2; i < count; i++)
        for (int k = 0; k < 3; k++) {
            int u = (k + 1) % 3, v = (k + 2) % 3;
            area[k] += (polygon[i - 1][u] - polygon[0][u]) * (polygon[i][v] - polygon[0][v]) -
                       (polygon[i - 1][v] - polygon[0][v]) * (polygon[i][u] - polygon[0][u]);
        }
    /* A plane with unit normal n meets |nx| + |ny| + |nz| voxels a unit of area. */
    double voxels = (fabs(area[0]) + fabs(area[1]) + fabs(area[2])) / 2;
    return (uint64_t)(voxels * UNITS + 0.5) + TRIANGLE_COST * UNITS;
}

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to plan the shards"); }

/* weight[] of the non-empty nodes of a level, in order. */
static svo_result weigh(svo_bins *bins, const svo_grid *grid, uint32_t level, svo_buffer *list, svo_buffer *weights, svo_error *err)
{
    int32_t size = (int32_t)1 << (grid->depth + 8 - level);
    for (;;) {
        weight w = {0};
        bool more = false;
        SVO_TRY(svo_bins_next(bins, &w.code, list, &more, err));
        if (!more) return SVO_OK;
        uint32_t x, y, z;
        svo_morton_decode(w.code, &x, &y, &z);
        int32_t corner[3] = {(int32_t)x * size, (int32_t)y * size, (int32_t)z * size};
        const uint32_t *triangles = (const uint32_t *)(const void *)list->data;
        for (uint64_t i = 0; i < list->size / 4; i++) {
            svo_record record;
            svo_bins_record(bins, triangles[i], &record);
            w.work += triangle_work(&record, corner, size);
        }
        if (svo_buffer_append(weights, &w, sizeof w) == NULL) return no_memory(err);
    }
}

/* --- the same for triangles outside of memory --- */

typedef struct stream {
    const svo_grid *grid;
    const svo_mat4 *transform;
    uint32_t level;
    uint64_t *work; /* of all nodes of the level */
} stream;

/* Add the work of a triangle to all nodes that it is handed to, as svo_bins_next hands it down. */
static void weigh_triangle(stream *s, const svo_vec3 v[3])
{
    svo_record record;
    double zero = 0; /* NaN where something is not finite */
    for (int k = 0; k < 3; k++) zero += v[k].x * 0 + v[k].y * 0 + v[k].z * 0;
    if (!(zero == 0)) return;
    for (int k = 0; k < 3; k++) svo_grid_snap(s->grid, v[k], record.q[k]);
    int32_t low[3], high[3];
    svo_raster_bounds((const int32_t(*)[3])record.q, low, high);
    struct { uint64_t code; uint32_t level; } stack[8 * (SVO_MAX_DEPTH + 1)];
    uint32_t top = 0;
    stack[top].code = 0;
    stack[top++].level = 0;
    while (top != 0) {
        const uint64_t code = stack[--top].code;
        const uint32_t level = stack[top].level;
        uint32_t x, y, z;
        svo_morton_decode(code, &x, &y, &z);
        const int32_t size = (int32_t)1 << (s->grid->depth + 8 - level), corner[3] = {(int32_t)x * size, (int32_t)y * size, (int32_t)z * size};
        if (level == s->level) {
            s->work[code] += triangle_work(&record, corner, size);
            continue;
        }
        const uint8_t mask = svo_raster_octants((const int32_t(*)[3])record.q, low, high, corner, size / 2);
        for (uint32_t i = 0; i < 8; i++) {
            if (!(mask >> i & 1)) continue;
            stack[top].code = code * 8 + i;
            stack[top++].level = level + 1;
        }
    }
}

static void weigh_corners(void *user, const double c[9])
{
    stream *s = user;
    svo_vec3 v[3];
    for (int k = 0; k < 3; k++) v[k] = svo_mat4_point(s->transform, svo_v3(c[3 * k], c[3 * k + 1], c[3 * k + 2]));
    weigh_triangle(s, v);
}

static svo_result weigh_stream(const svo_placement *p, const svo_grid *grid, uint32_t level, const svo_allocator *a, svo_buffer *weights, svo_error *err)
{
    if (level > MOST_STREAM_LEVEL)
        return svo_fail(err, SVO_LIMIT, "a mesh that is larger than memory can be cut into at most %u shards; allow more (--memory)", ((1u << 2 * MOST_STREAM_LEVEL) / NODES_PER_SHARD));
    const uint64_t nodes = (uint64_t)1 << 3 * level;
    stream s = {.grid = grid, .level = level, .work = svo_calloc(a, nodes, sizeof *s.work)};
    svo_result r = s.work != NULL ? SVO_OK : no_memory(err);
    for (uint64_t g = 0; r == SVO_OK && g < p->group_count; g++) {
        const svo_part *part = p->groups[g].part;
        s.transform = &p->mesh->instances[p->groups[g].instance].transform;
        if (part->soup != NULL) {
            r = svo_soup_triangles(part->soup, 0, part->soup->pieces.size / sizeof(svo_soup_piece), weigh_corners, &s, err);
            continue;
        }
        for (uint64_t t = 0; t < part->triangle_count; t++) {
            svo_vec3 v[3];
            svo_placement_world(p, &p->groups[g], t, v);
            weigh_triangle(&s, (const svo_vec3 *)v);
        }
    }
    for (uint64_t i = 0; r == SVO_OK && i < nodes; i++) {
        const weight w = {i, s.work[i]};
        if (w.work != 0 && svo_buffer_append(weights, &w, sizeof w) == NULL) r = no_memory(err);
    }
    svo_free(a, s.work, nodes, sizeof *s.work);
    return r;
}

static bool is_spilled(const svo_mesh *mesh)
{
    for (uint32_t i = 0; i < mesh->shape_count; i++)
        for (uint32_t p = 0; p < mesh->shapes[i].part_count; p++)
            if (mesh->shapes[i].parts[p].soup != NULL) return true;
    return false;
}

/* --- the cut ------------------------------------------------------------------------------------------------------ */

/* Can nodes be cut into `count` ranges of at most `most` each? */
static bool fits(const weight *w, uint64_t nodes, uint32_t count, uint64_t most)
{
    uint64_t sum = 0;
    uint32_t used = 1;
    for (uint64_t i = 0; i < nodes; i++) {
        if (w[i].work > most) return false;
        if (w[i].work > most - sum) {
            if (used++ == count) return false;
            sum = 0;
        }
        sum += w[i].work;
    }
    return true;
}

/* The smallest work of the largest of `count` ranges. */
static uint64_t least_most(const weight *w, uint64_t nodes, uint32_t count)
{
    uint64_t low = 0, high = 0;
    for (uint64_t i = 0; i < nodes; i++) {
        if (w[i].work > low) low = w[i].work;
        high += w[i].work;
    }
    if (high / count > low) low = high / count;
    while (low < high) {
        const uint64_t middle = low + (high - low) / 2;
        if (fits(w, nodes, count, middle)) high = middle;
        else low = middle + 1;
    }
    return low;
}

/* Ranges of nodes for all shards, none with more work than the best cut needs, and each with a node while there are as many: each takes what is nearest to
 * its share of what is left, as far as the others can take the rest. Beyond the number of nodes shards are empty. */
static svo_result cut(const svo_buffer *weights, uint32_t level, uint32_t chunk_level, const svo_allocator *a, svo_shard *s, svo_error *err)
{
    const weight *w = (const weight *)(const void *)weights->data;
    const uint64_t nodes = weights->size / sizeof *w, last = (uint64_t)1 << 3 * chunk_level;
    const uint32_t shards = nodes < s->count ? (uint32_t)nodes : s->count;
    s->first_code = s->index == 1 ? 0 : last;
    s->end_code = last;
    s->share = 0;
    if (nodes == 0) return SVO_OK;
    uint64_t *least = svo_alloc(a, (uint64_t)shards + 1, sizeof *least); /* [k]: first node that the last k shards can take */
    if (least == NULL) return no_memory(err);
    const uint64_t most = least_most(w, nodes, shards);
    uint64_t total = 0;
    least[0] = nodes;
    for (uint32_t k = 1; k <= shards; k++) {
        uint64_t i = least[k - 1], sum = 0;
        while (i > 0 && w[i - 1].work <= most - sum) sum += w[--i].work;
        least[k] = i;
    }
    for (uint64_t i = 0; i < nodes; i++) total += w[i].work;
    uint64_t begin = 0, rest = total;
    for (uint32_t k = 0; k < shards; k++) {
        const uint32_t others = shards - k - 1;
        const uint64_t share = rest / (others + 1);
        uint64_t end = begin, sum = 0;
        while (end < nodes - others && w[end].work <= most - sum && (end == begin || end < least[others] || sum + w[end].work / 2 <= share)) sum += w[end++].work;
        if (k + 1 == s->index) {
            s->first_code = begin == 0 ? 0 : w[begin].code << 3 * (chunk_level - level);
            s->end_code = end == nodes ? last : w[end].code << 3 * (chunk_level - level);
            s->share = total != 0 ? (double)sum / (double)total : 0;
        }
        begin = end;
        rest -= sum;
    }
    SVO_ASSERT(begin == nodes);
    svo_free(a, least, (uint64_t)shards + 1, sizeof *least);
    return SVO_OK;
}

svo_result svo_shard_plan(const svo_mesh *mesh, const svo_voxelize_options *options, const svo_tree_info *info, uint32_t index,
                          uint32_t count, svo_shard *out, svo_error *err)
{
    if (count == 0 || count > SVO_MAX_SHARDS || index == 0 || index > count)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "there is no shard %u of %u", index, count);
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, options->memory != 0 ? options->memory : UINT64_MAX, options->allocator);
    svo_grid grid = {.size = info->voxel_to_world[0], .depth = info->depth};
    for (int i = 0; i < 3; i++) grid.origin[i] = info->voxel_to_world[4 * i + 3];
    /* A surface has about 4^level nodes: the coarsest level with enough of them. */
    uint32_t chunk_level = svo_chunk_level(info->depth), level = 0;
    while (level < chunk_level && (uint64_t)1 << 2 * level < (uint64_t)NODES_PER_SHARD * count) level++;
    svo_placement placement = {.mesh = mesh, .allocator = &limit.base};
    svo_buffer list, weights;
    svo_buffer_init(&list, &limit.base);
    svo_buffer_init(&weights, &limit.base);
    svo_result r = svo_placement_create(mesh, &limit.base, &placement, err);
    const uint64_t keep = options->memory == 0 ? UINT64_MAX : options->memory / 2;
    const bool spilled = is_spilled(mesh);
    while (r == SVO_OK) {
        weights.size = 0;
        if (spilled) {
            r = weigh_stream(&placement, &grid, level, &limit.base, &weights, err);
        } else {
            svo_bins *bins = NULL;
            svo_bins_report unused;
            r = svo_bins_create(&placement, &grid, level, keep, options->threads, &limit.base, &bins, &unused, err);
            if (r == SVO_OK) r = weigh(bins, &grid, level, &list, &weights, err);
            svo_bins_free(bins);
        }
        /* A surface that fills little of the grid has fewer nodes. Those that are outside of memory cannot be weighed deeper, so the others are only if some shard had none. */
        const uint64_t nodes = weights.size / sizeof(weight);
        if (r != SVO_OK || nodes == 0 || level >= chunk_level || nodes >= (uint64_t)(level < MOST_STREAM_LEVEL ? NODES_PER_SHARD / 2 : 1) * count) break;
        level++;
    }
    if (r == SVO_OK) {
        svo_shard s = {.index = index, .count = count};
        r = cut(&weights, level, chunk_level, &limit.base, &s, err);
        if (r == SVO_OK) *out = s;
    }
    svo_buffer_free(&list);
    svo_buffer_free(&weights);
    svo_placement_free(&placement);
    return r;
}
