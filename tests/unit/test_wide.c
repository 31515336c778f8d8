/* What is written for AVX-512 and AVX2 does what the plain steps do, to the bit. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "svoi_shade_avx2.h"
#include "svoi_shade_wide.h"
#include "svoi_channel.h"
#include "voxel_set.h"

static bool skipped(void)
{
    if (svoi_clip_has_wide()) return false;
    printf("        skipped: this processor or compiler has no AVX-512\n");
    return true;
}

/* Bits of a brick, more or fewer of them. */
static uint64_t random_bits(uint64_t *seed)
{
    const uint64_t a = test_random(seed), b = test_random(seed), c = test_random(seed);
    switch (c % 5) {
    case 0: return a & b & c;
    case 1: return a & b;
    case 2: return a;
    case 3: return a | b;
    default: return UINT64_MAX;
    }
}

TEST(bricks_are_expanded_as_bit_by_bit)
{
    uint64_t seed = 5;
    if (skipped()) return;
    for (int round = 0; round < 2000; round++) {
        const uint64_t among = random_bits(&seed), bits = among & random_bits(&seed);
        const uint32_t brick = (uint32_t)test_random(&seed) % 32768, rank = (uint32_t)test_random(&seed) % 100000, begin = (uint32_t)test_random(&seed) % SVOI_LANES;
        svoi_wait w;
        memset(&w, 0xee, sizeof w);
        const uint32_t end = svoi_wide_expand(bits, among, brick, rank, begin, w.code, w.target);
        CHECK(end == begin + (uint32_t)__builtin_popcountll(bits));
        uint32_t n = begin;
        for (uint32_t bit = 0; bit < 64; bit++) {
            if (!(bits >> bit & 1)) continue;
            CHECK(w.code[n] == (brick << 6 | bit));
            CHECK(w.target[n] == rank + (uint32_t)__builtin_popcountll(among & (((uint64_t)1 << bit) - 1)));
            n++;
        }
        CHECK(begin == 0 || (w.code[begin - 1] == 0xeeeeeeee && w.target[begin - 1] == 0xeeeeeeee));
    }
}

TEST(values_are_written_where_they_belong_and_nowhere_else)
{
    enum { ROOM = 256 };
    static uint8_t bytes[SVO_MAX_CHANNELS][ROOM * SVO_MAX_STRIDE];
    const uint32_t stride[6] = {3, 4, 3, 1, 1, 1};
    uint64_t seed = 9;
    if (!svoi_avx2_has() && skipped()) return;
    for (int round = 0; round < 1000; round++) {
        if (round % 2 == 0 ? !svoi_clip_has_wide() : !svoi_avx2_has()) continue;
        const svo_shade_layout all = {.color = 0, .normal = 1, .emissive = 2, .metallic = 3, .roughness = 4, .coverage = 5, .material = SVO_MAX_CHANNELS};
        svo_shade_layout layout = all;
        if (round % 3 == 1) layout.emissive = layout.metallic = layout.roughness = layout.coverage = SVO_MAX_CHANNELS;
        const uint64_t among = random_bits(&seed), bits = among & random_bits(&seed);
        const uint32_t rank = (uint32_t)test_random(&seed) % 100;
        svoi_values v;
        uint8_t *channels[SVO_MAX_CHANNELS] = {0};
        memset(bytes, 0xaa, sizeof bytes);
        for (uint32_t c = 0; c < 6; c++) {
            channels[c] = bytes[c];
            for (uint32_t i = 0; i < 4; i++) v.of[c][i] = (uint8_t)(test_random(&seed) % 100);
        }
        (round % 2 == 0 ? svoi_wide_write : svoi_avx2_write)(&layout, &v, bits, among, rank, channels);
        for (uint32_t c = 0; c < 6; c++) {
            const bool there = c < 2 || layout.emissive == all.emissive;
            for (uint32_t i = 0, bit = 0; i < ROOM; i++) {
                bool set = false;
                if (i >= rank) {
                    while (bit < 64 && !(among >> bit & 1)) bit++;
                    set = there && bit < 64 && (bits >> bit & 1);
                    if (bit < 64) bit++;
                }
                for (uint32_t k = 0; k < stride[c]; k++) CHECK(bytes[c][i * stride[c] + k] == (set ? v.of[c][k] : 0xaa));
            }
        }
    }
}

