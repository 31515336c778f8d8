/* Points of lines and lattices; proving blocks; docs/format/svdag.md, "Palette blocks". */
#include "svo_palette.h"

#include "svoi_palette.h"

#include <stdio.h>

/* --- components, lines, lattices --------------------------------------------------------------------------------- */

uint32_t svo_lattice_components(svo_channel_kind kind)
{
    return kind == SVO_KIND_COLOR_SRGB8 ? 3 : kind == SVO_KIND_NORMAL_OCT32 ? 2 : 1;
}

void svo_lattice_split(svo_channel_kind kind, uint32_t value, int32_t c[3])
{
    if (kind == SVO_KIND_COLOR_SRGB8) { /* YCoCg-R: exact integers */
        int32_t r = value & 255, g = value >> 8 & 255, b = value >> 16 & 255;
        int32_t co = r - b, t = b + (co >> 1), cg = g - t;
        c[0] = t + (cg >> 1), c[1] = co, c[2] = cg;
    } else if (kind == SVO_KIND_NORMAL_OCT32) {
        c[0] = (int16_t)(uint16_t)value, c[1] = (int16_t)(uint16_t)(value >> 16), c[2] = 0;
    } else {
        memcpy(&c[0], &value, sizeof value); /* labels: unsigned, see svo_lattice_point */
        c[1] = c[2] = 0;
    }
}

uint32_t svo_lattice_point(svo_channel_kind kind, const svo_lattice *l, uint32_t number) { return svoi_lattice_point(kind, l, number); }

static uint32_t between(uint32_t a, uint32_t b, uint32_t number, uint32_t most) { return (a * (most - number) + b * number + most / 2) / most; }

uint32_t svo_line_point(svo_channel_kind kind, uint32_t a, uint32_t b, uint32_t number, uint32_t most)
{
    if (kind == SVO_KIND_NORMAL_OCT32) {
        a ^= 0x80008000u, b ^= 0x80008000u; /* as unsigned numbers */
        return (between(a & 0xffff, b & 0xffff, number, most) | between(a >> 16, b >> 16, number, most) << 16) ^ 0x80008000u;
    }
    return between(a & 255, b & 255, number, most) | between(a >> 8 & 255, b >> 8 & 255, number, most) << 8 |
           between(a >> 16 & 255, b >> 16 & 255, number, most) << 16;
}

/* Bits of the fields of one component of a lattice: low, n - 1, step. */
typedef struct fields { uint8_t low, n, step; } fields;

static fields lattice_fields(svo_channel_kind kind, uint32_t component)
{
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: return component == 0 ? (fields){8, 8, 5} : (fields){9, 9, 5};
    case SVO_KIND_NORMAL_OCT32: return (fields){16, 16, 7};
    case SVO_KIND_UNORM8: return (fields){8, 8, 5};
    case SVO_KIND_ID16: return (fields){16, 16, 0};
    case SVO_KIND_ID32: break;
    }
    return (fields){32, 32, 0};
}

static int32_t lattice_offset(svo_channel_kind kind, uint32_t component)
{
    return kind == SVO_KIND_NORMAL_OCT32 ? 32768 : kind == SVO_KIND_COLOR_SRGB8 && component != 0 ? 256 : 0;
}

uint32_t svo_lattice_header_bits(svo_channel_kind kind)
{
    uint32_t bits = 0;
    for (uint32_t i = 0; i < svo_lattice_components(kind); i++) {
        fields f = lattice_fields(kind, i);
        bits += f.low + f.n + f.step;
    }
    return bits;
}

uint32_t svoi_step_of(svo_channel_kind kind, uint32_t code)
{
    if (kind == SVO_KIND_NORMAL_OCT32) return (8 + (code & 7)) << (code >> 3) >> 3;
    return code + 1;
}

uint32_t svoi_step_code(svo_channel_kind kind, uint32_t step)
{
    if (kind != SVO_KIND_NORMAL_OCT32) return step > 32 ? 31 : step - 1;
    uint32_t code = 0;
    while (code < 127 && svoi_step_of(kind, code + 1) <= step) code++;
    return code;
}

void svoi_lattice_width(svo_lattice *l)
{
    uint64_t points = l->n[0] * l->n[1] * l->n[2];
    l->bits = points > 1 ? 64 - (uint32_t)__builtin_clzll(points - 1) : 0;
}

