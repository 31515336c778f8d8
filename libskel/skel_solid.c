/* Solid voxels from the contraction. The surface moves continuously from where it is to the curve, so it passes every point inside; drawing its triangles in steps of
 * less than half a voxel leaves no voxel out. No grid is held: the voxels are a set of codes. */
#include "skel_solid.h"

#include <math.h>
#include <string.h>

#include "skeli_solid.h"
#include "svo_morton.h"

#define STEP 0.45  /* of a voxel: samples of triangles and movements are nearer to each other than that */
#define DRAW_AT 0.25 /* of a voxel: movement that waits */
enum { MOST_VOXELS = 1 << 27, MOST_DEPTH = 12 };

svo_result skeli_solid_begin(const svo_allocator *a, const skeli_soup *mesh, double omega, uint32_t divide, skeli_solid *s, svo_error *err)
{
    memset(s, 0, sizeof *s);
    s->allocator = a;
    s->mesh = mesh;
    s->edge = omega / divide;
    while (s->depth <= MOST_DEPTH && ldexp(s->edge, (int)s->depth) < 1.2 * SKEL_LATTICE + 4 * s->edge) s->depth++;
    if (s->depth > MOST_DEPTH)
        return svo_fail(err, SVO_LIMIT, "voxels of 1/%u of omega need an octree deeper than %d; choose larger ones", divide, MOST_DEPTH);
    s->capacity = 1 << 16;
    s->slot = svo_alloc(a, s->capacity, sizeof *s->slot);
    s->last = svo_alloc(a, 3 * (uint64_t)mesh->vertex_count, sizeof *s->last);
    s->moves = svo_alloc(a, mesh->vertex_count, 1);
    s->seen = svo_calloc(a, SKELI_SOLID_SEEN, sizeof *s->seen);
    if (s->slot == NULL || s->moves == NULL || s->seen == NULL || s->last == NULL) return skeli_no_memory(err);
    memset(s->slot, 0xff, s->capacity * sizeof *s->slot);
    for (uint64_t i = 0; i < 3 * (uint64_t)mesh->vertex_count; i++) s->last[i] = (float)mesh->position[i];
    return SVO_OK;
}

void skeli_solid_free(skeli_solid *s)
{
    if (s->mesh != NULL) {
        svo_free(s->allocator, s->last, 3 * (uint64_t)s->mesh->vertex_count, sizeof *s->last);
        svo_free(s->allocator, s->moves, s->mesh->vertex_count, 1);
    }
    svo_free(s->allocator, s->seen, SKELI_SOLID_SEEN, sizeof *s->seen);
    svo_free(s->allocator, s->slot, s->capacity, sizeof *s->slot);
    memset(s, 0, sizeof *s);
}

static uint64_t find(const uint64_t *slot, uint64_t capacity, uint64_t code)
{
    uint64_t h = code * 0x9e3779b97f4a7c15u, i = (h ^ h >> 32) & (capacity - 1);
    while (slot[i] != UINT64_MAX && slot[i] != code) i = (i + 1) & (capacity - 1);
    return i;
}

static svo_result add(skeli_solid *s, uint64_t code, bool *fresh, svo_error *err)
{
    uint64_t i = find(s->slot, s->capacity, code);
    *fresh = s->slot[i] == UINT64_MAX;
    if (!*fresh) return SVO_OK;
    s->slot[i] = code;
    if (++s->count > MOST_VOXELS) return svo_fail(err, SVO_LIMIT, "the solid has more than %d voxels; choose larger ones", MOST_VOXELS);
    if (2 * s->count <= s->capacity) return SVO_OK;
    uint64_t *more = svo_alloc(s->allocator, 2 * s->capacity, sizeof *more);
    if (more == NULL) return skeli_no_memory(err);
    memset(more, 0xff, 2 * s->capacity * sizeof *more);
    for (uint64_t k = 0; k < s->capacity; k++)
        if (s->slot[k] != UINT64_MAX) more[find(more, 2 * s->capacity, s->slot[k])] = s->slot[k];
    svo_free(s->allocator, s->slot, s->capacity, sizeof *s->slot);
    s->slot = more;
    s->capacity *= 2;
    return SVO_OK;
}

