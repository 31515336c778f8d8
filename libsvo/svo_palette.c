#include "svo_palette.h"

#include "svo_task.h"

enum {
    GRANULES = 64,    /* in a superblock */
    LEVELS = 7,       /* block sizes 16 << 0 .. 16 << 6 */
    MAX_WIDTH = 6,    /* bits of a palette index */
    MODE_RAW = 7,
    HEADER_BITS = 16, /* of a block */
    BATCH = 64,       /* superblocks a task */
    SEEN = 2048       /* slots of the table below, a power of two > 1024 */
};

/* Positions of values in the current superblock, or numbers in the current palette. A slot is valid when its stamp is
 * the current one, so clearing costs nothing. */
typedef struct seen {
    uint32_t stamp;
    struct { uint32_t stamp, key, value; } slot[SEEN];
} seen;

static uint32_t *seen_find(seen *s, uint32_t key, bool *found)
{
    uint32_t i = (key * 2654435761u) >> 21;
    while (s->slot[i].stamp == s->stamp && s->slot[i].key != key) i = (i + 1) & (SEEN - 1);
    *found = s->slot[i].stamp == s->stamp;
    s->slot[i].stamp = s->stamp;
    s->slot[i].key = key;
    return &s->slot[i].value;
}

static uint32_t data_bytes(uint32_t mode, uint32_t granules, uint32_t distinct, uint32_t table_bits)
{
    uint32_t n = granules * SVO_GRANULE, bits;
    if (mode == 0) bits = table_bits;
    else if (mode == MODE_RAW) bits = n * table_bits;
    else bits = n * mode + distinct * table_bits;
    return (bits + 7) / 8;
}

/* Cheapest way to store a block; ties go to the smaller mode. */
static uint32_t best_mode(uint32_t granules, uint32_t distinct, uint32_t table_bits, uint32_t *bytes)
{
    uint32_t mode = MODE_RAW;
    *bytes = data_bytes(MODE_RAW, granules, distinct, table_bits);
    if (distinct == 1) mode = 0;
    else {
        uint32_t width = 32 - (uint32_t)__builtin_clz(distinct - 1);
        if (width <= MAX_WIDTH && data_bytes(width, granules, distinct, table_bits) <= *bytes) mode = width;
    }
    if (mode != MODE_RAW) *bytes = data_bytes(mode, granules, distinct, table_bits);
    return mode;
}

/* Distinct values of every dyadic range, level by level: a value counts in those ranges that hold no earlier equal one. */
static void count_distinct(seen *s, const uint32_t *v, uint32_t n, uint16_t distinct[LEVELS][GRANULES])
{
    memset(distinct, 0, sizeof(uint16_t) * LEVELS * GRANULES);
    s->stamp++;
    for (uint32_t i = 0; i < n; i++) {
        bool found;
        uint32_t *last = seen_find(s, v[i], &found);
        /* ranges of 16 << k that hold i but not *last: those with a differing bit at or above 4 + k */
        uint32_t differ = found ? (*last ^ i) >> 4 : GRANULES;
        for (uint32_t k = 0; k < LEVELS && differ >> k != 0; k++) distinct[k][i >> (4 + k)]++;
        *last = i;
    }
}

/* Bottom-up: keep a range whole where that is not dearer than its halves. Returns the map of block begins. */
static uint64_t choose_blocks(uint16_t distinct[LEVELS][GRANULES], uint32_t granules, uint32_t table_bits)
{
    uint32_t cost[GRANULES]; /* bits, of the ranges of the level below */
    uint64_t map = granules == GRANULES ? ~(uint64_t)0 : ((uint64_t)1 << granules) - 1;
    for (uint32_t i = 0; i < granules; i++) {
        uint32_t bytes;
        best_mode(1, distinct[0][i], table_bits, &bytes);
        cost[i] = HEADER_BITS + 8 * bytes;
    }
    for (uint32_t k = 1; k < LEVELS; k++) {
        uint32_t ranges = (granules + (1u << k) - 1) >> k, below = (granules + (1u << (k - 1)) - 1) >> (k - 1);
        for (uint32_t i = 0; i < ranges; i++) {
            if (2 * i + 1 >= below) { /* nothing to merge with */
                cost[i] = cost[2 * i];
                continue;
            }
            uint32_t begin = i << k, end = begin + (1u << k), bytes;
            if (end > granules) end = granules;
            best_mode(end - begin, distinct[k][i], table_bits, &bytes);
            uint32_t whole = HEADER_BITS + 8 * bytes, split = cost[2 * i] + cost[2 * i + 1];
            cost[i] = split;
            if (whole <= split) {
                cost[i] = whole;
                map &= ~((((uint64_t)1 << (end - begin - 1)) - 1) << (begin + 1));
            }
        }
    }
    return map;
}

