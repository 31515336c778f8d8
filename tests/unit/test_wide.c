/* What is written for AVX-512 does what the plain steps do, to the bit. */
#include <stdio.h>
#include <string.h>

#include "svoi_shade_wide.h"
#include "test.h"

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
    if (skipped()) return;
    for (int round = 0; round < 500; round++) {
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
        svoi_wide_write(&layout, &v, bits, among, rank, channels);
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

TEST(textures_are_read_as_one_by_one)
{
    static uint16_t texels[4 * WIDTH * HEIGHT];
    uint64_t seed = 3;
    if (skipped()) return;
    for (uint32_t i = 0; i < 4 * WIDTH * HEIGHT; i++) texels[i] = (uint16_t)test_random(&seed);
    for (int round = 0; round < 500; round++) {
        const uint32_t count = 8 * (1 + (uint32_t)round % (SVOI_LANES / 8));
        uint32_t texel[SVOI_LANES];
        float fx[SVOI_LANES], fy[SVOI_LANES], sums[SVOI_LANES][8], want[SVOI_LANES][8];
        for (uint32_t k = 0; k < count; k++) {
            texel[k] = (uint32_t)(test_random(&seed) % (HEIGHT - 1)) * WIDTH + (uint32_t)(test_random(&seed) % (WIDTH - 1));
            fx[k] = (float)test_random_unit(&seed), fy[k] = (float)test_random_unit(&seed);
            for (uint32_t i = 0; i < 8; i++) sums[k][i] = want[k][i] = (float)(i * k);
            read_one(texels, fx[k], fy[k], texel[k], want[k]);
        }
        svoi_wide_taps(texels, WIDTH, texel, fx, fy, count, &sums[0][0]);
        CHECK(memcmp(sums, want, count * sizeof *sums) == 0);
    }
}

TEST(footprints_are_read_as_one_by_one)
{
    static uint16_t texels[4 * WIDTH * HEIGHT];
    uint64_t seed = 4;
    if (skipped()) return;
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
            svoi_wide_footprint(texels, WIDTH, &n, x, y, sums);
            CHECK(memcmp(sums, want, sizeof sums) == 0);
        }
}