static uint64_t code_at(const skeli_solid *s, const double *p)
{
    uint32_t c[3];
    const double half = (double)(1u << (s->depth - 1));
    for (int k = 0; k < 3; k++) {
        double x = floor(p[k] / s->edge + half); /* the model is within 0.6 units of the middle */
        c[k] = x < 0 ? 0 : x < 2 * half ? (uint32_t)x : (uint32_t)(2 * half) - 1;
    }
    return svo_morton_encode(c[0], c[1], c[2]);
}

static svo_result draw(skeli_solid *s, double t[3][3], uint64_t *before, svo_error *err)
{
    double longest = 0;
    for (int e = 0; e < 3; e++) {
        double d2 = 0;
        for (int k = 0; k < 3; k++) d2 += (t[e][k] - t[(e + 1) % 3][k]) * (t[e][k] - t[(e + 1) % 3][k]);
        longest = fmax(longest, d2);
    }
    uint32_t n = (uint32_t)ceil(sqrt(longest) / (STEP * s->edge)) + 1;
    for (uint32_t i = 0; i <= n; i++)
        for (uint32_t j = 0; i + j <= n; j++) {
            double p[3], a = (double)i / n, b = (double)j / n;
            for (int k = 0; k < 3; k++) p[k] = t[0][k] + a * (t[1][k] - t[0][k]) + b * (t[2][k] - t[0][k]);
            uint64_t code = code_at(s, p);
            bool fresh;
            if (code == *before) continue;
            *before = code;
            SVO_TRY(add(s, code, &fresh, err));
        }
    return SVO_OK;
}

/* Many triangles of the mesh become the same triangle of the welded one, and a vertex that moves to and fro takes the same ways again: what was drawn lately is
 * known by a hash of where it began and ended, in the order of the live vertices. */
static bool drawn_before(skeli_solid *s, const skeli_state *state, const uint32_t c[3], double from[3][3], double to[3][3])
{
    int order[3] = {0, 1, 2};
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < 2; i++)
            if (state->live[c[order[i]]] > state->live[c[order[i + 1]]]) {
                int x = order[i];
                order[i] = order[i + 1];
                order[i + 1] = x;
            }
    uint64_t h = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            uint64_t a = (uint64_t)(int64_t)from[order[i]][k], b = (uint64_t)(int64_t)to[order[i]][k];
            h = (h ^ (a << 32 ^ b)) * 0x9e3779b97f4a7c15u;
            h ^= h >> 29;
        }
    uint64_t *at = &s->seen[h >> 48];
    if (*at == h) return true;
    *at = h;
    return false;
}

/* Vertices that are `least` from where they were drawn move there; triangles with one of them are drawn on the way. Others stay where they were drawn, so
 * that neighbours share their edges at every step, and what only trembles costs nothing. */
static svo_result draw_moved(skeli_solid *s, const skeli_state *state, double least, svo_error *err)
{
    uint64_t before = UINT64_MAX;
    for (uint64_t v = 0; v < s->mesh->vertex_count; v++) {
        double d2 = 0;
        for (uint64_t k = 0; k < 3; k++) {
            double d = state->position[3 * (uint64_t)state->live[v] + k] - s->last[3 * v + k];
            d2 += d * d;
        }
        s->moves[v] = d2 > least * least;
    }
    for (uint64_t f = 0; f < s->mesh->triangle_count; f++) {
        const uint32_t *c = s->mesh->corner + 3 * f;
        double from[3][3], to[3][3], way = 0;
        if (!s->moves[c[0]] && !s->moves[c[1]] && !s->moves[c[2]]) continue;
        for (int i = 0; i < 3; i++) {
            double d2 = 0;
            for (int k = 0; k < 3; k++) {
                from[i][k] = s->last[3 * (uint64_t)c[i] + (uint64_t)k];
                to[i][k] = s->moves[c[i]] ? state->position[3 * (uint64_t)state->live[c[i]] + (uint64_t)k] : from[i][k];
                d2 += (to[i][k] - from[i][k]) * (to[i][k] - from[i][k]);
            }
            way = fmax(way, d2);
        }
        bool point = c[0] != c[1]; /* a triangle that was a point and is one: those around it pass the same way */
        for (int i = 1; i < 3; i++) point = point && memcmp(from[0], from[i], sizeof from[0]) == 0 && memcmp(to[0], to[i], sizeof to[0]) == 0;
        if (point || drawn_before(s, state, c, from, to)) continue;
        uint32_t n = (uint32_t)ceil(sqrt(way) / (STEP * s->edge));
        for (uint32_t i = 1; i <= n; i++) {
            double t[3][3];
            for (int e = 0; e < 3; e++)
                for (int k = 0; k < 3; k++) t[e][k] = from[e][k] + (to[e][k] - from[e][k]) * i / n;
            SVO_TRY(draw(s, t, &before, err));
        }
    }
    for (uint64_t v = 0; v < s->mesh->vertex_count; v++)
        for (uint64_t k = 0; k < 3; k++)
            if (s->moves[v]) s->last[3 * v + k] = (float)state->position[3 * (uint64_t)state->live[v] + k];
    return SVO_OK;
}