typedef struct bit_writer {
    uint8_t *p;
    uint64_t bits;
    uint32_t held;
} bit_writer;

static void put(bit_writer *w, uint32_t value, uint32_t width)
{
    w->bits |= (uint64_t)value << w->held;
    w->held += width;
    while (w->held >= 8) {
        *w->p++ = (uint8_t)w->bits;
        w->bits >>= 8;
        w->held -= 8;
    }
}

static void put_end(bit_writer *w)
{
    if (w->held != 0) *w->p++ = (uint8_t)w->bits;
    w->bits = 0;
    w->held = 0;
}

/* One block; v has granules * 16 values (the last one repeated at the very end of the channel). */
static uint32_t write_block(seen *s, bit_writer *w, const uint32_t *v, uint32_t granules, uint32_t table_bits)
{
    uint32_t n = granules * SVO_GRANULE, palette[SVO_SUPERBLOCK], number[SVO_SUPERBLOCK], distinct = 0, bytes;
    s->stamp++;
    for (uint32_t i = 0; i < n; i++) {
        bool found;
        uint32_t *slot = seen_find(s, v[i], &found);
        if (!found) {
            *slot = distinct;
            palette[distinct++] = v[i];
        }
        number[i] = *slot;
    }
    uint32_t mode = best_mode(granules, distinct, table_bits, &bytes);
    if (mode == 0) put(w, v[0], table_bits);
    else if (mode == MODE_RAW)
        for (uint32_t i = 0; i < n; i++) put(w, v[i], table_bits);
    else {
        for (uint32_t i = 0; i < n; i++) put(w, number[i], mode);
        for (uint32_t i = 0; i < distinct; i++) put(w, palette[i], table_bits);
    }
    put_end(w);
    return mode;
}

/* Largest superblock: map, headers, and never more than raw indices plus what a header and its rounding take. */
enum { SUPERBLOCK_MAX = 8 + 2 * GRANULES + 4 * SVO_SUPERBLOCK + GRANULES };

static uint32_t write_superblock(seen *s, uint32_t *v, uint32_t n, uint32_t table_bits, uint8_t *out, svo_palette_stats *stats)
{
    uint32_t granules = (n + SVO_GRANULE - 1) / SVO_GRANULE;
    for (uint32_t i = n; i < granules * SVO_GRANULE; i++) v[i] = v[n - 1];
    uint16_t distinct[LEVELS][GRANULES];
    count_distinct(s, v, n, distinct);
    uint64_t map = choose_blocks(distinct, granules, table_bits);
    uint32_t blocks = (uint32_t)__builtin_popcountll(map);
    uint64_t stored = granules < GRANULES ? map | (uint64_t)1 << granules : map; /* the end of the last block */
    memcpy(out, &stored, sizeof stored);
    bit_writer w = {.p = out + 8 + 2 * blocks};
    for (uint32_t b = 0; b < blocks; b++) {
        uint32_t begin = (uint32_t)__builtin_ctzll(map);
        map &= map - 1;
        uint32_t end = map != 0 ? (uint32_t)__builtin_ctzll(map) : granules;
        uint32_t at = (uint32_t)(w.p - out), mode = write_block(s, &w, v + begin * SVO_GRANULE, end - begin, table_bits);
        uint16_t header = (uint16_t)(at << 3 | mode);
        memcpy(out + 8 + 2 * b, &header, sizeof header);
        stats->blocks[mode]++;
    }
    return (uint32_t)(w.p - out);
}

typedef struct encoder {
    uint64_t count, superblocks;
    uint32_t table_bits;
    svo_palette_source source;
    void *user;
    uint64_t *directory; /* offsets count from the batch's own bytes at first */
    svo_buffer *bytes;   /* a batch */
    svo_palette_stats *stats;
} encoder;

