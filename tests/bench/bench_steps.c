/* What each step of the geometry's coding saves: bits for one octree as it would be stored after each, as CSV.
 *
 *     bench_steps A.svdag [B.svdag ...]         (written with --geometry svdag)
 *
 * voxels are finest ones, nodes all nodes of the octree. Steps:
 *   svo            one byte an inner node, no pointers (cannot be traversed in place)
 *   svdag_offsets  equal subtrees; 32-bit references, 32-bit offsets of attributes, 64-bit bricks (layout 1)
 *   svdag          the same without offsets
 *   mirrors        and mirror images: a reference holds its turn in the same 32 bits
 *   symmetries     and all 48 symmetries
 *   inline         nodes with one parent inside it, pools with references of four widths, Huffman codes, bricks in one class (layout 3
 *                  with one class); inline_mirrors: the same for mirrors only
 *   classes        bricks in 24 classes (--geometry best; classes_mirrors: symmetric)
 *   counts         and sizes of subtrees, which number attributes
 * The last columns are where the bits of `counts` are, in parts of all. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svoi_best_encode.h"

static void must(bool ok, const char *what)
{
    if (!ok) fprintf(stderr, "%s\n", what), exit(1);
}

/* The builder's tables again, from layout 1: nodes by number instead of by place. */
typedef struct tables {
    svoi_bricks bricks;
    svoi_nodes nodes[SVO_MAX_DEPTH];
    uint32_t root;
} tables;

static tables tables_of(const svo_view *v)
{
    tables t = {.root = v->root};
    uint32_t *number = NULL, n;
    for (uint64_t i = 0; i < v->brick_count; i++) must(svoi_bricks_insert(&t.bricks, v->bricks[i], &n) == SVO_OK, "out of memory");
    for (uint32_t level = v->brick_level; level-- > 0;) {
        const svo_view_level *l = &v->levels[level];
        uint32_t *next = calloc(l->word_count, sizeof *next);
        must(next != NULL, "out of memory");
        for (uint64_t w = 0; w < l->word_count;) {
            uint32_t mask = l->words[w], k = (uint32_t)__builtin_popcount(mask & ~(mask >> 8) & 0xff), refs[8];
            uint32_t all = (uint32_t)__builtin_popcount(mask & 0xff);
            must(mask < 256, "octrees with full leaves are not for this table");
            for (uint32_t i = 0; i < k; i++) refs[i] = number != NULL ? number[l->words[w + 1 + i]] : l->words[w + 1 + i];
            must(svoi_nodes_insert(&t.nodes[level], mask, refs, 0, &next[w]) == SVO_OK, "out of memory");
            w += 1 + k + (all - 1) * (uint64_t)l->offset_words;
        }
        free(number);
        number = next;
    }
    if (v->brick_level != 0) t.root = number[v->root];
    free(number);
    return t;
}

static svoi_symdag merged(const svo_view *v, svoi_group group)
{
    tables t = tables_of(v);
    svoi_symdag d;
    must(svoi_symdag_make(&d, t.nodes, &t.bricks, v->brick_level, t.root, v->lod, svo_view_brick_lod(v), group, 0, NULL) == SVO_OK, "out of memory");
    return d;
}

/* 32-bit words a mask and a reference, 64-bit bricks; with offsets of attributes or without. */
static double pointers(const svoi_symdag *d, bool offsets)
{
    double bits = 64.0 * (double)d->level[d->brick_level].count;
    for (uint32_t l = 0; l < d->brick_level; l++) {
        uint64_t refs = d->level[l].item_count - d->level[l].count;
        bits += 32.0 * (double)(d->level[l].item_count + (offsets ? refs - d->level[l].count : 0));
    }
    return bits;
}

static double coded(const svoi_symdag *d, bool numbered, uint32_t classes, svoi_best_stats *stats)
{
    svoi_best_parts p;
    must(svoi_best_encode(d, numbered, classes, NULL, &p, stats) == SVO_OK, "out of memory");
    double bits = 8.0 * (double)(p.stream.size + p.levels.size + p.codes.size + p.dictionary.size);
    svoi_best_parts_free(&p);
    return bits;
}

static void row(const char *name, const svo_view *v, const char *step, double bits)
{
    double voxels = (double)v->nodes[v->depth], nodes = 0;
    for (uint32_t l = 0; l <= v->depth; l++) nodes += (double)v->nodes[l];
    printf("%s,%u,%.0f,%s,%.0f,%.4f,%.4f\n", name, v->depth, voxels, step, bits / 8, bits / voxels, bits / nodes);
}

static void measure(const char *name, const svo_view *v)
{
    double inner = 0;
    for (uint32_t l = 0; l < v->depth; l++) inner += (double)v->nodes[l];
    row(name, v, "svo", 8 * inner);
    svoi_best_stats stats;
    static const struct { svoi_group group; const char *pointers, *inside, *classes; } kinds[] = {
        {SVOI_IDENTITY, "svdag", NULL, NULL}, {SVOI_MIRRORS, "mirrors", "inline_mirrors", "classes_mirrors"}, {SVOI_ALL, "symmetries", "inline", "classes"}};
    for (int i = 0; i < 3; i++) {
        svoi_symdag d = merged(v, kinds[i].group);
        if (i == 0) row(name, v, "svdag_offsets", pointers(&d, true));
        row(name, v, kinds[i].pointers, pointers(&d, false));
        if (kinds[i].inside != NULL) row(name, v, kinds[i].inside, coded(&d, false, 3, NULL));
        if (kinds[i].classes != NULL) row(name, v, kinds[i].classes, coded(&d, false, SVOI_BEST_CLASSES, NULL));
        if (i == 2) {
            static const char *const part[] = {"class", "class_first", "turn", "turn_first", "mask", "octants", "octant", "number"};
            row(name, v, "counts", coded(&d, true, SVOI_BEST_CLASSES, &stats));
            for (int k = 0; k < 8; k++) {
                char step[32];
                snprintf(step, sizeof step, "part:%s", part[k]);
                row(name, v, step, (double)stats.bits[k]);
            }
            row(name, v, "part:skips", (double)stats.skips);
            row(name, v, "part:sizes", (double)stats.counts);
            row(name, v, "part:references", (double)stats.references);
            row(name, v, "part:other_heads", (double)(stats.heads - stats.skips - stats.counts - stats.references));
        }
        svoi_symdag_free(&d);
    }
}

int main(int argc, char **argv)
{
    puts("model,depth,voxels,step,bytes,bits_per_voxel,bits_per_node");
    for (int i = 1; i < argc; i++) {
        svo_error err = {0};
        fmt_bytes bytes;
        fmt_svdag f;
        if (fmt_bytes_open(argv[i], 0, NULL, &bytes, &err) != SVO_OK || fmt_svdag_open(bytes.data, bytes.size, NULL, &f, &err) != SVO_OK) {
            fprintf(stderr, "%s: %s\n", argv[i], err.message);
            return 1;
        }
        must(f.view.layout == SVO_LAYOUT_PLAIN && f.view.brick_level > 0, "files of --geometry svdag, of depth 3 or more, are wanted");
        const char *slash = strrchr(argv[i], '/');
        measure(slash != NULL ? slash + 1 : argv[i], &f.view);
        fmt_svdag_close(&f);
        fmt_bytes_close(&bytes);
    }
    return 0;
}
