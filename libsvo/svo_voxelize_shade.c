#include "svoi_voxelize.h"

#include <string.h>

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
    s->flat_ready = s->flat_encoded = false;
    s->moments = svo_facet_reads_textures(s->r->shader, &s->facet);
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
            if (b->bricks[code >> 6] >> (code & 63) & 1) v->fn(v->s, svoi_packed(row, u, w), code); /* not: not in the thin set, or masked away */
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
    const uint32_t *starts = (const uint32_t *)(const void *)s->w->starts.data, *visits = (const uint32_t *)(const void *)s->w->visits.data;
    for (uint32_t at = starts[i]; at < starts[i + 1]; at++) {
        uint32_t code = svoi_code_of(b, visits[at]);
        if (b->bricks[code >> 6] >> (code & 63) & 1) fn(s, visits[at], code);
    }
}

void svoi_visit_voxels(svoi_scan *s, uint64_t i, const svo_record *record, const int32_t box_lo[3], const int32_t box_hi[3], svoi_voxel_fn fn)
{
    visit_voxels(s, i, record, box_lo, box_hi, fn);
}

/* Piece number `at` of the batch. */
static void piece_of(const svoi_scan *s, uint32_t at, svo_piece *out)
{
    const svo_facet *t = &s->facet;
    const svoi_clip_batch *b = &s->batch;
    const uint32_t i = (t->axis + 1) % 3, j = (t->axis + 2) % 3;
    if (t->inside) {
        svo_facet_piece(t, out);
    } else if (t->clips) {
        *out = (svo_piece){.area = (double)b->area[at]};
        out->centre[i] = (double)b->cx[at];
        out->centre[j] = (double)b->cy[at];
        if (s->moments) out->xx = (double)b->xx[at], out->xy = (double)b->xy[at], out->yy = (double)b->yy[at];
    } else { /* a segment or a point */
        *out = (svo_piece){.area = 0};
        out->centre[i] = (double)b->x[at] + 0.5;
        out->centre[j] = (double)b->y[at] + 0.5;
        out->centre[t->axis] = (double)b->z[at] + 0.5;
    }
}

/* Put a voxel of the facet into the batch. False when alpha MASK leaves nothing of the facet there. */
static inline bool collect(svoi_scan *s, uint32_t voxel, uint64_t *target)
{
    const int32_t cell[3] = {(int32_t)(voxel & 255), (int32_t)(voxel >> 8 & 255), (int32_t)(voxel >> 16)};
    if (s->facet.masks && !svoi_visible(s, cell)) return false;
    static const uint8_t next[5] = {0, 1, 2, 0, 1};
    uint32_t n = s->pending++;
    s->batch.x[n] = (float)cell[next[s->facet.axis + 1]];
    s->batch.y[n] = (float)cell[next[s->facet.axis + 2]];
    s->batch.z[n] = (float)cell[s->facet.axis];
    s->target[n] = target;
    return true;
}

/* Add what waits to the sums. */
static void flush(svoi_scan *s)
{
    if (s->pending == 0) return;
    if (s->facet.clips) svoi_clip(&s->facet.clipper, &s->batch, s->pending, s->moments);
    svo_piece piece;
    for (uint32_t n = 0; n < s->pending; n++) {
        piece_of(s, n, &piece);
        if (s->facet.flat) {
            if (!s->flat_ready) svo_facet_contribution(s->r->shader, &s->facet, &piece, s->shift, &s->flat);
            s->flat_ready = true;
            svo_contribution c = s->flat;
            svo_contribution_weigh(&c, svo_piece_weight(&piece, s->shift));
            svo_shade_add(s->layout, &c, s->target[n]);
        } else {
            svo_contribution c;
            svo_facet_contribution(s->r->shader, &s->facet, &piece, s->shift, &c);
            svo_shade_add(s->layout, &c, s->target[n]);
        }
    }
    s->pending = 0;
}

/* The same for a material's weight alone. */
static void flush_weights(svoi_scan *s)
{
    if (s->pending == 0) return;
    if (s->facet.clips) svoi_clip(&s->facet.clipper, &s->batch, s->pending, false);
    svo_piece piece;
    for (uint32_t n = 0; n < s->pending; n++) {
        piece_of(s, n, &piece);
        *s->target[n] += svo_piece_weight(&piece, s->shift);
    }
    s->pending = 0;
}

