/* Exports of svo-dump: what one octree (dump_export.c) and scenes (dump_export_scene.c) share. */
#ifndef DUMP_EXPORT_H
#define DUMP_EXPORT_H

#include "dump.h"
#include "fmt_cells.h"
#include "svo_scene.h"

typedef enum dump_format { DUMP_PLY, DUMP_GLB, DUMP_VOX, DUMP_NRRD, DUMP_RAW, DUMP_VDB, DUMP_NVDB, DUMP_FORMATS } dump_format;

/* Cells of an octree as they are gathered. */
typedef struct dump_cells {
    const dump_export *ask;
    cli *c;
    uint64_t seen, told, total; /* leaves, for the progress */
    svo_buffer list; /* fmt_cell */
    uint32_t level, color; /* of the tree; channel or SVO_MAX_CHANNELS */
    uint32_t low[3], high[3];
    bool any;
    uint32_t box_low[3], box_high[3]; /* of the cells */
} dump_cells;

/* The cells of an octree at a level, in the box that was asked for. Free g->list, after an error too. */
svo_result dump_gather(dump_job *j, const svo_view *v, uint32_t depth, dump_cells *g, fmt_cells *c, svo_error *err);
/* output.export of the report, with the number of voxels. Borrowed. */
json_t *dump_export_report(dump_job *j, uint64_t voxels);
void dump_tell_glb(dump_job *j, json_t *report, uint64_t voxels, const fmt_cells_glb_report *t);

/* .ply and .glb; others are refused. */
svo_result dump_export_scene(dump_job *j, const svo_scene *s, dump_format f, const char *ending, fmt_output *o, svo_error *err);

#endif
