/* Voxels in the formats of other programs; what becomes of them is told in formats/fmt_cells.h. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "cells_vdb.h"
#include "cli_scene.h"
#include "dump.h"
#include "dump_cut.h"

typedef enum format { PLY, GLB, VOX, NRRD, RAW, VDB, NVDB, UNKNOWN } format;
static const char *const endings[UNKNOWN] = {".ply", ".glb", ".vox", ".nrrd", ".raw", ".vdb", ".nvdb"};

static format format_of(const char *path)
{
    size_t n = strlen(path);
    for (int i = 0; i < UNKNOWN; i++) {
        size_t m = strlen(endings[i]);
        if (n > m && strcasecmp(path + n - m, endings[i]) == 0) return (format)i;
    }
    return UNKNOWN;
}

typedef struct gather {
    const dump_export *ask;
    svo_buffer list; /* fmt_cell */
    uint32_t level, color; /* of the tree; channel or SVO_MAX_CHANNELS */
    uint32_t low[3], high[3];
    bool any;
    uint32_t box_low[3], box_high[3]; /* of the cells */
} gather;

/* A leaf, which may be many cells; those in the box are taken. */
static svo_result take(void *user, const dump_cut_node *n, svo_error *err)
{
    gather *g = user;
    if (!n->leaf) return SVO_OK;
    uint32_t shift = g->level - n->level, from[3], to[3];
    uint64_t count = 1;
    for (int k = 0; k < 3; k++) {
        uint32_t low = n->cell[k] << shift, high = low + ((1u << shift) - 1);
        from[k] = low > g->low[k] ? low : g->low[k];
        to[k] = high < g->high[k] ? high : g->high[k];
        if (from[k] > to[k]) return SVO_OK;
        count *= (uint64_t)to[k] - from[k] + 1; /* at most 2^63 */
    }
    uint64_t have = g->list.size / sizeof(fmt_cell);
    if (count > g->ask->limit || have > g->ask->limit - count)
        return svo_fail(err, SVO_LIMIT, "more than %llu voxels; raise --limit, or export a coarser level (--level) or a box (--low, --high)",
                        (unsigned long long)g->ask->limit);
    fmt_cell c = {.rgb = {203, 203, 203, 255}}; /* what svo-render draws without colour */
    if (g->color != SVO_MAX_CHANNELS) memcpy(c.rgb, n->values[g->color], 3);
    for (int k = 0; k < 3; k++) {
        if (!g->any || from[k] < g->box_low[k]) g->box_low[k] = from[k];
        if (!g->any || to[k] > g->box_high[k]) g->box_high[k] = to[k];
    }
    g->any = true;
    for (c.at[2] = from[2]; c.at[2] <= to[2]; c.at[2]++)
        for (c.at[1] = from[1]; c.at[1] <= to[1]; c.at[1]++)
            for (c.at[0] = from[0]; c.at[0] <= to[0]; c.at[0]++)
                if (svo_buffer_append(&g->list, &c, sizeof c) == NULL)
                    return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the voxels to export; export a coarser level (--level) or a box (--low, --high)");
    return SVO_OK;
}

static void tell_glb(dump_job *j, json_t *report, uint64_t voxels, const fmt_cells_glb_report *t)
{
    cli_put_u64(report, "faces", t->faces);
    cli_put_u64(report, "nodes", t->nodes);
    cli_info(j->c, "%s: %llu voxels, %llu faces", j->export.path, (unsigned long long)voxels, (unsigned long long)t->faces);
    if (!j->export.has_draco) return;
    cli_put_u64(report, "draco_bytes", t->draco_bytes);
    cli_put_u64(report, "draco_bits", t->bits);
    cli_put_f64(report, "draco_error_voxels", t->position_error);
    cli_put_f64(report, "draco_error_normal_degrees", t->normal_error);
    cli_info(j->c, "%s: Draco takes %llu bytes; with %u bits corners are at most %.3g voxels and normals %.3g degrees off", j->export.path, (unsigned long long)t->draco_bytes, t->bits,
             t->position_error, t->normal_error);
}

static svo_result write_glb(dump_job *j, const fmt_cells *c, fmt_output *o, json_t *report, svo_error *err)
{
    fmt_cells_glb *g;
    fmt_cells_glb_report told;
    uint64_t mesh;
    SVO_TRY(fmt_cells_glb_begin(j->export.has_draco, (uint32_t)j->export.draco, j->allocator, &g, err));
    svo_result r = fmt_cells_glb_mesh(g, c, NULL, &mesh, err);
    if (r == SVO_OK) {
        fmt_cells_glb_node(g, mesh, c->to_world, "voxels", NULL);
        r = fmt_cells_glb_end(g, o, &told, err);
    }
    if (r == SVO_OK) tell_glb(j, report, c->count, &told);
    fmt_cells_glb_free(g);
    return r;
}

