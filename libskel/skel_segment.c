/* The surface in segments. */
#include "skel_segment.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "skeli_geometry.h"
#include "skeli_refine.h"
#include "skeli_segment.h"

typedef struct work {
    skeli_pool *pool;
    const skel_skeleton *s;
    skel_segments *out;
    skeli_spokes spokes;
    uint32_t *segment_of_bone, *segment_of_joint; /* of joints: those without bones alone */
    uint32_t *place;   /* of each vertex: the number of its place */
    uint64_t *edge;    /* of each side of a triangle: places of its ends, the lower one above */
    uint32_t *order;   /* sides (3 triangle + k) by edge */
    uint64_t sides;
    uint32_t *piece;   /* of each triangle: union-find, then the lowest triangle of its piece */
    uint32_t *last, *stamp; /* of each segment: the last triangle of it in the run of sides looked at */
} work;

/* --- segments of the curve --------------------------------------------------------------------------------------------- */

static uint32_t degree(const work *w, uint32_t joint) { return w->spokes.start[joint + 1] - w->spokes.start[joint]; }

static uint32_t beyond(const skel_skeleton *s, uint32_t bone, uint32_t joint) { return s->bones[bone].a == joint ? s->bones[bone].b : s->bones[bone].a; }

/* Follow the chain of `bone` from one of its joints to where it ends; give the bones to `number`. */
static uint32_t follow(work *w, uint32_t bone, uint32_t joint, uint32_t number, uint32_t *bones)
{
    for (uint32_t at = bone;;) {
        if (w->segment_of_bone[at] == SVO_NONE) {
            w->segment_of_bone[at] = number;
            ++*bones;
        }
        joint = beyond(w->s, at, joint);
        if (degree(w, joint) != 2) return joint;
        uint32_t k = w->spokes.start[joint];
        at = w->spokes.bone[k] != at ? w->spokes.bone[k] : w->spokes.bone[k + 1];
        if (at == bone) return joint; /* round a loop without a branch */
    }
}

static svo_result find_segments(work *w, svo_error *err)
{
    const skel_skeleton *s = w->s;
    skel_segments *out = w->out;
    uint64_t most = (uint64_t)s->bone_count + s->joint_count;
    w->segment_of_bone = skeli_take(w->pool, s->bone_count, sizeof *w->segment_of_bone);
    w->segment_of_joint = skeli_take(w->pool, s->joint_count, sizeof *w->segment_of_joint);
    skel_segment *list = skeli_take(w->pool, most, sizeof *list);
    if (w->segment_of_bone == NULL || w->segment_of_joint == NULL || list == NULL) return skeli_no_memory(err);
    memset(w->segment_of_bone, 0xff, s->bone_count * sizeof *w->segment_of_bone);
    memset(w->segment_of_joint, 0xff, s->joint_count * sizeof *w->segment_of_joint);
    memset(list, 0, most * sizeof *list);
    for (uint32_t b = 0; b < s->bone_count; b++) {
        if (w->segment_of_bone[b] != SVO_NONE) continue;
        skel_segment *g = &list[out->count];
        g->first = degree(w, s->bones[b].a) != 2 ? s->bones[b].a : follow(w, b, s->bones[b].b, out->count, &g->bones);
        g->last = follow(w, b, s->bones[b].a, out->count, &g->bones);
        out->count++;
    }
    for (uint32_t j = 0; j < s->joint_count; j++) {
        if (degree(w, j) != 0) continue;
        list[out->count].first = list[out->count].last = j;
        w->segment_of_joint[j] = out->count++;
    }
    out->segment = svo_alloc(out->allocator, out->count, sizeof *list);
    if (out->segment == NULL) return skeli_no_memory(err);
    memcpy(out->segment, list, out->count * sizeof *list);
    skeli_give(w->pool, list);
    return SVO_OK;
}

/* --- triangles --------------------------------------------------------------------------------------------------------- */

