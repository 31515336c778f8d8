/* Attributes of voxels against a slow reference: many points spread evenly over every triangle, each read at full resolution and
 * put into the voxel it lies in. */
#include <math.h>
#include <stdio.h>

#include "svo_color.h"
#include "svo_shade.h"
#include "svo_texture.h"
#include "voxel_set.h"

static svo_voxelize_options at_depth(uint32_t depth, uint32_t channels)
{
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.channels = channels;
    o.threads = 2;
    return o;
}

/* Sums of one voxel. */
typedef struct reference {
    double samples, color_weight, color[3], normal[3], emissive[3], rough, metal, material[2];
} reference;

/* A wavy sheet of squares over [0,1]^2, smooth normals, colours and texture coordinates. */
typedef struct sheet {
    loose_mesh m;
    svo_material materials[2];
    svo_part parts[2];
    svo_image images[3];
} sheet;

static double height_at(double x, double y) { return 0.2 * sin(5 * x) * cos(4 * y) + 0.25; }

static void sheet_make(sheet *s, uint32_t n, double repeat)
{
    memset(s, 0, sizeof *s);
    double *v = malloc(72 * 2 * (size_t)n * n);
    float *uv = malloc(24 * 2 * (size_t)n * n), *normal = malloc(36 * 2 * (size_t)n * n), *color = malloc(48 * 2 * (size_t)n * n);
    uint64_t t = 0;
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++)
            for (int half = 0; half < 2; half++, t++)
                for (int c = 0; c < 3; c++) {
                    static const int corner[2][3] = {{0, 1, 3}, {0, 3, 2}};
                    int k = corner[half][c];
                    double px = (x + (k & 1)) / (double)n, py = (y + (k >> 1)) / (double)n;
                    uint64_t i = 3 * t + (uint64_t)c;
                    v[3 * i] = px, v[3 * i + 1] = height_at(px, py), v[3 * i + 2] = py;
                    uv[2 * i] = (float)(repeat * px), uv[2 * i + 1] = (float)(repeat * py);
                    normal[3 * i] = (float)cos(9 * px), normal[3 * i + 1] = 2, normal[3 * i + 2] = (float)sin(7 * py);
                    color[4 * i] = (float)px, color[4 * i + 1] = (float)py, color[4 * i + 2] = 0.5f, color[4 * i + 3] = (float)(0.2 + 0.8 * px);
                }
    loose_make(&s->m, v, t);
    free(v);
    s->m.part.uvs[0] = uv;
    s->m.part.normals = normal;
    s->m.part.colors = color;
    for (int i = 0; i < 2; i++) s->materials[i] = svo_material_default();
    s->m.part.material = 0;
    s->m.mesh.materials = s->materials;
    s->m.mesh.material_count = 2;
    s->m.mesh.images = s->images;
}
static void sheet_image(sheet *s, uint32_t width, uint32_t height, uint64_t seed, bool smooth)
{
    svo_image *image = &s->images[s->m.mesh.image_count++];
    image->width = width;
    image->height = height;
    image->pixels = malloc((size_t)width * height * 4);
    for (size_t i = 0; i < (size_t)width * height; i++)
        for (size_t k = 0; k < 4; k++) {
            double x = (double)(i % width) / width, y = (double)(i / width) / height;
            double wave = 127.5 + 127 * sin(2 * M_PI * (x * (double)(k + 1) + y * (double)(3 - (k % 3))));
            image->pixels[4 * i + k] = smooth ? (uint8_t)wave : (uint8_t)test_random(&seed);
        }
}
static void sheet_free(sheet *s)
{
    for (uint32_t i = 0; i < s->m.mesh.image_count; i++) free(s->images[i].pixels);
    loose_free(&s->m);
}

static double delta(const uint8_t a[3], const uint8_t b[3])
{
    float la[3], lb[3];
    svo_srgb8_to_lab(a, la);
    svo_srgb8_to_lab(b, lb);
    return svo_delta_e94(la, lb);
}

/* The tolerances, in CIE94 units (colours), degrees and units of 1/255. */
typedef struct tolerance { double color_mean, color_max, normal_max, other_max; } tolerance;

