/* MagicaVoxel's .vox: models, palette and scene graph, as its authors describe them. */
#include "import_vox.h"

#include <stdlib.h>
#include <string.h>

#include "fmt_container.h"

enum { MODELS = 1 << 20, NODES = 1 << 22, NESTING = 64 };
static const uint64_t VISITS = (uint64_t)1 << 24;

typedef struct model { uint32_t size[3]; uint64_t begin, count; } model; /* begin: of its XYZI rows in the file */
typedef struct node { uint32_t id, kind; uint64_t at, end; } node;        /* at: behind id and attributes */

typedef struct reader {
    const uint8_t *data;
    fmt_voxels *out;
    svo_buffer models, nodes;
    uint8_t palette[256][4];
    int64_t low[3];   /* of all voxels, in .vox axes */
    bool any, measure; /* first pass: find low */
    uint64_t visits;
    svo_error *err;
} reader;

typedef struct pose { int8_t row[3], sign[3]; int64_t t[3]; } pose; /* p' = R p + t; row r of R has sign[r] at column row[r] */

static svo_result bad(svo_error *err, uint64_t at, const char *what) { return svo_fail(err, SVO_INVALID_DATA, "byte %llu of the .vox file: %s", (unsigned long long)at, what); }

/* A DICT: finds the values of the keys `r` and `t`; a hidden node is told by _hidden. */
typedef struct dict { char r[16], t[64]; bool hidden; } dict;
static bool read_dict(fmt_cursor *c, dict *d)
{
    uint32_t pairs = fmt_cursor_u32(c);
    memset(d, 0, sizeof *d);
    for (uint32_t i = 0; i < pairs && c->ok; i++) {
        uint32_t kn = fmt_cursor_u32(c);
        const uint8_t *k = fmt_cursor_take(c, kn);
        uint32_t vn = fmt_cursor_u32(c);
        const uint8_t *v = fmt_cursor_take(c, vn);
        if (!c->ok) return false;
        if (kn == 2 && memcmp(k, "_r", 2) == 0 && vn < sizeof d->r) memcpy(d->r, v, vn), d->r[vn] = 0;
        if (kn == 2 && memcmp(k, "_t", 2) == 0 && vn < sizeof d->t) memcpy(d->t, v, vn), d->t[vn] = 0;
        if (kn == 7 && memcmp(k, "_hidden", 7) == 0) d->hidden = vn == 1 && v[0] == '1';
    }
    return c->ok;
}

static bool read_pose(const dict *d, pose *p)
{
    *p = (pose){{0, 1, 2}, {1, 1, 1}, {0, 0, 0}};
    if (d->t[0] != 0) {
        const char *at = d->t;
        for (int k = 0; k < 3; k++) {
            char *end;
            p->t[k] = strtol(at, &end, 10);
            if (end == at || p->t[k] > 1 << 24 || p->t[k] < -(1 << 24)) return false;
            at = end;
        }
    }
    if (d->r[0] != 0) {
        long bits = strtol(d->r, NULL, 10);
        if (bits < 0 || bits > 127) return false;
        p->row[0] = (int8_t)(bits & 3), p->row[1] = (int8_t)(bits >> 2 & 3), p->row[2] = (int8_t)(3 - p->row[0] - p->row[1]);
        if (p->row[0] > 2 || p->row[1] > 2 || p->row[0] == p->row[1]) return false;
        for (int k = 0; k < 3; k++) p->sign[k] = bits >> (4 + k) & 1 ? -1 : 1;
    }
    return true;
}

static pose combine(const pose *a, const pose *b) /* a after b */
{
    pose out;
    for (int r = 0; r < 3; r++) {
        int k = a->row[r];
        out.row[r] = b->row[k];
        out.sign[r] = (int8_t)(a->sign[r] * b->sign[k]);
        out.t[r] = a->sign[r] * b->t[k] + a->t[r];
    }
    return out;
}

