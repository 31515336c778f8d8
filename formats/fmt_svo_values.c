/* Packed values: flags of change, codes of recent values, differences in groups of eight. */
#include <string.h>

#ifdef __BMI2__
#include <immintrin.h>
#endif

#include "fmti_svo.h"
#include "fmti_svo_values.h"

/* Values are worked on as 32-bit numbers, little-endian, 0 above their bytes. */
enum {
    GROUP = 8,    /* differences that share a width */
    RECENT = 15,  /* values that a code can name; the code RECENT means another one */
    HASHES = 256, /* of the encoder's table that finds recent values */
    SLACK = 16    /* groups are stored and loaded 16 bytes at a time */
};

/* How values of a kind are cut into components, whose differences are packed apart. */
typedef struct shape {
    uint32_t stride, components, bits; /* bytes of a value; bits of a component */
} shape;

static shape shape_of(svo_channel_kind kind)
{
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: return (shape){3, 3, 8}; /* green, red - green, blue - green */
    case SVO_KIND_UNORM8: return (shape){1, 1, 8};
    case SVO_KIND_ID16: return (shape){2, 1, 16};
    case SVO_KIND_NORMAL_OCT32:
    case SVO_KIND_ID32: break;
    }
    return (shape){4, 2, 16};
}

/* With a constant stride; three bytes by way of memory would make the processor wait for its own stores. */
static inline uint32_t load_value(const uint8_t *p, const uint32_t stride)
{
    uint32_t v;
    if (stride == 4) return memcpy(&v, p, 4), v;
    v = p[0];
    if (stride > 1) v |= (uint32_t)p[1] << 8;
    if (stride > 2) v |= (uint32_t)p[2] << 16;
    return v;
}
static inline void store_value(uint8_t *p, uint32_t v, const uint32_t stride)
{
    const uint16_t low = (uint16_t)v;
    if (stride == 4) memcpy(p, &v, 4);
    else if (stride == 1) p[0] = (uint8_t)v;
    else memcpy(p, &low, 2);
    if (stride == 3) p[2] = (uint8_t)(v >> 16);
}

static svo_result out_of_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the values of a chunk"); }

/* --- encoder ---------------------------------------------------------------------------------------------------- */

enum { WORD = 64 }; /* values at a time, a word of flags */
typedef uint8_t bytes16 __attribute__((vector_size(16)));

/* 64 values as 32-bit numbers; `inside`: 16 bytes may be read from where any of them begins. */
static inline void load_word(const uint8_t *values, const uint32_t stride, bool inside, uint32_t *out)
{
    if (stride == 4) {
        memcpy(out, values, 4 * WORD);
    } else if (stride == 3 && inside) {
        const bytes16 zero = {0};
        for (uint64_t i = 0; i < WORD; i += 4) {
            bytes16 v;
            memcpy(&v, values + 3 * i, sizeof v);
            v = __builtin_shufflevector(v, zero, 0, 1, 2, 16, 3, 4, 5, 16, 6, 7, 8, 16, 9, 10, 11, 16);
            memcpy(out + i, &v, sizeof v);
        }
    } else {
        for (uint64_t i = 0; i < WORD; i++) out[i] = load_value(values + stride * i, stride);
    }
}

/* Bytes that are 0 or 1 to bits. */
static inline uint64_t bits_of(const uint8_t set[WORD])
{
    uint64_t bits = 0;
#ifdef __BMI2__
    for (uint32_t i = 0; i < WORD / 16; i++) bits |= (uint64_t)(uint32_t)_mm_movemask_epi8(_mm_slli_epi16(_mm_loadu_si128((const __m128i *)(const void *)(set + 16 * i)), 7)) << 16 * i;
#else
    for (uint32_t i = 0; i < WORD / 8; i++) {
        uint64_t eight;
        memcpy(&eight, set + 8 * i, sizeof eight);
        bits |= (eight * 0x0102040810204080u >> 56) << 8 * i;
    }
#endif
    return bits;
}

