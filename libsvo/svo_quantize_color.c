/* Colour tables. By number: variance cut (Wu-like, on the weighted distinct colours), then Lloyd's k-means, all in
 * CIELAB. By bound: a greedy cover, the most frequent colour first. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_color.h"
#include "svo_morton.h"
#include "svo_task.h"
#include "svoi_quantize.h"
#include "svoi_compare.h"
#ifdef __AVX2__
#include "svoi_compress_avx2.h"
#endif

/* --- variance cut ------------------------------------------------------------------------------------------------- */

typedef struct box {
    uint32_t begin, end; /* in the order */
    double mean[3], error; /* weighted squared distance to the mean */
    int axis;              /* of largest variance */
} box;

typedef struct bounds { float low[3], high[3]; } bounds;

typedef struct cluster {
    const svoi_colors *c;
    uint32_t *order; /* colours, grouped by box */
    box *boxes;
    uint32_t *heap; /* boxes, largest error first (ties: smaller number) */
    uint32_t count, capacity;
    float (*center)[3];
    uint32_t *own;    /* center of each colour */
    uint32_t *sorted; /* colours along a Morton curve through CIELAB; in the place of `order`, which is not needed any more */
    bounds *node;     /* of a binary tree over `sorted`: node i halves into 2i + 1 and 2i + 2 */
    uint32_t levels;  /* of the tree */
} cluster;

static void measure(cluster *k, box *b)
{
    double sum[3] = {0, 0, 0}, square[3] = {0, 0, 0}, weight = 0;
    for (uint32_t i = b->begin; i < b->end; i++) {
        const float *lab = k->c->lab[k->order[i]];
        double w = (double)k->c->times[k->order[i]];
        weight += w;
        for (int j = 0; j < 3; j++) sum[j] += w * lab[j], square[j] += w * lab[j] * lab[j];
    }
    b->error = 0;
    double most = -1;
    for (int j = 0; j < 3; j++) {
        b->mean[j] = sum[j] / weight;
        double e = square[j] - sum[j] * b->mean[j];
        if (e < 0) e = 0;
        b->error += e;
        if (e > most) most = e, b->axis = j;
    }
    if (b->end - b->begin == 1) b->error = 0;
}

static bool larger(const cluster *k, uint32_t x, uint32_t y)
{
    return k->boxes[x].error > k->boxes[y].error || (k->boxes[x].error == k->boxes[y].error && x < y);
}

static void sift_down(cluster *k, uint32_t i, uint32_t size)
{
    for (;;) {
        uint32_t child = 2 * i + 1;
        if (child >= size) return;
        if (child + 1 < size && larger(k, k->heap[child + 1], k->heap[child])) child++;
        if (!larger(k, k->heap[child], k->heap[i])) return;
        uint32_t t = k->heap[i];
        k->heap[i] = k->heap[child];
        k->heap[child] = t;
        i = child;
    }
}

static void sift_up(cluster *k, uint32_t i)
{
    while (i != 0 && larger(k, k->heap[i], k->heap[(i - 1) / 2])) {
        uint32_t t = k->heap[i];
        k->heap[i] = k->heap[(i - 1) / 2];
        k->heap[(i - 1) / 2] = t;
        i = (i - 1) / 2;
    }
}

/* Colours below the mean of the axis first; returns where the others begin. Neither side is empty when the variance
 * is not 0, but rounding may make it so. */
static uint32_t partition(cluster *k, const box *b)
{
    uint32_t i = b->begin, j = b->end;
    while (i < j) {
        if ((double)k->c->lab[k->order[i]][b->axis] < b->mean[b->axis]) {
            i++;
        } else {
            j--;
            uint32_t t = k->order[i];
            k->order[i] = k->order[j];
            k->order[j] = t;
        }
    }
    return i;
}

