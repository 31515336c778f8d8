/* binvox (Patrick Min's run-length code), and what it has in common with .vox, which is in import_vox.c. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_container.h"
#include "import_text.h"
#include "import_vox.h"
#include "svo_morton.h"

static const uint64_t MOST = (uint64_t)1 << 31;

bool fmt_is_voxels(const uint8_t *data, uint64_t size)
{
    return size >= 8 && (memcmp(data, "VOX ", 4) == 0 || memcmp(data, "#binvox", 7) == 0);
}

svo_result import_cell(fmt_voxels *v, uint32_t x, uint32_t y, uint32_t z, const uint8_t *rgb, svo_error *err)
{
    fmt_cell c = {{x, y, z}, {255, 255, 255, 255}};
    if (rgb != NULL) memcpy(c.rgb, rgb, 3);
    if (v->cells.size / sizeof c >= MOST) return svo_fail(err, SVO_LIMIT, "more than 2^31 voxels");
    if (svo_buffer_append(&v->cells, &c, sizeof c) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the voxels");
    return SVO_OK;
}

/* --- text headers --- */

/* The next line of a header, without its end; NULL when there is none, or it is too long. */
static const char *next_line(const uint8_t *data, uint64_t size, uint64_t *at, char line[1024])
{
    uint64_t end = *at;
    while (end < size && data[end] != '\n') end++;
    uint64_t n = end - *at;
    if (end == size || n >= 1024) return NULL;
    memcpy(line, data + *at, n);
    if (n > 0 && line[n - 1] == '\r') n--;
    line[n] = 0;
    *at = end + 1;
    return line;
}

static bool sizes_of(const double *v, int n, uint64_t out[3])
{
    uint64_t cells = 1;
    for (int k = 0; k < n; k++) {
        if (!(v[k] >= 1 && v[k] <= 1 << 21 && v[k] == floor(v[k]))) return false;
        out[k] = (uint64_t)v[k];
        cells *= out[k]; /* at most 2^63 */
    }
    return cells != 0;
}

static void place(fmt_voxels *v, double dx, double dy, double dz, const double low[3])
{
    const double m[16] = {dx, 0, 0, low[0], 0, dy, 0, low[1], 0, 0, dz, low[2], 0, 0, 0, 1};
    memcpy(v->to_world, m, sizeof m);
}

/* --- binvox --- */

static svo_result read_binvox(const uint8_t *data, uint64_t size, fmt_voxels *v, svo_error *err)
{
    char line[1024];
    uint64_t at = 0, dim[3] = {0};
    double d[3], translate[3] = {0, 0, 0}, scale = 1;
    bool begun = false;
    while (!begun && next_line(data, size, &at, line) != NULL) {
        bool good = true;
        if (strncmp(line, "dim ", 4) == 0) good = import_numbers(line + 4, d, 3) == 3 && sizes_of(d, 3, dim);
        else if (strncmp(line, "translate ", 10) == 0) good = import_numbers(line + 10, translate, 3) == 3;
        else if (strncmp(line, "scale ", 6) == 0) good = import_numbers(line + 6, &scale, 1) == 1 && scale > 0;
        else if (strcmp(line, "data") == 0) begun = true;
        if (!good) return svo_fail(err, SVO_INVALID_DATA, "binvox header: \"%.60s\" is wrong", line);
    }
    if (!begun || dim[0] == 0) return svo_fail(err, SVO_INVALID_DATA, "the binvox header has no \"dim\" or no \"data\"");
    uint64_t total = dim[0] * dim[1] * dim[2], i = 0;
    for (; i < total && at + 2 <= size; at += 2) {
        uint8_t value = data[at], count = data[at + 1];
        if (value > 1 || count == 0 || count > total - i)
            return svo_fail(err, SVO_INVALID_DATA, "byte %llu: a run that cannot be (value %u, length %u)", (unsigned long long)at, value, count);
        for (uint64_t k = i; value == 1 && k < i + count; k++) /* y is fastest, then z, then x */
            SVO_TRY(import_cell(v, (uint32_t)(k / (dim[1] * dim[2])), (uint32_t)(k % dim[2]), (uint32_t)(k / dim[2] % dim[1]), NULL, err));
        i += count;
    }
    if (i != total) return svo_fail(err, SVO_INVALID_DATA, "the file ends after %llu of %llu voxels", (unsigned long long)i, (unsigned long long)total);
    double most = (double)(dim[0] > dim[1] ? dim[0] > dim[2] ? dim[0] : dim[2] : dim[1] > dim[2] ? dim[1] : dim[2]);
    place(v, scale / most, scale / most, scale / most, translate);
    return SVO_OK;
}

/* --- what they have in common --- */

