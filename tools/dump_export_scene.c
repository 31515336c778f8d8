/* Scenes as .glb and .ply: the mesh of each asset once, and once more for each pose that its instances have. */
#include <stdlib.h>
#include <string.h>

#include "dump_export.h"
#include "dump_pose.h"
#include "svo_bones.h"
#include "svo_deform.h"

enum { MOST_NODES = 1 << 18 }; /* of a .glb: its JSON is held in memory, and viewers read it so */

/* An asset under a pose (SVO_NO_POSE: as it is), used by some instance. */
typedef struct shape {
    uint32_t asset, pose;
    double to_mesh[16]; /* from the coordinates of its faces to those of the asset's mesh */
    uint64_t mesh;      /* of the .glb; UINT64_MAX: without faces */
    svo_buffer faces;   /* for .ply: fmt_cell_face, with a pose fmt_bent_face */
} shape;

typedef struct scene_job {
    dump_job *j;
    const svo_scene *s;
    dump_pairs pairs;
    shape *shapes; /* of each pair */
    uint64_t shape_count;
    uint64_t voxels; /* of all shapes */
    bool colored;    /* any of them */
    fmt_cells_glb *glb;
    uint64_t sheared, instanced;
    svo_buffer many; /* many_place: instances that are not nodes of their own */
    svo_buffer placed;
} scene_job;

