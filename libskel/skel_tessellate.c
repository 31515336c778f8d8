/* Conforming tessellation: every edge of omega and longer is halved, in rounds, and each triangle is cut by the template for its
 * halved edges, so that triangles which share an edge still share its parts. Works on any soup: OpenMesh's subdividers would do the
 * same on manifold meshes only, and most of what artists and scanners deliver is none. */
#include "skeli_internal.h"

#include <string.h>

typedef struct edge_table {
    uint64_t *key; /* smaller vertex << 32 | larger, UINT64_MAX = empty */
    uint32_t *middle;
    uint64_t mask;
} edge_table;

static uint64_t edge_slot(const edge_table *t, uint64_t key)
{
    uint64_t h = key * 0x9e3779b97f4a7c15ull;
    h ^= h >> 29;
    uint64_t i = h & t->mask;
    while (t->key[i] != UINT64_MAX && t->key[i] != key) i = (i + 1) & t->mask;
    return i;
}

static uint64_t edge_key(uint32_t a, uint32_t b) { return a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a; }

static double length2(const int32_t *p, uint32_t a, uint32_t b)
{
    double d = 0;
    for (uint64_t k = 0; k < 3; k++) {
        double e = (double)p[3 * (uint64_t)a + k] - p[3 * (uint64_t)b + k];
        d += e * e;
    }
    return d;
}

/* Cut triangle c, whose edge k (corner k to k + 1) has middle m[k] or SVO_NONE. Returns the number of triangles in out. */
static int cut(const int32_t *p, const uint32_t *c, const uint32_t *m, uint32_t out[4][3])
{
    int cuts = (m[0] != SVO_NONE) + (m[1] != SVO_NONE) + (m[2] != SVO_NONE), n = 0;
#define EMIT(x, y, z) (out[n][0] = (x), out[n][1] = (y), out[n][2] = (z), n++)
    if (cuts == 0) {
        EMIT(c[0], c[1], c[2]);
    } else if (cuts == 3) {
        EMIT(c[0], m[0], m[2]);
        EMIT(m[0], c[1], m[1]);
        EMIT(m[2], m[1], c[2]);
        EMIT(m[0], m[1], m[2]);
    } else if (cuts == 1) {
        int k = m[0] != SVO_NONE ? 0 : m[1] != SVO_NONE ? 1 : 2;
        uint32_t x = c[k], y = c[(k + 1) % 3], z = c[(k + 2) % 3];
        EMIT(x, m[k], z);
        EMIT(m[k], y, z);
    } else {
        int k = m[0] == SVO_NONE ? 0 : m[1] == SVO_NONE ? 1 : 2; /* the edge that stays */
        uint32_t x = c[k], y = c[(k + 1) % 3], z = c[(k + 2) % 3], yz = m[(k + 1) % 3], zx = m[(k + 2) % 3];
        EMIT(z, zx, yz);
        if (length2(p, x, yz) < length2(p, y, zx)) { /* the shorter diagonal of what is left */
            EMIT(x, y, yz);
            EMIT(x, yz, zx);
        } else {
            EMIT(x, y, zx);
            EMIT(y, yz, zx);
        }
    }
#undef EMIT
    return n;
}

static svo_result table_begin(const svo_allocator *a, edge_table *t, uint64_t entries, svo_error *err)
{
    uint64_t capacity = 64;
    while (capacity < 2 * entries) capacity *= 2;
    t->mask = capacity - 1;
    t->key = svo_alloc(a, capacity, sizeof *t->key);
    t->middle = svo_alloc(a, capacity, sizeof *t->middle);
    if (t->key == NULL || t->middle == NULL) return skeli_no_memory(err);
    memset(t->key, 0xff, capacity * sizeof *t->key);
    return SVO_OK;
}

static void table_end(const svo_allocator *a, edge_table *t)
{
    svo_free(a, t->key, t->mask + 1, sizeof *t->key);
    svo_free(a, t->middle, t->mask + 1, sizeof *t->middle);
    t->key = NULL;
    t->middle = NULL;
}

static svo_result too_many(double omega, uint64_t max_vertices, svo_error *err)
{
    return svo_fail(err, SVO_LIMIT, "edges below omega %.9g need more than %llu vertices; choose a larger omega or raise the limit on vertices",
                    omega / SKEL_LATTICE, (unsigned long long)max_vertices);
}