static int by_code(const void *a, const void *b)
{
    const fmt_cell *x = a, *y = b;
    uint64_t p = svo_morton_encode(x->at[0], x->at[1], x->at[2]), q = svo_morton_encode(y->at[0], y->at[1], y->at[2]);
    if (p != q) return p < q ? -1 : 1;
    return memcmp(x->rgb, y->rgb, 4);
}

static void settle(fmt_voxels *v)
{
    fmt_cell *c = (fmt_cell *)(void *)v->cells.data;
    uint64_t count = v->cells.size / sizeof *c, kept = 0;
    if (count != 0) qsort(c, count, sizeof *c, by_code);
    for (uint64_t i = 0; i < count; i++) {
        if (kept > 0 && memcmp(c[kept - 1].at, c[i].at, sizeof c->at) == 0) continue;
        c[kept++] = c[i];
        for (int k = 0; k < 3; k++) v->side = c[i].at[k] + 1 > v->side ? c[i].at[k] + 1 : v->side;
    }
    v->cells.size = kept * sizeof *c;
}

svo_result fmt_import_voxels(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_voxels *out, svo_error *err)
{
    memset(out, 0, sizeof *out);
    svo_buffer_init(&out->cells, a);
    svo_result r;
    if (!fmt_is_voxels(data, size)) r = svo_fail(err, SVO_INVALID_DATA, "no .vox or binvox file");
    else if (data[0] == 'V') r = import_vox(data, size, a, out, err);
    else r = read_binvox(data, size, out, err);
    if (r == SVO_OK) settle(out);
    else svo_buffer_free(&out->cells);
    return r;
}

/* --- to an octree --- */

typedef struct emitter {
    const fmt_cell *cell;
    uint32_t depth;
    svo_buffer masks, values;
    bool failed;
} emitter;

static uint64_t code_of(const fmt_cell *c) { return svo_morton_encode(c->at[0], c->at[1], c->at[2]); }

/* Masks of a node of `level` and below, depth first; its voxels are [begin, end). At most SVO_CHUNK_LEVELS deep. */
static void add_masks(emitter *e, uint32_t level, uint64_t begin, uint64_t end)
{
    if (level == e->depth) return;
    uint64_t first[9];
    uint32_t shift = 3 * (e->depth - level - 1);
    uint8_t mask = 0;
    uint64_t i = begin;
    for (uint32_t o = 0; o < 8; o++) {
        first[o] = i;
        while (i < end && (code_of(&e->cell[i]) >> shift & 7) == o) i++;
        if (i > first[o]) mask = (uint8_t)(mask | 1u << o);
    }
    first[8] = i;
    if (svo_buffer_append(&e->masks, &mask, 1) == NULL) e->failed = true;
    for (uint32_t o = 0; o < 8 && !e->failed; o++)
        if (first[o + 1] > first[o]) add_masks(e, level + 1, first[o], first[o + 1]);
}

svo_result fmt_voxels_emit(const fmt_voxels *v, const svo_tree_info *info, const svo_chunk_sink *sink, svo_error *err)
{
    emitter e = {.cell = (const fmt_cell *)(const void *)v->cells.data, .depth = info->depth};
    uint64_t count = v->cells.size / sizeof *e.cell;
    uint32_t level = svo_chunk_level(info->depth), shift = 3 * (info->depth - level);
    svo_result r = SVO_OK;
    svo_buffer_init(&e.masks, v->cells.allocator);
    svo_buffer_init(&e.values, v->cells.allocator);
    bool values = info->channel_count == 1 && !info->channels[0].constant;
    for (uint64_t begin = 0, end; begin < count && r == SVO_OK; begin = end) {
        svo_chunk chunk = {.code = code_of(&e.cell[begin]) >> shift, .level = level, .depth = info->depth};
        for (end = begin; end < count && code_of(&e.cell[end]) >> shift == chunk.code; end++) {}
        e.masks.size = e.values.size = 0;
        add_masks(&e, level, begin, end);
        for (uint64_t i = begin; values && i < end && !e.failed; i++) e.failed = svo_buffer_append(&e.values, e.cell[i].rgb, 3) == NULL;
        if (e.failed) {
            r = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a part of the octree");
            break;
        }
        chunk.node_count = e.masks.size;
        chunk.value_count = end - begin;
        chunk.masks = e.masks.data;
        if (values) chunk.channels[0] = e.values.data;
        void *blob = NULL;
        r = sink->encode(sink->user, &chunk, 0, &blob, err);
        if (r == SVO_OK) r = sink->commit(sink->user, blob, err);
    }
    svo_buffer_free(&e.masks);
    svo_buffer_free(&e.values);
    return r;
}