static svo_result write_ply(dump_job *j, const fmt_cells *c, fmt_output *o, json_t *report, svo_error *err)
{
    svo_buffer list;
    svo_buffer_init(&list, c->allocator);
    svo_result r = fmt_cells_faces(c, &list, err);
    fmt_cells_placed placed = {.faces = (const fmt_cell_face *)(const void *)list.data, .count = list.size / sizeof(fmt_cell_face)};
    memcpy(placed.to_world, c->to_world, sizeof placed.to_world);
    if (r == SVO_OK) r = fmt_cells_placed_ply(&placed, 1, c->colored, o, err);
    cli_put_u64(report, "faces", placed.count);
    if (r == SVO_OK) cli_info(j->c, "%s: %llu voxels, %llu faces", j->export.path, (unsigned long long)c->count, (unsigned long long)placed.count);
    svo_buffer_free(&list);
    return r;
}

static json_t *begin_report(dump_job *j, uint64_t voxels)
{
    json_t *report = json_object();
    json_object_set_new(cli_section(j->c, "output"), "export", report);
    cli_put_u64(report, "voxels", voxels);
    return report;
}

static svo_result write(dump_job *j, format f, const fmt_cells *c, fmt_output *o, svo_error *err)
{
    json_t *report = begin_report(j, c->count);
    svo_result r = SVO_OK;
    if (f == PLY) {
        r = write_ply(j, c, o, report, err);
    } else if (f == GLB) {
        r = write_glb(j, c, o, report, err);
    } else if (f == VOX) {
        fmt_vox_report v;
        r = fmt_cells_vox(c, o, &v, err);
        if (r != SVO_OK) return r;
        cli_put_u64(report, "models", v.models);
        cli_put_u64(report, "colors", v.colors);
        cli_put_f64(report, "delta_e_mean", v.delta_mean);
        cli_put_f64(report, "delta_e_max", v.delta_max);
        cli_info(j->c, "%s: %llu voxels in %llu models; %llu colours to at most 255: mean %.3f, max %.3f delta E (CIE94)", j->export.path,
                 (unsigned long long)c->count, (unsigned long long)v.models, (unsigned long long)v.colors, v.delta_mean, v.delta_max);
    } else if (f == NRRD || f == RAW) {
        r = fmt_cells_dense(c, j->export.rgba, f == NRRD, o, err);
        json_object_set_new(report, "size", json_pack("[I,I,I]", (json_int_t)c->high[0] - c->low[0] + 1, (json_int_t)c->high[1] - c->low[1] + 1, (json_int_t)c->high[2] - c->low[2] + 1));
        if (r == SVO_OK) cli_info(j->c, "%s: %u x %u x %u cells, x fastest", j->export.path, c->high[0] - c->low[0] + 1, c->high[1] - c->low[1] + 1, c->high[2] - c->low[2] + 1);
    } else {
        r = f == VDB ? fmt_cells_vdb(c, o, err) : fmt_cells_nvdb(c, o, err);
    }
    return r;
}

/* The whole numbers of --low and --high. */
static svo_result read_box(const dump_export *ask, uint32_t side, gather *g, svo_error *err)
{
    for (int k = 0; k < 3; k++) {
        double low = ask->has_low ? ask->low[k] : 0, high = ask->has_high ? ask->high[k] : side - 1.0;
        if (!(low >= 0 && high < side && low <= high && low == floor(low) && high == floor(high)))
            return svo_fail(err, SVO_INVALID_ARGUMENT, "--low and --high are whole cells of the exported level, 0 to %u, both inclusive", side - 1);
        g->low[k] = (uint32_t)low, g->high[k] = (uint32_t)high;
    }
    return SVO_OK;
}

