/* Reading one value of a channel's blocks: svo_palette_value. All that a reader does at random goes through here, so what is
 * asked of memory comes first (a block's header and the begin of its data are two places) and the rest follows in registers. */
#include "svoi_palette.h"

static inline uint64_t load64(const uint8_t *p)
{
    uint64_t v;
    memcpy(&v, p, sizeof v);
    return v;
}

/* Number of set bits among bits at .. at + n, less one. */
static inline uint32_t rank_of(const uint8_t *p, uint32_t at, uint32_t n)
{
    p += at / 8;
    uint32_t end = at % 8 + n, count = 0;
    uint64_t w = load64(p) & ~(uint64_t)0 << at % 8;
    for (; end >= 64; end -= 64) {
        count += (uint32_t)__builtin_popcountll(w);
        w = load64(p += 8);
    }
    return count + (uint32_t)__builtin_popcountll(w & ~(uint64_t)0 >> (63 - end)) - 1;
}

static inline uint32_t bits_at(const uint8_t *p, uint32_t at, uint32_t width) /* 0..32 */
{
    return (uint32_t)(load64(p + at / 8) >> at % 8 & (((uint64_t)1 << width) - 1));
}

static inline uint32_t table_value(const svo_palette *p, uint32_t index)
{
    uint32_t v;
    switch (p->kind) {
    case SVO_KIND_COLOR_SRGB8: {
        const uint8_t *t = p->table + 3 * (uint64_t)index;
        return t[0] | (uint32_t)t[1] << 8 | (uint32_t)t[2] << 16;
    }
    case SVO_KIND_UNORM8: return p->table[index];
    case SVO_KIND_ID16: return p->table[2 * (uint64_t)index] | (uint32_t)p->table[2 * (uint64_t)index + 1] << 8;
    case SVO_KIND_NORMAL_OCT32:
    case SVO_KIND_ID32: break;
    }
    memcpy(&v, p->table + 4 * (uint64_t)index, sizeof v);
    return v;
}

/* A block of a superblock, and where in it the value is. */
typedef struct place {
    const uint8_t *data;
    uint32_t j, length;
} place;

/* The number of a value: one a value, or (runs) flags first and one for each of them. */
static inline uint32_t number_of(place b, uint32_t at, uint32_t width, bool runs)
{
    uint32_t nth = b.j;
    if (runs) {
        nth = rank_of(b.data, at, b.j);
        at += b.length;
    }
    return bits_at(b.data, at + nth * width, width);
}

static inline uint32_t width_of(uint64_t points) { return points > 1 ? 64 - (uint32_t)__builtin_clzll(points - 1) : 0; }

/* Where the numbers of a lattice's points begin, in bits, and how wide they are. */
static inline uint32_t lattice_numbers(svo_channel_kind kind, const uint8_t *data, uint32_t *width)
{
    uint64_t h = load64(data);
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: *width = width_of(((h >> 8 & 255) + 1) * ((h >> 30 & 511) + 1) * ((h >> 53 & 511) + 1)); return 67;
    case SVO_KIND_NORMAL_OCT32: *width = width_of(((h >> 16 & 0xffff) + 1) * ((load64(data + 4) >> 23 & 0xffff) + 1)); return 78;
    case SVO_KIND_UNORM8: *width = width_of((h >> 8 & 0xff) + 1); return 21;
    case SVO_KIND_ID16: *width = width_of((h >> 16 & 0xffff) + 1); return 32;
    case SVO_KIND_ID32: break;
    }
    *width = width_of((h >> 32) + 1);
    return 64;
}

/* docs/format/svdag.md, "Lattices"; colours: Y (8, 8, 5 bits), Co and Cg (9, 9, 5 bits). */
static inline svo_lattice color_lattice(const uint8_t *data)
{
    uint64_t h = load64(data);
    svo_lattice l;
    l.low[0] = (int32_t)(h & 255);
    l.n[0] = (h >> 8 & 255) + 1;
    l.step[0] = (uint32_t)(h >> 16 & 31) + 1;
    l.low[1] = (int32_t)(h >> 21 & 511) - 256;
    l.n[1] = (h >> 30 & 511) + 1;
    l.step[1] = (uint32_t)(h >> 39 & 31) + 1;
    l.low[2] = (int32_t)(h >> 44 & 511) - 256;
    l.n[2] = (h >> 53 & 511) + 1;
    l.step[2] = (uint32_t)((h >> 62 | (uint64_t)data[8] << 2) & 31) + 1;
    return l;
}

