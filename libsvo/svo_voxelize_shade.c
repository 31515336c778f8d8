#include "svoi_voxelize.h"

#include <string.h>

#include "svo_morton.h"
#include "svoi_shade_avx2.h"
#include "svoi_shade_wide.h"

static svo_result out_of_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while averaging attributes"); }

void svoi_load_triangle(const svoi_scan *s, uint32_t triangle, svo_record *record)
{
    svo_bins_record(s->r->bins, triangle, record);
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 3; k++) record->q[c][k] -= s->corner_axis[k] * SVO_RASTER_UNIT;
}

void svoi_load_facet(svoi_scan *s, uint32_t triangle, const svo_record *record)
{
    double block[3] = {s->corner_axis[0], s->corner_axis[1], s->corner_axis[2]};
    svo_facet_make(s->r->shader, record->group, triangle - s->r->placement.groups[record->group].first, block, (const int32_t(*)[3])record->q, &s->facet);
    s->whole.count = 3;
    memcpy(s->whole.at, s->facet.corner, sizeof s->facet.corner);
    s->flat_ready = s->inner_ready = false;
}

/* Is something of the facet visible in a voxel? */
bool svoi_visible(svoi_scan *s, const int32_t cell[3])
{
    svo_polygon a, b;
    svo_polygon_slab(&s->whole, 0, cell[0], &a);
    svo_polygon_slab(&a, 1, cell[1], &b);
    svo_polygon_slab(&b, 2, cell[2], &a);
    return svo_facet_visible(s->r->shader, &s->facet, &a, cell);
}

/* --- a chunk's attributes ------------------------------------------------------------------------------------- */

typedef struct row_visitor { svoi_scan *s; svoi_voxel_fn fn; } row_visitor;

static void visit_row(void *user, const svo_raster_row *row)
{
    row_visitor *v = user;
    const svo_block *b = v->s->w->block;
    for (int32_t u = row->u0; u <= row->u1; u++) {
        uint32_t column = svo_block_column(b, row, u);
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) {
            uint32_t code = column | b->spread[row->w][w];
            if (b->bricks[code >> 6] >> (code & 63) & 1) v->fn(v->s, code); /* not: not in the thin set, or masked away */
        }
    }
}

static inline void visit_voxels(svoi_scan *s, uint64_t i, const svo_record *record, const int32_t box_lo[3], const int32_t box_hi[3], svoi_voxel_fn fn)
{
    if (!s->recording) {
        const svo_raster_target cube = svo_raster_cube();
        row_visitor v = {s, fn};
        svo_raster_scan((const int32_t(*)[3])record->q, &cube, box_lo, box_hi, visit_row, &v);
        return;
    }
    const svo_block *b = s->w->block;
    const svoi_start *start = (const svoi_start *)(const void *)s->w->starts.data + i;
    const svo_block_visit *visits = (const svo_block_visit *)(const void *)s->w->visits.data;
    const uint32_t *codes = (const uint32_t *)(const void *)s->w->codes.data;
    for (uint32_t at = start->code; at < start[1].code; at++)
        if (b->bricks[codes[at] >> 6] >> (codes[at] & 63) & 1) fn(s, codes[at]);
    for (uint32_t at = start->visit; at < start[1].visit; at++)
        for (uint64_t bits = visits[at].bits & b->bricks[visits[at].brick]; bits != 0; bits &= bits - 1) fn(s, visits[at].brick << 6 | (uint32_t)__builtin_ctzll(bits));
}

void svoi_visit_voxels(svoi_scan *s, uint64_t i, const svo_record *record, const int32_t box_lo[3], const int32_t box_hi[3], svoi_voxel_fn fn)
{
    visit_voxels(s, i, record, box_lo, box_hi, fn);
}

/* Does alpha MASK leave something of the facet in a voxel? */
static inline bool left(svoi_scan *s, uint32_t code)
{
    if (!s->facet.masks) return true;
    uint32_t x, y, z;
    svo_morton_decode(code, &x, &y, &z);
    const int32_t cell[3] = {(int32_t)x, (int32_t)y, (int32_t)z};
    return svoi_visible(s, cell);
}

