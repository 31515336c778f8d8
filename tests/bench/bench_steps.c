/* What each step of the geometry's coding saves: bits for one octree as it would be stored after each, as CSV. With -r: what each step costs a reader.
 *
 *     bench_steps [-r ROUNDS] A.svdag [B.svdag ...]         (written with --geometry svdag)
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
 * The last columns are where the bits of `counts` are, in parts of all.
 *
 * -r: nanoseconds of a look-up of a random voxel from the root (svdag_offsets and counts: with the number of its attribute), in CPU time, and as a multiple
 * of svdag's. The steps take turns in rounds of 20000 look-ups behind as many that are not counted; a figure is the median round's, a
 * ratio the median of the rounds'. Steps with pointers are read here, as words in memory (a reference: word 26 bits, turn 6 bits), layout 3 by the
 * library (svo_view_voxel) without the tables that it makes of a file when it opens it, and then with them:
 *   inline, classes, counts   as above, decoded from the root on
 *   tables                    counts with the tables of svo_view_accelerate, as programs read a file */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bench_median.h"
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

/* --- rates ------------------------------------------------------------------------------------------------------- */

enum { SLICE = 20000, QUERIES = 400000, MOST_ROUNDS = 1001, STEPS = 8, TURN_BITS = 6 };

/* Nodes with 32-bit pointers: mask, references (place << 6 | the turn that takes octants of this node's frame to those of the other), and with offsets one for each child but the first; bricks as they are. */
typedef struct pointer_dag {
    uint32_t *words[SVO_MAX_DEPTH], root, turn, brick_level; /* turn: takes octants of the grid to those of the root */
    uint64_t *bricks;
    bool lod, brick_lod;
} pointer_dag;

static void *get(uint64_t count, size_t size)
{
    void *p = calloc(count + 1, size);
    must(p != NULL, "out of memory");
    return p;
}

static pointer_dag point(const svoi_symdag *d, bool offsets)
{
    pointer_dag p = {.turn = svoi_turn_inverse(d->root_turn), .brick_level = d->brick_level, .lod = d->lod, .brick_lod = d->brick_lod};
    const svoi_symlevel *below = &d->level[d->brick_level];
    uint32_t *place = get(below->count, sizeof *place);
    p.bricks = get(below->count, sizeof *p.bricks);
    memcpy(p.bricks, below->bits, below->count * sizeof *p.bricks);
    for (uint32_t i = 0; i < below->count; i++) place[i] = i;
    for (uint32_t level = d->brick_level; level-- > 0;) {
        const svoi_symlevel *l = &d->level[level];
        uint32_t *to = get(2 * l->item_count, sizeof *to), *mine = get(l->count, sizeof *mine);
        uint64_t at = 0;
        for (uint32_t i = 0; i < l->count; i++) {
            const uint32_t *item = l->items + l->start[i], refs = (uint32_t)__builtin_popcount(svoi_head_refs(item[0]));
            mine[i] = (uint32_t)at;
            to[at++] = svoi_head_mask(item[0]);
            for (uint32_t k = 1; k <= refs; k++) {
                must(place[item[k]] >> (32 - TURN_BITS) == 0, "too many nodes for references of 26 bits");
                to[at++] = place[item[k]] << TURN_BITS | svoi_turn_inverse(l->turn[l->start[i] + k]);
            }
            uint64_t sum = d->lod ? 1 : 0;
            for (uint32_t k = 1; k < refs && offsets; k++) {
                sum += svoi_symdag_size(d, level + 1, item[k]);
                to[at++] = (uint32_t)sum;
            }
        }
        must(at >> (32 - TURN_BITS) == 0, "too many nodes for references of 26 bits");
        p.words[level] = to;
        free(place);
        place = mine;
    }
    p.root = place[d->root];
    free(place);
    return p;
}

static void free_pointers(pointer_dag *p)
{
    for (uint32_t l = 0; l < p->brick_level; l++) free(p->words[l]);
    free(p->bricks);
}

/* As svo_view_voxel. `turned` and `offsets` are constants where this is called, so that a step pays for its own work alone; offsets are for octrees as they are in the grid. */
static inline bool follow(const pointer_dag *p, bool turned, bool offsets, uint32_t x, uint32_t y, uint32_t z, uint64_t *index)
{
    uint32_t at = p->root, u = p->turn;
    uint64_t i = 0;
    for (uint32_t level = 0; level < p->brick_level; level++) {
        const uint32_t shift = p->brick_level + 1 - level, octant = (x >> shift & 1) | (y >> shift & 1) << 1 | (z >> shift & 1) << 2;
        const uint32_t o = turned ? svoi_turn_octant(u, octant) : octant, *w = p->words[level] + at, mask = w[0];
        if ((mask >> o & 1) == 0) return false;
        const uint32_t slot = (uint32_t)__builtin_popcount(mask & ((1u << o) - 1)), ref = w[1 + slot];
        if (offsets) i += slot != 0 ? w[(uint32_t)__builtin_popcount(mask) + slot] : p->lod;
        if (turned) u = svoi_turn_after(ref & ((1u << TURN_BITS) - 1), u);
        at = ref >> TURN_BITS;
    }
    const uint32_t a = (x >> 1 & 1) | (y >> 1 & 1) << 1 | (z >> 1 & 1) << 2, b = (x & 1) | (y & 1) << 1 | (z & 1) << 2;
    const uint32_t bit = turned ? 8 * svoi_turn_octant(u, a) + svoi_turn_octant(u, b) : 8 * a + b;
    if ((p->bricks[at] >> bit & 1) == 0) return false;
    if (offsets) *index = svo_brick_voxel(p->brick_lod, p->bricks[at], i, bit);
    return true;
}

