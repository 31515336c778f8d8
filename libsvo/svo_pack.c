/* Packing in five steps: look at the assets, classify the instances, merge equal assets (svo_pack_equal.c), split the
 * instances into pages by a k-d tree (svo_pack_pages.c), write the arrays. Poses: svo_pack_pose.c. */
#include "svo_pack.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_algorithm1.h"
#include "svo_skin.h"
#include "svo_text.h"
#include "svoi_packer.h"

#define DEFAULT_PAGE_INSTANCES 1024u
/* Single precision keeps 2^-24 of a coordinate. An asset whose coordinates exceed 2^18 of its voxels would lose more
 * than 1/64 voxel to it, so its coordinates are moved to the middle of its grid. */
#define FAR_VOXELS 262144.0

const svo_scene *svo_packed_scene_get(const svo_packed_scene *p) { return &p->scene; }
const svo_pack_report *svo_packed_scene_report(const svo_packed_scene *p) { return &p->report; }

void svo_packed_scene_free(svo_packed_scene *p)
{
    if (p == NULL) return;
    const svo_allocator *a = p->allocator;
    for (uint32_t i = 0; p->sources != NULL && i < p->input_assets; i++) svo_extent_free(&p->sources[i].extent);
    svo_free(a, p->sources, p->input_assets, sizeof *p->sources);
    svo_free(a, p->report.assets, p->input_assets, sizeof *p->report.assets);
    svo_free(a, p->views, p->input_assets, sizeof *p->views);
    svo_free(a, p->asset_names, p->input_assets, sizeof *p->asset_names);
    svo_free(a, p->asset, p->capacity, sizeof *p->asset);
    svo_free(a, p->name, p->capacity, sizeof *p->name);
    svo_free(a, p->transform, p->capacity, 12 * sizeof *p->transform);
    svo_free(a, p->id, p->capacity, sizeof *p->id);
    svo_free(a, p->pages, p->page_capacity, sizeof *p->pages);
    svo_free(a, p->pose, p->capacity, sizeof *p->pose);
    svo_buffer_free(&p->names);
    svoi_pose_table_free(&p->poses);
    svo_free(a, p, 1, sizeof *p);
}

static void packer_free(svoi_packer *p)
{
    svo_free(p->allocator, p->order, p->in->place_count, 8);
    svo_free(p->allocator, p->scratch, p->kept, 8);
    svo_free(p->allocator, p->keys, p->kept, 8);
    svo_free(p->allocator, p->centre, p->in->place_count, 24);
    svo_free(p->allocator, p->pose, p->in->place_count, sizeof *p->pose);
}

svo_result svoi_pack_no_memory(svo_error *err, const char *what, uint64_t count)
{
    return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %s of %llu instances", what, (unsigned long long)count);
}

svo_mat4 svoi_pack_transform(const svoi_packer *p, const svo_place *place)
{
    svo_mat4 m = svo_mat4_identity();
    memcpy(m.m, place->transform, sizeof place->transform);
    const double *c = p->out->sources[place->asset].shift;
    if (c[0] != 0 || c[1] != 0 || c[2] != 0) {
        svo_vec3 t = svo_mat4_point(&m, svo_v3(c[0], c[1], c[2]));
        m.m[3] = t.x, m.m[7] = t.y, m.m[11] = t.z;
    }
    return m;
}

/* ---- 1. assets ---- */

static svo_result look_at_asset(svoi_packer *p, uint32_t a, svo_error *err)
{
    svoi_pack_source *s = &p->out->sources[a];
    s->view = *p->in->assets[a];
    SVO_TRY(svo_extent_make(&s->view, false, p->allocator, &s->extent, err));
    if (s->view.empty) return SVO_OK;
    double *m = s->view.voxel_to_world;
    svo_mat4 to_world;
    memcpy(to_world.m, m, sizeof to_world.m);
    double from[3], to[3], far_out = 0, edge = 0;
    svo_box_transform(&to_world, s->extent.low, s->extent.high, 0, from, to);
    for (int k = 0; k < 3; k++) {
        far_out = fmax(far_out, fmax(fabs(from[k]), fabs(to[k])));
        double e = svo_length(svo_v3(m[k], m[4 + k], m[8 + k]));
        edge = k == 0 ? e : fmin(edge, e);
    }
    if (far_out > FAR_VOXELS * edge) {
        double half = ldexp(0.5, (int)s->view.depth);
        svo_vec3 c = svo_mat4_point(&to_world, svo_v3(half, half, half));
        s->shift[0] = c.x, s->shift[1] = c.y, s->shift[2] = c.z;
        for (int k = 0; k < 3; k++) m[4 * k + 3] -= s->shift[k];
        p->out->report.assets[a].moved = true;
    }
    return SVO_OK;
}

