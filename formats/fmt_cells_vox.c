/* MagicaVoxel's .vox, as its authors describe it (MagicaVoxel-file-format-vox.txt and -extension.txt): models of at most 256^3 cells under a scene graph. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_cells.h"
#include "fmt_container.h"
#include "svo_channel.h"
#include "svo_color.h"

enum { SIDE = 256, PALETTE = 255, ROUNDS = 5 };

/* --- colours --- */

typedef struct shade { uint8_t rgb[4]; uint64_t count; float lab[3]; uint32_t entry; } shade;
typedef struct box { uint64_t begin, end; } box;

typedef struct palette {
    shade *shades;
    uint64_t count, capacity;
    uint8_t entry[PALETTE][3];
    uint32_t entries;
    const svo_allocator *a;
} palette;

static int by_axis(const shade *a, const shade *b, int axis)
{
    if (a->lab[axis] != b->lab[axis]) return a->lab[axis] < b->lab[axis] ? -1 : 1;
    return memcmp(a->rgb, b->rgb, 3);
}
static int by_l(const void *a, const void *b) { return by_axis(a, b, 0); }
static int by_a(const void *a, const void *b) { return by_axis(a, b, 1); }
static int by_b(const void *a, const void *b) { return by_axis(a, b, 2); }
static int by_rgb(const void *a, const void *b) { return memcmp(a, b, 3); }

