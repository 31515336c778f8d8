/* The quantities of tables 2.1 to 2.5 of Dado et al. 2016 (chapter 2) for octrees with colours, beside this format's, as CSV.
 *
 *     bench_tables [-t THREADS] A.svdag [B.svdag ...]        (svo-compress --geometry svdag --lod stored, colours without loss)
 *
 * Rows: model,depth,quantity,value. Bytes unless the name says otherwise. "Nodes" are all octree nodes, finest voxels included.
 *   attributes, distinct              nodes (Lambda) and distinct 24-bit colours (lambda)
 *   array, array_indices              24 bits a node; indices of ceil(log2 lambda) bits and the table
 *   pc24, pc14, pc12                  Algorithm 1 (64-bit directory, shared palettes, table) on colours as they are, by 14 and 12 bits
 *   dag, dag_offsets, dag_*           equal subtrees: 32-bit masks and pointers; with a 32-bit offset a pointer; and with each step of section 2.4
 *                                     (the first offset left out, offsets and pointers of whole bytes a level, 8-bit masks, pointers by frequency)
 *   svo, psvo, cdag, dado             12-bit colours: mask, pointer and colour a node; without pointers; equal coloured subtrees (32-bit mask and
 *                                     pointers); dag_combined + pc12
 *   fast, best, best_de3          this format with 12-bit colours, and (to 20 million nodes) within a CIE94 difference of 3; *_geometry: the part that is geometry
 *   *_mean, *_max, *_cpu_s            CIE94 difference over all nodes; seconds of CPU: fast: from chunks to the packed octree; cdag, pc12: of this program
 * ESVOs (contours, other code) are not among them. */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svo_algorithm1.h"
#include "svo_dag.h"
#include "svo_unpack.h"

static uint32_t threads = 2;