/* Values that differ from the one before them, behind a 0 at changes[0]; a bit for each of all values. Returns how many. */
static inline uint64_t find_changes(const uint8_t *values, uint64_t count, const uint32_t stride, uint64_t *flags, uint32_t *changes)
{
    enum { FEW = 12 }; /* bits that are better looked for than tried one by one */
    uint64_t n = 0;
    uint32_t v[WORD + 1]; /* behind the last one of the word before */
    v[0] = changes[0] = 0;
    for (uint64_t word = 0; word * WORD < count; word++, values += WORD * stride) {
        const uint64_t left = count - word * WORD, m = left < WORD ? left : WORD;
        uint8_t differs[WORD];
        if (m == WORD) {
            load_word(values, stride, left >= WORD + 16, v + 1);
        } else { /* those that are missing are like the last one */
            for (uint64_t i = 0; i < m; i++) v[i + 1] = load_value(values + stride * i, stride);
            for (uint64_t i = m; i < WORD; i++) v[i + 1] = v[m];
        }
        for (uint32_t i = 0; i < WORD; i++) differs[i] = v[i + 1] != v[i];
        const uint64_t bits = flags[word] = bits_of(differs);
        if (bits == UINT64_MAX) {
            memcpy(changes + 1 + n, v + 1, 4 * WORD);
            n += WORD;
        } else if ((uint32_t)__builtin_popcountll(bits) <= FEW) {
            for (uint64_t b = bits; b != 0; b &= b - 1) changes[++n] = v[1 + (uint32_t)__builtin_ctzll(b)];
        } else {
            for (uint64_t i = 0; i < m; i++) {
                changes[n + 1] = v[i + 1];
                n += differs[i];
            }
        }
        v[0] = v[WORD];
    }
    return n;
}

static uint64_t find_changes_of(uint32_t stride, const uint8_t *values, uint64_t count, uint64_t *flags, uint32_t *changes)
{
    switch (stride) { /* so that the compiler sees the loads' sizes */
    case 1: return find_changes(values, count, 1, flags, changes);
    case 2: return find_changes(values, count, 2, flags, changes);
    case 3: return find_changes(values, count, 3, flags, changes);
    default: return find_changes(values, count, 4, flags, changes);
    }
}

/* Finds the last RECENT values that had no code, by a hash; a value that another one has driven out of the table is new again. */
typedef struct recent {
    struct { uint32_t value, mark; } seen[HASHES]; /* mark: 16 * number of the value among those without a code + its code */
    uint32_t number, code;                         /* of the next one */
} recent;

static void recent_init(recent *r)
{
    memset(r, 0, sizeof *r);
    r->number = RECENT + 1; /* so that what is in the table now is too old */
}

/* The code of v; RECENT where it is new, then it is known from now on. Each value waits for the number that the one before it leaves: the way to that is short. */
static inline uint32_t recent_code(recent *r, uint32_t v)
{
    const uint32_t h = v * 2654435761u >> 24, mark = r->seen[h].mark, number = r->number, code = r->code, differs = r->seen[h].value != v;
    const uint32_t other = differs | (number - (mark >> 4) > RECENT), mask = 0 - other;
    r->seen[h].value = v;
    r->seen[h].mark = ((number << 4 | code) & mask) | (mark & ~mask);
    r->number = number + other;
    r->code = code + other < RECENT ? code + other : 0;
    return (RECENT & mask) | (mark & 15 & ~mask);
}

/* Do codes pay? They cost 4 bits a change; a hit saves its differences. Tried on one of eight runs of 64. */
static bool codes_pay(const shape *s, const uint32_t *changes, uint64_t count)
{
    uint64_t tried = 0, hits = 0;
    recent r;
    if (s->stride == 1) return false;
    recent_init(&r);
    for (uint64_t begin = 0; begin < count; begin += 512)
        for (uint64_t i = begin; i < begin + 64 && i < count; i++, tried++) hits += recent_code(&r, changes[i]) != RECENT;
    return hits * (s->stride == 4 ? 5 : 3) > tried;
}

