/* The ray caster against a search of all nodes, on rays of every nasty kind. */
#include "svo_raycast.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "nasty_rays.h"
#include "packer.h"
#include "svo_morton.h"
#include "test.h"

/* The rule of svo_raycast.h, restated without the kernel's shortcuts. */
typedef struct span { double enter, leave; } span;

static span node_span(const svo_ray *r, uint32_t depth, uint32_t level, const uint32_t cell[3])
{
    double size = ldexp(1, (int)(depth - level));
    span s = {-INFINITY, INFINITY};
    for (int k = 0; k < 3; k++) {
        double low = cell[k] * size, high = low + size, a, b;
        double inv = 1 / r->direction[k];
        if (!isfinite(inv)) {
            bool inside = floor(r->origin[k]) >= low && floor(r->origin[k]) < high;
            a = inside ? -INFINITY : INFINITY, b = inside ? INFINITY : -INFINITY;
        } else {
            double x = (low - r->origin[k]) * inv, y = (high - r->origin[k]) * inv;
            a = inv > 0 ? x : y, b = inv > 0 ? y : x;
        }
        s.enter = fmax(s.enter, a);
        s.leave = fmin(s.leave, b);
    }
    return s;
}

typedef struct world {
    uint32_t depth;
    uint64_t *codes, count; /* sorted, unique */
} world;

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

static void world_finish(world *w)
{
    qsort(w->codes, w->count, 8, compare_codes);
    uint64_t n = 0;
    for (uint64_t i = 0; i < w->count; i++)
        if (i == 0 || w->codes[i] != w->codes[i - 1]) w->codes[n++] = w->codes[i];
    w->count = n;
}

/* Nearest terminal node in codes [begin, end) of a node, and its number in depth-first order. */
static void search(const world *w, const svo_ray *r, bool lod, bool averaged, uint32_t level, uint64_t begin, uint64_t end, uint64_t number, svo_hit *best)
{
    uint32_t up = w->depth - level, cell[3];
    svo_morton_decode(w->codes[begin] >> 3 * up, &cell[0], &cell[1], &cell[2]);
    span s = node_span(r, w->depth, level, cell);
    double t = fmax(s.enter, r->t_min);
    bool met = s.enter < s.leave && t < s.leave && t <= r->t_max;
    if (met && (level == w->depth || (lod && ldexp(1, (int)up) <= r->spread * t + r->offset))) {
        if (!best->hit || t < best->t) {
            best->hit = true;
            best->t = t;
            best->level = (uint8_t)level;
            best->attribute = averaged && up <= 2 ? svo_average_of(number, (uint32_t)(end - begin)) : number;
            memcpy(best->cell, cell, sizeof cell);
        }
        return;
    }
    if (!met || level == w->depth) return;
    number += lod && (!averaged || up > 2);
    for (uint64_t i = begin; i < end;) {
        uint64_t prefix = w->codes[i] >> 3 * (up - 1), j = i + 1;
        while (j < end && w->codes[j] >> 3 * (up - 1) == prefix) j++;
        search(w, r, lod, averaged, level + 1, i, j, number, best);
        if (!lod) number += j - i;
        else
            /* nodes of the subtree: a new node on every level where the prefix changes */
            for (uint32_t l = level + 1; l <= w->depth; l++) {
                if (averaged && (w->depth - l == 1 || w->depth - l == 2)) continue;
                for (uint64_t k = i; k < j; k++)
                    number += k == i || w->codes[k] >> 3 * (w->depth - l) != w->codes[k - 1] >> 3 * (w->depth - l);
            }
        i = j;
    }
}

static svo_hit expected(const world *w, const svo_ray *r, bool lod, bool averaged)
{
    svo_hit best;
    memset(&best, 0, sizeof best);
    /* with lod the virtual levels of a small octree have attributes too */
    if (w->count != 0) search(w, r, lod, averaged, 0, 0, w->count, lod && !averaged && w->depth < 2 ? 2 - w->depth : 0, &best);
    return best;
}

static bool same_hit(const svo_hit *a, const svo_hit *b)
{
    if (a->hit != b->hit) return false;
    return !a->hit || (a->t == b->t && a->level == b->level && memcmp(a->cell, b->cell, sizeof a->cell) == 0 && a->attribute == b->attribute);
}