static void die(const char *what) { fprintf(stderr, "bench_tables: %s\n", what), exit(1); }
static void must(svo_result r, const svo_error *err)
{
    if (r != SVO_OK) die(err->message);
}
static void *get(uint64_t count, size_t size)
{
    void *p = calloc((size_t)count + 1, size);
    if (p == NULL) die("out of memory");
    return p;
}
static double cpu(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
static uint32_t bits_for(uint64_t count) { return count < 2 ? 0 : 64 - (uint32_t)__builtin_clzll(count - 1); }
static uint32_t bytes_for(uint64_t most) { return most == 0 ? 1 : (71 - (uint32_t)__builtin_clzll(most)) / 8; }

typedef struct where { const char *name; uint32_t depth; } where;
static void row(const where *w, const char *what, double value) { printf("%s,%u,%s,%.6g\n", w->name, w->depth, what, value); }

/* --- attributes --------------------------------------------------------------------------------------------------- */

typedef struct colors {
    uint32_t *index; /* of each node, into a table of distinct colours */
    uint64_t count, distinct;
} colors;

static colors colors_of(const svo_view *v, uint32_t channel)
{
    colors c = {get(v->attribute_count, sizeof *c.index), v->attribute_count, 0};
    uint32_t *number = get((uint64_t)1 << 24, sizeof *number); /* + 1 */
    for (uint64_t i = 0; i < c.count; i++) {
        uint8_t b[SVO_MAX_STRIDE];
        svo_view_attribute(v, channel, i, b);
        uint32_t *n = &number[b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16];
        if (*n == 0) *n = (uint32_t)++c.distinct;
        c.index[i] = *n - 1;
    }
    free(number);
    return c;
}

static double palettes(const where *w, const colors *c, const char *what)
{
    svo_algorithm1_result r;
    svo_error err;
    double start = cpu();
    must(svo_algorithm1(c->index, c->count, c->distinct, 64, threads, NULL, &r, &err), &err);
    double bytes = (double)r.bits / 8 + 3 * (double)c->distinct;
    char name[48];
    snprintf(name, sizeof name, "%s_cpu_s", what);
    row(w, name, cpu() - start);
    row(w, what, bytes);
    svo_algorithm1_free(&r, NULL);
    return bytes;
}

/* --- geometry after the chapter ----------------------------------------------------------------------------------- */

typedef struct steps { double dag, offsets, implicit, offset, pointer, mask, entropy, combined; } steps;

static int descending(const void *x, const void *y)
{
    uint32_t a = *(const uint32_t *)x, b = *(const uint32_t *)y;
    return (a < b) - (a > b);
}

/* Pointers of one level by how often each is used: the first 2^6 take a byte, the next 2^14 two, 2^22 three, each with an entry of 32 bits
 * in a table where that pays; the others four. */
static double by_frequency(uint32_t *uses, uint64_t count)
{
    double bytes = 0;
    qsort(uses, (size_t)count, sizeof *uses, descending);
    for (uint64_t i = 0, k = 0; i < count && uses[i] != 0; i++) {
        uint32_t width = k < 64 ? 1 : k < 64 + (1u << 14) ? 2 : 3;
        if (k < 64 + (1u << 14) + (1u << 22) && (double)width * uses[i] + 4 < 4.0 * uses[i]) bytes += (double)width * uses[i] + 4, k++;
        else bytes += 4.0 * uses[i];
    }
    return bytes;
}

static void add_level(steps *s, double nodes, double pointers, uint64_t most_offset, double next_words, double entropy)
{
    double inner = pointers > 0 ? nodes : 0, all = 4 * nodes + 8 * pointers;
    double narrow = bytes_for(most_offset), pointer = bytes_for((uint64_t)next_words);
    s->dag += 4 * nodes + 4 * pointers;
    s->offsets += all;
    s->implicit += all - 4 * inner;
    s->offset += all - (4 - narrow) * pointers;
    s->pointer += all - (4 - pointer) * pointers;
    s->mask += all - 3 * nodes;
    s->entropy += all - 4 * pointers + entropy;
    s->combined += nodes + entropy + narrow * (pointers - inner);
}

static steps geometry(const svo_view *v)
{
    steps s = {0};
    static uint32_t byte_uses[256];
    memset(byte_uses, 0, sizeof byte_uses);
    uint64_t octants = 0, masks = 0;
    for (uint64_t i = 0; i < v->brick_count; i++)
        for (uint32_t o = 0; o < 8; o++) {
            uint32_t m = v->bricks[i] >> 8 * o & 0xff;
            octants += m != 0;
            if (m != 0) byte_uses[m]++;
        }
    for (int m = 1; m < 256; m++) masks += byte_uses[m] != 0;
    double next = (double)(v->brick_count + 2 * octants);
    add_level(&s, (double)v->brick_count, (double)octants, 64, (double)masks, by_frequency(byte_uses, 256));
    add_level(&s, (double)masks, 0, 0, 0, 0); /* voxels are bits */
    for (uint32_t level = v->brick_level; level-- > 0;) {
        const svo_view_level *l = &v->levels[level];
        uint64_t below = level + 1 == v->brick_level ? v->brick_count : v->levels[level + 1].word_count, nodes = 0, pointers = 0, most = 0;
        uint32_t *uses = get(below, sizeof *uses);
        for (uint64_t at = 0; at < l->word_count; nodes++) {
            const uint32_t *w = l->words + at;
            uint32_t k = (uint32_t)__builtin_popcount(w[0] & 0xff);
            if (w[0] > 0xff) die("full leaves are not for this table");
            for (uint32_t i = 0; i < k; i++) uses[w[1 + i]]++;
            for (uint32_t i = 1; i < k && l->offset_words != 0; i++) {
                uint64_t offset = w[1 + k + (i - 1) * l->offset_words];
                if (l->offset_words == 2) offset |= (uint64_t)w[2 + k + (i - 1) * 2] << 32;
                if (offset > most) most = offset;
            }
            pointers += k;
            at += 1 + k + (uint64_t)(k - 1) * l->offset_words;
        }
        add_level(&s, (double)nodes, (double)pointers, most, next, by_frequency(uses, below));
        next = (double)(nodes + 2 * pointers);
        free(uses);
    }
    return s;
}

/* --- coloured subtrees --------------------------------------------------------------------------------------------- */

typedef struct set { uint64_t *slot, count, capacity; } set;
static bool set_add(set *s, uint64_t key)
{
    if (key == 0) key = 1;
    if (2 * (s->count + 1) > s->capacity) {
        set more = {get(s->capacity != 0 ? 2 * s->capacity : 1024, 8), 0, s->capacity != 0 ? 2 * s->capacity : 1024};
        for (uint64_t i = 0; i < s->capacity; i++)
            if (s->slot[i] != 0) set_add(&more, s->slot[i]);
        free(s->slot);
        *s = more;
    }
    uint64_t i = (key * 0x9e3779b97f4a7c15u) >> 20 & (s->capacity - 1);
    for (; s->slot[i] != 0; i = (i + 1) & (s->capacity - 1))
        if (s->slot[i] == key) return false;
    s->slot[i] = key;
    s->count++;
    return true;
}

typedef struct walk {
    const svo_view *v;
    const uint32_t *color;
    uint64_t next; /* attribute */
    set seen[SVO_MAX_DEPTH + 1];
    uint64_t nodes, pointers;
} walk;

static uint64_t mix(uint64_t h, uint64_t x)
{
    h = (h ^ x) * 0xd6e8feb86659fd93u;
    return (h ^ h >> 29) * 0x9e3779b97f4a7c15u;
}

/* Coloured subtrees by 64-bit hash (two that are not equal have the same one with a probability below 2^-64 n^2 / 2). Attributes are depth-first. */
static uint64_t subtree(walk *w, uint32_t level, svo_view_node node, uint64_t brick)
{
    uint64_t h = mix(level + 1, w->color[w->next++]), mask;
    uint32_t children = 0;
    if (level < w->v->brick_level) mask = svo_view_mask(w->v, level, node);
    else if (level == w->v->brick_level) {
        mask = 0;
        for (uint32_t o = 0; o < 8; o++) mask |= (uint64_t)((brick >> 8 * o & 0xff) != 0) << o;
    } else mask = level < w->v->tree_depth ? brick : 0;
    h = mix(h, mask);
    for (uint64_t m = mask; m != 0; m &= m - 1, children++) {
        uint32_t o = (uint32_t)__builtin_ctzll(m);
        svo_view_node child = node;
        uint64_t bits = level == w->v->brick_level ? brick >> 8 * o & 0xff : 0;
        if (level < w->v->brick_level) child = svo_view_child(w->v, level, node, o);
        if (level + 1 == w->v->brick_level) bits = svo_view_brick(w->v, child);
        h = mix(h, subtree(w, level + 1, child, bits));
    }
    if (set_add(&w->seen[level], h)) w->nodes++, w->pointers += children;
    return h;
}

static double colored_dag(const where *at, const svo_view *v, const uint32_t *color)
{
    walk *w = get(1, sizeof *w);
    w->v = v, w->color = color;
    double start = cpu();
    svo_view_node root = svo_view_root(v);
    subtree(w, 0, root, v->brick_level == 0 ? svo_view_brick(v, root) : 0);
    if (w->next != v->attribute_count) die("attributes of inner nodes are wanted (--lod stored)");
    row(at, "cdag_cpu_s", cpu() - start);
    row(at, "cdag_nodes", (double)w->nodes);
    double bytes = 5.5 * (double)w->nodes + 4 * (double)w->pointers;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) free(w->seen[l].slot);
    free(w);
    return bytes;
}

