/* Scenes, cameras, shading and shadows. Oracles: all instances one by one, all voxels one by one, projections by hand. */
#include "svo_render.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "packer.h"
#include "stage.h"
#include "svo_alloc.h"
#include "svo_morton.h"
#include "test.h"

/* ---- scenes to look at --------------------------------------------------------------------------------------------- */

/* A blob of voxels with colours and normals that say where they are. */
static void blob_value(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    uint32_t n = *(uint32_t *)user;
    if (channel == 0) out[0] = (uint8_t)(x * 255 / n), out[1] = (uint8_t)(y * 255 / n), out[2] = (uint8_t)(z * 255 / n);
    else {
        float d[3] = {x + 0.5f - 0.5f * (float)n, y + 0.5f - 0.5f * (float)n, z + 0.5f - 0.5f * (float)n};
        svo_oct32_encode(d, out);
    }
}

static svo_view *make_blob(uint32_t depth, double radius, double thickness, const double *voxel_to_world)
{
    uint32_t n = 1u << depth;
    uint64_t *codes = malloc(8 * (uint64_t)n * n * n), count = 0;
    for (uint32_t z = 0; z < n; z++)
        for (uint32_t y = 0; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                double c = n / 2.0, dx = x + 0.5 - c, dy = y + 0.5 - c, dz = z + 0.5 - c, d = sqrt(dx * dx + dy * dy + dz * dz) / n;
                if (fabs(d - radius) <= thickness) codes[count++] = svo_morton_encode(x, y, z);
            }
    packer_options o = {.lod = true, .voxel_to_world = voxel_to_world, .channel_count = 2, .value = blob_value, .user = &n,
                        .channels = {{.name = "color", .kind = SVO_KIND_COLOR_SRGB8}, {.name = "normal", .kind = SVO_KIND_NORMAL_OCT32}}};
    svo_view *v = packer_make(depth, codes, count, &o);
    free(codes);
    return v;
}

static svo_mat4 random_transform(uint64_t *s, double spread)
{
    double t[3], q[4], scale[3];
    double size = exp2(4 * test_random_unit(s) - 2);
    for (int k = 0; k < 3; k++) t[k] = spread * (test_random_unit(s) - 0.5), scale[k] = size * (0.5 + test_random_unit(s)) * (test_random(s) & 1 ? 1 : -1);
    for (int k = 0; k < 4; k++) q[k] = test_random_unit(s) - 0.5;
    svo_mat4 m = svo_mat4_trs(t, q, scale);
    m.m[1] += 0.3 * size * (test_random_unit(s) - 0.5); /* shear */
    return m;
}

static svo_scene_ray random_ray(uint64_t *s, double spread)
{
    svo_scene_ray r = {.t_max = INFINITY};
    r.origin = svo_v3(spread * (test_random_unit(s) - 0.5), spread * (test_random_unit(s) - 0.5), spread * (test_random_unit(s) - 0.5));
    r.direction = svo_v3(test_random_unit(s) - 0.5, test_random_unit(s) - 0.5, test_random_unit(s) - 0.5);
    if (test_random(s) % 8 == 0) r.direction.y = 0;
    if (test_random(s) % 8 == 0) r.direction.x = 0;
    return r;
}

/* All instances, one by one. */
static bool slow_trace(const svo_scene *s, const svo_scene_ray *ray, svo_hit *best, uint64_t *instance)
{
    bool found = false;
    for (uint32_t p = 0; p < s->page_count; p++)
        for (uint64_t i = s->pages[p].first; i < s->pages[p].first + s->pages[p].count; i++) {
            svo_mat4 grid, m = svo_scene_instance_transform(s, p, i), inverse;
            const svo_view *v = s->assets[s->instance_asset[i]];
            memcpy(grid.m, v->voxel_to_world, sizeof grid.m);
            m = svo_mat4_mul(m, grid);
            if (!svo_mat4_affine_inverse(&m, &inverse)) continue;
            svo_vec3 o = svo_mat4_vector(&inverse, svo_sub(ray->origin, svo_v3(m.m[3], m.m[7], m.m[11]))), d = svo_mat4_vector(&inverse, ray->direction);
            svo_ray r = {{o.x, o.y, o.z}, {d.x, d.y, d.z}, ray->t_min, ray->t_max, 0, 0};
            svo_hit h;
            svo_raycast(v, &r, 1, &h);
            if (h.hit && (!found || h.t < best->t)) *best = h, *instance = i, found = true;
        }
    return found;
}