static svo_result put_model(reader *r, const model *m, const pose *p)
{
    r->visits += m->count;
    if (r->visits > VISITS * 128) return svo_fail(r->err, SVO_LIMIT, "the .vox file places its models too often");
    for (uint64_t i = 0; i < m->count; i++) {
        const uint8_t *v = r->data + m->begin + 4 * i;
        int64_t d[3], at[3];
        for (int k = 0; k < 3; k++) {
            if (v[k] >= m->size[k]) return bad(r->err, m->begin + 4 * i, "a voxel outside its model");
            d[k] = 2 * (int64_t)v[k] + 1 - 2 * (int64_t)(m->size[k] / 2); /* twice its centre's place about the model's pivot: odd */
        }
        for (int k = 0; k < 3; k++) at[k] = (p->sign[k] * d[p->row[k]] - 1) / 2 + p->t[k]; /* an odd number less one: exact */
        if (v[3] == 0) continue;
        const int64_t turned[3] = {at[0], at[2], -at[1]}; /* +Z up to +Y up */
        if (r->measure) {
            for (int k = 0; k < 3; k++) r->low[k] = !r->any || turned[k] < r->low[k] ? turned[k] : r->low[k];
            r->any = true;
            continue;
        }
        int64_t u[3];
        for (int k = 0; k < 3; k++) {
            u[k] = turned[k] - r->low[k];
            if (u[k] >= 1 << 21) return svo_fail(r->err, SVO_LIMIT, "the models of the .vox file lie more than 2^21 voxels apart");
        }
        SVO_TRY(import_cell(r->out, (uint32_t)u[0], (uint32_t)u[1], (uint32_t)u[2], r->palette[v[3] - 1], r->err));
    }
    return SVO_OK;
}

static int by_id(const void *a, const void *b)
{
    const node *x = a, *y = b;
    return x->id < y->id ? -1 : x->id > y->id;
}

static svo_result visit(reader *r, uint32_t id, const pose *p, uint32_t depth)
{
    node key = {.id = id};
    const node *n = bsearch(&key, r->nodes.data, r->nodes.size / sizeof key, sizeof key, by_id);
    if (n == NULL) return svo_fail(r->err, SVO_INVALID_DATA, "the .vox file names node %u, which it does not have", id);
    if (depth > NESTING || ++r->visits > VISITS) return svo_fail(r->err, SVO_INVALID_DATA, "the nodes of the .vox file are nested too deeply, or in a circle");
    fmt_cursor c = fmt_cursor_make(r->data + n->at, n->end - n->at);
    dict d;
    if (!read_dict(&c, &d)) return bad(r->err, n->at, "a node that ends early");
    if (d.hidden) return SVO_OK;
    if (n->kind == FMT_FOURCC('n', 'T', 'R', 'N')) {
        uint32_t child = fmt_cursor_u32(&c);
        fmt_cursor_take(&c, 8); /* reserved, layer */
        uint32_t frames = fmt_cursor_u32(&c);
        pose own;
        if (frames == 0 || !read_dict(&c, &d) || !read_pose(&d, &own)) return bad(r->err, n->at, "a transform that cannot be read");
        pose all = combine(p, &own);
        for (int k = 0; k < 3; k++)
            if (all.t[k] > 1 << 24 || all.t[k] < -(1 << 24)) return bad(r->err, n->at, "a translation that is too large");
        return visit(r, child, &all, depth + 1);
    }
    uint32_t count = fmt_cursor_u32(&c);
    bool group = n->kind == FMT_FOURCC('n', 'G', 'R', 'P');
    for (uint32_t i = 0; i < count && (group || i == 0); i++) { /* of a shape: the first frame */
        uint32_t child = fmt_cursor_u32(&c);
        if (!c.ok) return bad(r->err, n->at, "a node that ends early");
        if (group) {
            SVO_TRY(visit(r, child, p, depth + 1));
            continue;
        }
        if (child >= r->models.size / sizeof(model)) return bad(r->err, n->at, "a shape of a model that is not there");
        SVO_TRY(put_model(r, (const model *)(const void *)r->models.data + child, p));
    }
    return SVO_OK;
}