static inline bool push(svoi_lanes *l, uint32_t code, uint32_t target)
{
    l->code[l->count] = code;
    l->target[l->count] = target;
    return ++l->count == SVOI_LANES;
}

/* What a flat facet contributes wherever it is. */
static const svo_contribution *flat_contribution(svoi_scan *s)
{
    if (!s->flat_ready) {
        svo_piece piece;
        svo_facet_piece(&s->facet, &piece);
        svo_facet_contribution(s->r->shader, &s->facet, &piece, s->shift, &s->flat);
        svoi_flat_values(s->layout, &s->flat, &s->flat_values);
        s->flat_ready = true;
    }
    return &s->flat;
}

/* Voxels that the facet shares with others: to the sums. */
static void flush_shared(svoi_scan *s)
{
    svoi_lanes *l = &s->shared;
    if (l->count == 0) return;
    /* sums of a chunk are more than the nearest caches hold: ask for them while areas are found */
    const uint32_t fields = s->layout->fields;
    for (uint32_t i = 0; i < l->count; i++) {
        const uint64_t *sums = s->sums + (uint64_t)l->target[i] * fields;
        __builtin_prefetch(sums, 1);
        __builtin_prefetch(sums + fields - 1, 1);
    }
    if (s->facet.flat) {
        svoi_lanes_areas(&s->facet, l);
        svoi_lanes_add_flat(s->layout, flat_contribution(s), l, s->shift, s->sums);
    } else {
        svoi_lanes_values(s->r->shader, &s->facet, l);
        svoi_lanes_add(s->r->shader, &s->facet, l, s->shift, s->sums);
    }
    l->count = 0;
}

/* The first of those that wait (a batch, or all): to their values. */
static void flush_waiting(svoi_scan *s, svoi_wait *w, bool inner)
{
    svoi_lanes *l = &s->batch;
    const uint32_t n = w->count < SVOI_LANES ? w->count : SVOI_LANES;
    if (n == 0) return;
    memcpy(l->code, w->code, n * sizeof *l->code);
    memcpy(l->target, w->target, n * sizeof *l->target);
    l->count = n;
    if (inner) svoi_inner_values(s->r->shader, &s->facet, &s->inner, l);
    else svoi_lanes_values(s->r->shader, &s->facet, l);
    svoi_lanes_write(s->layout, l, s->channels);
    w->count -= n;
    memcpy(w->code, w->code + n, w->count * sizeof *w->code);
    memcpy(w->target, w->target + n, w->count * sizeof *w->target);
}

/* Sort a batch into voxels that an edge of the facet may reach and others. */
static void sort_alone(svoi_scan *s)
{
    svoi_lanes *l = &s->alone;
    svoi_wait *in = &s->wait_inner, *edge = &s->wait_edge;
    uint8_t inner[SVOI_LANES];
    svoi_inner_find(&s->facet, l, inner);
    uint32_t n = in->count, m = edge->count;
    for (uint32_t i = 0; i < l->count; i++) {
        const uint32_t code = l->code[i], target = l->target[i], is = inner[i];
        in->code[n] = edge->code[m] = code;
        in->target[n] = edge->target[m] = target;
        n += is;
        m += 1 - is;
    }
    in->count = n;
    edge->count = m;
    if (n >= SVOI_LANES) flush_waiting(s, in, true);
    if (m >= SVOI_LANES) flush_waiting(s, edge, false);
}

/* Is there a table for voxels that no edge reaches? It is made when first asked for. */
static inline bool has_inner(svoi_scan *s)
{
    if (!s->inner_ready) {
        s->has_inner = svoi_inner_make(s->r->shader, &s->facet, &s->inner);
        if (s->has_inner) svoi_inner_bricks(&s->facet, s->inner_reach);
    }
    s->inner_ready = true;
    return s->has_inner;
}

/* Voxels that it has alone: to their values. */
static void flush_alone(svoi_scan *s)
{
    svoi_lanes *l = &s->alone;
    if (l->count == 0) return;
    if (s->facet.flat) {
        flat_contribution(s);
        svoi_lanes_write_flat(s->layout, &s->flat_values, l, s->channels);
        l->count = 0;
        return;
    }
    if (has_inner(s)) {
        sort_alone(s);
    } else {
        svoi_lanes_values(s->r->shader, &s->facet, l);
        svoi_lanes_write(s->layout, l, s->channels);
    }
    l->count = 0;
}

