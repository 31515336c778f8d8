#include "svoi_scatter.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svo_raster.h"
#include "svo_stream.h"
#include "svo_task.h"

enum {
    FEED_TRIANGLES = 4096,   /* of an item of the pipeline */
    BLOCK_BYTES = 1 << 16,   /* of a bin's write buffer */
    EXTRA_COST = 96          /* bytes a triangle besides its arrays: snapped record, lists and their growth */
};
#define NO_BLOCK UINT32_MAX

typedef struct block {
    uint64_t offset, cost;
    uint32_t bytes, next;
} block;

struct svoi_scattered {
    const svoi_scatter_plan *plan;
    svo_spill_file file;
    svoi_bin *bins;
    uint32_t bin_count;
    svo_buffer blocks;
};

uint64_t svoi_triangle_cost(const svo_soup_layout *l)
{
    uint64_t bytes = 72 + 12 + (l->normals ? 36 : 0) + (l->colors ? 48 : 0) + EXTRA_COST;
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) bytes += l->uvs[u] ? 24 : 0;
    return bytes;
}

svo_result svoi_layouts(const svo_placement *p, svo_soup_layout **out, svo_error *err)
{
    *out = NULL;
    if (p->group_count == 0) return SVO_OK;
    svo_soup_layout *l = svo_alloc(p->allocator, p->group_count, sizeof *l);
    if (l == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %llu placed parts", (unsigned long long)p->group_count);
    for (uint64_t g = 0; g < p->group_count; g++) {
        const svo_part *part = p->groups[g].part;
        /* Instances of one shape follow each other part by part; look at positions once where that is the previous part. */
        l[g] = g > 0 && p->groups[g - 1].part == part ? l[g - 1] : svo_soup_layout_of(part);
    }
    *out = l;
    return SVO_OK;
}

/* --- one reading of the triangles ----------------------------------------------------------------------------- */

typedef struct reading {
    const svoi_scatter_plan *plan;
    const svo_placement *p;
    svoi_scattered *from; /* NULL: the placement */
    uint32_t next_block;
    uint64_t group, local; /* next triangle of the placement */
    uint64_t piece, at;    /* the same in a soup */
    /* the cells: codes [base, base + count) at `levels` above the units */
    uint64_t base, count;
    uint32_t levels;
    uint64_t *cost;        /* first reading: by cell */
    const uint32_t *bin_of; /* second reading */
    svo_bins_report *report;
    svoi_scattered *to;
    uint8_t *buffers;
    uint32_t *used;
    uint64_t *block_cost;
    bool consume;
} reading;

typedef struct hit { uint32_t at, group, bin; } hit; /* at: of the record without its group */

typedef struct item {
    reading *owner;
    uint64_t group, first, count;  /* of the placement */
    svo_soup_piece piece;
    const block *block;
    svo_buffer raw, hits, cells;
    svo_bins_report report;
} item;

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while binning triangles"); }

static svo_result produce(void *user, void *slot, bool *more, svo_error *err)
{
    (void)err;
    reading *d = user;
    item *it = slot;
    if (it->owner == NULL) {
        it->owner = d;
        svo_buffer_init(&it->raw, d->plan->allocator);
        svo_buffer_init(&it->hits, d->plan->allocator);
        svo_buffer_init(&it->cells, d->plan->allocator);
    }
    it->report = (svo_bins_report){0};
    it->block = NULL;
    *more = true;
    if (d->from != NULL) {
        if (d->next_block == NO_BLOCK) {
            *more = false;
            return SVO_OK;
        }
        it->block = (const block *)(const void *)d->from->blocks.data + d->next_block;
        d->next_block = it->block->next;
        return SVO_OK;
    }
    while (d->group < d->p->group_count) {
        const svo_part *part = d->p->groups[d->group].part;
        it->group = d->group;
        if (part->soup == NULL) {
            it->first = d->local;
            it->count = part->triangle_count - d->local < FEED_TRIANGLES ? part->triangle_count - d->local : FEED_TRIANGLES;
            d->local += it->count;
        } else {
            const svo_soup_piece *pieces = (const svo_soup_piece *)(const void *)part->soup->pieces.data;
            it->count = 0;
            if (d->piece < part->soup->pieces.size / sizeof *pieces) {
                it->piece = pieces[d->piece];
                it->first = d->at;
                it->count = it->piece.count - d->at < FEED_TRIANGLES ? it->piece.count - d->at : FEED_TRIANGLES;
                d->at += it->count;
                if (d->at == it->piece.count) d->at = 0, d->piece++;
            }
        }
        if (it->count != 0) return SVO_OK;
        d->group++;
        d->local = d->piece = d->at = 0;
    }
    *more = false;
    return SVO_OK;
}

/* Numbers of the cells that a triangle meets, ascending, in place of what `cells` held. */
static bool find_cells(const reading *d, const int32_t q[3][3], svo_buffer *cells)
{
    const uint32_t depth = d->plan->grid.depth, cell_level = d->plan->unit_level - d->levels;
    const uint32_t bits = depth + 8 - cell_level; /* of a cell's edge, in lattice units */
    int32_t low[3], high[3];
    bool one = true;
    svo_raster_bounds(q, low, high);
    for (int k = 0; k < 3; k++) one &= low[k] >> bits == high[k] >> bits;
    cells->size = 0;
    if (one) {
        uint64_t code = svo_morton_encode((uint32_t)(low[0] >> bits), (uint32_t)(low[1] >> bits), (uint32_t)(low[2] >> bits));
        uint32_t number = (uint32_t)(code - d->base);
        return code < d->base || code - d->base >= d->count || svo_buffer_append(cells, &number, sizeof number) != NULL;
    }
    struct { uint64_t code; uint32_t level; } stack[8 * (SVO_MAX_DEPTH + 1)];
    uint32_t height = 0;
    stack[height].code = 0;
    stack[height++].level = 0;
    while (height != 0) {
        uint64_t code = stack[--height].code;
        uint32_t level = stack[height].level;
        if (level == cell_level) {
            uint32_t number = (uint32_t)(code - d->base);
            if (svo_buffer_append(cells, &number, sizeof number) == NULL) return false;
            continue;
        }
        uint32_t x, y, z, shift = 3 * (cell_level - level - 1);
        svo_morton_decode(code, &x, &y, &z);
        int32_t size = (int32_t)1 << (depth + 8 - level - 1);
        int32_t corner[3] = {(int32_t)x * 2 * size, (int32_t)y * 2 * size, (int32_t)z * 2 * size};
        uint8_t mask = svo_raster_octants(q, low, high, corner, size);
        for (uint32_t i = 8; i-- > 0;) {
            uint64_t child = code * 8 + i, begin = child << shift, end = (child + 1) << shift;
            if (!(mask >> i & 1) || begin >= d->base + d->count || end <= d->base) continue;
            stack[height].code = child;
            stack[height++].level = level + 1;
        }
    }
    return true;
}

static void note_triangle(const svo_grid *g, const svo_vec3 v[3], const int32_t q[3][3], svo_bins_report *r)
{
    for (int k = 0; k < 3; k++) {
        double dx = (v[k].x - g->origin[0]) / g->size - q[k][0] / 256.0;
        double dy = (v[k].y - g->origin[1]) / g->size - q[k][1] / 256.0;
        double dz = (v[k].z - g->origin[2]) / g->size - q[k][2] / 256.0;
        double d = sqrt(dx * dx + dy * dy + dz * dz);
        r->snap_sum += d;
        if (d > r->snap_max) r->snap_max = d;
    }
    int64_t e[3], f[3];
    for (int k = 0; k < 3; k++) e[k] = (int64_t)q[1][k] - q[0][k], f[k] = (int64_t)q[2][k] - q[0][k];
    r->degenerate += e[1] * f[2] == e[2] * f[1] && e[2] * f[0] == e[0] * f[2] && e[0] * f[1] == e[1] * f[0];
}

static svo_result one_record(reading *d, item *it, uint32_t group, uint32_t at, svo_error *err)
{
    const svo_soup_layout *layout = &d->plan->layouts[group];
    const svo_mat4 *m = &d->p->mesh->instances[d->p->groups[group].instance].transform;
    double c[9];
    svo_soup_corners(layout, it->raw.data + at, c);
    svo_vec3 v[3];
    int32_t q[3][3];
    double zero = 0; /* NaN where something is not finite */
    for (int k = 0; k < 3; k++) {
        v[k] = svo_mat4_point(m, svo_v3(c[3 * k], c[3 * k + 1], c[3 * k + 2]));
        zero += v[k].x * 0 + v[k].y * 0 + v[k].z * 0;
    }
    if (!(zero == 0)) {
        it->report.skipped++;
        return SVO_OK;
    }
    for (int k = 0; k < 3; k++) svo_grid_snap(&d->plan->grid, v[k], q[k]);
    if (d->cost != NULL) note_triangle(&d->plan->grid, (const svo_vec3 *)v, (const int32_t(*)[3])q, &it->report);
    if (!find_cells(d, (const int32_t(*)[3])q, &it->cells)) return no_memory(err);
    const uint32_t *cells = (const uint32_t *)(const void *)it->cells.data;
    uint32_t last = UINT32_MAX;
    uint64_t cost = d->cost != NULL ? svoi_triangle_cost(layout) : 0;
    for (uint64_t i = 0; i < it->cells.size / sizeof *cells; i++) {
        if (d->cost != NULL) {
            __atomic_fetch_add(&d->cost[cells[i]], cost, __ATOMIC_RELAXED);
        } else if (d->bin_of[cells[i]] != last) {
            last = d->bin_of[cells[i]];
            hit h = {at, group, last};
            if (svo_buffer_append(&it->hits, &h, sizeof h) == NULL) return no_memory(err);
        }
    }
    return SVO_OK;
}

static svo_result work(void *user, void *slot, uint32_t worker, svo_error *err)
{
    (void)worker;
    reading *d = user;
    item *it = slot;
    it->hits.size = it->raw.size = 0;
    if (it->block != NULL) {
        if (svo_buffer_append(&it->raw, NULL, it->block->bytes) == NULL) return no_memory(err);
        SVO_TRY(svo_spill_read(&d->from->file, it->block->offset, it->raw.data, it->block->bytes, err));
        if (d->consume) svo_spill_discard(&d->from->file, it->block->offset, it->block->bytes);
        for (uint32_t at = 0; at < it->block->bytes;) {
            uint32_t group;
            memcpy(&group, it->raw.data + at, 4);
            SVO_TRY(one_record(d, it, group, at + 4, err));
            at += 4 + d->plan->layouts[group].stride;
        }
        return SVO_OK;
    }
    const svo_part *part = d->p->groups[it->group].part;
    const svo_soup_layout *layout = &d->plan->layouts[it->group];
    if (svo_buffer_append(&it->raw, NULL, (size_t)(it->count * layout->stride)) == NULL) return no_memory(err);
    if (part->soup != NULL) SVO_TRY(svo_soup_read(part->soup, &it->piece, it->first, it->count, it->raw.data, err));
    for (uint64_t i = 0; i < it->count; i++) {
        uint32_t at = (uint32_t)(i * layout->stride);
        if (part->soup == NULL) svo_soup_pack(layout, part, it->first + i, it->raw.data + at);
        SVO_TRY(one_record(d, it, (uint32_t)it->group, at, err));
    }
    return SVO_OK;
}

/* The buffer of a bin becomes a block. */
static svo_result flush_bin(reading *d, uint32_t number, svo_error *err)
{
    svoi_scattered *s = d->to;
    svoi_bin *bin = &s->bins[number];
    if (d->used[number] == 0) return SVO_OK;
    uint32_t at = (uint32_t)(s->blocks.size / sizeof(block));
    block b = {s->file.size, d->block_cost[number], d->used[number], NO_BLOCK};
    if (at == NO_BLOCK || svo_buffer_append(&s->blocks, &b, sizeof b) == NULL) return no_memory(err);
    SVO_TRY(svo_spill_append(&s->file, d->buffers + (size_t)number * BLOCK_BYTES, b.bytes, err));
    if (bin->first_block == NO_BLOCK) bin->first_block = at;
    else ((block *)(void *)s->blocks.data)[bin->last_block].next = at;
    bin->last_block = at;
    d->used[number] = 0;
    d->block_cost[number] = 0;
    return SVO_OK;
}

static svo_result commit(void *user, void *slot, svo_error *err)
{
    reading *d = user;
    item *it = slot;
    if (d->report != NULL && d->cost != NULL) {
        d->report->skipped += it->report.skipped;
        d->report->degenerate += it->report.degenerate;
        d->report->snap_sum += it->report.snap_sum;
        if (it->report.snap_max > d->report->snap_max) d->report->snap_max = it->report.snap_max;
    }
    if (d->cost != NULL) return SVO_OK;
    const hit *hits = (const hit *)(const void *)it->hits.data;
    for (uint64_t i = 0; i < it->hits.size / sizeof *hits; i++) {
        hit h = hits[i];
        const svo_soup_layout *layout = &d->plan->layouts[h.group];
        if (d->used[h.bin] + 4 + layout->stride > BLOCK_BYTES) SVO_TRY(flush_bin(d, h.bin, err));
        uint8_t *to = d->buffers + (size_t)h.bin * BLOCK_BYTES + d->used[h.bin];
        memcpy(to, &h.group, 4);
        memcpy(to + 4, it->raw.data + h.at, layout->stride);
        d->used[h.bin] += 4 + layout->stride;
        uint64_t cost = svoi_triangle_cost(layout);
        d->block_cost[h.bin] += cost;
        d->to->bins[h.bin].cost += cost;
        d->to->bins[h.bin].triangles++;
    }
    return SVO_OK;
}

static void destroy(void *user, void *slot)
{
    (void)user;
    item *it = slot;
    if (it->owner == NULL) return;
    svo_buffer_free(&it->raw);
    svo_buffer_free(&it->hits);
    svo_buffer_free(&it->cells);
}

static svo_result read_all(reading *d, const svoi_bin *bin, svo_error *err)
{
    d->next_block = bin != NULL ? bin->first_block : NO_BLOCK;
    d->group = d->local = d->piece = d->at = 0;
    svo_pipeline p = {.threads = d->plan->threads, .window = 2 * d->plan->threads, .item_size = sizeof(item), .user = d,
                      .produce = produce, .work = work, .commit = commit, .destroy = destroy};
    return svo_pipeline_run(&p, err);
}

/* --- bins ----------------------------------------------------------------------------------------------------- */

/* Join cells to bins, in order. Bins cost at most `most`, where a cell alone does not cost more. Returns their number; fills
 * what is not NULL. */
static uint32_t join_cells(const reading *d, uint64_t most, uint64_t first, uint64_t end, uint32_t *bin_of, svoi_bin *bins)
{
    uint32_t count = 0;
    uint64_t sum = 0;
    const uint32_t shift = 3 * d->levels;
    for (uint64_t c = 0; c < d->count; c++) {
        if (count == 0 || (d->cost[c] != 0 && sum != 0 && d->cost[c] > most - (sum < most ? sum : most))) {
            count++;
            sum = 0;
            if (bins != NULL) bins[count - 1] = (svoi_bin){.first_block = NO_BLOCK, .last_block = NO_BLOCK};
        }
        uint64_t from = (d->base + c) << shift, to = (d->base + c + 1) << shift;
        if (bins != NULL && d->cost[c] != 0) { /* empty cells at the ends are left out, so that a bin of one unit is seen to be one */
            if (sum == 0) bins[count - 1].first = from < first ? first : from;
            bins[count - 1].end = to < end ? to : end;
        }
        sum += d->cost[c];
        if (bin_of != NULL) bin_of[c] = count - 1;
    }
    return count;
}

static svo_result make_bins(reading *d, svoi_scattered *s, uint64_t first, uint64_t end, uint32_t *bin_of, svo_error *err)
{
    const svo_allocator *a = d->plan->allocator;
    uint64_t most = d->plan->bin_cost, total = 0;
    for (uint64_t c = 0; c < d->count; c++) total += d->cost[c];
    /* Not more bins than buffers: then they are larger, and those that are too large are binned again. */
    while (join_cells(d, most, first, end, NULL, NULL) > d->plan->max_bins) most = most * 2 > total / d->plan->max_bins ? most * 2 : total / d->plan->max_bins;
    s->bin_count = join_cells(d, most, first, end, NULL, NULL);
    s->bins = svo_calloc(a, s->bin_count, sizeof *s->bins);
    d->buffers = svo_alloc(a, s->bin_count, BLOCK_BYTES);
    d->used = svo_calloc(a, s->bin_count, sizeof *d->used);
    d->block_cost = svo_calloc(a, s->bin_count, sizeof *d->block_cost);
    if (s->bins == NULL || d->buffers == NULL || d->used == NULL || d->block_cost == NULL) return no_memory(err);
    join_cells(d, most, first, end, bin_of, s->bins);
    return SVO_OK;
}

svo_result svoi_scatter(const svoi_scatter_plan *plan, svoi_scattered *from, const svoi_bin *bin, uint64_t first, uint64_t end,
                        svoi_scattered **out, svo_bins_report *report, svo_error *err)
{
    const svo_allocator *a = plan->allocator;
    reading d = {.plan = plan, .p = plan->placement, .from = from, .report = report};
    if (report != NULL) *report = (svo_bins_report){0};
    /* The finest cells of which there are not too many. */
    while ((end > first ? ((end - 1) >> 3 * d.levels) - (first >> 3 * d.levels) + 1 : 1) > plan->max_cells) d.levels++;
    d.base = first >> 3 * d.levels;
    d.count = end > first ? ((end - 1) >> 3 * d.levels) - d.base + 1 : 1;
    svoi_scattered *s = svo_calloc(a, 1, sizeof *s);
    if (s == NULL) return no_memory(err);
    s->plan = plan;
    svo_buffer_init(&s->blocks, a);
    uint64_t *cost = svo_calloc(a, d.count, sizeof *cost);
    uint32_t *bin_of = svo_alloc(a, d.count, sizeof *bin_of);
    d.cost = cost;
    d.to = s;
    svo_result r = cost != NULL && bin_of != NULL ? SVO_OK : no_memory(err);
    if (r == SVO_OK) r = read_all(&d, bin, err);
    if (r == SVO_OK) r = make_bins(&d, s, first, end, bin_of, err);
    if (r == SVO_OK) r = svo_spill_open(plan->spill, &s->file, err);
    d.cost = NULL;
    d.bin_of = bin_of;
    d.consume = from != NULL;
    if (r == SVO_OK) r = read_all(&d, bin, err);
    for (uint32_t i = 0; r == SVO_OK && i < s->bin_count; i++) {
        r = flush_bin(&d, i, err);
        s->bins[i].too_large = s->bins[i].cost > plan->bin_cost;
    }
    svo_free(a, d.buffers, s->bin_count, BLOCK_BYTES);
    svo_free(a, d.used, s->bin_count, sizeof *d.used);
    svo_free(a, d.block_cost, s->bin_count, sizeof *d.block_cost);
    svo_free(a, cost, d.count, sizeof *cost);
    svo_free(a, bin_of, d.count, sizeof *bin_of);
    if (r != SVO_OK) {
        svoi_scattered_free(s);
        return r;
    }
    *out = s;
    return SVO_OK;
}

void svoi_scattered_free(svoi_scattered *s)
{
    if (s == NULL) return;
    const svo_allocator *a = s->plan->allocator;
    svo_spill_close(&s->file);
    svo_free(a, s->bins, s->bin_count, sizeof *s->bins);
    svo_buffer_free(&s->blocks);
    svo_free(a, s, 1, sizeof *s);
}

uint32_t svoi_scattered_count(const svoi_scattered *s) { return s->bin_count; }
const svoi_bin *svoi_scattered_bin(const svoi_scattered *s, uint32_t number) { return &s->bins[number]; }

/* --- loading -------------------------------------------------------------------------------------------------- */

svoi_bin_part svoi_bin_whole(const svoi_scattered *s, const svoi_bin *bin)
{
    svoi_bin_part part = {bin->first_block, 0};
    const block *blocks = (const block *)(const void *)s->blocks.data;
    for (uint32_t b = bin->first_block; b != NO_BLOCK; b = blocks[b].next) part.blocks++;
    return part;
}

svo_result svoi_bin_parts(const svoi_scattered *s, const svoi_bin *bin, uint64_t cost, svo_buffer *parts, svo_error *err)
{
    const block *blocks = (const block *)(const void *)s->blocks.data;
    svoi_bin_part part = {bin->first_block, 0};
    uint64_t sum = 0;
    for (uint32_t b = bin->first_block; b != NO_BLOCK; b = blocks[b].next) {
        if (part.blocks != 0 && blocks[b].cost > cost - (sum < cost ? sum : cost)) {
            if (svo_buffer_append(parts, &part, sizeof part) == NULL) return no_memory(err);
            part = (svoi_bin_part){b, 0};
            sum = 0;
        }
        part.blocks++;
        sum += blocks[b].cost;
    }
    return part.blocks == 0 || svo_buffer_append(parts, &part, sizeof part) != NULL ? SVO_OK : no_memory(err);
}

typedef struct group_run { uint32_t group; uint64_t count; } group_run;

static svo_result count_runs(const svoi_scattered *s, const svoi_bin_part *part, uint8_t *bytes, svo_buffer *runs, svo_error *err)
{
    const block *blocks = (const block *)(const void *)s->blocks.data;
    uint32_t b = part->block;
    for (uint32_t i = 0; i < part->blocks; i++, b = blocks[b].next) {
        SVO_TRY(svo_spill_read(&s->file, blocks[b].offset, bytes, blocks[b].bytes, err));
        for (uint32_t at = 0; at < blocks[b].bytes;) {
            uint32_t group;
            memcpy(&group, bytes + at, 4);
            at += 4 + s->plan->layouts[group].stride;
            group_run *last = runs->size != 0 ? (group_run *)(void *)(runs->data + runs->size) - 1 : NULL;
            group_run fresh = {group, 1};
            if (last != NULL && last->group == group) last->count++;
            else if (svo_buffer_append(runs, &fresh, sizeof fresh) == NULL) return no_memory(err);
        }
    }
    return SVO_OK;
}

static bool make_arrays(const svo_allocator *a, const svo_soup_layout *l, svo_part *part)
{
    uint64_t n = part->vertex_count;
    bool ok = (part->positions = svo_alloc(a, n, 24)) != NULL && (part->indices = svo_alloc(a, part->triangle_count, 12)) != NULL;
    if (l->normals) ok = ok && (part->normals = svo_alloc(a, n, 12)) != NULL;
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++)
        if (l->uvs[u]) ok = ok && (part->uvs[u] = svo_alloc(a, n, 8)) != NULL;
    if (l->colors) ok = ok && (part->colors = svo_alloc(a, n, 16)) != NULL;
    return ok;
}

