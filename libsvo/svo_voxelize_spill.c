/* The voxelizer for triangles that do not fit in memory: they are binned to ranges of units outside of memory (svoi_scatter.h),
 * and each bin is voxelized as a mesh of its own, with the grid, channels and textures of the whole. A unit gets the same
 * triangles in the same order as in memory, so it gets the same bytes. A unit whose triangles alone are too many takes them in
 * parts: marks and sums do not care. */
#include <string.h>

#include "svo_task.h"
#include "svoi_scatter.h"
#include "svoi_voxelize.h"

enum {
    LEAST_BINS = 8, MOST_BINS = 1024, BUFFER = 1 << 16, /* of a bin: svo_scatter.c */
    LEAST_BIN = 1 << 20,                                /* bytes of memory of a bin that is worth its trouble */
    MOST_ROUNDS = 24                                    /* each narrows the range to at most 1/8 or the triangles to 1/8 */
};

typedef struct driver {
    svoi_run *r;
    svoi_scatter_plan plan;
    svo_placement whole;
    uint32_t threads;
} driver;

/* Of a voxel in a slice; of visits that are remembered, with what growing takes. */
static uint64_t sum_bytes(const svoi_run *r) { return 8u * svo_shader_layout(r->shader)->fields + 16; }
static uint64_t visit_bytes(const svoi_run *r) { return 3 * (sizeof(svo_block_visit) + 4 * sizeof(uint32_t)) * (uint64_t)r->most_visits; }

uint64_t svoi_scratch_bytes(const svoi_run *r) { return r->shader == NULL ? 0 : visit_bytes(r) + r->slice_voxels * sum_bytes(r); }

uint64_t svoi_slice(const svoi_run *r, bool parts)
{
    if (r->limit == NULL || !(parts || r->alone)) return r->slice_voxels;
    const uint64_t used = svo_limit_in_use(r->limit) + (parts ? r->part_cost : 0) + r->memory / 32, left = used < r->memory ? (r->memory - used) / sum_bytes(r) : 0;
    return left > r->slice_voxels ? left : r->slice_voxels;
}

uint64_t svoi_worker_bytes(const svoi_run *r)
{
    uint64_t bytes = sizeof(svo_block) + (1 << 20); /* masks, and what the sink takes */
    if (r->winding != NULL) bytes += 3 << 19;       /* svo_solid, and what each value is */
    if (r->shader == NULL) return bytes;
    uint64_t stride = 0;
    for (uint32_t c = 0; c < r->info->channel_count; c++) stride += svo_channel_stride(r->info->channels[c].kind);
    if (r->winding != NULL) bytes += 300000 * (2 * sizeof(uint32_t) + stride); /* values inside beside those of the surface */
    return bytes + svoi_scratch_bytes(r) + 400000 * stride;
}

/* --- bins one by one ------------------------------------------------------------------------------------------ */

/* Make a mesh the one that the run reads. */
static svo_result bind(driver *d, const svo_mesh *mesh, uint64_t first, uint64_t end, svo_error *err)
{
    svoi_run *r = d->r;
    svo_bins_report unused;
    SVO_TRY(svo_placement_create(mesh, r->allocator, &r->placement, err));
    SVO_TRY(svo_bins_create(&r->placement, &r->grid, r->info->depth - r->levels, UINT64_MAX, d->threads, r->allocator, &r->bins, &unused, err));
    svo_bins_limit(r->bins, first, end);
    if (r->winding != NULL) svo_bins_empty_nodes(r->bins, svoi_solid_side, r);
    return r->shader != NULL ? svo_shader_rebind(r->shader, &r->placement, err) : SVO_OK;
}

static void unbind(driver *d)
{
    svo_bins_free(d->r->bins);
    d->r->bins = NULL;
    svo_placement_free(&d->r->placement);
    d->r->placement = (svo_placement){.mesh = d->whole.mesh, .allocator = d->r->allocator};
}

static svo_result run_bin(driver *d, const svoi_scattered *s, const svoi_bin *bin, svo_error *err)
{
    svoi_bin_part whole = svoi_bin_whole(s, bin);
    svo_mesh mesh = {0};
    SVO_TRY(svoi_bin_load(s, &whole, &mesh, err));
    svo_result r = bind(d, &mesh, bin->first, bin->end, err);
    if (r == SVO_OK) r = svoi_run_chunks(d->r, d->threads, err);
    unbind(d);
    svoi_submesh_free(&mesh);
    return r;
}

/* --- a unit in parts ------------------------------------------------------------------------------------------ */

typedef struct unit_parts {
    driver *d;
    const svoi_scattered *scattered;
    svo_buffer parts; /* svoi_bin_part */
    uint64_t code;
    uint32_t bound;   /* part that is in memory; UINT32_MAX: none */
    svo_mesh mesh;
} unit_parts;

static void leave_part(unit_parts *p)
{
    if (p->bound == UINT32_MAX) return;
    unbind(p->d);
    svoi_submesh_free(&p->mesh);
    p->bound = UINT32_MAX;
}

static svo_result enter_part(void *user, uint32_t number, svo_buffer *list, svo_error *err)
{
    unit_parts *p = user;
    if (p->bound == number) return SVO_OK; /* the list is still the one of the last time */
    leave_part(p);
    SVO_TRY(svoi_bin_load(p->scattered, (const svoi_bin_part *)(const void *)p->parts.data + number, &p->mesh, err));
    p->bound = number;
    SVO_TRY(bind(p->d, &p->mesh, p->code, p->code + 1, err));
    uint64_t code;
    bool more = false;
    list->size = 0;
    return svo_bins_next(p->d->r->bins, &code, list, &more, err);
}

