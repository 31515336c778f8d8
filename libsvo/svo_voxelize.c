#include "svo_voxelize.h"

#include <math.h>
#include <string.h>

#include "svo_bin.h"
#include "svo_block.h"
#include "svo_distance.h"
#include "svo_morton.h"
#include "svo_raster.h"
#include "svo_shade.h"
#include "svo_task.h"

enum {
    MAX_WORKERS = 256,
    SLICE_VOXELS = 1 << 17, /* voxels averaged at a time: bounds the memory for sums */
    MOST_VISITS = 1 << 20   /* (triangle, voxel) pairs of a chunk that are remembered; with more they are found again */
};

/* Scratch of a worker. */
typedef struct worker {
    svo_block *block;
    svo_buffer masks, sums, values, ids;
    svo_buffer visits, starts; /* packed voxels that each triangle meets (uint32_t), and where each triangle's begin */
} worker;

typedef struct run {
    const svo_tree_info *info;
    const svo_chunk_sink *sink;
    const svo_allocator *allocator;
    svo_voxelize_report *report;
    svo_grid grid;
    svo_placement placement;
    svo_bins *bins;
    svo_shader *shader; /* NULL without channels that vary */
    bool masks;         /* some material cuts voxels away, so shading is asked first */
    worker workers[MAX_WORKERS];
    bool started, has_previous;
    uint64_t previous;
} run;

/* One chunk on its way through the pipeline. */
typedef struct item {
    uint64_t code;
    svo_buffer list; /* uint32_t triangle numbers */
    void *blob;
    bool has_blob, first;
    svo_block_counts counts;
    uint64_t masked;
    svo_distances distances; /* of one small cube in it, chosen by its code */
    run *owner; /* set once the slot has been used */
} item;

static svo_result out_of_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while voxelizing"); }

static uint32_t block_levels(const run *r) { return r->info->depth < SVO_CHUNK_LEVELS ? r->info->depth : SVO_CHUNK_LEVELS; }

/* --- a chunk's voxels ----------------------------------------------------------------------------------------- */

/* What the row functions need about the triangle in hand. */
typedef struct scan_state {
    run *r;
    worker *w;
    item *it;
    svo_facet facet;
    svo_polygon whole; /* the facet */
    bool recording; /* visits of all triangles so far are in the worker's buffers */
    int32_t corner_axis[3];
    const svo_shade_layout *layout;
    uint32_t shift;
    uint64_t slice_begin, slice_end; /* complex voxels averaged now */
    bool first_slice;
    uint8_t (*flat_values)[SVO_MAX_STRIDE]; /* of a flat facet, encoded when first used */
    bool flat_ready, flat_encoded, moments;
    svo_contribution flat;
    uint32_t pending; /* voxels of the facet that wait for their area */
    uint64_t *target[SVOI_CLIP_BATCH];
    svoi_clip_batch batch;
    uint8_t *channels[SVO_MAX_CHANNELS];
    uint32_t written[SVO_MAX_CHANNELS], written_count, stride[SVO_MAX_CHANNELS]; /* channels that are averaged */
    uint64_t *sums;
} scan_state;

/* A voxel of the block in 32 bits. */
static inline uint32_t packed(const svo_raster_row *row, int32_t u, int32_t w)
{
    return (uint32_t)u << 8 * row->u | (uint32_t)row->at_v << 8 * row->v | (uint32_t)w << 8 * row->w;
}
static inline uint32_t code_of(const svo_block *b, uint32_t voxel)
{
    return b->spread[0][voxel & 255] | b->spread[1][voxel >> 8 & 255] | b->spread[2][voxel >> 16];
}

/* Remember the voxels of a row for the passes to come; give up where memory or the limit does not allow it. */
static void record_row(scan_state *s, const svo_raster_row *row)
{
    if (!s->recording) return;
    size_t count = 0;
    for (int32_t u = row->u0; u <= row->u1; u++) count += row->lo[u] <= row->hi[u] ? (size_t)(row->hi[u] - row->lo[u] + 1) : 0;
    svo_buffer *v = &s->w->visits;
    if (v->size / 4 + count > MOST_VISITS || !svo_buffer_reserve(v, 4 * count)) {
        s->recording = false;
        return;
    }
    uint32_t *out = (uint32_t *)(void *)(v->data + v->size);
    for (int32_t u = row->u0; u <= row->u1; u++)
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) *out++ = packed(row, u, w);
    v->size += 4 * count;
}

