/* What light passes on its way: voxels that cover only a part, and the surface that a shadow ray leaves. The oracles are formulas. */
#include "svo_render.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "stage.h"
#include "svo_morton.h"

typedef struct paint {
    double normal[3];
    uint8_t emissive[3], coverage;
    uint32_t column; /* voxels above a floor, see contact: their x, whose normals are sideways; 0: none */
    uint8_t albedo;
} paint;

static void paint_value(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    const paint *p = user;
    (void)y, (void)z;
    float f[3] = {(float)p->normal[0], (float)p->normal[1], (float)p->normal[2]};
    if (p->column != 0 && y != 8) f[0] = x <= p->column ? -1 : 1, f[1] = f[2] = 0;
    if (channel == 0) memset(out, p->albedo, 3);
    else if (channel == 1) memcpy(out, p->emissive, 3);
    else if (channel == 2) out[0] = p->coverage;
    else svo_oct32_encode(f, out);
}

static svo_view *paint_view(uint32_t depth, const uint64_t *codes, uint64_t count, paint *p)
{
    packer_options o = {.lod = true, .value = paint_value, .user = p, .channel_count = 4,
                        .channels = {{.name = "color", .kind = SVO_KIND_COLOR_SRGB8}, {.name = "emissive", .kind = SVO_KIND_COLOR_SRGB8},
                                     {.name = "coverage", .kind = SVO_KIND_UNORM8}, {.name = "normal", .kind = SVO_KIND_NORMAL_OCT32}}};
    return packer_make(depth, codes, count, &o);
}

/* All voxels that a plane meets: the one through `at` along n, from the middle. */
static svo_view *plane_view(uint32_t depth, paint *p, double at)
{
    uint32_t size = 1u << depth;
    uint64_t *codes = malloc(8 * (uint64_t)size * size * size), count = 0;
    const double *n = p->normal;
    double reach = 0.5 * (fabs(n[0]) + fabs(n[1]) + fabs(n[2]));
    for (uint32_t z = 0; z < size; z++)
        for (uint32_t y = 0; y < size; y++)
            for (uint32_t x = 0; x < size; x++)
                if (fabs((x + 0.5) * n[0] + (y + 0.5) * n[1] + (z + 0.5) * n[2] - at) < reach) codes[count++] = svo_morton_encode(x, y, z);
    svo_view *v = paint_view(depth, codes, count, p);
    free(codes);
    return v;
}

static float *light_of(stage *s, svo_render_options *o, svo_render_stats *stats, uint32_t threads)
{
    svo_error err;
    uint8_t *pixels = malloc((size_t)o->width * o->height * 4);
    float *light = malloc((size_t)o->width * o->height * 16);
    svo_render_planes planes = {.light = light};
    o->threads = threads;
    if (svo_render_with_planes(s->bvh, &s->scene, o, pixels, &planes, stats, &err) != SVO_OK) test_fail(__FILE__, __LINE__, "%s", err.message);
    free(pixels);
    return light;
}

