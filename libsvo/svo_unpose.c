/* From a scene with poses to one that the ray caster takes: selection, resampling, hierarchy. */
#include <math.h>
#include <string.h>

#include "svo_morton.h"
#include "svo_resample.h"
#include "svo_task.h"
#include "svoi_select.h"

struct svo_unposed {
    const svo_allocator *allocator;
    svo_scene scene;
    svo_hierarchy *octree;
    svo_scene_one single; /* of the octree */
    /* arrays of the scene: those of the source without the posed instances, and one more instance in a page of its own */
    uint64_t capacity;
    uint32_t page_capacity, asset_capacity;
    const svo_view **assets;
    const char **names;
    uint32_t *asset, *name;
    float *transform;
    uint64_t *id;
    svo_scene_page *pages;
};

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the scene of deformed voxels"); }

const svo_scene *svo_unposed_scene(const svo_unposed *u) { return &u->scene; }
const svo_view *svo_unposed_view(const svo_unposed *u) { return svo_hierarchy_view(u->octree); }

void svo_unposed_free(svo_unposed *u)
{
    if (u == NULL) return;
    const svo_allocator *a = u->allocator;
    svo_hierarchy_free(u->octree);
    svo_free(a, u->assets, u->asset_capacity, sizeof *u->assets);
    svo_free(a, u->names, u->asset_capacity, sizeof *u->names);
    svo_free(a, u->asset, u->capacity, sizeof *u->asset);
    svo_free(a, u->name, u->capacity, sizeof *u->name);
    svo_free(a, u->transform, u->capacity, 12 * sizeof *u->transform);
    svo_free(a, u->id, u->capacity, sizeof *u->id);
    svo_free(a, u->pages, u->page_capacity, sizeof *u->pages);
    svo_free(a, u, 1, sizeof *u);
}

/* ---- attributes ------------------------------------------------------------------------------------------------------- */

/* What the octree can carry beside its normals, and what an asset without such a channel has: what the renderer takes then. */
enum { COLOR, EMISSIVE, COVERAGE, METALLIC, ROUGHNESS, BONE, KINDS };
static const struct { const char *name; svo_channel_kind kind; uint8_t plain[4]; } carried[KINDS] = {
    {"color", SVO_KIND_COLOR_SRGB8, {203, 203, 203}}, {"emissive", SVO_KIND_COLOR_SRGB8, {0, 0, 0}}, {"coverage", SVO_KIND_UNORM8, {255}},
    {"metallic", SVO_KIND_UNORM8, {0}},               {"roughness", SVO_KIND_UNORM8, {0}},           {"bone", SVO_KIND_ID32, {255, 255, 255, 255}}};

typedef struct gathering {
    const svo_scene *scene;
    const svo_selection *selection;
    const svo_resampled *cells;
    uint32_t *channel[KINDS], *short_bone; /* of each asset, SVO_MAX_CHANNELS: none; short_bone: bones of 16 bits */
    uint8_t *normals, *values[KINDS];      /* NULL: not carried */
    uint8_t mirror;                        /* metallic of assets that have neither it nor a roughness */
} gathering;

typedef struct cell_box { double low[3], edge; } cell_box; /* relative to the selection's origin, as its boxes */

static cell_box cell_of(const gathering *g, const svo_sample *s)
{
    const uint32_t up = g->cells->depth - s->level;
    const double *m = g->cells->voxel_to_world;
    cell_box c = {.edge = ldexp(m[0], (int)up)};
    uint32_t cell[3];
    svo_morton_decode(s->code >> 3 * up, &cell[0], &cell[1], &cell[2]);
    for (int k = 0; k < 3; k++) c.low[k] = m[4 * k + 3] - g->selection->origin[k] + cell[k] * c.edge;
    return c;
}

/* The part of a box that is in a cell; what is flat on an axis is in it there. */
static double share_of(const svo_selected *b, const cell_box *c)
{
    double part = 1, whole = 1;
    for (int k = 0; k < 3; k++) {
        const double low = b->low[k] > c->low[k] ? b->low[k] : c->low[k], high = b->high[k] < c->low[k] + c->edge ? b->high[k] : c->low[k] + c->edge, side = (double)b->high[k] - b->low[k];
        if (!(side > 0)) continue;
        part *= high > low ? high - low : 0;
        whole *= side;
    }
    return part / whole;
}

/* Of the surface that a box stands for; of one whose asset hides all that is behind it, the largest of its sides. */
static double area_of(const svo_selected *b)
{
    double side[3];
    if (b->area > 0) return b->area;
    for (int k = 0; k < 3; k++) side[k] = (double)b->high[k] - b->low[k];
    const double xy = side[0] * side[1], yz = side[1] * side[2], zx = side[2] * side[0];
    return fmax(fmax(xy, yz), zx);
}

