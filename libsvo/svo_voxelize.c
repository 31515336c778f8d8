#include "svoi_voxelize.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svo_task.h"

enum {
    MOST_VISITS = 1 << 17,
    LEAST_BIN = 2 << 20, /* bytes that are left to triangles, and some for what goes on the way */
    AHEAD = 112, /* chunks of geometry alone that may wait besides some a thread */
    SLICE_VOXELS = 1 << 17,
    MOST_EXPANDED = 128 << 20, /* bytes of textures that are kept in two forms */
    SOLID_COST = 200, /* bytes a triangle to tell inside from outside in memory, at most while that is prepared (no edge is shared) */
    IN_MEMORY_COST = 32 /* bytes a triangle that the walk in memory takes with its lists, besides snapped triangles */
};

static svo_result out_of_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while voxelizing"); }

/* --- a chunk's voxels ----------------------------------------------------------------------------------------- */

/* Room for a row's visits: for bricks of a large triangle, for voxels of a small one. False where they are not remembered. */
static bool make_room(svoi_scan *s)
{
    enum { MOST_IN_ROW = SVO_RASTER_SIZE * SVO_RASTER_SIZE + 1 };
    svo_buffer *v = s->by_brick ? &s->w->visits : &s->w->codes;
    const size_t size = s->by_brick ? sizeof(svo_block_visit) : sizeof(uint32_t), count = s->by_brick ? s->visits.count : s->code_count;
    const size_t more = s->by_brick ? SVO_BLOCK_ROW_VISITS : MOST_IN_ROW, most = s->by_brick ? s->r->most_visits : 4 * (size_t)s->r->most_visits;
    v->size = count * size;
    if (count + more > most || !svo_buffer_reserve(v, more * size)) return false;
    if (s->by_brick) s->visits.at = (svo_block_visit *)(void *)v->data;
    if (s->by_brick) s->visit_room = (uint32_t)(v->capacity / size) - SVO_BLOCK_ROW_VISITS;
    else s->code_room = (uint32_t)(v->capacity / size) - MOST_IN_ROW;
    return true;
}
static inline bool remembers(svoi_scan *s)
{
    if (!s->recording) return false;
    const bool room = s->by_brick ? s->visits.count < s->visit_room : s->code_count < s->code_room;
    return room || (s->recording = make_room(s));
}

/* Mark voxels in which something of the triangle is visible. */
static void mark_masked(void *user, const svo_raster_row *row)
{
    svoi_scan *s = user;
    svo_block *b = s->w->block;
    if (remembers(s)) svo_block_remember(b, row, &s->visits);
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
            if (svoi_visible(s, cell)) {
                svo_block_set(b, code);
                b->complex[code >> 6] |= bit;
            } else {
                b->masked[code >> 6] |= bit;
            }
        }
    }
}

static void mark_plain(void *user, const svo_raster_row *row) { svo_block_mark(((svoi_scan *)user)->w->block, row); }
static void mark_shaded(void *user, const svo_raster_row *row) { svo_block_mark_shaded(((svoi_scan *)user)->w->block, row); }

/* Mark a voxel (there 1) that has to be averaged if it was marked before, or do nothing (there 0, in a brick that is used). */
static inline uint32_t meet(svo_block *b, uint32_t code, uint64_t there)
{
    const uint64_t old = b->bricks[code >> 6], bit = there << (code & 63);
    if (old == 0) b->used[code >> 12] |= (uint64_t)1 << (code >> 6 & 63);
    b->bricks[code >> 6] = old | bit;
    b->complex[code >> 6] |= old & bit;
    return code;
}

