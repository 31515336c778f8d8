/* svo-dump of a .svscene. Node counts at the top are those of the stored assets, each once. */
#include "dump.h"

#include <math.h>
#include <string.h>

#include "fmt_scene.h"

enum { LISTED = 1000 }; /* instances and pages named one by one */

/* Instances of each asset; NULL when out of memory. */
static uint64_t *count_uses(const svo_scene *s, const svo_allocator *a)
{
    uint64_t *uses = svo_calloc(a, s->asset_count, sizeof *uses);
    for (uint64_t i = 0; uses != NULL && i < s->instance_count; i++) uses[s->instance_asset[i]]++;
    return uses;
}

/* Finest voxels of all instances; UINT64_MAX when they do not fit a number. */
static uint64_t instanced_voxels(const svo_scene *s, const uint64_t *uses)
{
    uint64_t sum = 0, product;
    for (uint32_t i = 0; i < s->asset_count; i++) {
        const svo_view *v = s->assets[i];
        if (__builtin_mul_overflow(uses[i], v->nodes[v->depth], &product) || __builtin_add_overflow(sum, product, &sum)) return UINT64_MAX;
    }
    return sum;
}

/* Channels that all assets have with the same kind: the columns of a point cloud. Constants differ, so none is one. */
static uint32_t shared_channels(const svo_scene *s, svo_channel *out)
{
    uint32_t n = 0;
    for (uint32_t c = 0; s->asset_count != 0 && c < s->assets[0]->channel_count; c++) {
        svo_channel k = s->assets[0]->channels[c].channel;
        bool all = true;
        for (uint32_t i = 1; i < s->asset_count && all; i++) {
            uint32_t at = svo_view_find_channel(s->assets[i], k.name);
            all = at != SVO_MAX_CHANNELS && s->assets[i]->channels[at].channel.kind == k.kind;
        }
        k.constant = false;
        if (all) out[n++] = k;
    }
    return n;
}

static svo_result write_instances(const svo_scene *s, const svo_channel *channels, uint32_t columns, dump_ply *p, svo_error *err)
{
    for (uint32_t page = 0; page < s->page_count; page++) {
        for (uint64_t k = 0; k < s->pages[page].count; k++) {
            uint64_t i = s->pages[page].first + k;
            const svo_view *v = s->assets[s->instance_asset[i]];
            uint32_t use[SVO_MAX_CHANNELS];
            for (uint32_t c = 0; c < columns; c++) use[c] = svo_view_find_channel(v, channels[c].name);
            svo_mat4 place = svo_scene_instance_transform(s, page, i), grid, world;
            memcpy(grid.m, v->voxel_to_world, sizeof grid.m);
            world = svo_mat4_mul(place, grid);
            dump_ply_place(p, world.m, &place, (uint32_t)i);
            SVO_TRY(dump_view_voxels(v, use, columns, p, err));
        }
    }
    return SVO_OK;
}

static svo_result write_voxels(dump_job *j, const svo_scene *s, uint64_t voxels, svo_error *err)
{
    svo_channel channels[SVO_MAX_CHANNELS];
    uint32_t columns = shared_channels(s, channels);
    bool dropped = false;
    for (uint32_t i = 0; i < s->asset_count; i++) dropped |= s->assets[i]->channel_count != columns;
    if (dropped) svo_warn(&j->c->warnings, "%.100s: the point cloud leaves out attributes that not all assets have; shared: %u", j->path, columns);
    dump_ply *p;
    SVO_TRY(dump_ply_begin(j, voxels, channels, columns, true, &p, err));
    svo_result r = write_instances(s, channels, columns, p, err);
    if (r == SVO_OK) return dump_ply_end(p, err);
    dump_ply_discard(p);
    return r;
}

static json_t *box(const double low[3], const double high[3])
{
    json_t *o = json_object();
    json_object_set_new(o, "low", dump_reals(low, 3));
    json_object_set_new(o, "high", dump_reals(high, 3));
    return o;
}

