/* svo-bench: the columns, and rows as CSV, JSON and a printed table. */
#define _GNU_SOURCE
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bench.h"
#include "svo_task.h"

enum { D = 1 << SWEEP_DEPTH, C = 1 << SWEEP_COLOR, N = 1 << SWEEP_NORMAL, O = 1 << SWEEP_OMEGA, M = 1 << SWEEP_METHOD, S = O | M, V = D | C | N };

const char *const bench_sweep_names[] = {"depth", "color", "normal", "omega", "method", NULL};

/* In the order of the enumeration. */
const bench_column_info bench_columns[COL_COUNT] = {
    [COL_TRIANGLES] = {"triangles", NULL, "", "triangles as placed by instances", V | S, true},
    [COL_IMPORT_WALL] = {"import_wall_s", NULL, "s", "reading the mesh and its textures, once", V | S, false},
    [COL_DEPTH] = {"grid_depth", NULL, "", "levels below the root", C | N, true},
    [COL_VOXELS] = {"voxels", "voxels", "", "finest voxels", V, true},
    [COL_NODES] = {"nodes", NULL, "", "nodes of all levels, finest voxels included", V, true},
    [COL_VOXELIZE_WALL] = {"voxelize_wall_s", "voxelize s", "s", "mesh to .svo in memory, median of the repeats", V, false},
    [COL_VOXELIZE_CPU] = {"voxelize_cpu_s", NULL, "s", "the same, user time of all threads", V, false},
    [COL_COMPRESS_WALL] = {"compress_wall_s", "compress s", "s", ".svo in memory to .svdag, median of the repeats", V, false},
    [COL_COMPRESS_CPU] = {"compress_cpu_s", NULL, "s", "the same, user time of all threads", V, false},
    [COL_TOTAL_WALL] = {"total_wall_s", NULL, "s", "voxelize_wall_s + compress_wall_s", V, false},
    [COL_TOTAL_CPU] = {"total_cpu_s", NULL, "s", "voxelize_cpu_s + compress_cpu_s", V, false},
    [COL_SVO_BYTES] = {"svo_bytes", ".svo", "B", "size of the .svo without provenance", V, true},
    [COL_SVDAG_BYTES] = {"svdag_bytes", ".svdag", "B", "size of the .svdag without provenance", V, true},
    [COL_SVO_PER_VOXEL] = {"svo_bytes_per_voxel", NULL, "B", "svo_bytes / voxels", V, false},
    [COL_SVDAG_PER_VOXEL] = {"svdag_bytes_per_voxel", "B/voxel", "B", "svdag_bytes / voxels", V, false},
    [COL_GEOMETRY_BYTES] = {"geometry_bytes", NULL, "B", "of svdag_bytes, nodes", V, true},
    [COL_ATTRIBUTE_BYTES] = {"attribute_bytes", NULL, "B", "of svdag_bytes, attributes", V, true},
    [COL_CHANNEL_BYTES] = {"channel_bytes", "channel B", "B", "of svdag_bytes, the channel that is swept", C | N, true},
    [COL_CHANNEL_PER_VOXEL] = {"channel_bytes_per_voxel", "channel B/voxel", "B", "channel_bytes / voxels", C | N, false},
    [COL_DISTINCT_IN] = {"distinct_in", NULL, "", "different values before", C | N, true},
    [COL_DISTINCT_OUT] = {"distinct_out", "distinct", "", "different values that are left", C | N, true},
    [COL_VOXEL_SIZE] = {"voxel_size_world", NULL, "mesh unit", "edge of a voxel", V, false},
    [COL_MEAN_VOXELS] = {"distance_mean_voxels", "mean voxels", "voxel", "voxel centre to the nearest point of the surface in the voxel, mean over the samples", D, false},
    [COL_MAX_VOXELS] = {"distance_max_voxels", "max voxels", "voxel", "the same, largest", D, false},
    [COL_BOUND_VOXELS] = {"distance_bound_voxels", NULL, "voxel", "half a voxel's diagonal, which the distance cannot exceed", D, false},
    [COL_MEAN_WORLD] = {"distance_mean_world", "mean world", "mesh unit", "distance_mean_voxels in the mesh's units", D, false},
    [COL_MAX_WORLD] = {"distance_max_world", NULL, "mesh unit", "distance_max_voxels in the mesh's units", D, false},
    [COL_BOUND_WORLD] = {"distance_bound_world", NULL, "mesh unit", "distance_bound_voxels in the mesh's units", D, false},
    [COL_MEAN_PERCENT] = {"distance_mean_percent", NULL, "percent", "distance_mean_voxels in percent of the grid's edge (the model's longest side)", D, false},
    [COL_MAX_PERCENT] = {"distance_max_percent", NULL, "percent", "distance_max_voxels in percent of the grid's edge", D, false},
    [COL_SAMPLES] = {"distance_samples", "samples", "", "voxels whose distance was measured: a fixed sample", D, true},
    [COL_SURFACE_VOXEL_MEAN] = {"surface_to_voxel_mean_voxels", NULL, "voxel", "point of the surface to the nearest voxel's centre, mean over the points", D, false},
    [COL_SURFACE_VOXEL_MAX] = {"surface_to_voxel_max_voxels", "surface max", "voxel", "the same, largest; at most distance_bound_voxels and the snap, but where alpha removed voxels", D, false},
    [COL_SURFACE_POINTS] = {"surface_points", NULL, "", "points of the surface: a fixed choice, evenly spread over the area", D, true},
    [COL_COLOR_MEAN] = {"color_error_mean", "dE mean", "CIE94", "colours of voxels against 4096 samples of the surface in each, mean", D, false},
    [COL_COLOR_MAX] = {"color_error_max", NULL, "CIE94", "the same, largest", D, false},
    [COL_NORMAL_MEAN] = {"normal_error_mean", "deg mean", "degree", "normals of voxels against 4096 samples of the surface in each, mean", D, false},
    [COL_NORMAL_MAX] = {"normal_error_max", NULL, "degree", "the same, largest", D, false},
    [COL_REFERENCE_VOXELS] = {"reference_voxels", NULL, "", "voxels whose attributes were compared: a fixed sample", D, true},
    [COL_SNAP_MEAN] = {"snap_mean_voxels", NULL, "voxel", "distance that vertices moved to the voxelizer's lattice, mean", D, false},
    [COL_SNAP_MAX] = {"snap_max_voxels", "snap max", "voxel", "the same, largest", D, false},
    [COL_DELTA_E_MEAN] = {"delta_e_mean", "dE mean", "CIE94", "colour difference over all attributes, inner nodes included, mean", C, false},
    [COL_DELTA_E_MAX] = {"delta_e_max", "dE max", "CIE94", "the same, largest", C, false},
    [COL_DEGREES_MEAN] = {"degrees_mean", "deg mean", "degree", "angle over all attributes, inner nodes included, mean", N, false},
    [COL_DEGREES_MAX] = {"degrees_max", "deg max", "degree", "the same, largest", N, false},
    [COL_SKELETON_WALL] = {"skeleton_wall_s", "skeleton s", "s", "mesh to skeleton, median of the repeats", S, false},
    [COL_SKELETON_CPU] = {"skeleton_cpu_s", NULL, "s", "the same, user time of all threads", S, false},
    [COL_CONVERGED] = {"converged", "converged", "", "1 if the contraction came to rest", S, true},
    [COL_ITERATIONS] = {"iterations", "sweeps", "", "sweeps of the contraction", S, true},
    [COL_VERTICES] = {"tessellated_vertices", NULL, "", "vertices with edges cut to omega", S, true},
    [COL_JOINTS] = {"joints", "joints", "", "joints", S, true},
    [COL_BONES] = {"bones", NULL, "", "bones", S, true},
    [COL_COMPONENTS] = {"components", "parts", "", "connected parts of the curve", S, true},
    [COL_ENDS] = {"ends", "ends", "", "joints with one bone", S, true},
    [COL_BRANCHES] = {"branches", NULL, "", "joints with three bones and more", S, true},
    [COL_LOOPS] = {"loops", "loops", "", "independent cycles", S, true},
    [COL_THINNESS] = {"thinness_percent", "thinness %", "percent", "area left after the contraction (thesis, equation 5.7.1)", S, false},
    [COL_SURFACE_MEAN] = {"surface_distance_mean_percent", NULL, "percent", "surface to the bones of its joint, of the bounding box's diagonal, mean", S, false},
    [COL_SURFACE_MAX] = {"surface_distance_max_percent", NULL, "percent", "the same, largest", S, false},
    [COL_RECONSTRUCTION_MEAN] = {"reconstruction_mean_percent", "error mean %", "percent", "that distance less the bone's radius there, absolute, mean", S, false},
    [COL_RECONSTRUCTION_MAX] = {"reconstruction_max_percent", "error max %", "percent", "the same, largest", S, false},
    [COL_INSIDE] = {"length_inside_percent", "inside %", "percent", "of the curve's length inside the solid", M, false},
    [COL_OFF_CENTRE] = {"off_centre_median", "off centre", "", "0 in the middle of the section across the curve, about 1 at the surface; median", M, false},
    [COL_BALLS_MEAN] = {"inscribed_balls_mean_percent", "balls %", "percent", "surface to the inscribed balls of the curve, of the diagonal, mean", M, false},
    [COL_BALLS_MAX] = {"inscribed_balls_max_percent", NULL, "percent", "the same, largest", M, false},
    [COL_LITERAL_MEAN] = {"literal_distance_mean_omegas", "from literal", "omega", "curve to that of the literal iteration at the same omega and place, the larger mean of both ways", M, false},
    [COL_LITERAL_MAX] = {"literal_hausdorff_percent", NULL, "percent", "the same, largest, of the model's unit", M, false},
    [COL_SKEL_BYTES] = {"skel_bytes", ".skel", "B", "size of the .skel, map included, without provenance", S, true},
    [COL_VOXELIZE_PEAK] = {"voxelize_peak_bytes", "peak B", "B", "most memory charged while voxelizing and writing, besides mesh and .svo", V, true},
    [COL_COMPRESS_PEAK] = {"compress_peak_bytes", NULL, "B", "most memory charged while compressing, besides mesh and .svo", V, true},
    [COL_PEAK_RSS] = {"peak_rss_bytes", NULL, "B", "most memory resident while the point was measured, mesh and .svo included; empty where the system does not tell", V | S, true},
    [COL_SKELETON_PEAK] = {"skeleton_peak_bytes", "peak B", "B", "most memory charged while building the skeleton, besides the mesh", S, true},
};

