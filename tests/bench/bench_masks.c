/* Coded masks of .svo files: bits a finest voxel (streams and records alone) and rates of one thread, by its own CPU time.
 *
 *     bench_masks [-o MASKS] model.svo ...     -o: the masks as they are, one byte a node, level by level, and to MASKS.deep depth first,
 *                                          chunk by chunk; of the last file, without the few levels above the chunks */
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

/* Masks of nodes of each level below the chunks, in order. */
typedef struct by_level { svo_buffer level[FMTI_MASKS_LEVELS], deep; } by_level;

static bool keep(by_level *to, const svo_chunk *c)
{
    const uint32_t levels = c->depth - c->level;
    uint32_t left[FMTI_MASKS_LEVELS] = {0}, l = 0; /* children to come, of the nodes on the way */
    for (uint64_t i = 0; i < c->node_count; i++) {
        const uint8_t mask = c->masks[i];
        if (svo_buffer_append(&to->level[l], &mask, 1) == NULL) return false;
        if (l + 1 < levels && mask != 0) left[++l] = (uint32_t)__builtin_popcount(mask) + 1;
        while (l != 0 && --left[l] == 0) l--;
    }
    return svo_buffer_append(&to->deep, c->masks, (size_t)c->node_count) != NULL;
}

static svo_result write_masks(by_level *from, const char *path, svo_error *err)
{
    char deep[4096];
    snprintf(deep, sizeof deep, "%s.deep", path);
    FILE *f = fopen(path, "wb"), *g = fopen(deep, "wb");
    bool ok = f != NULL && g != NULL && fwrite(from->deep.data, 1, from->deep.size, g) == from->deep.size;
    for (int i = 0; i < FMTI_MASKS_LEVELS && ok; i++) ok = from->level[i].size == 0 || fwrite(from->level[i].data, 1, from->level[i].size, f) == from->level[i].size;
    ok = (f == NULL || fclose(f) == 0) && ok;
    ok = (g == NULL || fclose(g) == 0) && ok;
    return ok ? SVO_OK : svo_fail(err, SVO_IO, "cannot write %s", path);
}

/* masks_path: where the masks go, or NULL */
static svo_result run(const char *path, const char *masks_path, svo_error *err)
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
    by_level plain;
    for (int i = 0; i < FMTI_MASKS_LEVELS; i++) svo_buffer_init(&plain.level[i], NULL);
    svo_buffer_init(&plain.deep, NULL);
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
        if (masks_path != NULL && !keep(&plain, &c)) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
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
    if (masks_path != NULL) SVO_TRY(write_masks(&plain, masks_path, err));
    for (int i = 0; i < FMTI_MASKS_LEVELS; i++) svo_buffer_free(&plain.level[i]);
    svo_buffer_free(&plain.deep);
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
    const char *masks = argc > 2 && strcmp(argv[1], "-o") == 0 ? argv[2] : NULL;
    for (int i = masks != NULL ? 3 : 1; i < argc; i++) {
        svo_error err = {0};
        if (run(argv[i], masks, &err) == SVO_OK) continue;
        fprintf(stderr, "%s: %s\n", argv[i], err.message);
        return 1;
    }
    return 0;
}
