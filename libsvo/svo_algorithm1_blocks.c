/* Blocks of Algorithm 1 in a file: docs/format/svdag.md, "Long blocks". Groups of 2^18 values are coded one by one, so memory is bounded and all
 * threads have work. */
#include "svo_task.h"
#include "svoi_algorithm1.h"

enum { GROUP_RECORD = 24 /* u64 first block, byte of the numbers, byte of the palettes */, LOCAL_SLOTS = 2 << SVO_ALGORITHM1_GROUP_BITS, MOST_WIDTH = 8 };

static uint64_t load64(const uint8_t *p)
{
    uint64_t v;
    memcpy(&v, p, sizeof v);
    return v;
}

/* An entry of the directory. */
typedef struct long_block { uint32_t begin, width; uint64_t at, palette; } long_block;

static long_block parse_block(uint64_t e)
{
    return (long_block){(uint32_t)(e & (SVO_ALGORITHM1_GROUP - 1)), (uint32_t)(e >> 18 & 15), e >> 22 & 0x1fffff, e >> 43};
}

static uint64_t block_entry(long_block b) { return b.begin | (uint64_t)b.width << 18 | b.at << 22 | b.palette << 43; }

/* --- reading ----------------------------------------------------------------------------------------------------- */

uint32_t svo_algorithm1_value(const svo_palette *p, uint64_t i)
{
    uint64_t group = i / SVO_ALGORITHM1_GROUP, groups = p->count / SVO_ALGORITHM1_GROUP + (p->count % SVO_ALGORITHM1_GROUP != 0);
    const uint8_t *record = p->payload + GROUP_RECORD * group;
    uint64_t first = load64(record), end = group + 1 < groups ? load64(record + GROUP_RECORD) : p->superblock_count;
    uint32_t j = (uint32_t)(i % SVO_ALGORITHM1_GROUP), bits = svo_palette_table_bits(p->table_count), value = 0;
    const uint8_t *d = p->directory + 8 * first;
    for (uint64_t n = end - first; n > 1;) { /* the last block that begins at j or before it */
        uint64_t half = n / 2;
        if ((load64(d + 8 * half) & (SVO_ALGORITHM1_GROUP - 1)) <= j) d += 8 * half;
        n -= half;
    }
    long_block b = parse_block(load64(d));
    uint64_t number = svo_palette_bits(p->payload + load64(record + 8), b.at + (uint64_t)(j - b.begin) * b.width, b.width);
    uint64_t index = svo_palette_bits(p->payload + load64(record + 16), (b.palette + number) * bits, bits);
    uint32_t stride = svo_channel_stride(p->kind);
    memcpy(&value, p->table + index * stride, stride);
    return value;
}

static svo_result bad(svo_error *err, uint64_t group, const char *why)
{
    svo_fail(err, SVO_INVALID_DATA, "DAG-21: group %llu of long blocks: %s", (unsigned long long)group, why);
    if (err != NULL) err->index = group;
    return SVO_INVALID_DATA;
}

typedef struct group_place { uint64_t first, last, numbers, palettes, end, length; } group_place;

static svo_result check_block(const svo_palette *p, const group_place *g, uint64_t group, long_block b, uint32_t end, uint64_t entries, svo_error *err)
{
    uint64_t most = 0, length = end - b.begin;
    for (uint64_t k = 0; k < length && b.width != 0; k++) {
        uint64_t n = svo_palette_bits(p->payload + g->numbers, b.at + k * b.width, b.width);
        most = n > most ? n : most;
    }
    return b.palette + most < entries ? SVO_OK : bad(err, group, "a number is outside the palettes");
}

