/* Colours in few bits: blocks chosen by bits and error against Algorithm 1 of Dado et al. 2016 and against blocks with two
 * endpoints and variable weights after Dolonius et al. 2017, on the same streams in one run.
 *
 *     bench_attributes [-r 1] [-c CHANNEL] [-t THREADS] [-b N [-k BITS,...] [-l SECONDS]] [-m METHODS] [-x BOUND,PRICE,SQUARES,BITS] FILE.svdag [...]
 *
 * The files are packed without loss. METHODS: any of a (Algorithm 1), d (two endpoints), o (ours). -x: ours with this goal
 * alone (svo_palette_goal) and
 * bits of a table index, with a histogram of modes. -r 1: nothing is coded; random access to each channel as it is in the files, and to
 * attributes of nodes of 4x4x4 and 2x2x2 voxels and of voxels (through svo_view_attribute, with a list of where they are).
 *
 * A line of CSV a method and setting: bits a value (tables, directories and headers included), CIE94 mean and largest,
 * PSNR and largest difference of a byte, millions of values coded a CPU second, nanoseconds of a random access whose
 * place depends on the last one (best of 5). Errors are measured on what the decoders return. -b N: times Algorithm 1's
 * search for blocks, as printed (brute force), on the first N, 2N, 4N ... values for at most 20 seconds each, and ours. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svo_algorithm1.h"
#include "svo_color.h"
#include "svo_quantize.h"

typedef struct stream {
    const char *name;
    uint64_t count, distinct;
    uint32_t *v, *index; /* values; numbers of the distinct ones */
    uint32_t *value;     /* distinct, ascending */
    uint64_t *times;
    uint32_t threads;
} stream;

static void die(const char *what) { fprintf(stderr, "bench_attributes: %s\n", what), exit(1); }

static void *get(uint64_t count, size_t size)
{
    void *p = calloc(count + 1, size);
    if (p == NULL) die("out of memory");
    return p;
}