/* Mark voxels; those that were marked before have to be averaged. */
static void mark_met(void *user, const svo_raster_row *row)
{
    svoi_scan *s = user;
    svo_block *b = s->w->block;
    if (!remembers(s)) {
        svo_block_mark_flat(b, row);
        return;
    }
    uint32_t *out = (uint32_t *)(void *)s->w->codes.data + s->code_count;
    const uint32_t *along = b->spread[row->w];
    for (int32_t u = row->u0; u <= row->u1; u++) {
        const uint32_t column = svo_block_column(b, row, u);
        const int32_t lo = row->lo[u], hi = row->hi[u];
        if (lo > hi) continue;
        /* Most columns have one voxel or two; which cannot be foreseen, so the second is always written, and counts where it is there. */
        const uint32_t second = hi > lo;
        *out++ = meet(b, column | along[lo], 1);
        *out = meet(b, column | along[lo + (int32_t)second], second);
        out += second;
        for (int32_t w = lo + 2; w <= hi; w++) *out++ = meet(b, column | along[w], 1);
    }
    s->code_count = (uint32_t)(out - (uint32_t *)(void *)s->w->codes.data);
}

/* The same for a large triangle; what is remembered is marked after its last row. */
static void mark_met_bricks(void *user, const svo_raster_row *row)
{
    svoi_scan *s = user;
    if (remembers(s)) svo_block_remember(s->w->block, row, &s->visits);
    else svo_block_mark_flat(s->w->block, row);
}

/* Does it meet so many voxels of a brick that bricks are better remembered than voxels? */
static bool is_large(const int32_t q[3][3])
{
    int32_t low[3], high[3], second = 0, most = 0;
    svo_raster_bounds(q, low, high);
    for (int k = 0; k < 3; k++) {
        const int32_t extent = (high[k] - low[k]) / SVO_RASTER_UNIT;
        if (extent > most) second = most, most = extent;
        else if (extent > second) second = extent;
    }
    return most >= 16 && second >= 8;
}

svo_result svoi_enter_part(svoi_scan *s, uint32_t number, svo_error *err)
{
    const svoi_parts *p = s->it->parts;
    return p == NULL ? SVO_OK : p->enter(p->user, number, &s->it->list, err);
}

static void mark_part(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3])
{
    svoi_run *r = s->r;
    const uint32_t *list = (const uint32_t *)(const void *)s->it->list.data;
    uint64_t count = s->it->list.size / 4;
    const bool thin = r->info->surface == SVO_SURFACE_THIN;
    svo_raster_target targets[3];
    uint32_t target_count = thin ? 3 : 1;
    for (uint32_t t = 0; t < target_count; t++) targets[t] = thin ? svo_raster_centre_line(t) : svo_raster_cube();
    /* The thin set is found with other scans than the surface in its voxels. */
    svo_buffer *starts = &s->w->starts;
    s->w->visits.size = starts->size = 0;
    s->w->codes.size = 0;
    s->visits.count = s->visit_room = s->code_count = s->code_room = 0;
    s->recording = s->it->parts == NULL && r->shader != NULL && r->info->channel_count != 0 && !thin && count < 4 * (uint64_t)r->most_visits &&
                   svo_buffer_reserve(starts, sizeof(svoi_start) * (count + 1));
    for (uint64_t i = 0; i < count; i++) {
        svo_record record;
        if (i + 12 < count) svo_bins_fetch(r->bins, list[i + 12]);
        svoi_load_triangle(s, list[i], &record);
        s->visits.first = s->visits.count;
        if (s->recording) ((svoi_start *)(void *)starts->data)[i] = (svoi_start){s->visits.count, s->code_count};
        svo_raster_row_fn fn = mark_plain;
        if (r->shader != NULL) {
            /* In the thin set a voxel's surface may belong to triangles that did not mark it: average them all. */
            s->by_brick = s->recording && is_large((const int32_t(*)[3])record.q);
            fn = thin ? mark_shaded : s->by_brick ? mark_met_bricks : mark_met;
            if (r->masks && svo_facet_is_masked(r->shader, record.group)) {
                svoi_load_facet(s, list[i], &record);
                fn = mark_masked;
                s->by_brick = true;
            }
        }
        for (uint32_t t = 0; t < target_count; t++)
            svo_raster_scan((const int32_t(*)[3])record.q, &targets[t], box_lo, box_hi, fn, s);
        /* also where there was no room for the triangle's last rows */
        if (fn == mark_met_bricks && s->visits.count != s->visits.first) svo_block_meet(s->w->block, s->visits.at + s->visits.first, s->visits.count - s->visits.first);
    }
    if (s->recording) ((svoi_start *)(void *)starts->data)[count] = (svoi_start){s->visits.count, s->code_count};
}