static inline svo_lattice normal_lattice(const uint8_t *data)
{
    uint64_t h = load64(data), g = load64(data + 4) >> 7; /* 39 bits each */
    uint32_t code[2] = {(uint32_t)(h >> 32 & 127), (uint32_t)(g >> 32 & 127)};
    svo_lattice l = {.low = {(int32_t)(h & 0xffff) - 32768, (int32_t)(g & 0xffff) - 32768, 0}, .n = {(h >> 16 & 0xffff) + 1, (g >> 16 & 0xffff) + 1, 1}};
    for (int i = 0; i < 2; i++) l.step[i] = (8 + (code[i] & 7)) << (code[i] >> 3) >> 3;
    return l;
}

static inline svo_lattice other_lattice(svo_channel_kind kind, const uint8_t *data)
{
    uint32_t field = kind == SVO_KIND_UNORM8 ? 8 : kind == SVO_KIND_ID16 ? 16 : 32, low = bits_at(data, 0, field);
    svo_lattice l = {.n = {(uint64_t)bits_at(data, field, field) + 1, 1, 1}, .step = {1, 1, 1}};
    memcpy(&l.low[0], &low, sizeof low);
    if (kind == SVO_KIND_UNORM8) l.step[0] = bits_at(data, 16, 5) + 1;
    return l;
}

static uint32_t color_of_lattice(place b, bool runs)
{
    svo_lattice l = color_lattice(b.data);
    return svoi_lattice_point(SVO_KIND_COLOR_SRGB8, &l, number_of(b, 67, width_of(l.n[0] * l.n[1] * l.n[2]), runs));
}

static uint32_t normal_of_lattice(place b, bool runs)
{
    svo_lattice l = normal_lattice(b.data);
    return svoi_lattice_point(SVO_KIND_NORMAL_OCT32, &l, number_of(b, 78, width_of(l.n[0] * l.n[1]), runs));
}

static uint32_t value_of_lattice(svo_channel_kind kind, place b, bool runs)
{
    if (kind == SVO_KIND_COLOR_SRGB8) return color_of_lattice(b, runs);
    if (kind == SVO_KIND_NORMAL_OCT32) return normal_of_lattice(b, runs);
    uint32_t width, at = lattice_numbers(kind, b.data, &width);
    svo_lattice l = other_lattice(kind, b.data);
    return svoi_lattice_point(kind, &l, number_of(b, at, width, runs));
}

/* Where a value is: first its superblock and block, then the block's header, then its data. Each step reads what the one before has named, which
 * one value at a time waits for; several values at a time do not. */
typedef struct search {
    bool repeat; /* the whole superblock has this value */
    const uint8_t *super, *data;
    uint32_t j, block, begin, end; /* granules */
    uint32_t mode, field;
} search;

/* Which entry of the directory has superblock s, or the one whose last value it repeats. */
static inline uint64_t entry_of(const svo_palette *p, uint64_t s, bool *repeat)
{
    *repeat = false;
    if (p->repeats == NULL) return s;
    const uint8_t *record = p->repeats + s / 64 * SVO_PALETTE_ENTRY;
    const uint64_t bits = load64(record);
    uint32_t before;
    memcpy(&before, record + 8, sizeof before);
    *repeat = !(bits >> s % 64 & 1);
    return before + (uint64_t)__builtin_popcountll(bits & ~(uint64_t)0 >> (63 - s % 64)) - 1;
}

static inline search find_block(const svo_palette *p, uint64_t i)
{
    search f = {.j = (uint32_t)(i % SVO_SUPERBLOCK)};
    const uint64_t s = entry_of(p, i / SVO_SUPERBLOCK, &f.repeat);
    const uint8_t *entry = p->directory + s * SVO_PALETTE_ENTRY;
    uint32_t offset;
    if (f.repeat) f.j = SVO_SUPERBLOCK - 1;
    memcpy(&offset, entry + 8, sizeof offset);
    f.super = p->payload + load64(p->payload + s / SVO_PALETTE_GROUP * 8) + offset;
    if (s + 1 < p->superblock_count) { /* where the data would be if all blocks took the same bits: right often enough */
        uint32_t next;
        memcpy(&next, entry + SVO_PALETTE_ENTRY + 8, sizeof next);
        const uint8_t *guess = f.super + ((uint64_t)(next - offset) * f.j >> 10);
        __builtin_prefetch(guess);
        __builtin_prefetch(guess + 64);
    }
    uint64_t map = load64(entry);
    uint32_t granule = f.j / SVO_GRANULE;
    uint64_t upto = ~(uint64_t)0 >> (63 - granule), below = map & upto, above = map & ~upto;
    f.block = (uint32_t)__builtin_popcountll(below) - 1;
    f.begin = 63 - (uint32_t)__builtin_clzll(below);
    f.end = above != 0 ? (uint32_t)__builtin_ctzll(above) : 64;
    return f;
}

static inline void find_data(search *f)
{
    uint16_t header;
    memcpy(&header, f->super + 2 * f->block, sizeof header);
    f->mode = header & 31;
    f->field = header >> 5;
    f->data = f->super + f->field;
}