/* Changes without a code, and the value before each. codes[i]: a byte each. Returns how many there are. */
static uint64_t find_codes(const uint32_t *changes /* from -1 on */, uint64_t count, uint8_t *codes, uint32_t *plain, uint32_t *before)
{
    recent r;
    uint64_t n = 0;
    recent_init(&r);
    for (uint64_t i = 0; i < count; i++) {
        const uint32_t code = recent_code(&r, changes[i]);
        codes[i] = (uint8_t)code;
        plain[n] = changes[i];
        before[n] = changes[(int64_t)i - 1];
        n += code == RECENT;
    }
    return n;
}

/* Small numbers of both signs to small numbers. */
static inline uint8_t fold8(uint32_t d) { return (uint8_t)(d << 1 ^ (0 - (d >> 7 & 1))); }
static inline uint16_t fold16(uint32_t d) { return (uint16_t)(d << 1 ^ (0 - (d >> 15 & 1))); }

/* Differences of all components, folded: in bytes, or in numbers of 16 bits. Component k is at out[k]. */
static void find_differences8(const shape *s, const uint32_t *restrict plain, const uint32_t *restrict before, uint64_t count, uint8_t *const out[3])
{
    uint8_t *restrict first = out[0], *restrict second = out[1], *restrict third = out[2];
    if (s->components == 1) {
        for (uint64_t i = 0; i < count; i++) first[i] = fold8(plain[i] - before[i]);
        return;
    }
    for (uint64_t i = 0; i < count; i++) {
        const uint32_t a = plain[i], b = before[i], g = (a >> 8) - (b >> 8);
        first[i] = fold8(g);
        second[i] = fold8(a - b - g);
        third[i] = fold8((a >> 16) - (b >> 16) - g);
    }
}
static void find_differences16(const shape *s, const uint32_t *restrict plain, const uint32_t *restrict before, uint64_t count, uint16_t *const out[2])
{
    uint16_t *restrict first = out[0], *restrict second = out[1];
    for (uint64_t i = 0; i < count; i++) first[i] = fold16(plain[i] - before[i]);
    for (uint64_t i = 0; s->components == 2 && i < count; i++) second[i] = fold16((plain[i] >> 16) - (before[i] >> 16));
}

static inline uint64_t load64(const void *p)
{
    uint64_t v;
    memcpy(&v, p, sizeof v);
    return v;
}

/* Four numbers of w bits in lanes of 16, or eight in lanes of 8, to 4 w (8 w) bits, and four back. */
static inline uint64_t squeeze(uint64_t x, uint32_t w)
{
#ifdef __BMI2__
    return _pext_u64(x, 0x0001000100010001u * (((uint64_t)1 << w) - 1));
#else
    const uint64_t pairs = (x & 0x0000ffff0000ffffu) | (x >> 16 & 0x0000ffff0000ffffu) << w;
    return (pairs & 0xffffffffu) | pairs >> 32 << 2 * w;
#endif
}
static inline uint64_t squeeze_bytes(uint64_t x, uint32_t w)
{
#ifdef __BMI2__
    return _pext_u64(x, 0x0101010101010101u * (((uint64_t)1 << w) - 1));
#else
    const uint64_t twos = (x & 0x00ff00ff00ff00ffu) | (x >> 8 & 0x00ff00ff00ff00ffu) << w;
    const uint64_t fours = (twos & 0x0000ffff0000ffffu) | (twos >> 16 & 0x0000ffff0000ffffu) << 2 * w;
    return (fours & 0xffffffffu) | fours >> 32 << 4 * w;
#endif
}
static inline uint64_t stretch(uint64_t x, uint32_t w)
{
    const uint64_t pair = ((uint64_t)1 << 2 * w) - 1, one = (((uint64_t)1 << w) - 1) * 0x100000001u;
    const uint64_t pairs = (x & pair) | (x >> 2 * w & pair) << 32;
    return (pairs & one) | (pairs >> w & one) << 16;
}

static inline uint32_t bits_in(uint64_t any) { return any != 0 ? 64 - (uint32_t)__builtin_clzll(any) : 0; }