static void read_lattice(svo_channel_kind kind, const uint8_t *data, svo_lattice *l)
{
    uint32_t at = 0, components = svo_lattice_components(kind);
    l->n[1] = l->n[2] = 1;
    for (uint32_t i = 0; i < components; i++) {
        fields f = lattice_fields(kind, i);
        l->low[i] = (int32_t)((uint32_t)svo_palette_bits(data, at, f.low) - (uint32_t)lattice_offset(kind, i));
        at += f.low;
        l->n[i] = svo_palette_bits(data, at, f.n) + 1;
        at += f.n;
        l->step[i] = svoi_step_of(kind, (uint32_t)svo_palette_bits(data, at, f.step));
        at += f.step;
    }
    svoi_lattice_width(l);
}

void svoi_put_lattice(svoi_bits *w, svo_channel_kind kind, const svo_lattice *l)
{
    for (uint32_t i = 0; i < svo_lattice_components(kind); i++) {
        fields f = lattice_fields(kind, i);
        svoi_put(w, (uint32_t)l->low[i] + (uint32_t)lattice_offset(kind, i), f.low);
        svoi_put(w, (uint32_t)(l->n[i] - 1), f.n);
        svoi_put(w, svoi_step_code(kind, l->step[i]), f.step);
    }
}

/* --- checking ---------------------------------------------------------------------------------------------------- */

/* Number of set bits among the first n + 1 from bit `at` on, less one. */
static uint32_t rank_of(const uint8_t *data, uint32_t at, uint32_t n)
{
    uint32_t count = 0, done = 0;
    for (; done + 56 <= n + 1; done += 56) count += (uint32_t)__builtin_popcountll(svo_palette_bits(data, at + done, 56));
    return count + (uint32_t)__builtin_popcountll(svo_palette_bits(data, at + done, n + 1 - done)) - 1;
}

static svo_result bad(svo_error *err, uint64_t superblock, const char *why)
{
    svo_fail(err, SVO_INVALID_DATA, "DAG-09: superblock %llu: %s", (unsigned long long)superblock, why);
    if (err != NULL) err->index = superblock;
    return SVO_INVALID_DATA;
}

typedef struct check {
    const svo_palette *p;
    uint32_t b;           /* bits of a table index */
    const uint8_t *data;  /* of a block, 8 readable bytes behind `size` */
    uint64_t size, at;    /* bytes that the superblock has for it; bits read */
    const char *why;      /* set when something is wrong */
} check;

static bool take(check *c, uint64_t bits, const char *why)
{
    if (c->why == NULL && bits > 8 * c->size - c->at) c->why = why;
    if (c->why == NULL) c->at += bits;
    return c->why == NULL;
}

/* `n` table indices. */
static bool take_entries(check *c, uint64_t n)
{
    uint64_t at = c->at;
    if (!take(c, n * c->b, "a block does not fit the payload")) return false;
    for (uint64_t i = 0; i < n; i++)
        if (svo_palette_bits(c->data, at + i * c->b, c->b) >= c->p->table_count) c->why = "an index is outside the table";
    return c->why == NULL;
}

/* The numbers of a block of `length` values, which must be below `limit` (0: their largest goes to *most). */
static bool take_numbers(check *c, uint32_t length, uint32_t width, bool runs, uint64_t limit, uint64_t *most)
{
    uint64_t numbers = length, flags = c->at;
    if (runs) {
        if (!take(c, length, "a block does not fit the payload")) return false;
        if (!(svo_palette_bits(c->data, flags, 1))) c->why = "the first value of a block does not begin a run";
        numbers = rank_of(c->data, (uint32_t)flags, length - 1) + 1u;
    }
    uint64_t at = c->at, largest = 0;
    if (!take(c, numbers * width, "a block does not fit the payload")) return false;
    for (uint64_t i = 0; i < numbers; i++) {
        uint64_t n = svo_palette_bits(c->data, at + i * width, width);
        if (n > largest) largest = n;
    }
    if (limit != 0 && largest >= limit) c->why = "a number has no value";
    *most = largest;
    return c->why == NULL;
}