static svo_result count_shades(palette *p, const fmt_cells *c, svo_error *err)
{
    uint8_t (*all)[4] = svo_alloc(c->allocator, c->count, 4);
    if (all == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to count colours");
    for (uint64_t i = 0; i < c->count; i++) memcpy(all[i], c->cell[i].rgb, 4);
    qsort(all, c->count, 4, by_rgb);
    for (uint64_t i = 0; i < c->count; i++) p->capacity += i == 0 || memcmp(all[i], all[i - 1], 3) != 0;
    p->shades = svo_calloc(c->allocator, p->capacity, sizeof *p->shades);
    for (uint64_t i = 0; i < c->count && p->shades != NULL; i++) {
        if (i == 0 || memcmp(all[i], all[i - 1], 3) != 0) {
            shade *s = &p->shades[p->count++];
            memcpy(s->rgb, all[i], 4);
            svo_srgb8_to_lab(s->rgb, s->lab);
        }
        p->shades[p->count - 1].count++;
    }
    svo_free(c->allocator, all, c->count, 4);
    return p->shades != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to count colours");
}

/* Sum of squares about the mean, along the axis where it is largest. */
static double spread(const shade *s, uint64_t count, int *axis)
{
    double best = -1;
    for (int k = 0; k < 3; k++) {
        double n = 0, sum = 0, squares = 0;
        for (uint64_t i = 0; i < count; i++) n += (double)s[i].count, sum += (double)s[i].count * (double)s[i].lab[k];
        for (uint64_t i = 0; i < count; i++) {
            double d = (double)s[i].lab[k] - sum / n;
            squares += (double)s[i].count * d * d;
        }
        if (squares > best) best = squares, *axis = k;
    }
    return best;
}

/* Cut the box with the largest spread at the weighted median until there are PALETTE. */
static void median_cut(palette *p)
{
    static int (*const orders[3])(const void *, const void *) = {by_l, by_a, by_b};
    box boxes[PALETTE] = {{0, p->count}};
    double spreads[PALETTE];
    int axes[PALETTE];
    uint32_t count = 1;
    spreads[0] = spread(p->shades, p->count, &axes[0]);
    while (count < PALETTE) {
        uint32_t most = 0;
        for (uint32_t i = 1; i < count; i++)
            if (spreads[i] > spreads[most]) most = i;
        box b = boxes[most];
        if (b.end - b.begin < 2 || !(spreads[most] > 0)) break;
        shade *s = p->shades + b.begin;
        uint64_t n = b.end - b.begin, half = 0, sum = 0, middle = 1;
        qsort(s, n, sizeof *s, orders[axes[most]]);
        for (uint64_t i = 0; i < n; i++) half += s[i].count;
        for (uint64_t i = 0; i + 1 < n; i++) {
            sum += s[i].count;
            middle = i + 1;
            if (2 * sum >= half) break;
        }
        boxes[most].end = b.begin + middle;
        boxes[count] = (box){b.begin + middle, b.end};
        spreads[most] = spread(s, middle, &axes[most]);
        spreads[count] = spread(s + middle, n - middle, &axes[count]);
        count++;
    }
    for (uint32_t i = 0; i < count; i++)
        for (uint64_t k = boxes[i].begin; k < boxes[i].end; k++) p->shades[k].entry = i;
    p->entries = count;
}

/* The entry of each colour: the one that looks nearest. */
static void assign(palette *p, fmt_vox_report *report)
{
    float lab[PALETTE][3];
    double sum = 0, cells = 0;
    report->delta_max = 0;
    for (uint32_t e = 0; e < p->entries; e++) svo_srgb8_to_lab(p->entry[e], lab[e]);
    for (uint64_t i = 0; i < p->count; i++) {
        shade *s = &p->shades[i];
        double best = HUGE_VAL;
        for (uint32_t e = 0; e < p->entries; e++) {
            double d = svo_delta_e94(s->lab, lab[e]);
            if (d < best) best = d, s->entry = e;
        }
        sum += best * (double)s->count, cells += (double)s->count;
        report->delta_max = fmax(report->delta_max, best);
    }
    report->delta_mean = cells > 0 ? sum / cells : 0;
}

/* Entries become the mean of their colours, in linear light. */
static void recentre(palette *p)
{
    double sums[PALETTE][4] = {{0}};
    for (uint64_t i = 0; i < p->count; i++) {
        const shade *s = &p->shades[i];
        for (int k = 0; k < 3; k++) sums[s->entry][k] += (double)s->count * (double)svo_srgb_to_linear(s->rgb[k]);
        sums[s->entry][3] += (double)s->count;
    }
    for (uint32_t e = 0; e < p->entries; e++)
        for (int k = 0; k < 3 && sums[e][3] > 0; k++) p->entry[e][k] = svo_linear_to_srgb((float)(sums[e][k] / sums[e][3]));
}

static svo_result make_palette(palette *p, const fmt_cells *c, fmt_vox_report *report, svo_error *err)
{
    if (c->count == 0) return SVO_OK;
    SVO_TRY(count_shades(p, c, err));
    report->colors = p->count;
    if (p->count <= PALETTE) {
        p->entries = (uint32_t)p->count;
        for (uint32_t i = 0; i < p->entries; i++) {
            memcpy(p->entry[i], p->shades[i].rgb, 3);
            p->shades[i].entry = i;
        }
        return SVO_OK;
    }
    median_cut(p);
    for (int round = 0; round < ROUNDS; round++) {
        recentre(p);
        assign(p, report);
    }
    qsort(p->shades, p->count, sizeof *p->shades, by_rgb);
    return SVO_OK;
}

static uint8_t entry_of(const palette *p, const uint8_t rgb[4])
{
    const shade *s = bsearch(rgb, p->shades, p->count, sizeof *p->shades, by_rgb);
    return (uint8_t)(1 + (s != NULL ? s->entry : 0));
}

/* --- chunks --- */


static svo_result chunk(svo_buffer *b, const char *id, const void *content, uint32_t size, svo_error *err)
{
    uint8_t head[12];
    memcpy(head, id, 4);
    fmt_store32(head + 4, size);
    fmt_store32(head + 8, 0);
    if (svo_buffer_append(b, head, 12) == NULL || (size != 0 && svo_buffer_append(b, content, size) == NULL))
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the .vox file");
    return SVO_OK;
}

static uint32_t put_text(uint8_t *to, const char *text)
{
    uint32_t n = (uint32_t)strlen(text);
    fmt_store32(to, n);
    memcpy(to + 4, text, n);
    return 4 + n;
}

/* A transform node: attributes, child, reserved -1, layer -1, one frame with or without a translation. */
static svo_result transform(svo_buffer *b, uint32_t id, uint32_t child, const int64_t *t, svo_error *err)
{
    uint8_t c[200];
    char text[100];
    uint32_t n = 0;
    fmt_store32(c, id), fmt_store32(c + 4, 0), fmt_store32(c + 8, child);
    fmt_store32(c + 12, UINT32_MAX), fmt_store32(c + 16, UINT32_MAX), fmt_store32(c + 20, 1);
    n = 24;
    fmt_store32(c + n, t != NULL ? 1 : 0);
    n += 4;
    if (t != NULL) {
        snprintf(text, sizeof text, "%lld %lld %lld", (long long)t[0], (long long)t[1], (long long)t[2]);
        n += put_text(c + n, "_t");
        n += put_text(c + n, text);
    }
    return chunk(b, "nTRN", c, n, err);
}

static svo_result shape(svo_buffer *b, uint32_t id, uint32_t number, svo_error *err)
{
    uint8_t c[20];
    fmt_store32(c, id), fmt_store32(c + 4, 0), fmt_store32(c + 8, 1), fmt_store32(c + 12, number), fmt_store32(c + 16, 0);
    return chunk(b, "nSHP", c, sizeof c, err);
}

static svo_result group(svo_buffer *b, uint32_t id, uint32_t children, svo_error *err)
{
    svo_buffer c;
    uint8_t head[12], word[4];
    svo_buffer_init(&c, b->allocator);
    fmt_store32(head, id), fmt_store32(head + 4, 0), fmt_store32(head + 8, children);
    bool ok = svo_buffer_append(&c, head, 12) != NULL;
    for (uint32_t i = 0; i < children && ok; i++) {
        fmt_store32(word, 2 + 2 * i);
        ok = svo_buffer_append(&c, word, 4) != NULL;
    }
    svo_result r = ok ? chunk(b, "nGRP", c.data, (uint32_t)c.size, err) : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the .vox file");
    svo_buffer_free(&c);
    return r;
}

/* Cells in .vox axes: right-handed with +Z up, so x, -z, y; `top` turns -z to a number from 0 on. */
static void turn(const fmt_cell *c, uint32_t top, uint32_t out[3])
{
    out[0] = c->at[0], out[1] = top - c->at[2], out[2] = c->at[1];
}

typedef struct placed { uint64_t tile; uint64_t cell; } placed;

static int by_tile(const void *a, const void *b)
{
    const placed *x = a, *y = b;
    if (x->tile != y->tile) return x->tile < y->tile ? -1 : 1;
    return x->cell < y->cell ? -1 : x->cell > y->cell;
}

static svo_result write_models(const fmt_cells *c, const palette *p, placed *order, svo_buffer *b, svo_buffer *nodes, uint64_t *models, svo_error *err)
{
    uint32_t top = c->high[2];
    int64_t centre[3] = {((int64_t)c->low[0] + c->high[0] + 1) / 2, ((int64_t)c->high[2] - c->low[2] + 1) / 2, c->low[1]};
    for (uint64_t i = 0; i < c->count; i++) {
        uint32_t v[3];
        turn(&c->cell[i], top, v);
        order[i] = (placed){(uint64_t)(v[2] / SIDE) << 42 | (uint64_t)(v[1] / SIDE) << 21 | v[0] / SIDE, i};
    }
    qsort(order, c->count, sizeof *order, by_tile);
    for (uint64_t begin = 0, end; begin < c->count; begin = end) {
        uint32_t low[3] = {UINT32_MAX, UINT32_MAX, UINT32_MAX}, high[3] = {0}, v[3];
        for (end = begin; end < c->count && order[end].tile == order[begin].tile; end++) {
            turn(&c->cell[order[end].cell], top, v);
            for (int k = 0; k < 3; k++) low[k] = v[k] < low[k] ? v[k] : low[k], high[k] = v[k] > high[k] ? v[k] : high[k];
        }
        uint8_t size[12];
        int64_t t[3];
        for (int k = 0; k < 3; k++) {
            uint32_t n = high[k] - low[k] + 1;
            fmt_store32(size + 4 * k, n);
            t[k] = (int64_t)low[k] + n / 2 - centre[k]; /* of the model's cell n/2 */
        }
        SVO_TRY(chunk(b, "SIZE", size, sizeof size, err));
        uint8_t head[4];
        fmt_store32(head, (uint32_t)(end - begin)); /* at most 2^24 */
        SVO_TRY(chunk(b, "XYZI", head, 4, err));
        fmt_store32(b->data + b->size - 12, (uint32_t)(4 + 4 * (end - begin)));
        for (uint64_t i = begin; i < end; i++) {
            const fmt_cell *cell = &c->cell[order[i].cell];
            turn(cell, top, v);
            const uint8_t row[4] = {(uint8_t)(v[0] - low[0]), (uint8_t)(v[1] - low[1]), (uint8_t)(v[2] - low[2]), entry_of(p, cell->rgb)};
            if (svo_buffer_append(b, row, 4) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the .vox file");
        }
        uint32_t number = (uint32_t)*models;
        SVO_TRY(transform(nodes, 2 + 2 * number, 3 + 2 * number, t, err));
        SVO_TRY(shape(nodes, 3 + 2 * number, number, err));
        (*models)++;
    }
    return SVO_OK;
}

static svo_result write_file(const fmt_cells *c, const palette *p, fmt_output *out, fmt_vox_report *report, svo_error *err)
{
    svo_buffer body, nodes, graph;
    svo_buffer *all[3] = {&body, &nodes, &graph};
    for (int i = 0; i < 3; i++) svo_buffer_init(all[i], c->allocator);
    placed *order = c->count != 0 ? svo_alloc(c->allocator, c->count, sizeof *order) : NULL;
    svo_result r = order != NULL || c->count == 0 ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the .vox file");
    if (r == SVO_OK) r = write_models(c, p, order, &body, &nodes, &report->models, err);
    if (r == SVO_OK) r = transform(&graph, 0, 1, NULL, err);
    if (r == SVO_OK) r = group(&graph, 1, (uint32_t)report->models, err);
    uint8_t colors[1024] = {0};
    for (uint32_t e = 0; e < p->entries; e++) { /* entry 0 of the chunk is colour number 1 */
        memcpy(colors + 4 * e, p->entry[e], 3);
        colors[4 * e + 3] = 255;
    }
    if (r == SVO_OK && svo_buffer_append(&graph, nodes.data, nodes.size) == NULL && nodes.size != 0) r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the .vox file");
    if (r == SVO_OK) r = chunk(&graph, "RGBA", colors, sizeof colors, err);
    if (r == SVO_OK && body.size + graph.size > UINT32_MAX) r = svo_fail(err, SVO_LIMIT, "more than 4 GB, which a .vox file cannot say; export a coarser level");
    if (r == SVO_OK) {
        uint8_t head[20] = "VOX ";
        fmt_store32(head + 4, 200);
        memcpy(head + 8, "MAIN", 4);
        fmt_store32(head + 12, 0);
        fmt_store32(head + 16, (uint32_t)(body.size + graph.size));
        r = fmt_output_write(out, head, 20, err);
    }
    if (r == SVO_OK) r = fmt_output_write(out, body.data, body.size, err);
    if (r == SVO_OK) r = fmt_output_write(out, graph.data, graph.size, err);
    svo_free(c->allocator, order, c->count, sizeof *order);
    for (int i = 0; i < 3; i++) svo_buffer_free(all[i]);
    return r;
}

svo_result fmt_cells_vox(const fmt_cells *c, fmt_output *out, fmt_vox_report *report, svo_error *err)
{
    palette p = {.a = c->allocator};
    memset(report, 0, sizeof *report);
    svo_result r = make_palette(&p, c, report, err);
    if (r == SVO_OK) r = write_file(c, &p, out, report, err);
    svo_free(c->allocator, p.shades, p.capacity, sizeof *p.shades);
    return r;
}