/* --- this format --------------------------------------------------------------------------------------------------- */

static svo_packed *pack(const svo_view *v, uint32_t channel, svo_dag_options o, svo_dag_report *report, double *seconds)
{
    svo_unpack u;
    svo_unpack_begin(&u, v);
    svo_tree_info info = svo_unpack_info(v);
    svo_chunk_source s = svo_unpack_source(&u);
    svo_packed *p;
    svo_error err;
    o.threads = threads;
    double start = cpu();
    must(svo_dag_build(&info, &s, &o, &p, report, &err), &err);
    *seconds = cpu() - start;
    (void)channel;
    return p;
}

static void ours(const where *w, const svo_view *v, uint32_t channel, const char *name, svo_dag_options o)
{
    svo_dag_report r;
    double seconds;
    char what[48];
    svo_packed_free(pack(v, channel, o, &r, &seconds));
    row(w, name, (double)(r.geometry_bytes + r.attribute_bytes));
    snprintf(what, sizeof what, "%s_geometry", name), row(w, what, (double)r.geometry_bytes);
    snprintf(what, sizeof what, "%s_mean", name), row(w, what, r.channels[channel].error_mean);
    snprintf(what, sizeof what, "%s_max", name), row(w, what, r.channels[channel].error_max);
    snprintf(what, sizeof what, "%s_cpu_s", name), row(w, what, seconds);
}