/* All that the facet has left. */
static void flush_facet(svoi_scan *s)
{
    flush_shared(s);
    flush_alone(s);
    flush_waiting(s, &s->wait_inner, true);
    flush_waiting(s, &s->wait_edge, false);
}

/* A material's weight alone. */
static void flush_weights(svoi_scan *s)
{
    svoi_lanes *l = &s->shared;
    if (l->count == 0) return;
    svoi_lanes_areas(&s->facet, l);
    svoi_lanes_add_areas(l, s->shift, s->sums);
    l->count = 0;
}

static inline void shade_voxel(svoi_scan *s, uint32_t code)
{
    const svo_block *b = s->w->block;
    if (b->complex[code >> 6] >> (code & 63) & 1) {
        uint64_t index = svo_block_complex_index(b, code);
        if (index < s->slice_begin || index >= s->slice_end || !left(s, code)) return;
        if (push(&s->shared, code, (uint32_t)(index - s->slice_begin))) flush_shared(s);
    } else if (s->first_slice && !s->facet.masks) { /* voxels that a masked facet is seen in are averaged */
        if (push(&s->alone, code, svo_block_index(b, code))) flush_alone(s);
    }
}

/* Work on the first batch of what waits, `count` voxels, and keep the rest. */
static void flush_batch(svoi_scan *s, svoi_lanes *l, uint32_t count, void (*flush)(svoi_scan *))
{
    const uint32_t rest = count - SVOI_LANES;
    l->count = SVOI_LANES;
    flush(s);
    memcpy(l->code, l->code + SVOI_LANES, rest * sizeof *l->code);
    memcpy(l->target, l->target + SVOI_LANES, rest * sizeof *l->target);
    l->count = rest;
}

/* Codes of a brick's voxels, and their numbers, counted on among the brick's `among`. Returns how many there are then. */
static inline uint32_t expand(const svoi_scan *s, uint64_t bits, uint64_t among, uint32_t brick, uint32_t rank, uint32_t n, uint32_t *code, uint32_t *target)
{
    if (s->wide) return svoi_wide_expand(bits, among, brick, rank, n, code, target);
    for (; bits != 0; bits &= bits - 1, n++) {
        const uint32_t bit = (uint32_t)__builtin_ctzll(bits);
        code[n] = brick << 6 | bit;
        target[n] = rank + (uint32_t)__builtin_popcountll(among & (((uint64_t)1 << bit) - 1));
    }
    return n;
}

static inline void share_brick(svoi_scan *s, uint64_t bits, uint32_t brick)
{
    svoi_lanes *l = &s->shared;
    const svo_block *b = s->w->block;
    const uint64_t begin = s->slice_begin, size = s->slice_end - begin;
    const uint32_t n = expand(s, bits, b->complex[brick], brick, b->complex_rank[brick], l->count, l->code, l->target);
    uint32_t kept = s->one_slice ? n : l->count;
    for (uint32_t k = kept; k < n; k++) {
        const uint64_t index = l->target[k] - begin;
        l->code[kept] = l->code[k];
        l->target[kept] = (uint32_t)index;
        kept += index < size;
    }
    l->count = kept;
    if (kept >= SVOI_LANES) flush_batch(s, l, kept, flush_shared);
}

/* Voxels of a brick that look the same: their values follow one another in a few runs. */
static inline void take_flat(svoi_scan *s, uint64_t bits, uint64_t among, uint32_t rank)
{
    flat_contribution(s);
    if (s->wide) {
        svoi_wide_write(s->layout, &s->flat_values, bits, among, rank, s->channels);
        return;
    }
    if (s->eight) {
        svoi_avx2_write(s->layout, &s->flat_values, bits, among, rank, s->channels);
        return;
    }
    for (uint64_t rest = bits; rest != 0;) {
        const uint64_t low = rest & (0 - rest), gap = among & ~bits & ~(low - 1); /* from the first voxel on: those of others */
        const uint64_t run = gap != 0 ? rest & ((gap & (0 - gap)) - 1) : rest;
        svoi_write_run(s->layout, &s->flat_values, rank + (uint32_t)__builtin_popcountll(among & (low - 1)), (uint32_t)__builtin_popcountll(run), s->channels);
        rest &= ~run;
    }
}

