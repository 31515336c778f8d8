/* Many rays at a time: every kernel against svo_raycast, bit for bit, and against a loop over all voxels. */
#include "svo_rays.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "nasty_rays.h"
#include "packer.h"
#include "svo_dag.h"
#include "svo_morton.h"
#include "trees.h"

static const svo_ray_kernel kernels[] = {SVO_KERNEL_AUTO, SVO_KERNEL_PORTABLE, SVO_KERNEL_AVX512, SVO_KERNEL_AVX2};

static void print_difference(const svo_ray *r, const svo_hit *a, const svo_hit *b)
{
    CHECK_MSG(false, "o %a %a %a d %a %a %a t %a %a cone %g %g: hit %d t %a level %d face %d at %u %u %u index %llu, svo_raycast %d t %a level %d face %d at %u %u %u index %llu",
              r->origin[0], r->origin[1], r->origin[2], r->direction[0], r->direction[1], r->direction[2], r->t_min, r->t_max, r->spread, r->offset,
              a->hit, a->t, a->level, a->face, a->cell[0], a->cell[1], a->cell[2], (unsigned long long)a->attribute,
              b->hit, b->t, b->level, b->face, b->cell[0], b->cell[1], b->cell[2], (unsigned long long)b->attribute);
}

/* All kernels give the same as svo_raycast on these rays, whatever the size of the batch. */
static void check_rays(const svo_view *v, const svo_ray *rays, uint64_t count)
{
    svo_hit *expected = malloc(count * sizeof *expected), *hits = malloc(count * sizeof *hits);
    bool *blocked = malloc(count);
    for (uint64_t i = 0; i < count; i++) svo_raycast(v, &rays[i], 1, &expected[i]);
    for (size_t k = 0; k < sizeof kernels / sizeof *kernels && !test_failed(); k++) {
        svo_rays_options o = svo_default_rays_options();
        o.kernel = kernels[k];
        svo_rays *r;
        svo_error err;
        CHECK_OK(svo_rays_build(v, &o, &r, NULL, &err));
        uint64_t step = k == 1 ? 100 : count;
        for (uint64_t i = 0; i < count; i += step) {
            uint64_t n = count - i < step ? count - i : step;
            svo_rays_cast(r, rays + i, n, hits + i);
            svo_rays_blocked(r, rays + i, n, blocked + i);
        }
        for (uint64_t i = 0; i < count && !test_failed(); i++) {
            if (memcmp(&hits[i], &expected[i], sizeof *hits) != 0) print_difference(&rays[i], &hits[i], &expected[i]);
            CHECK(blocked[i] == expected[i].hit);
        }
        svo_rays_free(r);
    }
    free(expected), free(hits), free(blocked);
}

/* Values of many hits at a time are those of each. */
static void check_values(const svo_view *v, const svo_ray *rays, uint32_t count)
{
    svo_hit *hits = malloc(count * sizeof *hits);
    uint8_t *values = malloc((size_t)count * SVO_MAX_STRIDE), expected[SVO_MAX_STRIDE];
    svo_raycast(v, rays, count, hits);
    for (uint32_t c = 0; c < v->channel_count && !test_failed(); c++) {
        const uint32_t stride = svo_channel_stride(v->channels[c].channel.kind);
        svo_rays_values(v, c, hits, count, values);
        for (uint32_t i = 0; i < count && !test_failed(); i++) {
            memset(expected, 0, sizeof expected);
            if (hits[i].hit) svo_view_attribute(v, c, hits[i].attribute, expected);
            CHECK(memcmp(values + (size_t)i * stride, expected, stride) == 0);
        }
    }
    free(hits), free(values);
}