static void compare(sheet *sh, uint32_t depth, tolerance allowed, const char *what)
{
    svo_voxelize_options o = at_depth(depth, SVO_WANT_COLOR | SVO_WANT_NORMAL | SVO_WANT_EMISSIVE | SVO_WANT_METALLIC | SVO_WANT_ROUGHNESS | SVO_WANT_MATERIAL);
    voxel_set s;
    svo_error err;
    CHECK_OK(voxel_run(&sh->m.mesh, &o, true, &s, &err));
    reference *sums = calloc(s.count, sizeof *sums);
    svo_pyramid pyramids[4];
    svo_mesh *mesh = &sh->m.mesh;
    const double *w = s.info.voxel_to_world;
    for (uint32_t pi = 0; pi < sh->m.shape.part_count; pi++) {
        const svo_part *p = &sh->m.shape.parts[pi];
        const svo_material *m = &mesh->materials[p->material];
        bool weighted = m->alpha_mode != SVO_ALPHA_OPAQUE;
        const svo_texture *how[4] = {&m->base_color_texture, &m->opacity_texture, &m->emissive_texture, &m->metallic_roughness_texture};
        const svo_texel kinds[4] = {weighted ? SVO_TEXEL_COLOR_ALPHA : SVO_TEXEL_COLOR, SVO_TEXEL_LINEAR, SVO_TEXEL_COLOR, SVO_TEXEL_LINEAR};
        for (int k = 0; k < 4; k++)
            if (how[k]->image != SVO_NONE) CHECK_OK(svo_pyramid_create(&mesh->images[how[k]->image], kinds[k], NULL, &pyramids[k], &err));
        for (uint64_t t = 0; t < p->triangle_count; t++) {
            const uint32_t *index = p->indices + 3 * t;
            double size = 0, area[3];
            const double *c[3];
            for (int k = 0; k < 3; k++) c[k] = p->positions + 3 * (size_t)index[k];
            for (int k = 0; k < 3; k++) {
                int i = (k + 1) % 3, j = (k + 2) % 3;
                area[k] = (c[1][i] - c[0][i]) * (c[2][j] - c[0][j]) - (c[1][j] - c[0][j]) * (c[2][i] - c[0][i]);
                size += area[k] * area[k] / (w[0] * w[0]) / (w[0] * w[0]);
            }
            /* about 1600 samples a voxel face */
            int steps = (int)(40 * sqrt(sqrt(size))) + 3;
            double share = sqrt(size) / ((double)steps * steps); /* of a sample, in voxel faces */
            for (int a = 0; a < steps; a++)
                for (int b = 0; b < 2 * (steps - a) - 1; b++) { /* centroids of the steps^2 small triangles */
                    double x = (a + (b & 1 ? 2.0 / 3 : 1.0 / 3)) / steps, y = (b / 2 + (b & 1 ? 2.0 / 3 : 1.0 / 3)) / steps;
                    double bary[3] = {1 - x - y, x, y}, at[3] = {0, 0, 0}, n[3] = {0, 0, 0}, uv[2] = {0, 0}, color[4] = {0, 0, 0, 0};
                    for (int k = 0; k < 3; k++) {
                        const float *nk = p->normals + 3 * (size_t)index[k];
                        double length = sqrt((double)(nk[0] * nk[0] + nk[1] * nk[1] + nk[2] * nk[2]));
                        for (int i = 0; i < 3; i++) at[i] += bary[k] * c[k][i], n[i] += bary[k] * (double)nk[i] / length;
                        for (int i = 0; i < 2; i++) uv[i] += bary[k] * (double)p->uvs[0][2 * (size_t)index[k] + (size_t)i];
                        for (int i = 0; i < 4; i++) color[i] += bary[k] * (p->colors != NULL ? (double)p->colors[4 * (size_t)index[k] + (size_t)i] : 1);
                    }
                    uint32_t g[3];
                    for (int i = 0; i < 3; i++) {
                        double cell = floor((at[i] - w[4 * i + 3]) / w[0]), most = ldexp(1, (int)depth) - 1;
                        g[i] = (uint32_t)(cell < 0 ? 0 : cell > most ? most : cell);
                    }
                    int64_t found = voxel_find(&s, svo_morton_encode(g[0], g[1], g[2]));
                    if (found < 0) continue; /* within the snap of a face, or masked */
                    reference *r = &sums[found];
                    float texel[4][4];
                    for (int k = 0; k < 4; k++) {
                        for (int i = 0; i < 4; i++) texel[k][i] = 1;
                        if (how[k]->image != SVO_NONE) svo_pyramid_sample(&pyramids[k], how[k], uv[0], uv[1], -1, texel[k]);
                    }
                    if (weighted && texel[0][3] > 0)
                        for (int i = 0; i < 3; i++) texel[0][i] /= texel[0][3];
                    double alpha = weighted ? color[3] * (double)(m->base_color[3] * texel[0][3] * texel[1][0]) : 1;
                    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
                    r->samples += share;
                    r->color_weight += share * alpha;
                    for (int i = 0; i < 3; i++) {
                        r->color[i] += share * alpha * color[i] * (double)(m->base_color[i] * texel[0][i]);
                        r->normal[i] += share * n[i] / length;
                        r->emissive[i] += share * (double)(m->emissive[i] * texel[2][i]);
                    }
                    r->rough += share * (double)(m->roughness * texel[3][1]);
                    r->metal += share * (double)(m->metallic * texel[3][2]);
                    r->material[p->material] += share;
                }
        }
        for (int k = 0; k < 4; k++)
            if (how[k]->image != SVO_NONE) svo_pyramid_free(&pyramids[k]);
    }
    double color_sum = 0, color_max = 0, normal_max = 0, other_max = 0, compared = 0;
    for (uint64_t v = 0; v < s.count; v++) {
        const reference *r = &sums[v];
        if (r->samples < 0.15) continue; /* too small a part of the surface for the samples to mean much */
        compared++;
        for (uint32_t ch = 0; ch < s.info.channel_count; ch++) {
            const char *name = s.info.channels[ch].name;
            svo_channel_kind kind = s.info.channels[ch].kind;
            const uint8_t *value = s.info.channels[ch].constant ? s.info.channels[ch].value : s.values[ch] + v * svo_channel_stride(kind);
            if (kind == SVO_KIND_COLOR_SRGB8) {
                uint8_t expected[3];
                bool emissive = strcmp(name, "emissive") == 0;
                for (int i = 0; i < 3; i++)
                    expected[i] = svo_linear_to_srgb((float)(emissive ? r->emissive[i] / r->samples : r->color[i] / r->color_weight));
                double d = delta(expected, value);
                if (!emissive && r->color_weight < 0.02 * r->samples) continue; /* nearly invisible: any colour will do */
                color_sum += emissive ? 0 : d;
                color_max = fmax(color_max, d);
            } else if (kind == SVO_KIND_NORMAL_OCT32) {
                float n[3];
                svo_oct32_decode(value, n);
                double length = sqrt(r->normal[0] * r->normal[0] + r->normal[1] * r->normal[1] + r->normal[2] * r->normal[2]), dot = 0;
                for (int i = 0; i < 3; i++) dot += r->normal[i] * (double)n[i] / length;
                normal_max = fmax(normal_max, acos(fmin(1, dot)) * 180 / M_PI);
            } else if (kind == SVO_KIND_UNORM8) {
                double expected = (strcmp(name, "metallic") == 0 ? r->metal : r->rough) / r->samples;
                other_max = fmax(other_max, fabs(expected * 255 - value[0]));
            } else if (fabs(r->material[0] - r->material[1]) > 0.05) {
                CHECK_U64(value[0], r->material[1] > r->material[0]);
            }
        }
    }
    CHECK(compared > 30);
    printf("        %-28s depth %u: %5.0f voxels, colour mean %.3f max %.3f, normals max %.3f, others max %.2f\n", what, depth, compared,
           color_sum / compared, color_max, normal_max, other_max);
    CHECK_MSG(color_sum / compared <= allowed.color_mean && color_max <= allowed.color_max, "%s: colours", what);
    CHECK_MSG(normal_max <= allowed.normal_max && other_max <= allowed.other_max, "%s: normals or others", what);
    free(sums);
    voxel_free(&s);
}