/* One round. *more tells whether something was cut. */
static svo_result split_round(svo_buffer *vertices, svo_buffer *triangles, svo_buffer *next, double omega, uint64_t max_vertices,
                              bool *more, svo_error *err)
{
    const svo_allocator *a = vertices->allocator;
    const uint32_t *corner = (const uint32_t *)triangles->data;
    uint64_t count = triangles->size / 12, longer = 0;
    double omega2 = omega * omega;
    for (uint64_t t = 0; t < count; t++)
        for (int k = 0; k < 3; k++)
            longer += length2((const int32_t *)vertices->data, corner[3 * t + (uint64_t)k], corner[3 * t + (uint64_t)(k + 1) % 3]) >= omega2;
    *more = longer > 0;
    if (longer == 0) return SVO_OK;
    edge_table table = {0};
    svo_result result = table_begin(a, &table, longer, err);
    next->size = 0;
    for (uint64_t t = 0; t < count && result == SVO_OK; t++) {
        uint32_t c[3], m[3], out[4][3];
        memcpy(c, corner + 3 * t, sizeof c);
        for (int k = 0; k < 3; k++) {
            uint32_t x = c[k], y = c[(k + 1) % 3];
            const int32_t *p = (const int32_t *)vertices->data;
            m[k] = SVO_NONE;
            if (length2(p, x, y) < omega2) continue;
            uint64_t slot = edge_slot(&table, edge_key(x, y));
            if (table.key[slot] == UINT64_MAX) {
                uint64_t at = vertices->size / 12;
                if (at >= max_vertices) {
                    result = too_many(omega, max_vertices, err);
                    break;
                }
                int32_t middle[3];
                for (uint64_t i = 0; i < 3; i++) middle[i] = (p[3 * (uint64_t)x + i] + p[3 * (uint64_t)y + i]) >> 1;
                if (svo_buffer_append(vertices, middle, sizeof middle) == NULL) {
                    result = skeli_no_memory(err);
                    break;
                }
                table.key[slot] = edge_key(x, y);
                table.middle[slot] = (uint32_t)at;
            }
            m[k] = table.middle[slot];
        }
        if (result != SVO_OK) break;
        int n = cut((const int32_t *)vertices->data, c, m, out);
        if (svo_buffer_append(next, out, (size_t)n * 12) == NULL) result = skeli_no_memory(err);
    }
    table_end(a, &table);
    svo_buffer t = *triangles;
    *triangles = *next;
    *next = t;
    if (result == SVO_OK && triangles->size / 12 >= INT32_MAX) result = too_many(omega, max_vertices, err);
    return result;
}

svo_result skeli_tessellate(skeli_pool *pool, const skeli_soup *in, double omega, uint64_t max_vertices, skeli_soup *out, uint32_t *moved,
                            svo_error *err)
{
    svo_buffer vertices, triangles, next;
    svo_buffer_init(&vertices, pool->allocator);
    svo_buffer_init(&triangles, pool->allocator);
    svo_buffer_init(&next, pool->allocator);
    svo_result result = SVO_OK;
    if (max_vertices > INT32_MAX - 1) max_vertices = INT32_MAX - 1;
    if (in->vertex_count > max_vertices) result = too_many(omega, max_vertices, err);
    if (result == SVO_OK &&
        ((in->vertex_count > 0 && svo_buffer_append(&vertices, in->position, (size_t)in->vertex_count * 12) == NULL) ||
         (in->triangle_count > 0 && svo_buffer_append(&triangles, in->corner, (size_t)in->triangle_count * 12) == NULL)))
        result = skeli_no_memory(err);
    for (bool more = true; more && result == SVO_OK;)
        result = split_round(&vertices, &triangles, &next, omega, max_vertices, &more, err);
    svo_buffer_free(&next);
    if (result == SVO_OK) {
        uint64_t points = vertices.size / 12, count = triangles.size / 12, dropped;
        uint32_t *remap = skeli_take(pool, points, sizeof *remap);
        if (remap == NULL) result = skeli_no_memory(err);
        else if (count == 0) { /* points only: nothing to sort */
            *out = *in;
            for (uint32_t i = 0; i < in->vertex_count; i++) moved[i] = i;
        } else {
            result = skeli_canonical(pool, (const int32_t *)vertices.data, points, (const uint32_t *)triangles.data, count, out, remap, &dropped, err);
            if (result == SVO_OK) memcpy(moved, remap, (size_t)in->vertex_count * sizeof *moved);
        }
        skeli_give(pool, remap);
    }
    svo_buffer_free(&vertices);
    svo_buffer_free(&triangles);
    return result;
}