enum { WIDTH = 37, HEIGHT = 29 };

static void read_one(const uint16_t *texels, float fx, float fy, uint32_t texel, float sum[8])
{
    const uint16_t *top = texels + 4 * (uint64_t)texel, *bottom = top + 4 * WIDTH;
    for (uint32_t i = 0; i < 8; i++) {
        const float a = (float)top[i], b = (float)bottom[i], value = a + (b - a) * fy;
        sum[i] += value * (i < 4 ? 1 - fx : fx);
    }
}

TEST(footprints_are_read_as_one_by_one)
{
    static uint16_t texels[4 * WIDTH * HEIGHT];
    uint64_t seed = 4;
    const svoi_texels from = {.texels = texels};
    if (!svoi_avx2_has() && skipped()) return;
    for (uint32_t i = 0; i < 4 * WIDTH * HEIGHT; i++) texels[i] = (uint16_t)test_random(&seed);
    for (uint32_t along = 1; along <= 128; along++)
        for (uint32_t across = 1; across <= 4 && along * across <= 128; across++) {
            svoi_tap_plan n = {.along = along, .across = across};
            /* all of it within the image */
            n.step[0] = (float)(test_random_unit(&seed) * 20 / along), n.step[1] = (float)(test_random_unit(&seed) * 16 / along);
            n.side[0] = (float)(test_random_unit(&seed) * 3), n.side[1] = (float)(test_random_unit(&seed) * 2);
            const float x = (float)test_random_unit(&seed), y = (float)test_random_unit(&seed);
            float sums[16] = {0}, want[2][8] = {{0}};
            for (uint32_t i = 0; i < along; i++)
                for (uint32_t j = 0; j < across; j++) {
                    const float px = x + (float)i * n.step[0] + (float)j * n.side[0], py = y + (float)i * n.step[1] + (float)j * n.side[1];
                    const int32_t ix = (int32_t)px, iy = (int32_t)py;
                    read_one(texels, px - (float)ix, py - (float)iy, (uint32_t)(iy * WIDTH + ix), want[(i * across + j) % 2]);
                }
            if (svoi_clip_has_wide()) {
                svoi_wide_footprint(texels, WIDTH, &n, x, y, sums);
                CHECK(memcmp(sums, want, sizeof sums) == 0);
            }
            if (svoi_avx2_has()) {
                memset(sums, 0, sizeof sums);
                svoi_avx2_footprint(&from, 0, WIDTH, &n, x, y, sums);
                CHECK(memcmp(sums, want, sizeof sums) == 0);
            }
        }
}

TEST(colours_are_encoded_as_one_by_one)
{
    uint64_t seed = 6;
    if (!svoi_avx2_has() && skipped()) return;
    for (int round = 0; round < 2000; round++) {
        const uint32_t count = 1 + (uint32_t)test_random(&seed) % SVOI_LANES;
        float c[3][SVOI_LANES];
        uint8_t out[3 * SVOI_LANES + 64];
        for (int k = 0; k < 3; k++)
            for (uint32_t i = 0; i < SVOI_LANES; i++) {
                const uint32_t bits = (uint32_t)test_random(&seed);
                if (round % 2 == 0) c[k][i] = (float)pow(test_random_unit(&seed), 3);
                else memcpy(&c[k][i], &bits, 4); /* anything */
            }
        for (int way = 0; way < 2; way++) {
            if (way == 0 ? !svoi_clip_has_wide() : !svoi_avx2_has()) continue;
            (way == 0 ? svoi_wide_colors : svoi_avx2_colors)(svoi_srgb_steps(), c[0], c[1], c[2], count, out);
            for (uint32_t i = 0; i < count; i++)
                for (int k = 0; k < 3; k++) CHECK(out[3 * i + (uint32_t)k] == svo_linear_to_srgb(c[k][i]));
        }
    }
}