/* ---- 2. instances ---- */

/* The 3x3 part as it will be stored. */
static svo_mat4 rounded(const double t[12])
{
    svo_mat4 m = svo_mat4_identity();
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) m.m[4 * i + j] = (float)t[4 * i + j];
    return m;
}

/* Fills order with the places that are kept; counts the others. */
static svo_result classify(svoi_packer *p, svo_error *err)
{
    svo_pack_report *r = &p->out->report;
    for (uint64_t i = 0; i < p->in->place_count; i++) {
        const svo_place *place = &p->in->places[i];
        SVO_ASSERT(place->asset < p->in->asset_count && p->in->assets[place->asset] != NULL);
        bool finite = true, hidden = true;
        for (int k = 0; k < 12; k++) {
            finite = finite && isfinite(place->transform[k]) && fabs(place->transform[k]) <= 3e38;
            if (k % 4 != 3 && place->transform[k] != 0) hidden = false;
        }
        if (!finite) {
            svo_fail(err, SVO_INVALID_DATA, "instance %llu: its transform is not finite in single precision", (unsigned long long)i);
            if (err != NULL) err->index = i;
            return SVO_INVALID_DATA;
        }
        svo_pack_asset *asset = &r->assets[place->asset];
        if (hidden) {
            r->dropped_hidden++;
            continue;
        }
        svo_mat4 m = rounded(place->transform), inverse;
        if (!svo_mat4_affine_inverse(&m, &inverse)) {
            r->dropped_flat++;
            continue;
        }
        if (p->in->assets[place->asset]->empty) {
            asset->fate = SVO_PACK_EMPTY;
            r->dropped_empty++;
            continue;
        }
        asset->fate = SVO_PACK_KEPT;
        p->order[p->kept++] = i;
    }
    if (r->dropped_empty != 0)
        svo_warn(p->warnings, "%llu instances of assets without voxels are left out", (unsigned long long)r->dropped_empty);
    if (r->dropped_flat != 0)
        svo_warn(p->warnings, "%llu instances are left out: their transforms are singular, nothing of them has a volume",
                 (unsigned long long)r->dropped_flat);
    r->kept = p->kept;
    return SVO_OK;
}

/* Names that are used, each once, in the order of the packed instances. */
static svo_result gather_names(svoi_packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    if (svo_buffer_append(&o->names, "", 1) == NULL) return svoi_pack_no_memory(err, "the names", p->kept);
    uint64_t named = 0;
    for (uint64_t i = 0; i < p->kept; i++) {
        uint32_t name = p->in->places[p->order[i]].name;
        SVO_ASSERT(name == 0 || name < p->in->names_size);
        named += name != 0 && p->in->names[name] != 0;
    }
    if (named == 0) return SVO_OK;
    o->name = svo_calloc(p->allocator, p->kept, sizeof *o->name);
    uint64_t slots = 16;
    while (slots < 2 * named) slots *= 2;
    uint32_t *table = svo_calloc(p->allocator, slots, sizeof *table); /* open addressing; 0 = free */
    svo_result result = o->name == NULL || table == NULL ? svoi_pack_no_memory(err, "the names", p->kept) : SVO_OK;
    for (uint64_t i = 0; i < p->kept && result == SVO_OK; i++) {
        uint32_t offset = p->in->places[p->order[i]].name;
        if (offset == 0 || p->in->names[offset] == 0) continue;
        const char *text = p->in->names + offset;
        uint64_t size, slot = svo_text_hash(text, &size) & (slots - 1);
        while (table[slot] != 0 && strcmp((const char *)o->names.data + table[slot], text) != 0) slot = (slot + 1) & (slots - 1);
        if (table[slot] == 0) {
            if (o->names.size + size + 1 > UINT32_MAX) result = svo_fail(err, SVO_LIMIT, "names of instances take more than 4 GiB");
            else {
                table[slot] = (uint32_t)o->names.size;
                if (svo_buffer_append(&o->names, text, (size_t)size + 1) == NULL) result = svoi_pack_no_memory(err, "the names", p->kept);
            }
        }
        o->name[i] = table[slot];
    }
    svo_free(p->allocator, table, slots, sizeof *table);
    return result;
}