static void write_values(svoi_scan *s, uint64_t index, uint8_t (*values)[SVO_MAX_STRIDE])
{
    for (uint32_t k = 0; k < s->written_count; k++) {
        uint32_t c = s->written[k];
        memcpy(s->channels[c] + index * s->stride[c], values[c], s->stride[c]);
    }
}

static inline void shade_voxel(svoi_scan *s, uint32_t voxel, uint32_t code)
{
    svo_block *b = s->w->block;
    if (b->complex[code >> 6] >> (code & 63) & 1) {
        uint64_t index = svo_block_complex_index(b, code);
        if (index < s->slice_begin || index >= s->slice_end) return;
        if (collect(s, voxel, s->sums + (index - s->slice_begin) * s->layout->fields) && s->pending == SVOI_CLIP_BATCH) flush(s);
    } else if (s->first_slice) {
        if (!s->flat_encoded) {
            uint64_t sums[32] = {0};
            svo_piece piece;
            svo_contribution c;
            svo_facet_piece(&s->facet, &piece);
            svo_facet_contribution(s->r->shader, &s->facet, &piece, s->shift, &c);
            svo_contribution_weigh(&c, 1);
            svo_shade_add(s->layout, &c, sums);
            svo_shade_value(s->layout, sums, s->flat_values);
            s->flat_encoded = true;
        }
        write_values(s, svo_block_index(b, code), s->flat_values);
    }
}

static inline void weigh_voxel(svoi_scan *s, uint32_t voxel, uint32_t code)
{
    if (collect(s, voxel, s->sums + svo_block_index(s->w->block, code)) && s->pending == SVOI_CLIP_BATCH) flush_weights(s);
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
        s->moments = false;
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

/* Morton codes of complex voxels in order, to write their values where they belong. */
static void write_slice(svoi_scan *s)
{
    svo_block *b = s->w->block;
    uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE];
    memset(values, 0, sizeof values);
    for (uint32_t i = 0; i < 512; i++)
        for (uint64_t used = b->used[i]; used != 0; used &= used - 1) {
            uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(used);
            uint64_t index = b->complex_rank[brick];
            for (uint64_t bits = b->complex[brick]; bits != 0; bits &= bits - 1, index++) {
                if (index < s->slice_begin || index >= s->slice_end) continue;
                svo_shade_value(s->layout, s->sums + (index - s->slice_begin) * s->layout->fields, values);
                write_values(s, svo_block_index(b, brick * 64 + (uint32_t)__builtin_ctzll(bits)), values);
            }
        }
}

static void shade_part(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3])
{
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    for (uint64_t i = 0; i < s->it->list.size / 4; i++) {
        svo_record record;
        svoi_load_triangle(s, list[i], &record);
        svoi_load_facet(s, list[i], &record);
        visit_voxels(s, i, &record, box_lo, box_hi, shade_voxel);
        flush(s);
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
    if (!svo_buffer_append(&w->values, NULL, bytes)) return out_of_memory(err);
    bytes = 0;
    s->written_count = 0;
    for (uint32_t c = 0; c < r->info->channel_count; c++) {
        s->channels[c] = NULL;
        if (r->info->channels[c].constant) continue;
        s->stride[c] = svo_channel_stride(r->info->channels[c].kind);
        if (c != s->layout->material) s->written[s->written_count++] = c;
        s->channels[c] = w->values.data + bytes;
        bytes += voxels * svo_channel_stride(r->info->channels[c].kind);
    }
    uint8_t flat_values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE];
    memset(flat_values, 0, sizeof flat_values);
    s->flat_values = flat_values;
    const bool only_material = s->layout->fields == 1;
    s->first_slice = true;
    for (uint64_t begin = 0; !only_material && (begin < complex || begin == 0); begin += r->slice_voxels) {
        s->slice_begin = begin;
        s->slice_end = complex - begin < r->slice_voxels ? complex : begin + r->slice_voxels;
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
    if (s->layout->material < SVO_MAX_CHANNELS) return shade_materials(s, box_lo, box_hi, voxels, err);
    return SVO_OK;
}