static svo_result mark_voxels(svoi_scan *s, const int32_t box_lo[3], const int32_t box_hi[3], svo_error *err)
{
    for (uint32_t part = 0; part < svoi_part_count(s); part++) {
        SVO_TRY(svoi_enter_part(s, part, err));
        mark_part(s, box_lo, box_hi);
    }
    return SVO_OK;
}

/* --- pipeline ------------------------------------------------------------------------------------------------- */

static svo_result produce(void *user, void *slot, bool *more, svo_error *err)
{
    svoi_run *r = user;
    svoi_item *it = slot;
    if (it->owner == NULL) {
        it->owner = r;
        svo_buffer_init(&it->list, r->allocator);
        svo_buffer_init(&it->copy, r->allocator);
        svoi_samples_init(&it->samples, r->allocator);
    }
    it->has_blob = false;
    it->blob = NULL;
    it->masked = 0;
    it->samples.list.size = it->samples.triangles.size = 0;
    it->distances = (svo_distances){0};
    it->parts = NULL;
    it->tree = (svo_tree_counts){0};
    it->asked = (svo_solid_counts){0};
    SVO_TRY(svo_bins_next_node(r->bins, &it->code, &it->level, &it->full, &it->list, more, err));
    it->first = !r->started && it->list.size != 0;
    if (it->list.size != 0) r->started = true;
    return SVO_OK;
}

/* The sample of distances: in every chunk of a small octree (more of it where there are few chunks), in one of eight of a large one, and in
 * the first; of units in one of four. */
static void measure(svoi_scan *s, int32_t size)
{
    const svoi_run *r = s->r;
    svoi_item *it = s->it;
    const uint32_t depth = r->info->depth;
    uint64_t choice = (it->code + 1) * 0x9e3779b97f4a7c15u >> 32;
    bool always = it->first || (r->joins ? r->levels < 4 : depth <= 9);
    if (!always && choice % (r->joins ? 4 : 8) != 0) return;
    svo_block_distances(s->w->block, r->bins, &r->placement, &r->grid, (const uint32_t *)(const void *)it->list.data, it->list.size / 4, s->corner_axis, size,
                        choice / 8, depth <= 8 && !r->joins ? 16 : 1, &it->distances);
}

/* A copy of the unit in the worker's hands, for the join. */
static svo_result keep_unit(svoi_item *it, const svo_tree_info *info, const svo_chunk *unit, svo_error *err)
{
    it->unit = *unit;
    it->copy.size = 0;
    size_t bytes = (size_t)unit->node_count;
    for (uint32_t c = 0; c < info->channel_count; c++)
        if (!info->channels[c].constant) bytes += (size_t)unit->value_count * svo_channel_stride(info->channels[c].kind);
    if (!svo_buffer_reserve(&it->copy, bytes)) return out_of_memory(err);
    it->unit.masks = svo_buffer_append(&it->copy, unit->masks, (size_t)unit->node_count);
    for (uint32_t c = 0; c < info->channel_count; c++)
        if (!info->channels[c].constant)
            it->unit.channels[c] = svo_buffer_append(&it->copy, unit->channels[c], (size_t)unit->value_count * svo_channel_stride(info->channels[c].kind));
    return SVO_OK;
}