static void cut(cluster *k)
{
    k->boxes[0] = (box){.begin = 0, .end = (uint32_t)k->c->count};
    measure(k, &k->boxes[0]);
    k->heap[0] = 0;
    k->count = 1;
    while (k->count < k->capacity) {
        box *b = &k->boxes[k->heap[0]];
        if (!(b->error > 0)) return;
        uint32_t middle = partition(k, b);
        if (middle == b->begin || middle == b->end) { /* cannot be split in double precision */
            b->error = 0;
            sift_down(k, 0, k->count);
            continue;
        }
        k->boxes[k->count] = (box){.begin = middle, .end = b->end};
        b->end = middle;
        measure(k, b);
        measure(k, &k->boxes[k->count]);
        sift_down(k, 0, k->count);
        k->heap[k->count] = k->count;
        sift_up(k, k->count);
        k->count++;
    }
}

/* --- k-means ------------------------------------------------------------------------------------------------------ */

/* Colours of a node of the tree. */
static void node_range(const cluster *k, uint32_t level, uint64_t place, uint64_t *begin, uint64_t *end)
{
    *begin = place * k->c->count >> level;
    *end = (place + 1) * k->c->count >> level;
}

/* Centers that may be nearest, component by component, ascending numbers. */
typedef struct candidates {
    float *x[3];
    uint32_t *number;
    double *least; /* scratch */
} candidates;

/* Colours [begin, end) of `sorted`: the nearest of `count` candidates. Ties: the smaller number. */
static void assign_leaf(cluster *k, uint64_t begin, uint64_t end, const candidates *near, uint32_t count)
{
    for (uint64_t i = begin; i < end; i++) {
        const float *lab = k->c->lab[k->sorted[i]];
        double best = INFINITY, a = lab[0], b = lab[1], c = lab[2];
        uint32_t own = 0;
        for (uint32_t m = 0; m < count; m++) {
            double x = a - near->x[0][m], y = b - near->x[1][m], z = c - near->x[2][m], d = x * x + y * y + z * z;
            if (d < best) best = d, own = m;
        }
        k->own[k->sorted[i]] = near->number[own];
    }
}

/* Squared distances from a box to `count` points: the least to each, and the least of the greatest. With AVX2 up to
 * three more points are read and distances written. */
#ifdef __AVX2__
static __m256d lanes_below(uint32_t count)
{
    return _mm256_castsi256_pd(_mm256_cvtepi32_epi64(_mm_cmpgt_epi32(_mm_set1_epi32(count < 4 ? (int)count : 4), _mm_setr_epi32(0, 1, 2, 3))));
}

static double box_distances(const bounds *b, const candidates *near, uint32_t count, double *restrict least)
{
    const __m256d sign = _mm256_set1_pd(-0.0), zero = _mm256_setzero_pd();
    __m256d low[3], high[3], bound = _mm256_set1_pd(INFINITY);
    for (int j = 0; j < 3; j++) low[j] = _mm256_set1_pd(b->low[j]), high[j] = _mm256_set1_pd(b->high[j]);
    for (uint32_t m = 0; m < count; m += 4) {
        __m256d close = zero, away = zero;
        for (int j = 0; j < 3; j++) {
            __m256d p = _mm256_cvtps_pd(_mm_loadu_ps(near->x[j] + m)), below = _mm256_sub_pd(low[j], p), above = _mm256_sub_pd(p, high[j]);
            __m256d d = _mm256_max_pd(_mm256_max_pd(below, above), zero), far = _mm256_max_pd(_mm256_xor_pd(below, sign), _mm256_xor_pd(above, sign));
            close = _mm256_add_pd(close, _mm256_mul_pd(d, d));
            away = _mm256_add_pd(away, _mm256_mul_pd(far, far));
        }
        _mm256_storeu_pd(least + m, close);
        bound = _mm256_min_pd(bound, _mm256_blendv_pd(bound, away, lanes_below(count - m)));
    }
    __m128d two = _mm_min_pd(_mm256_castpd256_pd128(bound), _mm256_extractf128_pd(bound, 1));
    return _mm_cvtsd_f64(_mm_min_sd(two, _mm_unpackhi_pd(two, two)));
}