static inline void take_brick(svoi_scan *s, uint64_t bits, uint32_t brick)
{
    const svo_block *b = s->w->block;
    const uint64_t among = b->bricks[brick];
    const uint32_t rank = b->rank[brick];
    if (s->facet.flat) {
        take_flat(s, bits, among, rank);
    } else if (has_inner(s) && svoi_inner_brick(&s->facet, s->inner_reach, brick)) {
        svoi_wait *w = &s->wait_inner;
        w->count = expand(s, bits, among, brick, rank, w->count, w->code, w->target);
        if (w->count >= SVOI_LANES) flush_waiting(s, w, true);
    } else {
        svoi_lanes *l = &s->alone;
        l->count = expand(s, bits, among, brick, rank, l->count, l->code, l->target);
        if (l->count >= SVOI_LANES) flush_batch(s, l, l->count, flush_alone);
    }
}

/* The same as shade_voxel for all voxels of a facet that were remembered one by one, where all of them exist and the facet is seen in all. Whether a voxel
 * has other triangles cannot be foreseen, so there is no branch on it. */
static void shade_codes(svoi_scan *s, const uint32_t *codes, uint32_t count)
{
    const svo_block *b = s->w->block;
    svoi_lanes *shared = &s->shared, *alone = &s->alone;
    const uint64_t begin = s->slice_begin, size = s->slice_end - begin;
    for (uint32_t at = 0; s->wide && s->one_slice && at < count; at += SVOI_LANES) {
        svoi_wide_codes(b, codes + at, count - at < SVOI_LANES ? count - at : SVOI_LANES, shared, alone);
        if (shared->count >= SVOI_LANES) flush_batch(s, shared, shared->count, flush_shared);
        if (alone->count >= SVOI_LANES) flush_batch(s, alone, alone->count, flush_alone);
    }
    if (s->wide && s->one_slice) return;
    for (uint32_t at = 0; at < count;) {
        const uint32_t stop = count - at < SVOI_LANES ? count : at + SVOI_LANES;
        uint32_t n = shared->count, m = alone->count, last = m;
        for (; at < stop; at++) {
            const uint32_t code = codes[at], met = b->complex[code >> 6] >> (code & 63) & 1;
            shared->code[n] = alone->code[m] = code;
            n += met;
            m += 1 - met;
        }
        uint32_t kept = shared->count;
        for (uint32_t k = kept; k < n; k++) {
            const uint64_t index = svo_block_complex_index(b, shared->code[k]) - begin;
            shared->code[kept] = shared->code[k];
            shared->target[kept] = (uint32_t)index;
            kept += index < size;
        }
        shared->count = kept;
        if (kept >= SVOI_LANES) flush_batch(s, shared, kept, flush_shared);
        if (!s->first_slice) continue;
        for (; last < m; last++) alone->target[last] = svo_block_index(b, alone->code[last]);
        alone->count = m;
        if (m >= SVOI_LANES) flush_batch(s, alone, m, flush_alone);
    }
}

/* The same for a facet's bricks. */
static void shade_bricks(svoi_scan *s, const svo_block_visit *v, uint32_t count)
{
    const svo_block *b = s->w->block;
    for (const svo_block_visit *end = v + count; v < end; v++) {
        const uint64_t shared = v->bits & b->complex[v->brick], alone = v->bits & ~shared;
        if (shared != 0) share_brick(s, shared, v->brick);
        if (alone != 0 && s->first_slice) take_brick(s, alone, v->brick);
    }
}

static void shade_remembered(svoi_scan *s, uint64_t i)
{
    const svoi_start *start = (const svoi_start *)(const void *)s->w->starts.data + i;
    if (start[1].code != start->code) shade_codes(s, (const uint32_t *)(const void *)s->w->codes.data + start->code, start[1].code - start->code);
    if (start[1].visit != start->visit) shade_bricks(s, (const svo_block_visit *)(const void *)s->w->visits.data + start->visit, start[1].visit - start->visit);
}