/* The cells of an octree at a level, in the box that was asked for. Free g->list. */
static svo_result gather_cells(dump_job *j, const svo_view *v, uint32_t depth, gather *g, fmt_cells *c, svo_error *err)
{
    const dump_export *ask = &j->export;
    *g = (gather){.ask = ask, .level = v->tree_depth - (v->depth - depth), .color = svo_view_find_channel(v, "color")};
    if (g->color != SVO_MAX_CHANNELS && v->channels[g->color].channel.kind != SVO_KIND_COLOR_SRGB8) g->color = SVO_MAX_CHANNELS;
    svo_buffer_init(&g->list, j->allocator);
    SVO_TRY(read_box(ask, 1u << depth, g, err));
    SVO_TRY(dump_cut(v, g->level, take, g, err));
    *c = (fmt_cells){.cell = (const fmt_cell *)(const void *)g->list.data, .count = g->list.size / sizeof(fmt_cell), .colored = g->color != SVO_MAX_CHANNELS, .allocator = j->allocator};
    for (int i = 0; i < 16; i++) c->to_world[i] = v->voxel_to_world[i] * (i % 4 < 3 && i < 12 ? ldexp(1, (int)(v->depth - depth)) : 1);
    return SVO_OK;
}

static svo_result export_view(dump_job *j, const svo_view *v, format f, fmt_output *o, svo_error *err)
{
    const dump_export *ask = &j->export;
    uint32_t depth = ask->has_level ? (uint32_t)ask->level : v->depth;
    if (depth > v->depth) return svo_fail(err, SVO_INVALID_ARGUMENT, "--level %u: the finest level of this file is %u", depth, v->depth);
    gather g;
    fmt_cells c;
    svo_result r = gather_cells(j, v, depth, &g, &c, err);
    if (r == SVO_OK) {
        bool whole = f == NRRD || f == RAW ? ask->has_low || ask->has_high || !g.any : !g.any; /* dense: the box that was asked for, else that of the voxels */
        for (int k = 0; k < 3; k++) c.low[k] = whole ? g.low[k] : g.box_low[k], c.high[k] = whole ? g.high[k] : g.box_high[k];
        r = write(j, f, &c, o, err);
    }
    svo_buffer_free(&g.list);
    return r;
}

/* --- scenes --- */

enum { MOST_NODES = 1 << 18 }; /* of a .glb: its JSON is held in memory, and viewers read it so */

/* Visit every instance: its map from the cells of its asset, as exported, to the scene. */
typedef svo_result (*place_fn)(void *user, uint32_t page, uint64_t instance, const double to_scene[16], svo_error *err);
static svo_result each_instance(const svo_scene *s, const double (*to_mesh)[16], place_fn fn, void *user, svo_error *err)
{
    for (uint32_t page = 0; page < s->page_count; page++)
        for (uint64_t i = s->pages[page].first; i < s->pages[page].first + s->pages[page].count; i++) {
            svo_mat4 grid;
            memcpy(grid.m, to_mesh[s->instance_asset[i]], sizeof grid.m);
            const svo_mat4 m = svo_mat4_mul(svo_scene_instance_transform(s, page, i), grid);
            SVO_TRY(fn(user, page, i, m.m, err));
        }
    return SVO_OK;
}

typedef struct scene_job {
    dump_job *j;
    const svo_scene *s;
    double (*to_mesh)[16]; /* of each asset */
    uint64_t voxels;       /* of all assets */
    bool colored;          /* any of them */
    fmt_cells_glb *glb;
    uint64_t *meshes;
    uint64_t sheared, instanced;
    svo_buffer many;     /* many_place: instances that are not nodes of their own */
    svo_buffer *faces; /* of each asset, for .ply */
    svo_buffer placed;
} scene_job;

static void node(scene_job *k, uint64_t i, const double to_scene[16])
{
    fmt_cells_glb_node(k->glb, k->meshes[k->s->instance_asset[i]], to_scene, svo_scene_instance_name(k->s, i), &k->s->instance_id[i]);
}

typedef struct many_place { uint32_t page, asset; uint64_t instance; fmt_cells_place place; } many_place;

static svo_result place_node(void *user, uint32_t page, uint64_t i, const double to_scene[16], svo_error *err)
{
    scene_job *k = user;
    many_place p = {.page = page, .asset = k->s->instance_asset[i], .instance = i};
    const bool straight = fmt_cells_place_of(to_scene, k->s->pages[page].origin, &p.place);
    k->sheared += !straight; /* glTF wants matrices without shear */
    if (straight && k->j->export.instancing && k->meshes[p.asset] != UINT64_MAX)
        return svo_buffer_append(&k->many, &p, sizeof p) != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the instances");
    node(k, i, to_scene);
    return SVO_OK;
}

static int by_page_and_asset(const void *a, const void *b)
{
    const many_place *p = a, *q = b;
    if (p->page != q->page) return p->page < q->page ? -1 : 1;
    if (p->asset != q->asset) return p->asset < q->asset ? -1 : 1;
    return p->instance < q->instance ? -1 : p->instance > q->instance;
}