static inline uint32_t width_of(const uint16_t *group)
{
    uint64_t any = load64(group) | load64(group + 4);
    any |= any >> 32;
    const uint32_t w = bits_in((any | any >> 16) & 0xffff);
    return w < 15 ? w : 16;
}

/* Differences (filled up to a multiple of GROUP) to widths of 4 bits and packed groups. Returns the end. */
static uint8_t *pack16(const uint16_t *d, uint64_t count, uint8_t *widths, uint8_t *out)
{
    const uint64_t groups = (count + GROUP - 1) / GROUP;
    memset(widths, 0, (size_t)((groups + 1) / 2));
    for (uint64_t g = 0; g < groups; g++, d += GROUP) {
        const uint32_t w = width_of(d);
        const uint64_t low = squeeze(load64(d), w), high = squeeze(load64(d + 4), w);
        const uint64_t first = w < 16 ? low | high << 4 * w : low, second = w < 16 ? high >> 1 >> (63 - 4 * w) : high;
        widths[g / 2] |= (uint8_t)((w < 16 ? w : 15) << 4 * (g & 1));
        memcpy(out, &first, 8);
        memcpy(out + 8, &second, 8);
        out += w;
    }
    return out;
}
/* The same for bytes, of which a group of eight is no more than one word. Two groups at a time: `d` is filled up to a multiple of two. */
static uint8_t *pack8(const uint8_t *d, uint64_t count, uint8_t *widths, uint8_t *out)
{
    const uint64_t groups = (count + GROUP - 1) / GROUP;
    for (uint64_t g = 0; g < groups; g += 2, d += 2 * GROUP) {
        const uint64_t a = load64(d), b = load64(d + GROUP);
        uint64_t any_a = a | a >> 32, any_b = b | b >> 32;
        any_a |= any_a >> 16, any_b |= any_b >> 16;
        const uint32_t w = bits_in((any_a | any_a >> 8) & 0xff), v = bits_in((any_b | any_b >> 8) & 0xff);
        const uint64_t first = squeeze_bytes(a, w), second = squeeze_bytes(b, v);
        *widths++ = (uint8_t)(w | v << 4);
        memcpy(out, &first, 8);
        memcpy(out + w, &second, 8);
        out += w + v;
    }
    return out;
}

/* Flags: a bit for each byte of eight that is not 0, then those bytes. Returns the end. */
static uint8_t *store_flags(const uint64_t *flags, uint64_t count, uint8_t *out)
{
    const uint64_t bytes = (count + 7) / 8;
    uint8_t *present = out;
    out += (bytes + 7) / 8;
    for (uint64_t word = 0; word * 64 < count; word++) {
        const uint64_t bits = flags[word];
        uint32_t any = 0;
        for (uint32_t i = 0; bits != 0 && i < 8; i++) {
            const uint8_t b = (uint8_t)(bits >> 8 * i);
            *out = b;
            out += b != 0;
            any |= (uint32_t)(b != 0) << i;
        }
        present[word] = (uint8_t)any;
    }
    return out;
}