/* Optical depth of a share covered; what hides all that is behind it has that of half a byte's step less. */
static double optical_depth(uint8_t coverage) { return -log1p(-fmin(coverage, 254.5) / 255.0); }

/* What boxes count for in the cell of these samples: the area of the surface that each stands for times the part of it that is there, and its optical depth where some let light pass. */
static void weigh(void *user, const svo_sample *samples, uint64_t count, double *weights)
{
    const gathering *g = user;
    const cell_box cell = cell_of(g, &samples[0]);
    for (uint64_t i = 0; i < count; i++) {
        const svo_selected *b = &g->selection->boxes[samples[i].value];
        weights[i] = area_of(b) * share_of(b, &cell) * (g->values[COVERAGE] != NULL ? optical_depth(g->values[COVERAGE][samples[i].value]) : 1);
    }
}

/* Deformed boxes overlap and cells overlap them, so a ray meets several cells for each voxel that it would have met. What they cover together is to be what the voxels do: each box has
 * an optical depth times the area of the surface that it stands for, and shares it out to its cells by the volume that is in them. A cell's depth, as thick as the renderer takes it to be
 * (|n| . edge an axis), is what it got over its volume. What hides all that is behind it does so in every cell that it meets. */
static void merge_coverage(void *user, const svo_sample *samples, uint64_t count, uint32_t level, uint8_t *value)
{
    const gathering *g = user;
    const double voxel = g->cells->voxel_to_world[0], edge = ldexp(voxel, (int)(g->cells->depth - samples[0].level)), stored = ldexp(voxel, (int)(g->cells->depth - level));
    double sum = 0;
    for (uint64_t i = 0; i < count; i++) {
        const svo_selected *b = &g->selection->boxes[samples[i].value];
        const uint8_t coverage = g->values[COVERAGE][samples[i].value];
        float n[3];
        if (coverage == 255) {
            *value = 255;
            return;
        }
        if (coverage == 0) continue;
        const cell_box cell = cell_of(g, &samples[i]); /* of one inside this cell: its own */
        svo_oct32_decode(b->normal, n);
        sum -= log1p(-coverage / 255.0) * b->area * (fabsf(n[0]) + fabsf(n[1]) + fabsf(n[2])) * share_of(b, &cell);
    }
    /* Bytes are coarse for what covers little, so they are rounded up and down at random (by the place of the cell): right in the mean. */
    const uint64_t mixed = ((samples[0].code << 5 | samples[0].level) + 1) * 0x9e3779b97f4a7c15u;
    const double random = (double)((mixed ^ mixed >> 32) * 0xbf58476d1ce4e5b9u >> 11) * 0x1p-53;
    *value = (uint8_t)fmin(floor(-255 * expm1(-sum * stored / (edge * edge * edge)) + random), 254);
}

static void gather_value(const gathering *g, uint64_t i, int kind, uint8_t *value)
{
    const svo_selected *b = &g->selection->boxes[i];
    const uint32_t asset = g->scene->instance_asset[b->instance], channel = g->channel[kind][asset];
    memcpy(value, carried[kind].plain, sizeof carried[kind].plain);
    if (channel != SVO_MAX_CHANNELS) svo_view_attribute(g->scene->assets[asset], channel, b->attribute, value);
    else if (kind == METALLIC && g->channel[ROUGHNESS][asset] == SVO_MAX_CHANNELS) value[0] = g->mirror;
    else if (kind == BONE && g->short_bone[asset] != SVO_MAX_CHANNELS) {
        memset(value, 0, 4);
        svo_view_attribute(g->scene->assets[asset], g->short_bone[asset], b->attribute, value);
    }
}

static svo_result gather_values(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    gathering *g = user;
    for (uint64_t i = begin; i < end; i++) {
        memcpy(g->normals + 4 * i, g->selection->boxes[i].normal, 4);
        for (int c = 0; c < KINDS; c++) {
            uint8_t value[SVO_MAX_STRIDE];
            const uint32_t stride = svo_channel_stride(carried[c].kind);
            if (g->values[c] == NULL) continue;
            gather_value(g, i, c, value);
            memcpy(g->values[c] + stride * i, value, stride);
        }
    }
    return SVO_OK;
}