TEST(instances_against_one_by_one)
{
    uint64_t seed = 1, hits = 0;
    static const double half[16] = {0.1, 0, 0, -1.6, 0, 0.1, 0, -1.6, 0, 0, 0.1, -1.6, 0, 0, 0, 1};
    for (int round = 0; round < 6; round++) {
        stage s;
        uint64_t count = round == 0 ? 1 : round == 1 ? 3 : 200;
        stage_begin(&s, count);
        stage_asset(&s, make_blob(5, 0.4, 0.03, half));
        stage_asset(&s, make_blob(4, 0.2, 0.3, half));
        stage_asset(&s, packer_make(3, NULL, 0, NULL));
        for (uint64_t i = 0; i < count; i++) {
            svo_mat4 m = random_transform(&seed, 40);
            if (round == 5) m.m[3] = m.m[7] = 0; /* in a row */
            stage_instance(&s, count == 1 ? 0 : (uint32_t)(test_random(&seed) % 3), &m);
        }
        if (!stage_build(&s, count > 3 ? 7 : 1, round == 4 ? 1000 : 0, 2)) return;
        CHECK_U64(s.report.placed + s.report.empty, count);
        for (int i = 0; i < 1500; i++) {
            svo_scene_ray r = random_ray(&seed, 60);
            if (round == 4) r.origin.x += 1000 * floor(7 * test_random_unit(&seed));
            svo_scene_hit h;
            svo_hit want;
            uint64_t instance = 0;
            svo_scene_trace(s.bvh, &r, 1, &h);
            bool hit = slow_trace(&s.scene, &r, &want, &instance);
            CHECK_MSG(h.node.hit == hit, "round %d ray %d: hit %d, expected %d", round, i, h.node.hit, hit);
            CHECK(svo_scene_blocked(s.bvh, &r) == hit);
            if (!hit) continue;
            hits++;
            CHECK(svo_bvh_item(s.bvh, h.item)->instance == instance);
            CHECK(fabs(h.node.t - want.t) <= 1e-9 * (1 + want.t) && memcmp(h.node.cell, want.cell, sizeof want.cell) == 0);
            /* The point lies in the transformed voxel, and the normal looks against the ray. */
            double m[9];
            svo_bvh_from_grid(s.bvh, h.item, m);
            const svo_placed *p = svo_bvh_item(s.bvh, h.item);
            svo_vec3 at = svo_add(r.origin, svo_scale(r.direction, h.node.t)), rel = svo_sub(at, svo_v3(p->origin[0], p->origin[1], p->origin[2]));
            svo_mat4 forward = {{m[0], m[1], m[2], 0, m[3], m[4], m[5], 0, m[6], m[7], m[8], 0, 0, 0, 0, 1}};
            double det = svo_mat4_det3(&forward);
            for (int k = 0; k < 3; k++) { /* Cramer's rule with the forward map */
                svo_mat4 x = forward;
                x.m[k] = rel.x, x.m[4 + k] = rel.y, x.m[8 + k] = rel.z;
                double g = svo_mat4_det3(&x) / det;
                CHECK(g > h.node.cell[k] - 1e-6 && g < h.node.cell[k] + 1 + 1e-6);
            }
            svo_vec3 n = svo_bvh_face_normal(s.bvh, &h);
            if (h.node.face == SVO_FACE_INSIDE) CHECK(svo_dot(n, n) == 0);
            else CHECK(svo_dot(n, r.direction) < 0 && fabs(svo_length(n) - 1) < 1e-9);
        }
        stage_end(&s);
    }
    CHECK(hits > 500);
}

TEST(scales_from_a_millionth_to_a_million)
{
    stage s;
    stage_begin(&s, 8);
    stage_asset(&s, make_blob(5, 0.4, 0.05, NULL)); /* 32 units wide */
    double scales[4] = {1e-6, 1e-3, 1e3, 1e6}, at = 0;
    for (int i = 0; i < 4; i++)
        for (int mirror = 0; mirror < 2; mirror++) {
            double k = scales[i], t[3] = {at, 0, 0}, q[4] = {0, 0, 0, 1}, scale[3] = {mirror ? -k : k, k, k};
            t[0] += mirror ? 32 * k : 0;
            svo_mat4 m = svo_mat4_trs(t, q, scale);
            stage_instance(&s, 0, &m);
            at += 40 * k;
        }
    if (!stage_build(&s, 1, 0, 1)) return;
    CHECK_U64(s.report.placed, 8);
    at = 0;
    for (int i = 0; i < 8; i++) {
        double k = scales[i / 2];
        /* from above, down through the middle of the shell: top at y = 16 + 0.45 * 32 voxels or so */
        svo_scene_ray r = {.origin = {(float)at + 16.3 * k, 100 * k, 15.7 * k}, .direction = {0, -1, 0}, .t_max = INFINITY};
        svo_scene_hit h;
        svo_scene_trace(s.bvh, &r, 1, &h);
        CHECK_MSG(h.node.hit && svo_bvh_item(s.bvh, h.item)->instance == (uint64_t)i, "instance %d", i);
        double y = (100 * k - h.node.t) / k;
        CHECK_MSG(y > 29 && y < 32 && fabs(y - round(y)) < 1e-3, "instance %d at y %g", i, y);
        CHECK(fabs(svo_bvh_item(s.bvh, h.item)->stretch / (double)(float)k - 1) < 1e-6);
        at += 40 * k;
    }
    stage_end(&s);
}

/* The stretch is never smaller than what a vector can be stretched to, and not much larger. */
TEST(stretch_bounds_every_direction)
{
    uint64_t seed = 9;
    stage s;
    stage_begin(&s, 60);
    stage_asset(&s, make_blob(3, 0.3, 0.2, NULL));
    for (int i = 0; i < 60; i++) {
        svo_mat4 m = random_transform(&seed, 10);
        if (i % 3 == 0) m.m[1] += 1e3, m.m[6] -= 400;
        if (i % 7 == 0) m.m[0] *= 1e-6, m.m[4] *= 1e-6, m.m[8] *= 1e-6;
        stage_instance(&s, 0, &m);
    }
    if (!stage_build(&s, 3, 0, 1)) return;
    for (uint32_t i = 0; i < s.report.placed; i++) {
        double m[9], stretch = svo_bvh_item(s.bvh, i)->stretch, most = 0;
        svo_bvh_from_grid(s.bvh, i, m);
        svo_vec3 v = {0.3, 0.5, 0.7};
        for (int step = 0; step < 20000; step++) { /* power iteration of M^T M */
            svo_vec3 w = {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z, m[6] * v.x + m[7] * v.y + m[8] * v.z};
            most = fmax(most, svo_length(w) / svo_length(v));
            v = svo_normalize(svo_v3(m[0] * w.x + m[3] * w.y + m[6] * w.z, m[1] * w.x + m[4] * w.y + m[7] * w.z, m[2] * w.x + m[5] * w.y + m[8] * w.z));
        }
        CHECK_MSG(stretch >= most * (1 - 1e-12) && stretch < most * 1.0001, "stretch %.12g, found %.12g", stretch, most);
    }
    stage_end(&s);
}

