/* From a scene with poses to one that the ray caster takes: selection, resampling, hierarchy. */
#include <math.h>
#include <string.h>

#include "svo_resample.h"
#include "svo_task.h"

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

typedef struct gathering {
    const svo_scene *scene;
    const svo_selection *selection;
    uint32_t *channel[2]; /* color and emissive of each asset, SVO_MAX_CHANNELS: none */
    uint8_t *values[3];   /* normal, color, emissive; 4, 3, 3 bytes */
} gathering;

/* What the renderer takes for an asset without colours, and no light. */
static const uint8_t no_color[2][3] = {{203, 203, 203}, {0, 0, 0}};

static svo_result gather_values(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    gathering *g = user;
    for (uint64_t i = begin; i < end; i++) {
        const svo_selected *b = &g->selection->boxes[i];
        uint32_t asset = g->scene->instance_asset[b->instance];
        memcpy(g->values[0] + 4 * i, b->normal, 4);
        for (int c = 0; c < 2; c++) {
            if (g->values[1 + c] == NULL) continue;
            uint8_t value[SVO_MAX_STRIDE];
            if (g->channel[c][asset] != SVO_MAX_CHANNELS) svo_view_attribute(g->scene->assets[asset], g->channel[c][asset], b->attribute, value);
            else memcpy(value, no_color[c], 3);
            memcpy(g->values[1 + c] + 3 * i, value, 3);
        }
    }
    return SVO_OK;
}

static svo_result find_values(const svo_scene *scene, const svo_selection *s, uint32_t threads, const svo_allocator *a, gathering *g, svo_error *err)
{
    static const char *const names[2] = {"color", "emissive"};
    *g = (gathering){.scene = scene, .selection = s};
    g->values[0] = svo_alloc(a, s->count, 4);
    bool ok = g->values[0] != NULL || s->count == 0;
    for (int c = 0; c < 2 && ok; c++) {
        bool any = false;
        g->channel[c] = svo_alloc(a, scene->asset_count, sizeof *g->channel[c]);
        ok = g->channel[c] != NULL || scene->asset_count == 0;
        for (uint32_t i = 0; i < scene->asset_count && ok; i++) {
            const svo_view *v = scene->assets[i];
            uint32_t n = svo_view_find_channel(v, names[c]);
            bool there = n < v->channel_count && v->channels[n].channel.kind == SVO_KIND_COLOR_SRGB8;
            g->channel[c][i] = there ? n : SVO_MAX_CHANNELS;
            any = any || there;
        }
        if (!any || !ok) continue;
        g->values[1 + c] = svo_alloc(a, s->count, 3);
        ok = g->values[1 + c] != NULL || s->count == 0;
    }
    return ok ? svo_parallel_for(threads, s->count, 0, gather_values, g, err) : no_memory(err);
}

static void free_values(gathering *g, uint64_t count, const svo_allocator *a)
{
    for (int c = 0; c < 2; c++) svo_free(a, g->channel[c], g->scene->asset_count, sizeof *g->channel[c]);
    for (int c = 0; c < 3; c++) svo_free(a, g->values[c], count, c == 0 ? 4 : 3);
}

static svo_result build_octree(svo_resampled *r, const gathering *g, uint32_t threads, svo_unposed *u, svo_hierarchy_report *report, svo_error *err)
{
    static const svo_channel channels[3] = {{.name = "normal", .kind = SVO_KIND_NORMAL_OCT32},
                                            {.name = "color", .kind = SVO_KIND_COLOR_SRGB8},
                                            {.name = "emissive", .kind = SVO_KIND_COLOR_SRGB8}};
    svo_hierarchy_input in = {.depth = r->depth, .sample_count = r->count, .samples = r->samples, .value_count = g->selection->count};
    memcpy(in.voxel_to_world, r->voxel_to_world, sizeof in.voxel_to_world);
    for (int c = 0; c < 3; c++) {
        if (g->values[c] == NULL) continue;
        in.channels[in.channel_count] = channels[c];
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

svo_result svo_unpose(const svo_scene *scene, const svo_unpose_options *o, svo_unposed **out, svo_unpose_report *report, svo_error *err)
{
    const svo_allocator *a = o->select.allocator;
    svo_unpose_report r = {0};
    svo_selection selection;
    svo_resampled cells = {0};
    gathering values = {.scene = scene};
    svo_unposed *u = svo_calloc(a, 1, sizeof *u);
    if (u == NULL) return no_memory(err);
    u->allocator = a;
    svo_select_options select = o->select;
    if (select.occlusion) { /* how far the cells of svo_resample reach */
        bool emit = o->method == SVO_RESAMPLE_EMIT;
        select.overhang[0] = emit ? 2 : 0, select.overhang[1] = emit ? 0.125 : 1;
    }
    svo_result result = svo_select(scene, &select, &selection, err);
    if (result != SVO_OK) {
        svo_unposed_free(u);
        return result;
    }
    r.select = selection.report;
    result = svo_resample(&selection, o->method, 0, o->select.threads, a, &cells, err);
    r.resample = cells.report;
    double began = svo_seconds();
    if (result == SVO_OK) result = find_values(scene, &selection, o->select.threads, a, &values, err);
    r.seconds_values = svo_seconds() - began;
    if (result == SVO_OK) result = build_octree(&cells, &values, o->select.threads, u, &r.hierarchy, err);
    free_values(&values, selection.count, a);
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