/* Two panes, each an instance of its own, in front of a wall, seen at a slant: what comes through is the product, as for panes without thickness. */
TEST(panes_one_behind_the_other)
{
    static const uint8_t covers[] = {0, 1, 60, 128, 254, 255};
    for (size_t c = 0; c < sizeof covers; c++) {
        paint pane = {{0, 0, 1}, {255, 0, 0}, covers[c], 0, 0}, wall = {{0, 0, 1}, {0, 255, 0}, 255, 0, 0};
        stage s;
        stage_begin(&s, 3);
        stage_asset(&s, plane_view(5, &pane, 16.3));
        stage_asset(&s, plane_view(5, &wall, 16.3));
        svo_mat4 m = svo_mat4_identity();
        m.m[11] = -8; /* the wall */
        stage_instance(&s, 1, &m);
        m.m[11] = 0;
        stage_instance(&s, 0, &m);
        m.m[10] = 0.25, m.m[11] = 20; /* flat, and between others */
        stage_instance(&s, 0, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        svo_error err;
        for (int rays = 0; rays < 2; rays++) {
            if (rays == 1) CHECK_OK(svo_bvh_use_rays(s.bvh, NULL, NULL, &err));
            for (int side = 0; side < 3; side++)
                for (int footprint = 0; footprint < 2; footprint++) {
                    svo_render_options o = svo_default_render_options();
                    svo_render_stats st;
                    o.width = 40, o.height = 30, o.shadows = false, o.ambient = 0, o.footprint = footprint * (side + 0.5), o.light = svo_v3(0, 0, -1);
                    CHECK_OK(svo_eye_look(svo_v3(16 + 9 * side, 17 + 5 * side, 60), svo_v3(16, 16, 16), svo_v3(0, 1, 0), 0.1, &o.eye, &err));
                    float *light = light_of(&s, &o, &st, 1), *other = light_of(&s, &o, &st, 3);
                    CHECK(memcmp(light, other, (size_t)o.width * o.height * 16) == 0);
                    double a = covers[c] / 255.0, red = 1 - (1 - a) * (1 - a), green = (1 - a) * (1 - a);
                    for (uint32_t i = 0; i < o.width * o.height && !test_failed(); i++)
                        CHECK_MSG(fabs(light[4 * i] - red) < 2e-3 && fabs(light[4 * i + 1] - green) < 2e-3 && light[4 * i + 2] == 0 && fabs(light[4 * i + 3] - 1) < 2e-3,
                                  "coverage %u: %g %g %g %g instead of %g %g 0 1", covers[c], light[4 * i], light[4 * i + 1], light[4 * i + 2], light[4 * i + 3], red, green);
                    free(light), free(other);
                }
        }
        stage_end(&s);
    }
}

/* A pane in any direction is several voxels thick along a ray, here more and there fewer, but on the whole it covers what it should (nearly:
 * 1 - (1 - a)^x is not linear in x). */
TEST(slanted_panes_cover_as_much_as_straight_ones)
{
    uint64_t seed = 3;
    for (int round = 0; round < 10; round++) {
        svo_vec3 n = svo_normalize(svo_v3(test_random_unit(&seed) - 0.5, test_random_unit(&seed) - 0.5, 0.1 + test_random_unit(&seed)));
        paint pane = {{n.x, n.y, n.z}, {255, 255, 255}, 100, 0, 0};
        stage s;
        stage_begin(&s, 1);
        stage_asset(&s, plane_view(6, &pane, 32 * (n.x + n.y + n.z)));
        svo_mat4 m = svo_mat4_identity();
        m.m[0] = 3, m.m[5] = 2, m.m[1] = 0.4;
        stage_instance(&s, 0, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        svo_vec3 middle = svo_mat4_point(&m, svo_v3(32, 32, 32)), up = svo_normalize(svo_mat4_normal(&m, n));
        svo_render_options o = svo_default_render_options();
        svo_render_stats st;
        svo_error err;
        o.width = o.height = 64, o.shadows = false, o.ambient = 0, o.footprint = round % 2;
        svo_vec3 eye = svo_add(middle, svo_add(svo_scale(up, 200), svo_v3(150 * test_random_unit(&seed), 100 * test_random_unit(&seed), 0)));
        CHECK_OK(svo_eye_look(eye, middle, svo_v3(0, 1, 0.1), 0.05, &o.eye, &err));
        float *light = light_of(&s, &o, &st, 1);
        double sum = 0, a = 100 / 255.0;
        for (uint32_t i = 0; i < o.width * o.height; i++) sum += light[4 * i + 3];
        sum /= o.width * o.height;
        CHECK_MSG(fabs(sum - a) < 0.05 * a, "round %d: mean coverage %g instead of %g", round, sum, a);
        free(light);
        stage_end(&s);
    }
}

/* Light through a pane onto a floor is as much less as the pane covers, and no less beside it. */
TEST(panes_cast_light_shadows)
{
    for (int covers = 0; covers <= 255; covers += 51) {
        paint pane = {{0, 1, 0}, {0, 0, 0}, (uint8_t)covers, 0, 0}, floor = {{0, 1, 0}, {0, 0, 0}, 255, 0, 255};
        stage s;
        stage_begin(&s, 2);
        stage_asset(&s, plane_view(5, &floor, 8.5));
        stage_asset(&s, plane_view(4, &pane, 8.5));
        svo_mat4 m = svo_mat4_identity();
        stage_instance(&s, 0, &m);
        m.m[3] = 8, m.m[7] = 12, m.m[11] = 8;
        stage_instance(&s, 1, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        svo_render_options o = svo_default_render_options();
        svo_render_stats st;
        svo_error err;
        o.width = o.height = 64, o.ambient = 0, o.footprint = 0, o.light = svo_v3(0, 1, 0);
        CHECK_OK(svo_eye_look(svo_v3(8, 12, 16), svo_v3(8, 0, 16.01), svo_v3(0, 0, 1), 1.2, &o.eye, &err)); /* between the two, below the edge at x = 8 */
        float *light = light_of(&s, &o, &st, 1);
        uint32_t full = 0, less = 0, other = 0;
        for (uint32_t i = 0; i < 64 * 64; i++) {
            double want = 1 - covers / 255.0;
            if (fabs(light[4 * i] - want) < 2e-3) less++;
            else if (fabs(light[4 * i] - 1) < 2e-3) full++;
            else other++;
        }
        CHECK_MSG(other == 0 && (covers == 0 ? less == 4096 : less > 1500 && full > 1500), "coverage %d: %u, %u, %u", covers, full, less, other);
        free(light);
        stage_end(&s);
    }
}

/* A mirror and a rough floor below a pane and a ceiling: what they get through the pane is mixed as for the eye. */
TEST(panes_in_mirrors_and_bounced_light)
{
    for (int bounce = 0; bounce < 2; bounce++) {
        double first[3] = {0, 0, 0}, last[3] = {0, 0, 0};
        static const uint8_t covers[] = {0, 255, 40, 128, 230};
        for (size_t c = 0; c < sizeof covers; c++) {
            paint floor = {{0, 1, 0}, {0, 0, 0}, 255, 0, bounce ? 255 : 0}, pane = {{0, 1, 0}, {255, 0, 0}, covers[c], 0, 0}, ceiling = {{0, 1, 0}, {0, 255, 0}, 255, 0, 0};
            stage s;
            stage_begin(&s, 3);
            stage_asset(&s, plane_view(5, &floor, 8.5));
            stage_asset(&s, plane_view(5, &pane, 16.3));
            stage_asset(&s, plane_view(5, &ceiling, 16.3));
            svo_mat4 m = svo_mat4_identity();
            for (uint32_t k = 0; k < 3; k++) m.m[7] = 8.0 * k, stage_instance(&s, k, &m);
            if (!stage_build(&s, 1, 0, 1)) return;
            svo_render_options o = svo_default_render_options();
            svo_render_stats st;
            svo_error err;
            o.width = o.height = 32, o.shadows = false, o.ambient = bounce, o.footprint = 0, o.light = svo_v3(0, -1, 0);
            o.bounce = bounce ? 4 : 0, o.reflections = !bounce, o.reflectance = 1;
            CHECK_OK(svo_eye_look(svo_v3(16, 15, 16), svo_v3(16, 0, 16.01), svo_v3(0, 0, 1), 0.3, &o.eye, &err)); /* below the pane */
            float *light = light_of(&s, &o, &st, 1), *other = light_of(&s, &o, &st, 3);
            CHECK(memcmp(light, other, (size_t)o.width * o.height * 16) == 0);
            const double a = covers[c] / 255.0, pixels = (double)o.width * o.height;
            double sum[3] = {0, 0, 0};
            for (uint32_t i = 0; i < o.width * o.height && !test_failed(); i++) {
                for (int k = 0; k < 3; k++) sum[k] += light[4 * i + (uint32_t)k] / pixels;
                if (!bounce) CHECK_MSG(fabs(light[4 * i] - a) < 2e-3 && fabs(light[4 * i + 1] - (1 - a)) < 2e-3, "coverage %u: %g %g", covers[c], light[4 * i], light[4 * i + 1]);
            }
            if (covers[c] == 0) memcpy(first, sum, sizeof first);
            else if (covers[c] == 255) memcpy(last, sum, sizeof last);
            else /* the same rays each time; those through the pane's edge have a shorter way in it */
                for (int k = 0; k < 3; k++) CHECK_MSG(fabs(sum[k] - (a * last[k] + (1 - a) * first[k])) < 0.01, "coverage %u: %g between %g and %g", covers[c], sum[k], first[k], last[k]);
            if (bounce && covers[c] == 255) CHECK(last[0] > first[0] + 0.2 && last[1] < first[1] - 0.1);
            free(light), free(other);
            stage_end(&s);
        }
    }
}

/* A step of one voxel on a floor, and a plate one voxel above it, cast shadows from where they begin. */
TEST(shadows_begin_at_the_next_voxel)
{
    for (int plate = 0; plate < 2; plate++) {
        uint64_t codes[1024 + 64], count = 0;
        for (uint32_t z = 0; z < 32; z++)
            for (uint32_t x = 0; x < 32; x++) codes[count++] = svo_morton_encode(x, 8, z);
        for (uint32_t z = 10; z < 18; z++)
            for (uint32_t x = 14; x < 16; x++) codes[count++] = svo_morton_encode(x, 9 + (uint32_t)plate, z);
        paint p = {{0, 1, 0}, {0, 0, 0}, 255, plate ? 0 : 14, 0};
        stage s;
        stage_begin(&s, 1);
        stage_asset(&s, paint_view(5, codes, count, &p));
        svo_mat4 m = svo_mat4_identity();
        stage_instance(&s, 0, &m);
        if (!stage_build(&s, 1, 0, 1)) return;
        svo_error err;
        /* Look down at the floor; light from +x at 45 degrees. Height of the thing's top above the floor's: 1 (plate: 2), so of the floor's voxels
         * those next to it at -x are dark (of a plate: those below it as well), those at +x are not. */
        for (uint32_t x = 8; x < 24; x++) {
            svo_render_options o = svo_default_render_options();
            svo_render_stats st;
            o.width = o.height = 1, o.footprint = 0, o.light = svo_v3(1, 1.01, 0);
            double from = plate && x >= 14 && x < 16 ? 9.9 : 30;
            CHECK_OK(svo_eye_look(svo_v3(x + 0.5, from, 14.5), svo_v3(x + 0.5, 0, 14.5001), svo_v3(1, 0, 0), 1e-3, &o.eye, &err));
            if (!plate && x >= 14 && x < 16) continue; /* the thing itself */
            free(light_of(&s, &o, &st, 1));
            CHECK_U64(st.shadow, 1);
            bool dark = plate ? x >= 12 && x <= 14 : x == 13; /* from x + 0.5, one voxel along x for one upwards */
            CHECK_MSG((st.blocked == 1) == dark, "plate %d, x %u: %s", plate, x, st.blocked ? "dark" : "lit");
        }
        stage_end(&s);
    }
}