TEST(vertex_colours_and_normals)
{
    for (uint32_t depth = 3; depth <= 6 && !test_failed(); depth++) {
        sheet s;
        sheet_make(&s, depth == 3 ? 40 : 7, 1);
        s.materials[0].roughness = 0.3f;
        compare(&s, depth, (tolerance){0.05, 1, 0.3, 0.8}, depth == 3 ? "small triangles" : "vertex colours");
        sheet_free(&s);
    }
}

TEST(two_materials_share_voxels)
{
    sheet s;
    sheet_make(&s, 23, 1);
    free(s.m.part.colors);
    s.m.part.colors = NULL;
    s.materials[0].base_color[0] = 0.1f;
    s.materials[0].emissive[1] = 0.4f;
    s.materials[1].metallic = 0.8f;
    s.materials[1].roughness = 0.1f;
    for (int i = 0; i < 2; i++) s.parts[i] = s.m.part, s.parts[i].material = (uint32_t)i;
    s.parts[0].triangle_count = 501;
    s.parts[1].triangle_count -= 501;
    s.parts[1].indices += 3 * 501;
    s.m.shape.part_count = 2;
    s.m.shape.parts = s.parts;
    for (uint32_t depth = 3; depth <= 5 && !test_failed(); depth++) compare(&s, depth, (tolerance){0.02, 2.5, 0.3, 4}, "two materials");
    sheet_free(&s);
}