static void check_rays(const world *w, const svo_view *v, uint64_t seed, int count, bool cones)
{
    uint64_t hits = 0;
    for (int i = 0; i < count; i++) {
        svo_ray r = nasty_ray(&seed, w->depth, (uint32_t)i % KINDS);
        if (cones) {
            double n = ldexp(1, (int)w->depth);
            r.spread = i % 3 == 0 ? 0 : exp2(test_random_unit(&seed) * w->depth);
            r.offset = i % 5 != 0 ? 0 : n * test_random_unit(&seed) * test_random_unit(&seed);
        }
        svo_hit h, e = expected(w, &r, v->lod, v->averaged);
        svo_raycast(v, &r, 1, &h);
        hits += h.hit;
        CHECK_MSG(same_hit(&h, &e),
                  "ray %d o %a %a %a d %a %a %a t %a %a cone %g %g: hit %d t %a level %d at %u %u %u index %llu, expected %d t %a level %d "
                  "at %u %u %u index %llu", i, r.origin[0], r.origin[1], r.origin[2], r.direction[0], r.direction[1], r.direction[2], r.t_min,
                  r.t_max, r.spread, r.offset, h.hit, h.t, h.level, h.cell[0], h.cell[1], h.cell[2], (unsigned long long)h.attribute, e.hit,
                  e.t, e.level, e.cell[0], e.cell[1], e.cell[2], (unsigned long long)e.attribute);
        CHECK(svo_ray_blocked(v, &r) == h.hit);
        if (!h.hit) continue;
        /* t, face and node agree with each other */
        double enter, leave;
        CHECK(svo_ray_node(v, &r, h.level, h.cell, &enter, &leave));
        CHECK(h.t == fmax(enter, r.t_min) && h.t < leave);
        if (h.face == SVO_FACE_INSIDE) CHECK(enter < r.t_min);
        else {
            CHECK(h.face < 6 && enter >= r.t_min);
            int axis = h.face / 2;
            CHECK(h.face & 1 ? r.direction[axis] < 0 : r.direction[axis] > 0);
            double size = ldexp(1, (int)(w->depth - h.level)), p = (h.cell[axis] + (h.face & 1)) * size;
            CHECK((p - r.origin[axis]) * (1 / r.direction[axis]) == h.t);
        }
    }
    if (w->count > 0) CHECK_MSG(hits > (uint64_t)count / 50 || w->count < ldexp(1, 3 * (int)w->depth) / 100, "%llu hits are no test", (unsigned long long)hits);
}

static void free_world(world *w) { free(w->codes), w->codes = NULL, w->count = 0; }

static world random_world(uint32_t depth, uint64_t count, uint64_t seed)
{
    world w = {depth, malloc(count * 8 + 8), count};
    for (uint64_t i = 0; i < count; i++) w.codes[i] = test_random(&seed) & (((uint64_t)1 << 3 * depth) - 1);
    world_finish(&w);
    return w;
}

static void check_world(world *w, uint64_t seed, int rays)
{
    for (int variant = 0; variant < 5 && !test_failed(); variant++) {
        packer_options o = {.lod = variant != 0, .averaged = variant == 4, .share = variant == 2 && w->count < 3000, .offset_words = variant == 3 ? 2 : 1};
        svo_view *v = packer_make(w->depth, w->codes, w->count, &o);
        check_rays(w, v, seed + (uint64_t)variant, rays, variant != 1);
        packer_free(v);
    }
    free_world(w);
}

TEST(every_depth_and_filling)
{
    for (uint32_t depth = 0; depth <= 7 && !test_failed(); depth++) {
        uint64_t cells = (uint64_t)1 << 3 * depth;
        uint64_t counts[4] = {1, cells / 50 + 1, cells / 4 + 1, 0};
        for (int c = 0; c < 3 && !test_failed(); c++) {
            world w = random_world(depth, counts[c] < 4000 ? counts[c] : 4000, depth * 7 + (uint64_t)c);
            check_world(&w, depth + 100 * (uint64_t)c, 1200);
        }
    }
}

TEST(solid_blocks)
{
    for (uint32_t depth = 0; depth <= 4 && !test_failed(); depth++) {
        world w = {depth, malloc(8u << 3 * depth), (uint64_t)1 << 3 * depth};
        for (uint64_t i = 0; i < w.count; i++) w.codes[i] = i;
        check_world(&w, depth, 2400);
    }
}

/* A shell: what the voxelizer makes; long walks along the surface. */
TEST(spheres)
{
    for (uint32_t depth = 5; depth <= 6 && !test_failed(); depth++) {
        uint32_t n = 1u << depth;
        world w = {depth, malloc(8 * (uint64_t)n * n * n), 0};
        for (uint32_t z = 0; z < n; z++)
            for (uint32_t y = 0; y < n; y++)
                for (uint32_t x = 0; x < n; x++) {
                    double c = n / 2.0, dx = x + 0.5 - c, dy = y + 0.5 - c, dz = z + 0.5 - c, d = sqrt(dx * dx + dy * dy + dz * dz);
                    if (fabs(d - 0.45 * n) < 0.9) w.codes[w.count++] = svo_morton_encode(x, y, z);
                }
        world_finish(&w);
        check_world(&w, depth, depth == 5 ? 1200 : 400);
    }
}