TEST(values_are_put_where_their_numbers_say)
{
    enum { ROOM = 512 };
    uint64_t seed = 7;
    if (skipped()) return;
    for (int round = 0; round < 3000; round++) {
        const uint32_t stride = (uint32_t[]){1, 3, 4}[round % 3], count = (uint32_t)test_random(&seed) % (SVOI_LANES + 1), much = 1 + (uint32_t)test_random(&seed) % 40;
        uint32_t index[SVOI_LANES + 16] = {0};
        uint8_t values[4 * SVOI_LANES + 64], out[4 * ROOM], want[4 * ROOM];
        for (uint32_t i = 0, at = 0; i < count; i++, at++) { /* runs of all lengths */
            if (test_random(&seed) % much == 0) at += 1 + (uint32_t)test_random(&seed) % 4;
            index[i] = at;
        }
        for (size_t i = 0; i < sizeof values; i++) values[i] = (uint8_t)test_random(&seed);
        memset(out, 0xaa, sizeof out);
        memset(want, 0xaa, sizeof want);
        for (uint32_t i = 0; i < count; i++) memcpy(want + stride * index[i], values + stride * i, stride);
        svoi_wide_put(values, stride, index, count, out);
        CHECK(memcmp(out, want, sizeof out) == 0);
    }
}

/* Triangles of all sizes with texture coordinates, normals and colours. */
static void tangle_make(loose_mesh *m, uint32_t count, double texels, uint64_t *seed)
{
    double *v = malloc(72 * (size_t)count);
    float *uv = malloc(24 * (size_t)count), *normal = malloc(36 * (size_t)count);
    for (uint32_t t = 0; t < count; t++) {
        const double size = pow(0.5, (double)(t % 6));
        double at[3];
        for (int k = 0; k < 3; k++) at[k] = test_random_unit(seed);
        for (uint32_t c = 3 * t; c < 3 * t + 3; c++) {
            for (uint32_t k = 0; k < 3; k++) v[3 * c + k] = at[k] + size * (test_random_unit(seed) - 0.5);
            for (uint32_t k = 0; k < 2; k++) uv[2 * c + k] = (float)(v[3 * c + k] * texels + 0.3 * v[3 * c + 2] - 1);
            for (uint32_t k = 0; k < 3; k++) normal[3 * c + k] = t % 3 == 0 ? (float)k : (float)(test_random_unit(seed) - 0.5);
        }
    }
    loose_make(m, v, count);
    free(v);
    m->part.uvs[0] = uv;
    m->part.normals = normal;
}

/* With all vector code that there is, with that of AVX2, and without. */
static void run_all(const svo_mesh *mesh, const svo_voxelize_options *o, voxel_set *with, voxel_set *half, voxel_set *without)
{
    svo_error err;
    CHECK_OK(voxel_run(mesh, o, false, with, &err));
    svoi_clip_hold_back(true);
    CHECK_OK(voxel_run(mesh, o, false, half, &err));
    svoi_avx2_hold_back(true);
    CHECK_OK(voxel_run(mesh, o, false, without, &err));
    svoi_avx2_hold_back(false);
    svoi_clip_hold_back(false);
}