TEST(textures_are_filtered)
{
    /* smooth image, larger and smaller than the voxels; all four textures; alpha weights */
    for (int k = 0; k < 6 && !test_failed(); k++) {
        sheet s;
        sheet_make(&s, 9, k < 3 ? 1 : 2.3);
        sheet_image(&s, 64, 64, 1, true);
        sheet_image(&s, 50, 33, 2, true);
        svo_material *m = &s.materials[0];
        m->base_color_texture.image = 0;
        m->emissive_texture.image = 1;
        m->emissive[0] = m->emissive[1] = 0.9f;
        m->metallic = 1;
        m->metallic_roughness_texture.image = 1;
        if (k == 2 || k == 5) {
            m->alpha_mode = SVO_ALPHA_BLEND;
            m->opacity_texture.image = 1;
        }
        compare(&s, 4 + (uint32_t)(k % 3), (tolerance){0.7, 9, 0.3, 5}, k % 3 == 2 ? "smooth texture, blended" : "smooth texture");
        sheet_free(&s);
    }
}

TEST(noise_is_averaged_not_picked)
{
    /* white noise far finer than the voxels: the average is grey, a nearest reading would be anything */
    sheet s;
    sheet_make(&s, 9, 1);
    free(s.m.part.colors);
    s.m.part.colors = NULL;
    sheet_image(&s, 512, 512, 7, false);
    s.materials[0].base_color_texture.image = 0;
    for (uint32_t depth = 3; depth <= 5 && !test_failed(); depth++) compare(&s, depth, (tolerance){1.8, 16, 0.3, 0.1}, "noise");
    sheet_free(&s);
}