static inline uint32_t read_data(const svo_palette *p, const search *f)
{
    const uint32_t b = svo_palette_table_bits(p->table_count), mode = f->mode;
    const uint8_t *data = f->data;
    if (mode < SVO_BLOCK_ONE_WIDE) return table_value(p, mode << 11 | f->field);
    place at = {data, f->j - f->begin * SVO_GRANULE, (f->end - f->begin) * SVO_GRANULE};
    if (mode >= SVO_BLOCK_PALETTE_RUNS) {
        uint32_t n = number_of(at, 8 + (data[0] + 1u) * b, mode - SVO_BLOCK_PALETTE_RUNS + 2, true);
        return table_value(p, bits_at(data, 8 + n * b, b));
    }
    if (mode >= SVO_BLOCK_PALETTE) {
        uint32_t width = mode - SVO_BLOCK_PALETTE + 1, n = number_of(at, 0, width, false);
        return table_value(p, bits_at(data, at.length * width + n * b, b));
    }
    if (mode >= SVO_BLOCK_LINE) {
        bool runs = mode >= SVO_BLOCK_LINE_RUNS;
        uint32_t width = mode - (runs ? SVO_BLOCK_LINE_RUNS : SVO_BLOCK_LINE) + 2, n = number_of(at, 2 * b, width, runs);
        return svo_line_point(p->kind, table_value(p, bits_at(data, 0, b)), table_value(p, bits_at(data, b, b)), n, (1u << width) - 1);
    }
    if (mode >= SVO_BLOCK_BOX) return value_of_lattice(p->kind, at, mode == SVO_BLOCK_BOX_RUNS);
    return table_value(p, bits_at(data, mode == SVO_BLOCK_RAW ? at.j * b : 0, b));
}

uint32_t svo_palette_value(const svo_palette *p, uint64_t i)
{
    search f = find_block(p, i);
    find_data(&f);
    __builtin_prefetch(f.data + 64); /* numbers and palettes are seldom in the line of the begin */
    __builtin_prefetch(f.data + 128);
    return read_data(p, &f);
}

/* Ask memory for what read_data will read beyond the begin of the data: the number of the value and palettes, ... */
static inline void ask_numbers(const search *f, uint32_t table_bits)
{
    const uint32_t j = f->j - f->begin * SVO_GRANULE, length = (f->end - f->begin) * SVO_GRANULE, mode = f->mode;
    if (mode >= SVO_BLOCK_PALETTE_RUNS) { /* the number is between the flags' place and the last possible one */
        __builtin_prefetch(f->data + 64);
        __builtin_prefetch(f->data + 128);
    } else if (mode >= SVO_BLOCK_PALETTE) {
        __builtin_prefetch(f->data + (j * (mode - SVO_BLOCK_PALETTE + 1) >> 3));
        __builtin_prefetch(f->data + (length * (mode - SVO_BLOCK_PALETTE + 1) >> 3));
    } else if (mode >= SVO_BLOCK_LINE_RUNS) __builtin_prefetch(f->data + 64);
    else if (mode >= SVO_BLOCK_LINE) __builtin_prefetch(f->data + ((2 * table_bits + j * (mode - SVO_BLOCK_LINE + 2)) >> 3));
    else if (mode == SVO_BLOCK_RAW) __builtin_prefetch(f->data + (j * table_bits >> 3));
}

/* ... and where numbers are as wide as a lattice's header says. */
static inline void ask_points(svo_channel_kind kind, const search *f)
{
    const uint32_t j = f->j - f->begin * SVO_GRANULE;
    uint32_t width, at = lattice_numbers(kind, f->data, &width);
    if (f->mode == SVO_BLOCK_BOX) {
        __builtin_prefetch(f->data + ((at + j * width) >> 3));
        return;
    }
    at += (f->end - f->begin) * SVO_GRANULE; /* flags first; perhaps every second value begins a run */
    __builtin_prefetch(f->data + 64);
    __builtin_prefetch(f->data + ((at + j * width / 2) >> 3));
    __builtin_prefetch(f->data + ((at + j * width / 4) >> 3));
}

void svo_palette_values(const svo_palette *p, const uint64_t *index, uint32_t count, uint32_t *values)
{
    enum { AT_ONCE = 32 };
    search f[AT_ONCE];
    const uint32_t table_bits = svo_palette_table_bits(p->table_count);
    while (count != 0) {
        const uint32_t n = count < AT_ONCE ? count : AT_ONCE;
        for (uint32_t k = 0; k < n; k++) {
            bool repeat;
            __builtin_prefetch(p->directory + entry_of(p, index[k] / SVO_SUPERBLOCK, &repeat) * SVO_PALETTE_ENTRY);
        }
        for (uint32_t k = 0; k < n; k++) {
            f[k] = find_block(p, index[k]);
            __builtin_prefetch(f[k].super + 2 * f[k].block);
        }
        for (uint32_t k = 0; k < n; k++) {
            find_data(&f[k]);
            __builtin_prefetch(f[k].data);
            ask_numbers(&f[k], table_bits);
        }
        for (uint32_t k = 0; k < n; k++)
            if (f[k].mode == SVO_BLOCK_BOX || f[k].mode == SVO_BLOCK_BOX_RUNS) ask_points(p->kind, &f[k]);
        for (uint32_t k = 0; k < n; k++) values[k] = read_data(p, &f[k]);
        index += n, values += n, count -= n;
    }
}