svo_result fmti_values_encode(svo_channel_kind kind, const uint8_t *values, uint64_t count, const svo_allocator *a, svo_buffer *to, svo_error *err)
{
    const shape s = shape_of(kind);
    /* flags; changes; plain, before; differences; codes */
    const uint64_t words = (count + 63) / 64, room = count + 2 * GROUP, scratch_size = 8 * words + 4 * (count + 2) + 8 * room + 4 * room + count;
    const uint64_t most = 1 + words + 8 * words + count / 2 + 1 + s.components * (count / GROUP / 2 + 2 + 2 * room) + SLACK;
    uint8_t *scratch = svo_alloc(a, scratch_size, 1);
    if (scratch == NULL || !svo_buffer_reserve(to, (size_t)most)) {
        svo_free(a, scratch, scratch_size, 1);
        return out_of_memory(err);
    }
    uint64_t *flags = (uint64_t *)(void *)scratch;
    uint32_t *changes = (uint32_t *)(void *)(flags + words), *plain = changes + count + 2, *before = plain + room;
    uint8_t *differences = (uint8_t *)(before + room), *codes = differences + 4 * room, *out = to->data + to->size; /* differences: up to 3 bytes, or 2 words, a value */
    const uint64_t n = find_changes_of(s.stride, values, count, flags, changes);
    uint64_t m = n;
    const uint32_t *from = changes + 1, *last = changes;
    const bool coded = codes_pay(&s, changes + 1, n);
    *out++ = coded;
    out = store_flags(flags, count, out);
    if (coded) {
        m = find_codes(changes + 1, n, codes, plain, before);
        from = plain, last = before;
        for (uint64_t i = 0; i < n; i += 2) *out++ = (uint8_t)(codes[i] | (i + 1 < n ? codes[i + 1] : 0) << 4);
    }
    const uint64_t width_bytes = ((m + GROUP - 1) / GROUP + 1) / 2;
    uint8_t *const byte[3] = {differences, differences + room, differences + 2 * room};
    uint16_t *const word[2] = {(uint16_t *)(void *)differences, (uint16_t *)(void *)differences + room};
    if (s.bits == 8) find_differences8(&s, from, last, m, byte);
    else find_differences16(&s, from, last, m, word);
    for (uint32_t k = 0; k < s.components; k++) {
        if (s.bits == 8) memset(byte[k] + m, 0, 2 * GROUP);
        else memset(word[k] + m, 0, GROUP * sizeof **word);
        out = s.bits == 8 ? pack8(byte[k], m, out, out + width_bytes) : pack16(word[k], m, out, out + width_bytes);
    }
    to->size = (size_t)(out - to->data);
    svo_free(a, scratch, scratch_size, 1);
    return SVO_OK;
}

/* --- decoder ---------------------------------------------------------------------------------------------------- */

static svo_result damaged(const char *what, svo_error *err) { return svo_fail(err, SVO_INVALID_DATA, "packed values: %s (SVO-13)", what); }
static svo_result ends_early(svo_error *err) { return damaged("they end early", err); }

/* Flags of `count` values, and how many are set. */
static svo_result load_flags(const uint8_t **at, const uint8_t *end, uint64_t count, uint64_t *flags, uint64_t *set, svo_error *err)
{
    const uint64_t words = (count + 63) / 64;
    if ((uint64_t)(end - *at) < words) return ends_early(err);
    const uint8_t *present = *at, *p = *at + words;
    uint64_t n = 0;
    for (uint64_t word = 0; word < words; word++) {
        const uint32_t any = present[word];
        uint64_t bits = 0;
        if ((uint64_t)(end - p) < (uint32_t)__builtin_popcount(any)) return ends_early(err);
        for (uint32_t b = any; b != 0; b &= b - 1, p++) {
            if (*p == 0) return damaged("an empty byte of flags is stored", err);
            bits |= (uint64_t)*p << 8 * (uint32_t)__builtin_ctz(b);
        }
        flags[word] = bits;
        n += (uint64_t)__builtin_popcountll(bits);
    }
    if (count % 64 != 0 && flags[words - 1] >> count % 64 != 0) return damaged("flags of values that are not there", err);
    *at = p;
    *set = n;
    return SVO_OK;
}

/* Codes of `count` changes to bytes, and how many of them are RECENT. */
static svo_result load_codes(const uint8_t **at, const uint8_t *end, uint64_t count, uint8_t *codes, uint64_t *others, svo_error *err)
{
    const uint64_t bytes = (count + 1) / 2;
    if ((uint64_t)(end - *at) < bytes) return ends_early(err);
    for (uint64_t i = 0; i < bytes; i++) {
        codes[2 * i] = (*at)[i] & 15;
        codes[2 * i + 1] = (*at)[i] >> 4;
    }
    if (count % 2 != 0 && codes[count] != 0) return damaged("a code of no value", err);
    uint64_t n = 0;
    for (uint64_t i = 0; i < count; i++) n += codes[i] == RECENT;
    *others = n;
    *at += bytes;
    return SVO_OK;
}