svo_result skeli_solid_step(skeli_solid *s, const skeli_state *state, double movement, bool all, svo_error *err)
{
    if (s->count == 0) { /* the surface as it is */
        uint64_t before = UINT64_MAX;
        for (uint64_t f = 0; f < s->mesh->triangle_count; f++) {
            double t[3][3];
            for (uint64_t i = 0; i < 3; i++)
                for (uint64_t k = 0; k < 3; k++) t[i][k] = s->mesh->position[3 * (uint64_t)s->mesh->corner[3 * f + i] + k];
            SVO_TRY(draw(s, t, &before, err));
        }
    }
    s->moved += movement;
    if (!all && s->moved < DRAW_AT * s->edge) return SVO_OK;
    s->moved = 0;
    return draw_moved(s, state, all ? DRAW_AT * s->edge / 16 : DRAW_AT * s->edge, err);
}

/* --- what the surface did not pass -------------------------------------------------------------------------------- */

static svo_result fill(skeli_solid *s, const skeli_surface *surface, uint64_t *queue, uint64_t room, svo_error *err)
{
    const double half = ldexp(1, (int)s->depth - 1);
    const uint32_t side = 1u << s->depth;
    uint64_t tail = 0;
    for (uint64_t k = 0; k < s->capacity; k++)
        if (s->slot[k] != UINT64_MAX) queue[tail++] = s->slot[k];
    /* a set of codes is only as ordered as its slots, but what is reached does not depend on the order */
    while (tail > 0) {
        uint32_t at[3];
        svo_morton_decode(queue[--tail], &at[0], &at[1], &at[2]);
        for (int n = 0; n < 6; n++) {
            uint32_t to[3] = {at[0], at[1], at[2]};
            to[n / 2] += n % 2 ? 1 : UINT32_MAX;
            if (to[n / 2] >= side) continue;
            uint64_t code = svo_morton_encode(to[0], to[1], to[2]);
            if (s->slot[find(s->slot, s->capacity, code)] != UINT64_MAX) continue;
            double p[3];
            for (int k = 0; k < 3; k++) p[k] = (to[k] + 0.5 - half) * s->edge;
            if (!skeli_surface_inside(surface, p)) continue;
            bool fresh;
            SVO_TRY(add(s, code, &fresh, err));
            if (tail == room) return svo_fail(err, SVO_LIMIT, "the solid grew beyond its room while holes were closed");
            queue[tail++] = code;
        }
    }
    return SVO_OK;
}

static void sort_codes(uint64_t *codes, uint64_t *scratch, uint64_t count, uint32_t bits)
{
    for (uint32_t shift = 0; shift < bits; shift += 8) {
        uint64_t start[257] = {0};
        for (uint64_t i = 0; i < count; i++) start[(codes[i] >> shift & 255) + 1]++;
        for (int b = 0; b < 256; b++) start[b + 1] += start[b];
        for (uint64_t i = 0; i < count; i++) scratch[start[codes[i] >> shift & 255]++] = codes[i];
        memcpy(codes, scratch, count * sizeof *codes);
    }
}