static inline void weigh_voxel(svoi_scan *s, uint32_t code)
{
    if (left(s, code) && push(&s->shared, code, svo_block_index(s->w->block, code))) flush_weights(s);
}

static uint32_t label_of(const svoi_run *r, uint32_t group)
{
    uint32_t material = r->placement.groups[group].part->material;
    return material < r->placement.mesh->material_count ? material : UINT16_MAX;
}

/* Weights of the triangles with one label. */
static void weigh_part(svoi_scan *s, uint32_t label, const int32_t box_lo[3], const int32_t box_hi[3])
{
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    for (uint64_t i = 0; i < s->it->list.size / 4; i++) {
        svo_record record;
        svoi_load_triangle(s, list[i], &record);
        if (label_of(s->r, record.group) != label) continue;
        svoi_load_facet(s, list[i], &record);
        visit_voxels(s, i, &record, box_lo, box_hi, weigh_voxel);
        flush_weights(s);
    }
}

/* The material with the greatest area in each voxel, ties to the smaller number: one pass a material. */
static svo_result shade_materials(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3], uint64_t voxels, svo_error *err)
{
    svoi_run *r = s->r;
    svoi_worker *w = s->w;
    uint8_t *out = s->channels[s->layout->material];
    w->ids.size = 0;
    w->sums.size = 0;
    if (!svo_buffer_append(&w->ids, NULL, voxels * 8) || !svo_buffer_append(&w->sums, NULL, voxels * 8)) return out_of_memory(err);
    uint64_t *best = (uint64_t *)(void *)w->ids.data, *sums = (uint64_t *)(void *)w->sums.data;
    for (uint32_t next = 0;;) {
        uint32_t label = UINT32_MAX; /* smallest label >= next */
        for (uint32_t part = 0; part < svoi_part_count(s); part++) {
            SVO_TRY(svoi_enter_part(s, part, err));
            const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
            for (uint64_t i = 0; i < s->it->list.size / 4; i++) {
                svo_record record;
                svo_bins_record(r->bins, list[i], &record);
                uint32_t l = label_of(r, record.group);
                if (l >= next && l < label) label = l;
            }
        }
        if (label == UINT32_MAX) return SVO_OK;
        memset(sums, 0, voxels * 8);
        s->sums = sums;
        for (uint32_t part = 0; part < svoi_part_count(s); part++) {
            SVO_TRY(svoi_enter_part(s, part, err));
            weigh_part(s, label, box_lo, box_hi);
        }
        for (uint64_t v = 0; v < voxels; v++)
            if (sums[v] > best[v]) {
                best[v] = sums[v];
                out[2 * v] = (uint8_t)label;
                out[2 * v + 1] = (uint8_t)(label >> 8);
            }
        next = label + 1;
    }
}

/* Averages of voxels that all are in one slice, a brick at a time. */
static void write_bricks(svoi_scan *s)
{
    const svo_block *b = s->w->block;
    const uint32_t fields = s->layout->fields;
    const uint64_t *sums = s->sums;
    svoi_lanes *l = &s->shared;
    l->count = 0;
    for (uint32_t i = 0; i < 512; i++)
        for (uint64_t used = b->used[i]; used != 0; used &= used - 1) {
            const uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(used);
            if (b->complex[brick] == 0) continue;
            l->count = expand(s, b->complex[brick], b->bricks[brick], brick, b->rank[brick], l->count, l->code, l->target);
            if (l->count < SVOI_LANES) continue;
            svoi_sums_write(s->layout, l, sums, l->target, SVOI_LANES, s->channels);
            sums += (uint64_t)SVOI_LANES * fields;
            l->count -= SVOI_LANES;
            memcpy(l->target, l->target + SVOI_LANES, l->count * sizeof *l->target);
        }
    svoi_sums_write(s->layout, l, sums, l->target, l->count, s->channels);
    l->count = 0;
}