TEST(what_cannot_be_drawn_is_left_out)
{
    stage s;
    stage_begin(&s, 100010);
    stage_asset(&s, make_blob(4, 0.3, 0.1, NULL));
    stage_asset(&s, packer_make(4, NULL, 0, NULL));
    svo_mat4 one = svo_mat4_identity(), flat = one, nan = one, gone = one;
    flat.m[5] = 0, nan.m[0] = NAN, memset(gone.m, 0, sizeof gone.m);
    stage_instance(&s, 0, &flat);
    stage_instance(&s, 0, &nan);
    stage_instance(&s, 0, &gone);
    stage_instance(&s, 1, &one);
    for (int i = 0; i < 100000; i++) stage_instance(&s, 0, &one); /* all at one place */
    one.m[3] = 40;
    stage_instance(&s, 0, &one);
    if (!stage_build(&s, 5, 0, 2)) return;
    CHECK_U64(s.report.singular, 3);
    CHECK_U64(s.report.empty, 1);
    CHECK_U64(s.report.duplicates, 99999);
    CHECK_U64(s.report.placed, 2);
    CHECK_U64(s.warnings.count, 1);
    svo_scene_ray r = {.origin = {8.5, 8.5, 100}, .direction = {0, 0, -1}, .t_max = INFINITY};
    svo_scene_hit h;
    svo_scene_trace(s.bvh, &r, 1, &h);
    CHECK(h.node.hit && svo_bvh_item(s.bvh, h.item)->instance == 4); /* the first of the equal ones */
    r.direction.z = NAN;
    CHECK(!svo_scene_blocked(s.bvh, &r));
    stage_end(&s);

    /* none at all, and none that has voxels */
    for (uint64_t n = 0; n < 2; n++) {
        stage_begin(&s, n);
        stage_asset(&s, packer_make(4, NULL, 0, NULL));
        svo_mat4 m = svo_mat4_identity();
        if (n == 1) stage_instance(&s, 0, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        double low[3], high[3];
        CHECK(!svo_bvh_bounds(s.bvh, low, high));
        r.direction.z = -1;
        CHECK(!svo_scene_blocked(s.bvh, &r));
        stage_end(&s);
    }
}

/* Copies that differ by rounding overlap almost wholly: still the nearest, and of equals the first. */
/* Batches of many rays give what single rays give, in every byte: rays of a camera, of a light, and at random. */
TEST(instances_traced_many_rays_at_a_time)
{
    enum { RAYS = 700 };
    static svo_scene_ray rays[RAYS];
    static svo_scene_hit hits[RAYS], one;
    static bool blocked[RAYS];
    uint64_t seed = 77, met = 0;
    for (int round = 0; round < 8 && !test_failed(); round++) {
        stage s;
        uint64_t count = round == 0 ? 1 : round == 1 ? 4 : 300;
        stage_begin(&s, count);
        stage_asset(&s, make_blob(6, 0.4, 0.02, NULL));
        stage_asset(&s, make_blob(4, 0.2, 0.3, NULL));
        stage_asset(&s, packer_make(3, NULL, 0, NULL));
        for (uint64_t i = 0; i < count; i++) {
            svo_mat4 m = random_transform(&seed, round == 5 ? 0 : 40);
            if (round == 6) m = svo_mat4_identity(), m.m[3] = (double)(i / 3); /* many at the same t */
            stage_instance(&s, count == 1 ? 0 : (uint32_t)(test_random(&seed) % 3), &m);
        }
        if (!stage_build(&s, count > 4 ? 5 : 1, 0, 2)) return;
        svo_rays_options o = svo_default_rays_options();
        svo_rays_report report;
        svo_error err;
        if (round == 7) o.memory = 6000; /* room for the smaller asset */
        CHECK_OK(svo_bvh_use_rays(s.bvh, &o, &report, &err));
        for (int kind = 0; kind < 4; kind++) {
            svo_vec3 eye = random_ray(&seed, 90).origin, light = random_ray(&seed, 1).direction;
            for (uint32_t i = 0; i < RAYS; i++) {
                rays[i] = random_ray(&seed, 60);
                svo_vec3 across = svo_v3((i % 4 + i / 16 % 4 * 4) / 16.0, (i / 4 % 4 + i / 64 * 4) / 16.0, 0.1);
                if (kind == 1) rays[i].origin = eye, rays[i].direction = svo_sub(svo_v3(across.x * 8, across.y * 8, 0), eye);
                if (kind == 2) rays[i].origin = svo_scale(across, 20), rays[i].direction = light;
                if (kind == 3) rays[i].t_min = test_random_unit(&seed), rays[i].t_max = 30 * test_random_unit(&seed), rays[i].spread = 0.05 * (double)(i % 3);
                if (i % 211 == 17) rays[i].direction.z = NAN;
            }
            svo_scene_trace(s.bvh, rays, RAYS, hits);
            svo_scene_blocked_many(s.bvh, rays, RAYS, blocked);
            for (uint32_t i = 0; i < RAYS && !test_failed(); i++) {
                memset(&one, 0, sizeof one);
                svo_scene_trace(s.bvh, &rays[i], 1, &one);
                CHECK_MSG(memcmp(&one.node, &hits[i].node, sizeof one.node) == 0 && (!one.node.hit || one.item == hits[i].item), "round %d kind %d ray %u: hit %d %d t %a %a item %u %u", round, kind, i,
                          hits[i].node.hit, one.node.hit, hits[i].node.t, one.node.t, hits[i].item, one.item);
                CHECK(blocked[i] == one.node.hit && svo_scene_blocked(s.bvh, &rays[i]) == one.node.hit);
                met += one.node.hit;
            }
        }
        stage_end(&s);
    }
    CHECK(met > 2000);
    /* every allocation may fail */
    stage s;
    stage_begin(&s, 2);
    stage_asset(&s, make_blob(5, 0.4, 0.03, NULL));
    stage_asset(&s, make_blob(4, 0.2, 0.3, NULL));
    svo_mat4 m = svo_mat4_identity();
    stage_instance(&s, 0, &m), m.m[3] = 3, stage_instance(&s, 1, &m);
    if (!stage_build(&s, 1, 0, 1)) return;
    for (uint64_t fail = 1;; fail++) {
        svo_limit_allocator a;
        svo_bvh *b = NULL;
        svo_error err;
        svo_rays_options o = svo_default_rays_options();
        svo_limit_allocator_init(&a, 1 << 30, NULL);
        CHECK_OK(svo_bvh_build(&s.scene, 1, &a.base, NULL, &b, NULL, &err));
        o.allocator = &a.base;
        a.fail_at = a.count + fail;
        svo_result r = svo_bvh_use_rays(b, &o, NULL, &err);
        CHECK(r == SVO_OK || r == SVO_OUT_OF_MEMORY);
        svo_bvh_free(b);
        CHECK_U64(svo_limit_in_use(&a), 0);
        if (r == SVO_OK || test_failed()) break;
    }
    stage_end(&s);
}

TEST(many_instances_almost_at_one_place)
{
    stage s;
    uint64_t seed = 4;
    stage_begin(&s, 3000);
    stage_asset(&s, make_blob(4, 0.3, 0.1, NULL));
    for (int i = 0; i < 3000; i++) {
        svo_mat4 m = svo_mat4_identity();
        m.m[3] = i % 3 == 0 ? 0 : 1e-4 * test_random_unit(&seed);
        m.m[7] = 1e-4 * (i / 2);
        stage_instance(&s, 0, &m);
    }
    if (!stage_build(&s, 1, 0, 1)) return;
    for (int i = 0; i < 60; i++) {
        svo_scene_ray r = random_ray(&seed, 8);
        r.origin = svo_add(r.origin, svo_v3(8, 8, 40)), r.direction = svo_v3(0.02 * i - 0.6, 0.1, -2);
        svo_scene_hit h;
        svo_hit want;
        uint64_t instance = 0;
        svo_scene_trace(s.bvh, &r, 1, &h);
        bool hit = slow_trace(&s.scene, &r, &want, &instance);
        CHECK(hit == h.node.hit);
        if (hit) CHECK(svo_bvh_item(s.bvh, h.item)->instance == instance && h.node.t == want.t);
    }
    stage_end(&s);
}

TEST(hierarchy_survives_failing_allocations)
{
    stage s;
    uint64_t seed = 2;
    stage_begin(&s, 50);
    stage_asset(&s, make_blob(3, 0.3, 0.1, NULL));
    for (int i = 0; i < 50; i++) {
        svo_mat4 m = random_transform(&seed, 10);
        stage_instance(&s, 0, &m);
    }
    if (!stage_build(&s, 1, 0, 1)) return;
    for (uint64_t fail = 1;; fail++) {
        svo_limit_allocator a;
        svo_error err;
        svo_bvh *b = NULL;
        svo_limit_allocator_init(&a, 1 << 30, NULL);
        a.fail_at = fail;
        svo_result r = svo_bvh_build(&s.scene, 1, &a.base, NULL, &b, NULL, &err);
        if (r == SVO_OK) {
            CHECK(fail > 4);
            svo_bvh_free(b);
            CHECK_U64(svo_limit_in_use(&a), 0);
            break;
        }
        CHECK(r == SVO_OUT_OF_MEMORY && b == NULL);
        CHECK_U64(svo_limit_in_use(&a), 0);
    }
    stage_end(&s);
}

/* ---- cameras ------------------------------------------------------------------------------------------------------- */

static bool project(const svo_eye *e, double aspect, svo_vec3 p, double *x, double *y)
{
    svo_vec3 d = svo_sub(p, e->position);
    double z = svo_dot(d, e->forward), t = tan(0.5 * e->yfov);
    *x = svo_dot(d, e->right) / z / (t * aspect), *y = svo_dot(d, e->up) / z / t;
    return z > 0;
}

TEST(framing_holds_the_box)
{
    uint64_t seed = 3;
    for (int i = 0; i < 2000; i++) {
        double low[3], high[3], size = exp2(60 * test_random_unit(&seed) - 30), aspect = exp2(6 * test_random_unit(&seed) - 3);
        double fov = i % 5 == 0 ? 1e-3 : i % 5 == 1 ? 3.124 : 0.01 + 2.5 * test_random_unit(&seed), most = 0, x, y;
        for (int k = 0; k < 3; k++) {
            low[k] = size * 100 * (test_random_unit(&seed) - 0.5);
            high[k] = low[k] + size * (i % 7 == k ? 0 : test_random_unit(&seed));
        }
        svo_eye e = svo_eye_frame(low, high, aspect, fov);
        for (int c = 0; c < 8; c++) {
            CHECK(project(&e, aspect, svo_v3(c & 1 ? high[0] : low[0], c & 2 ? high[1] : low[1], c & 4 ? high[2] : low[2]), &x, &y));
            CHECK_MSG(fabs(x) < 0.96 && fabs(y) < 0.96, "corner at %g %g, aspect %g fov %g", x, y, aspect, fov);
            most = fmax(most, fmax(fabs(x), fabs(y)));
        }
        /* and fills the picture, where it is the box that decides */
        if (fov < 1.5 && i % 7 > 2) CHECK_MSG(most > 0.90, "only %g of the picture, fov %g aspect %g", most, fov, aspect);
    }
    /* a point, and no box at all */
    double p[3] = {5, 5, 5}, q[3] = {NAN, 0, INFINITY};
    svo_eye e = svo_eye_frame(p, p, 1, 0.7);
    CHECK(isfinite(e.position.x) && svo_length(svo_sub(e.position, svo_v3(5, 5, 5))) > 0);
    e = svo_eye_frame(q, q, 1, 0.7);
    CHECK(isfinite(e.position.x) && fabs(svo_length(e.forward) - 1) < 1e-12);
}

TEST(cameras_have_right_handed_axes)
{
    svo_error err;
    svo_eye e;
    uint64_t seed = 4;
    for (int i = 0; i < 200; i++) {
        svo_vec3 from = random_ray(&seed, 10).origin, to = random_ray(&seed, 10).origin, up = i % 4 ? svo_v3(0, 1, 0) : svo_sub(to, from);
        CHECK_OK(svo_eye_look(from, to, up, 1, &e, &err));
        CHECK(svo_length(svo_sub(svo_cross(e.right, e.up), svo_scale(e.forward, -1))) < 1e-12);
        CHECK(svo_length(svo_sub(e.forward, svo_normalize(svo_sub(to, from)))) < 1e-12);
        if (i % 4) CHECK(svo_dot(e.up, up) >= 0);
    }
    svo_vec3 a = {1, 2, 3};
    CHECK_RESULT(svo_eye_look(a, a, a, 1, &e, &err), SVO_INVALID_ARGUMENT);
    CHECK_RESULT(svo_eye_look(a, svo_v3(NAN, 0, 0), a, 1, &e, &err), SVO_INVALID_ARGUMENT);
    /* glTF: looks along -Z, +Y up */
    double t[3] = {1, 2, 3}, q[4] = {0, 0.6, 0, 0.8}, scale[3] = {2, 2, 2};
    svo_mat4 m = svo_mat4_trs(t, q, scale);
    CHECK_OK(svo_eye_from_transform(&m, 0.5, &e, &err));
    CHECK(svo_length(svo_sub(e.forward, svo_normalize(svo_mat4_vector(&m, svo_v3(0, 0, -1))))) < 1e-12);
    CHECK(e.position.x == 1 && e.position.y == 2 && e.position.z == 3);
    memset(m.m, 0, sizeof m.m);
    CHECK_RESULT(svo_eye_from_transform(&m, 0.5, &e, &err), SVO_INVALID_DATA);
}

/* Pixels are where the projection says: rays through the corners and the middle of a picture. */
TEST(rays_go_through_their_pixels)
{
    svo_render_options o = svo_default_render_options();
    svo_error err;
    o.width = 320, o.height = 200;
    CHECK_OK(svo_eye_look(svo_v3(1, 2, 3), svo_v3(4, 4, -5), svo_v3(0, 1, 0), 0.8, &o.eye, &err));
    uint64_t seed = 1;
    for (int i = 0; i < 100; i++) {
        double x = 320 * test_random_unit(&seed), y = 200 * test_random_unit(&seed), px, py, depth = 0.1 + 10 * test_random_unit(&seed);
        svo_scene_ray r = svo_render_ray(&o, x, y);
        CHECK(project(&o.eye, 1.6, svo_add(r.origin, svo_scale(r.direction, depth)), &px, &py));
        CHECK(fabs(0.5 * (px + 1) * 320 - x) < 1e-9 && fabs(0.5 * (1 - py) * 200 - y) < 1e-9);
        CHECK(fabs(svo_dot(r.direction, o.eye.forward) - 1) < 1e-12);
        /* one pixel at depth t */
        CHECK(fabs(r.spread - 2 * tan(0.4) / 200) < 1e-15);
    }
}

/* ---- pictures ------------------------------------------------------------------------------------------------------ */

static uint8_t *picture(stage *s, const svo_render_options *o, svo_render_stats *stats)
{
    svo_error err;
    uint8_t *p = malloc((size_t)o->width * o->height * 4);
    svo_result r = svo_render(s->bvh, &s->scene, o, p, stats, &err);
    if (r != SVO_OK) test_fail(__FILE__, __LINE__, "svo_render: %s", err.message);
    return p;
}

static void frame(stage *s, svo_render_options *o, double fov)
{
    double low[3], high[3];
    if (svo_bvh_bounds(s->bvh, low, high)) o->eye = svo_eye_frame(low, high, (double)o->width / o->height, fov);
}

TEST(the_same_picture_for_any_thread_count)
{
    stage s;
    uint64_t seed = 6;
    stage_begin(&s, 40);
    stage_asset(&s, make_blob(6, 0.4, 0.02, NULL));
    for (int i = 0; i < 40; i++) {
        svo_mat4 m = random_transform(&seed, 400);
        stage_instance(&s, 0, &m);
    }
    if (!stage_build(&s, 4, 0, 3)) return;
    svo_render_options o = svo_default_render_options();
    o.width = 203, o.height = 111, o.measure = true, o.samples = 2;
    frame(&s, &o, 0.7);
    svo_render_stats first, other;
    o.threads = 1;
    uint8_t *a = picture(&s, &o, &first);
    CHECK(first.hits > 5000 && first.lod_stops > 100 && first.blocked > 100 && first.primary == 4 * 203 * 111);
    for (int i = 0; i < 2; i++) {
        o.threads = i == 0 ? 2 : 7;
        uint8_t *b = picture(&s, &o, &other);
        CHECK(memcmp(a, b, 4 * 203 * 111) == 0);
        CHECK(first.hits == other.hits && first.shadow == other.shadow && first.blocked == other.blocked && first.stop_max == other.stop_max &&
              first.parent_min == other.parent_min && memcmp(first.levels, other.levels, sizeof first.levels) == 0);
        free(b);
    }
    free(a);
    stage_end(&s);
}

/* The stop rule over whole pictures, at every distance. */
TEST(stopped_nodes_are_below_a_pixel_and_their_parents_not)
{
    for (int i = 0; i < 8; i++) {
        stage s;
        uint64_t seed = (uint64_t)i;
        stage_begin(&s, 2);
        stage_asset(&s, make_blob(6, 0.4, 0.02, NULL));
        svo_mat4 m = random_transform(&seed, 1);
        stage_instance(&s, 0, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        svo_render_options o = svo_default_render_options();
        svo_render_stats st;
        o.width = 128u >> i % 6, o.height = 96u >> i % 6, o.measure = true, o.footprint = i == 7 ? 3.5 : 1;
        frame(&s, &o, 0.5);
        free(picture(&s, &o, &st));
        CHECK(st.hits > 0);
        CHECK_MSG(st.stop_max <= o.footprint * (1 + 1e-12), "a node %g samples wide", st.stop_max);
        CHECK_MSG(st.parent_min > o.footprint * (1 - 1e-12), "a parent %g samples wide", st.parent_min);
        if (i % 6 > 2) CHECK(st.lod_stops > 0);
        /* never above the finest voxels without a footprint */
        o.footprint = 0;
        free(picture(&s, &o, &st));
        CHECK(st.lod_stops == 0 && st.levels[6] == st.hits);
        stage_end(&s);
    }
}

/* A voxel that fills the picture shows exactly its colour when the light comes from the eye and there is no ambient. */
static void one_color(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    (void)x, (void)y, (void)z;
    memcpy(out, (uint8_t *)user + 3 * channel, 3);
}

TEST(colours_come_through_exactly)
{
    uint8_t value[6] = {200, 17, 90, 0, 0, 0};
    uint64_t code = 0;
    for (int emissive = 0; emissive < 2; emissive++) {
        packer_options p = {.channel_count = 2, .value = one_color, .user = value,
                            .channels = {{.name = "color", .kind = SVO_KIND_COLOR_SRGB8}, {.name = "emissive", .kind = SVO_KIND_COLOR_SRGB8}}};
        if (emissive) memcpy(value + 3, (uint8_t[]){0, 255, 30}, 3);
        stage s;
        stage_begin(&s, 1);
        stage_asset(&s, packer_make(0, &code, 1, &p));
        svo_mat4 m = svo_mat4_identity();
        stage_instance(&s, 0, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        svo_render_options o = svo_default_render_options();
        svo_error err;
        o.width = 8, o.height = 8, o.ambient = 0, o.light = svo_v3(0, 0, 5);
        CHECK_OK(svo_eye_look(svo_v3(0.5, 0.5, 3), svo_v3(0.5, 0.5, 0), svo_v3(0, 1, 0), 0.2, &o.eye, &err));
        uint8_t *a = picture(&s, &o, NULL);
        uint8_t want[3] = {200, 17, 90};
        if (emissive) want[1] = 255, want[2] = svo_linear_to_srgb(svo_srgb_to_linear(90) + svo_srgb_to_linear(30));
        for (int i = 0; i < 64; i++) CHECK_MSG(memcmp(a + 4 * i, want, 3) == 0 && a[4 * i + 3] == 255, "pixel %d: %u %u %u", i, a[4 * i], a[4 * i + 1], a[4 * i + 2]);
        free(a);
        /* light from the side: black, and only the emission is left */
        o.light = svo_v3(1, 0, 0);
        a = picture(&s, &o, NULL);
        CHECK(a[0] == 0 && a[1] == value[4] && a[2] == value[5]);
        free(a);
        /* inside the voxel */
        o.width = o.height = 1;
        o.eye.position = svo_v3(0.5, 0.5, 0.5), o.light = svo_v3(0, 0, 1), o.shadows = false;
        a = picture(&s, &o, NULL);
        CHECK(memcmp(a, want, 3) == 0);
        free(a);
        stage_end(&s);
    }
}

TEST(background_and_transparency)
{
    stage s;
    stage_begin(&s, 1);
    stage_asset(&s, make_blob(5, 0.25, 0.25, NULL));
    svo_mat4 m = svo_mat4_identity();
    stage_instance(&s, 0, &m);
    if (!stage_build(&s, 1, 0, 1)) return;
    svo_render_options o = svo_default_render_options();
    svo_render_stats st;
    o.width = 64, o.height = 64, o.transparent = true;
    frame(&s, &o, 0.7);
    uint8_t *a = picture(&s, &o, &st);
    uint64_t covered = 0;
    for (int i = 0; i < 64 * 64; i++) {
        CHECK(a[4 * i + 3] == 0 || a[4 * i + 3] == 255);
        covered += a[4 * i + 3] == 255;
    }
    CHECK_U64(covered, st.hits);
    o.samples = 4;
    uint8_t *b = picture(&s, &o, &st);
    double sum = 0, between = 0;
    for (int i = 0; i < 64 * 64; i++) sum += b[4 * i + 3] / 255.0, between += b[4 * i + 3] != 0 && b[4 * i + 3] != 255;
    CHECK(fabs(sum - (double)st.hits / 16) < 8 && between > 20);
    free(a), free(b);
    stage_end(&s);
}

TEST(extreme_pictures)
{
    stage s;
    stage_begin(&s, 1);
    stage_asset(&s, make_blob(5, 0.25, 0.25, NULL));
    svo_mat4 m = svo_mat4_identity();
    stage_instance(&s, 0, &m);
    if (!stage_build(&s, 1, 0, 1)) return;
    svo_render_options o = svo_default_render_options();
    svo_render_stats st;
    svo_error err;
    struct { uint32_t w, h; double fov; } cases[] = {{1, 1, 0.7}, {1, 301, 0.7}, {301, 1, 0.7}, {40, 40, 1e-3 * 0.0174533}, {41, 41, 179 * 0.0174533}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        o.width = cases[i].w, o.height = cases[i].h, o.measure = true;
        frame(&s, &o, cases[i].fov);
        if (i == 4) CHECK_OK(svo_eye_look(svo_v3(16, 16, 34), svo_v3(16, 16, 0), svo_v3(0, 1, 0), cases[i].fov, &o.eye, &err)); /* almost touching */
        free(picture(&s, &o, &st));
        CHECK_U64(st.primary, (uint64_t)cases[i].w * cases[i].h);
        CHECK_MSG(st.hits > 0 && st.stop_max <= 1 + 1e-9 && st.parent_min > 1 - 1e-9, "case %zu: %llu hits, edges %g and %g", i,
                  (unsigned long long)st.hits, st.stop_max, st.parent_min);
    }
    uint8_t pixel[4];
    o.width = 65537;
    CHECK_RESULT(svo_render(s.bvh, &s.scene, &o, pixel, NULL, &err), SVO_LIMIT);
    o.width = 65536, o.height = 65536;
    CHECK_RESULT(svo_render(s.bvh, &s.scene, &o, pixel, NULL, &err), SVO_LIMIT);
    o.width = o.height = 1, o.light = svo_v3(0, 0, 0);
    CHECK_RESULT(svo_render(s.bvh, &s.scene, &o, pixel, NULL, &err), SVO_INVALID_ARGUMENT);
    stage_end(&s);
    /* nothing in the scene: the background */
    stage_begin(&s, 0);
    if (!stage_build(&s, 1, 0, 1)) return;
    o = svo_default_render_options();
    o.width = 3, o.height = 2;
    uint8_t *a = picture(&s, &o, &st);
    CHECK(st.hits == 0 && a[0] > 100 && a[3] == 255);
    free(a);
    stage_end(&s);
}

/* ---- shadows ------------------------------------------------------------------------------------------------------- */

static bool voxel_blocks(void *user, uint32_t x, uint32_t y, uint32_t z)
{
    const svo_ray *r = user;
    double p[3] = {x, y, z}, enter = r->t_min, leave = r->t_max;
    for (int k = 0; k < 3; k++) {
        double inv = 1 / r->direction[k], a = (p[k] - r->origin[k]) * inv, b = (p[k] + 1 - r->origin[k]) * inv;
        enter = fmax(enter, fmin(a, b)), leave = fmin(leave, fmax(a, b));
    }
    return enter < leave;
}

/* Shadows of the picture: every shadow ray against every voxel of every instance. */
TEST(shadow_rays_against_every_voxel)
{
    stage s;
    uint64_t seed = 21, lit = 0, dark = 0;
    stage_begin(&s, 5);
    stage_asset(&s, make_blob(4, 0.4, 0.06, NULL));
    uint32_t n = 16;
    for (int i = 0; i < 5; i++) {
        svo_mat4 m = random_transform(&seed, 40);
        /* one, and a smaller one between it and the light */
        if (i < 2) {
            m = svo_mat4_identity();
            svo_vec3 up = svo_scale(svo_normalize(svo_v3(-0.45, 0.85, 0.65)), 14);
            if (i == 1) m.m[0] = m.m[5] = m.m[10] = 0.5, m.m[3] = 4 + up.x, m.m[7] = 4 + up.y, m.m[11] = 4 + up.z;
        }
        stage_instance(&s, 0, &m);
    }
    if (!stage_build(&s, 1, 0, 1)) return;
    svo_render_options o = svo_default_render_options();
    o.width = 60, o.height = 40, o.footprint = 0;
    svo_error err;
    CHECK_OK(svo_eye_look(svo_v3(20, 20, 50), svo_v3(8, 9, 8), svo_v3(0, 1, 0), 0.5, &o.eye, &err));
    svo_vec3 light = svo_normalize(o.light);
    for (int i = 0; i < 60 * 40; i++) {
        svo_scene_ray r = svo_render_ray(&o, i % 60 + 0.5, i / 60 + 0.5), shadow = {.direction = light, .t_max = INFINITY};
        svo_scene_hit h;
        svo_scene_trace(s.bvh, &r, 1, &h);
        if (!h.node.hit) continue;
        svo_vec3 normal = svo_bvh_face_normal(s.bvh, &h);
        if (!(svo_dot(normal, light) > 0)) continue;
        shadow.origin = svo_render_shadow_origin(s.bvh, &h, normal);
        bool want = false;
        for (uint32_t item = 0; item < s.report.placed && !want; item++) {
            svo_ray g = svo_bvh_grid_ray(s.bvh, item, &shadow);
            for (uint32_t z = 0; z < n && !want; z++)
                for (uint32_t y = 0; y < n && !want; y++)
                    for (uint32_t x = 0; x < n && !want; x++) {
                        double dx = x + 0.5 - 8, dy = y + 0.5 - 8, dz = z + 0.5 - 8, d = sqrt(dx * dx + dy * dy + dz * dz) / n;
                        if (fabs(d - 0.4) <= 0.06) want = voxel_blocks(&g, x, y, z);
                    }
        }
        CHECK(svo_scene_blocked(s.bvh, &shadow) == want);
        lit += !want, dark += want;
    }
    CHECK_MSG(lit > 50 && dark > 20, "%llu lit, %llu dark", (unsigned long long)lit, (unsigned long long)dark);
    stage_end(&s);
}

/* A flat surface in any direction, marked conservatively, never shadows itself, at any angle of light, at any level. */
static void plane_value(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    (void)channel, (void)x, (void)y, (void)z;
    const double *n = user;
    float f[3] = {(float)n[0], (float)n[1], (float)n[2]};
    svo_oct32_encode(f, out);
}

TEST(flat_surfaces_do_not_shadow_themselves)
{
    uint64_t seed = 33, tested = 0;
    for (int round = 0; round < 12; round++) {
        double n[3] = {test_random_unit(&seed) - 0.5, 0.2 + test_random_unit(&seed), test_random_unit(&seed) - 0.5};
        if (round == 0) n[0] = n[2] = 0;
        if (round == 1) n[0] = n[1] = n[2] = 1;
        svo_vec3 normal = svo_normalize(svo_v3(n[0], n[1], n[2]));
        n[0] = normal.x, n[1] = normal.y, n[2] = normal.z;
        double at = 16.3 * (n[0] + n[1] + n[2]) + 0.01, reach = 0.5 * (fabs(n[0]) + fabs(n[1]) + fabs(n[2]));
        uint64_t codes[32768], count = 0;
        for (uint32_t z = 0; z < 32; z++)
            for (uint32_t y = 0; y < 32; y++)
                for (uint32_t x = 0; x < 32; x++)
                    if (fabs((x + 0.5) * n[0] + (y + 0.5) * n[1] + (z + 0.5) * n[2] - at) <= reach) codes[count++] = svo_morton_encode(x, y, z);
        packer_options p = {.lod = true, .value = plane_value, .user = n, .channel_count = 1, .channels = {{.name = "normal", .kind = SVO_KIND_NORMAL_OCT32}}};
        stage s;
        stage_begin(&s, 1);
        stage_asset(&s, packer_make(5, codes, count, &p));
        svo_mat4 m = random_transform(&seed, 5); /* any affine map */
        stage_instance(&s, 0, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        svo_render_options o = svo_default_render_options();
        svo_render_stats st;
        svo_error err;
        double low[3], high[3];
        svo_bvh_bounds(s.bvh, low, high);
        svo_vec3 up = svo_normalize(svo_mat4_normal(&m, normal)), middle = {0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])};
        double size = svo_length(svo_sub(svo_v3(high[0], high[1], high[2]), svo_v3(low[0], low[1], low[2])));
        /* light from every side, down to 3 degrees */
        for (int l = 0; l < 8; l++) {
            svo_vec3 side = svo_normalize(svo_cross(up, random_ray(&seed, 1).direction));
            double angle = l == 0 ? 0.05 : 0.05 + 1.4 * test_random_unit(&seed);
            o.light = svo_add(svo_scale(side, cos(angle)), svo_scale(up, sin(angle)));
            o.width = o.height = l % 4 == 3 ? 12 : 64; /* the small ones stop at inner nodes */
            CHECK_OK(svo_eye_look(svo_add(middle, svo_add(svo_scale(up, 2 * size), svo_scale(side, 0.5 * size))), middle, svo_v3(0, 1, 0.1), 0.5, &o.eye, &err));
            free(picture(&s, &o, &st));
            CHECK(st.hits > 10 && st.shadow > 10);
            CHECK_MSG(st.blocked == 0, "round %d: %llu of %llu points in the plane's own shadow", round, (unsigned long long)st.blocked, (unsigned long long)st.shadow);
            tested += st.shadow;
        }
        stage_end(&s);
    }
    CHECK(tested > 10000);
}