static void check_view(const svo_view *v, uint64_t seed, uint64_t count)
{
    svo_ray *rays = malloc(count * sizeof *rays);
    for (int cones = 0; cones < 2 && !test_failed(); cones++) {
        for (uint64_t i = 0; i < count; i++) {
            rays[i] = nasty_ray(&seed, v->depth, (uint32_t)(i % 3 == 0 ? i / 3 % KINDS : i % 2)); /* two thirds in general position */
            if (!cones || !v->lod) continue;
            rays[i].spread = i % 3 == 1 ? 0 : exp2(test_random_unit(&seed) * v->depth);
            rays[i].offset = i % 5 != 0 ? 0 : ldexp(1, (int)v->depth) * test_random_unit(&seed) * test_random_unit(&seed);
        }
        check_rays(v, rays, count);
        check_values(v, rays, (uint32_t)count);
    }
    free(rays);
}

static int compare_codes(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* Sorted, unique codes of a world: 0 scattered, 1 a shell, 2 a solid block with holes, 3 clusters, 4 walls and blocks parallel to the axes. */
static uint64_t make_world(uint32_t depth, uint32_t style, uint64_t want, uint64_t *seed, uint64_t **out)
{
    uint64_t *codes = malloc((want + 1) * 8), count = 0, mask = ((uint64_t)1 << 3 * depth) - 1;
    double n = ldexp(1, (int)depth);
    uint64_t base = test_random(seed) & mask;
    for (uint64_t i = 0; i < want; i++) {
        if (style == 1) {
            double z = 2 * test_random_unit(seed) - 1, a = 6.2831853 * test_random_unit(seed), r = sqrt(1 - z * z);
            double p[3] = {r * cos(a), r * sin(a), z};
            uint32_t c[3];
            for (int k = 0; k < 3; k++) c[k] = (uint32_t)fmin(fmax(n * (0.5 + 0.45 * p[k]), 0), n - 1);
            codes[count++] = svo_morton_encode(c[0], c[1], c[2]);
        } else if (style == 2) {
            if (test_random(seed) % 50 != 0) codes[count++] = i & mask;
        } else if (style == 3) {
            if (i % 64 == 0) base = test_random(seed) & mask;
            codes[count++] = (base ^ (test_random(seed) & 511)) & mask;
        } else if (style == 4) { /* half of them are thin, half of those without a hole; most reach across several nodes of 16^3 */
            const uint64_t holes = test_random(seed) % 2;
            uint32_t low[3], size[3];
            svo_morton_decode(test_random(seed) & mask, &low[0], &low[1], &low[2]);
            for (int k = 0; k < 3; k++) size[k] = 1 + (uint32_t)(test_random(seed) % 23);
            if (test_random(seed) % 2 == 0) size[test_random(seed) % 3] = 1;
            for (uint32_t j = 0; j < size[0] * size[1] * size[2] && i < want; j++) {
                const uint32_t c[3] = {low[0] + j % size[0], low[1] + j / size[0] % size[1], low[2] + j / size[0] / size[1]};
                if (c[0] >= n || c[1] >= n || c[2] >= n || (holes != 0 && test_random(seed) % 40 == 0)) continue;
                codes[count++] = svo_morton_encode(c[0], c[1], c[2]), i++;
            }
        } else codes[count++] = test_random(seed) & mask;
    }
    if (count == 0) codes[count++] = 0;
    qsort(codes, count, 8, compare_codes);
    uint64_t kept = 0;
    for (uint64_t i = 0; i < count; i++)
        if (i == 0 || codes[i] != codes[i - 1]) codes[kept++] = codes[i];
    *out = codes;
    return kept;
}

TEST(every_depth_and_shape)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 11, 16, 21};
    uint64_t seed = 1;
    for (size_t d = 0; d < sizeof depths / sizeof *depths; d++)
        for (uint32_t style = 0; style < 5 && !test_failed(); style++) {
            uint64_t *codes, cells = (uint64_t)1 << 3 * depths[d], want = cells < 3000 ? cells : 3000;
            uint64_t count = make_world(depths[d], style, want, &seed, &codes);
            for (int lod = 0; lod < 3 && !test_failed(); lod++) {
                packer_options o = {.lod = lod != 0, .averaged = lod == 2};
                svo_view *v = packer_make(depths[d], codes, count, &o);
                check_view(v, seed, 1500);
                packer_free(v);
            }
            free(codes);
        }
}

