/* Packed values: what goes in comes out, whatever the values look like; damaged bytes are refused or decode within bounds. */
#include <stdlib.h>
#include <string.h>

#include "fmti_svo_values.h"
#include "test.h"

static svo_error err;

static const svo_channel_kind kinds[] = {SVO_KIND_COLOR_SRGB8, SVO_KIND_NORMAL_OCT32, SVO_KIND_UNORM8, SVO_KIND_ID16, SVO_KIND_ID32};
enum { KINDS = sizeof kinds / sizeof kinds[0], STYLES = 6 };

/* 0 zeros, 1 noise, 2 a slow walk, 3 runs of a few values, 4 a few values in any order, 5 noise of few bits and rare jumps */
static void make(uint32_t style, uint32_t stride, uint64_t count, uint64_t *seed, uint8_t *out)
{
    uint8_t few[12][4], last[4] = {0};
    for (int i = 0; i < 12; i++)
        for (int k = 0; k < 4; k++) few[i][k] = (uint8_t)test_random(seed);
    for (uint64_t i = 0; i < count; i++) {
        const uint64_t dice = test_random(seed);
        for (uint32_t k = 0; k < stride; k++) {
            switch (style) {
            case 0: last[k] = 0; break;
            case 1: last[k] = (uint8_t)(dice >> 8 * k); break;
            case 2: last[k] = (uint8_t)(last[k] + (dice >> 8 * k) % 3 - 1); break;
            case 3: last[k] = dice % 40 == 0 || i == 0 ? few[dice / 64 % 12][k] : last[k]; break;
            case 4: last[k] = few[dice % 12][k]; break;
            default: last[k] = dice % 97 == 0 ? (uint8_t)(dice >> 8 * k) : (uint8_t)(last[k] ^ (dice >> 8 * k & 3)); break;
            }
        }
        memcpy(out + i * stride, last, stride);
    }
}

/* In blocks of exactly the right size, so that sanitizers see every byte too far. */
static svo_result decode_exact(svo_channel_kind kind, const uint8_t *bytes, size_t size, uint64_t count, uint8_t **values, size_t *used)
{
    const uint32_t stride = svo_channel_stride(kind);
    uint8_t *own = svo_alloc(NULL, size + (size == 0), 1);
    const uint8_t *at = own;
    *values = malloc(count * stride);
    if (size != 0) memcpy(own, bytes, size);
    const svo_result r = fmti_values_decode(kind, &at, own + size, count, NULL, *values, &err);
    *used = (size_t)(at - own);
    svo_free(NULL, own, size + (size == 0), 1);
    return r;
}

static void round_trip(svo_channel_kind kind, uint32_t style, uint64_t count, uint64_t *seed)
{
    const uint32_t stride = svo_channel_stride(kind);
    uint8_t *in = malloc(count * stride), *back;
    make(style, stride, count, seed, in);
    svo_buffer b;
    svo_buffer_init(&b, NULL);
    svo_buffer_append(&b, "abc", 3); /* it appends */
    size_t used;
    CHECK_OK(fmti_values_encode(kind, in, count, NULL, &b, &err));
    CHECK(memcmp(b.data, "abc", 3) == 0);
    CHECK_OK(decode_exact(kind, b.data + 3, b.size - 3, count, &back, &used));
    CHECK_U64(used, b.size - 3);
    CHECK_MSG(memcmp(in, back, count * stride) == 0, "kind %u style %u count %llu differ", kind, style, (unsigned long long)count);
    free(back);
    if (style == 0) CHECK(b.size - 3 == 1 + (count + 63) / 64);
    /* cut short: never good */
    for (int i = 0; i < 20; i++) {
        CHECK_RESULT(decode_exact(kind, b.data + 3, (size_t)(test_random(seed) % (b.size - 3)), count, &back, &used), SVO_INVALID_DATA);
        free(back);
    }
    /* a changed byte: refused, or decoded within bounds */
    for (int i = 0; i < 40; i++) {
        uint8_t *at = &b.data[3 + test_random(seed) % (b.size - 3)], was = *at;
        *at ^= (uint8_t)(1u << test_random(seed) % 8);
        svo_result r = decode_exact(kind, b.data + 3, b.size - 3, count, &back, &used);
        CHECK(r == SVO_OK ? used <= b.size - 3 : r == SVO_INVALID_DATA);
        *at = was;
        free(back);
    }
    svo_buffer_free(&b);
    free(in);
}