/* Numbers of `count` values from b.j on. */
static void numbers_of(place b, uint32_t at, uint32_t width, bool runs, uint32_t count, uint32_t *numbers)
{
    uint32_t nth = b.j;
    if (!runs) {
        for (uint32_t i = 0; i < count; i++) numbers[i] = bits_at(b.data, at + nth++ * width, width);
        return;
    }
    const uint32_t flags = at + b.j;
    nth = rank_of(b.data, at, b.j);
    at += b.length;
    numbers[0] = bits_at(b.data, at + nth * width, width);
    for (uint32_t i = 1; i < count; i++) {
        const uint32_t bit = flags + i;
        numbers[i] = b.data[bit / 8] >> bit % 8 & 1 ? bits_at(b.data, at + ++nth * width, width) : numbers[i - 1];
    }
}

/* `count` values of one block, each different neighbour's work done once. */
static void read_some(const svo_palette *p, const search *f, uint32_t count, uint32_t *values)
{
    const uint32_t b = svo_palette_table_bits(p->table_count), mode = f->mode;
    const uint8_t *data = f->data;
    place at = {data, f->j - f->begin * SVO_GRANULE, (f->end - f->begin) * SVO_GRANULE};
    if (mode <= SVO_BLOCK_ONE_WIDE) {
        const uint32_t value = read_data(p, f);
        for (uint32_t i = 0; i < count; i++) values[i] = value;
        return;
    }
    uint32_t ends[2] = {0, 0}, most = 0, entries = 0;
    svo_lattice l = {.bits = 0};
    if (mode >= SVO_BLOCK_PALETTE_RUNS) {
        entries = 8;
        numbers_of(at, 8 + (data[0] + 1u) * b, mode - SVO_BLOCK_PALETTE_RUNS + 2, true, count, values);
    } else if (mode >= SVO_BLOCK_PALETTE) {
        const uint32_t width = mode - SVO_BLOCK_PALETTE + 1;
        entries = at.length * width;
        numbers_of(at, 0, width, false, count, values);
    } else if (mode >= SVO_BLOCK_LINE) {
        const bool runs = mode >= SVO_BLOCK_LINE_RUNS;
        const uint32_t width = mode - (runs ? SVO_BLOCK_LINE_RUNS : SVO_BLOCK_LINE) + 2;
        ends[0] = table_value(p, bits_at(data, 0, b)), ends[1] = table_value(p, bits_at(data, b, b));
        most = (1u << width) - 1;
        numbers_of(at, 2 * b, width, runs, count, values);
    } else if (mode >= SVO_BLOCK_BOX) {
        uint32_t width, first = lattice_numbers(p->kind, data, &width);
        l = p->kind == SVO_KIND_COLOR_SRGB8 ? color_lattice(data) : p->kind == SVO_KIND_NORMAL_OCT32 ? normal_lattice(data) : other_lattice(p->kind, data);
        numbers_of(at, first, width, mode == SVO_BLOCK_BOX_RUNS, count, values);
    } else {
        numbers_of(at, 0, b, false, count, values);
    }
    uint32_t last = 0, value = 0;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t number = values[i];
        if (i == 0 || number != last) {
            last = number;
            if (mode >= SVO_BLOCK_PALETTE) value = table_value(p, bits_at(data, entries + number * b, b));
            else if (mode >= SVO_BLOCK_LINE) value = svo_line_point(p->kind, ends[0], ends[1], number, most);
            else if (mode >= SVO_BLOCK_BOX) value = svoi_lattice_point(p->kind, &l, number);
            else value = table_value(p, number);
        }
        values[i] = value;
    }
}

void svo_palette_range(const svo_palette *p, uint64_t first, uint32_t count, uint32_t *values)
{
    while (count != 0) {
        search f = find_block(p, first);
        const uint32_t rest = f.repeat ? SVO_SUPERBLOCK - (uint32_t)(first % SVO_SUPERBLOCK) : f.end * SVO_GRANULE - f.j, n = count < rest ? count : rest;
        find_data(&f);
        if (f.repeat) {
            values[0] = read_data(p, &f);
            for (uint32_t i = 1; i < n; i++) values[i] = values[0];
        } else read_some(p, &f, n, values);
        first += n, values += n, count -= n;
    }
}