TEST(empty_octree)
{
    svo_view *v = packer_make(5, NULL, 0, NULL);
    svo_ray r = {{-1, 16.5, 16.5}, {1, 0, 0}, 0, INFINITY, 0, 0};
    svo_hit h;
    svo_raycast(v, &r, 1, &h);
    CHECK(!h.hit && !svo_ray_blocked(v, &r));
    packer_free(v);
}

TEST(a_batch_gives_what_single_rays_give)
{
    world w = random_world(6, 2000, 1);
    packer_options o = {.lod = true};
    svo_view *v = packer_make(6, w.codes, w.count, &o);
    svo_ray rays[97];
    svo_hit hits[97], one;
    uint64_t seed = 5;
    for (uint32_t i = 0; i < 97; i++) rays[i] = nasty_ray(&seed, 6, i % KINDS), rays[i].spread = i % 4;
    svo_raycast(v, rays, 97, hits);
    for (uint32_t i = 0; i < 97; i++) {
        svo_raycast(v, &rays[i], 1, &one);
        CHECK(memcmp(&one, &hits[i], sizeof one) == 0);
    }
    packer_free(v);
    free_world(&w);
}

/* Conventions, one by one. */
TEST(half_open_cells)
{
    uint64_t code = svo_morton_encode(3, 3, 3);
    svo_view *v = packer_make(3, &code, 1, NULL);
    struct { double o[3], d[3]; bool hit; double t; int face; } cases[] = {
        {{0, 3.5, 3.5}, {1, 0, 0}, true, 3, SVO_FACE_LOW_X},
        {{8, 3.5, 3.5}, {-2, 0, 0}, true, 2, SVO_FACE_HIGH_X},
        {{3.5, 3.5, 3.5}, {1, 0, 0}, true, 0, SVO_FACE_INSIDE},
        {{3, 3.5, 3.5}, {1, 0, 0}, true, 0, SVO_FACE_LOW_X},   /* on the near face */
        {{4, 3.5, 3.5}, {1, 0, 0}, false, 0, 0},               /* on the far face */
        {{4, 3.5, 3.5}, {-1, 0, 0}, true, 0, SVO_FACE_HIGH_X}, /* near again */
        {{3, 3.5, 3.5}, {-1, 0, 0}, false, 0, 0},
        {{0, 3, 3.5}, {1, 0, 0}, true, 3, SVO_FACE_LOW_X},     /* along a face: belongs to the upper cell */
        {{0, 4, 3.5}, {1, 0, 0}, false, 0, 0},
        {{0, 3, 3}, {1, 0, 0}, true, 3, SVO_FACE_LOW_X},       /* along an edge */
        {{0, 4, 3}, {1, 0, 0}, false, 0, 0},
        {{0, 0, 0}, {1, 1, 1}, true, 3, SVO_FACE_LOW_X},       /* through two corners */
        {{8, 8, 8}, {-1, -1, -1}, true, 4, SVO_FACE_HIGH_X},
        {{2, 5, 3.5}, {1, -1, 0}, true, 1, SVO_FACE_LOW_X},    /* enters at an edge: the lowest axis names the face */
        {{2, 4, 3.5}, {1, -1, 0}, false, 0, 0},                /* touches an edge from outside */
        {{2, 3, 3.5}, {1, 1, 0}, false, 0, 0},
        {{3.5, 3.5, 3.5}, {0, 0, 0}, true, 0, SVO_FACE_INSIDE}, /* a point */
        {{2.5, 3.5, 3.5}, {0, 0, 0}, false, 0, 0},
        {{NAN, 3.5, 3.5}, {1, 0, 0}, false, 0, 0},
        {{0, 3.5, 3.5}, {INFINITY, 0, 0}, false, 0, 0},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        svo_ray r = {.t_max = INFINITY};
        memcpy(r.origin, cases[i].o, sizeof r.origin);
        memcpy(r.direction, cases[i].d, sizeof r.direction);
        svo_hit h;
        svo_raycast(v, &r, 1, &h);
        CHECK_MSG(h.hit == cases[i].hit, "case %zu: hit %d", i, h.hit);
        if (h.hit) CHECK_MSG(h.t == cases[i].t && h.face == cases[i].face, "case %zu: t %g face %d", i, h.t, h.face);
    }
    packer_free(v);
}