TEST(values_come_back)
{
    uint64_t seed = 1;
    for (uint32_t k = 0; k < KINDS; k++)
        for (uint32_t style = 0; style < STYLES; style++) {
            for (uint64_t count = 1; count < 150 && !test_failed(); count += count < 20 ? 1 : 13) round_trip(kinds[k], style, count, &seed);
            for (int i = 0; i < 6 && !test_failed(); i++) round_trip(kinds[k], style, 1000 + test_random(&seed) % 5000, &seed);
            if (test_failed()) return;
        }
}

/* Bytes that nobody wrote. */
TEST(noise_is_refused_or_decoded)
{
    uint64_t seed = 7;
    for (int i = 0; i < 20000; i++) {
        uint8_t bytes[80], *values;
        size_t size = test_random(&seed) % sizeof bytes, used;
        for (size_t b = 0; b < size; b++) bytes[b] = (uint8_t)(test_random(&seed) >> (test_random(&seed) & 7));
        if (size != 0) bytes[0] &= 1;
        svo_result r = decode_exact(kinds[test_random(&seed) % KINDS], bytes, size, 1 + test_random(&seed) % 100, &values, &used);
        CHECK(r == SVO_OK || r == SVO_INVALID_DATA);
        free(values);
    }
}

static svo_result decode_text(svo_channel_kind kind, const char *bytes, size_t size, uint64_t count)
{
    uint8_t *values;
    size_t used;
    svo_result r = decode_exact(kind, (const uint8_t *)bytes, size, count, &values, &used);
    free(values);
    return r == SVO_OK && used != size ? SVO_RUNTIME : r;
}

/* The example of the specification, and each rule broken. */
TEST(svo_13_rules)
{
    static const uint8_t values[] = {7, 7, 9, 9};
    static const uint8_t good[] = {0, 1, 5, 4, 0x4e, 0, 0, 0};
    svo_buffer b;
    svo_buffer_init(&b, NULL);
    CHECK_OK(fmti_values_encode(SVO_KIND_UNORM8, values, 4, NULL, &b, &err));
    CHECK(b.size == sizeof good && memcmp(b.data, good, sizeof good) == 0);
    svo_buffer_free(&b);
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\1\5\4\x4e\0\0\0", 8, 4), SVO_OK);
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\2\1\5\4\x4e\0\0\0", 8, 4), SVO_INVALID_DATA); /* mode */
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\1\0\4\x4e\0\0\0", 8, 4), SVO_INVALID_DATA); /* an empty byte of flags */
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\3\5\1\4\x4e\0\0\0", 9, 4), SVO_INVALID_DATA); /* flags of no values */
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\1\x15\4\x4e\0\0\0", 8, 4), SVO_INVALID_DATA);
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\1\5\x14\x4e\0\0\0", 8, 4), SVO_INVALID_DATA); /* a width of no group */
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\1\5\t\x4e\0\0\0\0\0\0\0\0", 13, 4), SVO_INVALID_DATA); /* 9 bits of 8 */
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\1\5\4\x4e\1\0\0", 8, 4), SVO_INVALID_DATA); /* a difference of no value */
    CHECK_RESULT(decode_text(SVO_KIND_UNORM8, "\0\1\5\4\x4e\0\0", 7, 4), SVO_INVALID_DATA);
    /* with codes: 1 new, 2 new, the first again; then a code of no value */
    CHECK_RESULT(decode_text(SVO_KIND_ID16, "\1\1\7\xff\0\2\x0a\0", 8, 3), SVO_OK);
    CHECK_RESULT(decode_text(SVO_KIND_ID16, "\1\1\7\xff\x10\2\x0a\0", 8, 3), SVO_INVALID_DATA);
}