bench_axes bench_axes_of(const bench *b)
{
    static const bench_axes axes[] = {
        {COL_TOTAL_WALL, COL_SVDAG_BYTES, COL_MEAN_PERCENT, COL_MAX_PERCENT, "voxel centre to surface, mean, % of the longest side", "voxelize + compress",
         "bytes of the .svdag", "largest distance"},
        {COL_COMPRESS_WALL, COL_CHANNEL_BYTES, COL_DELTA_E_MEAN, COL_DELTA_E_MAX, "colour difference, mean, CIE94", "compress", "bytes of the colours",
         "largest difference"},
        {COL_COMPRESS_WALL, COL_CHANNEL_BYTES, COL_DEGREES_MEAN, COL_DEGREES_MAX, "angle of normals, mean, degrees", "compress", "bytes of the normals",
         "largest angle"},
        {COL_SKELETON_WALL, COL_SKEL_BYTES, COL_RECONSTRUCTION_MEAN, COL_RECONSTRUCTION_MAX, "reconstruction error, mean, % of the diagonal", "skeleton",
         "bytes of the .skel", "largest error"},
        {COL_SKELETON_WALL, COL_SKELETON_PEAK, COL_BALLS_MEAN, COL_BALLS_MAX, "surface to inscribed balls, mean, % of the diagonal", "skeleton",
         "most memory, bytes", "largest distance"}};
    static const bench_column cpu[] = {COL_TOTAL_CPU, COL_COMPRESS_CPU, COL_COMPRESS_CPU, COL_SKELETON_CPU, COL_SKELETON_CPU};
    bench_axes a = axes[b->sweep];
    if (b->cpu) a.seconds = cpu[b->sweep];
    return a;
}