static svo_result run_unit(driver *d, const svoi_scattered *s, const svoi_bin *bin, svo_error *err)
{
    unit_parts p = {.d = d, .scattered = s, .code = bin->first, .bound = UINT32_MAX};
    svo_buffer_init(&p.parts, d->r->allocator);
    svo_result r = svoi_bin_parts(s, bin, d->plan.bin_cost, &p.parts, err);
    if (r == SVO_OK) {
        svoi_parts parts = {&p, (uint32_t)(p.parts.size / sizeof(svoi_bin_part)), bin->triangles, enter_part};
        r = svoi_run_chunk_parts(d->r, bin->first, &parts, err);
    }
    leave_part(&p);
    svo_buffer_free(&p.parts);
    return r;
}

/* --- all of them ---------------------------------------------------------------------------------------------- */

static svo_result run_range(driver *d, svoi_scattered *from, const svoi_bin *whole, uint64_t first, uint64_t end, uint32_t round,
                            svo_bins_report *report, svo_error *err)
{
    if (round == MOST_ROUNDS) return svo_fail(err, SVO_LIMIT, "the triangles cannot be cut into parts that fit in memory; allow more (--memory)");
    svoi_scattered *s = NULL;
    SVO_TRY(svoi_scatter(&d->plan, from, whole, first, end, &s, report, err));
    svo_result r = SVO_OK;
    svo_voxelize_report *note = d->r->report;
    if (round == 0) note->seconds_setup = svo_seconds() - d->r->began;
    if (round + 1 > note->spill_rounds) note->spill_rounds = round + 1;
    /* Bins begin and end with cells that triangles meet. So a node between them that lies in a larger empty one does so altogether, and within a bin it is empty where
     * none of the bin's triangles meets it: what is asked about the inside is what is asked in memory. */
    uint64_t done = first;
    bool any = false;
    for (uint32_t i = 0; i < svoi_scattered_count(s); i++) any |= svoi_scattered_bin(s, i)->triangles != 0;
    for (uint32_t i = 0; r == SVO_OK && i < svoi_scattered_count(s); i++) {
        const svoi_bin *bin = svoi_scattered_bin(s, i);
        if (bin->triangles == 0) continue;
        if (d->r->winding != NULL) r = svoi_run_gap(d->r, done, bin->first, d->threads, err);
        if (r != SVO_OK) break;
        done = bin->end;
        note->spill_bins += !bin->too_large;
        note->split_units += bin->too_large && bin->end - bin->first == 1;
        if (!bin->too_large) r = run_bin(d, s, bin, err);
        else if (bin->end - bin->first == 1) r = run_unit(d, s, bin, err);
        else r = run_range(d, s, bin, bin->first, bin->end, round + 1, NULL, err);
    }
    if (r == SVO_OK && any && d->r->winding != NULL) r = svoi_run_gap(d->r, done, end, d->threads, err);
    svoi_scattered_free(s);
    return r;
}

svo_result svoi_voxelize_spilled(svoi_run *r, const svo_voxelize_options *o, uint64_t first, uint64_t end, uint64_t memory, uint32_t threads, svo_bins_report *report,
                                 svo_error *err)
{
    driver d = {.r = r, .threads = threads, .whole = r->placement};
    svo_soup_layout *layouts = NULL;
    SVO_TRY(svoi_layouts(&d.whole, &layouts, err));
    /* What workers do not take goes to a bin and to the buffers of the rounds. */
    uint64_t rest = memory == 0 ? UINT64_MAX : memory - memory / 8, taken = (uint64_t)threads * svoi_worker_bytes(r);
    rest = rest > taken ? rest - taken : 0;
    d.plan = (svoi_scatter_plan){.placement = &d.whole, .layouts = layouts, .grid = r->grid, .spill = o->spill, .allocator = r->allocator, .threads = threads};
    d.plan.bin_cost = memory == 0 ? (uint64_t)1 << 30 : rest / 4 * 3;
    r->part_cost = d.plan.bin_cost;
    uint64_t bins = rest / 8 / BUFFER;
    d.plan.max_bins = bins < LEAST_BINS ? LEAST_BINS : bins > MOST_BINS ? MOST_BINS : (uint32_t)bins;
    d.plan.max_cells = rest >= (uint64_t)64 << 20 ? 1u << 18 : 1u << 15;
    d.plan.unit_level = r->info->depth - r->levels;
    const uint64_t all = (uint64_t)1 << 3 * d.plan.unit_level;
    if (end > all) end = all;
    svo_result result = SVO_OK;
    if (d.plan.bin_cost < LEAST_BIN)
        result = svo_fail(err, SVO_LIMIT, "%.1f MB of memory are not enough to voxelize in parts with %u threads; at least %.0f MB more are needed", (double)memory / 1e6,
                          threads, (double)(taken + 2 * LEAST_BIN - (memory < taken ? memory : taken)) / 1e6 + 1);
    if (result == SVO_OK && r->winding != NULL && r->shader != NULL) result = svoi_far_create(&d.whole, layouts, r->allocator, &r->far, err);
    if (result == SVO_OK && first < end) result = run_range(&d, NULL, NULL, first, end, 0, report, err);
    svoi_far_free(r->far);
    r->far = NULL;
    svo_free(r->allocator, layouts, d.whole.group_count, sizeof *layouts);
    r->placement = d.whole;
    return result;
}