TEST(masks_remove_what_nobody_sees)
{
    /* a flat square, its texture opaque on the left half only; and a single opaque texel in a coarse grid */
    double v[18] = {0, 0.3, 0, 1, 0.3, 0, 1, 0.3, 1, 0, 0.3, 0, 1, 0.3, 1, 0, 0.3, 1};
    float uv[12] = {0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1};
    loose_mesh m;
    loose_make(&m, v, 2);
    m.part.uvs[0] = malloc(sizeof uv);
    memcpy(m.part.uvs[0], uv, sizeof uv);
    svo_material material = svo_material_default();
    material.alpha_mode = SVO_ALPHA_MASK;
    material.base_color_texture.image = 0;
    material.base_color_texture.wrap_u = material.base_color_texture.wrap_v = SVO_WRAP_CLAMP;
    svo_image image = {.width = 64, .height = 64, .has_alpha = true, .pixels = calloc(64 * 64, 4)};
    m.part.material = 0;
    m.mesh.materials = &material;
    m.mesh.material_count = 1;
    m.mesh.images = &image;
    m.mesh.image_count = 1;
    for (int nearest = 0; nearest < 2; nearest++)
        for (uint32_t depth = 2; depth <= 9; depth++) {
            material.base_color_texture.nearest = nearest;
            for (int i = 0; i < 64 * 64; i++) image.pixels[4 * i] = image.pixels[4 * i + 3] = i % 64 < 32 ? 255 : 0;
            svo_voxelize_options o = at_depth(depth, SVO_WANT_AUTO);
            voxel_set s;
            svo_error err;
            CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
            uint32_t n = 1u << depth, slack = n > 64 ? n / 64 : 1; /* a texel */
            CHECK_MSG(s.count >= (uint64_t)(n / 2) * n && s.count <= (uint64_t)(n / 2 + slack) * n, "depth %u: %llu voxels", depth, (unsigned long long)s.count);
            CHECK_U64(s.count + s.report.masked_voxels, (uint64_t)n * n);
            for (uint64_t i = 0; i < s.count; i++) {
                uint32_t x, y, z;
                svo_morton_decode(s.codes[i], &x, &y, &z);
                CHECK(x < n / 2 + slack);
                CHECK_MSG(s.values[0][3 * i] > 200, "what is hidden darkens voxel %u %u: %u", x, z, s.values[0][3 * i]);
            }
            voxel_free(&s);
            if (depth > 6) continue;
            memset(image.pixels, 0, 64 * 64 * 4);
            memset(image.pixels + 4 * (64 * 40 + 10), 255, 4);
            CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
            CHECK_MSG(s.count >= 1 && s.count <= 16, "one texel: %llu voxels", (unsigned long long)s.count);
            CHECK(voxel_find(&s, svo_morton_encode(10 * n / 64, 0, 40 * n / 64)) >= 0 || depth == 6);
            voxel_free(&s);
            memset(image.pixels, 0, 64 * 64 * 4);
            CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
            CHECK_U64(s.count, 0);
            voxel_free(&s);
        }
    free(image.pixels);
    loose_free(&m);
}

TEST(constant_channels_cost_nothing)
{
    double v[9] = {0, 0, 0, 1, 0, 0, 0, 1, 1};
    loose_mesh m;
    loose_make(&m, v, 1);
    svo_material material = svo_material_default();
    m.part.material = 0;
    m.mesh.materials = &material;
    m.mesh.material_count = 1;
    svo_tree_info info;
    svo_error err;
    svo_voxelize_options o = at_depth(5, SVO_WANT_AUTO);
    CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
    CHECK(info.channel_count == 1 && strcmp(info.channels[0].name, "normal") == 0); /* white says nothing */
    material.base_color[1] = 0;
    material.metallic = 1;
    CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
    CHECK(info.channel_count == 3 && info.channels[0].constant && info.channels[2].constant);
    CHECK(info.channels[0].value[0] == 255 && info.channels[0].value[1] == 0 && info.channels[2].value[0] == 255);
    float paint[12] = {0.5f, 1, 1, 1, 0.5f, 1, 1, 1, 0.5f, 1, 1, 1};
    m.part.colors = paint; /* one colour for all vertices */
    CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
    CHECK(info.channels[0].constant && info.channels[0].value[0] == svo_linear_to_srgb(0.5f) && info.channels[0].value[1] == 0);
    paint[8] = 0.25f;
    CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
    CHECK(!info.channels[0].constant);
    m.part.colors = NULL;
    o.channels = SVO_WANT_COLOR | SVO_WANT_MATERIAL;
    voxel_set s;
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    CHECK(s.info.channel_count == 2 && s.info.channels[1].constant && s.info.channels[1].value[0] == 0 && s.count > 0);
    voxel_free(&s);
    o.channels = 0;
    CHECK_OK(svo_voxelize_plan(&m.mesh, &o, &info, &err));
    CHECK_U64(info.channel_count, 0);
    loose_free(&m);
}

TEST(normals_of_mirrored_and_opposite_sides)
{
    /* a triangle facing +z, mirrored in x: glTF keeps the front, so +z still */
    double v[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    loose_mesh m;
    loose_make(&m, v, 1);
    m.instance.transform.m[0] = -2;
    svo_voxelize_options o = at_depth(4, SVO_WANT_NORMAL);
    voxel_set s;
    svo_error err;
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    for (uint64_t i = 0; i < s.count; i++) {
        float n[3];
        svo_oct32_decode(s.values[0] + 4 * i, n);
        CHECK(n[2] > 0.9999f);
    }
    voxel_free(&s);
    loose_free(&m);
    /* two sheets back to back cancel: one of the two sides, never a zero vector or something else */
    double w[18] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0};
    loose_make(&m, w, 2);
    CHECK_OK(voxel_run(&m.mesh, &o, true, &s, &err));
    for (uint64_t i = 0; i < s.count; i++) {
        float n[3];
        svo_oct32_decode(s.values[0] + 4 * i, n);
        CHECK(fabsf(n[2]) > 0.999f);
    }
    voxel_free(&s);
    loose_free(&m);
}