void bench_text_add(bench_text *t, const char *format, ...)
{
    va_list args;
    char *line = NULL;
    va_start(args, format);
    int n = vasprintf(&line, format, args);
    va_end(args);
    if (n < 0 || t->failed || (n > 0 && svo_buffer_append(&t->bytes, line, (size_t)n) == NULL)) t->failed = true;
    if (n >= 0) free(line);
}

bool bench_has_column(const bench *b, int i) { return (bench_columns[i].sweeps >> b->sweep & 1) != 0; }

/* --- CSV ---------------------------------------------------------------------------------------------------------- */

/* RFC 4180, but lines end in \n. */
static void csv_field(bench_text *out, const char *text)
{
    if (strpbrk(text, ",\"\r\n") == NULL) {
        bench_text_add(out, "%s", text);
        return;
    }
    bench_text_add(out, "\"");
    for (const char *p = text; *p != 0; p++) bench_text_add(out, *p == '"' ? "\"\"" : "%c", *p);
    bench_text_add(out, "\"");
}

void bench_write_csv(const bench *b, bench_text *out)
{
    bench_text_add(out, "model,%s", bench_sweep_names[b->sweep]);
    for (int i = 0; i < COL_COUNT; i++)
        if (bench_has_column(b, i)) bench_text_add(out, ",%s", bench_columns[i].name);
    bench_text_add(out, ",pareto_seconds,pareto_bytes,error\n");
    for (uint32_t m = 0; m < b->model_count; m++) {
        for (uint32_t v = 0; v < b->value_count; v++) {
            const bench_row *row = bench_row_at(b, m, v);
            csv_field(out, b->models[m].name);
            bench_text_add(out, ",%s", b->values[v].label);
            for (int i = 0; i < COL_COUNT; i++) {
                if (!bench_has_column(b, i)) continue;
                bench_text_add(out, ",");
                if (isfinite(row->value[i])) bench_text_add(out, bench_columns[i].integer ? "%.0f" : "%.9g", row->value[i]);
            }
            if (row->result == SVO_OK) bench_text_add(out, ",%d,%d,", row->front_seconds, row->front_bytes);
            else bench_text_add(out, ",,,");
            csv_field(out, row->error);
            bench_text_add(out, "\n");
        }
    }
}

