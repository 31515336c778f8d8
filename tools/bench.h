/* svo-bench: what its parts share. One row for each model and value of the swept parameter. */
#ifndef BENCH_H
#define BENCH_H

#include "cli.h"
#include "fmt_file.h"
#include "svo_mesh.h"
#include "svo_stream.h"

typedef enum bench_sweep { SWEEP_DEPTH, SWEEP_COLOR, SWEEP_NORMAL, SWEEP_OMEGA, SWEEP_METHOD } bench_sweep;

enum { BENCH_MAX_VALUES = 64, BENCH_MAX_REPEAT = 1000 };

/* What is measured. Names, units and meanings are in bench_columns. */
typedef enum bench_column {
    COL_TRIANGLES, COL_IMPORT_WALL, COL_DEPTH, COL_VOXELS, COL_NODES, COL_VOXELIZE_WALL, COL_VOXELIZE_CPU, COL_COMPRESS_WALL,
    COL_COMPRESS_CPU, COL_TOTAL_WALL, COL_TOTAL_CPU, COL_SVO_BYTES, COL_SVDAG_BYTES, COL_SVO_PER_VOXEL, COL_SVDAG_PER_VOXEL,
    COL_GEOMETRY_BYTES, COL_ATTRIBUTE_BYTES, COL_CHANNEL_BYTES, COL_CHANNEL_PER_VOXEL, COL_DISTINCT_IN, COL_DISTINCT_OUT,
    COL_VOXEL_SIZE, COL_MEAN_VOXELS, COL_MAX_VOXELS, COL_BOUND_VOXELS, COL_MEAN_WORLD, COL_MAX_WORLD, COL_BOUND_WORLD,
    COL_MEAN_PERCENT, COL_MAX_PERCENT, COL_SAMPLES, COL_SURFACE_VOXEL_MEAN, COL_SURFACE_VOXEL_MAX, COL_SURFACE_POINTS,
    COL_COLOR_MEAN, COL_COLOR_MAX, COL_NORMAL_MEAN, COL_NORMAL_MAX, COL_REFERENCE_VOXELS, COL_SNAP_MEAN, COL_SNAP_MAX, COL_DELTA_E_MEAN, COL_DELTA_E_MAX,
    COL_DEGREES_MEAN, COL_DEGREES_MAX, COL_SKELETON_WALL, COL_SKELETON_CPU, COL_CONVERGED, COL_ITERATIONS, COL_VERTICES,
    COL_JOINTS, COL_BONES, COL_COMPONENTS, COL_ENDS, COL_BRANCHES, COL_LOOPS, COL_THINNESS, COL_SURFACE_MEAN, COL_SURFACE_MAX,
    COL_RECONSTRUCTION_MEAN, COL_RECONSTRUCTION_MAX, COL_INSIDE, COL_OFF_CENTRE, COL_BALLS_MEAN, COL_BALLS_MAX, COL_LITERAL_MEAN, COL_LITERAL_MAX, COL_SKEL_BYTES, COL_VOXELIZE_PEAK, COL_COMPRESS_PEAK, COL_SKELETON_PEAK,
    COL_PEAK_RSS,
    COL_COUNT
} bench_column;

typedef struct bench_column_info {
    const char *name;   /* in CSV and JSON, ends with the unit where there is one */
    const char *brief;  /* heading of the printed table; NULL = not printed */
    const char *unit;   /* "" = a count */
    const char *meaning;
    uint32_t sweeps;    /* bit 1 << bench_sweep: where it applies */
    bool integer;
} bench_column_info;
extern const bench_column_info bench_columns[COL_COUNT];

/* The pair that a sweep is about, for the plot and the Pareto front. */
typedef struct bench_axes {
    bench_column seconds, bytes, error, error_max;
    const char *error_title, *work_title, *bytes_title, *max_note;
} bench_axes;
extern const char *const bench_sweep_names[];

typedef enum bench_value_kind { VALUE_NUMBER, VALUE_BOUND, VALUE_LOSSLESS, VALUE_METHOD } bench_value_kind;
typedef struct bench_value {
    bench_value_kind kind;
    double number; /* METHOD: omega */
    int method, search, place; /* METHOD: as in skel_options */
    bool by_delta;             /* METHOD: ends by the thesis' delta */
    char label[48];
} bench_value;