/* A view of layout 3 with so many classes of bricks, of the octree v. */
typedef struct coded_view {
    svoi_best_parts parts;
    svo_view view;
} coded_view;

static void code(const svo_view *v, const svoi_symdag *d, bool numbered, uint32_t classes, coded_view *c)
{
    svo_error err = {0};
    must(svoi_best_encode(d, numbered, classes, NULL, &c->parts, NULL) == SVO_OK, "out of memory");
    c->view = *v;
    c->view.top = NULL;
    c->view.layout = SVO_LAYOUT_BEST;
    c->view.root = d->root_turn;
    c->view.unnumbered = !numbered;
    c->view.attribute_count = svoi_symdag_size(d, 0, d->root);
    c->view.best_stream = c->parts.stream.data, c->view.best_stream_bytes = c->parts.stream.size;
    c->view.best_codes = c->parts.codes.data, c->view.best_code_bytes = c->parts.codes.size;
    c->view.best_levels = (const svoi_best_level *)(const void *)c->parts.levels.data;
    c->view.bricks = (const uint64_t *)(const void *)c->parts.dictionary.data;
    c->view.brick_count = c->parts.dictionary.size / 8;
    must(svo_view_prepare(&c->view, NULL, &err) == SVO_OK, err.message);
}

typedef struct readers {
    pointer_dag offsets, svdag, mirrors, symmetries;
    coded_view inside, classes, counts, tables;
    uint32_t (*cell)[3];
    uint64_t count, step, at;
} readers;
static const char *const reader_names[STEPS] = {"svdag_offsets", "svdag", "mirrors", "symmetries", "inline", "classes", "counts", "tables"};

static uint64_t random_number(uint64_t *state)
{
    *state ^= *state << 13, *state ^= *state >> 7, *state ^= *state << 17;
    return *state;
}

static bool pick(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    readers *r = user;
    (void)index;
    if (r->at++ % r->step == 0 && r->count < QUERIES) memcpy(r->cell[r->count++], (uint32_t[]){x, y, z}, sizeof *r->cell);
    return true;
}

/* Look up voxels [first, first + count); the sum of what was found (with numbers: that of the numbers) goes to *sum. */
static double ask(const readers *r, int step, uint64_t first, uint64_t count, uint64_t *sum)
{
    struct timespec begin, end;
    uint64_t found = 0;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &begin);
    for (uint64_t k = first; k < first + count; k++) {
        const uint32_t x = r->cell[k][0], y = r->cell[k][1], z = r->cell[k][2];
        uint64_t index = 1;
        switch (step) {
        case 0: found += follow(&r->offsets, false, true, x, y, z, &index) ? index : 0; break;
        case 1: found += follow(&r->svdag, false, false, x, y, z, &index); break;
        case 2: found += follow(&r->mirrors, true, false, x, y, z, &index); break;
        case 3: found += follow(&r->symmetries, true, false, x, y, z, &index); break;
        case 4: found += svo_view_voxel(&r->inside.view, x, y, z, NULL); break;
        case 5: found += svo_view_voxel(&r->classes.view, x, y, z, NULL); break;
        case 6: found += svo_view_voxel(&r->counts.view, x, y, z, &index) ? index : 0; break;
        default: found += svo_view_voxel(&r->tables.view, x, y, z, &index) ? index : 0; break;
        }
    }
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &end);
    *sum += found;
    return (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
}

static void make_readers(const svo_view *v, readers *r)
{
    svoi_symdag d = merged(v, SVOI_IDENTITY);
    r->offsets = point(&d, true), r->svdag = point(&d, false);
    svoi_symdag_free(&d);
    d = merged(v, SVOI_MIRRORS);
    r->mirrors = point(&d, false);
    svoi_symdag_free(&d);
    d = merged(v, SVOI_ALL);
    r->symmetries = point(&d, false);
    code(v, &d, false, 3, &r->inside);
    code(v, &d, false, SVOI_BEST_CLASSES, &r->classes);
    code(v, &d, true, SVOI_BEST_CLASSES, &r->counts);
    code(v, &d, true, SVOI_BEST_CLASSES, &r->tables);
    svo_view_accelerate(&r->tables.view, NULL);
    svoi_symdag_free(&d);
    r->cell = get(QUERIES, sizeof *r->cell);
    r->step = v->nodes[v->depth] / QUERIES + 1;
    svo_view_voxels(v, pick, r);
    uint64_t seed = 88172645463325252u;
    for (uint64_t i = r->count; i > 1; i--) { /* in random order */
        uint64_t j = random_number(&seed) % i;
        uint32_t keep[3];
        memcpy(keep, r->cell[i - 1], sizeof keep);
        memcpy(r->cell[i - 1], r->cell[j], sizeof keep);
        memcpy(r->cell[j], keep, sizeof keep);
    }
}