/* Differences of one component. out has room for a multiple of GROUP. */
static svo_result unpack(const uint8_t **at, const uint8_t *end, uint64_t count, uint32_t bits, uint16_t *out, svo_error *err)
{
    const uint64_t groups = (count + GROUP - 1) / GROUP, bytes = (groups + 1) / 2;
    if ((uint64_t)(end - *at) < bytes) return ends_early(err);
    const uint8_t *widths = *at, *p = *at + bytes;
    if (groups % 2 != 0 && widths[bytes - 1] >> 4 != 0) return damaged("a width of no group", err);
    for (uint64_t g = 0; g < groups; g++, out += GROUP) {
        uint32_t w = widths[g / 2] >> 4 * (g & 1) & 15;
        uint64_t first, second, half[2];
        w = w < 15 ? w : 16;
        if (w > bits) return damaged("a group wider than its numbers", err);
        const uint64_t left = (uint64_t)(end - p);
        if (left >= SLACK) {
            first = load64(p), second = load64(p + 8);
        } else {
            uint8_t tail[SLACK] = {0};
            if (left < w) return ends_early(err);
            memcpy(tail, p, (size_t)left);
            first = load64(tail), second = load64(tail + 8);
        }
        half[0] = w < 16 ? stretch(first, w) : first;
        half[1] = w < 16 ? stretch(first >> 4 * w | second << 1 << (63 - 4 * w), w) : second;
        memcpy(out, half, sizeof half);
        p += w;
    }
    for (uint64_t i = count; i % GROUP != 0; i++)
        if (out[(int64_t)(i - groups * GROUP)] != 0) return damaged("a difference of no value", err);
    *at = p;
    return SVO_OK;
}

/* Components of differences to what has to be added to the value before, lane by lane. */
static void merge(const shape *s, uint64_t count, uint64_t room, const uint16_t *differences, uint32_t *out)
{
    const uint16_t *a = differences, *b = differences + room, *c = differences + 2 * room;
    if (s->components == 1) {
        for (uint64_t i = 0; i < count; i++) out[i] = (uint16_t)(a[i] >> 1 ^ (0 - (a[i] & 1)));
        if (s->bits == 8)
            for (uint64_t i = 0; i < count; i++) out[i] &= 0xff;
    } else if (s->components == 2) {
        for (uint64_t i = 0; i < count; i++)
            out[i] = (uint32_t)(uint16_t)(a[i] >> 1 ^ (0 - (a[i] & 1))) | (uint32_t)(uint16_t)(b[i] >> 1 ^ (0 - (b[i] & 1))) << 16;
    } else {
        for (uint64_t i = 0; i < count; i++) {
            const uint32_t g = a[i] >> 1 ^ (0u - (a[i] & 1u)), r = (b[i] >> 1 ^ (0u - (b[i] & 1u))) + g, l = (c[i] >> 1 ^ (0u - (c[i] & 1u))) + g;
            out[i] = (r & 0xff) | (g & 0xff) << 8 | (l & 0xff) << 16;
        }
    }
}

/* Sum in lanes: their highest bits apart. */
static inline uint32_t add_lanes(uint32_t x, uint32_t d, const uint32_t tops) { return ((x & ~tops) + (d & ~tops)) ^ ((x ^ d) & tops); }

static inline void rebuild(const uint64_t *flags, uint64_t count, const uint8_t *codes, const uint32_t *d, const uint32_t stride, const uint32_t tops, uint8_t *values)
{
    uint32_t x = 0, head = 0, ring[RECENT + 1] = {0};
    for (uint64_t word = 0; word * 64 < count; word++) {
        const uint64_t left = count - word * 64, m = left < 64 ? left : 64;
        uint64_t bits = flags[word];
        if (bits == 0) { /* a run */
            for (uint64_t i = 0; i < m; i++, values += stride) store_value(values, x, stride);
        } else if (codes == NULL) {
            for (uint64_t i = 0; i < m; i++, bits >>= 1, values += stride) {
                const uint32_t set = bits & 1;
                x = add_lanes(x, *d & (0 - set), tops);
                d += set;
                store_value(values, x, stride);
            }
        } else {
            for (uint64_t i = 0; i < m; i++, bits >>= 1, values += stride) {
                /* without branches, which could not be foreseen */
                const uint32_t set = bits & 1, code = *codes, other = set & (code == RECENT), mask = 0 - other, keep = set - 1;
                const uint32_t v = (add_lanes(x, *d, tops) & mask) | (ring[code] & ~mask);
                x = (v & ~keep) | (x & keep);
                ring[(head & mask) | (RECENT & ~mask)] = x;
                head += other;
                head = head < RECENT ? head : 0;
                d += other;
                codes += set;
                store_value(values, x, stride);
            }
        }
    }
}