/* Voxels that alpha MASK has cut away altogether. */
static uint64_t count_masked(const svo_block *b)
{
    uint64_t n = 0;
    for (uint32_t i = 0; i < 512; i++)
        for (uint64_t bits = b->dirty[i]; bits != 0; bits &= bits - 1) {
            uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(bits);
            n += (uint64_t)__builtin_popcountll(b->masked[brick] & ~b->bricks[brick]);
        }
    return n;
}

/* What a unit of surface voxels holds. */
static void count_surface(const svoi_run *r, svoi_item *it)
{
    const uint32_t level = r->info->depth - r->levels;
    it->tree = (svo_tree_counts){.chunks = !r->joins, .values = it->counts.nodes[SVO_CHUNK_LEVELS]};
    for (uint32_t i = 0; i <= r->levels; i++) it->tree.nodes[level + i] = it->counts.nodes[SVO_CHUNK_LEVELS - r->levels + i];
}

static svo_result work(void *user, void *slot, uint32_t number, svo_error *err)
{
    svoi_run *r = user;
    svoi_item *it = slot;
    svoi_worker *w = &r->workers[number];
    if (w->block == NULL) {
        w->block = svo_alloc(r->allocator, 1, sizeof *w->block);
        if (w->block == NULL) return out_of_memory(err);
        svo_block_init(w->block);
        svo_buffer_init(&w->masks, r->allocator);
        svo_buffer_init(&w->sums, r->allocator);
        svo_buffer_init(&w->values, r->allocator);
        svo_buffer_init(&w->ids, r->allocator);
        svo_buffer_init(&w->visits, r->allocator);
        svo_buffer_init(&w->codes, r->allocator);
        svo_buffer_init(&w->starts, r->allocator);
        svo_buffer_init(&w->entries, r->allocator);
        svo_buffer_init(&w->sources, r->allocator);
        svo_buffer_init(&w->filled, r->allocator);
        w->hit.triangle = SVO_NONE;
    }
    svoi_scan s = {.r = r, .w = w, .it = it};
    svo_chunk chunk;
    if (it->full) {
        bool any;
        SVO_TRY(svoi_solid_chunk(&s, 0, &chunk, &any, err));
        SVO_TRY(r->sink->encode(r->sink->user, &chunk, number, &it->blob, err));
        it->has_blob = true;
        return SVO_OK;
    }
    uint32_t x, y, z;
    svo_morton_decode(it->code, &x, &y, &z);
    const uint32_t levels = r->levels;
    s.corner_axis[0] = (int32_t)(x << levels);
    s.corner_axis[1] = (int32_t)(y << levels);
    s.corner_axis[2] = (int32_t)(z << levels);
    const int32_t last = (1 << levels) - 1, box_lo[3] = {0, 0, 0}, box_hi[3] = {last, last, last};
    svo_result result = mark_voxels(&s, box_lo, box_hi, err);
    w->masks.size = 0;
    if (result == SVO_OK && !svo_block_emit(w->block, &w->masks, &it->counts)) result = out_of_memory(err);
    if (result == SVO_OK && r->masks) it->masked = count_masked(w->block);
    bool any = it->counts.nodes[7] != 0;
    if (result == SVO_OK && any) {
        if (r->shader != NULL && r->info->channel_count != 0) result = svoi_shade_chunk(&s, box_lo, box_hi, err);
        if (result == SVO_OK && svoi_part_count(&s) == 1) measure(&s, last + 1); /* else the nearest triangle may be in another part */
        if (result == SVO_OK && r->sample_count != 0 && r->shader != NULL) svoi_samples_take(&s, box_lo, box_hi);
    }
    if (result == SVO_OK && r->winding != NULL) {
        result = svoi_solid_chunk(&s, levels, &chunk, &any, err);
    } else if (result == SVO_OK && any) {
        /* A unit smaller than the block lies in its low corner: drop the nodes above. */
        uint32_t skip = SVO_CHUNK_LEVELS - levels;
        chunk = (svo_chunk){.code = it->code, .level = svo_chunk_level(r->info->depth), .depth = r->info->depth};
        chunk.masks = w->masks.data + skip;
        chunk.node_count = w->masks.size - skip;
        chunk.value_count = it->counts.nodes[7];
        for (uint32_t c = 0; c < r->info->channel_count; c++) chunk.channels[c] = s.channels[c];
        count_surface(r, it);
    }
    if (result == SVO_OK && any) {
        result = r->joins ? keep_unit(it, r->info, &chunk, err) : r->sink->encode(r->sink->user, &chunk, number, &it->blob, err);
        it->has_blob = result == SVO_OK;
    }
    svo_block_clear(w->block);
    return result;
}