static void assign(work *w)
{
    const skel_skeleton *s = w->s;
    skel_segments *out = w->out;
    for (uint64_t t = 0; t < out->triangle_count; t++) {
        const uint32_t *c = out->corner + 3 * t;
        double at[3] = {0, 0, 0}, best = INFINITY, foot;
        out->segment_of[t] = out->bone_of[t] = SVO_NONE;
        bool whole = true;
        for (int k = 0; k < 3; k++) {
            whole &= s->map[c[k]] != SVO_NONE;
            for (int e = 0; e < 3; e++) at[e] += out->position[3 * (uint64_t)c[k] + (uint64_t)e] / 3;
        }
        for (int k = 0; k < 3 && whole; k++) {
            uint32_t j = s->map[c[k]];
            for (uint32_t i = w->spokes.start[j]; i < w->spokes.start[j + 1]; i++) {
                uint32_t b = w->spokes.bone[i];
                double d = skeli_segment_distance(at, s->joints[s->bones[b].a].position, s->joints[s->bones[b].b].position, &foot);
                if (!(d < best || (d == best && b < out->bone_of[t]) || out->segment_of[t] == SVO_NONE)) continue;
                best = d;
                out->bone_of[t] = b;
                out->segment_of[t] = w->segment_of_bone[b];
            }
            if (out->segment_of[t] == SVO_NONE) out->segment_of[t] = w->segment_of_joint[j];
        }
    }
}

/* Sides of triangles in order of their edges; vertices at one place are one. */
static svo_result find_edges(work *w, svo_error *err)
{
    const skel_segments *out = w->out;
    uint64_t n = out->vertex_count, sides = 3 * out->triangle_count, most = n > sides ? n : sides;
    if (sides >= SVO_NONE) return svo_fail(err, SVO_LIMIT, "segments take fewer than 2^32 / 3 triangles, not %llu", (unsigned long long)out->triangle_count);
    uint32_t *scratch = skeli_take(w->pool, most, sizeof *scratch), *order = skeli_take(w->pool, most, sizeof *order);
    uint64_t *key = skeli_take(w->pool, most, sizeof *key);
    w->place = skeli_take(w->pool, n, sizeof *w->place);
    w->piece = skeli_take(w->pool, out->triangle_count, sizeof *w->piece);
    w->last = skeli_take(w->pool, out->count, sizeof *w->last);
    w->stamp = skeli_take(w->pool, out->count, sizeof *w->stamp);
    if (scratch == NULL || order == NULL || key == NULL || w->place == NULL || w->piece == NULL || w->last == NULL || w->stamp == NULL) return skeli_no_memory(err);
    for (uint32_t v = 0; v < n; v++) order[v] = v;
    for (uint64_t axis = 0; axis < 3; axis++) {
        for (uint64_t v = 0; v < n; v++) {
            double x = out->position[3 * v + axis] + 0.0; /* -0 and 0 are one place */
            memcpy(&key[v], &x, sizeof x);
        }
        skeli_sort_by64(order, scratch, n, key, 64);
    }
    uint32_t places = 0;
    for (uint64_t i = 0; i < n; i++) {
        const double *a = out->position + 3 * (uint64_t)order[i], *b = i > 0 ? out->position + 3 * (uint64_t)order[i - 1] : a;
        places += i > 0 && !(a[0] == b[0] && a[1] == b[1] && a[2] == b[2]);
        w->place[order[i]] = places;
    }
    w->sides = 0;
    for (uint64_t t = 0; t < out->triangle_count; t++) {
        w->piece[t] = (uint32_t)t;
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t a = w->place[out->corner[3 * t + k]], b = w->place[out->corner[3 * t + (k + 1) % 3]];
            key[3 * t + k] = a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a;
            if (out->segment_of[t] != SVO_NONE && a != b) order[w->sides++] = (uint32_t)(3 * t + k);
        }
    }
    skeli_sort_by64(order, scratch, w->sides, key, 64);
    w->order = order;
    w->edge = key;
    skeli_give(w->pool, scratch);
    return SVO_OK;
}

