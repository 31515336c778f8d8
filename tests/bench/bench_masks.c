/* Coded masks of .svo files: bits a finest voxel (streams and records alone) and rates of one thread, by its own CPU time.
 *
 *     bench_masks model.svo ... */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmt_svo.h"
#include "fmti_svo_masks.h"

static double cpu_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static svo_result run(const char *path, svo_error *err)
{
    fmt_input *in = NULL;
    fmt_svo_reader *r = NULL;
    fmti_masks_pool *pool = NULL;
    svo_buffer packed, storage, coded;
    svo_buffer_init(&packed, NULL);
    svo_buffer_init(&storage, NULL);
    svo_buffer_init(&coded, NULL);
    double encode = 0, decode = 0, voxels = 0, bytes = 0;
    uint8_t *back = malloc(300000);
    fmti_masks_prior();
    SVO_TRY(fmt_input_open(path, &in, err));
    SVO_TRY(fmt_svo_reader_open(in, NULL, &r, err));
    SVO_TRY(fmti_masks_pool_new(NULL, &pool, err));
    svo_chunk_source s = fmt_svo_reader_source(r);
    for (bool more = true;;) {
        svo_chunk c;
        SVO_TRY(s.fetch(s.user, &packed, &more, err));
        if (!more) break;
        SVO_TRY(s.decode(s.user, &packed, &storage, &c, err));
        if (c.node_count == 0) continue;
        coded.size = 0;
        double start = cpu_seconds();
        SVO_TRY(fmti_masks_encode(pool, c.depth - c.level, c.masks, c.node_count, &coded, err));
        double middle = cpu_seconds();
        SVO_TRY(fmti_masks_decode(pool, c.depth - c.level, coded.data, coded.size, back, c.node_count, err));
        encode += middle - start;
        decode += cpu_seconds() - middle;
        if (memcmp(back, c.masks, (size_t)c.node_count) != 0) return svo_fail(err, SVO_RUNTIME, "the masks differ");
        voxels += (double)c.value_count;
        bytes += (double)coded.size + 8; /* and a record */
    }
    printf("%-24s %9.3f M voxels  %7.4f bits a voxel  encode %6.2f  decode %6.2f M voxels/s a thread\n", path, voxels * 1e-6, 8 * bytes / voxels,
           voxels / encode * 1e-6, voxels / decode * 1e-6);
    free(back);
    fmti_masks_pool_free(pool);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    svo_buffer_free(&coded);
    return SVO_OK;
}

int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        svo_error err = {0};
        if (run(argv[i], &err) == SVO_OK) continue;
        fprintf(stderr, "%s: %s\n", argv[i], err.message);
        return 1;
    }
    return 0;
}
