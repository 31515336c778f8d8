/* Voxels in the formats of other programs; what becomes of them is told in formats/fmt_cells.h. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "cells_vdb.h"
#include "cli_scene.h"
#include "dump_cut.h"
#include "dump_export.h"

static const char *const endings[DUMP_FORMATS] = {".ply", ".glb", ".vox", ".nrrd", ".raw", ".vdb", ".nvdb"};

static dump_format format_of(const char *path)
{
    size_t n = strlen(path);
    for (int i = 0; i < DUMP_FORMATS; i++) {
        size_t m = strlen(endings[i]);
        if (n > m && strcasecmp(path + n - m, endings[i]) == 0) return (dump_format)i;
    }
    return DUMP_FORMATS;
}

/* A leaf, which may be many cells; those in the box are taken. */
static svo_result take(void *user, const dump_cut_node *n, svo_error *err)
{
    dump_cells *g = user;
    if (!n->leaf) return SVO_OK;
    if (++g->seen - g->told >= 1 << 16) {
        g->told = g->seen;
        cli_progress(g->c, "gathering voxels", g->total != 0 ? (double)g->seen / (double)g->total : -1);
    }
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

void dump_tell_glb(dump_job *j, json_t *report, uint64_t voxels, const fmt_cells_glb_report *t)
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
    if (r == SVO_OK) dump_tell_glb(j, report, c->count, &told);
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

json_t *dump_export_report(dump_job *j, uint64_t voxels)
{
    json_t *report = json_object();
    json_object_set_new(cli_section(j->c, "output"), "export", report);
    cli_put_u64(report, "voxels", voxels);
    return report;
}

static svo_result write(dump_job *j, dump_format f, const fmt_cells *c, fmt_output *o, svo_error *err)
{
    json_t *report = dump_export_report(j, c->count);
    svo_result r = SVO_OK;
    cli_progress(j->c, "writing", -1);
    if (f == DUMP_PLY) {
        r = write_ply(j, c, o, report, err);
    } else if (f == DUMP_GLB) {
        r = write_glb(j, c, o, report, err);
    } else if (f == DUMP_VOX) {
        fmt_vox_report v;
        r = fmt_cells_vox(c, o, &v, err);
        if (r != SVO_OK) return r;
        cli_put_u64(report, "models", v.models);
        cli_put_u64(report, "colors", v.colors);
        cli_put_f64(report, "delta_e_mean", v.delta_mean);
        cli_put_f64(report, "delta_e_max", v.delta_max);
        cli_info(j->c, "%s: %llu voxels in %llu models; %llu colours to at most 255: mean %.3f, max %.3f delta E (CIE94)", j->export.path,
                 (unsigned long long)c->count, (unsigned long long)v.models, (unsigned long long)v.colors, v.delta_mean, v.delta_max);
    } else if (f == DUMP_NRRD || f == DUMP_RAW) {
        r = fmt_cells_dense(c, j->export.rgba, f == DUMP_NRRD, o, err);
        json_object_set_new(report, "size", json_pack("[I,I,I]", (json_int_t)c->high[0] - c->low[0] + 1, (json_int_t)c->high[1] - c->low[1] + 1, (json_int_t)c->high[2] - c->low[2] + 1));
        if (r == SVO_OK) cli_info(j->c, "%s: %u x %u x %u cells, x fastest", j->export.path, c->high[0] - c->low[0] + 1, c->high[1] - c->low[1] + 1, c->high[2] - c->low[2] + 1);
    } else {
        r = f == DUMP_VDB ? fmt_cells_vdb(c, o, err) : fmt_cells_nvdb(c, o, err);
    }
    return r;
}

/* The whole numbers of --low and --high. */
static svo_result read_box(const dump_export *ask, uint32_t side, dump_cells *g, svo_error *err)
{
    for (int k = 0; k < 3; k++) {
        double low = ask->has_low ? ask->low[k] : 0, high = ask->has_high ? ask->high[k] : side - 1.0;
        if (!(low >= 0 && high < side && low <= high && low == floor(low) && high == floor(high)))
            return svo_fail(err, SVO_INVALID_ARGUMENT, "--low and --high are whole cells of the exported level, 0 to %u, both inclusive", side - 1);
        g->low[k] = (uint32_t)low, g->high[k] = (uint32_t)high;
    }
    return SVO_OK;
}

svo_result dump_gather(dump_job *j, const svo_view *v, uint32_t depth, dump_cells *g, fmt_cells *c, svo_error *err)
{
    const dump_export *ask = &j->export;
    *g = (dump_cells){.ask = ask, .c = j->c, .total = v->nodes[depth], .level = v->tree_depth - (v->depth - depth), .color = svo_view_find_channel(v, "color")};
    if (g->color != SVO_MAX_CHANNELS && v->channels[g->color].channel.kind != SVO_KIND_COLOR_SRGB8) g->color = SVO_MAX_CHANNELS;
    svo_buffer_init(&g->list, j->allocator);
    SVO_TRY(read_box(ask, 1u << depth, g, err));
    SVO_TRY(dump_cut(v, g->level, take, g, err));
    *c = (fmt_cells){.cell = (const fmt_cell *)(const void *)g->list.data, .count = g->list.size / sizeof(fmt_cell), .colored = g->color != SVO_MAX_CHANNELS, .allocator = j->allocator};
    for (int i = 0; i < 16; i++) c->to_world[i] = v->voxel_to_world[i] * (i % 4 < 3 && i < 12 ? ldexp(1, (int)(v->depth - depth)) : 1);
    return SVO_OK;
}

static svo_result export_view(dump_job *j, const svo_view *v, dump_format f, fmt_output *o, svo_error *err)
{
    const dump_export *ask = &j->export;
    uint32_t depth = ask->has_level ? (uint32_t)ask->level : v->depth;
    if (depth > v->depth) return svo_fail(err, SVO_INVALID_ARGUMENT, "--level %u: the finest level of this file is %u", depth, v->depth);
    dump_cells g;
    fmt_cells c;
    svo_result r = dump_gather(j, v, depth, &g, &c, err);
    if (r == SVO_OK) {
        bool whole = f == DUMP_NRRD || f == DUMP_RAW ? ask->has_low || ask->has_high || !g.any : !g.any; /* dense: the box that was asked for, else that of the voxels */
        for (int k = 0; k < 3; k++) c.low[k] = whole ? g.low[k] : g.box_low[k], c.high[k] = whole ? g.high[k] : g.box_high[k];
        r = write(j, f, &c, o, err);
    }
    svo_buffer_free(&g.list);
    return r;
}

svo_result dump_export_file(dump_job *j, svo_error *err)
{
    dump_format f = format_of(j->export.path);
    if (f == DUMP_FORMATS) return svo_fail(err, SVO_INVALID_ARGUMENT, "%s: --export writes .ply (mesh), .glb, .vox, .nrrd, .raw, .vdb or .nvdb", j->export.path);
    if (f != DUMP_GLB && j->export.instancing) return svo_fail(err, SVO_INVALID_ARGUMENT, "--instancing is for .glb files");
    if (f != DUMP_GLB && f != DUMP_PLY && j->export.rest) return svo_fail(err, SVO_INVALID_ARGUMENT, "--rest is for scenes, as .glb or .ply");
    if (f != DUMP_GLB && j->export.has_draco) return svo_fail(err, SVO_INVALID_ARGUMENT, "--draco is for .glb files");
    if ((f == DUMP_VDB && !fmt_have_vdb()) || (f == DUMP_NVDB && !fmt_have_nvdb()))
        return svo_fail(err, SVO_NOT_BUILT, "%s: this build cannot write %s files, because the library (libopenvdb-dev, libnanovdb-dev) was not there when it was made", j->export.path, endings[f]);
    cli_scene s;
    fmt_output *o = NULL;
    SVO_TRY(fmt_output_open(j->export.path, j->c->force, &o, err));
    svo_result r = cli_scene_open(j->c, j->path, j->data, j->size, j->allocator, NULL, &s, err);
    if (r == SVO_OK) {
        if (strcmp(s.kind, "svscene") == 0) r = dump_export_scene(j, s.scene, f, endings[f], o, err);
        else if (s.scene->asset_count == 0) r = svo_fail(err, SVO_RUNTIME, "the file has no octree");
        else r = export_view(j, s.scene->assets[0], f, o, err);
        cli_scene_close(&s);
    }
    if (r == SVO_OK) return fmt_output_commit(o, err);
    fmt_output_discard(o);
    return r;
}