/* Pieces: triangles of one segment that share edges. */
static void find_pieces(work *w)
{
    const skel_segments *out = w->out;
    for (uint64_t t = 0; t < out->triangle_count; t++) w->piece[t] = (uint32_t)t;
    memset(w->stamp, 0xff, out->count * sizeof *w->stamp);
    for (uint64_t i = 0, run = 0; i < w->sides; i++) {
        if (i > 0 && w->edge[w->order[i]] != w->edge[w->order[i - 1]]) run = i;
        uint32_t t = w->order[i] / 3, g = out->segment_of[t];
        if (w->stamp[g] == run) {
            uint32_t p = skeli_root(w->piece, t), q = skeli_root(w->piece, w->last[g]);
            w->piece[p > q ? p : q] = p > q ? q : p;
        }
        w->stamp[g] = (uint32_t)run;
        w->last[g] = t;
    }
    for (uint64_t t = 0; t < out->triangle_count; t++) w->piece[t] = skeli_root(w->piece, (uint32_t)t);
}

static double area_of(const skel_segments *out, uint64_t t)
{
    const uint32_t *c = out->corner + 3 * t;
    return skeli_area(out->position + 3 * (uint64_t)c[0], out->position + 3 * (uint64_t)c[1], out->position + 3 * (uint64_t)c[2]);
}

static double length_of(const skel_segments *out, uint32_t side)
{
    const double *a = out->position + 3 * (uint64_t)out->corner[side], *b = out->position + 3 * (uint64_t)out->corner[side - side % 3 + (side + 1) % 3];
    return skeli_apart_far(a, b);
}

/* Sums of area by piece, and each segment's piece of the largest one (the first of equal ones); pieces that are counted again get new sums. */
static void weigh(const work *w, double *area, uint32_t *largest)
{
    skel_segments *out = w->out;
    memset(area, 0, out->triangle_count * sizeof *area);
    for (uint32_t g = 0; g < out->count; g++) {
        largest[g] = SVO_NONE;
        out->segment[g].area = 0;
        out->segment[g].triangles = out->segment[g].pieces = 0;
    }
    for (uint64_t t = 0; t < out->triangle_count; t++) {
        if (out->segment_of[t] == SVO_NONE) continue;
        skel_segment *g = &out->segment[out->segment_of[t]];
        double x = area_of(out, t);
        area[w->piece[t]] += x;
        g->area += x;
        g->triangles++;
        g->pieces += w->piece[t] == t;
    }
    for (uint64_t t = 0; t < out->triangle_count; t++) {
        uint32_t g = out->segment_of[t];
        if (g != SVO_NONE && w->piece[t] == t && (largest[g] == SVO_NONE || area[t] > area[largest[g]])) largest[g] = (uint32_t)t;
    }
}

/* Islands go to the largest piece of another segment that they have the longest border with. True when some did. */
static bool move_islands(work *w, const uint32_t *largest, uint32_t *to, double *border, uint32_t *scratch, uint64_t *key, uint32_t *order)
{
    skel_segments *out = w->out;
    uint64_t n = 0;
    for (uint64_t i = 0, end; i < w->sides; i = end) { /* sides of islands at an edge that a largest piece has too: (piece, segment there) */
        uint32_t main[2] = {SVO_NONE, SVO_NONE}; /* segments with their largest pieces at this edge */
        for (end = i; end < w->sides && w->edge[w->order[end]] == w->edge[w->order[i]]; end++) {
            uint32_t t = w->order[end] / 3, g = out->segment_of[t];
            if (largest[g] != w->piece[t] || main[0] == g) continue;
            main[main[0] != SVO_NONE] = g;
        }
        for (uint64_t k = i; k < end; k++) {
            uint32_t side = w->order[k], t = side / 3, g = out->segment_of[t], found = main[0] != g ? main[0] : main[1];
            if (largest[g] == w->piece[t] || found == SVO_NONE) continue;
            key[side] = (uint64_t)w->piece[t] << 32 | found;
            order[n++] = side;
        }
    }
    if (n == 0) return false;
    skeli_sort_by64(order, scratch, n, key, 64);
    memset(to, 0xff, out->triangle_count * sizeof *to);
    for (uint64_t i = 0, end; i < n; i = end) {
        double sum = 0;
        for (end = i; end < n && key[order[end]] == key[order[i]]; end++) sum += length_of(out, order[end]);
        uint32_t piece = (uint32_t)(key[order[i]] >> 32);
        if (to[piece] != SVO_NONE && !(sum > border[piece])) continue;
        to[piece] = (uint32_t)key[order[i]];
        border[piece] = sum;
    }
    for (uint64_t t = 0; t < out->triangle_count; t++) {
        uint32_t p = w->piece[t];
        if (out->segment_of[t] == SVO_NONE || to[p] == SVO_NONE) continue;
        out->segment_of[t] = to[p];
        out->islands += p == t;
    }
    return true;
}