/* The rule of svo_raycast.h for all voxels, one by one. */
TEST(a_loop_over_all_voxels_agrees)
{
    uint64_t seed = 9;
    for (uint32_t depth = 3; depth <= 6 && !test_failed(); depth++) {
        uint64_t *codes, count = make_world(depth, depth % 2 == 0 ? 1 : 0, 400, &seed, &codes);
        svo_view *v = packer_make(depth, codes, count, NULL);
        svo_rays *r;
        svo_error err;
        CHECK_OK(svo_rays_build(v, NULL, &r, NULL, &err));
        enum { RAYS = 2000 };
        static svo_ray rays[RAYS];
        static svo_hit hits[RAYS];
        for (uint32_t i = 0; i < RAYS; i++) rays[i] = nasty_ray(&seed, depth, i % KINDS);
        svo_rays_cast(r, rays, RAYS, hits);
        for (uint32_t i = 0; i < RAYS && !test_failed(); i++) {
            double best = INFINITY;
            uint32_t at[3] = {0, 0, 0};
            for (uint64_t k = 0; k < count; k++) {
                uint32_t cell[3];
                double enter, leave;
                svo_morton_decode(codes[k], &cell[0], &cell[1], &cell[2]);
                if (!svo_ray_node(v, &rays[i], depth, cell, &enter, &leave)) continue;
                double t = fmax(enter, rays[i].t_min);
                if (t < leave && t <= rays[i].t_max && t < best) best = t, memcpy(at, cell, sizeof at);
            }
            CHECK(hits[i].hit == (best < INFINITY));
            if (hits[i].hit) CHECK(hits[i].t == best && memcmp(at, hits[i].cell, sizeof at) == 0);
        }
        svo_rays_free(r);
        packer_free(v);
        free(codes);
    }
}

/* Neighbouring rays, as of a camera or a light, which kernels trace together: tiles of 16x16 in rows of 4x4, from everywhere, inside
 * voxels, along axes nearly and exactly, narrow and wide, with intervals and levels of detail. */
TEST(rays_that_go_the_same_way)
{
    static const uint32_t depths[] = {2, 3, 4, 5, 6, 7, 9, 12, 16, 21};
    enum { RAYS = 256 };
    svo_ray *rays = malloc(RAYS * sizeof *rays);
    uint64_t seed = 21;
    for (size_t d = 0; d < sizeof depths / sizeof *depths; d++)
        for (uint32_t style = 0; style < 5 && !test_failed(); style++) {
            uint64_t *codes, cells = (uint64_t)1 << 3 * depths[d], want = cells < 5000 ? cells : 5000;
            uint64_t count = make_world(depths[d], style, want, &seed, &codes);
            packer_options o = {.lod = true};
            svo_view *v = packer_make(depths[d], codes, count, &o);
            double n = ldexp(1, (int)depths[d]);
            for (uint32_t tile = 0; tile < 40 && !test_failed(); tile++) {
                double origin[3], forward[3], right[3], up[3];
                bool parallel = tile % 3 == 1, inside = tile % 4 == 3, lod = tile % 5 == 2, interval = tile % 7 == 4;
                uint32_t x, y, z;
                svo_morton_decode(codes[test_random(&seed) % count], &x, &y, &z);
                double aim[3] = {x + 0.5, y + 0.4, z + 0.6};
                double width = ldexp(test_random_unit(&seed), -(int)(test_random(&seed) % 12)); /* of the tile, in the grid */
                for (int k = 0; k < 3; k++) {
                    origin[k] = inside ? aim[k] + 4 * test_random_unit(&seed) : (3 * test_random_unit(&seed) - 1) * n;
                    forward[k] = aim[k] - origin[k] + (tile % 11 == 7 ? n : 0);
                    right[k] = n * width * (test_random_unit(&seed) - 0.5);
                    up[k] = n * width * (test_random_unit(&seed) - 0.5);
                }
                if (inside && tile % 8 == 3) origin[tile % 3] = floor(origin[tile % 3]); /* on a plane of voxels, as in the middle of something symmetric */
                if (tile % 13 == 5) forward[tile % 3] = ldexp(forward[tile % 3], -30); /* nearly along a plane */
                if (tile % 13 == 6) forward[tile % 3] = 0, right[tile % 3] = up[tile % 3] = 0;
                double spread = lod ? ldexp(test_random_unit(&seed), (int)(test_random(&seed) % (depths[d] + 1))) : 0;
                for (uint32_t i = 0; i < RAYS; i++) {
                    double sx = (i / 16 % 4 * 4 + i % 4) / 16.0 - 0.5, sy = (i / 64 * 4 + i / 4 % 4) / 16.0 - 0.5;
                    rays[i] = (svo_ray){.t_min = 0, .t_max = INFINITY, .spread = spread, .offset = lod && tile % 2 != 0 ? spread * n / 8 : 0};
                    for (int k = 0; k < 3; k++) {
                        double across = sx * right[k] + sy * up[k];
                        rays[i].origin[k] = origin[k] + (parallel ? across : 0);
                        rays[i].direction[k] = forward[k] + (parallel ? 0 : across);
                    }
                    if (interval) rays[i].t_min = 0.2 * test_random_unit(&seed), rays[i].t_max = 0.7 + 0.6 * test_random_unit(&seed);
                    if (tile % 17 == 9 && i % 50 == 3) rays[i] = nasty_ray(&seed, depths[d], (uint32_t)(test_random(&seed) % KINDS));
                }
                check_rays(v, rays, tile % 6 == 0 ? 100 : RAYS);
            }
            packer_free(v);
            free(codes);
        }
    free(rays);
}