static svo_result commit(void *user, void *slot, svo_error *err)
{
    svoi_run *r = user;
    svoi_item *it = slot;
    r->report->masked_voxels += it->masked;
    r->report->solid_asked += it->asked.asked;
    r->report->solid_ambiguous += it->asked.ambiguous;
    if (!it->has_blob) return SVO_OK;
    svoi_samples_merge(r, &it->samples);
    r->report->distance_samples += it->distances.count;
    r->report->distance_mean += it->distances.sum; /* the sum until the end */
    if (it->distances.most > r->report->distance_max) r->report->distance_max = it->distances.most;
    svo_tree_counts *counts = &r->report->counts;
    const uint32_t level = r->info->depth - r->levels;
    const uint64_t first = it->full ? it->code << 3 * (level - it->level) : it->code;
    svo_counts_ancestors(counts, level, it->full ? it->level : level, r->has_previous, r->previous, first);
    svo_counts_add(counts, &it->tree);
    r->has_previous = true;
    r->previous = first;
    it->has_blob = false;
    return r->joins ? svoi_join_add(&r->join, r->info, it->code, &it->unit, err) : r->sink->commit(r->sink->user, it->blob, err);
}

/* The chunk that units were parts of. */
static svo_result finish_join(svoi_run *r, svo_error *err)
{
    svo_chunk chunk;
    void *blob;
    if (r->join.used == 0) return SVO_OK;
    SVO_TRY(svoi_join_chunk(&r->join, r->info, &chunk, err));
    SVO_TRY(r->sink->encode(r->sink->user, &chunk, 0, &blob, err));
    r->report->counts.chunks++;
    return r->sink->commit(r->sink->user, blob, err);
}

static void destroy(void *user, void *slot)
{
    (void)user;
    svoi_item *it = slot;
    if (it->owner == NULL) return;
    if (it->has_blob && !it->owner->joins) it->owner->sink->discard(it->owner->sink->user, it->blob);
    svo_buffer_free(&it->list);
    svo_buffer_free(&it->copy);
    svoi_samples_free(&it->samples);
}

/* Do some triangles need the shader to know which voxels exist? */
static bool mesh_masks(const svo_mesh *mesh)
{
    for (uint32_t i = 0; i < mesh->material_count; i++)
        if (mesh->materials[i].alpha_mode == SVO_ALPHA_MASK) return true;
    return false;
}

static uint64_t shifted(uint64_t code, uint32_t by) { return code > UINT64_MAX >> by ? UINT64_MAX : code << by; }

svo_result svoi_run_chunks(svoi_run *r, uint32_t threads, svo_error *err)
{
    svo_pipeline p = {.threads = threads, .item_size = sizeof(svoi_item), .user = r, .produce = produce, .work = work, .commit = commit, .destroy = destroy};
    /* A chunk of geometry takes 0.1 ms and some kB, and the system takes a processor away for milliseconds. */
    if (r->shader == NULL && r->winding == NULL && threads > 1 && r->limit == NULL) p.window = 8 * threads + AHEAD;
    return svo_pipeline_run(&p, err);
}