static svo_result encode_batches(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    encoder *e = user;
    seen *s = svo_calloc(e->bytes[0].allocator, 1, sizeof *s);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    svo_result r = SVO_OK;
    uint32_t v[SVO_SUPERBLOCK];
    uint8_t out[SUPERBLOCK_MAX];
    for (uint64_t batch = begin; batch < end && r == SVO_OK; batch++) {
        uint64_t last = (batch + 1) * BATCH < e->superblocks ? (batch + 1) * BATCH : e->superblocks;
        for (uint64_t b = batch * BATCH; b < last; b++) {
            uint64_t first = b * SVO_SUPERBLOCK, left = e->count - first;
            uint32_t n = left < SVO_SUPERBLOCK ? (uint32_t)left : SVO_SUPERBLOCK, same = 1;
            e->source(e->user, first, n, v);
            while (same < n && v[same] == v[0]) same++;
            if (same == n) {
                e->directory[b] = SVO_PALETTE_CONSTANT | v[0];
                e->stats[batch].constant_superblocks++;
                continue;
            }
            uint32_t size = write_superblock(s, v, n, e->table_bits, out, &e->stats[batch]);
            e->directory[b] = e->bytes[batch].size;
            if (svo_buffer_append(&e->bytes[batch], out, size) == NULL) {
                r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
                break;
            }
        }
    }
    svo_free(e->bytes[0].allocator, s, 1, sizeof *s);
    return r;
}

static void add_stats(svo_palette_stats *to, const svo_palette_stats *s)
{
    to->constant_superblocks += s->constant_superblocks;
    for (int i = 0; i < 8; i++) to->blocks[i] += s->blocks[i];
}

svo_result svo_palette_encode(uint64_t count, uint64_t table_count, svo_palette_source source, void *user, uint32_t threads,
                              svo_buffer *directory, svo_buffer *payload, svo_palette_stats *stats, svo_error *err)
{
    const svo_allocator *a = directory->allocator;
    encoder e = {.count = count, .superblocks = (count + SVO_SUPERBLOCK - 1) / SVO_SUPERBLOCK,
                 .table_bits = svo_palette_table_bits(table_count), .source = source, .user = user};
    uint64_t batches = (e.superblocks + BATCH - 1) / BATCH, total = 0;
    if (e.table_bits > 32) return svo_fail(err, SVO_LIMIT, "a channel has more than 2^32 different values");
    e.bytes = svo_calloc(a, batches, sizeof *e.bytes);
    e.stats = svo_calloc(a, batches, sizeof *e.stats);
    e.directory = svo_buffer_append(directory, NULL, (size_t)e.superblocks * 8);
    svo_result r = SVO_OK;
    if (batches != 0 && (e.bytes == NULL || e.stats == NULL || e.directory == NULL))
        r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    if (r == SVO_OK) {
        for (uint64_t i = 0; i < batches; i++) svo_buffer_init(&e.bytes[i], a);
        r = svo_parallel_for(threads, batches, 1, encode_batches, &e, err);
    }
    if (r == SVO_OK) {
        for (uint64_t i = 0; i < batches; i++) total += e.bytes[i].size;
        if (!svo_buffer_reserve(payload, (size_t)total + SVO_PALETTE_PADDING))
            r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    }
    for (uint64_t i = 0; i < batches && r == SVO_OK; i++) {
        uint64_t last = (i + 1) * BATCH < e.superblocks ? (i + 1) * BATCH : e.superblocks;
        for (uint64_t b = i * BATCH; b < last; b++)
            if (!(e.directory[b] & SVO_PALETTE_CONSTANT)) e.directory[b] += payload->size;
        svo_buffer_append(payload, e.bytes[i].data, e.bytes[i].size);
        svo_buffer_free(&e.bytes[i]);
        if (stats != NULL) add_stats(stats, &e.stats[i]);
    }
    if (r == SVO_OK) svo_buffer_append(payload, NULL, SVO_PALETTE_PADDING);
    if (e.bytes != NULL)
        for (uint64_t i = 0; i < batches; i++) svo_buffer_free(&e.bytes[i]);
    svo_free(a, e.bytes, batches, sizeof *e.bytes);
    svo_free(a, e.stats, batches, sizeof *e.stats);
    return r;
}

/* --- checking ---------------------------------------------------------------------------------------------------- */

static svo_result bad(svo_error *err, uint64_t superblock, const char *why)
{
    svo_fail(err, SVO_INVALID_DATA, "DAG-09: superblock %llu: %s", (unsigned long long)superblock, why);
    if (err != NULL) err->index = superblock;
    return SVO_INVALID_DATA;
}