static void put_assets(dump_job *j, const fmt_scene *f, const uint64_t *uses)
{
    const svo_scene *s = &f->scene;
    uint64_t nodes[SVO_MAX_DEPTH + 1] = {0}, voxels = 0, all = 0;
    uint32_t depth = 0;
    json_t *list = json_array(), *names = json_array(), *levels = json_array();
    for (uint32_t i = 0; i < s->asset_count; i++) {
        const svo_view *v = s->assets[i];
        const fmt_container *c = &f->assets[i].container;
        json_t *a = json_object();
        cli_put_text(a, "name", s->asset_names[i]);
        cli_put_u64(a, "instances", uses[i]);
        cli_put_u64(a, "bytes", c->size);
        dump_grid(a, v->depth, v->voxel_to_world, v->surface, v->fill);
        dump_counts(a, v->depth, v->nodes, c->size);
        json_object_set_new(a, "attributes", dump_view_channels(v, c));
        json_array_append_new(list, a);
        if (v->depth > depth) depth = v->depth;
        for (uint32_t l = 0; l <= v->depth; l++) nodes[l] += v->nodes[l];
        voxels += v->nodes[v->depth];
        for (uint32_t k = 0; k < v->channel_count; k++) {
            size_t n = 0;
            while (n < json_array_size(names) && strcmp(json_string_value(json_object_get(json_array_get(names, n), "name")), v->channels[k].channel.name) != 0) n++;
            if (n < json_array_size(names)) continue;
            json_t *name = json_object();
            cli_put_text(name, "name", v->channels[k].channel.name);
            json_array_append_new(names, name);
        }
    }
    for (uint32_t l = 0; l <= depth && s->asset_count != 0; l++) {
        json_t *level = json_object();
        cli_put_u64(level, "level", l);
        cli_put_u64(level, "nodes", nodes[l]);
        json_array_append_new(levels, level);
        all += nodes[l];
    }
    cli_put_u64(j->json, "depth", depth);
    json_object_set_new(j->json, "voxel_to_world", json_null()); /* each asset and instance has its own */
    json_object_set_new(j->json, "levels", levels);
    cli_put_u64(j->json, "nodes", all);
    cli_put_u64(j->json, "voxels", voxels);
    cli_put_u64(j->json, "instanced_voxels", instanced_voxels(s, uses));
    cli_put_f64(j->json, "bytes_per_voxel", voxels != 0 ? (double)j->size / (double)voxels : NAN);
    cli_put_f64(j->json, "bytes_per_node", all != 0 ? (double)j->size / (double)all : NAN);
    json_object_set_new(j->json, "attributes", names);
    json_object_set_new(j->json, "assets", list);
}

static void put_instances(json_t *o, const svo_scene *s)
{
    json_t *pages = json_array(), *instances = json_array();
    for (uint32_t p = 0; p < s->page_count; p++) {
        const svo_scene_page *page = &s->pages[p];
        if (p < LISTED) {
            json_t *e = json_object();
            cli_put_u64(e, "first", page->first);
            cli_put_u64(e, "instances", page->count);
            json_object_set_new(e, "bounds", box(page->low, page->high));
            json_array_append_new(pages, e);
        }
        for (uint64_t i = page->first; i < page->first + page->count && i < LISTED; i++) {
            json_t *e = json_object();
            svo_mat4 m = svo_scene_instance_transform(s, p, i);
            cli_put_u64(e, "asset", s->instance_asset[i]);
            cli_put_u64(e, "id", s->instance_id[i]);
            const char *name = svo_scene_instance_name(s, i);
            if (name[0] != 0) cli_put_text(e, "name", name);
            json_object_set_new(e, "transform", dump_reals(m.m, 16));
            json_array_append_new(instances, e);
        }
    }
    json_object_set_new(o, "pages", pages);
    json_object_set_new(o, "instances", instances);
    json_object_set_new(o, "listed_in_full", json_boolean(s->page_count <= LISTED && s->instance_count <= LISTED));
}

static void summarise(dump_job *j, const fmt_scene *f, const uint64_t *uses)
{
    const svo_scene *s = &f->scene;
    double low[3], high[3];
    dump_container(j, &f->container);
    cli_put_u64(j->json, "asset_count", s->asset_count);
    cli_put_u64(j->json, "instance_count", s->instance_count);
    cli_put_u64(j->json, "page_count", s->page_count);
    json_object_set_new(j->json, "bounds", svo_scene_bounds(s, low, high) ? box(low, high) : json_null());
    json_t *camera = json_null();
    if (s->has_camera) {
        camera = json_object();
        cli_put_f64(camera, "fov", s->camera_yfov * (180 / 3.14159265358979323846));
        json_object_set_new(camera, "transform", dump_reals(s->camera_transform.m, 16));
    }
    json_object_set_new(j->json, "camera", camera);
    put_assets(j, f, uses);
    put_instances(j->json, s);
    dump_sections(j, &f->container);
    dump_provenance(j->json, f->provenance);
    json_t *left = json_object_get(json_object_get(j->json, "provenance"), "left_out"); /* svo-pack's; of other writers there is none */
    if (json_is_array(left)) json_object_set(j->json, "left_out", left);
}

svo_result dump_scene(dump_job *j, svo_error *err)
{
    fmt_scene f;
    SVO_TRY(fmt_scene_open(j->data, j->size, j->allocator, &f, err));
    svo_result r = SVO_OK;
    uint64_t *uses = count_uses(&f.scene, j->allocator);
    if (uses == NULL && f.scene.asset_count != 0) r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to count instances");
    if (r == SVO_OK && j->voxels != NULL) r = write_voxels(j, &f.scene, instanced_voxels(&f.scene, uses), err);
    if (r == SVO_OK) summarise(j, &f, uses);
    svo_free(j->allocator, uses, f.scene.asset_count, sizeof *uses);
    fmt_scene_close(&f);
    return r;
}