/* --- JSON --------------------------------------------------------------------------------------------------------- */

/* The processor's own name, as the system tells it; "" where it does not. */
static void processor_name(char *out, size_t size)
{
    out[0] = 0;
    FILE *f = fopen("/proc/cpuinfo", "r");
    char line[256];
    while (f != NULL && out[0] == 0 && fgets(line, sizeof line, f) != NULL) {
        char *colon = strchr(line, ':');
        if (strncmp(line, "model name", 10) != 0 || colon == NULL) continue;
        colon[strcspn(colon, "\n")] = 0;
        snprintf(out, size, "%s", colon + 1 + (colon[1] == ' '));
    }
    if (f != NULL) fclose(f);
}

json_t *bench_host(const cli *c)
{
    json_t *host = json_object();
    char cpu[200];
    processor_name(cpu, sizeof cpu);
    cli_put_u64(host, "processors", svo_processor_count());
    cli_put_u64(host, "threads", c->threads != 0 ? c->threads : svo_processor_count());
    cli_put_text(host, "processor", cpu[0] != 0 ? cpu : NULL);
#if defined(__clang__)
    cli_put_text(host, "compiler", "clang " __clang_version__);
#else
    cli_put_text(host, "compiler", "gcc " __VERSION__);
#endif
#if defined(NDEBUG)
    cli_put_text(host, "assertions", "off");
#else
    cli_put_text(host, "assertions", "on");
#endif
    return host;
}

static json_t *json_columns(const bench *b)
{
    json_t *all = json_array();
    for (int i = 0; i < COL_COUNT; i++) {
        if (!bench_has_column(b, i)) continue;
        json_t *o = json_object();
        cli_put_text(o, "name", bench_columns[i].name);
        cli_put_text(o, "unit", bench_columns[i].unit);
        cli_put_text(o, "meaning", bench_columns[i].meaning);
        json_array_append_new(all, o);
    }
    return all;
}

static json_t *json_row(const bench *b, uint32_t m, uint32_t v)
{
    const bench_row *row = bench_row_at(b, m, v);
    json_t *o = json_object();
    cli_put_text(o, "model", b->models[m].name);
    if (b->values[v].kind == VALUE_NUMBER && b->sweep == SWEEP_OMEGA) cli_put_f64(o, "omega", b->values[v].number);
    else if (b->values[v].kind == VALUE_NUMBER) cli_put_u64(o, bench_sweep_names[b->sweep], (uint64_t)b->values[v].number);
    else cli_put_text(o, bench_sweep_names[b->sweep], b->values[v].label);
    cli_put_text(o, "error", row->result != SVO_OK ? row->error : NULL);
    if (row->result != SVO_OK) cli_put_text(o, "error_code", svo_result_name(row->result));
    for (int i = 0; i < COL_COUNT && row->result == SVO_OK; i++) {
        if (!bench_has_column(b, i)) continue;
        if (bench_columns[i].integer && isfinite(row->value[i])) cli_put_u64(o, bench_columns[i].name, (uint64_t)row->value[i]);
        else cli_put_f64(o, bench_columns[i].name, row->value[i]);
    }
    if (row->result == SVO_OK) {
        json_object_set_new(o, "pareto_seconds", json_boolean(row->front_seconds));
        json_object_set_new(o, "pareto_bytes", json_boolean(row->front_bytes));
    }
    return o;
}