static void measure_translations(svoi_packer *p)
{
    svo_packed_scene *o = p->out;
    for (uint32_t g = 0; g < o->scene.page_count; g++)
        for (uint64_t i = o->pages[g].first; i < o->pages[g].first + o->pages[g].count; i++) {
            svo_mat4 m = svoi_pack_transform(p, &p->in->places[p->order[i]]), s = svo_scene_instance_transform(&o->scene, g, i);
            double e = svo_length(svo_v3(m.m[3] - s.m[3], m.m[7] - s.m[7], m.m[11] - s.m[11]));
            o->report.translation_error = fmax(o->report.translation_error, e);
        }
}

/* The poses of the kept places, each once, for the coordinates that their assets have now. */
static svo_result take_poses(svoi_packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    const svo_pack_input *in = p->in;
    bool any = false;
    for (uint64_t i = 0; i < p->kept && !any; i++) any = in->places[p->order[i]].pose != 0;
    if (!any) return SVO_OK;
    p->pose = svo_alloc(p->allocator, in->place_count, sizeof *p->pose);
    if (p->pose == NULL) return svoi_pack_no_memory(err, "the poses", p->kept);
    for (uint64_t i = 0; i < in->place_count; i++) p->pose[i] = SVO_NO_POSE;
    for (uint64_t i = 0; i < p->kept; i++) {
        const svo_place *place = &in->places[p->order[i]];
        const svoi_pack_source *s = &o->sources[place->asset];
        if (place->pose == 0) continue;
        SVO_ASSERT(place->pose - 1 < in->poses.count);
        svo_mat4 grid;
        double low[3], high[3];
        memcpy(grid.m, s->view.voxel_to_world, sizeof grid.m);
        svo_box_transform(&grid, s->extent.low, s->extent.high, 0, low, high);
        for (int k = 0; k < 3; k++) low[k] += s->shift[k], high[k] += s->shift[k];
        svo_result result = svoi_pose_table_add(&o->poses, &in->poses, place->pose - 1, low, high, s->shift, &p->pose[p->order[i]], err);
        if (result != SVO_OK) {
            if (err != NULL) err->index = p->order[i];
            return result;
        }
        if (p->pose[p->order[i]] == SVO_NO_POSE) continue;
        o->report.posed++;
        const svo_pose *pose = (const svo_pose *)(const void *)o->poses.poses.data + p->pose[p->order[i]];
        if ((pose->flags & SVO_POSE_BONES) != 0) o->report.assets[place->asset].bones = true;
    }
    for (uint32_t a = 0; a < in->asset_count; a++)
        if (o->report.assets[a].bones) SVO_TRY(svo_extent_make(&o->sources[a].view, true, p->allocator, &o->sources[a].extent, err));
    o->report.poses_rest = o->poses.rest, o->report.poses_shared = o->poses.shared;
    o->report.bones_rest = o->poses.bones_rest, o->report.matrices_shared = o->poses.matrices_shared;
    return SVO_OK;
}

static uint64_t channel_bytes(const svo_view *v, const svo_view_channel *k)
{
    uint64_t stride = svo_channel_stride(k->channel.kind), corrections = k->correction_count * SVO_CORRECTION;
    if (k->encoding == SVO_ENCODING_CONSTANT) return 0;
    if (k->encoding == SVO_ENCODING_RAW) return v->attribute_count * stride + corrections;
    return k->table_count * stride + svo_view_directory_elements(v, k) * (k->encoding == SVO_ENCODING_BLOCKS ? SVO_PALETTE_ENTRY : SVO_ALGORITHM1_ENTRY) + k->payload_size + corrections;
}

/* Channels of bones (svo_skin.h) that no pose asks for. Where nothing else varies they stay: without them the octree's numbering would have to go as well. */
static void drop_bones(svoi_packer *p)
{
    svo_pack_report *r = &p->out->report;
    for (uint32_t a = 0; a < p->in->asset_count; a++) {
        svo_view *v = &p->out->sources[a].view;
        uint32_t varying = 0, kept = 0;
        if (r->assets[a].fate != SVO_PACK_KEPT || r->assets[a].bones || p->keep_bones) continue;
        for (uint32_t i = 0; i < v->channel_count; i++) varying += !svo_skin_is_channel(v->channels[i].channel.name) && v->channels[i].encoding != SVO_ENCODING_CONSTANT;
        if (varying == 0 && !v->unnumbered) continue;
        for (uint32_t i = 0; i < v->channel_count; i++) {
            if (!svo_skin_is_channel(v->channels[i].channel.name)) {
                if (kept != i) v->channels[kept] = v->channels[i];
                kept++;
                continue;
            }
            r->bone_channel_bytes += channel_bytes(v, &v->channels[i]);
            r->bone_channels++;
        }
        v->channel_count = kept;
    }
}