svo_result skeli_solid_end(skeli_solid *s, const skeli_surface *surface, skel_skeleton *out, svo_error *err)
{
    skel_solid *o = &out->solid;
    const skel_report *r = &out->report;
    o->swept = s->count;
    uint64_t room = 8 * s->count + 4096; /* a stack: every voxel once, at most six pushes before one is popped; checked */
    uint64_t *queue = svo_alloc(s->allocator, room, sizeof *queue);
    if (queue == NULL) return skeli_no_memory(err);
    svo_result result = fill(s, surface, queue, room, err);
    svo_free(s->allocator, queue, room, sizeof *queue);
    SVO_TRY(result);
    o->filled = s->count - o->swept;
    o->depth = s->depth;
    o->codes = svo_alloc(out->allocator, s->count, sizeof *o->codes);
    uint64_t *scratch = svo_alloc(s->allocator, s->count, sizeof *scratch);
    if (o->codes == NULL || scratch == NULL) {
        svo_free(s->allocator, scratch, s->count, sizeof *scratch);
        svo_free(out->allocator, o->codes, s->count, sizeof *o->codes);
        o->codes = NULL;
        return skeli_no_memory(err);
    }
    for (uint64_t k = 0; k < s->capacity; k++)
        if (s->slot[k] != UINT64_MAX) o->codes[o->count++] = s->slot[k];
    sort_codes(o->codes, scratch, o->count, 3 * s->depth);
    svo_free(s->allocator, scratch, s->count, sizeof *scratch);
    double edge = s->edge / SKEL_LATTICE * r->unit, half = ldexp(edge, (int)s->depth - 1);
    for (int i = 0; i < 3; i++) {
        o->voxel_to_world[5 * i] = edge;
        o->voxel_to_world[4 * i + 3] = r->centre[i] - half;
    }
    o->voxel_to_world[15] = 1;
    return SVO_OK;
}

/* --- octree ------------------------------------------------------------------------------------------------------- */

svo_result skel_solid_info(const skel_skeleton *s, svo_tree_info *out, svo_error *err)
{
    if (s->solid.count == 0) return svo_fail(err, SVO_INVALID_ARGUMENT, "the skeleton was built without a solid");
    memset(out, 0, sizeof *out);
    out->depth = s->solid.depth;
    out->surface = SVO_SURFACE_THIN;
    out->fill = SVO_FILL_SOLID;
    memcpy(out->voxel_to_world, s->solid.voxel_to_world, sizeof out->voxel_to_world);
    return SVO_OK;
}

/* Masks of the node at `level` (its root: `top`) with codes[begin .. end); adds to *values. Depth is at most 12. */
static svo_result node(const uint64_t *codes, uint64_t begin, uint64_t end, uint32_t level, uint32_t depth, bool top, svo_buffer *masks, uint64_t *values, svo_error *err)
{
    uint64_t at = masks->size;
    if (!svo_buffer_append(masks, NULL, 1)) return skeli_no_memory(err);
    if (!top && end - begin == (uint64_t)1 << 3 * (depth - level)) { /* full leaf: mask 0 */
        (*values)++;
        return SVO_OK;
    }
    uint32_t shift = 3 * (depth - level - 1);
    uint8_t mask = 0;
    while (begin < end) {
        uint64_t child = codes[begin] >> shift, stop = begin;
        while (stop < end && codes[stop] >> shift == child) stop++;
        mask |= (uint8_t)(1u << (child & 7));
        if (level + 1 == depth) (*values)++;
        else SVO_TRY(node(codes, begin, stop, level + 1, depth, false, masks, values, err));
        begin = stop;
    }
    masks->data[at] = mask;
    return SVO_OK;
}

svo_result skel_solid_stream(const skel_skeleton *s, const svo_chunk_sink *sink, const svo_allocator *a, svo_tree_counts *counts, svo_error *err)
{
    const skel_solid *o = &s->solid;
    svo_tree_info info;
    SVO_TRY(skel_solid_info(s, &info, err));
    uint32_t level = svo_chunk_level(o->depth);
    svo_tree_counts ignored;
    if (counts == NULL) counts = &ignored;
    memset(counts, 0, sizeof *counts);
    svo_buffer masks;
    svo_buffer_init(&masks, a);
    svo_result result = SVO_OK;
    uint64_t begin = 0, previous = 0;
    while (begin < o->count && result == SVO_OK) {
        uint64_t code = o->codes[begin] >> 3 * (o->depth - level), end = begin, values = 0;
        while (end < o->count && o->codes[end] >> 3 * (o->depth - level) == code) end++;
        masks.size = 0;
        result = node(o->codes, begin, end, level, o->depth, true, &masks, &values, err);
        svo_chunk chunk = {.code = code, .level = level, .depth = o->depth, .node_count = masks.size, .value_count = values, .masks = masks.data};
        void *blob = NULL;
        svo_counts_ancestors(counts, level, level, begin > 0, previous, code);
        if (result == SVO_OK) result = svo_chunk_check(&info, &chunk, counts, err);
        if (result == SVO_OK) result = sink->encode(sink->user, &chunk, 0, &blob, err);
        if (result == SVO_OK) result = sink->commit(sink->user, blob, err);
        previous = code;
        begin = end;
    }
    svo_buffer_free(&masks);
    return result;
}