static svo_result find_values(const svo_unpose_options *o, gathering *g, svo_error *err)
{
    const svo_allocator *a = o->select.allocator;
    const svo_scene *scene = g->scene;
    const uint64_t count = g->selection->count;
    bool any[KINDS], shorter, ok = true;
    for (int c = 0; c < KINDS; c++) {
        const bool plain = c != COLOR && c != METALLIC; /* an asset that has this everywhere has none */
        g->channel[c] = svoi_find_channels(scene, carried[c].name, carried[c].kind, plain ? carried[c].plain : NULL, a, &any[c]);
        ok = ok && (g->channel[c] != NULL || scene->asset_count == 0);
    }
    g->short_bone = svoi_find_channels(scene, carried[BONE].name, SVO_KIND_ID16, NULL, a, &shorter);
    ok = ok && (g->short_bone != NULL || scene->asset_count == 0);
    any[BONE] = (any[BONE] || shorter) && o->labels;
    any[METALLIC] = any[ROUGHNESS] = (any[METALLIC] || any[ROUGHNESS]) && o->reflections;
    g->mirror = (uint8_t)rint(255 * o->reflectance);
    g->normals = svo_alloc(a, count, 4);
    ok = ok && (g->normals != NULL || count == 0);
    for (int c = 0; c < KINDS && ok; c++) {
        g->values[c] = any[c] ? svo_alloc(a, count, svo_channel_stride(carried[c].kind)) : NULL;
        ok = !any[c] || g->values[c] != NULL || count == 0;
    }
    return ok ? svo_parallel_for(o->select.threads, count, 0, gather_values, g, err) : no_memory(err);
}

static void free_values(gathering *g, const svo_allocator *a)
{
    const uint64_t count = g->selection->count;
    for (int c = 0; c < KINDS; c++) {
        svo_free(a, g->channel[c], g->scene->asset_count, sizeof *g->channel[c]);
        svo_free(a, g->values[c], count, svo_channel_stride(carried[c].kind));
    }
    svo_free(a, g->short_bone, g->scene->asset_count, sizeof *g->short_bone);
    svo_free(a, g->normals, count, 4);
}

static svo_result build_octree(svo_resampled *r, gathering *g, uint32_t threads, svo_unposed *u, svo_hierarchy_report *report, svo_error *err)
{
    svo_hierarchy_input in = {.depth = r->depth, .sample_count = r->count, .samples = r->samples, .value_count = g->selection->count, .channel_count = 1};
    svo_hierarchy_merge merge = {.merge = merge_coverage, .user = g};
    memcpy(in.voxel_to_world, r->voxel_to_world, sizeof in.voxel_to_world);
    in.weigh = weigh, in.user = g;
    in.channels[0] = (svo_channel){.name = "normal", .kind = SVO_KIND_NORMAL_OCT32};
    in.values[0] = g->normals;
    for (int c = 0; c < KINDS; c++) {
        if (g->values[c] == NULL) continue;
        svo_channel *to = &in.channels[in.channel_count];
        memcpy(to->name, carried[c].name, strlen(carried[c].name));
        to->kind = carried[c].kind;
        if (c == COVERAGE) merge.channel = in.channel_count, in.merge = &merge;
        in.values[in.channel_count++] = g->values[c];
    }
    return svo_hierarchy_build(&in, threads, u->allocator, &u->octree, report, err);
}

/* ---- the scene -------------------------------------------------------------------------------------------------------- */

static bool is_rigid(const svo_scene *s, uint64_t i) { return s->instance_pose == NULL || s->instance_pose[i] == SVO_NO_POSE; }

static bool allocate(svo_unposed *u, const svo_scene *s, bool everything)
{
    const svo_allocator *a = u->allocator;
    uint64_t rigid = 0;
    for (uint64_t i = 0; i < s->instance_count && !everything; i++) rigid += is_rigid(s, i);
    u->capacity = rigid + 1;
    u->page_capacity = s->page_count + 1;
    u->asset_capacity = s->asset_count + 1;
    u->assets = svo_alloc(a, u->asset_capacity, sizeof *u->assets);
    u->names = svo_alloc(a, u->asset_capacity, sizeof *u->names);
    u->asset = svo_alloc(a, u->capacity, sizeof *u->asset);
    u->name = svo_calloc(a, u->capacity, sizeof *u->name);
    u->transform = svo_alloc(a, u->capacity, 12 * sizeof *u->transform);
    u->id = svo_alloc(a, u->capacity, sizeof *u->id);
    u->pages = svo_alloc(a, u->page_capacity, sizeof *u->pages);
    return u->assets != NULL && u->names != NULL && u->asset != NULL && u->name != NULL && u->transform != NULL && u->id != NULL && u->pages != NULL;
}