/* Rough ground, three voxels thick, and the height of its top. */
enum { GROUND_DEPTH = 8, GROUND_SIDE = 1 << GROUND_DEPTH };
static svo_view *make_ground(uint32_t ground[GROUND_SIDE][GROUND_SIDE], uint64_t *seed)
{
    uint64_t count = 0, *codes = malloc(3 * GROUND_SIDE * GROUND_SIDE * sizeof *codes);
    for (uint32_t x = 0; x < GROUND_SIDE; x++)
        for (uint32_t z = 0; z < GROUND_SIDE; z++) {
            ground[x][z] = (uint32_t)(100 + 20 * sin(x / 9.0) * cos(z / 13.0) + 6 * test_random_unit(seed));
            for (uint32_t k = 0; k < 3; k++) codes[count++] = svo_morton_encode(x, ground[x][z] - k, z);
        }
    qsort(codes, count, 8, compare_codes);
    packer_options o = {.lod = true};
    svo_view *v = packer_make(GROUND_DEPTH, codes, count, &o);
    free(codes);
    return v;
}

/* Rays that begin near each other above, in and below rough ground, and leave it in all directions, with directions of all lengths: what is near is soon behind them. */
TEST(rays_that_leave_rough_ground)
{
    enum { RAYS = 1024 };
    static uint32_t ground[GROUND_SIDE][GROUND_SIDE];
    static const int lengths[] = {0, 3, -20, 40, -80, 85, 110, -200};
    uint64_t seed = 43, hits = 0, traced = 0;
    svo_view *v = make_ground(ground, &seed);
    svo_ray *rays = malloc(RAYS * sizeof *rays);
    for (uint32_t tile = 0; tile < 64 && !test_failed(); tile++) {
        const double step = 3 * test_random_unit(&seed), above = 12 * test_random_unit(&seed) - (tile % 8 == 3 ? 8 : 0), rise = tile % 3 == 0 ? 0.1 : 1;
        const double left = test_random_unit(&seed) * (GROUND_SIDE - 32 * step), front = test_random_unit(&seed) * (GROUND_SIDE - 32 * step);
        for (uint32_t i = 0; i < RAYS; i++) { /* 32x32 in blocks of 4x4 */
            const double x = left + step * (i / 16 % 8 * 4 + i % 4), z = front + step * (i / 128 * 4 + i / 4 % 4);
            const double d[3] = {test_random_unit(&seed) - 0.5, rise * (test_random_unit(&seed) - (tile % 2 == 0 ? 0 : 0.3)), test_random_unit(&seed) - 0.5};
            rays[i] = (svo_ray){.origin = {x, ground[(uint32_t)x][(uint32_t)z] + above, z}, .t_max = INFINITY};
            for (int k = 0; k < 3; k++) rays[i].direction[k] = ldexp(d[k], lengths[tile % 8]);
            if (tile % 5 == 4) rays[i].t_max = ldexp(100 * test_random_unit(&seed), -lengths[tile % 8]);
            if (tile % 7 == 3) rays[i].offset = 6 * test_random_unit(&seed);
            if (tile % 7 == 5) rays[i].spread = ldexp(0.2 * test_random_unit(&seed), lengths[tile % 8]);
            if (tile % 11 == 5) rays[i].t_min = ldexp(-20 * test_random_unit(&seed), -lengths[tile % 8]);
            hits += svo_ray_blocked(v, &rays[i]);
        }
        traced += RAYS;
        check_rays(v, rays, RAYS);
    }
    CHECK(hits > traced / 8 && hits < traced - traced / 8);
    free(rays);
    packer_free(v);
}