/* A block of `length` values; its bits are taken. */
static bool check_block(check *c, uint32_t mode, uint32_t length)
{
    svo_channel_kind kind = c->p->kind;
    uint64_t most;
    if (mode == SVO_BLOCK_ONE_WIDE) return take_entries(c, 1);
    if (mode == SVO_BLOCK_RAW) return take_entries(c, length);
    if (mode < SVO_BLOCK_LINE) {
        svo_lattice l;
        if (c->size < (svo_lattice_header_bits(kind) + 7) / 8) c->why = "a block does not fit the payload";
        if (c->why != NULL) return false;
        uint8_t head[24] = {0}; /* a lattice's head may be longer than 8 bytes */
        memcpy(head, c->data, c->size < 16 ? (size_t)c->size : 16);
        read_lattice(kind, head, &l);
        if (l.bits > 32) c->why = "a lattice has more than 2^32 points";
        take(c, svo_lattice_header_bits(kind), "a block does not fit the payload");
        return c->why == NULL && take_numbers(c, length, l.bits, mode == SVO_BLOCK_BOX_RUNS, l.n[0] * l.n[1] * l.n[2], &most);
    }
    if (mode < SVO_BLOCK_PALETTE) {
        if (kind != SVO_KIND_COLOR_SRGB8 && kind != SVO_KIND_NORMAL_OCT32) {
            c->why = "a line in a channel that has none";
            return false;
        }
        bool runs = mode >= SVO_BLOCK_LINE_RUNS;
        uint32_t width = mode - (runs ? SVO_BLOCK_LINE_RUNS : SVO_BLOCK_LINE) + 2;
        return take_entries(c, 2) && take_numbers(c, length, width, runs, 0, &most);
    }
    if (mode < SVO_BLOCK_PALETTE_RUNS) return take_numbers(c, length, mode - SVO_BLOCK_PALETTE + 1, false, 0, &most) && take_entries(c, most + 1);
    if (!take(c, 8, "a block does not fit the payload")) return false;
    uint64_t entries = c->data[0] + 1u;
    return take_entries(c, entries) && take_numbers(c, length, mode - SVO_BLOCK_PALETTE_RUNS + 2, true, entries, &most);
}

/* `s` has `size` bytes up to the end of the payload, behind which 8 more can be read. *used: bytes of the superblock. */
static svo_result check_superblock(const svo_palette *p, uint64_t number, uint64_t map, const uint8_t *s, uint64_t size,
                                   uint64_t *used, svo_palette_stats *stats, svo_error *err)
{
    if (!(map & 1)) return bad(err, number, "the first block does not begin at 0");
    uint32_t blocks = (uint32_t)__builtin_popcountll(map);
    uint64_t at = 2 * (uint64_t)blocks; /* blocks follow each other without gaps */
    if (at > size) return bad(err, number, "does not fit the payload");
    for (uint32_t i = 0; i < blocks; i++) {
        uint32_t begin = (uint32_t)__builtin_ctzll(map);
        map &= map - 1;
        uint32_t length = ((map != 0 ? (uint32_t)__builtin_ctzll(map) : 64) - begin) * SVO_GRANULE;
        uint16_t header;
        memcpy(&header, s + 2 * i, sizeof header);
        uint32_t mode = header & 31, field = header >> 5;
        if (mode >= SVO_BLOCK_MODES) return bad(err, number, "unknown mode of a block");
        stats->blocks[mode]++;
        stats->values[mode] += length;
        if (mode < SVO_BLOCK_ONE_WIDE) {
            if ((mode << 11 | field) >= p->table_count) return bad(err, number, "an index is outside the table");
            continue;
        }
        if (field != at) return bad(err, number, "a block does not begin where the last one ends");
        check c = {.p = p, .b = svo_palette_table_bits(p->table_count), .data = s + at, .size = size - at};
        if (!check_block(&c, mode, length)) return bad(err, number, c.why);
        if (c.at % 8 != 0 && svo_palette_bits(c.data, c.at, 8 - c.at % 8) != 0) return bad(err, number, "bits behind a block are not 0");
        stats->bits[mode] += c.at;
        at += (c.at + 7) / 8;
    }
    *used = at;
    return SVO_OK;
}

/* Where the superblock behind number i says it begins; 0: nowhere behind `at`. */
static uint64_t next_begin(const svo_palette *p, uint64_t i, uint64_t base, uint64_t at, uint64_t end)
{
    uint32_t offset;
    if (++i >= p->superblock_count) return 0;
    memcpy(&offset, p->directory + i * SVO_PALETTE_ENTRY + 8, sizeof offset);
    if (i % SVO_PALETTE_GROUP == 0) memcpy(&base, p->payload + i / SVO_PALETTE_GROUP * 8, sizeof base);
    return base <= end && offset <= end - base && base + offset > at ? base + offset : 0;
}