/* `s` has `size` bytes of its own, behind which 8 more can be read. */
static svo_result check_superblock(uint64_t number, uint32_t n, uint64_t table_count, const uint8_t *s, uint64_t size,
                                   svo_palette_stats *stats, svo_error *err)
{
    uint32_t granules = (n + SVO_GRANULE - 1) / SVO_GRANULE, table_bits = svo_palette_table_bits(table_count);
    uint64_t map;
    if (size < sizeof map) return bad(err, number, "does not fit the payload");
    memcpy(&map, s, sizeof map);
    if (granules < GRANULES) {
        if (map >> granules != 1) return bad(err, number, "the map of blocks does not end where the values do");
        map ^= (uint64_t)1 << granules;
    }
    if (!(map & 1)) return bad(err, number, "the first block does not begin at 0");
    uint32_t blocks = (uint32_t)__builtin_popcountll(map);
    uint64_t at = 8 + 2 * (uint64_t)blocks; /* blocks follow each other without gaps */
    if (at > size) return bad(err, number, "does not fit the payload");
    for (uint32_t b = 0; b < blocks; b++) {
        uint32_t begin = (uint32_t)__builtin_ctzll(map);
        map &= map - 1;
        uint32_t end = map != 0 ? (uint32_t)__builtin_ctzll(map) : granules, values = (end - begin) * SVO_GRANULE;
        uint16_t header;
        memcpy(&header, s + 8 + 2 * b, sizeof header);
        uint32_t mode = header & 7, most = 0, entries = mode == 0 ? 1 : values;
        if (header >> 3 != at) return bad(err, number, "a block does not begin where the last one ends");
        stats->blocks[mode]++;
        const uint8_t *data = s + at;
        uint64_t base = 0;
        if (mode != 0 && mode != MODE_RAW) {
            base = (uint64_t)values * mode;
            if (at + base / 8 > size) return bad(err, number, "a block does not fit the payload");
            for (uint32_t i = 0; i < values; i++) {
                uint32_t index = svo_palette_bits(data, (uint64_t)i * mode, mode);
                if (index > most) most = index;
            }
            entries = most + 1;
        }
        uint64_t bytes = (base + (uint64_t)entries * table_bits + 7) / 8;
        if (bytes > size - at) return bad(err, number, "a block does not fit the payload");
        for (uint32_t i = 0; i < entries; i++)
            if (svo_palette_bits(data, base + (uint64_t)i * table_bits, table_bits) >= table_count)
                return bad(err, number, "an index is outside the table");
        at += bytes;
    }
    return at == size ? SVO_OK : bad(err, number, "is larger than its blocks");
}

svo_result svo_palette_check(uint64_t count, uint64_t table_count, const uint64_t *directory, uint64_t superblocks,
                             const uint8_t *payload, uint64_t payload_size, svo_palette_stats *stats, svo_error *err)
{
    svo_palette_stats local = {0};
    uint64_t at = 0, end = payload_size - SVO_PALETTE_PADDING, next = 0;
    if (table_count == 0 || table_count > (uint64_t)1 << 32) return bad(err, 0, "the size of the table is out of range");
    if (superblocks != count / SVO_SUPERBLOCK + (count % SVO_SUPERBLOCK != 0)) return bad(err, 0, "wrong number of superblocks");
    if (payload_size < SVO_PALETTE_PADDING) return bad(err, 0, "the payload lacks its padding");
    for (uint64_t b = 0; b < superblocks; b++) {
        if (directory[b] & SVO_PALETTE_CONSTANT) {
            uint64_t index = directory[b] ^ SVO_PALETTE_CONSTANT;
            if (index >= table_count) return bad(err, b, "an index is outside the table");
            local.constant_superblocks++;
            continue;
        }
        if (directory[b] != at) return bad(err, b, "does not begin where the last one ends");
        /* it reaches to the begin of the next one that is stored */
        if (next <= b) next = b + 1;
        while (next < superblocks && directory[next] & SVO_PALETTE_CONSTANT) next++;
        uint64_t to = next < superblocks ? directory[next] : end;
        if (to < at || to > end) return bad(err, b, "does not fit the payload");
        uint64_t left = count - b * SVO_SUPERBLOCK;
        SVO_TRY(check_superblock(b, left < SVO_SUPERBLOCK ? (uint32_t)left : SVO_SUPERBLOCK, table_count, payload + at, to - at, &local, err));
        at = to;
    }
    if (at != end) return bad(err, 0, "the payload is larger than its superblocks");
    for (uint32_t i = 0; i < SVO_PALETTE_PADDING; i++)
        if (payload[end + i] != 0) return bad(err, 0, "padding is not 0");
    if (stats != NULL) *stats = local;
    return SVO_OK;
}