static svo_result make_scene(svo_unposed *u, const svo_scene *s, bool everything, svo_error *err)
{
    if (!allocate(u, s, everything)) return no_memory(err);
    const svo_view *view = svo_hierarchy_view(u->octree);
    u->scene = *s;
    uint64_t n = 0;
    uint32_t pages = 0;
    for (uint32_t p = 0; p < s->page_count; p++) {
        svo_scene_page page = s->pages[p];
        page.first = n;
        for (uint64_t i = s->pages[p].first; i < s->pages[p].first + s->pages[p].count; i++) {
            if (everything || !is_rigid(s, i)) continue;
            u->asset[n] = s->instance_asset[i];
            u->id[n] = s->instance_id[i];
            if (s->instance_name != NULL) u->name[n] = s->instance_name[i];
            memcpy(u->transform + 12 * n, s->instance_transform + 12 * i, 12 * sizeof *u->transform);
            n++;
        }
        page.count = n - page.first;
        if (page.count != 0) u->pages[pages++] = page;
    }
    for (uint32_t i = 0; i < s->asset_count; i++) u->assets[i] = s->assets[i], u->names[i] = s->asset_names[i];
    SVO_TRY(svo_scene_single(view, "", u->allocator, &u->single, err));
    if (u->single.scene.instance_count != 0) {
        u->assets[s->asset_count] = view, u->names[s->asset_count] = "";
        u->asset[n] = s->asset_count;
        u->id[n] = UINT64_MAX;
        memcpy(u->transform + 12 * n, u->single.transform, sizeof u->single.transform);
        u->pages[pages] = u->single.page;
        u->pages[pages].first = n++;
        pages++;
        u->scene.asset_count++;
    }
    u->scene.assets = u->assets, u->scene.asset_names = u->names;
    u->scene.instance_count = n;
    u->scene.instance_asset = u->asset, u->scene.instance_transform = u->transform, u->scene.instance_id = u->id;
    u->scene.instance_name = s->instance_name != NULL ? u->name : NULL;
    u->scene.instance_pose = NULL;
    u->scene.poses = (svo_poses){0};
    u->scene.page_count = pages, u->scene.pages = u->pages;
    return SVO_OK;
}

/* What is seen, and with shadows what can be between that and the light, where that pays: most of a few shapes can shade them. Instances without a pose are not selected, so where there are some
 * nothing is known of what is seen of them, and all is taken. */
enum { CROWD = 16 };
static svo_result select_all(const svo_scene *scene, const svo_unpose_options *o, svo_select_options *select, svo_selection *out, svo_error *err)
{
    const bool culling = select->occlusion || select->frustum;
    if (!o->shadows || !culling) return svo_select(scene, select, out, err);
    bool all = scene->instance_count < CROWD;
    for (uint64_t i = 0; i < scene->instance_count && !select->everything && !all; i++) all = is_rigid(scene, i);
    if (all) {
        select->occlusion = select->frustum = false;
        return svo_select(scene, select, out, err);
    }
    svo_light_mask *mask;
    SVO_TRY(svo_select(scene, select, out, err));
    const double seconds = out->report.seconds;
    svo_result r = svo_light_mask_make(out, o->light, select->overhang, select->allocator, &mask, err);
    svo_selection_free(out);
    if (r != SVO_OK) return r;
    select->shading = mask;
    r = svo_select(scene, select, out, err);
    select->shading = NULL;
    svo_light_mask_free(mask);
    if (r == SVO_OK) out->report.seconds += seconds;
    return r;
}

svo_result svo_unpose(const svo_scene *scene, const svo_unpose_options *o, svo_unposed **out, svo_unpose_report *report, svo_error *err)
{
    const svo_allocator *a = o->select.allocator;
    svo_unpose_report r = {0};
    svo_selection selection;
    svo_resampled cells = {0};
    gathering values = {.scene = scene, .selection = &selection, .cells = &cells};
    svo_unposed *u = svo_calloc(a, 1, sizeof *u);
    if (u == NULL) return no_memory(err);
    u->allocator = a;
    svo_select_options select = o->select;
    if (select.occlusion || select.frustum) { /* how far the cells of svo_resample reach */
        bool emit = o->method == SVO_RESAMPLE_EMIT;
        select.overhang[0] = emit ? 2 : 0, select.overhang[1] = emit ? 0.125 : 1;
    }
    svo_result result = select_all(scene, o, &select, &selection, err);
    if (result != SVO_OK) {
        svo_unposed_free(u);
        return result;
    }
    r.select = selection.report;
    result = svo_resample(&selection, o->method, o->most_cells, o->select.threads, a, &cells, err);
    r.resample = cells.report;
    double began = svo_seconds();
    if (result == SVO_OK) result = find_values(o, &values, err);
    r.seconds_values = svo_seconds() - began;
    if (result == SVO_OK) result = build_octree(&cells, &values, o->select.threads, u, &r.hierarchy, err);
    free_values(&values, a);
    svo_resampled_free(&cells);
    svo_selection_free(&selection);
    if (result == SVO_OK) result = make_scene(u, scene, o->select.everything, err);
    if (result != SVO_OK) {
        svo_unposed_free(u);
        return result;
    }
    if (report != NULL) *report = r;
    *out = u;
    return SVO_OK;
}