TEST(attributes_are_the_same_without)
{
    uint64_t seed = 8;
    for (uint32_t round = 0; round < 36 && !test_failed(); round++) {
        loose_mesh m;
        svo_material material = svo_material_default();
        svo_image images[2];
        tangle_make(&m, 90, (double[]){0.2, 1, 5, 40}[round % 4], &seed);
        for (uint32_t i = 0; i < 2; i++) {
            images[i] = (svo_image){.width = i == 0 ? 64 : 37, .height = round % 5 == 0 ? 3 : 32};
            images[i].pixels = malloc(4 * (size_t)images[i].width * images[i].height);
            for (uint32_t k = 0; k < 4 * images[i].width * images[i].height; k++) images[i].pixels[k] = (uint8_t)test_random(&seed);
        }
        svo_texture *how[3] = {&material.base_color_texture, &material.emissive_texture, &material.metallic_roughness_texture};
        for (uint32_t k = 0; k < 3; k++) {
            if (k != 0 && round % 3 == 0) break; /* colours alone */
            how[k]->image = k % 2;
            how[k]->wrap_u = (svo_wrap[]){SVO_WRAP_REPEAT, SVO_WRAP_MIRROR, SVO_WRAP_CLAMP}[round / 4 % 3];
            how[k]->wrap_v = round % 7 == 0 ? SVO_WRAP_CLAMP : how[k]->wrap_u;
        }
        material.emissive[0] = material.emissive[1] = material.emissive[2] = material.metallic = 0.8f;
        if (round % 9 == 8) material.alpha_mode = SVO_ALPHA_BLEND;
        m.part.material = 0;
        m.mesh.materials = &material;
        m.mesh.material_count = 1;
        m.mesh.images = images;
        m.mesh.image_count = 2;
        svo_voxelize_options o = svo_default_voxelize_options();
        o.depth = 6 + round % 2;
        o.threads = 2;
        o.channels = SVO_WANT_COLOR | SVO_WANT_NORMAL | SVO_WANT_EMISSIVE | SVO_WANT_METALLIC | SVO_WANT_ROUGHNESS;
        voxel_set with, half, without;
        run_all(&m.mesh, &o, &with, &half, &without);
        CHECK(with.hash == without.hash && half.hash == without.hash && with.count == without.count);
        voxel_free(&with);
        voxel_free(&half);
        voxel_free(&without);
        for (uint32_t i = 0; i < 2; i++) free(images[i].pixels);
        loose_free(&m);
    }
}

/* Triangles that look the same everywhere, of two materials: normals alone (sums of five), with colours (nine), and with all other channels, of which some are transparent. */
TEST(plain_attributes_are_the_same_without)
{
    uint64_t seed = 12;
    for (uint32_t round = 0; round < 24 && !test_failed(); round++) {
        loose_mesh m;
        svo_material materials[2] = {svo_material_default(), svo_material_default()};
        tangle_make(&m, 150, 1, &seed);
        if (round % 4 == 3) materials[1].alpha_mode = SVO_ALPHA_BLEND, materials[1].base_color[3] = 0.3f;
        for (int k = 0; k < 3; k++) materials[1].base_color[k] = materials[1].emissive[k] = (float)test_random_unit(&seed);
        materials[1].metallic = materials[1].roughness = 0.4f;
        if (round % 2 == 0) {
            free(m.part.normals);
            m.part.normals = NULL;
        }
        svo_part parts[2] = {m.part, m.part};
        parts[0].triangle_count = 70;
        parts[1].triangle_count -= 70;
        parts[1].indices += 3 * 70;
        parts[0].material = 0, parts[1].material = 1;
        svo_shape shape = m.mesh.shapes[0], *shapes = m.mesh.shapes;
        shape.parts = parts;
        shape.part_count = 2;
        m.mesh.shapes = &shape;
        m.mesh.materials = materials;
        m.mesh.material_count = 2;
        svo_voxelize_options o = svo_default_voxelize_options();
        o.depth = 6 + round % 3;
        o.threads = 2;
        o.channels = SVO_WANT_NORMAL | (round % 3 > 0 ? SVO_WANT_COLOR : 0) | (round % 3 > 1 ? SVO_WANT_EMISSIVE | SVO_WANT_METALLIC | SVO_WANT_ROUGHNESS | SVO_WANT_COVERAGE : 0);
        voxel_set with, half, without;
        run_all(&m.mesh, &o, &with, &half, &without);
        CHECK_MSG(with.hash == without.hash && half.hash == without.hash && with.counts.nodes[o.depth] > 1000, "round %u, %llu voxels", round, (unsigned long long)with.counts.nodes[o.depth]);
        voxel_free(&with);
        voxel_free(&half);
        voxel_free(&without);
        m.mesh.shapes = shapes;
        loose_free(&m);
    }
}