/* A wall one voxel thick has no hole for any ray that goes from one side to the other, not even along shared edges. */
TEST(walls_have_no_holes)
{
    uint64_t codes[256], n = 0;
    for (uint32_t y = 0; y < 16; y++)
        for (uint32_t z = 0; z < 16; z++) codes[n++] = svo_morton_encode(7, y, z);
    svo_view *v = packer_make(4, codes, n, NULL);
    uint64_t s = 3;
    for (int i = 0; i < 20000; i++) {
        svo_ray r = {.t_max = 1};
        double to[3];
        for (int k = 0; k < 3; k++) {
            /* integers, halves and anything */
            r.origin[k] = 1 + 14 * test_random_unit(&s), to[k] = 1 + 14 * test_random_unit(&s);
            if (i & 1) r.origin[k] = floor(r.origin[k]), to[k] = floor(to[k]);
        }
        r.origin[0] = i & 2 ? 2 : 12, to[0] = i & 2 ? 13 : 3;
        for (int k = 0; k < 3; k++) r.direction[k] = to[k] - r.origin[k];
        CHECK_MSG(svo_ray_blocked(v, &r), "ray %d passes", i);
    }
    packer_free(v);
}

/* Against planes in quadruple-like precision with division: the answers may differ only where the ray passes within
 * rounding of an edge, and then t differs little. */
TEST(an_independent_slab_test_agrees)
{
    world w = random_world(6, 3000, 77);
    svo_view *v = packer_make(6, w.codes, w.count, NULL);
    uint64_t s = 9, differ = 0;
    double worst = 0;
    for (int i = 0; i < 4000; i++) {
        svo_ray r = nasty_ray(&s, 6, (uint32_t)i % 2);
        svo_hit h;
        svo_raycast(v, &r, 1, &h);
        long double best = INFINITY;
        for (uint64_t c = 0; c < w.count; c++) {
            uint32_t p[3];
            svo_morton_decode(w.codes[c], &p[0], &p[1], &p[2]);
            long double a = 0, b = INFINITY;
            for (int k = 0; k < 3; k++) {
                long double x = ((long double)p[k] - r.origin[k]) / r.direction[k], y = ((long double)p[k] + 1 - r.origin[k]) / r.direction[k];
                a = fmaxl(a, fminl(x, y)), b = fminl(b, fmaxl(x, y));
            }
            if (a < b && a < best) best = a;
        }
        if (h.hit != isfinite((double)best)) differ++;
        else if (h.hit) {
            double e = fabs((double)(best - h.t));
            if (e > 1e-12) differ++;
            else worst = fmax(worst, e);
        }
    }
    CHECK_MSG(differ == 0, "%llu of 4000 rays differ", (unsigned long long)differ);
    CHECK(worst < 1e-13);
    packer_free(v);
    free_world(&w);
}

TEST(far_origins_and_odd_direction_lengths)
{
    world w = random_world(6, 5000, 3);
    svo_view *v = packer_make(6, w.codes, w.count, NULL);
    uint64_t s = 4, found = 0;
    for (int i = 0; i < 2000; i++) {
        svo_ray near = nasty_ray(&s, 6, 0);
        svo_hit a, b;
        svo_raycast(v, &near, 1, &a);
        /* the same ray with a direction of another length: a power of two changes nothing but t */
        int e = (int)(test_random(&s) % 1800) - 900;
        svo_ray r = near;
        for (int k = 0; k < 3; k++) r.direction[k] = ldexp(near.direction[k], e);
        svo_raycast(v, &r, 1, &b);
        CHECK(a.hit == b.hit);
        if (a.hit) CHECK_MSG(ldexp(b.t, e) == a.t && memcmp(a.cell, b.cell, sizeof a.cell) == 0, "2^%d: %a and %a", e, a.t, b.t);
        /* from 1e18 cells away along an axis the other coordinates stay exact */
        svo_ray far = {.t_max = INFINITY};
        int axis = i % 3;
        for (int k = 0; k < 3; k++) far.origin[k] = 64 * test_random_unit(&s);
        far.direction[axis] = i & 1 ? 3 : -3;
        svo_ray close = far;
        far.origin[axis] = i & 1 ? -3e18 : 3e18;
        close.origin[axis] = i & 1 ? -64 : 128;
        svo_raycast(v, &far, 1, &b);
        svo_raycast(v, &close, 1, &a);
        CHECK(a.hit == b.hit && svo_ray_blocked(v, &far) == a.hit);
        if (a.hit) CHECK(memcmp(a.cell, b.cell, sizeof a.cell) == 0 && fabs(b.t - 1e18) < 1e3);
        found += a.hit;
    }
    CHECK(found > 100);
    packer_free(v);
    free_world(&w);
}

