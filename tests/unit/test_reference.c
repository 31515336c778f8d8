/* The reference that reports measure attributes with, against surfaces whose averages are known by hand, and samples whose errors are. */
#include <math.h>
#include <stdio.h>

#include "svo_color.h"
#include "svoi_reference.h"
#include "voxel_set.h"

typedef struct scene {
    loose_mesh m;
    svo_material materials[2];
    svo_part parts[2];
    svo_image image;
    svo_placement placement;
    svo_grid grid;
    svo_tree_info info;
} scene;

static void add_channel(svo_tree_info *info, const char *name, svo_channel_kind kind)
{
    svo_channel *c = &info->channels[info->channel_count++];
    snprintf(c->name, sizeof c->name, "%s", name);
    c->kind = kind;
}

/* A grid of unit voxels with four channels: colour, normal, roughness, material. */
static void scene_make(scene *s, const double *positions, uint64_t triangles)
{
    memset(s, 0, sizeof *s);
    loose_make(&s->m, positions, triangles);
    for (int i = 0; i < 2; i++) s->materials[i] = svo_material_default();
    s->m.part.material = 0;
    s->m.mesh.materials = s->materials;
    s->m.mesh.material_count = 2;
    s->m.mesh.images = &s->image;
    s->grid = (svo_grid){.size = 1, .depth = 4};
    s->info.depth = 4;
    add_channel(&s->info, "color", SVO_KIND_COLOR_SRGB8);
    add_channel(&s->info, "normal", SVO_KIND_NORMAL_OCT32);
    add_channel(&s->info, "roughness", SVO_KIND_UNORM8);
    add_channel(&s->info, "material", SVO_KIND_ID16);
}
static void scene_free(scene *s)
{
    free(s->image.pixels);
    loose_free(&s->m);
}

/* Errors of one voxel with these values and triangles 0 .. count - 1. */
static void measure(scene *s, uint32_t x, uint32_t y, uint32_t z, uint32_t count, const uint8_t color[3], const float normal[3], uint8_t roughness,
                    uint8_t material, svo_channel_error out[SVO_MAX_CHANNELS])
{
    svo_error err;
    uint32_t list[64];
    svoi_sample v = {.code = svo_morton_encode(x, y, z), .count = count};
    for (uint32_t i = 0; i < count; i++) list[i] = i;
    memcpy(v.values[0], color, 3);
    svo_oct32_encode(normal, v.values[1]);
    v.values[2][0] = roughness;
    v.values[3][0] = material;
    uint64_t measured = 0;
    CHECK_OK(svo_placement_create(&s->m.mesh, NULL, &s->placement, &err));
    CHECK_OK(svoi_reference_measure(&s->placement, &s->grid, &s->info, &v, 1, list, 2, NULL, out, &measured, &err));
    svo_placement_free(&s->placement);
}

static double delta(const uint8_t a[3], const uint8_t b[3])
{
    float la[3], lb[3];
    svo_srgb8_to_lab(a, la);
    svo_srgb8_to_lab(b, lb);
    return svo_delta_e94(la, lb);
}

static const float up[3] = {0, 0, 1};

TEST(known_differences_are_reported)
{
    /* one triangle over the whole floor at z = 3.4 */
    double v[9] = {-20, -20, 3.4, 40, -20, 3.4, -20, 40, 3.4};
    scene s;
    scene_make(&s, v, 1);
    svo_material *m = &s.materials[0];
    m->base_color[0] = 0.5f, m->base_color[1] = 0.25f, m->base_color[2] = 0.125f;
    m->roughness = 0.2f;
    uint8_t right[3] = {svo_linear_to_srgb(0.5f), svo_linear_to_srgb(0.25f), svo_linear_to_srgb(0.125f)}, wrong[3] = {200, 20, 90};
    svo_channel_error e[SVO_MAX_CHANNELS];
    measure(&s, 2, 5, 3, 1, right, up, 51, 0, e);
    CHECK(e[0].voxels == 1 && e[0].max == 0 && e[1].max < 0.01 && e[2].max < 1e-6 && e[3].max == 0);
    for (int degrees = 5; degrees < 180; degrees += 25) {
        float tilted[3] = {(float)sin(degrees * M_PI / 180), 0, (float)cos(degrees * M_PI / 180)};
        measure(&s, 2, 5, 3, 1, wrong, tilted, 153, 1, e);
        CHECK_MSG(fabs(e[1].max - degrees) < 0.01 && e[1].mean == e[1].max, "%d degrees measured as %f", degrees, e[1].max);
    }
    CHECK(fabs(e[0].max - delta(right, wrong)) < 1e-6 && fabs(e[2].max - 0.4) < 1e-6 && e[3].max == 1);
    scene_free(&s);
}