TEST(points_have_the_values_of_the_surface)
{
    sheet s;
    sheet_make(&s, 5, 1);
    s.materials[0].roughness = 0.3f;
    svo_voxelize_options o = at_depth(4, SVO_WANT_COLOR | SVO_WANT_NORMAL | SVO_WANT_ROUGHNESS | SVO_WANT_MATERIAL);
    svo_tree_info info;
    svo_error err;
    CHECK_OK(svo_voxelize_plan(&s.m.mesh, &o, &info, &err));
    for (uint32_t c = 0; c < info.channel_count; c++) info.channels[c].constant = false; /* ask for them all */
    svo_placement p;
    CHECK_OK(svo_placement_create(&s.m.mesh, NULL, &p, &err));
    svo_grid g = {.size = info.voxel_to_world[0], .depth = info.depth};
    for (int i = 0; i < 3; i++) g.origin[i] = info.voxel_to_world[4 * i + 3];
    svo_shader *shader = NULL;
    CHECK_OK(svo_shader_create(&p, &g, &info, 1, NULL, &shader, &err));
    uint64_t seed = 5;
    for (uint64_t t = 0; shader != NULL && t < p.triangle_count; t++) {
        svo_facet facet;
        svo_facet_make_points(shader, t, &facet);
        for (int n = 0; n < 4; n++) {
            double b[3] = {(double)(test_random(&seed) % 1000), (double)(test_random(&seed) % 1000), (double)(test_random(&seed) % 1000) + 1};
            double sum = b[0] + b[1] + b[2], color[3] = {0, 0, 0}, normal[3] = {0, 0, 0};
            for (int k = 0; k < 3; k++) b[k] /= sum;
            uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE], expected[3];
            svo_facet_point(shader, &facet, b, values);
            for (int k = 0; k < 3; k++) {
                const float *nk = s.m.part.normals + 3 * (3 * t + (uint64_t)k), *ck = s.m.part.colors + 4 * (3 * t + (uint64_t)k);
                double length = sqrt((double)(nk[0] * nk[0] + nk[1] * nk[1] + nk[2] * nk[2]));
                for (int i = 0; i < 3; i++) color[i] += b[k] * (double)ck[i], normal[i] += b[k] * (double)nk[i] / length;
            }
            for (int i = 0; i < 3; i++) expected[i] = svo_linear_to_srgb((float)color[i]);
            float found[3];
            svo_oct32_decode(values[1], found);
            double length = sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]), dot = 0;
            for (int i = 0; i < 3; i++) dot += normal[i] * (double)found[i] / length;
            CHECK(delta(expected, values[0]) < 1 && dot > 0.999999);
            CHECK_U64(values[2][0], 77); /* 0.3 */
            CHECK(values[3][0] == 0 && values[3][1] == 0);
        }
    }
    svo_shader_free(shader);
    svo_placement_free(&p);
    sheet_free(&s);
}

/* A square at height y of [0,1]^2 with corners' texture coordinates at (0,0) and (u,v), material 0, and one image. */
static void square_make(sheet *s, double y, float u, float v, uint32_t width, uint32_t height)
{
    double at[18] = {0, y, 0, 1, y, 0, 1, y, 1, 0, y, 0, 1, y, 1, 0, y, 1};
    float uv[12] = {0, 0, u, 0, u, v, 0, 0, u, v, 0, v};
    memset(s, 0, sizeof *s);
    loose_make(&s->m, at, 2);
    s->m.part.uvs[0] = malloc(sizeof uv);
    memcpy(s->m.part.uvs[0], uv, sizeof uv);
    for (int i = 0; i < 2; i++) s->materials[i] = svo_material_default();
    s->m.part.material = 0;
    s->m.mesh.materials = s->materials;
    s->m.mesh.material_count = 2;
    s->m.mesh.images = s->images;
    s->m.mesh.image_count = 1;
    s->images[0] = (svo_image){.width = width, .height = height, .pixels = calloc((size_t)width * height, 4)};
    s->materials[0].base_color_texture.image = 0;
}
static void paint(sheet *s, uint32_t x, uint32_t y, uint8_t grey, uint8_t alpha)
{
    uint8_t *p = s->images[0].pixels + 4 * ((size_t)y * s->images[0].width + x);
    p[0] = p[1] = p[2] = grey;
    p[3] = alpha;
    if (alpha < 255) s->images[0].has_alpha = true;
}