json_t *bench_json(const bench *b)
{
    json_t *all = json_object(), *rows = json_array(), *notes = json_array();
    cli_put_text(all, "tool", b->c->tool->name);
    cli_put_text(all, "version", SVO_VERSION_STRING);
    cli_put_text(all, "command", b->command);
    cli_put_text(all, "sweep", bench_sweep_names[b->sweep]);
    cli_put_u64(all, "repeat", b->repeat);
    cli_put_text(all, "clock", b->cpu ? "cpu" : "wall");
    json_object_set_new(all, "host", bench_host(b->c));
    json_object_set_new(all, "columns", json_columns(b));
    for (uint32_t m = 0; m < b->model_count; m++)
        for (uint32_t v = 0; v < b->value_count; v++) json_array_append_new(rows, json_row(b, m, v));
    json_object_set_new(all, "rows", rows);
    json_array_append_new(notes, json_string("seconds are medians; cpu is the user time of all threads"));
    if (b->sweep == SWEEP_DEPTH)
        json_array_append_new(notes, json_string("every point of the snapped surface lies in a voxel, so the distance from the surface to its nearest voxel (not its centre) is 0 by "
                                                 "construction; from the surface as given it is at most snap_max_voxels"));
    json_array_append_new(notes, json_string("pareto_seconds, pareto_bytes: no other row of the same model has less time by the clock chosen (fewer bytes) and no more error, or less error and no more time (bytes)"));
    json_object_set_new(all, "notes", notes);
    return all;
}

/* --- printed table ------------------------------------------------------------------------------------------------ */

void bench_format_cell(const bench_row *row, int column, char out[40])
{
    double x = row->value[column];
    if (!isfinite(x)) snprintf(out, 40, "-");
    else if (bench_columns[column].integer) snprintf(out, 40, "%.0f", x);
    else if (strcmp(bench_columns[column].unit, "s") == 0) snprintf(out, 40, "%.4f", x);
    else snprintf(out, 40, "%.4g", x);
}

static int at_least(int width, size_t length) { return (int)length > width ? (int)length : width; }

void bench_write_table(const bench *b, bench_text *out)
{
    int width[COL_COUNT], model_width = 5, value_width = (int)strlen(bench_sweep_names[b->sweep]);
    char cell[40];
    for (uint32_t m = 0; m < b->model_count; m++) model_width = at_least(model_width, strlen(b->models[m].name));
    for (uint32_t v = 0; v < b->value_count; v++) value_width = at_least(value_width, strlen(b->values[v].label));
    for (int i = 0; i < COL_COUNT; i++) {
        if (!bench_has_column(b, i) || bench_columns[i].brief == NULL) continue;
        width[i] = (int)strlen(bench_columns[i].brief);
        for (uint64_t r = 0; r < (uint64_t)b->model_count * b->value_count; r++) {
            bench_format_cell(&b->rows[r], i, cell);
            width[i] = at_least(width[i], strlen(cell));
        }
    }
    bench_text_add(out, "%-*s  %*s", model_width, "model", value_width, bench_sweep_names[b->sweep]);
    for (int i = 0; i < COL_COUNT; i++)
        if (bench_has_column(b, i) && bench_columns[i].brief != NULL) bench_text_add(out, "  %*s", width[i], bench_columns[i].brief);
    bench_text_add(out, "\n");
    for (uint32_t m = 0; m < b->model_count; m++) {
        for (uint32_t v = 0; v < b->value_count; v++) {
            const bench_row *row = bench_row_at(b, m, v);
            bench_text_add(out, "%-*s  %*s", model_width, b->models[m].name, value_width, b->values[v].label);
            for (int i = 0; i < COL_COUNT && row->result == SVO_OK; i++) {
                if (!bench_has_column(b, i) || bench_columns[i].brief == NULL) continue;
                bench_format_cell(row, i, cell);
                bench_text_add(out, "  %*s", width[i], cell);
            }
            if (row->result != SVO_OK) bench_text_add(out, "  error: %s", row->error);
            bench_text_add(out, "\n");
        }
    }
}