/* A block out of order hides those behind it; numbers and indices are looked at one by one. */
static svo_result check_group(const svo_palette *p, const group_place *g, uint64_t group, svo_palette_stats *stats, svo_rules *rules, svo_error *err)
{
    uint32_t bits = svo_palette_table_bits(p->table_count);
    uint64_t at = 0, entries = bits != 0 ? 8 * (g->end - g->palettes) / bits : SVO_ALGORITHM1_GROUP;
    for (uint64_t i = g->first; i < g->last; i++) {
        uint64_t e = load64(p->directory + 8 * i);
        long_block b = parse_block(e);
        uint32_t end = i + 1 < g->last ? parse_block(load64(p->directory + 8 * (i + 1))).begin : (uint32_t)g->length;
        if (e >> 61 != 0 || b.width > MOST_WIDTH || b.begin >= end || (i == g->first && b.begin != 0)) return bad(err, group, "its blocks are not in order");
        if (b.at != at) return bad(err, group, "a block's numbers are not behind those before");
        at += (uint64_t)(end - b.begin) * b.width;
        if (at > 8 * (g->palettes - g->numbers)) return bad(err, group, "a block's numbers are outside");
        SVO_TRY(svo_go_on(rules, check_block(p, g, group, b, end, entries, err), err));
        uint32_t mode = b.width == 0 ? SVO_BLOCK_ONE : SVO_BLOCK_PALETTE + b.width - 1;
        stats->blocks[mode]++;
        stats->values[mode] += end - b.begin;
        stats->bits[mode] += (uint64_t)(end - b.begin) * b.width;
    }
    if ((at + 7) / 8 != g->palettes - g->numbers) SVO_TRY(svo_go_on(rules, bad(err, group, "its numbers have another size"), err));
    for (uint64_t k = 0; k < entries && bits != 0; k++)
        if (svo_palette_bits(p->payload + g->palettes, k * bits, bits) >= p->table_count)
            SVO_TRY(svo_go_on(rules, bad(err, group, "an index is outside the table"), err));
    return SVO_OK;
}

svo_result svo_algorithm1_check(const svo_palette *p, svo_palette_stats *stats, svo_error *err) { return svo_algorithm1_check_all(p, stats, NULL, err); }

svo_result svo_algorithm1_check_all(const svo_palette *p, svo_palette_stats *stats, svo_rules *rules, svo_error *err)
{
    uint64_t groups = p->count / SVO_ALGORITHM1_GROUP + (p->count % SVO_ALGORITHM1_GROUP != 0);
    svo_palette_stats local = {0};
    if (groups > p->payload_size / GROUP_RECORD || p->payload_size - GROUP_RECORD * groups < SVO_PALETTE_PADDING) return bad(err, 0, "the payload is too short");
    if (p->table_count == 0 || p->table_count > (uint64_t)1 << 31) return bad(err, 0, "the table has no entries or too many");
    uint64_t end = p->payload_size - SVO_PALETTE_PADDING, behind = GROUP_RECORD * groups, block = 0;
    for (uint64_t i = 0; i < groups; i++) {
        const uint8_t *r = p->payload + GROUP_RECORD * i;
        bool last = i + 1 == groups;
        group_place g = {.first = load64(r), .last = last ? p->superblock_count : load64(r + GROUP_RECORD), .numbers = load64(r + 8), .palettes = load64(r + 16),
                         .end = last ? end : load64(r + GROUP_RECORD + 8), .length = last ? p->count - i * SVO_ALGORITHM1_GROUP : SVO_ALGORITHM1_GROUP};
        if (g.first != block || g.last <= g.first || g.last > p->superblock_count) return bad(err, i, "it has no blocks, or others' blocks");
        if (g.numbers != behind || g.palettes < g.numbers || g.end < g.palettes || g.end > end) return bad(err, i, "it is not behind the one before");
        SVO_TRY(svo_go_on(rules, check_group(p, &g, i, &local, rules, err), err));
        block = g.last, behind = g.end;
    }
    if (block != p->superblock_count || behind != end) SVO_TRY(svo_go_on(rules, bad(err, groups, "there is more than the groups hold"), err));
    for (uint32_t i = 0; i < SVO_PALETTE_PADDING; i++)
        if (p->payload[end + i] != 0) SVO_TRY(svo_go_on(rules, bad(err, groups, "padding is not 0"), err));
    if (stats != NULL) *stats = local;
    return SVO_OK;
}

/* --- writing ----------------------------------------------------------------------------------------------------- */

typedef struct group_bytes { svo_buffer directory, numbers, palettes; } group_bytes;

typedef struct run {
    svoi_encoder e;
    group_bytes *group;
} run;

