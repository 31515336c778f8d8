/* bench_voxelize MODEL DEPTH... : voxels a second in memory (no file is written), geometry alone and with attributes, by threads.
 * CPU seconds are of the whole process over the run, so they hold on a busy machine too. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmt_import.h"
#include "svo_voxelize.h"

static svo_result count_encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    (void)worker, (void)err;
    *blob = NULL;
    __atomic_fetch_add((uint64_t *)user, chunk->value_count, __ATOMIC_RELAXED);
    return SVO_OK;
}
static svo_result count_commit(void *user, void *blob, svo_error *err) { return (void)user, (void)blob, (void)err, SVO_OK; }
static void count_discard(void *user, void *blob) { (void)user, (void)blob; }

int main(int argc, char **argv)
{
    if (argc < 3) return fprintf(stderr, "usage: bench_voxelize MODEL DEPTH...\n"), 1;
    svo_mesh mesh;
    svo_error err;
    fmt_import_options import = {0};
    if (fmt_import_mesh(argv[1], &import, &mesh, &err) != SVO_OK) return fprintf(stderr, "%s\n", err.message), 1;
    printf("depth,attributes,threads,triangles,voxels,wall_s,cpu_s,mvoxels_per_wall_s,mvoxels_per_cpu_s,peak_mb\n");
    for (int d = 2; d < argc; d++)
        for (int attributes = 0; attributes < 2; attributes++)
            for (uint32_t threads = 1; threads <= 2; threads++) {
                svo_voxelize_options o = svo_default_voxelize_options();
                o.depth = (uint32_t)atoi(argv[d]);
                o.threads = threads;
                o.channels = attributes ? SVO_WANT_COLOR | SVO_WANT_NORMAL : 0;
                svo_tree_info info;
                svo_voxelize_report report;
                uint64_t voxels = 0;
                svo_chunk_sink sink = {&voxels, count_encode, count_commit, count_discard};
                double wall = svo_seconds();
                clock_t cpu = clock();
                svo_result r = svo_voxelize_plan(&mesh, &o, &info, &err);
                if (r == SVO_OK) r = svo_voxelize(&mesh, &o, &info, &sink, &report, &err);
                if (r != SVO_OK) return fprintf(stderr, "%s\n", err.message), 1;
                wall = svo_seconds() - wall;
                double used = (double)(clock() - cpu) / CLOCKS_PER_SEC;
                printf("%u,%s,%u,%llu,%llu,%.3f,%.3f,%.1f,%.1f,%.1f\n", o.depth, attributes ? "color+normal" : "none", threads,
                       (unsigned long long)report.triangles, (unsigned long long)voxels, wall, used, (double)voxels / wall / 1e6,
                       (double)voxels / used / 1e6, (double)report.peak_bytes / 1e6);
            }
    svo_mesh_free(&mesh);
    return 0;
}