/* Codes go to those that are averaged and to the others, in order, with their numbers. */
TEST(codes_are_sorted_as_one_by_one)
{
    uint64_t seed = 21;
    if (skipped()) return;
    svo_block *b = calloc(1, sizeof *b);
    svoi_lanes *lanes = calloc(2, sizeof *lanes);
    for (int round = 0; round < 500; round++) {
        uint32_t codes[SVOI_LANES], bricks[8], count = 1 + (uint32_t)test_random(&seed) % SVOI_LANES;
        for (int k = 0; k < 8; k++) {
            const uint32_t brick = bricks[k] = (uint32_t)test_random(&seed) % SVO_BLOCK_BRICKS;
            b->bricks[brick] = random_bits(&seed) | 1;
            b->complex[brick] = b->bricks[brick] & random_bits(&seed);
            b->rank[brick] = (uint32_t)test_random(&seed) % 100000;
            b->complex_rank[brick] = (uint32_t)test_random(&seed) % 100000;
        }
        for (uint32_t i = 0; i < count; i++) {
            const uint32_t brick = bricks[test_random(&seed) % 8];
            uint32_t bit = (uint32_t)test_random(&seed) % 64;
            while (!(b->bricks[brick] >> bit & 1)) bit = (bit + 1) % 64;
            codes[i] = brick << 6 | bit;
        }
        uint32_t n[2];
        for (int k = 0; k < 2; k++) n[k] = lanes[k].count = (uint32_t)test_random(&seed) % SVOI_LANES;
        svoi_wide_codes(b, codes, count, &lanes[0], &lanes[1]);
        for (uint32_t i = 0; i < count; i++) {
            const bool met = b->complex[codes[i] >> 6] >> (codes[i] & 63) & 1;
            const uint32_t number = met ? svo_block_complex_index(b, codes[i]) : svo_block_index(b, codes[i]), at = n[!met]++;
            CHECK(lanes[!met].code[at] == codes[i] && lanes[!met].target[at] == number);
        }
        CHECK(lanes[0].count == n[0] && lanes[1].count == n[1]);
    }
    free(b);
    free(lanes);
}