typedef struct bench_model {
    char *path;
    const char *name; /* the shortest end of path that no other model shares; UTF-8, so it may lie in `owned` */
    char *owned;
} bench_model;

typedef struct bench_row {
    svo_result result;
    char error[240];        /* why there are no figures */
    double value[COL_COUNT]; /* NAN where not measured */
    bool front_seconds, front_bytes; /* no other row of the model is better in one and not worse in the other */
} bench_row;

typedef struct bench bench;
struct bench {
    cli *c;
    bench_sweep sweep;
    uint64_t depth, repeat;
    int attributes; /* of the sweep of depth: 0 automatic, 1 none */
    bool cpu;       /* the plot and the front take user time in place of wall time */
    uint32_t value_count;
    bench_value values[BENCH_MAX_VALUES];
    uint32_t model_count;
    bench_model *models;
    bench_row *rows; /* model_count * value_count, model by model */
    char *command;   /* as given, UTF-8 */
    void (*save)(bench *b, void *user); /* called after each point */
    void *save_user;
    bool save_failed;
};

bench_axes bench_axes_of(const bench *b);

static inline bench_row *bench_row_at(const bench *b, uint32_t model, uint32_t value)
{
    return &b->rows[(uint64_t)model * b->value_count + value];
}

/* Wall time and user CPU time (of all threads) of repeated runs. */
typedef struct bench_watch {
    double wall_start, cpu_start;
    uint32_t count;
    double wall[BENCH_MAX_REPEAT], cpu[BENCH_MAX_REPEAT];
} bench_watch;
void bench_watch_start(bench_watch *w);
void bench_watch_stop(bench_watch *w);
double bench_median(double *v, uint32_t n);

/* The sweeps of skeletons: one point of one model, charged to `memory`. What the literal iteration makes of it at the point's omega and place is kept for
 * the points that follow; free it when the model is done. */
typedef struct bench_literals bench_literals;
svo_result bench_skeleton(bench *b, const svo_mesh *mesh, const svo_allocator *memory, const bench_value *value, bench_watch *watch, bench_literals **literals, double *v, svo_error *err);
void bench_literals_free(bench_literals *l);
/* "fast+grid@0.025": words in any order, then omega. */
bool bench_parse_method(const char *item, bench_value *out);

/* Measure all values of one model into its rows; a failure is noted in the rows it concerns. */
void bench_measure(bench *b, uint32_t model);
/* Distance of points of the mesh's surface (a fixed choice, evenly spread over its area) from the nearest voxel centre of the .svo, in voxels: at least
 * 1.5 where no voxel touches the point's own. Reads the .svo once. *count 0: the mesh has no area. */
typedef struct bench_surface { uint64_t count; double mean, max; } bench_surface;
svo_result bench_surface_distances(const svo_mesh *mesh, const svo_buffer *svo, const svo_tree_info *info, const svo_allocator *a, bench_surface *out, svo_error *err);

/* Mark the Pareto fronts of every model among the rows that are measured. */
void bench_mark_fronts(bench *b);

/* "6..10,12", "4..14:2", "deltaE=1,lossless"; NULL = the sweep's default. False with the reason in why. */
bool bench_parse_values(bench_sweep sweep, const char *text, bench_value out[BENCH_MAX_VALUES], uint32_t *count, char why[300]);

/* Text in memory; after a failure to allocate nothing is added and `failed` stays set. */
typedef struct bench_text {
    svo_buffer bytes;
    bool failed;
} bench_text;
void bench_text_add(bench_text *t, const char *format, ...) SVO_PRINTF(2, 3);
/* With & < > " ' escaped and characters that XML 1.0 does not allow replaced. `text` is UTF-8. */
void bench_text_xml(bench_text *t, const char *text);

void bench_write_csv(const bench *b, bench_text *out);
void bench_write_svg(const bench *b, bench_text *out);
/* One page with all of it, which needs nothing else. */
void bench_write_html(const bench *b, bench_text *out);
/* Does a column belong to the sweep? A figure as the table shows it, "-" where there is none. */
bool bench_has_column(const bench *b, int column);
void bench_format_cell(const bench_row *row, int column, char out[40]);
void bench_write_table(const bench *b, bench_text *out);
/* New reference. */
json_t *bench_json(const bench *b);
/* "2 processors, 2 threads, gcc 12.2.0": what times depend on; no name of the machine. */
json_t *bench_host(const cli *c);

#endif