TEST(stretched_coordinates_keep_detail_along_the_short_axis)
{
    /* 512 texels across one voxel along x, 16 along the other axis: white noise along x, bands 16 texels wide along the other. Voxels of a band are
     * its grey, whatever is averaged along x; blurring across would mix bands. */
    const uint32_t depth = 4, n = 1u << depth;
    sheet s;
    square_make(&s, 0.03, 1, 1, 8192, 16 * n);
    uint64_t seed = 11;
    for (uint32_t y = 0; y < 16 * n; y++)
        for (uint32_t x = 0; x < 8192; x++) paint(&s, x, y, y / 16 % 2 ? 200 : (uint8_t)(test_random(&seed) & 1), 255);
    svo_voxelize_options o = at_depth(depth, SVO_WANT_COLOR);
    voxel_set v;
    svo_error err;
    CHECK_OK(voxel_run(&s.m.mesh, &o, true, &v, &err));
    double worst = 0;
    for (uint64_t i = 0; i < v.count; i++) {
        uint32_t x, y, z;
        svo_morton_decode(v.codes[i], &x, &y, &z);
        double share = (double)svo_srgb_to_linear(v.values[0][3 * i]) / (double)svo_srgb_to_linear(200);
        worst = fmax(worst, z % 2 ? 1 - share : share);
    }
    /* A filter with the variance of the voxel's 16 texels, box or not, has most of its weight there; one level coarser, a third would be its neighbours'. */
    printf("        stretched 1:32: at most %.3f of the light comes from the neighbours\n", worst);
    CHECK(worst < 0.15);
    voxel_free(&v);
    sheet_free(&s);
}

TEST(minified_checks_are_grey)
{
    /* checks of one texel, 8 to 200 a voxel, also at sizes that are no powers of two: half the light everywhere */
    for (uint32_t texels = 128; texels <= 3200; texels = texels * 5 / 2 + 2) {
        sheet s;
        square_make(&s, 0.03, 1, 1, texels, texels);
        for (uint32_t y = 0; y < texels; y++)
            for (uint32_t x = 0; x < texels; x++) paint(&s, x, y, (x ^ y) & 1 ? 255 : 0, 255);
        svo_voxelize_options o = at_depth(4, SVO_WANT_COLOR);
        voxel_set v;
        svo_error err;
        CHECK_OK(voxel_run(&s.m.mesh, &o, true, &v, &err));
        const uint8_t g = svo_linear_to_srgb(0.5f), grey[3] = {g, g, g};
        double worst = 0;
        for (uint64_t i = 0; i < v.count; i++) worst = fmax(worst, delta(grey, v.values[0] + 3 * i));
        CHECK_MSG(worst < 2, "%u texels: %f from grey", texels, worst);
        voxel_free(&v);
        sheet_free(&s);
    }
}