svo_result fmti_values_decode(svo_channel_kind kind, const uint8_t **at, const uint8_t *end, uint64_t count, const svo_allocator *a, uint8_t *values,
                              svo_error *err)
{
    const shape s = shape_of(kind);
    const uint64_t words = (count + 63) / 64, room = (count + GROUP) / GROUP * GROUP;
    const uint64_t scratch_size = 8 * words + 4 * room + 2 * s.components * room + count + 2;
    if (end - *at < 1) return ends_early(err);
    const uint32_t mode = *(*at)++;
    if (mode > 1) return damaged("unknown mode", err);
    if ((uint64_t)(end - *at) < words) return ends_early(err); /* before memory is taken */
    uint8_t *scratch = svo_alloc(a, scratch_size, 1);
    if (scratch == NULL) return out_of_memory(err);
    uint64_t *flags = (uint64_t *)(void *)scratch, changes = 0, others = 0;
    uint32_t *sums = (uint32_t *)(void *)(flags + words);
    uint16_t *differences = (uint16_t *)(void *)(sums + room);
    uint8_t *codes = (uint8_t *)(differences + s.components * room);
    svo_result r = load_flags(at, end, count, flags, &changes, err);
    others = changes;
    if (r == SVO_OK && mode == 1) r = load_codes(at, end, changes, codes, &others, err);
    for (uint32_t k = 0; r == SVO_OK && k < s.components; k++) r = unpack(at, end, others, s.bits, differences + k * room, err);
    if (r == SVO_OK) {
        merge(&s, others, room, differences, sums);
        sums[others] = 0; /* read, and not used, after the last one */
        codes[changes] = 0;
        const uint8_t *c = mode == 1 ? codes : NULL;
        switch (kind) {
        case SVO_KIND_COLOR_SRGB8: rebuild(flags, count, c, sums, 3, 0x808080, values); break;
        case SVO_KIND_UNORM8: rebuild(flags, count, c, sums, 1, 0x80, values); break;
        case SVO_KIND_ID16: rebuild(flags, count, c, sums, 2, 0x8000, values); break;
        default: rebuild(flags, count, c, sums, 4, 0x80008000u, values); break;
        }
    }
    svo_free(a, scratch, scratch_size, 1);
    return r;
}

/* --- all channels ------------------------------------------------------------------------------------------------- */

svo_result fmti_svo_pack(const svo_tree_info *info, const svo_chunk *chunk, const svo_allocator *a, svo_buffer *to, svo_error *err)
{
    for (uint32_t i = 0; i < info->channel_count; i++)
        if (!info->channels[i].constant) SVO_TRY(fmti_values_encode(info->channels[i].kind, chunk->channels[i], chunk->value_count, a, to, err));
    return SVO_OK;
}

svo_result fmti_svo_unpack(const svo_tree_info *info, const uint8_t *bytes, uint64_t size, uint64_t count, const svo_allocator *a, uint8_t *const to[SVO_MAX_CHANNELS],
                           svo_error *err)
{
    const uint8_t *end = bytes + size;
    for (uint32_t i = 0; i < info->channel_count; i++)
        if (!info->channels[i].constant) SVO_TRY(fmti_values_decode(info->channels[i].kind, &bytes, end, count, a, to[i], err));
    return bytes == end ? SVO_OK : damaged("bytes after the last channel", err);
}