svo_result svoi_run_gap(svoi_run *r, uint64_t first, uint64_t end, uint32_t threads, svo_error *err)
{
    const svo_placement none = {.mesh = r->placement.mesh, .allocator = r->allocator};
    svo_bins_report unused;
    if (first >= end) return SVO_OK;
    SVO_TRY(svo_bins_create(&none, &r->grid, r->info->depth - r->levels, 0, threads, r->allocator, &r->bins, &unused, err));
    svo_bins_empty_nodes(r->bins, svoi_solid_side, r);
    svo_bins_gap(r->bins, first, end);
    const svo_result result = svoi_run_chunks(r, threads, err);
    svo_bins_free(r->bins);
    r->bins = NULL;
    return result;
}

svo_result svoi_run_chunk_parts(svoi_run *r, uint64_t code, const svoi_parts *parts, svo_error *err)
{
    svoi_item it = {.code = code, .level = r->info->depth - r->levels, .parts = parts, .first = !r->started, .owner = r};
    r->started = true;
    svo_buffer_init(&it.list, r->allocator);
    svo_buffer_init(&it.copy, r->allocator);
    svoi_samples_init(&it.samples, r->allocator);
    svo_result result = work(r, &it, 0, err);
    if (result == SVO_OK) result = commit(r, &it, err);
    destroy(r, &it);
    return result;
}

static bool is_spilled(const svo_placement *p)
{
    for (uint64_t g = 0; g < p->group_count; g++)
        if (p->groups[g].part->soup != NULL) return true;
    return false;
}

/* In memory, or through a spill? Whatever does not need it goes without. */
static bool must_spill(const svoi_run *r, const svo_voxelize_options *o, uint64_t left, uint32_t threads)
{
    if (is_spilled(&r->placement)) return true;
    if (r->placement.triangle_count >= UINT32_MAX) return o->spill != NULL;
    if (o->spill == NULL || o->memory == 0) return false;
    return r->placement.triangle_count > left / IN_MEMORY_COST || r->placement.triangle_count * IN_MEMORY_COST + threads * svoi_worker_bytes(r) > left;
}

/* Fewer workers, and smaller scratch of each, where memory is short: neither changes a byte of the result. */
static uint32_t fit_workers(svoi_run *r, uint64_t left, uint32_t threads)
{
    while (threads > 1 && threads * svoi_worker_bytes(r) > left / 2) threads--;
    /* Half of what can be divided: the smaller the slices, the more often the triangles of a unit in parts are read. */
    const uint64_t least = svoi_worker_bytes(r) - svoi_scratch_bytes(r), bin = left / 8 + LEAST_BIN;
    uint64_t most = left > 2 * least ? left / 2 : left > least ? least + (left - least) / 2 : least;
    if (most > least && most + bin > left) most = left > least + bin ? left - bin : least;
    while (svoi_worker_bytes(r) > most && r->slice_voxels > 1024) r->slice_voxels /= 2, r->most_visits /= 2;
    return threads;
}

/* What tells inside from outside, in memory where that leaves half of it, else in temporary files. */
static svo_result prepare_solid(svoi_run *r, const svo_voxelize_options *o, uint64_t left, uint32_t threads, svo_pager **pager, svo_error *err)
{
    svo_voxelize_report *report = r->report;
    svo_winding_report w;
    svo_winding_paging paging = {.run_bytes = left / 4};
    const bool spilled = is_spilled(&r->placement), paged = spilled || (o->spill != NULL && o->memory != 0 && r->placement.triangle_count > left / 2 / SOLID_COST);
    if (paged && (o->spill == NULL || o->spill->map == NULL))
        return svo_fail(err, SVO_LIMIT, "a solid of triangles outside of memory needs temporary files that can be mapped");
    if (paged && o->memory == 0) paging.run_bytes = (uint64_t)256 << 20;
    if (paged) SVO_TRY(svo_pager_create(o->spill, o->memory == 0 ? (uint64_t)256 << 20 : left / 4, 0, r->allocator, pager, err));
    paging.pager = *pager;
    SVO_TRY(svo_winding_create(&r->placement, &r->grid, threads, r->allocator, paged ? &paging : NULL, &r->winding, &w, err));
    report->solid_paged = paged;
    report->solid_triangles_oriented = w.oriented;
    report->solid_triangles_even = w.even;
    report->solid_triangles_open = w.open;
    report->solid_triangles_turned = w.turned;
    report->solid_boundary_edges = w.boundary_edges;
    report->seconds_solid = w.seconds;
    return SVO_OK;
}