/* Is something of the facet visible in a voxel? */
static bool visible(scan_state *s, const int32_t cell[3])
{
    svo_polygon a, b;
    svo_polygon_slab(&s->whole, 0, cell[0], &a);
    svo_polygon_slab(&a, 1, cell[1], &b);
    svo_polygon_slab(&b, 2, cell[2], &a);
    return svo_facet_visible(s->r->shader, &s->facet, &a, cell);
}

/* Mark voxels in which something of the triangle is visible. */
static void mark_masked(void *user, const svo_raster_row *row)
{
    scan_state *s = user;
    svo_block *b = s->w->block;
    for (int32_t u = row->u0; u <= row->u1; u++) {
        uint32_t column = svo_block_column(b, row, u);
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) {
            uint32_t code = column | b->spread[row->w][w];
            uint64_t bit = (uint64_t)1 << (code & 63);
            int32_t cell[3];
            cell[row->u] = u;
            cell[row->v] = row->at_v;
            cell[row->w] = w;
            b->dirty[code >> 12] |= (uint64_t)1 << (code >> 6 & 63);
            if (visible(s, cell)) {
                svo_block_set(b, code);
                b->complex[code >> 6] |= bit;
            } else {
                b->masked[code >> 6] |= bit;
            }
        }
    }
    record_row(s, row);
}

static void mark_plain(void *user, const svo_raster_row *row) { svo_block_mark(((scan_state *)user)->w->block, row); }
static void mark_flat(void *user, const svo_raster_row *row)
{
    svo_block_mark_flat(((scan_state *)user)->w->block, row);
    record_row(user, row);
}
static void mark_shaded(void *user, const svo_raster_row *row)
{
    svo_block_mark_shaded(((scan_state *)user)->w->block, row);
    record_row(user, row);
}

static void load_triangle(const scan_state *s, uint32_t triangle, svo_record *record)
{
    svo_bins_record(s->r->bins, triangle, record);
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 3; k++) record->q[c][k] -= s->corner_axis[k] * SVO_RASTER_UNIT;
}

static void load_facet(scan_state *s, uint32_t triangle, const svo_record *record)
{
    double block[3] = {s->corner_axis[0], s->corner_axis[1], s->corner_axis[2]};
    svo_facet_make(s->r->shader, record->group, triangle - s->r->placement.groups[record->group].first, block, (const int32_t(*)[3])record->q, &s->facet);
    s->whole.count = 3;
    memcpy(s->whole.at, s->facet.corner, sizeof s->facet.corner);
    s->flat_ready = s->flat_encoded = false;
    s->moments = svo_facet_reads_textures(s->r->shader, &s->facet);
}

static void mark_voxels(scan_state *s, const int32_t box_lo[3], const int32_t box_hi[3])
{
    run *r = s->r;
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    uint64_t count = s->it->list.size / 4;
    const bool thin = r->info->surface == SVO_SURFACE_THIN;
    svo_raster_target targets[3];
    uint32_t target_count = thin ? 3 : 1;
    for (uint32_t t = 0; t < target_count; t++) targets[t] = thin ? svo_raster_centre_line(t) : svo_raster_cube();
    /* The thin set is found with other scans than the surface in its voxels. */
    svo_buffer *starts = &s->w->starts;
    s->w->visits.size = starts->size = 0;
    s->recording = r->shader != NULL && r->info->channel_count != 0 && !thin && count < MOST_VISITS && svo_buffer_reserve(starts, 4 * (count + 1));
    for (uint64_t i = 0; i < count; i++) {
        svo_record record;
        load_triangle(s, list[i], &record);
        if (s->recording) {
            uint32_t at = (uint32_t)(s->w->visits.size / 4);
            memcpy(starts->data + 4 * i, &at, 4);
        }
        svo_raster_row_fn fn = mark_plain;
        if (r->shader != NULL) {
            bool masks, flat = svo_facet_is_flat(r->shader, record.group, list[i] - r->placement.groups[record.group].first, &masks);
            /* In the thin set a voxel's surface may belong to triangles that did not mark it: average them all. */
            fn = flat && !thin ? mark_flat : mark_shaded;
            if (masks) {
                load_facet(s, list[i], &record);
                fn = mark_masked;
            }
        }
        for (uint32_t t = 0; t < target_count; t++)
            svo_raster_scan((const int32_t(*)[3])record.q, &targets[t], box_lo, box_hi, fn, s);
    }
    if (s->recording) {
        uint32_t end = (uint32_t)(s->w->visits.size / 4);
        memcpy(starts->data + 4 * count, &end, 4);
    }
}