/* Rays that begin above rough ground and run over it towards a light: one packet meets ever more bricks, in most of which it misses what is there. */
TEST(rays_over_rough_ground_to_a_light)
{
    enum { SIDE = GROUND_SIDE, RAYS = 1024 };
    uint64_t seed = 41, blocked_rays = 0, traced = 0;
    static uint32_t ground[SIDE][SIDE];
    svo_view *v = make_ground(ground, &seed);
    svo_ray *rays = malloc(RAYS * sizeof *rays);
    for (uint32_t tile = 0; tile < 48 && !test_failed(); tile++) {
        double step = 0.2 + 3 * test_random_unit(&seed), above = 1 + 8 * test_random_unit(&seed), light[3] = {test_random_unit(&seed) - 0.5, 0, test_random_unit(&seed) - 0.5};
        light[1] = tile % 3 == 0 ? 0.02 : tile % 3 == 1 ? 0.2 : -0.01;
        double left = test_random_unit(&seed) * (SIDE - 32 * step), front = test_random_unit(&seed) * (SIDE - 32 * step);
        for (uint32_t i = 0; i < RAYS; i++) { /* 32x32 in blocks of 4x4 */
            double x = left + step * (i / 16 % 8 * 4 + i % 4), z = front + step * (i / 128 * 4 + i / 4 % 4);
            rays[i] = (svo_ray){.origin = {x, ground[(uint32_t)x][(uint32_t)z] + above, z}, .t_min = 0, .t_max = tile % 5 == 4 ? 100 : INFINITY};
            for (int k = 0; k < 3; k++) rays[i].direction[k] = light[k];
            if (tile % 7 == 3) rays[i].offset = 2 * step;
            if (tile % 11 == 5) rays[i].t_min = -40; /* from below the ground */
            blocked_rays += svo_ray_blocked(v, &rays[i]);
        }
        traced += RAYS;
        check_rays(v, rays, RAYS);
    }
    CHECK(blocked_rays > traced / 8 && blocked_rays < traced - traced / 8);
    free(rays);
    packer_free(v);
}

/* Cameras in a voxel, on its faces, edges and corners, looking along axes, edges and diagonals, with the least and the largest field
 * of view that svo-render takes: the hit set of every kernel is that of a loop over all voxels. */