/* Steps say what the octree of the file says: its voxels, and one number for each from those that number. */
static void check_readers(const readers *r, const svo_view *v)
{
    uint64_t sum[STEPS] = {0}, all = r->count;
    for (int s = 0; s < STEPS; s++) ask(r, s, 0, all, &sum[s]);
    for (int s = 1; s < 6; s++) must(sum[s] == all, "a step does not find a voxel");
    must(sum[0] == sum[6] && sum[0] == sum[7], "steps number attributes differently");
    for (uint64_t k = 0; k < all; k++) { /* some of the cells around are empty */
        const uint32_t side = (uint32_t)1 << v->depth, x = (r->cell[k][0] + 3) % side, y = (r->cell[k][1] + 1) % side, z = r->cell[k][2];
        uint64_t i = 0, j = 0;
        const bool is = svo_view_voxel(v, x, y, z, NULL);
        must(follow(&r->offsets, false, true, x, y, z, &i) == is && svo_view_voxel(&r->counts.view, x, y, z, &j) == is && i == j, "steps differ");
        must(follow(&r->mirrors, true, false, x, y, z, &i) == is && follow(&r->symmetries, true, false, x, y, z, &i) == is, "turned steps differ");
        must(svo_view_voxel(&r->inside.view, x, y, z, NULL) == is && svo_view_voxel(&r->classes.view, x, y, z, NULL) == is, "coded steps differ");
    }
}

static void rates(const char *name, const svo_view *v, int rounds)
{
    static double took[STEPS][MOST_ROUNDS];
    readers r = {0};
    make_readers(v, &r);
    must(r.count >= 2 * SLICE, "too few voxels");
    check_readers(&r, v);
    const uint64_t slices = r.count / SLICE;
    uint64_t sum = 0;
    for (int n = 0; n < rounds; n++)
        for (int k = 0; k < STEPS; k++) {
            const int step = (k + n) % STEPS;
            ask(&r, step, (uint64_t)n % slices * SLICE, SLICE, &sum);
            took[step][n] = ask(&r, step, (uint64_t)(n + 1) % slices * SLICE, SLICE, &sum) / SLICE;
        }
    for (int s = 0; s < STEPS; s++) {
        double ratio[MOST_ROUNDS], time[MOST_ROUNDS];
        for (int n = 0; n < rounds; n++) ratio[n] = took[s][n] / took[1][n], time[n] = took[s][n];
        printf("%s,%u,%llu,%s,%.1f,%.3f\n", name, v->depth, (unsigned long long)v->nodes[v->depth], reader_names[s], 1e9 * bench_median(time, rounds), bench_median(ratio, rounds));
    }
    pointer_dag *pointers[] = {&r.offsets, &r.svdag, &r.mirrors, &r.symmetries};
    coded_view *views[] = {&r.inside, &r.classes, &r.counts, &r.tables};
    for (int k = 0; k < 4; k++) {
        free_pointers(pointers[k]);
        svo_view_release(&views[k]->view, NULL);
        svoi_best_parts_free(&views[k]->parts);
    }
    free(r.cell);
}

int main(int argc, char **argv)
{
    int first = 1, rounds = 0;
    if (argc > 2 && strcmp(argv[1], "-r") == 0) rounds = atoi(argv[2]), first = 3;
    must(first == 1 || (rounds > 0 && rounds <= MOST_ROUNDS), "-r: 1 to 1001 rounds");
    puts(rounds != 0 ? "model,depth,voxels,step,lookup_ns,ratio" : "model,depth,voxels,step,bytes,bits_per_voxel,bits_per_node");
    for (int i = first; i < argc; i++) {
        svo_error err = {0};
        fmt_bytes bytes;
        fmt_svdag f;
        if (fmt_bytes_open(argv[i], 0, NULL, &bytes, &err) != SVO_OK || fmt_svdag_open(bytes.data, bytes.size, NULL, &f, &err) != SVO_OK) {
            fprintf(stderr, "%s: %s\n", argv[i], err.message);
            return 1;
        }
        must(f.view.layout == SVO_LAYOUT_PLAIN && f.view.brick_level > 0, "files of --geometry svdag, of depth 3 or more, are wanted");
        const char *slash = strrchr(argv[i], '/');
        const char *name = slash != NULL ? slash + 1 : argv[i];
        if (rounds != 0) rates(name, &f.view, rounds);
        else measure(name, &f.view);
        fmt_svdag_close(&f);
        fmt_bytes_close(&bytes);
    }
    return 0;
}