/* A shape and an instance for every run. */
static svo_result make_mesh(const svoi_scattered *s, const svo_buffer *runs, svo_mesh *m, svo_error *err)
{
    const svo_placement *p = s->plan->placement;
    const svo_allocator *a = m->allocator;
    const group_run *run = (const group_run *)(const void *)runs->data;
    uint64_t count = runs->size / sizeof *run;
    m->shapes = svo_calloc(a, count, sizeof *m->shapes);
    m->instances = svo_calloc(a, count, sizeof *m->instances);
    m->shape_count = m->instance_count = (uint32_t)count;
    if (m->shapes == NULL || m->instances == NULL) return no_memory(err);
    for (uint32_t i = 0; i < count; i++) {
        svo_part *part = svo_calloc(a, 1, sizeof *part);
        if (part == NULL) return no_memory(err);
        m->shapes[i].parts = part;
        m->shapes[i].part_count = 1;
        m->instances[i].shape = i;
        m->instances[i].transform = p->mesh->instances[p->groups[run[i].group].instance].transform;
        part->material = p->groups[run[i].group].part->material;
        part->triangle_count = run[i].count;
        part->vertex_count = 3 * run[i].count;
        if (!make_arrays(a, &s->plan->layouts[run[i].group], part)) return no_memory(err);
        for (uint64_t k = 0; k < part->vertex_count; k++) part->indices[k] = (uint32_t)k;
    }
    return SVO_OK;
}