static uint64_t left_of(const svo_voxelize_options *o, const svo_limit_allocator *limit)
{
    const uint64_t used = svo_limit_in_use(limit);
    return o->memory == 0 ? UINT64_MAX : o->memory > used ? o->memory - used : 0;
}

static svo_result run_all(svoi_run *r, const svo_voxelize_options *o, uint32_t threads, const svo_limit_allocator *limit, svo_pager **pager, svo_error *err)
{
    svo_voxelize_report *report = r->report;
    r->began = svo_seconds();
    r->most_visits = MOST_VISITS;
    r->limit = o->memory != 0 ? limit : NULL;
    r->memory = o->memory;
    r->slice_voxels = SLICE_VOXELS;
    SVO_TRY(svo_placement_create(r->placement.mesh, r->allocator, &r->placement, err));
    report->triangles = r->placement.triangle_count;
    const bool solid = r->info->fill == SVO_FILL_SOLID;
    r->levels = solid ? r->info->depth - svo_chunk_level(r->info->depth) : svoi_unit_levels(r->info->depth); /* what is inside is told for a chunk at a time */
    const uint32_t below = 3 * (r->info->depth - r->levels - svo_chunk_level(r->info->depth));
    r->joins = below != 0;
    const uint64_t first = o->has_range ? shifted(o->first_code, below) : 0, end = o->has_range ? shifted(o->end_code, below) : UINT64_MAX;
    bool varies = false;
    for (uint32_t c = 0; c < r->info->channel_count; c++) varies |= !r->info->channels[c].constant;
    r->masks = mesh_masks(r->placement.mesh);
    if (varies || r->masks) SVO_TRY(svo_shader_create(&r->placement, &r->grid, r->info, threads, r->allocator, &r->shader, err));
    uint64_t left = left_of(o, limit);
    if (r->shader != NULL) svo_shader_expand(r->shader, o->memory == 0 ? MOST_EXPANDED : left / 16 < MOST_EXPANDED ? left / 16 : MOST_EXPANDED, threads);
    if (solid) SVO_TRY(prepare_solid(r, o, left_of(o, limit), threads, pager, err));
    if (o->memory != 0) threads = fit_workers(r, left = left_of(o, limit), threads);
    r->alone = threads == 1;
    svo_bins_report bins = {0};
    svo_result result;
    const bool spills = must_spill(r, o, left, threads);
    if (spills) {
        report->spilled = true;
        r->sample_count = 0; /* samples mean triangles of the mesh as a whole */
        result = svoi_voxelize_spilled(r, o, first, end, o->memory != 0 ? left : 0, threads, &bins, err);
    } else {
        /* Half of what is allowed goes to snapped triangles; without room for them they are snapped again at every use. */
        uint64_t keep = o->memory == 0 ? UINT64_MAX : left / 2;
        SVO_TRY(svo_bins_create(&r->placement, &r->grid, r->info->depth - r->levels, keep, threads, r->allocator, &r->bins, &bins, err));
        svo_bins_limit(r->bins, first, end);
        if (solid) svo_bins_empty_nodes(r->bins, svoi_solid_side, r);
        report->seconds_setup = svo_seconds() - r->began;
        result = svoi_run_chunks(r, threads, err);
    }
    report->skipped_not_finite = bins.skipped;
    report->degenerate = bins.degenerate;
    uint64_t corners = 3 * (report->triangles - bins.skipped);
    report->snap_mean = corners != 0 ? bins.snap_sum / (double)corners : 0;
    report->snap_max = bins.snap_max;
    report->solid_asked += r->asked.asked;
    report->solid_ambiguous += r->asked.ambiguous;
    if (result == SVO_OK && r->joins) result = finish_join(r, err);
    if (report->distance_samples != 0) report->distance_mean /= (double)report->distance_samples;
    report->seconds_voxels = svo_seconds() - r->began - report->seconds_setup;
    if (result != SVO_OK || r->sample_count == 0) return result;
    double started = svo_seconds();
    result = svoi_samples_measure(r, threads, err);
    if (result == SVO_OUT_OF_MEMORY) result = SVO_OK, report->reference_voxels = 0; /* the octree is complete without it */
    report->seconds_reference = svo_seconds() - started;
    return result;
}

