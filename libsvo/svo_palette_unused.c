/* Leaving out table entries that no block names. Clustered tables and those of values that lattices hold have some; without them the table is
 * smaller, and its indices may be. Entries keep their order, so no block gets larger and everything is rewritten in place. */
#include "svoi_palette.h"

typedef struct reading {
    svo_channel_kind kind;
    uint32_t bits;         /* of an index as it is */
    const uint8_t *data;   /* of a block */
    uint64_t at;           /* bits read */
} reading;

static uint32_t next_bits(reading *r, uint32_t width)
{
    uint32_t v = (uint32_t)svo_palette_bits(r->data, r->at, width);
    r->at += width;
    return v;
}

typedef struct writing {
    svoi_bits out;
    const svoi_used *used;
    svoi_used *mark; /* NULL: write */
    uint32_t bits;   /* of an index as it will be */
} writing;

static void copy_bits(reading *r, writing *w, uint64_t n)
{
    if (w->mark != NULL) {
        r->at += n;
        return;
    }
    for (; n > 32; n -= 32) svoi_put(&w->out, next_bits(r, 32), 32);
    svoi_put(&w->out, next_bits(r, (uint32_t)n), (uint32_t)n);
}

uint32_t svoi_used_index(const svoi_used *u, uint32_t index)
{
    return u->before[index / 64] + (uint32_t)__builtin_popcountll(u->bit[index / 64] & (((uint64_t)1 << index % 64) - 1));
}

static void one_index(writing *w, uint32_t index)
{
    if (w->mark != NULL) w->mark->bit[index / 64] |= (uint64_t)1 << index % 64;
    else svoi_put(&w->out, svoi_used_index(w->used, index), w->bits);
}

static void copy_indices(reading *r, writing *w, uint32_t n)
{
    for (uint32_t i = 0; i < n; i++) one_index(w, next_bits(r, r->bits));
}

/* Numbers of `width` bits for `length` values, by runs or not; returns the largest (when not by runs). */
static uint32_t copy_numbers(reading *r, writing *w, uint32_t length, uint32_t width, bool runs)
{
    uint32_t numbers = length, most = 0;
    reading look = *r;
    if (runs) {
        numbers = 0;
        for (uint32_t i = 0; i < length; i += 16) numbers += (uint32_t)__builtin_popcount(next_bits(&look, 16));
    } else {
        for (uint32_t i = 0; i < length; i++) {
            uint32_t n = next_bits(&look, width);
            most = n > most ? n : most;
        }
    }
    copy_bits(r, w, (runs ? length : 0) + (uint64_t)numbers * width);
    return most;
}

/* The data of a block of a mode above 1, but for lattices. */
static void copy_block(reading *r, writing *w, uint32_t mode, uint32_t length)
{
    if (mode == SVO_BLOCK_ONE_WIDE || mode == SVO_BLOCK_RAW) {
        copy_indices(r, w, mode == SVO_BLOCK_RAW ? length : 1);
    } else if (mode < SVO_BLOCK_PALETTE) {
        bool runs = mode >= SVO_BLOCK_LINE_RUNS;
        copy_indices(r, w, 2);
        copy_numbers(r, w, length, mode - (runs ? SVO_BLOCK_LINE_RUNS : SVO_BLOCK_LINE) + 2, runs);
    } else if (mode < SVO_BLOCK_PALETTE_RUNS) {
        uint32_t most = copy_numbers(r, w, length, mode - SVO_BLOCK_PALETTE + 1, false);
        copy_indices(r, w, most + 1);
    } else {
        uint32_t entries = r->data[0] + 1u;
        copy_bits(r, w, 8);
        copy_indices(r, w, entries);
        copy_numbers(r, w, length, mode - SVO_BLOCK_PALETTE_RUNS + 2, true);
    }
}

/* Superblock `in` of `size` bytes to `out` (which may not overlap it), or only its indices to w->mark; returns the bytes written. */
static uint32_t copy_superblock(writing *w, svo_channel_kind kind, uint32_t bits, uint64_t map, const uint8_t *in, uint32_t size, uint8_t *out)
{
    uint32_t blocks = (uint32_t)__builtin_popcountll(map), k = 0;
    w->out = (svoi_bits){.p = out + 2 * blocks};
    for (uint64_t rest = map; rest != 0; rest &= rest - 1, k++) {
        uint32_t begin = (uint32_t)__builtin_ctzll(rest), end = (rest & (rest - 1)) != 0 ? (uint32_t)__builtin_ctzll(rest & (rest - 1)) : SVOI_GRANULES;
        uint16_t header;
        memcpy(&header, in + 2 * k, sizeof header);
        uint32_t mode = header & 31, field = header >> 5, index = mode << 11 | field;
        reading r = {.kind = kind, .bits = bits, .data = in + field};
        if (mode == SVO_BLOCK_ONE_WIDE) index = next_bits(&r, bits), r.at = 0;
        if (mode <= SVO_BLOCK_ONE_WIDE && w->mark == NULL && svoi_used_index(w->used, index) < 4096) {
            index = svoi_used_index(w->used, index);
            header = (uint16_t)(index >> 11 | (index & 2047) << 5);
        } else if (mode < SVO_BLOCK_ONE_WIDE) {
            one_index(w, index); /* only marks: an index never grows */
        } else {
            header = (uint16_t)(mode | (uint32_t)(w->out.p - out) << 5);
            if (mode == SVO_BLOCK_BOX || mode == SVO_BLOCK_BOX_RUNS) { /* no indices: its bytes reach to the next block's */
                uint32_t next = size;
                for (uint32_t q = k + 1; q < blocks && next == size; q++) {
                    uint16_t h;
                    memcpy(&h, in + 2 * q, sizeof h);
                    if ((h & 31) > 1) next = h >> 5;
                }
                copy_bits(&r, w, 8 * (uint64_t)(next - field));
            } else {
                copy_block(&r, w, mode, (end - begin) * SVO_GRANULE);
            }
            if (w->mark == NULL) svoi_put_end(&w->out);
        }
        if (w->mark == NULL) memcpy(out + 2 * k, &header, sizeof header);
    }
    return (uint32_t)(w->out.p - out);
}