/* --- a chunk's attributes ------------------------------------------------------------------------------------- */

/* A function of a voxel that the triangle in hand meets and that exists. */
typedef void (*voxel_fn)(scan_state *s, uint32_t voxel, uint32_t code);
typedef struct row_visitor { scan_state *s; voxel_fn fn; } row_visitor;

static void visit_row(void *user, const svo_raster_row *row)
{
    row_visitor *v = user;
    const svo_block *b = v->s->w->block;
    for (int32_t u = row->u0; u <= row->u1; u++) {
        uint32_t column = svo_block_column(b, row, u);
        for (int32_t w = row->lo[u]; w <= row->hi[u]; w++) {
            uint32_t code = column | b->spread[row->w][w];
            if (b->bricks[code >> 6] >> (code & 63) & 1) v->fn(v->s, packed(row, u, w), code); /* not: not in the thin set, or masked away */
        }
    }
}

static inline void visit_voxels(scan_state *s, uint64_t i, const svo_record *record, const int32_t box_lo[3], const int32_t box_hi[3], voxel_fn fn)
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
        uint32_t code = code_of(b, visits[at]);
        if (b->bricks[code >> 6] >> (code & 63) & 1) fn(s, visits[at], code);
    }
}

/* Piece number `at` of the batch. */
static void piece_of(const scan_state *s, uint32_t at, svo_piece *out)
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
static inline bool collect(scan_state *s, uint32_t voxel, uint64_t *target)
{
    const int32_t cell[3] = {(int32_t)(voxel & 255), (int32_t)(voxel >> 8 & 255), (int32_t)(voxel >> 16)};
    if (s->facet.masks && !visible(s, cell)) return false;
    static const uint8_t next[5] = {0, 1, 2, 0, 1};
    uint32_t n = s->pending++;
    s->batch.x[n] = (float)cell[next[s->facet.axis + 1]];
    s->batch.y[n] = (float)cell[next[s->facet.axis + 2]];
    s->batch.z[n] = (float)cell[s->facet.axis];
    s->target[n] = target;
    return true;
}

/* Add what waits to the sums. */
static void flush(scan_state *s)
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
static void flush_weights(scan_state *s)
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

static void write_values(scan_state *s, uint64_t index, uint8_t (*values)[SVO_MAX_STRIDE])
{
    for (uint32_t k = 0; k < s->written_count; k++) {
        uint32_t c = s->written[k];
        memcpy(s->channels[c] + index * s->stride[c], values[c], s->stride[c]);
    }
}

static inline void shade_voxel(scan_state *s, uint32_t voxel, uint32_t code)
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

static inline void weigh_voxel(scan_state *s, uint32_t voxel, uint32_t code)
{
    if (collect(s, voxel, s->sums + svo_block_index(s->w->block, code)) && s->pending == SVOI_CLIP_BATCH) flush_weights(s);
}

static uint32_t label_of(const run *r, uint32_t group)
{
    uint32_t material = r->placement.groups[group].part->material;
    return material < r->placement.mesh->material_count ? material : UINT16_MAX;
}