/* Those of `count` candidates within the bound, to `kept`; returns their number. Up to four more are written. */
static uint32_t keep_near(const candidates *near, uint32_t count, double bound, const candidates *kept)
{
    uint32_t n = 0;
    for (uint32_t m = 0; m < count; m += 4) {
        __m256d within = _mm256_and_pd(_mm256_cmp_pd(_mm256_loadu_pd(near->least + m), _mm256_set1_pd(bound), _CMP_LE_OQ), lanes_below(count - m));
        uint32_t mask = (uint32_t)_mm256_movemask_pd(within);
        for (int j = 0; j < 3; j++) keep_floats(kept->x[j] + n, mask, _mm_loadu_ps(near->x[j] + m));
        keep_words((int32_t *)kept->number + n, mask, _mm_loadu_si128((const __m128i *)(near->number + m)));
        n += (uint32_t)__builtin_popcount(mask);
    }
    return n;
}
#else
static double box_distances(const bounds *b, const candidates *near, uint32_t count, double *restrict least)
{
    double low[3], high[3], bound = INFINITY;
    for (int j = 0; j < 3; j++) low[j] = b->low[j], high[j] = b->high[j];
    for (uint32_t m = 0; m < count; m++) {
        double close = 0, away = 0;
        for (int j = 0; j < 3; j++) {
            double p = near->x[j][m], below = low[j] - p, above = p - high[j], d = below > above ? below : above;
            double far = -below > -above ? -below : -above; /* p - low, high - p */
            d = d > 0 ? d : 0;
            close += d * d;
            away += far * far;
        }
        least[m] = close;
        bound = away < bound ? away : bound;
    }
    return bound;
}

static uint32_t keep_near(const candidates *near, uint32_t count, double bound, const candidates *kept)
{
    uint32_t n = 0;
    for (uint32_t m = 0; m < count; m++) {
        for (int j = 0; j < 3; j++) kept->x[j][n] = near->x[j][m];
        kept->number[n] = near->number[m];
        n += near->least[m] <= bound;
    }
    return n;
}
#endif

/* The nearest center of every colour below a node, exactly: on the way down only those centers are kept that can be
 * nearest to some point of the node's box (Kanungo et al. 2002). near's `count` are given; space behind them is scratch. */
static void assign_node(cluster *k, uint32_t level, uint64_t place, const candidates *near, uint32_t count)
{
    uint64_t begin, end;
    node_range(k, level, place, &begin, &end);
    double bound = box_distances(&k->node[((uint64_t)1 << level) - 1 + place], near, count, near->least) * (1 + 1e-9);
    candidates kept = {{near->x[0] + count, near->x[1] + count, near->x[2] + count}, near->number + count, near->least};
    uint32_t n = keep_near(near, count, bound, &kept);
    if (level == k->levels || n == 1) {
        assign_leaf(k, begin, end, &kept, n);
        return;
    }
    assign_node(k, level + 1, 2 * place, &kept, n);
    assign_node(k, level + 1, 2 * place + 1, &kept, n);
}

enum { TASK_LEVEL = 6, LEAF = 8 };

static svo_result assign(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    cluster *k = user;
    const svo_allocator *a = k->c->a;
    uint64_t space = (uint64_t)k->count * (k->levels + 2) + 4, least = (uint64_t)k->count + 3; /* what is not kept is written, too */
    candidates near;
    for (int j = 0; j < 3; j++) near.x[j] = svo_alloc(a, space, sizeof *near.x[j]);
    near.number = svo_alloc(a, space, sizeof *near.number);
    near.least = svo_alloc(a, least, sizeof *near.least);
    svo_result r = near.x[0] == NULL || near.x[1] == NULL || near.x[2] == NULL || near.number == NULL || near.least == NULL
                       ? svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (colours)")
                       : SVO_OK;
    if (r == SVO_OK) {
        for (uint32_t m = 0; m < k->count; m++) {
            near.number[m] = m;
            for (int j = 0; j < 3; j++) near.x[j][m] = k->center[m][j];
        }
        uint32_t level = k->levels < TASK_LEVEL ? k->levels : TASK_LEVEL;
        for (uint64_t place = begin; place < end; place++) assign_node(k, level, place, &near, k->count);
    }
    for (int j = 0; j < 3; j++) svo_free(a, near.x[j], space, sizeof *near.x[j]);
    svo_free(a, near.number, space, sizeof *near.number);
    svo_free(a, near.least, least, sizeof *near.least);
    return r;
}