/* A node for each page and asset; one instance alone keeps its name and number. */
static svo_result place_many(scene_job *k, svo_error *err)
{
    many_place *all = (many_place *)(void *)k->many.data;
    const uint64_t count = k->many.size / sizeof *all;
    fmt_cells_place *run = svo_calloc(k->j->allocator, count, sizeof *run);
    if (run == NULL && count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the instances");
    if (count != 0) qsort(all, count, sizeof *all, by_page_and_asset);
    for (uint64_t i = 0, n; i < count; i += n) {
        for (n = 0; i + n < count && all[i + n].page == all[i].page && all[i + n].asset == all[i].asset; n++) run[n] = all[i + n].place;
        if (n > 1) {
            fmt_cells_glb_places(k->glb, k->meshes[all[i].asset], k->s->pages[all[i].page].origin, run, n);
            k->instanced += n;
            continue;
        }
        svo_mat4 grid;
        memcpy(grid.m, k->to_mesh[all[i].asset], sizeof grid.m);
        const svo_mat4 m = svo_scene_instance_transform(k->s, all[i].page, all[i].instance), to_scene = svo_mat4_mul(m, grid);
        node(k, all[i].instance, to_scene.m);
    }
    svo_free(k->j->allocator, run, count, sizeof *run);
    return SVO_OK;
}

static svo_result place_faces(void *user, uint32_t page, uint64_t i, const double to_scene[16], svo_error *err)
{
    scene_job *k = user;
    (void)page;
    const svo_buffer *faces = &k->faces[k->s->instance_asset[i]];
    fmt_cells_placed p = {.faces = (const fmt_cell_face *)(const void *)faces->data, .count = faces->size / sizeof(fmt_cell_face)};
    memcpy(p.to_world, to_scene, sizeof p.to_world);
    return svo_buffer_append(&k->placed, &p, sizeof p) != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the instances");
}

/* The mesh of each asset, once. */
static svo_result prepare_assets(scene_job *k, format f, svo_error *err)
{
    const dump_export *ask = &k->j->export;
    for (uint32_t i = 0; i < k->s->asset_count; i++) {
        const svo_view *v = k->s->assets[i];
        gather g;
        fmt_cells c;
        svo_result r = gather_cells(k->j, v, ask->has_level && ask->level < v->depth ? (uint32_t)ask->level : v->depth, &g, &c, err);
        if (r == SVO_OK) {
            memcpy(k->to_mesh[i], c.to_world, sizeof c.to_world);
            k->voxels += c.count;
            k->colored |= c.colored;
            r = f == GLB ? fmt_cells_glb_mesh(k->glb, &c, k->s->asset_names[i], &k->meshes[i], err) : fmt_cells_faces(&c, &k->faces[i], err);
        }
        svo_buffer_free(&g.list);
        SVO_TRY(r);
    }
    return SVO_OK;
}

static svo_result write_scene(scene_job *k, format f, fmt_output *o, svo_error *err)
{
    const svo_scene *s = k->s;
    uint64_t posed = 0;
    for (uint64_t i = 0; i < s->instance_count; i++) posed += svo_scene_instance_pose(s, i) != NULL;
    if (posed != 0)
        svo_warn(&k->j->c->warnings, "%.100s: %llu instances have a pose; they are exported as they are without it (svo-render --resample --save-svo makes voxels of one)", k->j->path, (unsigned long long)posed);
    SVO_TRY(prepare_assets(k, f, err));
    json_t *report = begin_report(k->j, k->voxels);
    cli_put_u64(report, "instances", s->instance_count);
    cli_put_u64(report, "poses_left_out", posed);
    if (f == PLY) {
        SVO_TRY(each_instance(s, (const double (*)[16])k->to_mesh, place_faces, k, err));
        const fmt_cells_placed *list = (const fmt_cells_placed *)(const void *)k->placed.data;
        const uint64_t count = k->placed.size / sizeof *list;
        uint64_t faces = 0;
        SVO_TRY(fmt_cells_placed_ply(list, count, k->colored, o, err));
        for (uint64_t i = 0; i < count; i++) faces += list[i].count;
        cli_put_u64(report, "faces", faces);
        cli_info(k->j->c, "%s: %llu instances, %llu faces", k->j->export.path, (unsigned long long)count, (unsigned long long)faces);
        return SVO_OK;
    }
    fmt_cells_glb_report told;
    SVO_TRY(each_instance(s, (const double (*)[16])k->to_mesh, place_node, k, err));
    SVO_TRY(place_many(k, err));
    cli_put_u64(report, "instanced", k->instanced);
    SVO_TRY(fmt_cells_glb_end(k->glb, o, &told, err));
    if (k->sheared != 0) svo_warn(&k->j->c->warnings, "%.100s: %llu instances are sheared, which glTF has no words for; their nodes have the matrix all the same, as most viewers take it", k->j->path, (unsigned long long)k->sheared);
    tell_glb(k->j, report, k->voxels, &told);
    return SVO_OK;
}

static svo_result export_scene(dump_job *j, const svo_scene *s, format f, fmt_output *o, svo_error *err)
{
    const dump_export *ask = &j->export;
    if (f != GLB && f != PLY) return svo_fail(err, SVO_UNSUPPORTED, "a scene is exported as .glb or .ply; %s takes one octree: export the assets one by one, or the voxels with --voxels", endings[f]);
    if (ask->has_low || ask->has_high) return svo_fail(err, SVO_INVALID_ARGUMENT, "--low and --high are for one octree, not for scenes");
    if (f == GLB && s->instance_count > MOST_NODES && !ask->instancing)
        return svo_fail(err, SVO_LIMIT, "%llu instances are more nodes than a .glb is good for (%d); --instancing makes one of many", (unsigned long long)s->instance_count, MOST_NODES);
    scene_job k = {.j = j, .s = s};
    const uint64_t n = s->asset_count;
    svo_buffer_init(&k.many, j->allocator);
    svo_buffer_init(&k.placed, j->allocator);
    k.to_mesh = svo_calloc(j->allocator, n, sizeof *k.to_mesh);
    k.meshes = svo_calloc(j->allocator, n, sizeof *k.meshes);
    k.faces = svo_calloc(j->allocator, n, sizeof *k.faces);
    svo_result r = n == 0 || (k.to_mesh != NULL && k.meshes != NULL && k.faces != NULL) ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the assets");
    for (uint64_t i = 0; i < n && k.faces != NULL; i++) svo_buffer_init(&k.faces[i], j->allocator);
    if (r == SVO_OK && f == GLB) r = fmt_cells_glb_begin(ask->has_draco, (uint32_t)ask->draco, j->allocator, &k.glb, err);
    if (r == SVO_OK) r = write_scene(&k, f, o, err);
    fmt_cells_glb_free(k.glb);
    for (uint64_t i = 0; i < n && k.faces != NULL; i++) svo_buffer_free(&k.faces[i]);
    svo_buffer_free(&k.placed);
    svo_buffer_free(&k.many);
    svo_free(j->allocator, k.faces, n, sizeof *k.faces);
    svo_free(j->allocator, k.meshes, n, sizeof *k.meshes);
    svo_free(j->allocator, k.to_mesh, n, sizeof *k.to_mesh);
    return r;
}

svo_result dump_export_file(dump_job *j, svo_error *err)
{
    format f = format_of(j->export.path);
    if (f == UNKNOWN) return svo_fail(err, SVO_INVALID_ARGUMENT, "%s: --export writes .ply (mesh), .glb, .vox, .nrrd, .raw, .vdb or .nvdb", j->export.path);
    if (f != GLB && j->export.instancing) return svo_fail(err, SVO_INVALID_ARGUMENT, "--instancing is for .glb files");
    if (f != GLB && j->export.has_draco) return svo_fail(err, SVO_INVALID_ARGUMENT, "--draco is for .glb files");
    if ((f == VDB && !fmt_have_vdb()) || (f == NVDB && !fmt_have_nvdb()))
        return svo_fail(err, SVO_NOT_BUILT, "%s: this build cannot write %s files, because the library (libopenvdb-dev, libnanovdb-dev) was not there when it was made", j->export.path, endings[f]);
    cli_scene s;
    fmt_output *o = NULL;
    SVO_TRY(fmt_output_open(j->export.path, j->c->force, &o, err));
    svo_result r = cli_scene_open(j->c, j->path, j->data, j->size, j->allocator, NULL, &s, err);
    if (r == SVO_OK) {
        if (strcmp(s.kind, "svscene") == 0) r = export_scene(j, s.scene, f, o, err);
        else if (s.scene->asset_count == 0) r = svo_fail(err, SVO_RUNTIME, "the file has no octree");
        else r = export_view(j, s.scene->assets[0], f, o, err);
        cli_scene_close(&s);
    }
    if (r == SVO_OK) return fmt_output_commit(o, err);
    fmt_output_discard(o);
    return r;
}