/* Depth 21: more voxels than could be listed; positions and counts at the end of their ranges. */
TEST(the_deepest_octree)
{
    for (int lod = 0; lod < 2; lod++) {
        svo_view *v = packer_solid(21, lod != 0);
        uint64_t s = 8;
        for (int i = 0; i < 3000; i++) {
            svo_ray r = nasty_ray(&s, 21, (uint32_t)i % KINDS);
            svo_hit h;
            svo_raycast(v, &r, 1, &h);
            const uint32_t whole[3] = {0};
            span root = node_span(&r, 21, 0, whole);
            double t = fmax(root.enter, r.t_min);
            CHECK(h.hit == (t < root.leave && t <= r.t_max));
            if (!h.hit) continue;
            CHECK(h.t == t && h.level == 21);
            for (int k = 0; k < 3; k++) {
                /* rounding of the point: 2^-52 of its largest term */
                double p = r.origin[k] + t * r.direction[k];
                CHECK(p >= h.cell[k] - 1e-3 && p <= h.cell[k] + 1 + 1e-3);
            }
            uint64_t code = svo_morton_encode(h.cell[0], h.cell[1], h.cell[2]), index = code;
            /* with lod: every ancestor and every complete subtree of a node before it counts too */
            if (lod)
                for (uint32_t l = 0; l < 21; l++) index += (code >> 3 * (21 - l)) + 1;
            CHECK_U64(h.attribute, index);
        }
        packer_free(v);
    }
}

/* A stop of level l everywhere is the same as the octree cut off at level l. */
TEST(a_constant_footprint_cuts_the_octree)
{
    world w = random_world(7, 3000, 21);
    packer_options o = {.lod = true};
    svo_view *v = packer_make(7, w.codes, w.count, &o);
    for (uint32_t level = 0; level <= 7; level++) {
        world cut = {level, malloc(w.count * 8), w.count};
        for (uint64_t i = 0; i < w.count; i++) cut.codes[i] = w.codes[i] >> 3 * (7 - level);
        svo_view *c = packer_make(level, cut.codes, cut.count, NULL);
        uint64_t s = level;
        for (int i = 0; i < 600; i++) {
            svo_ray r = nasty_ray(&s, 7, (uint32_t)i % KINDS), q = r;
            double scale = ldexp(1, -(int)(7 - level));
            for (int k = 0; k < 3; k++) q.origin[k] *= scale, q.direction[k] *= scale;
            /* a zero component takes the cell of floor(origin): the same in both grids */
            r.offset = ldexp(1, (int)(7 - level));
            svo_hit a, b;
            svo_raycast(v, &r, 1, &a);
            svo_raycast(c, &q, 1, &b);
            CHECK(a.hit == b.hit);
            if (a.hit) CHECK(a.level == level && a.t == b.t && memcmp(a.cell, b.cell, sizeof a.cell) == 0 && a.face == b.face);
        }
        packer_free(c);
        free_world(&cut);
    }
    packer_free(v);
    free_world(&w);
}

/* The stop rule itself: the node's edge is within the footprint, its parent's was not where the ray entered the parent. */
TEST(stops_are_the_first_small_nodes)
{
    world w = random_world(7, 5000, 31);
    packer_options o = {.lod = true};
    svo_view *v = packer_make(7, w.codes, w.count, &o);
    uint64_t s = 12, stops = 0, levels[8] = {0};
    for (int i = 0; i < 6000; i++) {
        svo_ray r = nasty_ray(&s, 7, (uint32_t)i % 2);
        r.spread = exp2(test_random_unit(&s) * 9);
        svo_hit h;
        svo_raycast(v, &r, 1, &h);
        if (!h.hit) continue;
        levels[h.level]++;
        double edge = ldexp(1, 7 - h.level), enter, leave;
        if (h.level < 7) {
            CHECK(edge <= r.spread * h.t);
            stops++;
        }
        if (h.level == 0) continue;
        uint32_t parent[3] = {h.cell[0] / 2, h.cell[1] / 2, h.cell[2] / 2};
        CHECK(svo_ray_node(v, &r, h.level - 1u, parent, &enter, &leave));
        CHECK(2 * edge > r.spread * fmax(enter, r.t_min));
    }
    CHECK(stops > 1000);
    for (int l = 3; l < 8; l++) CHECK(levels[l] > 10);
    packer_free(v);
    free_world(&w);
}