static svo_result check_repeats(const svo_palette *p, svo_error *err)
{
    const uint64_t all = svo_palette_superblocks(p->count), words = svo_palette_repeat_words(p->count);
    uint64_t entries = 0;
    for (uint64_t w = 0; w < words; w++) {
        uint64_t bits;
        uint32_t before;
        memcpy(&bits, p->repeats + w * SVO_PALETTE_ENTRY, sizeof bits);
        memcpy(&before, p->repeats + w * SVO_PALETTE_ENTRY + 8, sizeof before);
        if (before != entries || (w == 0 && !(bits & 1)) || (w + 1 == words && all % 64 != 0 && bits >> all % 64 != 0))
            return bad(err, 64 * w, "bits of the superblocks that have entries, or their number");
        entries += (uint64_t)__builtin_popcountll(bits);
    }
    return entries == p->superblock_count ? SVO_OK : bad(err, 0, "wrong number of superblocks");
}

svo_result svo_palette_check(const svo_palette *p, svo_palette_stats *stats, svo_error *err) { return svo_palette_check_all(p, stats, NULL, err); }

svo_result svo_palette_check_all(const svo_palette *p, svo_palette_stats *stats, svo_rules *rules, svo_error *err)
{
    svo_palette_stats local = {0};
    uint64_t groups = (p->superblock_count + SVO_PALETTE_GROUP - 1) / SVO_PALETTE_GROUP, base = 0;
    if (p->table_count > (uint64_t)1 << 32) return bad(err, 0, "the table is too large");
    if (p->repeats == NULL && p->superblock_count != svo_palette_superblocks(p->count)) return bad(err, 0, "wrong number of superblocks");
    if (p->repeats != NULL) SVO_TRY(check_repeats(p, err));
    if (p->payload_size < SVO_PALETTE_PADDING || groups > (p->payload_size - SVO_PALETTE_PADDING) / 8)
        return bad(err, 0, "the payload lacks its bases or its padding");
    uint64_t at = 8 * groups, end = p->payload_size - SVO_PALETTE_PADDING;
    for (uint64_t i = 0; i < p->superblock_count; i++) {
        const uint8_t *entry = p->directory + i * SVO_PALETTE_ENTRY;
        uint64_t map, used = 0;
        uint32_t offset;
        memcpy(&map, entry, sizeof map);
        memcpy(&offset, entry + 8, sizeof offset);
        if (i % SVO_PALETTE_GROUP == 0) {
            memcpy(&base, p->payload + i / SVO_PALETTE_GROUP * 8, sizeof base);
            if (base != at) return bad(err, i, "a base is not where its first superblock begins");
        }
        if (base + offset != at) return bad(err, i, "does not begin where the last one ends");
        svo_result r = check_superblock(p, i, map, p->payload + at, end - at, &used, &local, err);
        if (r != SVO_OK) { /* the directory says where the next one begins; without it nothing more can be told */
            uint64_t next = rules != NULL ? next_begin(p, i, base, at, end) : 0;
            if (next == 0) return r;
            SVO_TRY(svo_go_on(rules, r, err));
            used = next - at;
        }
        at += used;
    }
    if (at != end) return bad(err, 0, "the payload is larger than its superblocks");
    for (uint32_t i = 0; i < SVO_PALETTE_PADDING; i++)
        if (p->payload[end + i] != 0) return bad(err, 0, "padding is not 0");
    if (stats != NULL) *stats = local;
    return SVO_OK;
}

void svo_block_name(uint32_t mode, char *out, size_t size)
{
    if (mode < SVO_BLOCK_ONE_WIDE) snprintf(out, size, "one");
    else if (mode == SVO_BLOCK_ONE_WIDE) snprintf(out, size, "one, wide");
    else if (mode == SVO_BLOCK_RAW) snprintf(out, size, "indices");
    else if (mode == SVO_BLOCK_BOX) snprintf(out, size, "lattice");
    else if (mode == SVO_BLOCK_BOX_RUNS) snprintf(out, size, "lattice with runs");
    else if (mode < SVO_BLOCK_LINE_RUNS) snprintf(out, size, "line %u bits", mode - SVO_BLOCK_LINE + 2);
    else if (mode < SVO_BLOCK_PALETTE) snprintf(out, size, "line %u bits with runs", mode - SVO_BLOCK_LINE_RUNS + 2);
    else if (mode < SVO_BLOCK_PALETTE_RUNS) snprintf(out, size, "palette %u bits", mode - SVO_BLOCK_PALETTE + 1);
    else if (mode < SVO_BLOCK_MODES) snprintf(out, size, "palette %u bits with runs", mode - SVO_BLOCK_PALETTE_RUNS + 2);
    else snprintf(out, size, "?");
}