static double cpu_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int compare_u32(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

static void find_distinct(stream *s)
{
    uint32_t *sorted = get(s->count, 4);
    memcpy(sorted, s->v, s->count * 4);
    qsort(sorted, s->count, 4, compare_u32);
    s->value = get(s->count, 4);
    s->times = get(s->count, 8);
    for (uint64_t i = 0; i < s->count; i++) {
        if (i == 0 || sorted[i] != sorted[i - 1]) s->value[s->distinct++] = sorted[i];
        s->times[s->distinct - 1]++;
    }
    free(sorted);
    s->index = get(s->count, 4);
    uint32_t *number = get(1 << 24, 4);
    for (uint64_t i = 0; i < s->distinct; i++) number[s->value[i]] = (uint32_t)i;
    for (uint64_t i = 0; i < s->count; i++) s->index[i] = number[s->v[i]];
    free(number);
}

static void load(const char *path, const char *channel, stream *s)
{
    svo_error err = {0};
    fmt_bytes bytes;
    fmt_svdag f;
    if (fmt_bytes_open(path, 0, NULL, &bytes, &err) != SVO_OK || fmt_svdag_open(bytes.data, bytes.size, NULL, &f, &err) != SVO_OK) die(err.message);
    uint32_t c = svo_view_find_channel(&f.view, channel);
    if (c == SVO_MAX_CHANNELS || f.view.channels[c].channel.kind != SVO_KIND_COLOR_SRGB8) die("no such channel of colours");
    s->count = f.view.attribute_count;
    s->v = get(s->count, 4);
    for (uint64_t i = 0; i < s->count; i++) svo_view_attribute(&f.view, c, i, (uint8_t *)&s->v[i]);
    const char *slash = strrchr(path, '/');
    s->name = slash != NULL ? slash + 1 : path;
    fmt_svdag_close(&f);
    fmt_bytes_close(&bytes);
    find_distinct(s);
}

/* --- errors and access times ------------------------------------------------------------------------------------- */

typedef uint32_t (*decode_fn)(const void *coded, uint64_t i);

static double delta(uint32_t a, uint32_t b)
{
    static struct { uint64_t key; double error; } cache[1 << 16];
    uint64_t key = ((uint64_t)a << 32 | b) + 1, slot = (key * 0x9e3779b97f4a7c15u) >> 48;
    if (cache[slot].key != key) {
        float x[3], y[3];
        svo_srgb8_to_lab((const uint8_t[]){(uint8_t)a, (uint8_t)(a >> 8), (uint8_t)(a >> 16)}, x);
        svo_srgb8_to_lab((const uint8_t[]){(uint8_t)b, (uint8_t)(b >> 8), (uint8_t)(b >> 16)}, y);
        cache[slot].key = key;
        cache[slot].error = svo_delta_e94(x, y);
    }
    return cache[slot].error;
}

/* Nanoseconds of a read whose place depends on the value read before; best of 5. */
static double access_time(uint64_t count, decode_fn decode, const void *coded)
{
    enum { ROUNDS = 5, READS = 400000 };
    uint64_t x = 88172645463325252u, used = 0;
    double best = 1e9;
    for (int r = 0; r < ROUNDS; r++) {
        double started = cpu_seconds();
        for (int k = 0; k < READS; k++) {
            x ^= x << 13, x ^= x >> 7, x ^= x << 17;
            uint64_t i = (x >> 32) * count >> 32; /* fewer than 2^32 values */
            if ((used & 1) && i != 0) i--;
            used += decode(coded, i);
        }
        double ns = (cpu_seconds() - started) / READS * 1e9;
        if (ns < best) best = ns;
    }
    return best;
}

static void line(const stream *s, const char *method, const char *setting, uint64_t bits, double seconds, decode_fn decode, const void *coded)
{
    double sum = 0, most = 0, squares = 0, best;
    int32_t byte = 0;
    for (uint64_t i = 0; i < s->count; i++) {
        uint32_t a = s->v[i], b = decode(coded, i);
        if (a == b) continue;
        double e = delta(a, b);
        sum += e;
        if (e > most) most = e;
        for (int k = 0; k < 24; k += 8) {
            int32_t d = (int32_t)(a >> k & 255) - (int32_t)(b >> k & 255);
            squares += d * d;
            if (d < 0) d = -d;
            if (d > byte) byte = d;
        }
    }
    best = access_time(s->count, decode, coded);
    printf("%s,%s,%s,%.4f,%.4f,%.3f,%.2f,%d,%.2f,%.1f\n", s->name, method, setting, (double)bits / (double)s->count, sum / (double)s->count, most,
           squares > 0 ? 10 * log10(255.0 * 255 * 3 * (double)s->count / squares) : 99, (int)byte, (double)s->count / seconds / 1e6, best);
    fflush(stdout);
}

/* --- tables ------------------------------------------------------------------------------------------------------ */

/* Clustered colours: *table (distinct), and for each distinct value of the stream its entry. */
static uint64_t make_table(const stream *s, uint32_t bits, uint32_t **table, uint32_t **entry)
{
    svo_dag_options o = svo_default_dag_options();
    svo_quantize_result q;
    svo_error err = {0};
    o.color_bits = bits;
    o.threads = s->threads;
    *table = get(s->distinct, 4);
    *entry = get(s->distinct, 4);
    if (svo_quantize(SVO_KIND_COLOR_SRGB8, s->value, s->times, s->distinct, &o, NULL, *entry, &q, &err) != SVO_OK) die(err.message);
    memcpy(*table, *entry, s->distinct * 4);
    qsort(*table, s->distinct, 4, compare_u32);
    uint64_t n = 0;
    for (uint64_t i = 0; i < s->distinct; i++)
        if (i == 0 || (*table)[i] != (*table)[n - 1]) (*table)[n++] = (*table)[i];
    for (uint64_t i = 0; i < s->distinct; i++) {
        uint32_t *at = bsearch(&(*entry)[i], *table, n, 4, compare_u32);
        (*entry)[i] = (uint32_t)(at - *table);
    }
    return n;
}

/* --- ours -------------------------------------------------------------------------------------------------------- */

static void give(void *user, uint64_t first, uint32_t n, uint32_t *values) { memcpy(values, ((const stream *)user)->v + first, n * 4); }
static uint32_t decode_blocks(const void *coded, uint64_t i) { return svo_palette_value(coded, i); }

static void ours(const stream *s, double bound, double price, bool squares, uint32_t table_bits, bool histogram, const char *setting)
{
    svo_error err = {0};
    svo_palette_goal goal = {bound, price, squares};
    svo_buffer directory, payload;
    uint32_t *table, *entry;
    svo_buffer_init(&directory, NULL);
    svo_buffer_init(&payload, NULL);
    double started = cpu_seconds();
    uint64_t n = make_table(s, table_bits, &table, &entry);
    svo_palette_job job = {.kind = SVO_KIND_COLOR_SRGB8, .count = s->count, .source = give, .user = (void *)(uintptr_t)s, .table = table,
                           .table_count = n, .goal = goal, .threads = s->threads};
    if (svo_palette_encode(&job, &directory, &payload, NULL, &err) != SVO_OK) die(err.message);
    double seconds = cpu_seconds() - started;
    uint8_t *bytes = get(n, 3);
    for (uint64_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) bytes[3 * i + (uint64_t)k] = (uint8_t)(table[i] >> 8 * k);
    svo_palette p = {SVO_KIND_COLOR_SRGB8, s->count, bytes, n, directory.data, directory.size / SVO_PALETTE_ENTRY, payload.data, payload.size, NULL};
    svo_palette_stats stats;
    if (svo_palette_check(&p, &stats, &err) != SVO_OK) die(err.message);
    line(s, "blocks", setting, 8 * (directory.size + payload.size) + 24 * n, seconds, decode_blocks, &p);
    if (histogram)
        for (int m = 0; m < SVO_BLOCK_MODES; m++)
            if (stats.blocks[m] != 0)
                fprintf(stderr, "  mode %2d: %8llu blocks %5.1f %% of values, %6.2f bits a value, %5.1f %% of bits\n", m, (unsigned long long)stats.blocks[m],
                        100.0 * (double)stats.values[m] / (double)s->count, (double)stats.bits[m] / (double)stats.values[m],
                        100.0 * (double)(stats.bits[m] + 16 * stats.blocks[m]) / (8.0 * (double)payload.size));
    free(table), free(entry), free(bytes);
    svo_buffer_free(&directory);
    svo_buffer_free(&payload);
}

/* Attributes of nodes of one size: 4x4x4 voxels, 2x2x2, or one. */
typedef struct sized { const svo_view *v; uint32_t channel; uint64_t *attribute, count; } sized;

static uint32_t decode_sized(const void *coded, uint64_t i)
{
    const sized *s = coded;
    uint32_t value = 0;
    svo_view_attribute(s->v, s->channel, s->attribute[i], (uint8_t *)&value);
    return value;
}

/* Every brick of the octree; at most SVO_MAX_DEPTH deep. */
static void gather_bricks(sized to[3], uint32_t level, svo_view_node node)
{
    const svo_view *v = to->v;
    if (node.full) return;
    if (level < v->brick_level) {
        for (uint32_t m = svo_view_mask(v, level, node); m != 0; m &= m - 1) gather_bricks(to, level + 1, svo_view_child(v, level, node, (uint32_t)__builtin_ctz(m)));
        return;
    }
    const uint64_t brick = svo_view_brick(v, node);
    to[0].attribute[to[0].count++] = svo_view_node_attribute(v, level, node);
    for (uint32_t a = 0; a < 8; a++)
        if (brick >> 8 * a & 0xff) to[1].attribute[to[1].count++] = svo_view_brick_octant(v, node, brick, a);
    for (uint64_t m = brick; m != 0; m &= m - 1) to[2].attribute[to[2].count++] = svo_view_brick_voxel(v, node, brick, (uint32_t)__builtin_ctzll(m));
}

/* What an attribute of a node costs by its size, of every channel. */
static void read_nodes(const char *path, const svo_view *v)
{
    static const char *const names[] = {"4x4x4", "2x2x2", "voxel"};
    sized s[3];
    if (!v->lod || v->empty) return;
    for (int k = 0; k < 3; k++) s[k] = (sized){v, 0, get(v->nodes[v->depth], 8), 0};
    gather_bricks(s, 0, svo_view_root(v));
    for (uint32_t c = 0; c < v->channel_count; c++)
        for (int k = 0; k < 3; k++) {
            if (v->channels[c].encoding == SVO_ENCODING_CONSTANT || s[k].count == 0) continue;
            s[k].channel = c;
            printf("%s,%s,%s of %llu,%s,%.1f ns\n", path, v->channels[c].channel.name, names[k], (unsigned long long)s[k].count, v->averaged ? "averaged" : "stored",
                   access_time(s[k].count, decode_sized, &s[k]));
        }
    for (int k = 0; k < 3; k++) free(s[k].attribute);
}

/* The channels of a file as they are. */
static void read_channels(const char *path)
{
    svo_error err = {0};
    fmt_bytes bytes;
    fmt_svdag f;
    if (fmt_bytes_open(path, 0, NULL, &bytes, &err) != SVO_OK || fmt_svdag_open(bytes.data, bytes.size, NULL, &f, &err) != SVO_OK) die(err.message);
    for (uint32_t c = 0; c < f.view.channel_count; c++) {
        if (f.view.channels[c].encoding != SVO_ENCODING_BLOCKS) continue;
        svo_palette p = svo_view_palette(&f.view, c);
        printf("%s,%s,%llu values,%.4f bits,%.1f ns\n", path, f.view.channels[c].channel.name, (unsigned long long)p.count,
               8.0 * (double)(p.payload_size + SVO_PALETTE_ENTRY * svo_view_directory_elements(&f.view, &f.view.channels[c])) / (double)p.count, access_time(p.count, decode_blocks, &p));
    }
    read_nodes(path, &f.view);
    fmt_svdag_close(&f);
    fmt_bytes_close(&bytes);
}

/* --- Algorithm 1 ------------------------------------------------------------------------------------------------- */

typedef struct dado {
    const uint32_t *table;
    svo_algorithm1_result r;
    uint64_t *at; /* first bit of each block */
    uint8_t *data;
} dado;

static uint32_t decode_dado(const void *coded, uint64_t i)
{
    const dado *d = coded;
    const svo_algorithm1_block *b = d->r.blocks;
    for (uint64_t n = d->r.block_count; n > 1;) {
        uint64_t half = n / 2;
        if (b[half].begin <= i) b += half;
        n -= half;
    }
    uint64_t number = svo_palette_bits(d->data, d->at[b - d->r.blocks] + (i - b->begin) * b->bits, b->bits);
    return d->table[d->r.palettes[b->palette + number]];
}

static void algorithm1(const stream *s, uint32_t bits)
{
    svo_error err = {0};
    uint32_t *table, *entry, *index = get(s->count, 4);
    char setting[32];
    dado d = {0};
    double started = cpu_seconds();
    uint64_t n = make_table(s, bits, &table, &entry);
    for (uint64_t i = 0; i < s->count; i++) index[i] = entry[s->index[i]];
    if (svo_algorithm1(index, s->count, n, 64, s->threads, NULL, &d.r, &err) != SVO_OK) die(err.message);
    double seconds = cpu_seconds() - started;
    d.table = table;
    d.at = get(d.r.block_count, 8);
    d.data = get(s->count + 8, 1);
    uint64_t at = 0;
    for (uint64_t k = 0; k < d.r.block_count; k++) {
        const svo_algorithm1_block *b = &d.r.blocks[k];
        uint64_t end = k + 1 < d.r.block_count ? b[1].begin : s->count;
        d.at[k] = at;
        for (uint64_t i = b->begin; i < end; i++, at += b->bits) {
            uint32_t *p = d.r.palettes + b->palette, number = 0;
            if (b->bits != 0) number = (uint32_t)((uint32_t *)bsearch(&index[i], p, p[-1], 4, compare_u32) - p);
            for (uint32_t k2 = 0; k2 < b->bits; k2++) d.data[(at + k2) / 8] |= (uint8_t)((number >> k2 & 1) << (at + k2) % 8);
        }
    }
    snprintf(setting, sizeof setting, "%u bits", bits);
    line(s, "Algorithm 1", setting, d.r.bits + 24 * n, seconds, decode_dado, &d);
    svo_algorithm1_free(&d.r, NULL);
    free(table), free(entry), free(index), free(d.at), free(d.data);
}

/* Line 5 of Algorithm 1 as printed, on the first n values: every begin, extended until there are too many values. */
static double brute_force(const uint32_t *index, uint64_t n, uint64_t table_count, double limit)
{
    typedef struct { uint64_t i, j; } range;
    range *stack = get(n, sizeof *stack);
    uint64_t depth = 0, *seen = get(table_count, 8), stamp = 0, cb = svo_palette_table_bits(table_count);
    double started = cpu_seconds();
    stack[depth++] = (range){0, n};
    while (depth != 0 && cpu_seconds() - started < limit) {
        range p = stack[--depth];
        for (uint32_t w = 0; w < 4; w++) {
            uint64_t from = p.i, most = 0;
            for (uint64_t k = p.i; k < p.j; k++) {
                uint64_t distinct = 0, l = k;
                for (stamp++; l < p.j; l++) {
                    if (seen[index[l]] != stamp && ++distinct > 1u << w) break;
                    seen[index[l]] = stamp;
                }
                if (l - k > most) most = l - k, from = k;
                if ((k & 1023) == 0 && cpu_seconds() - started > limit) goto out;
            }
            if (most * w + (cb << w) + 64 >= most * (w + 1)) continue;
            if (from > p.i) stack[depth++] = (range){p.i, from};
            if (from + most < p.j) stack[depth++] = (range){from + most, p.j};
            break;
        }
    }
out:
    free(stack), free(seen);
    double seconds = cpu_seconds() - started;
    return seconds < limit ? seconds : -1;
}

enum { TIMES = 7 };

static int compare_double(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Seconds of the printed phase one (CPU time of one thread; -1: more than `limit`), then of ours and of both phases on one thread and on all (wall time,
 * the median of TIMES runs). */
static void growth(const stream *s, uint64_t first, uint32_t bits, double limit)
{
    uint32_t *table, *entry, *index = get(s->count, 4);
    uint64_t n = make_table(s, bits, &table, &entry);
    for (uint64_t i = 0; i < s->count; i++) index[i] = entry[s->index[i]];
    bool slow_enough = true;
    for (uint64_t m = first; m <= s->count; m = 2 * m > s->count && m < s->count ? s->count : 2 * m) {
        svo_algorithm1_result r;
        svo_error err;
        double slow = slow_enough ? brute_force(index, m, n, limit) : -1, large[2], all[2];
        for (int k = 0; k < 2; k++) {
            double both[TIMES], one[TIMES];
            for (int t = 0; t < TIMES; t++) {
                double started = svo_seconds();
                if (svo_algorithm1(index, m, n, 64, k == 0 ? 1 : s->threads, NULL, &r, &err) != SVO_OK) die(err.message);
                both[t] = svo_seconds() - started;
                one[t] = r.seconds_large;
                svo_algorithm1_free(&r, NULL);
            }
            qsort(both, TIMES, sizeof *both, compare_double);
            qsort(one, TIMES, sizeof *one, compare_double);
            all[k] = both[TIMES / 2], large[k] = one[TIMES / 2];
        }
        printf("%s,%u,%llu,%.3f,%.5f,%.5f,%.4f,%.4f,%.0f\n", s->name, bits, (unsigned long long)m, slow, large[0], large[1], all[0], all[1], slow > 0 ? slow / large[1] : -1);
        slow_enough = slow >= 0;
    }
    free(table), free(entry), free(index);
}

/* --- two endpoints and variable weights -------------------------------------------------------------------------- */

enum { MACRO = 16384 };
typedef struct weighted { uint64_t begin, at; uint32_t bits; uint32_t a, b; } weighted; /* endpoints as colours */
typedef struct dolonius {
    uint64_t count, capacity, *macro; /* first block of each macro block */
    weighted *block;
    uint8_t *data;
} dolonius;

static uint32_t decode_dolonius(const void *coded, uint64_t i)
{
    const dolonius *d = coded;
    uint64_t low = d->macro[i / MACRO], n = d->macro[i / MACRO + 1] - low;
    const weighted *b = d->block + low;
    while (n > 1) {
        uint64_t half = n / 2;
        if (b[half].begin <= i) b += half;
        n -= half;
    }
    if (b->bits == 0) return b->a;
    uint32_t weight = (uint32_t)svo_palette_bits(d->data, b->at + (i - b->begin) * b->bits, b->bits);
    return svo_line_point(SVO_KIND_COLOR_SRGB8, b->a, b->b, weight, (1u << b->bits) - 1);
}

static uint32_t as565(const double c[3])
{
    uint32_t out = 0;
    for (int k = 0; k < 3; k++) {
        int most = k == 1 ? 63 : 31, q = (int)(c[k] / 255 * most + 0.5);
        q = q < 0 ? 0 : q > most ? most : q;
        out |= (uint32_t)((q * 255 * 2 + most) / (2 * most)) << 8 * k;
    }
    return out;
}

/* Best line for values [i, j) with 2^bits weights: false when a value is farther than `limit` (RGB, 0..255) away. */
static bool fit_line(const stream *s, uint64_t i, uint64_t j, uint32_t bits, double limit, weighted *w, uint8_t *weights)
{
    double mean[3] = {0, 0, 0}, m[6] = {0}, v[3], low = 0, high = 0, n = (double)(j - i);
    for (uint64_t k = i; k < j; k++)
        for (int c = 0; c < 3; c++) mean[c] += (double)(s->v[k] >> 8 * c & 255) / n;
    for (uint64_t k = i; k < j; k++) {
        double x = (double)(s->v[k] & 255) - mean[0], y = (double)(s->v[k] >> 8 & 255) - mean[1], z = (double)(s->v[k] >> 16) - mean[2];
        m[0] += x * x, m[1] += x * y, m[2] += x * z, m[3] += y * y, m[4] += y * z, m[5] += z * z;
    }
    v[0] = m[0] + m[1] + m[2], v[1] = m[1] + m[3] + m[4], v[2] = m[2] + m[4] + m[5];
    for (int it = 0; it < 6; it++) {
        double x = m[0] * v[0] + m[1] * v[1] + m[2] * v[2], y = m[1] * v[0] + m[3] * v[1] + m[4] * v[2], z = m[2] * v[0] + m[4] * v[1] + m[5] * v[2];
        double l = sqrt(x * x + y * y + z * z);
        if (!(l > 0)) break;
        v[0] = x / l, v[1] = y / l, v[2] = z / l;
    }
    for (uint64_t k = i; k < j && bits != 0; k++) {
        double t = 0;
        for (int c = 0; c < 3; c++) t += ((double)(s->v[k] >> 8 * c & 255) - mean[c]) * v[c];
        low = t < low ? t : low, high = t > high ? t : high;
    }
    double a[3], b[3];
    for (int c = 0; c < 3; c++) a[c] = mean[c] + v[c] * low, b[c] = mean[c] + v[c] * high;
    w->a = as565(a), w->b = as565(b), w->bits = bits, w->begin = i;
    uint32_t points = 1u << bits, point[16];
    for (uint32_t q = 0; q < points; q++) point[q] = bits == 0 ? w->a : svo_line_point(SVO_KIND_COLOR_SRGB8, w->a, w->b, q, points - 1);
    for (uint64_t k = i; k < j; k++) {
        double best = 1e30;
        for (uint32_t q = 0; q < points; q++) {
            double d = 0;
            for (int c = 0; c < 24; c += 8) {
                double x = (double)(s->v[k] >> c & 255) - (double)(point[q] >> c & 255);
                d += x * x;
            }
            if (d < best) best = d, weights[k - i] = (uint8_t)q;
        }
        if (best > limit * limit) return false;
    }
    return true;
}

/* Greedy: from each begin, the longest block for 0..4 bits a weight (doubled, then halved), the cheapest a value taken. */
static void two_endpoints(const stream *s, double threshold)
{
    dolonius d = {.macro = get(s->count / MACRO + 2, 8), .data = get(s->count, 1)};
    static uint8_t weights[MACRO], best_weights[MACRO];
    uint64_t at = 0, bits = 0;
    double started = cpu_seconds(), limit = threshold * 255 * 1.0;
    for (uint64_t i = 0; i < s->count;) {
        uint64_t end = (i / MACRO + 1) * MACRO < s->count ? (i / MACRO + 1) * MACRO : s->count;
        if (i % MACRO == 0) d.macro[i / MACRO] = d.count;
        weighted best = {0}, w;
        uint64_t best_n = 0;
        double least = 1e30;
        for (uint32_t b = 0; b <= 4; b++) {
            uint64_t good = 0, step = 1;
            while (i + good + step <= end && fit_line(s, i, i + good + step, b, limit, &w, weights)) good += step, step *= 2;
            for (; step > 0; step /= 2)
                if (i + good + step <= end && fit_line(s, i, i + good + step, b, limit, &w, weights)) good += step;
            if (good == 0) {
                if (b < 4 || best_n != 0) continue;
                good = 1; /* two endpoints of 16 bits cannot hold it any better */
            }
            double cost = (64.0 + (double)(good * b)) / (double)good;
            if (cost < least) {
                fit_line(s, i, i + good, b, 1e9, &w, weights);
                least = cost, best = w, best_n = good;
                memcpy(best_weights, weights, good);
            }
        }
        if (d.count == d.capacity) d.block = realloc(d.block, (d.capacity = 2 * d.capacity + 1024) * sizeof *d.block);
        if (d.block == NULL) die("out of memory");
        best.at = at;
        d.block[d.count++] = best;
        for (uint64_t k = 0; k < best_n; k++)
            for (uint32_t b = 0; b < best.bits; b++, at++) d.data[at / 8] |= (uint8_t)((best_weights[k] >> b & 1) << at % 8);
        bits += 64 + best_n * best.bits;
        i += best_n;
    }
    d.macro[(s->count + MACRO - 1) / MACRO] = d.count;
    bits += (s->count + MACRO - 1) / MACRO * 64;
    char setting[32];
    snprintf(setting, sizeof setting, "threshold %g", threshold);
    line(s, "two endpoints", setting, bits, cpu_seconds() - started, decode_dolonius, &d);
    free(d.macro), free(d.data), free(d.block);
}

int main(int argc, char **argv)
{
    const char *channel = "color", *methods = "ado";
    double goal[4] = {-1, 0, 0, 12};
    uint32_t threads = 1;
    uint64_t brute = 0;
    const char *brute_bits = "12";
    double brute_limit = 20;
    bool as_is = false;
    int i = 1;
    for (; i + 1 < argc && argv[i][0] == '-'; i += 2) {
        if (argv[i][1] == 'c') channel = argv[i + 1];
        else if (argv[i][1] == 't') threads = (uint32_t)atoi(argv[i + 1]);
        else if (argv[i][1] == 'r') as_is = atoi(argv[i + 1]) != 0;
        else if (argv[i][1] == 'b') brute = (uint64_t)atoll(argv[i + 1]);
        else if (argv[i][1] == 'k') brute_bits = argv[i + 1];
        else if (argv[i][1] == 'l') brute_limit = atof(argv[i + 1]);
        else if (argv[i][1] == 'm') methods = argv[i + 1];
        else if (argv[i][1] != 'x' || sscanf(argv[i + 1], "%lf,%lf,%lf,%lf", &goal[0], &goal[1], &goal[2], &goal[3]) != 4) die("unknown option");
    }
    if (i >= argc) die("usage: bench_attributes [-r 1] [-c CHANNEL] [-t THREADS] [-b N [-k BITS,...] [-l SECONDS]] [-m METHODS] [-x BOUND,PRICE,SQUARES,BITS] FILE.svdag ...");
    for (; as_is && i < argc; i++) read_channels(argv[i]);
    if (as_is) return 0;
    if (brute == 0) puts("stream,method,setting,bits_per_value,mean_delta_e,max_delta_e,psnr,max_byte,million_per_cpu_second,random_access_ns");
    for (; i < argc; i++) {
        stream s = {.threads = threads};
        load(argv[i], channel, &s);
        fprintf(stderr, "%s: %llu values, %llu different\n", s.name, (unsigned long long)s.count, (unsigned long long)s.distinct);
        if (brute != 0) {
            puts("stream,bits,values,printed_s,phase_one_s,phase_one_all_threads_s,both_s,both_all_threads_s,ratio");
            for (const char *b = brute_bits; *b != 0; b += strcspn(b, ","), b += *b == ',') growth(&s, brute, (uint32_t)atoi(b), brute_limit);
            methods = "";
        }
        if (goal[0] >= 0) {
            ours(&s, goal[0], goal[1], goal[2] != 0, (uint32_t)goal[3], true, "as given");
            methods = "";
        }
        if (strchr(methods, 'a'))
            for (uint32_t bits = 6; bits <= 14; bits++) algorithm1(&s, bits);
        if (strchr(methods, 'd'))
            for (int k = 0; k < 3; k++) two_endpoints(&s, (const double[]){0.02, 0.05, 0.1}[k]);
        if (strchr(methods, 'o')) {
            static const double bounds[] = {0.5, 1, 2, 3, 5}, prices[] = {30, 10, 5, 3, 2, 1, 0.5}, squares[] = {0.3, 0.1, 0.05, 0.03, 0.02, 0.01};
            static const uint32_t bound_bits[] = {14, 13, 12, 11, 11}, price_bits[] = {14, 13, 12, 11, 11, 11, 11}; /* as svo-compress has them */
            char setting[48];
            ours(&s, 0, 0, false, 16, false, "exact");
            for (size_t k = 0; k < sizeof bounds / sizeof *bounds; k++) {
                snprintf(setting, sizeof setting, "deltaE=%g", bounds[k]);
                ours(&s, bounds[k], 0.1 / bounds[k], false, bound_bits[k], false, setting);
            }
            for (size_t k = 0; k < sizeof prices / sizeof *prices; k++) {
                snprintf(setting, sizeof setting, "deltaE=6 %g bits a unit", prices[k]);
                ours(&s, 6, prices[k], false, price_bits[k], false, setting);
            }
            for (size_t k = 0; k < sizeof squares / sizeof *squares; k++) {
                snprintf(setting, sizeof setting, "deltaE=8 %g bits a square", squares[k]);
                ours(&s, 8, squares[k], true, 11, false, setting);
            }
        }
        free(s.v), free(s.index), free(s.value), free(s.times);
    }
    return 0;
}