/* Averages of the slice, in order, to where they belong. */
static void write_slice(svoi_scan *s)
{
    const svo_block *b = s->w->block;
    svoi_lanes *l = &s->shared;
    uint64_t done = 0; /* of the slice */
    if (s->one_slice) {
        write_bricks(s);
        return;
    }
    l->count = 0;
    for (uint32_t i = 0; i < 512; i++)
        for (uint64_t used = b->used[i]; used != 0; used &= used - 1) {
            uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(used);
            uint64_t index = b->complex_rank[brick];
            for (uint64_t bits = b->complex[brick]; bits != 0; bits &= bits - 1, index++) {
                if (index < s->slice_begin || index >= s->slice_end) continue;
                uint32_t code = brick * 64 + (uint32_t)__builtin_ctzll(bits);
                if (!push(l, code, svo_block_index(b, code))) continue;
                svoi_sums_write(s->layout, l, s->sums + done * s->layout->fields, l->target, l->count, s->channels);
                done += l->count;
                l->count = 0;
            }
        }
    svoi_sums_write(s->layout, l, s->sums + done * s->layout->fields, l->target, l->count, s->channels);
    l->count = 0;
}

static void shade_part(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3])
{
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    for (uint64_t i = 0; i < s->it->list.size / 4; i++) {
        svo_record record;
        svoi_load_triangle(s, list[i], &record);
        svoi_load_facet(s, list[i], &record);
        if (s->recording && !s->r->masks) shade_remembered(s, i);
        else visit_voxels(s, i, &record, box_lo, box_hi, shade_voxel);
        flush_facet(s);
    }
}

svo_result svoi_shade_chunk(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3], svo_error *err)
{
    svoi_run *r = s->r;
    svoi_worker *w = s->w;
    uint64_t count = svoi_triangle_count(s), voxels = s->it->counts.nodes[7], complex = s->it->counts.complex;
    s->layout = svo_shader_layout(r->shader);
    /* 2^24 parts of a voxel face; fewer where so many triangles meet that sums could overflow */
    s->shift = 24;
    for (uint64_t n = count >> 22; n != 0 && s->shift > 0; n >>= 1) s->shift--;
    uint64_t bytes = 0;
    for (uint32_t c = 0; c < r->info->channel_count; c++)
        if (!r->info->channels[c].constant) bytes += voxels * svo_channel_stride(r->info->channels[c].kind);
    w->values.size = 0;
    if (!svo_buffer_append(&w->values, NULL, bytes + 32)) return out_of_memory(err);
    bytes = 0;
    for (uint32_t c = 0; c < r->info->channel_count; c++) {
        s->channels[c] = NULL;
        if (r->info->channels[c].constant) continue;
        s->channels[c] = w->values.data + bytes;
        bytes += voxels * svo_channel_stride(r->info->channels[c].kind);
    }
    s->shared.count = s->alone.count = s->wait_inner.count = s->wait_edge.count = 0;
    const bool only_material = s->layout->fields == 1;
    s->first_slice = true;
    s->wide = svoi_clip_has_wide();
    s->eight = !s->wide && svoi_avx2_has();
    const uint64_t slice = svoi_slice(r, svoi_part_count(s) > 1);
    for (uint64_t begin = 0; !only_material && (begin < complex || begin == 0); begin += slice) {
        s->slice_begin = begin;
        s->slice_end = complex - begin < slice ? complex : begin + slice;
        s->one_slice = s->slice_end - begin == complex;
        w->sums.size = 0;
        if (!svo_buffer_append(&w->sums, NULL, (s->slice_end - begin) * s->layout->fields * 8 + 8)) return out_of_memory(err);
        s->sums = (uint64_t *)(void *)w->sums.data;
        for (uint32_t part = 0; part < svoi_part_count(s); part++) {
            SVO_TRY(svoi_enter_part(s, part, err));
            shade_part(s, box_lo, box_hi);
        }
        write_slice(s);
        s->first_slice = false;
    }
    if (slice > r->slice_voxels) svo_buffer_free(&w->sums); /* it may be all that was left */
    if (s->layout->material < SVO_MAX_CHANNELS) return shade_materials(s, box_lo, box_hi, voxels, err);
    return SVO_OK;
}