/* Inner voxels by AVX2: each lane's mean is that of its readings one by one, of 16-bit texels and of bytes; other lanes stay. */
TEST(inner_voxels_are_read_as_one_by_one)
{
    static uint8_t pixels[4 * WIDTH * HEIGHT];
    static uint16_t texels[4 * WIDTH * HEIGHT];
    float stored[256];
    uint64_t seed = 17;
    if (!svoi_avx2_has()) {
        printf("        skipped: this processor or compiler has no AVX2\n");
        return;
    }
    for (int i = 0; i < 256; i++) stored[i] = (float)(test_random(&seed) % 65536);
    for (uint32_t i = 0; i < 4 * WIDTH * HEIGHT; i++) {
        pixels[i] = (uint8_t)test_random(&seed);
        texels[i] = i % 4 == 3 ? 65535 : (uint16_t)stored[pixels[i]];
    }
    const svoi_texels from[2] = {{.texels = texels}, {.pixels = pixels, .stored = stored}};
    svoi_inner_texture *f = calloc(1, sizeof *f);
    svoi_lanes *l = calloc(1, sizeof *l);
    for (uint32_t round = 0; round < 1000 && !test_failed(); round++) {
        const bool single = round % 5 == 0;
        svoi_tap_plan n = {.along = single ? 1 : 1 + round % 7, .across = single ? 1 : 1 + round % 4};
        float cx[SVOI_LANES], cy[SVOI_LANES], out[4][SVOI_LANES] = {{0}};
        for (uint32_t k = 0; k <= SVOI_INNER_STEPS; k++) /* one reading is at the middle */
            for (uint32_t i = 0; i < 6; i++) f->row[k][i] = n.along * n.across == 1 ? 0 : (float)test_random_unit(&seed);
        l->count = 1 + (uint32_t)test_random(&seed) % SVOI_LANES;
        for (uint32_t i = 0; i < SVOI_LANES; i++) {
            l->step[i] = (uint8_t)(test_random(&seed) % 17);
            cx[i] = (float)(test_random_unit(&seed) * (WIDTH - 13) + 1), cy[i] = (float)(test_random_unit(&seed) * (HEIGHT - 13) + 1);
        }
        const uint64_t all = UINT64_MAX >> (64 - l->count), lanes = round % 3 == 0 ? all : all & test_random(&seed);
        if (lanes == 0) continue;
        svoi_avx2_read(&from[round % 2], WIDTH, f, &n, l, lanes, cx, cy, 0.25f, out);
        for (uint32_t i = 0; i < l->count; i++) {
            const float *row = f->row[l->step[i]];
            float sum[8] = {0};
            for (uint32_t j = 0; lanes >> i & 1 && j < n.along * n.across; j++) {
                const float along = (float)(j / n.across), across = (float)(j % n.across);
                const float x = cx[i] - row[0] + (along * row[2] + across * row[4]), y = cy[i] - row[1] + (along * row[3] + across * row[5]);
                read_one(texels, x - (float)(int32_t)x, y - (float)(int32_t)y, (uint32_t)((int32_t)y * WIDTH + (int32_t)x), sum);
            }
            for (uint32_t c = 0; c < 3; c++) CHECK(out[c][i] == (sum[c] + sum[c + 4]) * 0.25f);
        }
    }
    free(l);
    free(f);
}

/* Those whose readings are inside, less than a period away, and farther, by AVX2. */
TEST(inner_voxels_are_sorted_as_one_by_one)
{
    uint64_t seed = 19;
    if (!svoi_avx2_has()) return;
    svoi_inner_texture *f = calloc(1, sizeof *f);
    svoi_lanes *l = calloc(1, sizeof *l);
    for (uint32_t round = 0; round < 1000 && !test_failed(); round++) {
        const float width = (float)(4 + round % 60), height = (float)(3 + round % 41);
        float cx[SVOI_LANES], cy[SVOI_LANES];
        const uint32_t first = round % 17;
        f->alike[first] = (uint32_t)test_random(&seed) & 0x1ffff;
        f->most_x[first] = f->most_y[first] = 0;
        for (uint32_t k = 0; k <= SVOI_INNER_STEPS; k++) {
            f->reach_x[k] = (float)(test_random_unit(&seed) * 12), f->reach_y[k] = (float)(test_random_unit(&seed) * 12);
            if ((f->alike[first] >> k & 1) == 0) continue;
            f->most_x[first] = fmaxf(f->most_x[first], f->reach_x[k]), f->most_y[first] = fmaxf(f->most_y[first], f->reach_y[k]);
        }
        l->count = 1 + (uint32_t)test_random(&seed) % SVOI_LANES;
        for (uint32_t i = 0; i < SVOI_LANES; i++) {
            l->step[i] = (uint8_t)(test_random(&seed) % 17);
            cx[i] = (float)test_random_unit(&seed) * width, cy[i] = (float)test_random_unit(&seed) * height;
        }
        const svoi_sorted_lanes r = svoi_avx2_sort(f, l, first, cx, cy, width, height);
        for (uint32_t i = 0; i < l->count; i++) {
            const uint32_t s = l->step[i], asked = f->alike[first] >> s & 1;
            const float ex = f->reach_x[s], ey = f->reach_y[s];
            const uint32_t in = asked & (cx[i] - ex > 0 && cy[i] - ey > 0 && cx[i] + ex < width - 1 && cy[i] + ey < height - 1);
            const uint32_t near = asked & !in & (ex + 1 < width && ey + 1 < height);
            CHECK((r.inside >> i & 1) == in && (r.near >> i & 1) == near && (r.far >> i & 1) == (asked & !in & !near));
        }
        CHECK(l->count == SVOI_LANES || (r.inside | r.near | r.far) >> l->count == 0);
    }
    free(l);
    free(f);
}