static svo_result fill_mesh(const svoi_scattered *s, const svoi_bin_part *from, uint8_t *bytes, svo_mesh *m, svo_error *err)
{
    const block *blocks = (const block *)(const void *)s->blocks.data;
    uint64_t run = 0, local = 0;
    uint32_t b = from->block;
    for (uint32_t i = 0; i < from->blocks; i++, b = blocks[b].next) {
        SVO_TRY(svo_spill_read(&s->file, blocks[b].offset, bytes, blocks[b].bytes, err));
        for (uint32_t at = 0; at < blocks[b].bytes; local++) {
            uint32_t group;
            memcpy(&group, bytes + at, 4);
            svo_part *part = m->shapes[run].parts;
            if (local == part->triangle_count) part = m->shapes[++run].parts, local = 0;
            svo_soup_unpack(&s->plan->layouts[group], bytes + at + 4, part, local);
            at += 4 + s->plan->layouts[group].stride;
        }
    }
    return SVO_OK;
}

svo_result svoi_bin_load(const svoi_scattered *s, const svoi_bin_part *part, svo_mesh *out, svo_error *err)
{
    const svo_allocator *a = s->plan->allocator;
    const svo_mesh *whole = s->plan->placement->mesh;
    svo_mesh m = {.allocator = a, .material_count = whole->material_count, .materials = whole->materials,
                  .image_count = whole->image_count, .images = whole->images};
    if (part->blocks == 0) {
        *out = m;
        return SVO_OK;
    }
    svo_buffer runs;
    svo_buffer_init(&runs, a);
    uint8_t *bytes = svo_alloc(a, BLOCK_BYTES, 1);
    svo_result r = bytes != NULL ? count_runs(s, part, bytes, &runs, err) : no_memory(err);
    if (r == SVO_OK) r = make_mesh(s, &runs, &m, err);
    if (r == SVO_OK) r = fill_mesh(s, part, bytes, &m, err);
    svo_free(a, bytes, BLOCK_BYTES, 1);
    svo_buffer_free(&runs);
    if (r != SVO_OK) svoi_submesh_free(&m);
    else *out = m;
    return r;
}

void svoi_submesh_free(svo_mesh *m)
{
    m->material_count = m->image_count = 0; /* borrowed */
    m->materials = NULL;
    m->images = NULL;
    svo_mesh_free(m);
}