static svo_result find_shapes(scene_job *k, svo_error *err)
{
    SVO_TRY(dump_pairs_find(k->s, k->j->export.rest, k->j->allocator, &k->pairs, err));
    k->shapes = svo_calloc(k->j->allocator, k->pairs.count, sizeof *k->shapes);
    if (k->shapes == NULL && k->pairs.count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the assets");
    for (k->shape_count = 0; k->shape_count < k->pairs.count; k->shape_count++) {
        const dump_pair *p = &k->pairs.pair[k->shape_count];
        k->shapes[k->shape_count] = (shape){.asset = p->asset, .pose = p->pose, .mesh = UINT64_MAX};
        svo_buffer_init(&k->shapes[k->shape_count].faces, k->j->allocator);
    }
    return SVO_OK;
}

static shape *shape_of(const scene_job *k, uint64_t instance) { return &k->shapes[dump_pairs_index(&k->pairs, k->s, k->j->export.rest, instance)]; }

/* --- poses --- */

typedef struct bending {
    const fmt_cells *cells;
    const svo_bones *bones; /* NULL: none */
    uint32_t level;
    double edge; /* of a cell, in voxels */
    svo_deform map;
} bending;

static bool bent_corner(void *user, uint64_t cell, const uint32_t at[3], double out[3])
{
    static const svo_bone_range resting = {SVO_NO_BONE, 255, 255, {0, 0}};
    const bending *b = user;
    svo_bone_list list = {&resting, 1};
    if (b->bones != NULL) list = svo_bones_at(b->bones, b->level, b->cells->cell[cell].at);
    const svo_vec3 p = svo_deform_blended_point(&b->map, list, svo_v3(at[0] * b->edge, at[1] * b->edge, at[2] * b->edge));
    out[0] = p.x, out[1] = p.y, out[2] = p.z;
    return list.range != NULL; /* cells inside of full leaves are no nodes, and have no list */
}

static bool is_mirrored(const svo_mat4 *m)
{
    const double *a = m->m;
    return a[0] * (a[5] * a[10] - a[6] * a[9]) - a[1] * (a[4] * a[10] - a[6] * a[8]) + a[2] * (a[4] * a[9] - a[5] * a[8]) < 0;
}

/* The faces of an asset under a pose, in the coordinates of its mesh. */
static svo_result bend_faces(scene_job *k, shape *q, const fmt_cells *c, uint32_t depth, const svo_bones *bones, svo_error *err)
{
    const svo_view *v = k->s->assets[q->asset];
    const svo_pose *pose = &k->s->poses.pose[q->pose];
    const svo_mat4 none = svo_mat4_identity();
    svo_mat4 grid;
    memcpy(grid.m, v->voxel_to_world, sizeof grid.m);
    bending b = {.cells = c, .bones = pose->flags & SVO_POSE_BONES ? bones : NULL, .level = depth, .edge = (double)(1u << (v->depth - depth))};
    b.map = svo_deform_make(&k->s->poses, pose, &grid, &none);
    fmt_cells_bend bend = {.corner = bent_corner, .user = &b, .mirrored = is_mirrored(&grid)};
    if (pose->flags & SVO_POSE_MATRIX) {
        const svo_mat4 m = svo_pose_matrix(&k->s->poses, pose->matrix);
        bend.mirrored ^= is_mirrored(&m);
    }
    memcpy(q->to_mesh, none.m, sizeof q->to_mesh);
    return fmt_cells_bent_faces(c, &bend, &q->faces, err);
}

/* --- shapes --- */

static svo_result make_shape(scene_job *k, shape *q, dump_format f, const fmt_cells *c, uint32_t depth, const svo_bones *bones, svo_error *err)
{
    const char *name = k->s->asset_names[q->asset];
    if (c->count > k->j->export.limit - k->voxels)
        return svo_fail(err, SVO_LIMIT, "more than %llu voxels in all assets and poses; raise --limit, export a coarser level (--level) or without poses (--rest)", (unsigned long long)k->j->export.limit);
    k->voxels += c->count;
    k->colored |= c->colored;
    if (q->pose == SVO_NO_POSE) {
        memcpy(q->to_mesh, c->to_world, sizeof q->to_mesh);
        return f == DUMP_GLB ? fmt_cells_glb_mesh(k->glb, c, name, &q->mesh, err) : fmt_cells_faces(c, &q->faces, err);
    }
    SVO_TRY(bend_faces(k, q, c, depth, bones, err));
    if (f != DUMP_GLB) return SVO_OK;
    svo_result r = fmt_cells_glb_bent(k->glb, (const fmt_bent_face *)(const void *)q->faces.data, q->faces.size / sizeof(fmt_bent_face), c->colored, name, &q->mesh, err);
    svo_buffer_free(&q->faces);
    return r;
}

/* All shapes of an asset: they follow each other in the list. */
static svo_result make_asset(scene_job *k, shape *first, uint64_t count, dump_format f, svo_error *err)
{
    const dump_export *ask = &k->j->export;
    const svo_view *v = k->s->assets[first->asset];
    const uint32_t depth = ask->has_level && ask->level < v->depth ? (uint32_t)ask->level : v->depth;
    dump_cells g;
    fmt_cells c;
    svo_bones *bones = NULL;
    bool follows = false;
    for (uint64_t i = 0; i < count; i++) follows |= first[i].pose != SVO_NO_POSE && (k->s->poses.pose[first[i].pose].flags & SVO_POSE_BONES) != 0;
    svo_result r = dump_gather(k->j, v, depth, &g, &c, err);
    if (r == SVO_OK && follows) r = svo_bones_make(v, k->j->c->threads, k->j->allocator, &bones, err);
    for (uint64_t i = 0; i < count && r == SVO_OK; i++) r = make_shape(k, &first[i], f, &c, depth, bones, err);
    svo_bones_free(bones);
    svo_buffer_free(&g.list);
    return r;
}

static svo_result make_shapes(scene_job *k, dump_format f, svo_error *err)
{
    for (uint64_t i = 0, n; i < k->shape_count; i += n) {
        cli_progress(k->j->c, "assets and poses", (double)i / (double)k->shape_count);
        for (n = 0; i + n < k->shape_count && k->shapes[i + n].asset == k->shapes[i].asset; n++) {}
        SVO_TRY(make_asset(k, &k->shapes[i], n, f, err));
    }
    return SVO_OK;
}

/* --- instances --- */

/* From the faces of its shape to the scene. */
static svo_mat4 map_of(const scene_job *k, uint32_t page, uint64_t instance)
{
    svo_mat4 to_mesh;
    memcpy(to_mesh.m, shape_of(k, instance)->to_mesh, sizeof to_mesh.m);
    return svo_mat4_mul(svo_scene_instance_transform(k->s, page, instance), to_mesh);
}

static void node(scene_job *k, uint32_t page, uint64_t i)
{
    const svo_mat4 m = map_of(k, page, i);
    fmt_cells_glb_node(k->glb, shape_of(k, i)->mesh, m.m, svo_scene_instance_name(k->s, i), &k->s->instance_id[i]);
}

typedef struct many_place { uint64_t mesh, instance; uint32_t page; fmt_cells_place place; } many_place;

static svo_result place_node(scene_job *k, uint32_t page, uint64_t i, svo_error *err)
{
    many_place p = {.page = page, .mesh = shape_of(k, i)->mesh, .instance = i};
    const svo_mat4 m = map_of(k, page, i);
    const bool straight = fmt_cells_place_of(m.m, k->s->pages[page].origin, &p.place);
    k->sheared += !straight; /* glTF wants matrices without shear */
    if (straight && k->j->export.instancing && p.mesh != UINT64_MAX)
        return svo_buffer_append(&k->many, &p, sizeof p) != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the instances");
    node(k, page, i);
    return SVO_OK;
}

static int by_page_and_mesh(const void *a, const void *b)
{
    const many_place *p = a, *q = b;
    if (p->page != q->page) return p->page < q->page ? -1 : 1;
    if (p->mesh != q->mesh) return p->mesh < q->mesh ? -1 : 1;
    return p->instance < q->instance ? -1 : p->instance > q->instance;
}

/* A node for each page and mesh; one instance alone keeps its name and number. */
static svo_result place_many(scene_job *k, svo_error *err)
{
    many_place *all = (many_place *)(void *)k->many.data;
    const uint64_t count = k->many.size / sizeof *all;
    fmt_cells_place *run = svo_calloc(k->j->allocator, count, sizeof *run);
    if (run == NULL && count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the instances");
    if (count != 0) qsort(all, count, sizeof *all, by_page_and_mesh);
    for (uint64_t i = 0, n; i < count; i += n) {
        for (n = 0; i + n < count && all[i + n].page == all[i].page && all[i + n].mesh == all[i].mesh; n++) run[n] = all[i + n].place;
        if (n > 1) {
            fmt_cells_glb_places(k->glb, all[i].mesh, k->s->pages[all[i].page].origin, run, n);
            k->instanced += n;
            continue;
        }
        node(k, all[i].page, all[i].instance);
    }
    svo_free(k->j->allocator, run, count, sizeof *run);
    return SVO_OK;
}

static svo_result place_faces(scene_job *k, uint32_t page, uint64_t i, svo_error *err)
{
    const shape *q = shape_of(k, i);
    const svo_mat4 m = map_of(k, page, i);
    fmt_cells_placed p = {.count = q->faces.size / (q->pose == SVO_NO_POSE ? sizeof(fmt_cell_face) : sizeof(fmt_bent_face))};
    if (q->pose == SVO_NO_POSE) p.faces = (const fmt_cell_face *)(const void *)q->faces.data;
    else p.bent = (const fmt_bent_face *)(const void *)q->faces.data;
    memcpy(p.to_world, m.m, sizeof p.to_world);
    return svo_buffer_append(&k->placed, &p, sizeof p) != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the instances");
}

typedef svo_result (*place_fn)(scene_job *k, uint32_t page, uint64_t instance, svo_error *err);
static svo_result each_instance(scene_job *k, place_fn fn, svo_error *err)
{
    for (uint32_t page = 0; page < k->s->page_count; page++)
        for (uint64_t i = k->s->pages[page].first; i < k->s->pages[page].first + k->s->pages[page].count; i++) SVO_TRY(fn(k, page, i, err));
    return SVO_OK;
}

/* --- the file --- */

static svo_result write_scene(scene_job *k, dump_format f, fmt_output *o, svo_error *err)
{
    const svo_scene *s = k->s;
    const bool rest = k->j->export.rest;
    uint64_t posed = 0, meshes = 0;
    for (uint64_t i = 0; i < s->instance_count; i++) posed += svo_scene_instance_pose(s, i) != NULL;
    for (uint64_t i = 0; i < k->shape_count; i++) meshes += k->shapes[i].pose != SVO_NO_POSE;
    if (posed != 0 && rest)
        svo_warn(&k->j->c->warnings, "%.100s: %llu instances have a pose; they are exported as they are without it", k->j->path, (unsigned long long)posed);
    SVO_TRY(make_shapes(k, f, err));
    cli_progress(k->j->c, "writing", -1);
    json_t *report = dump_export_report(k->j, k->voxels);
    cli_put_u64(report, "instances", s->instance_count);
    cli_put_u64(report, "posed", rest ? 0 : posed);
    cli_put_u64(report, "posed_meshes", meshes);
    cli_put_u64(report, "poses_left_out", rest ? posed : 0);
    if (f == DUMP_PLY) {
        SVO_TRY(each_instance(k, place_faces, err));
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
    SVO_TRY(each_instance(k, place_node, err));
    SVO_TRY(place_many(k, err));
    cli_put_u64(report, "instanced", k->instanced);
    SVO_TRY(fmt_cells_glb_end(k->glb, o, &told, err));
    if (k->sheared != 0) svo_warn(&k->j->c->warnings, "%.100s: %llu instances are sheared, which glTF has no words for; their nodes have the matrix all the same, as most viewers take it", k->j->path, (unsigned long long)k->sheared);
    dump_tell_glb(k->j, report, k->voxels, &told);
    return SVO_OK;
}

svo_result dump_export_scene(dump_job *j, const svo_scene *s, dump_format f, const char *ending, fmt_output *o, svo_error *err)
{
    const dump_export *ask = &j->export;
    if (f != DUMP_GLB && f != DUMP_PLY) return svo_fail(err, SVO_UNSUPPORTED, "a scene is exported as .glb or .ply; %s takes one octree: export the assets one by one, or the voxels with --voxels", ending);
    if (ask->has_low || ask->has_high) return svo_fail(err, SVO_INVALID_ARGUMENT, "--low and --high are for one octree, not for scenes");
    if (f == DUMP_GLB && s->instance_count > MOST_NODES && !ask->instancing)
        return svo_fail(err, SVO_LIMIT, "%llu instances are more nodes than a .glb is good for (%d); --instancing makes one of many", (unsigned long long)s->instance_count, MOST_NODES);
    scene_job k = {.j = j, .s = s};
    svo_buffer_init(&k.many, j->allocator);
    svo_buffer_init(&k.placed, j->allocator);
    svo_result r = find_shapes(&k, err);
    if (r == SVO_OK && f == DUMP_GLB) r = fmt_cells_glb_begin(ask->has_draco, (uint32_t)ask->draco, j->allocator, &k.glb, err);
    if (r == SVO_OK) r = write_scene(&k, f, o, err);
    fmt_cells_glb_free(k.glb);
    for (uint64_t i = 0; i < k.shape_count; i++) svo_buffer_free(&k.shapes[i].faces);
    svo_buffer_free(&k.placed);
    svo_buffer_free(&k.many);
    svo_free(j->allocator, k.shapes, k.pairs.count, sizeof *k.shapes);
    dump_pairs_free(&k.pairs);
    return r;
}