TEST(coverage_is_the_mean_of_alpha)
{
    /* alpha 0 on the left quarter, 64 on the second, 255 on the right half; 64 texels a voxel at depth 2 */
    for (int mode = 0; mode < 3; mode++) {
        sheet s;
        square_make(&s, 0.03, 1, 1, 256, 256);
        s.materials[0].base_color_texture.wrap_u = s.materials[0].base_color_texture.wrap_v = SVO_WRAP_CLAMP;
        for (uint32_t y = 0; y < 256; y++)
            for (uint32_t x = 0; x < 256; x++) paint(&s, x, y, 255, x < 64 ? 0 : x < 128 ? 64 : 255);
        s.materials[0].alpha_mode = (svo_alpha_mode)mode;
        svo_voxelize_options o = at_depth(2, SVO_WANT_AUTO | SVO_WANT_COVERAGE);
        voxel_set v;
        svo_error err;
        CHECK_OK(voxel_run(&s.m.mesh, &o, true, &v, &err));
        uint32_t c = v.info.channel_count - 1;
        CHECK(strcmp(v.info.channels[c].name, "coverage") == 0);
        CHECK(v.info.channels[c].constant == (mode == SVO_ALPHA_OPAQUE));
        CHECK_U64(v.count, mode == SVO_ALPHA_MASK ? 12 : 16); /* masked: at its right end the second quarter reaches a half; BLEND keeps all */
        for (uint64_t i = 0; i < v.count && mode != SVO_ALPHA_OPAQUE; i++) {
            uint32_t x, y, z, expected[4] = {0, 64, 255, 255};
            svo_morton_decode(v.codes[i], &x, &y, &z);
            CHECK_MSG(abs((int)v.values[c][i] - (int)expected[x]) <= 6, "column %u: %u", x, v.values[c][i]);
        }
        if (mode == SVO_ALPHA_OPAQUE) CHECK_U64(v.info.channels[c].value[0], 255);
        o.channels = SVO_WANT_AUTO;
        svo_tree_info info;
        CHECK_OK(svo_voxelize_plan(&s.m.mesh, &o, &info, &err));
        bool has = false;
        for (uint32_t i = 0; i < info.channel_count; i++) has |= strcmp(info.channels[i].name, "coverage") == 0;
        CHECK(has == (mode == SVO_ALPHA_BLEND));
        voxel_free(&v);
        sheet_free(&s);
    }
}

TEST(coverage_of_an_even_pane_is_constant)
{
    sheet s;
    square_make(&s, 0.03, 1, 1, 1, 1);
    s.materials[0].base_color_texture.image = SVO_NONE;
    s.materials[0].alpha_mode = SVO_ALPHA_BLEND;
    s.materials[0].base_color[3] = 0.2f;
    svo_voxelize_options o = at_depth(4, SVO_WANT_AUTO);
    svo_tree_info info;
    svo_error err;
    CHECK_OK(svo_voxelize_plan(&s.m.mesh, &o, &info, &err));
    uint32_t c = info.channel_count - 1;
    CHECK(strcmp(info.channels[c].name, "coverage") == 0 && info.channels[c].constant && info.channels[c].value[0] == 51);
    sheet_free(&s);
}

TEST(coordinates_that_mean_nothing_do_no_harm)
{
    const float bad[] = {NAN, INFINITY, -INFINITY, 1e30f, -3e38f, 1e-42f, 4e9f};
    for (size_t k = 0; k < sizeof bad / sizeof *bad; k++)
        for (int mode = 0; mode < 3; mode++) {
            sheet s;
            square_make(&s, 0.03, 1, 1, 5, 3);
            for (uint32_t i = 0; i < 15; i++) paint(&s, i % 5, i / 5, (uint8_t)(17 * i), (uint8_t)(255 - 10 * i));
            for (int i = 0; i < 12; i += mode + 1) s.m.part.uvs[0][i] = bad[k];
            s.m.part.normals = calloc(18, sizeof(float)); /* of zero length, and one that is not a number */
            s.m.part.normals[4] = NAN;
            s.materials[0].alpha_mode = (svo_alpha_mode)mode;
            s.materials[0].alpha_cutoff = 0;
            svo_voxelize_options o = at_depth(5, SVO_WANT_AUTO);
            voxel_set v;
            svo_error err;
            CHECK_OK(voxel_run(&s.m.mesh, &o, true, &v, &err));
            CHECK_U64(v.count, 1024);
            for (uint64_t i = 0; i < v.count; i++)
                for (uint32_t c = 0; c < v.info.channel_count; c++)
                    if (v.info.channels[c].kind == SVO_KIND_NORMAL_OCT32) {
                        float n[3];
                        svo_oct32_decode(v.values[c] + 4 * i, n);
                        CHECK(fabsf(n[1]) > 0.99f); /* the face's */
                    }
            voxel_free(&v);
            sheet_free(&s);
        }
}