static svo_result read_chunks(reader *r, uint64_t size)
{
    uint64_t at = 20;
    uint32_t dims[3] = {0};
    if (size < 20 || memcmp(r->data + 8, "MAIN", 4) != 0) return bad(r->err, 8, "no chunk MAIN");
    at += fmt_load32(r->data + 12);
    while (at + 12 <= size) {
        uint32_t kind = fmt_load32(r->data + at), bytes = fmt_load32(r->data + at + 4);
        uint64_t begin = at + 12;
        if (bytes > size - begin) return bad(r->err, at, "a chunk that goes beyond the end of the file");
        fmt_cursor c = fmt_cursor_make(r->data + begin, bytes);
        if (kind == FMT_FOURCC('S', 'I', 'Z', 'E')) {
            for (int k = 0; k < 3; k++) dims[k] = fmt_cursor_u32(&c);
            if (!c.ok || dims[0] - 1 >= 256 || dims[1] - 1 >= 256 || dims[2] - 1 >= 256) return bad(r->err, at, "a model of impossible size");
        } else if (kind == FMT_FOURCC('X', 'Y', 'Z', 'I')) {
            model m = {{dims[0], dims[1], dims[2]}, begin + 4, fmt_cursor_u32(&c)};
            if (!c.ok || m.count > (bytes - 4u) / 4 || dims[0] == 0) return bad(r->err, at, "a model that ends early, or has no size");
            if (r->models.size / sizeof m >= MODELS) return svo_fail(r->err, SVO_LIMIT, "more than 2^20 models");
            if (svo_buffer_append(&r->models, &m, sizeof m) == NULL) return svo_fail(r->err, SVO_OUT_OF_MEMORY, "no memory for the models");
        } else if (kind == FMT_FOURCC('R', 'G', 'B', 'A')) {
            const uint8_t *colors = fmt_cursor_take(&c, 1024);
            if (colors == NULL) return bad(r->err, at, "a palette that ends early");
            memcpy(r->palette, colors, 1024);
        } else if (kind == FMT_FOURCC('n', 'T', 'R', 'N') || kind == FMT_FOURCC('n', 'G', 'R', 'P') || kind == FMT_FOURCC('n', 'S', 'H', 'P')) {
            node n = {fmt_cursor_u32(&c), kind, begin + 4, begin + bytes};
            if (!c.ok || r->nodes.size / sizeof n >= NODES) return bad(r->err, at, "a node that ends early, or too many of them");
            if (svo_buffer_append(&r->nodes, &n, sizeof n) == NULL) return svo_fail(r->err, SVO_OUT_OF_MEMORY, "no memory for the nodes");
        }
        at = begin + bytes;
    }
    return at == size ? SVO_OK : bad(r->err, at, "bytes behind the last chunk");
}

static svo_result place_models(reader *r)
{
    const pose none = {{0, 1, 2}, {1, 1, 1}, {0, 0, 0}};
    r->visits = 0;
    if (r->nodes.size != 0) return visit(r, 0, &none, 0);
    for (uint64_t i = 0; i < r->models.size / sizeof(model); i++) SVO_TRY(put_model(r, (const model *)(const void *)r->models.data + i, &none));
    return SVO_OK;
}

svo_result import_vox(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_voxels *v, svo_error *err)
{
    reader r = {.data = data, .out = v, .measure = true, .err = err};
    svo_buffer_init(&r.models, a);
    svo_buffer_init(&r.nodes, a);
    for (int i = 0; i < 256; i++) /* without a palette chunk: grey, and colours are not believed */
        for (int k = 0; k < 4; k++) r.palette[i][k] = 203;
    svo_result result = read_chunks(&r, size);
    if (r.nodes.size != 0) qsort(r.nodes.data, r.nodes.size / sizeof(node), sizeof(node), by_id);
    if (result == SVO_OK) result = place_models(&r);
    r.measure = false;
    if (result == SVO_OK) result = place_models(&r);
    v->colored = true;
    for (int k = 0; k < 3; k++) v->to_world[5 * k] = 1, v->to_world[4 * k + 3] = (double)r.low[k];
    v->to_world[15] = 1;
    svo_buffer_free(&r.models);
    svo_buffer_free(&r.nodes);
    return result;
}