TEST(cameras_in_extreme_places)
{
    static const double fields[] = {1e-3, 40, 179}; /* degrees */
    static const double looks[][3] = {{1, 0, 0}, {0, -1, 0}, {0, 0, 1}, {1, 1, 0}, {-1, 1, 1}, {0.3, -0.5, 0.8}, {1, 0x1p-40, 0}};
    enum { SIDE = 8, RAYS = SIDE * SIDE, PLACES = 6, LOOKS = sizeof looks / sizeof *looks };
    uint64_t seed = 31, *codes, count = make_world(5, 1, 600, &seed, &codes), met = 0;
    svo_view *v = packer_make(5, codes, count, NULL);
    svo_ray rays[RAYS];
    for (uint32_t place = 0; place < PLACES; place++)
        for (uint32_t look = 0; look < LOOKS; look++)
            for (uint32_t field = 0; field < 3 && !test_failed(); field++) {
                uint32_t c[3];
                svo_morton_decode(codes[test_random(&seed) % count], &c[0], &c[1], &c[2]);
                double at[3] = {c[0] + 0.5, c[1] + 0.25, c[2] + 0.75}, right[3], up[3], half = tan(fields[field] * 3.14159265358979323846 / 360);
                for (uint32_t k = 0; k < 3; k++)
                    if (place >= 1 && place <= 3 && k < place) at[k] = c[k]; /* on a face, an edge, a corner */
                    else if (place == 4) at[k] = c[k] + 1;                  /* the corner at the far side */
                    else if (place == 5) at[k] = 16;                        /* inside of the shell, on planes of all levels */
                const double *f = looks[look];
                uint32_t axis = fabs(f[0]) > 0.5 ? 1 : 0;
                for (uint32_t k = 0; k < 3; k++) right[k] = k == axis;
                up[0] = f[1] * right[2] - f[2] * right[1], up[1] = f[2] * right[0] - f[0] * right[2], up[2] = f[0] * right[1] - f[1] * right[0];
                for (uint32_t i = 0; i < RAYS; i++) {
                    double x = half * (2.0 * (i % SIDE) / (SIDE - 2) - 1), y = half * (2.0 * (i / SIDE) / (SIDE - 2) - 1); /* some are 0 */
                    rays[i] = (svo_ray){.t_min = 0, .t_max = INFINITY};
                    for (int k = 0; k < 3; k++) rays[i].origin[k] = at[k], rays[i].direction[k] = f[k] + x * right[k] + y * up[k];
                }
                check_rays(v, rays, RAYS);
                for (uint32_t i = 0; i < RAYS && !test_failed(); i++) {
                    svo_hit hit;
                    svo_raycast(v, &rays[i], 1, &hit);
                    double best = INFINITY;
                    for (uint64_t k = 0; k < count; k++) {
                        uint32_t cell[3];
                        double enter, leave;
                        svo_morton_decode(codes[k], &cell[0], &cell[1], &cell[2]);
                        if (svo_ray_node(v, &rays[i], 5, cell, &enter, &leave) && fmax(enter, 0) < leave) best = fmin(best, fmax(enter, 0));
                    }
                    CHECK(hit.hit == (best < INFINITY) && (!hit.hit || hit.t == best));
                    met += hit.hit;
                }
            }
    CHECK(met > 2000);
    packer_free(v);
    free(codes);
}

TEST(every_layout)
{
    static const svo_geometry layouts[] = {SVO_GEOMETRY_SVDAG, SVO_GEOMETRY_FAST, SVO_GEOMETRY_SYMMETRIC, SVO_GEOMETRY_BEST};
    uint64_t seed = 4;
    for (uint32_t depth = 2; depth <= 9 && !test_failed(); depth += depth < 4 ? 1 : 2)
        for (uint32_t style = 0; style < TREE_STYLES + 1 && !test_failed(); style++) {
            tree t;
            if (style == TREE_STYLES && depth > 5) continue;
            if (style == TREE_STYLES) tree_full(&t, depth, &seed);
            else tree_random(&t, depth, style, &seed);
            for (size_t k = 0; k < sizeof layouts / sizeof *layouts && !test_failed(); k++) {
                svo_dag_options o = svo_default_dag_options();
                o.geometry = layouts[k];
                svo_dag_builder *b;
                svo_packed *p = NULL;
                svo_error err;
                CHECK_OK(svo_dag_builder_create(&t.info, &o, &b, &err));
                CHECK_OK(tree_feed(&t, 1, svo_dag_builder_sink(b), &err));
                CHECK_OK(svo_dag_builder_finish(b, &p, NULL, &err));
                check_view(svo_packed_view(p), seed, 600);
                svo_packed_free(p);
            }
            tree_free(&t);
        }
}