/* The values of a group, numbered by first appearance. */
typedef struct worker {
    uint32_t values[SVO_SUPERBLOCK];
    uint32_t index[SVO_ALGORITHM1_GROUP];  /* local numbers */
    uint32_t table[SVO_ALGORITHM1_GROUP];  /* of local numbers: the table's */
    uint32_t place[SVO_ALGORITHM1_GROUP];  /* of local numbers: in a block's palette */
    uint32_t slot[LOCAL_SLOTS];            /* local number + 1 */
    uint32_t distinct;
} worker;

static bool number_values(const run *r, worker *w, uint64_t first, uint32_t n)
{
    const svo_palette_job *j = r->e.job;
    w->distinct = 0;
    memset(w->slot, 0, sizeof w->slot);
    for (uint32_t at = 0; at < n; at += SVO_SUPERBLOCK) {
        uint32_t some = n - at < SVO_SUPERBLOCK ? n - at : SVO_SUPERBLOCK;
        j->source(j->user, first + at, some, w->values);
        for (uint32_t i = 0; i < some; i++) {
            if (i != 0 && w->values[i] == w->values[i - 1]) {
                w->index[at + i] = w->index[at + i - 1];
                continue;
            }
            uint32_t t = svoi_table_index(&r->e, w->values[i]), s = (t * 2654435761u) >> (31 - SVO_ALGORITHM1_GROUP_BITS);
            if (t == SVOI_NO_INDEX) return false;
            while (w->slot[s] != 0 && w->table[w->slot[s] - 1] != t) s = (s + 1) & (LOCAL_SLOTS - 1);
            if (w->slot[s] == 0) {
                w->table[w->distinct++] = t;
                w->slot[s] = w->distinct;
            }
            w->index[at + i] = w->slot[s] - 1;
        }
    }
    return true;
}

/* Bits to a buffer in whole bytes at the end. Room was made. */
typedef struct bit_writer { svo_buffer *to; svoi_bits bits; } bit_writer;

static bool begin_bits(bit_writer *w, svo_buffer *to, uint64_t bits)
{
    *w = (bit_writer){.to = to};
    if (!svo_buffer_reserve(to, (size_t)(bits / 8 + 16))) return false;
    w->bits.p = to->data;
    return true;
}

static void end_bits(bit_writer *w)
{
    svoi_put_end(&w->bits);
    w->to->size = (size_t)(w->bits.p - w->to->data);
}

static bool write_group(const run *r, worker *w, uint32_t n, const svo_algorithm1_result *a, group_bytes *out)
{
    bit_writer numbers, palettes;
    uint64_t number_bits = 0, at = 0;
    for (uint64_t i = 0; i < a->block_count; i++)
        number_bits += ((i + 1 < a->block_count ? a->blocks[i + 1].begin : n) - a->blocks[i].begin) * a->blocks[i].bits;
    if (!begin_bits(&numbers, &out->numbers, number_bits) || !begin_bits(&palettes, &out->palettes, a->palette_entries * r->e.table_bits)) return false;
    /* palettes lie behind each other, each with its length before it */
    uint64_t entries = 0;
    for (uint64_t from = 0; entries < a->palette_entries;) {
        uint32_t count = a->palettes[from++];
        for (uint32_t k = 0; k < count; k++) svoi_put(&palettes.bits, w->table[a->palettes[from + k]], r->e.table_bits);
        from += count, entries += count;
    }
    end_bits(&palettes);
    for (uint64_t i = 0; i < a->block_count; i++) {
        const svo_algorithm1_block *b = &a->blocks[i];
        uint64_t end = i + 1 < a->block_count ? a->blocks[i + 1].begin : n;
        const uint32_t *palette = a->palettes + b->palette;
        for (uint32_t k = 0; k < palette[-1]; k++) w->place[palette[k]] = k;
        /* entries before it: what lies before in `palettes` less a length for each palette */
        uint64_t entry = block_entry((long_block){(uint32_t)b->begin, b->bits, at, b->palette - b->palette_number - 1});
        if (svo_buffer_append(&out->directory, &entry, sizeof entry) == NULL) return false;
        for (uint64_t k = b->begin; k < end && b->bits != 0; k++) svoi_put(&numbers.bits, w->place[w->index[k]], b->bits);
        at += (end - b->begin) * b->bits;
    }
    end_bits(&numbers);
    return true;
}