/* All superblocks, rewritten from the front: none is larger than it was. */
static void copy_all(writing *w, svo_channel_kind kind, uint32_t bits, svo_buffer *directory, svo_buffer *payload, uint8_t *scratch)
{
    uint64_t superblocks = directory->size / SVO_PALETTE_ENTRY, groups = (superblocks + SVO_PALETTE_GROUP - 1) / SVO_PALETTE_GROUP;
    uint64_t to = 8 * groups, end = payload->size - SVO_PALETTE_PADDING, base = 0, new_base = 0;
    for (uint64_t s = 0; s < superblocks; s++) {
        uint8_t *entry = directory->data + s * SVO_PALETTE_ENTRY;
        uint64_t map, next = end;
        uint32_t offset;
        if (s % SVO_PALETTE_GROUP == 0) {
            memcpy(&base, payload->data + s / SVO_PALETTE_GROUP * 8, sizeof base);
            new_base = to;
            if (w->mark == NULL) memcpy(payload->data + s / SVO_PALETTE_GROUP * 8, &new_base, sizeof new_base);
        }
        memcpy(&map, entry, sizeof map);
        memcpy(&offset, entry + 8, sizeof offset);
        if (s + 1 < superblocks) {
            if ((s + 1) % SVO_PALETTE_GROUP == 0) {
                memcpy(&next, payload->data + (s + 1) / SVO_PALETTE_GROUP * 8, sizeof next);
            } else {
                memcpy(&offset, entry + SVO_PALETTE_ENTRY + 8, sizeof offset);
                next = base + offset;
                memcpy(&offset, entry + 8, sizeof offset);
            }
        }
        uint32_t size = copy_superblock(w, kind, bits, map, payload->data + base + offset, (uint32_t)(next - base - offset), scratch);
        if (w->mark != NULL) continue;
        memcpy(payload->data + to, scratch, size);
        offset = (uint32_t)(to - new_base);
        memcpy(entry + 8, &offset, sizeof offset);
        to += size;
    }
    if (w->mark != NULL) return;
    memset(payload->data + to, 0, SVO_PALETTE_PADDING);
    payload->size = (size_t)to + SVO_PALETTE_PADDING;
}

svo_result svoi_palette_drop_unused(svo_channel_kind kind, uint64_t table_count, svo_buffer *directory, svo_buffer *payload, svoi_used *used,
                                    const svo_allocator *a, svo_error *err)
{
    *used = (svoi_used){.words = table_count / 64 + 1};
    used->bit = svo_calloc(a, used->words, sizeof *used->bit);
    used->before = svo_calloc(a, used->words, sizeof *used->before);
    uint8_t *scratch = svo_alloc(a, SVOI_SUPERBLOCK_MAX, 1);
    if (used->bit == NULL || used->before == NULL || scratch == NULL) {
        svo_free(a, scratch, SVOI_SUPERBLOCK_MAX, 1);
        svoi_used_free(used, a);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    }
    uint32_t bits = svo_palette_table_bits(table_count);
    writing w = {.mark = used};
    copy_all(&w, kind, bits, directory, payload, scratch);
    for (uint64_t i = 0; i < used->words; i++) {
        used->before[i] = (uint32_t)used->count;
        used->count += (uint32_t)__builtin_popcountll(used->bit[i]);
    }
    if (used->count != table_count) {
        w = (writing){.used = used, .bits = svo_palette_table_bits(used->count)};
        copy_all(&w, kind, bits, directory, payload, scratch);
    }
    svo_free(a, scratch, SVOI_SUPERBLOCK_MAX, 1);
    return SVO_OK;
}

void svoi_used_free(svoi_used *u, const svo_allocator *a)
{
    svo_free(a, u->bit, u->words, sizeof *u->bit);
    svo_free(a, u->before, u->words, sizeof *u->before);
    *u = (svoi_used){0};
}