static svo_result connect(work *w, svo_error *err)
{
    skel_segments *out = w->out;
    uint64_t n = out->triangle_count;
    double *area = skeli_take(w->pool, n, sizeof *area), *border = skeli_take(w->pool, n, sizeof *border);
    uint32_t *largest = skeli_take(w->pool, out->count, sizeof *largest), *to = skeli_take(w->pool, n, sizeof *to);
    uint32_t *order = skeli_take(w->pool, 3 * n, sizeof *order), *scratch = skeli_take(w->pool, 3 * n, sizeof *scratch);
    uint64_t *key = skeli_take(w->pool, 3 * n, sizeof *key);
    if (area == NULL || border == NULL || largest == NULL || to == NULL || order == NULL || scratch == NULL || key == NULL) return skeli_no_memory(err);
    do { /* every round joins a piece to a larger one */
        find_pieces(w);
        weigh(w, area, largest);
    } while (move_islands(w, largest, to, border, scratch, key, order));
    return SVO_OK;
}

/* --- colours ----------------------------------------------------------------------------------------------------------- */

/* Far apart in hue and lightness; more than these are made by the golden angle. */
static const uint32_t palette[] = {0xe6194b, 0x3cb44b, 0x4363d8, 0xffe119, 0xf58231, 0x42d4f4, 0x911eb4, 0xbfef45, 0xf032e6, 0x469990, 0x9a6324, 0xfabed4};
enum { PALETTE = sizeof palette / sizeof *palette };

static uint32_t color_number(uint32_t i)
{
    if (i < PALETTE) return palette[i];
    uint32_t hue = (uint32_t)((uint64_t)(i - PALETTE) * 949 % 1536), ramp = hue % 256, rgb[3];
    const uint32_t up[6][3] = {{255, ramp, 0}, {255 - ramp, 255, 0}, {0, 255, ramp}, {0, 255 - ramp, 255}, {ramp, 0, 255}, {255, 0, 255 - ramp}};
    for (int k = 0; k < 3; k++) rgb[k] = 40 + up[hue / 256][k] * 150 / 255 + i / 1536 % 60;
    return rgb[0] << 16 | rgb[1] << 8 | rgb[2];
}

static int pair_less(const void *a, const void *b)
{
    const uint32_t *x = a, *y = b;
    return x[0] != y[0] ? (x[0] < y[0] ? -1 : 1) : x[1] != y[1] ? (x[1] < y[1] ? -1 : 1) : 0;
}

/* Segments that meet, the higher one first: at an edge of the surface (each with at most 16 before it, where more than two triangles share it), or at a joint. Counted
 * only where pair is NULL. */
static uint64_t meetings(const work *w, uint32_t *pair)
{
    uint64_t n = 0, run = 0;
    const skel_segments *out = w->out;
#define MEET(x, y) do { if (pair != NULL) (pair[2 * n] = (x) > (y) ? (x) : (y), pair[2 * n + 1] = (x) > (y) ? (y) : (x)); n++; } while (0)
    for (uint64_t i = 1; i < w->sides; i++) {
        if (w->edge[w->order[i]] != w->edge[w->order[i - 1]]) run = i;
        uint32_t a = out->segment_of[w->order[i] / 3];
        for (uint64_t k = i - run > 16 ? i - 16 : run; k < i; k++) {
            uint32_t b = out->segment_of[w->order[k] / 3];
            if (a != b) MEET(a, b);
        }
    }
    for (uint32_t j = 0; j < w->s->joint_count; j++)
        for (uint32_t k = w->spokes.start[j]; k < w->spokes.start[j + 1]; k++)
            for (uint32_t i = w->spokes.start[j]; i < k; i++) {
                uint32_t a = w->segment_of_bone[w->spokes.bone[k]], b = w->segment_of_bone[w->spokes.bone[i]];
                if (a != b) MEET(a, b);
            }
#undef MEET
    return n;
}

