/* Parts of svo-dump: a file is read into a JSON object, which is printed as it is or as text. */
#ifndef DUMP_H
#define DUMP_H

#include "cli.h"
#include "fmt_container.h"
#include "svo_math.h"
#include "svo_stream.h"
#include "svo_view.h"

/* What --export was asked for. */
typedef struct dump_export {
    const char *path; /* NULL: nothing */
    bool rgba, has_level, has_low, has_high, has_draco, instancing, rest;
    uint64_t level, limit, draco; /* draco: bits, 0 = fewest that do */
    double low[3], high[3];
} dump_export;

/* What is to be done with one file. */
typedef struct dump_job {
    cli *c;
    const char *path;   /* as given, "-" is stdin */
    const uint8_t *data; /* 64-byte aligned */
    uint64_t size;
    const svo_allocator *allocator;
    bool quick;         /* hashes only; nothing that needs decoding */
    const char *voxels; /* PLY to write, or NULL */
    uint64_t limit;     /* voxels that --voxels may write */
    dump_export export;
    bool has_tree, histogram;
    uint64_t tree; /* the last level to list */
    const char *html;   /* page to write, or NULL */
    uint64_t html_size; /* its bytes at most */
    const char *source; /* .svo to hold a .svdag against, or NULL */
    json_t *json;       /* filled by the functions below */
} dump_job;

svo_result dump_svo(dump_job *j, svo_error *err);
svo_result dump_svdag(dump_job *j, svo_error *err);
/* Hold a packed octree against the .svo j->source: voxels, attributes, and the bounds that its provenance promises; "source" of j->json says what was found. SVO_INVALID_DATA
 * where something does not hold. Memory: the source packed without loss. */
svo_result dump_against_source(dump_job *j, const svo_view *v, const char *provenance, svo_error *err);
svo_result dump_scene(dump_job *j, svo_error *err);
svo_result dump_skel(dump_job *j, svo_error *err);

/* --- dump_validate.c --- */
/* What is wrong with the file, after a run over it ended with `first` and *err (SVO_OK: an empty list): objects with id, message, chunk, offset. All damaged chunks,
 * all subtrees of a .svo that break rules (of each the first), and in the other kinds all violations that do not hang on another; at most 1000. New reference. */
json_t *dump_violations(dump_job *j, svo_result first, const svo_error *err, uint64_t *suppressed);
/* What can still be read of a damaged file, and where the damage is. New reference. */
json_t *dump_partial(dump_job *j, svo_result first, const svo_error *err);
const char *dump_kind_text(uint32_t kind);

/* Add the nodes down to a level, and histograms, to j->json. A .svo is packed in memory. */
svo_result dump_inside(dump_job *j, svo_error *err);
/* Write j->export.path. */
svo_result dump_export_file(dump_job *j, svo_error *err);
/* Write j->html: a page that draws the file. j->json is already filled, and shown on it. */
svo_result dump_html(dump_job *j, svo_error *err);

/* --- shared by the kinds (dump_common.c) --- */

/* file, format, version, bytes, content hash. */
void dump_container(dump_job *j, const fmt_container *c);
/* Bytes by type of chunk; they sum to those of the file. */
void dump_sections(dump_job *j, const fmt_container *c);
/* depth, voxel_to_world, voxel_size, grid bounds, surface, fill. */
void dump_grid(json_t *o, uint32_t depth, const double voxel_to_world[16], svo_surface surface, svo_fill fill);
/* levels, nodes, voxels and what they cost of `bytes`. */
void dump_counts(json_t *o, uint32_t depth, const uint64_t *nodes, uint64_t bytes);
/* Bounds of voxels low..high (inclusive) in the grid and the world; any false: null. */
void dump_bounds(json_t *o, bool any, const uint32_t low[3], const uint32_t high[3], const double voxel_to_world[16]);
/* Name, kind, constant (and its value) of a channel. New reference. */
json_t *dump_channel(const svo_channel *c);
/* A value as people read it: [r,g,b], [x,y,z] or a number. New reference. */
json_t *dump_value(svo_channel_kind kind, const uint8_t *value);
/* attributes of a packed octree; `c` (may be NULL) is its file, for the bytes of each channel. New reference. */
json_t *dump_view_channels(const svo_view *v, const fmt_container *c);
typedef struct dump_ply dump_ply;
/* Feed all finest voxels of a packed octree to a point cloud. use[i] is the view's channel that column i takes. */
svo_result dump_view_voxels(const svo_view *v, const uint32_t *use, uint32_t columns, dump_ply *p, svo_error *err);
void dump_provenance(json_t *o, const char *text);
json_t *dump_reals(const double *v, size_t n);

/* --- text (dump_text.c): prints j->json to stdout --- */
void dump_print(const dump_job *j);
/* One line of the table of many files; json NULL: its heading. */
void dump_print_row(const json_t *json);

/* --- point clouds (dump_ply.c) --- */
/* A binary PLY of exactly `count` voxels: vx vy vz, world centre x y z, the channels, and `instance` if asked for. */
svo_result dump_ply_begin(const dump_job *j, uint64_t count, const svo_channel *channels, uint32_t channel_count, bool instances,
                          dump_ply **out, svo_error *err);
/* The map of the rows that follow from the grid to the world, and of their normals (NULL: as they are); both borrowed. */
void dump_ply_place(dump_ply *p, const double voxel_to_world[16], const svo_mat4 *normals, uint32_t instance);
/* values[i]: the voxel's value of channel i (of constant channels ignored, may be NULL). */
svo_result dump_ply_voxel(dump_ply *p, uint32_t x, uint32_t y, uint32_t z, const uint8_t *const *values, svo_error *err);
svo_result dump_ply_end(dump_ply *p, svo_error *err);
void dump_ply_discard(dump_ply *p);

#endif