svo_result svo_voxelize(const svo_mesh *mesh, const svo_voxelize_options *options, const svo_tree_info *info,
                        const svo_chunk_sink *sink, svo_voxelize_report *report, svo_error *err)
{
    svo_voxelize_report unused;
    if (report == NULL) report = &unused;
    memset(report, 0, sizeof *report);
    if (info->depth > SVO_MAX_DEPTH) return svo_fail(err, SVO_LIMIT, "a depth of %u is more than %u", info->depth, SVO_MAX_DEPTH);
    svo_limit_allocator limit;
    svo_limit_allocator_init(&limit, options->memory != 0 ? options->memory : UINT64_MAX, options->allocator);
    svoi_run *r = svo_calloc(&limit.base, 1, sizeof *r);
    if (r == NULL)
        return options->memory != 0 ? svo_fail(err, SVO_LIMIT, "%llu bytes of memory are not enough to begin", (unsigned long long)options->memory) : out_of_memory(err);
    uint32_t threads = options->threads != 0 ? options->threads : svo_processor_count();
    if (threads > SVOI_MAX_WORKERS) threads = SVOI_MAX_WORKERS;
    r->info = info;
    r->sink = sink;
    r->allocator = &limit.base;
    r->report = report;
    r->sample_count = options->reference_voxels;
    r->sample_limit = UINT64_MAX;
    svoi_samples_init(&r->samples, r->allocator);
    r->placement.mesh = mesh;
    svoi_join_init(&r->join, r->allocator);
    r->grid.depth = info->depth;
    r->grid.size = info->voxel_to_world[0];
    for (int i = 0; i < 3; i++) r->grid.origin[i] = info->voxel_to_world[4 * i + 3];
    svo_error local = {0};
    svo_pager *pager = NULL;
    svo_result result = run_all(r, options, threads, &limit, &pager, &local);
    if (result == SVO_OUT_OF_MEMORY && options->memory != 0) {
        char why[120];
        memcpy(why, local.message, sizeof why - 1);
        why[sizeof why - 1] = 0;
        result = svo_fail(&local, SVO_LIMIT, "%.1f MB of memory are not enough: %s; allow more, or use fewer threads", (double)options->memory / 1e6, why);
    }
    for (uint32_t i = 0; i < SVOI_MAX_WORKERS; i++) {
        svoi_worker *w = &r->workers[i];
        if (w->block == NULL) continue;
        svo_buffer_free(&w->masks);
        svo_buffer_free(&w->sums);
        svo_buffer_free(&w->values);
        svo_buffer_free(&w->ids);
        svo_buffer_free(&w->visits);
        svo_buffer_free(&w->codes);
        svo_buffer_free(&w->starts);
        svo_buffer_free(&w->entries);
        svo_buffer_free(&w->sources);
        svo_buffer_free(&w->filled);
        svo_solid_free(w->solid);
        svoi_far_free_single(r, w);
        svo_free(r->allocator, w->block, 1, sizeof *w->block);
    }
    svoi_join_free(&r->join);
    svoi_samples_free(&r->samples);
    svo_winding_free(r->winding);
    svo_pager_free(pager);
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