/* Of the palette from a segment's own place on, then of what lies beyond it: the first colour that no neighbour of lower number has. */
static svo_result paint(work *w, svo_error *err)
{
    skel_segments *out = w->out;
    uint64_t n = meetings(w, NULL);
    uint32_t *pair = skeli_take(w->pool, 2 * n, sizeof *pair), *color = skeli_take(w->pool, out->count, sizeof *color), *used = skeli_take(w->pool, (uint64_t)out->count + PALETTE + 1, sizeof *used);
    if (pair == NULL || color == NULL || used == NULL) return skeli_no_memory(err);
    meetings(w, pair);
    qsort(pair, n, 2 * sizeof *pair, pair_less);
    memset(used, 0xff, ((uint64_t)out->count + PALETTE + 1) * sizeof *used);
    uint64_t at = 0;
    for (uint32_t g = 0; g < out->count; g++) {
        for (; at < n && pair[2 * at] == g; at++) used[color[pair[2 * at + 1]]] = g;
        uint32_t tries = 0;
        for (; tries < PALETTE && used[(g + tries) % PALETTE] == g;) tries++;
        color[g] = tries < PALETTE ? (g + tries) % PALETTE : PALETTE;
        for (; used[color[g]] == g;) color[g]++;
        out->segment[g].color = color_number(color[g]);
        if (color[g] >= out->color_count) out->color_count = color[g] + 1;
    }
    return SVO_OK;
}

svo_result skeli_segments(const double *position, uint64_t points, const uint32_t *corner, uint64_t triangles, const skel_skeleton *s, const svo_allocator *a, skel_segments *out, svo_error *err)
{
    skeli_pool pool = {.allocator = a};
    skel_segments r = {.allocator = a, .vertex_count = points, .triangle_count = triangles};
    work w = {.pool = &pool, .s = s, .out = &r};
    r.position = svo_alloc(a, 3 * points, sizeof *r.position);
    r.corner = svo_alloc(a, 3 * triangles, sizeof *r.corner);
    r.segment_of = svo_alloc(a, triangles, sizeof *r.segment_of);
    r.bone_of = svo_alloc(a, triangles, sizeof *r.bone_of);
    svo_result result = r.position == NULL || r.corner == NULL || r.segment_of == NULL || r.bone_of == NULL ? skeli_no_memory(err) : SVO_OK;
    if (result == SVO_OK) {
        memcpy(r.position, position, 3 * points * sizeof *position);
        memcpy(r.corner, corner, 3 * triangles * sizeof *corner);
        result = skeli_spokes_make(&pool, s, &w.spokes, err);
    }
    if (result == SVO_OK) result = find_segments(&w, err);
    if (result == SVO_OK) {
        assign(&w);
        result = find_edges(&w, err);
    }
    if (result == SVO_OK) result = connect(&w, err);
    if (result == SVO_OK) result = paint(&w, err);
    skeli_pool_free(&pool);
    if (result == SVO_OK) *out = r;
    else skel_segments_free(&r);
    return result;
}

void skel_segments_free(skel_segments *s)
{
    svo_free(s->allocator, s->segment, s->count, sizeof *s->segment);
    svo_free(s->allocator, s->position, 3 * s->vertex_count, sizeof *s->position);
    svo_free(s->allocator, s->corner, 3 * s->triangle_count, sizeof *s->corner);
    svo_free(s->allocator, s->segment_of, s->triangle_count, sizeof *s->segment_of);
    svo_free(s->allocator, s->bone_of, s->triangle_count, sizeof *s->bone_of);
    memset(s, 0, sizeof *s);
}