TEST(bytes_are_read_as_the_numbers_they_stand_for)
{
    static uint8_t pixels[4 * WIDTH * HEIGHT], halves[2][256];
    static uint16_t texels[4 * WIDTH * HEIGHT];
    uint64_t seed = 11;
    if (!svoi_bytes_has_wide()) {
        printf("        skipped: this processor or compiler has no AVX-512 VBMI\n");
        return;
    }
    for (int i = 0; i < 512; i++) halves[i / 256][i % 256] = (uint8_t)test_random(&seed);
    for (uint32_t i = 0; i < 4 * WIDTH * HEIGHT; i++) {
        pixels[i] = (uint8_t)test_random(&seed);
        texels[i] = i % 4 == 3 ? 65535 : (uint16_t)(halves[0][pixels[i]] | halves[1][pixels[i]] << 8);
    }
    for (int round = 0; round < 1000; round++) {
        svoi_inner_texture f;
        svoi_lanes *l = calloc(1, sizeof *l);
        svoi_tap_plan n = {.along = 1 + (uint32_t)round % 7, .across = 1 + (uint32_t)round % 4};
        float cx[SVOI_LANES], cy[SVOI_LANES], out[2][4][SVOI_LANES], sums[2][16] = {{0}};
        const bool wraps = round % 2 == 1;
        memset(&f, 0, sizeof f);
        memset(out, 0, sizeof out);
        for (uint32_t k = 0; k < SVOI_INNER_ROWS; k++) { /* steps of up to a texel, all of it at least ten texels from where it begins */
            f.step_x[k] = (float)test_random_unit(&seed), f.step_y[k] = (float)test_random_unit(&seed);
            f.side_x[k] = (float)test_random_unit(&seed), f.side_y[k] = (float)test_random_unit(&seed);
        }
        l->count = 1 + (uint32_t)test_random(&seed) % SVOI_LANES;
        for (uint32_t i = 0; i < SVOI_LANES; i++) {
            l->step[i] = (uint8_t)(test_random(&seed) % 17);
            cx[i] = (float)(test_random_unit(&seed) * (WIDTH - 13) + (wraps ? 9 : 0)), cy[i] = (float)(test_random_unit(&seed) * (HEIGHT - 13) + (wraps ? 9 : 0));
        }
        const uint64_t all = l->count < 64 ? ((uint64_t)1 << l->count) - 1 : UINT64_MAX, lanes = round % 3 == 0 ? all : all & test_random(&seed);
        svoi_wide_read(texels, WIDTH, HEIGHT, &f, &n, l, lanes, wraps, cx, cy, 0.25f, out[0]);
        svoi_bytes_read(pixels, (const uint8_t(*)[256])halves, WIDTH, HEIGHT, &f, &n, l, lanes, wraps, cx, cy, 0.25f, out[1]);
        for (uint32_t c = 0; c < 3; c++)
            for (uint32_t i = 0; i < l->count; i++) CHECK(out[0][c][i] == out[1][c][i] && (lanes >> i & 1 || out[0][c][i] == 0));
        n.step[0] = f.step_x[0], n.step[1] = f.step_y[0], n.side[0] = f.side_x[0], n.side[1] = f.side_y[0];
        svoi_wide_footprint(texels, WIDTH, &n, 1.5f, 2.25f, sums[0]);
        svoi_bytes_footprint(pixels, (const uint8_t(*)[256])halves, WIDTH, &n, 1.5f, 2.25f, sums[1]);
        CHECK(memcmp(sums[0], sums[1], sizeof *sums) == 0);
        free(l);
    }
}