TEST(odd_rays_are_as_svo_raycast_has_them)
{
    uint64_t seed = 5, *codes;
    uint64_t count = make_world(7, 1, 3000, &seed, &codes);
    packer_options o = {.lod = true};
    svo_view *v = packer_make(7, codes, count, &o);
    static const double values[] = {0, -0.0, 1, -1, 64, 64.5, 0x1p-1074, -0x1p-1060, 0x1p-301, 0x1p301, -0x1p1000, 1e18, -1e12, INFINITY, -INFINITY, NAN};
    enum { RAYS = 6000, VALUES = sizeof values / sizeof *values };
    svo_ray *rays = malloc(RAYS * sizeof *rays);
    for (uint32_t i = 0; i < RAYS; i++) {
        rays[i] = nasty_ray(&seed, 7, i % 2);
        uint64_t which = test_random(&seed);
        double *fields[10] = {&rays[i].origin[0], &rays[i].origin[1], &rays[i].origin[2], &rays[i].direction[0], &rays[i].direction[1],
                              &rays[i].direction[2], &rays[i].t_min, &rays[i].t_max, &rays[i].spread, &rays[i].offset};
        *fields[which % 10] = values[(which >> 8) % VALUES];
        if (i % 2 != 0) *fields[(which >> 16) % 10] = values[(which >> 24) % VALUES];
    }
    check_rays(v, rays, RAYS);
    free(rays);
    packer_free(v);
    free(codes);
}

/* An octree of 2^63 voxels: its levels are one node each, and so are those of the second form. */
TEST(the_largest_solid)
{
    svo_view *v = packer_solid(21, true);
    svo_rays *r;
    svo_rays_report report;
    svo_error err;
    CHECK_OK(svo_rays_build(v, NULL, &r, &report, &err));
    CHECK(report.bytes < 100000);
    svo_rays_free(r);
    check_view(v, 3, 500);
    packer_free(v);
}

TEST(a_form_that_is_too_large_is_not_kept)
{
    uint64_t seed = 6, *codes;
    uint64_t count = make_world(12, 0, 20000, &seed, &codes);
    svo_view *v = packer_make(12, codes, count, NULL);
    svo_rays_options o = svo_default_rays_options();
    svo_limit_allocator limited;
    svo_limit_allocator_init(&limited, UINT64_MAX, NULL);
    o.allocator = &limited.base;
    o.memory = 10000;
    svo_rays *r;
    svo_rays_report report;
    svo_error err;
    CHECK_OK(svo_rays_build(v, &o, &r, &report, &err));
    CHECK(report.bytes == 0 && report.kernel == SVO_KERNEL_PORTABLE);
    svo_ray ray = nasty_ray(&seed, 12, 0);
    svo_hit a, b;
    svo_rays_cast(r, &ray, 1, &a);
    svo_raycast(v, &ray, 1, &b);
    CHECK(memcmp(&a, &b, sizeof a) == 0);
    svo_rays_free(r);
    CHECK(svo_limit_in_use(&limited) == 0);
    /* every allocation may fail */
    o.memory = 0;
    for (uint64_t i = 1; i < 60 && !test_failed(); i++) {
        svo_limit_allocator_init(&limited, UINT64_MAX, NULL);
        limited.fail_at = i;
        svo_result result = svo_rays_build(v, &o, &r, &report, &err);
        if (result == SVO_OK) {
            CHECK(report.kernel == SVO_KERNEL_PORTABLE || report.bytes > 8 * count / 64);
            svo_rays_free(r);
        } else CHECK(result == SVO_OUT_OF_MEMORY);
        CHECK(svo_limit_in_use(&limited) == 0);
    }
    packer_free(v);
    free(codes);
}

TEST(an_empty_octree)
{
    svo_view *v = packer_make(5, NULL, 0, NULL);
    check_view(v, 1, 50);
    packer_free(v);
}