static void measure(const where *w, const svo_view *v)
{
    uint32_t channel = svo_view_find_channel(v, "color");
    if (channel == SVO_MAX_CHANNELS || v->channel_count != 1 || v->unnumbered) die("one channel of colours that vary is wanted");
    if (v->layout != SVO_LAYOUT_PLAIN || v->brick_level == 0 || !v->lod || v->averaged) die("files of --geometry svdag --lod stored are wanted, of depth 3 or more");
    double nodes = 0, leaves = (double)v->nodes[v->depth];
    for (uint32_t l = 0; l <= v->depth; l++) nodes += (double)v->nodes[l];
    row(w, "voxels", leaves);
    row(w, "attributes", nodes);
    colors c = colors_of(v, channel);
    row(w, "distinct", (double)c.distinct);
    row(w, "array", 3 * nodes);
    row(w, "array_indices", nodes * bits_for(c.distinct) / 8 + 3 * (double)c.distinct);
    palettes(w, &c, "pc24");
    free(c.index);

    steps s = geometry(v);
    const struct { const char *name; double bytes; } rows[] = {{"dag", s.dag}, {"dag_offsets", s.offsets}, {"dag_implicit", s.implicit}, {"dag_offset_bytes", s.offset},
        {"dag_pointer_bytes", s.pointer}, {"dag_mask_bytes", s.mask}, {"dag_entropy", s.entropy}, {"dag_combined", s.combined}};
    for (int i = 0; i < 8; i++) row(w, rows[i].name, rows[i].bytes);

    double pc12 = 0;
    for (uint32_t bits = 14; bits >= 12; bits -= 2) {
        svo_dag_options o = svo_default_dag_options();
        svo_dag_report r;
        double seconds;
        o.geometry = SVO_GEOMETRY_SVDAG;
        o.averaged = false;
        o.color_bits = bits;
        svo_packed *p = pack(v, channel, o, &r, &seconds);
        c = colors_of(svo_packed_view(p), channel);
        row(w, bits == 14 ? "pc14_mean" : "pc12_mean", r.channels[channel].error_mean);
        row(w, bits == 14 ? "pc14_max" : "pc12_max", r.channels[channel].error_max);
        pc12 = palettes(w, &c, bits == 14 ? "pc14" : "pc12");
        if (bits == 12) row(w, "cdag", colored_dag(w, svo_packed_view(p), c.index));
        free(c.index);
        svo_packed_free(p);
    }
    row(w, "svo", 5 * (nodes - leaves) + 1.5 * nodes);
    row(w, "psvo", nodes - leaves + 1.5 * nodes);
    row(w, "dado", s.combined + pc12);

    svo_dag_options o = svo_default_dag_options();
    o.geometry = SVO_GEOMETRY_FAST;
    ours(w, v, channel, "fast_lossless", o);
    o.color_bits = 12;
    ours(w, v, channel, "fast", o);
    o.geometry = SVO_GEOMETRY_BEST;
    ours(w, v, channel, "best", o);
    o.color_bits = 0, o.color_delta_e = 3;
    if (nodes < 2e7) ours(w, v, channel, "best_de3", o); /* some microseconds a node */
}

int main(int argc, char **argv)
{
    int i = 1;
    if (i + 1 < argc && strcmp(argv[i], "-t") == 0) threads = (uint32_t)atoi(argv[i + 1]), i += 2;
    if (i >= argc) die("usage: bench_tables [-t THREADS] A.svdag [B.svdag ...]");
    puts("model,depth,quantity,value");
    for (; i < argc; i++) {
        svo_error err = {0};
        fmt_bytes bytes;
        fmt_svdag f;
        must(fmt_bytes_open(argv[i], 0, NULL, &bytes, &err), &err);
        must(fmt_svdag_open(bytes.data, bytes.size, NULL, &f, &err), &err);
        const char *slash = strrchr(argv[i], '/');
        char name[64];
        snprintf(name, sizeof name, "%s", slash != NULL ? slash + 1 : argv[i]);
        name[strcspn(name, "._")] = 0;
        where w = {name, f.view.depth};
        measure(&w, &f.view);
        fflush(stdout);
        fmt_svdag_close(&f);
        fmt_bytes_close(&bytes);
    }
    return 0;
}