TEST(areas_weigh_materials)
{
    /* the voxel's floor plane cut at x = 2.75: three quarters of one material, a quarter of the other; the second one stands upright and is as
     * high as 0.5, so normals weigh 1 to 0.5 */
    double v[36] = {2, 5, 3.5, 2.75, 5, 3.5, 2.75, 6, 3.5, 2, 5, 3.5, 2.75, 6, 3.5, 2, 6, 3.5,
                    2.75, 5, 3.5, 3, 5, 3.5, 3, 6, 3.5, 2.75, 5, 3.5, 3, 6, 3.5, 2.75, 6, 3.5};
    scene s;
    scene_make(&s, v, 4);
    for (int i = 0; i < 2; i++) s.parts[i] = s.m.part, s.parts[i].material = (uint32_t)i, s.parts[i].triangle_count = 2;
    s.parts[1].indices += 6;
    s.m.shape.parts = s.parts;
    s.m.shape.part_count = 2;
    for (int i = 0; i < 3; i++) s.materials[0].base_color[i] = 0.8f, s.materials[1].base_color[i] = 0.1f;
    s.materials[0].roughness = 0.4f, s.materials[1].roughness = 0.8f;
    uint8_t grey = svo_linear_to_srgb(0.75f * 0.8f + 0.25f * 0.1f), mixed[3] = {grey, grey, grey};
    svo_channel_error e[SVO_MAX_CHANNELS];
    measure(&s, 2, 5, 3, 4, mixed, up, (uint8_t)(255 * 0.5 + 0.5), 0, e);
    CHECK(e[0].max < 0.02 && e[1].max < 0.01 && e[2].max < 0.003 && e[3].max == 0);
    scene_free(&s);
}

TEST(textures_and_colours_are_averaged_in_linear_light)
{
    /* 64 checks of black and white in a voxel, seen at 45 degrees: half the light; times a gradient from 0 to 1 across it: a quarter */
    double v[18] = {2, 5, 3, 3, 5, 4, 3, 6, 4, 2, 5, 3, 3, 6, 4, 2, 6, 3};
    float uv[12] = {0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1};
    scene s;
    scene_make(&s, v, 2);
    s.m.part.uvs[0] = malloc(sizeof uv);
    memcpy(s.m.part.uvs[0], uv, sizeof uv);
    s.image = (svo_image){.width = 8, .height = 8, .pixels = malloc(256)};
    for (int i = 0; i < 64; i++) memset(s.image.pixels + 4 * i, (i ^ i / 8) & 1 ? 255 : 0, 3), s.image.pixels[4 * i + 3] = 255;
    s.materials[0].base_color_texture.image = 0;
    s.m.mesh.image_count = 1;
    float tilted[3] = {-0.70710678f, 0, 0.70710678f};
    svo_channel_error e[SVO_MAX_CHANNELS];
    for (int nearest = 0; nearest < 2; nearest++) {
        s.materials[0].base_color_texture.nearest = nearest;
        uint8_t half = svo_linear_to_srgb(0.5f), expected[3] = {half, half, half};
        measure(&s, 2, 5, 3, 2, expected, tilted, 255, 0, e);
        CHECK_MSG(e[0].max < 0.5 && e[1].max < 0.01, "half: %f, %f degrees", e[0].max, e[1].max);
    }
    s.m.part.colors = malloc(6 * 16);
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 4; k++) s.m.part.colors[4 * i + k] = k < 3 ? uv[2 * i] : 1;
    uint8_t quarter = svo_linear_to_srgb(0.25f), expected[3] = {quarter, quarter, quarter};
    measure(&s, 2, 5, 3, 2, expected, tilted, 255, 0, e);
    CHECK_MSG(e[0].max < 0.7, "a quarter: %f", e[0].max);
    scene_free(&s);
}

TEST(the_sample_does_not_depend_on_threads)
{
    double v[90];
    uint64_t seed = 3;
    for (int i = 0; i < 90; i++) v[i] = (double)(test_random(&seed) % 1000) / 100;
    loose_mesh m;
    loose_make(&m, v, 10);
    float *colors = m.part.colors = malloc(30 * 16);
    for (int i = 0; i < 120; i++) colors[i] = (float)(test_random(&seed) % 256) / 255;
    voxel_set s[2];
    svo_error err;
    for (int k = 0; k < 2; k++) {
        svo_voxelize_options o = svo_default_voxelize_options();
        o.depth = 8 + 1;
        o.channels = SVO_WANT_COLOR | SVO_WANT_NORMAL;
        o.threads = k == 0 ? 1 : 4;
        o.reference_voxels = 300;
        CHECK_OK(voxel_run(&m.mesh, &o, true, &s[k], &err));
    }
    CHECK(s[0].report.reference_voxels > 250 && s[0].report.reference_voxels <= 300);
    CHECK_U64(s[0].report.reference_voxels, s[1].report.reference_voxels);
    CHECK(memcmp(s[0].report.attribute_errors, s[1].report.attribute_errors, sizeof s[0].report.attribute_errors) == 0);
    printf("        random triangles: colour mean %.4f max %.3f, normals mean %.4f max %.3f\n", s[0].report.attribute_errors[0].mean,
           s[0].report.attribute_errors[0].max, s[0].report.attribute_errors[1].mean, s[0].report.attribute_errors[1].max);
    CHECK(s[0].report.attribute_errors[0].mean < 0.1 && s[0].report.attribute_errors[1].mean < 0.1);
    for (int k = 0; k < 2; k++) voxel_free(&s[k]);
    loose_free(&m);
}