static svo_result run(svoi_packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    const svo_pack_input *in = p->in;
    uint32_t assets = in->asset_count;
    o->input_assets = assets;
    if (assets != 0) {
        o->sources = svo_calloc(p->allocator, assets, sizeof *o->sources);
        o->report.assets = svo_calloc(p->allocator, assets, sizeof *o->report.assets);
        o->views = svo_calloc(p->allocator, assets, sizeof *o->views);
        o->asset_names = svo_calloc(p->allocator, assets, sizeof *o->asset_names);
        if (o->sources == NULL || o->report.assets == NULL || o->views == NULL || o->asset_names == NULL)
            return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %u assets", assets);
        for (uint32_t a = 0; a < assets; a++) o->report.assets[a].fate = SVO_PACK_UNUSED;
    }
    if (in->place_count != 0) {
        p->order = svo_alloc(p->allocator, in->place_count, 8);
        if (p->order == NULL) return svoi_pack_no_memory(err, "the order", in->place_count);
    }
    SVO_TRY(classify(p, err));
    for (uint32_t a = 0; a < assets; a++)
        if (o->report.assets[a].fate == SVO_PACK_KEPT) SVO_TRY(look_at_asset(p, a, err));
    SVO_TRY(take_poses(p, err));
    drop_bones(p);
    SVO_TRY(svoi_pack_merge_assets(p, err));
    if (p->kept != 0) {
        SVO_TRY(svoi_pack_make_pages(p, err));
        o->capacity = p->kept;
        o->asset = svo_alloc(p->allocator, p->kept, sizeof *o->asset);
        o->transform = svo_alloc(p->allocator, p->kept, 12 * sizeof *o->transform);
        o->id = svo_alloc(p->allocator, p->kept, sizeof *o->id);
        if (o->report.posed != 0) o->pose = svo_alloc(p->allocator, p->kept, sizeof *o->pose);
        if (o->asset == NULL || o->transform == NULL || o->id == NULL || (o->pose == NULL && o->report.posed != 0)) return svoi_pack_no_memory(err, "the arrays", p->kept);
    }
    svo_scene *s = &o->scene;
    s->instance_count = p->kept;
    s->assets = o->views;
    s->asset_names = o->asset_names;
    s->instance_asset = o->asset;
    s->instance_transform = o->transform;
    s->instance_id = o->id;
    s->pages = o->pages;
    s->instance_pose = o->pose;
    s->poses = svoi_pose_table_get(&o->poses);
    SVO_TRY(svoi_pack_fill_pages(p, err));
    SVO_TRY(gather_names(p, err));
    s->instance_name = o->name;
    s->names = (const char *)o->names.data;
    s->names_size = o->names.size;
    s->has_camera = in->has_camera;
    s->camera_transform = in->camera_transform;
    s->camera_yfov = in->camera_yfov;
    measure_translations(p);
    for (uint64_t i = 0; i < p->kept; i++) o->report.assets[in->places[p->order[i]].asset].instances++;
    return SVO_OK;
}

svo_result svo_pack(const svo_pack_input *input, const svo_pack_options *options, svo_packed_scene **out, svo_error *err)
{
    static const svo_pack_options defaults = {0};
    if (options == NULL) options = &defaults;
    const svo_allocator *a = options->allocator;
    svoi_packer p = {.in = input, .allocator = a, .warnings = options->warnings, .threads = options->threads,
                .page_instances = options->page_instances != 0 ? options->page_instances : DEFAULT_PAGE_INSTANCES};
    p.out = svo_calloc(a, 1, sizeof *p.out);
    if (p.out == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a scene");
    p.out->allocator = a;
    svo_buffer_init(&p.out->names, a);
    svoi_pose_table_init(&p.out->poses, a);
    p.keep_bones = options->keep_bones;
    svo_result result = run(&p, err);
    packer_free(&p);
    if (result != SVO_OK) {
        /* (the capacity of arrays that were not made is 0, and svo_free takes NULL) */
        svo_packed_scene_free(p.out);
        return result;
    }
    *out = p.out;
    return SVO_OK;
}