static svo_result encode_groups(void *user, uint64_t begin, uint64_t end, uint32_t number, svo_error *err)
{
    (void)number;
    run *r = user;
    const svo_palette_job *j = r->e.job;
    worker *w = svo_alloc(j->allocator, 1, sizeof *w);
    if (w == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    svo_result result = SVO_OK;
    for (uint64_t i = begin; i < end && result == SVO_OK; i++) {
        uint64_t first = i * SVO_ALGORITHM1_GROUP, left = j->count - first;
        uint32_t n = left < SVO_ALGORITHM1_GROUP ? (uint32_t)left : SVO_ALGORITHM1_GROUP;
        svo_algorithm1_result a;
        if (!number_values(r, w, first, n)) {
            result = svo_fail(err, SVO_INVALID_ARGUMENT, "a value is not in the table");
            break;
        }
        result = svoi_algorithm1(w->index, n, w->distinct, r->e.table_bits, 64, 1, j->allocator, &a, err);
        if (result != SVO_OK) break;
        if (!write_group(r, w, n, &a, &r->group[i])) result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
        svo_algorithm1_free(&a, j->allocator);
    }
    svo_free(j->allocator, w, 1, sizeof *w);
    return result;
}

static svo_result join(run *r, uint64_t groups, svo_buffer *directory, svo_buffer *payload, svo_error *err)
{
    uint64_t bytes = GROUP_RECORD * groups, blocks = 0, at = bytes;
    for (uint64_t i = 0; i < groups; i++) bytes += r->group[i].numbers.size + r->group[i].palettes.size, blocks += r->group[i].directory.size / 8;
    if (!svo_buffer_reserve(payload, (size_t)bytes + SVO_PALETTE_PADDING) || !svo_buffer_reserve(directory, (size_t)blocks * 8))
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    svo_buffer_append(payload, NULL, (size_t)at);
    blocks = 0;
    for (uint64_t i = 0; i < groups; i++) {
        group_bytes *g = &r->group[i];
        uint64_t record[3] = {blocks, at, at + g->numbers.size};
        memcpy(payload->data + GROUP_RECORD * i, record, sizeof record);
        blocks += g->directory.size / 8;
        at += g->numbers.size + g->palettes.size;
        svo_buffer_append(directory, g->directory.data, g->directory.size);
        if (g->numbers.size != 0) svo_buffer_append(payload, g->numbers.data, g->numbers.size);
        if (g->palettes.size != 0) svo_buffer_append(payload, g->palettes.data, g->palettes.size);
    }
    svo_buffer_append(payload, NULL, SVO_PALETTE_PADDING);
    return SVO_OK;
}

svo_result svo_algorithm1_encode(const svo_palette_job *job, svo_buffer *directory, svo_buffer *payload, svo_error *err)
{
    SVO_ASSERT(payload->size == 0 && job->count != 0);
    if (job->table_count > (uint64_t)1 << 31) return svo_fail(err, SVO_LIMIT, "a channel's table has more than 2^31 values");
    run r = {.e = {.job = job, .table_bits = svo_palette_table_bits(job->table_count)}};
    uint64_t groups = (job->count + SVO_ALGORITHM1_GROUP - 1) / SVO_ALGORITHM1_GROUP;
    svo_result result = svoi_table_fill(&r.e) ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    r.group = result == SVO_OK ? svo_calloc(job->allocator, groups, sizeof *r.group) : NULL;
    if (result == SVO_OK && r.group == NULL) result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    if (result == SVO_OK) {
        for (uint64_t i = 0; i < groups; i++) {
            svo_buffer_init(&r.group[i].directory, job->allocator);
            svo_buffer_init(&r.group[i].numbers, job->allocator);
            svo_buffer_init(&r.group[i].palettes, job->allocator);
        }
        result = svo_parallel_for(job->threads, groups, 1, encode_groups, &r, err);
        if (result == SVO_OK) result = join(&r, groups, directory, payload, err);
    }
    for (uint64_t i = 0; i < groups && r.group != NULL; i++) {
        svo_buffer_free(&r.group[i].directory);
        svo_buffer_free(&r.group[i].numbers);
        svo_buffer_free(&r.group[i].palettes);
    }
    svo_free(job->allocator, r.group, groups, sizeof *r.group);
    svo_free(job->allocator, r.e.slots, r.e.slot_count, sizeof *r.e.slots);
    return result;
}