/* The material with the greatest area in each voxel, ties to the smaller number: one pass a material. */
static bool shade_materials(scan_state *s, const int32_t box_lo[3], const int32_t box_hi[3], uint64_t voxels)
{
    run *r = s->r;
    worker *w = s->w;
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    uint64_t count = s->it->list.size / 4;
    uint8_t *out = s->channels[s->layout->material];
    w->ids.size = 0;
    w->sums.size = 0;
    if (!svo_buffer_append(&w->ids, NULL, voxels * 8) || !svo_buffer_append(&w->sums, NULL, voxels * 8)) return false;
    uint64_t *best = (uint64_t *)(void *)w->ids.data, *sums = (uint64_t *)(void *)w->sums.data;
    for (uint32_t next = 0;;) {
        uint32_t label = UINT32_MAX; /* smallest label >= next */
        for (uint64_t i = 0; i < count; i++) {
            svo_record record;
            svo_bins_record(r->bins, list[i], &record);
            uint32_t l = label_of(r, record.group);
            if (l >= next && l < label) label = l;
        }
        if (label == UINT32_MAX) return true;
        memset(sums, 0, voxels * 8);
        s->sums = sums;
        for (uint64_t i = 0; i < count; i++) {
            svo_record record;
            load_triangle(s, list[i], &record);
            if (label_of(r, record.group) != label) continue;
            load_facet(s, list[i], &record);
            s->moments = false;
            visit_voxels(s, i, &record, box_lo, box_hi, weigh_voxel);
            flush_weights(s);
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
static void write_slice(scan_state *s)
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

static bool shade(scan_state *s, const int32_t box_lo[3], const int32_t box_hi[3])
{
    run *r = s->r;
    worker *w = s->w;
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    uint64_t count = s->it->list.size / 4, voxels = s->it->counts.nodes[7], complex = s->it->counts.complex;
    s->layout = svo_shader_layout(r->shader);
    /* 2^24 parts of a voxel face; fewer where so many triangles meet that sums could overflow */
    s->shift = 24;
    for (uint64_t n = count >> 22; n != 0 && s->shift > 0; n >>= 1) s->shift--;
    uint64_t bytes = 0;
    for (uint32_t c = 0; c < r->info->channel_count; c++)
        if (!r->info->channels[c].constant) bytes += voxels * svo_channel_stride(r->info->channels[c].kind);
    w->values.size = 0;
    if (!svo_buffer_append(&w->values, NULL, bytes)) return false;
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
    for (uint64_t begin = 0; !only_material && (begin < complex || begin == 0); begin += SLICE_VOXELS) {
        s->slice_begin = begin;
        s->slice_end = complex - begin < SLICE_VOXELS ? complex : begin + SLICE_VOXELS;
        w->sums.size = 0;
        if (!svo_buffer_append(&w->sums, NULL, (s->slice_end - begin) * s->layout->fields * 8 + 8)) return false;
        s->sums = (uint64_t *)(void *)w->sums.data;
        for (uint64_t i = 0; i < count; i++) {
            svo_record record;
            load_triangle(s, list[i], &record);
            load_facet(s, list[i], &record);
            visit_voxels(s, i, &record, box_lo, box_hi, shade_voxel);
            flush(s);
        }
        write_slice(s);
        s->first_slice = false;
    }
    if (s->layout->material < SVO_MAX_CHANNELS) return shade_materials(s, box_lo, box_hi, voxels);
    return true;
}

/* --- pipeline ------------------------------------------------------------------------------------------------- */

static svo_result produce(void *user, void *slot, bool *more, svo_error *err)
{
    run *r = user;
    item *it = slot;
    if (it->owner == NULL) {
        it->owner = r;
        svo_buffer_init(&it->list, r->allocator);
    }
    it->has_blob = false;
    it->blob = NULL;
    it->masked = 0;
    it->distances = (svo_distances){0};
    it->first = !r->started;
    r->started = true;
    return svo_bins_next(r->bins, &it->code, &it->list, more, err);
}

static svo_result work(void *user, void *slot, uint32_t number, svo_error *err)
{
    run *r = user;
    item *it = slot;
    worker *w = &r->workers[number];
    if (w->block == NULL) {
        w->block = svo_alloc(r->allocator, 1, sizeof *w->block);
        if (w->block == NULL) return out_of_memory(err);
        svo_block_init(w->block);
        svo_buffer_init(&w->masks, r->allocator);
        svo_buffer_init(&w->sums, r->allocator);
        svo_buffer_init(&w->values, r->allocator);
        svo_buffer_init(&w->ids, r->allocator);
        svo_buffer_init(&w->visits, r->allocator);
        svo_buffer_init(&w->starts, r->allocator);
    }
    scan_state s = {.r = r, .w = w, .it = it};
    uint32_t x, y, z;
    svo_morton_decode(it->code, &x, &y, &z);
    s.corner_axis[0] = (int32_t)(x * SVO_RASTER_SIZE);
    s.corner_axis[1] = (int32_t)(y * SVO_RASTER_SIZE);
    s.corner_axis[2] = (int32_t)(z * SVO_RASTER_SIZE);
    const uint32_t levels = block_levels(r);
    const int32_t last = (1 << levels) - 1, box_lo[3] = {0, 0, 0}, box_hi[3] = {last, last, last};
    mark_voxels(&s, box_lo, box_hi);
    svo_result result = SVO_OK;
    w->masks.size = 0;
    if (!svo_block_emit(w->block, &w->masks, &it->counts)) result = out_of_memory(err);
    if (result == SVO_OK && r->masks)
        for (uint32_t i = 0; i < 512; i++)
            for (uint64_t bits = w->block->dirty[i]; bits != 0; bits &= bits - 1) {
                uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(bits);
                it->masked += (uint64_t)__builtin_popcountll(w->block->masked[brick] & ~w->block->bricks[brick]);
            }
    if (result == SVO_OK && it->counts.nodes[7] != 0) {
        if (r->shader != NULL && r->info->channel_count != 0 && !shade(&s, box_lo, box_hi)) result = out_of_memory(err);
        /* The sample: in every chunk of a small octree (more of it where there are few chunks), in one of eight of a large one, and in the
         * first. */
        uint64_t choice = (it->code + 1) * 0x9e3779b97f4a7c15u >> 32;
        if (it->first || r->info->depth <= 9 || choice % 8 == 0)
            svo_block_distances(w->block, r->bins, &r->placement, &r->grid, (const uint32_t *)(const void *)it->list.data, it->list.size / 4,
                                s.corner_axis, last + 1, choice / 8, r->info->depth <= 8 ? 16 : 1, &it->distances);
        if (result == SVO_OK) {
            /* A grid smaller than the block lies in its low corner: drop the nodes above. */
            uint32_t skip = SVO_CHUNK_LEVELS - levels;
            svo_chunk chunk = {.code = it->code, .level = svo_chunk_level(r->info->depth), .depth = r->info->depth};
            chunk.masks = w->masks.data + skip;
            chunk.node_count = w->masks.size - skip;
            chunk.voxel_count = it->counts.nodes[7];
            for (uint32_t c = 0; c < r->info->channel_count; c++) chunk.channels[c] = s.channels[c];
            result = r->sink->encode(r->sink->user, &chunk, number, &it->blob, err);
            it->has_blob = result == SVO_OK;
        }
    }
    svo_block_clear(w->block);
    return result;
}

static svo_result commit(void *user, void *slot, svo_error *err)
{
    run *r = user;
    item *it = slot;
    r->report->masked_voxels += it->masked;
    if (!it->has_blob) return SVO_OK;
    r->report->distance_samples += it->distances.count;
    r->report->distance_mean += it->distances.sum; /* the sum until the end */
    if (it->distances.most > r->report->distance_max) r->report->distance_max = it->distances.most;
    svo_tree_counts *counts = &r->report->counts;
    uint32_t level = svo_chunk_level(r->info->depth), levels = block_levels(r);
    svo_counts_ancestors(counts, level, r->has_previous, r->previous, it->code);
    r->has_previous = true;
    r->previous = it->code;
    counts->chunks++;
    for (uint32_t i = 0; i <= levels; i++) counts->nodes[level + i] += it->counts.nodes[SVO_CHUNK_LEVELS - levels + i];
    it->has_blob = false;
    return r->sink->commit(r->sink->user, it->blob, err);
}

static void destroy(void *user, void *slot)
{
    (void)user;
    item *it = slot;
    if (it->owner == NULL) return;
    if (it->has_blob) it->owner->sink->discard(it->owner->sink->user, it->blob);
    svo_buffer_free(&it->list);
}

/* Do some triangles need the shader to know which voxels exist? */
static bool mesh_masks(const svo_mesh *mesh)
{
    for (uint32_t i = 0; i < mesh->material_count; i++)
        if (mesh->materials[i].alpha_mode == SVO_ALPHA_MASK) return true;
    return false;
}

static svo_result run_all(run *r, const svo_voxelize_options *o, uint32_t threads, svo_error *err)
{
    double started = svo_seconds();
    svo_voxelize_report *report = r->report;
    SVO_TRY(svo_placement_create(r->placement.mesh, r->allocator, &r->placement, err));
    report->triangles = r->placement.triangle_count;
    svo_bins_report bins;
    /* Half of what is allowed goes to snapped triangles; without room for them they are snapped again at every use. */
    uint64_t keep = o->memory == 0 ? UINT64_MAX : o->memory / 2;
    SVO_TRY(svo_bins_create(&r->placement, &r->grid, svo_chunk_level(r->info->depth), keep, threads, r->allocator, &r->bins, &bins, err));
    if (o->has_range) svo_bins_limit(r->bins, o->first_code, o->end_code);
    report->skipped_not_finite = bins.skipped;
    report->degenerate = bins.degenerate;
    uint64_t corners = 3 * (report->triangles - bins.skipped);
    report->snap_mean = corners != 0 ? bins.snap_sum / (double)corners : 0;
    report->snap_max = bins.snap_max;
    bool varies = false;
    for (uint32_t c = 0; c < r->info->channel_count; c++) varies |= !r->info->channels[c].constant;
    r->masks = mesh_masks(r->placement.mesh);
    if (varies || r->masks) SVO_TRY(svo_shader_create(&r->placement, &r->grid, r->info, threads, r->allocator, &r->shader, err));
    report->seconds_setup = svo_seconds() - started;
    started = svo_seconds();
    svo_pipeline p = {.threads = threads, .item_size = sizeof(item), .user = r, .produce = produce, .work = work, .commit = commit, .destroy = destroy};
    svo_result result = svo_pipeline_run(&p, err);
    if (report->distance_samples != 0) report->distance_mean /= (double)report->distance_samples;
    report->seconds_voxels = svo_seconds() - started;
    return result;
}

svo_result svo_voxelize(const svo_mesh *mesh, const svo_voxelize_options *options, const svo_tree_info *info,
                        const svo_chunk_sink *sink, svo_voxelize_report *report, svo_error *err)
{
    svo_voxelize_report unused;
    if (report == NULL) report = &unused;
    memset(report, 0, sizeof *report);
    if (info->fill == SVO_FILL_SOLID) return svo_fail(err, SVO_UNSUPPORTED, "--fill solid is not available; only the surface can be voxelized");
    if (info->depth > SVO_MAX_DEPTH) return svo_fail(err, SVO_LIMIT, "a depth of %u is more than %u", info->depth, SVO_MAX_DEPTH);
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, options->memory != 0 ? options->memory : UINT64_MAX, options->allocator);
    run *r = svo_calloc(&limit.base, 1, sizeof *r);
    if (r == NULL)
        return options->memory != 0 ? svo_fail(err, SVO_LIMIT, "%llu bytes of memory are not enough to begin", (unsigned long long)options->memory) : out_of_memory(err);
    uint32_t threads = options->threads != 0 ? options->threads : svo_processor_count();
    if (threads > MAX_WORKERS) threads = MAX_WORKERS;
    r->info = info;
    r->sink = sink;
    r->allocator = &limit.base;
    r->report = report;
    r->placement.mesh = mesh;
    r->grid.depth = info->depth;
    r->grid.size = info->voxel_to_world[0];
    for (int i = 0; i < 3; i++) r->grid.origin[i] = info->voxel_to_world[4 * i + 3];
    svo_error local = {0};
    svo_result result = run_all(r, options, threads, &local);
    if (result == SVO_OUT_OF_MEMORY && options->memory != 0) {
        char why[120];
        memcpy(why, local.message, sizeof why - 1);
        why[sizeof why - 1] = 0;
        result = svo_fail(&local, SVO_LIMIT, "%.1f MB of memory are not enough: %s; allow more, or use fewer threads", (double)options->memory / 1e6, why);
    }
    for (uint32_t i = 0; i < MAX_WORKERS; i++) {
        worker *w = &r->workers[i];
        if (w->block == NULL) continue;
        svo_buffer_free(&w->masks);
        svo_buffer_free(&w->sums);
        svo_buffer_free(&w->values);
        svo_buffer_free(&w->ids);
        svo_buffer_free(&w->visits);
        svo_buffer_free(&w->starts);
        svo_free(r->allocator, w->block, 1, sizeof *w->block);
    }
    svo_shader_free(r->shader);
    svo_bins_free(r->bins);
    svo_placement_free(&r->placement);
    svo_free(&limit.base, r, 1, sizeof *r);
    report->peak_bytes = svo_limit_peak(&limit);
    if (result == SVO_OK) {
        if (report->triangles == 0) svo_warn(options->warnings, "the mesh has no triangles; the octree is empty");
        else if (report->skipped_not_finite == report->triangles) svo_warn(options->warnings, "no triangle has finite corners; the octree is empty");
        else if (report->skipped_not_finite != 0)
            svo_warn(options->warnings, "%llu triangles with a NaN or infinite corner were skipped", (unsigned long long)report->skipped_not_finite);
    } else if (err != NULL) {
        *err = local;
    }
    return result;
}