static svo_result make_tree(cluster *k, svo_error *err)
{
    const svoi_colors *c = k->c;
    uint64_t *order = svo_alloc(c->a, c->count, sizeof *order); /* 33 bits of the curve, 24 of a number */
    if (order == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (colours)");
    k->sorted = k->order;
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t at[3];
        for (int j = 0; j < 3; j++) {
            double v = (c->lab[i][j] + (j == 0 ? 0 : 128)) * 8;
            at[j] = v > 0 ? (uint32_t)v : 0;
        }
        order[i] = svo_morton_encode(at[0], at[1], at[2]) << 24 | i;
    }
    qsort(order, (size_t)c->count, sizeof *order, svoi_compare_u64);
    for (uint64_t i = 0; i < c->count; i++) k->sorted[i] = (uint32_t)order[i] & 0xffffff;
    svo_free(c->a, order, c->count, sizeof *order);
    for (uint32_t level = k->levels + 1; level-- > 0;)
        for (uint64_t place = 0; place < (uint64_t)1 << level; place++) {
            uint64_t at = ((uint64_t)1 << level) - 1 + place, begin, end;
            bounds *b = &k->node[at];
            if (level < k->levels) {
                const bounds *x = &k->node[2 * at + 1], *y = &k->node[2 * at + 2];
                for (int j = 0; j < 3; j++) {
                    b->low[j] = x->low[j] < y->low[j] ? x->low[j] : y->low[j];
                    b->high[j] = x->high[j] > y->high[j] ? x->high[j] : y->high[j];
                }
                continue;
            }
            node_range(k, level, place, &begin, &end);
            for (uint64_t i = begin; i < end; i++)
                for (int j = 0; j < 3; j++) {
                    float v = c->lab[k->sorted[i]][j];
                    if (i == begin || v < b->low[j]) b->low[j] = v;
                    if (i == begin || v > b->high[j]) b->high[j] = v;
                }
        }
    return SVO_OK;
}

/* Means of what belongs to each center, in Lab or (rgb) in sRGB; summed in the order of the colours. */
static svo_result average(cluster *k, bool rgb, svo_error *err)
{
    double(*sum)[4] = svo_calloc(k->c->a, k->count, sizeof *sum);
    if (sum == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (colours)");
    for (uint64_t i = 0; i < k->c->count; i++) {
        double w = (double)k->c->times[i], *s = sum[k->own[i]];
        uint8_t bytes[3];
        svoi_rgb_bytes(k->c->rgb[i], bytes);
        for (int j = 0; j < 3; j++) s[j] += w * (rgb ? (double)bytes[j] : (double)k->c->lab[i][j]);
        s[3] += w;
    }
    for (uint32_t m = 0; m < k->count; m++)
        if (sum[m][3] > 0) /* a center that lost all its colours stays where it is */
            for (int j = 0; j < 3; j++) k->center[m][j] = (float)(sum[m][j] / sum[m][3]);
    svo_free(k->c->a, sum, k->count, sizeof *sum);
    return SVO_OK;
}

enum { ITERATIONS = 2 };

static svo_result run_cluster(cluster *k, uint32_t *mapped, svo_error *err)
{
    for (uint64_t i = 0; i < k->c->count; i++) k->order[i] = (uint32_t)i;
    cut(k);
    SVO_TRY(make_tree(k, err));
    uint64_t tasks = (uint64_t)1 << (k->levels < TASK_LEVEL ? k->levels : TASK_LEVEL);
    for (uint32_t m = 0; m < k->count; m++)
        for (int j = 0; j < 3; j++) k->center[m][j] = (float)k->boxes[m].mean[j];
    for (int i = 0; i < ITERATIONS; i++) {
        SVO_TRY(svo_parallel_for(k->c->threads, tasks, 1, assign, k, err));
        SVO_TRY(average(k, i + 1 == ITERATIONS, err)); /* at last as a colour that can be stored */
    }
    for (uint64_t i = 0; i < k->c->count; i++) {
        const float *m = k->center[k->own[i]];
        mapped[i] = (uint32_t)(m[0] + 0.5f) | (uint32_t)(m[1] + 0.5f) << 8 | (uint32_t)(m[2] + 0.5f) << 16;
    }
    return SVO_OK;
}

svo_result svoi_cluster_colors(const svoi_colors *c, uint32_t colors, uint32_t *mapped, svo_error *err)
{
    if (c->count <= colors) {
        memcpy(mapped, c->rgb, (size_t)c->count * sizeof *mapped);
        return SVO_OK;
    }
    cluster k = {.c = c, .capacity = colors};
    while (c->count >> k.levels > LEAF) k.levels++;
    uint64_t nodes = ((uint64_t)2 << k.levels) - 1;
    k.node = svo_alloc(c->a, nodes, sizeof *k.node);
    k.order = svo_alloc(c->a, c->count, sizeof *k.order);
    k.own = svo_calloc(c->a, c->count, sizeof *k.own);
    k.boxes = svo_alloc(c->a, colors, sizeof *k.boxes);
    k.heap = svo_alloc(c->a, colors, sizeof *k.heap);
    k.center = svo_alloc(c->a, colors, sizeof *k.center);
    svo_result r = k.order == NULL || k.own == NULL || k.boxes == NULL || k.heap == NULL || k.center == NULL || k.node == NULL
                       ? svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (colours)")
                       : run_cluster(&k, mapped, err);
    svo_free(c->a, k.order, c->count, sizeof *k.order);
    svo_free(c->a, k.own, c->count, sizeof *k.own);
    svo_free(c->a, k.boxes, colors, sizeof *k.boxes);
    svo_free(c->a, k.heap, colors, sizeof *k.heap);
    svo_free(c->a, k.center, colors, sizeof *k.center);
    svo_free(c->a, k.node, nodes, sizeof *k.node);
    return r;
}

/* --- cells of CIELAB: to look only at what is near ---------------------------------------------------------------- */

/* L* is 0..100, a* and b* of sRGB lie in -108..108. */
typedef struct cells {
    double edge;
    int32_t n[3];
    uint64_t count;
    uint64_t *begin; /* of a cell in items; count + 1 */
    uint32_t *items; /* colours by cell */
    uint64_t item_count;
} cells;

static int32_t cell_axis(const cells *c, int axis, double v)
{
    double low = axis == 0 ? 0 : -110;
    double at = floor((v - low) / c->edge);
    if (at < 0) return 0;
    return at >= c->n[axis] ? c->n[axis] - 1 : (int32_t)at;
}

static uint64_t cell_of(const cells *c, const float lab[3])
{
    return ((uint64_t)cell_axis(c, 0, lab[0]) * (uint64_t)c->n[1] + (uint64_t)cell_axis(c, 1, lab[1])) * (uint64_t)c->n[2] +
           (uint64_t)cell_axis(c, 2, lab[2]);
}

static void cells_free(cells *c, const svo_allocator *a)
{
    svo_free(a, c->begin, c->count + 1, sizeof *c->begin);
    svo_free(a, c->items, c->item_count, sizeof *c->items);
}

static svo_result cells_make(const svoi_colors *colors, double edge, cells *c, svo_error *err)
{
    *c = (cells){.edge = edge, .item_count = colors->count};
    for (int i = 0; i < 3; i++) c->n[i] = (int32_t)((i == 0 ? 100.0 : 220.0) / edge) + 1;
    c->count = (uint64_t)c->n[0] * (uint64_t)c->n[1] * (uint64_t)c->n[2];
    c->begin = svo_calloc(colors->a, c->count + 1, sizeof *c->begin);
    c->items = svo_alloc(colors->a, c->item_count, sizeof *c->items);
    if (c->begin == NULL || c->items == NULL) {
        cells_free(c, colors->a);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (colours)");
    }
    for (uint64_t i = 0; i < colors->count; i++) c->begin[cell_of(c, colors->lab[i]) + 1]++;
    for (uint64_t i = 0; i < c->count; i++) c->begin[i + 1] += c->begin[i];
    for (uint64_t i = 0; i < colors->count; i++) c->items[c->begin[cell_of(c, colors->lab[i])]++] = (uint32_t)i;
    for (uint64_t i = c->count; i-- > 0;) c->begin[i + 1] = c->begin[i];
    c->begin[0] = 0;
    return SVO_OK;
}

/* --- cover -------------------------------------------------------------------------------------------------------- */

typedef struct ranked { uint64_t times; uint32_t color; } ranked;

static int compare_ranked(const void *a, const void *b)
{
    const ranked *x = a, *y = b;
    if (x->times != y->times) return x->times > y->times ? -1 : 1;
    return (x->color > y->color) - (x->color < y->color);
}

/* CIE94 is at least the Euclidean distance / (1 + 0.045 C), C the chroma of the covered colour, which is at most that
 * of the center + the distance. Hence the radius within which all colours lie that the center may cover. */
static double cover_radius(const float lab[3], double bound)
{
    double chroma = sqrt((double)lab[1] * lab[1] + (double)lab[2] * lab[2]);
    double shrink = 1 - 0.045 * bound;
    return shrink > 0 ? bound * (1 + 0.045 * chroma) / shrink * 1.0001 + 1e-3 : INFINITY;
}

static void cover_from(const svoi_colors *c, cells *cell, uint32_t center, double bound, bool *covered, uint32_t *mapped)
{
    const float *lab = c->lab[center];
    double radius = cover_radius(lab, bound);
    int32_t low[3], high[3];
    for (int i = 0; i < 3; i++) low[i] = cell_axis(cell, i, lab[i] - radius), high[i] = cell_axis(cell, i, lab[i] + radius);
    for (int32_t x = low[0]; x <= high[0]; x++)
        for (int32_t y = low[1]; y <= high[1]; y++)
            for (int32_t z = low[2]; z <= high[2]; z++) {
                uint64_t at = ((uint64_t)x * (uint64_t)cell->n[1] + (uint64_t)y) * (uint64_t)cell->n[2] + (uint64_t)z;
                for (uint64_t i = cell->begin[at]; i < cell->begin[at + 1]; i++) {
                    uint32_t other = cell->items[i];
                    if (covered[other] || svo_delta_e94(c->lab[other], lab) > bound) continue;
                    covered[other] = true;
                    mapped[other] = c->rgb[center];
                }
            }
}

svo_result svoi_cover_colors(const svoi_colors *c, double bound, uint32_t *mapped, svo_error *err)
{
    cells cell;
    /* small enough to skip what is far, large enough that walking empty cells costs little */
    SVO_TRY(cells_make(c, bound < 2 ? 2 : bound > 50 ? 50 : bound, &cell, err));
    ranked *order = svo_alloc(c->a, c->count, sizeof *order);
    bool *covered = svo_calloc(c->a, c->count, sizeof *covered);
    svo_result r = order == NULL || covered == NULL ? svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (colours)") : SVO_OK;
    if (r == SVO_OK) {
        for (uint64_t i = 0; i < c->count; i++) order[i] = (ranked){c->times[i], (uint32_t)i};
        qsort(order, (size_t)c->count, sizeof *order, compare_ranked);
        for (uint64_t i = 0; i < c->count; i++)
            if (!covered[order[i].color]) cover_from(c, &cell, order[i].color, bound, covered, mapped);
    }
    svo_free(c->a, order, c->count, sizeof *order);
    svo_free(c->a, covered, c->count, sizeof *covered);
    cells_free(&cell, c->a);
    return r;
}
