/* Polygons to triangles; the rule is stated in import_common.h. */
#include "import_common.h"

#include <math.h>

typedef struct point { double x, y; } point;

static double cross(point a, point b, point c) { return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x); }

/* Newell's normal: twice the vector area, robust for non-planar polygons. */
static void newell(const double *p, uint32_t n, double out[3])
{
    out[0] = out[1] = out[2] = 0;
    for (uint32_t i = 0; i < n; i++) {
        /* Relative to the first corner: small polygons far from the origin keep their digits. */
        const double *a = p + 3 * (size_t)i, *b = p + 3 * (size_t)((i + 1) % n);
        double ax = a[0] - p[0], ay = a[1] - p[1], az = a[2] - p[2];
        double bx = b[0] - p[0], by = b[1] - p[1], bz = b[2] - p[2];
        out[0] += ay * bz - az * by;
        out[1] += az * bx - ax * bz;
        out[2] += ax * by - ay * bx;
    }
}

static void put(uint32_t *t, uint32_t a, uint32_t b, uint32_t c) { t[0] = a, t[1] = b, t[2] = c; }

static void fan(uint32_t n, uint32_t *t)
{
    for (uint32_t i = 1; i + 1 < n; i++, t += 3) put(t, 0, i, i + 1);
}

static bool inside(point a, point b, point c, point p) { return cross(a, b, p) >= 0 && cross(b, c, p) >= 0 && cross(c, a, p) >= 0; }

typedef struct ears {
    const point *p;
    uint32_t *next, *previous;
    uint64_t budget;
} ears;

static bool same(point a, point b) { return a.x == b.x && a.y == b.y; }

/* Is corner i an ear of the remaining ring? Only reflex corners can lie in it, but testing all is as right. */
static bool is_ear(ears *e, uint32_t i)
{
    uint32_t h = e->previous[i], j = e->next[i];
    point a = e->p[h], b = e->p[i], c = e->p[j];
    if (!(cross(a, b, c) > 0)) return false;
    for (uint32_t k = e->next[j]; k != h; k = e->next[k]) {
        if (e->budget == 0) return false;
        e->budget--;
        point q = e->p[k];
        if (same(q, a) || same(q, b) || same(q, c)) continue; /* bridges to holes visit corners twice */
        if (inside(a, b, c, q)) return false;
    }
    return true;
}

static bool clip_ears(ears *e, uint32_t n, uint32_t *t)
{
    uint32_t left = n, i = 0, tried = 0;
    for (uint32_t k = 0; k < n; k++) e->next[k] = (k + 1) % n, e->previous[k] = (k + n - 1) % n;
    while (left > 3) {
        /* A corner without area adds nothing and may be cut at any time. */
        uint32_t h = e->previous[i], j = e->next[i];
        bool flat = cross(e->p[h], e->p[i], e->p[j]) == 0 && tried >= left;
        if (flat || is_ear(e, i)) {
            put(t, h, i, j);
            t += 3;
            e->next[h] = j;
            e->previous[j] = h;
            left--;
            tried = 0;
            i = j;
        } else {
            if (e->budget == 0 || ++tried > 2 * left) break;
            i = j;
        }
    }
    for (uint32_t a = e->next[i], b = e->next[a]; b != i; a = b, b = e->next[b], t += 3) put(t, i, a, b);
    return left == 3;
}

svo_result import_triangulate(const double *positions, uint32_t n, uint32_t *triangles, svo_buffer *scratch, bool *fanned,
                              svo_error *err)
{
    if (n == 3) {
        put(triangles, 0, 1, 2);
        return SVO_OK;
    }
    double normal[3];
    newell(positions, n, normal);
    double size[3] = {fabs(normal[0]), fabs(normal[1]), fabs(normal[2])};
    int drop = size[2] >= size[0] && size[2] >= size[1] ? 2 : size[1] >= size[0] ? 1 : 0;
    if (!(size[drop] > 0) || !isfinite(size[drop])) { /* no area, or not finite: any cut is as good */
        fan(n, triangles);
        return SVO_OK;
    }
    scratch->size = 0;
    point *p = svo_buffer_append(scratch, NULL, (size_t)n * (sizeof(point) + 2 * sizeof(uint32_t)));
    if (p == NULL) return import_no_memory(err);
    /* Keep the winding: seen along the dropped axis the polygon shall turn left. */
    int ax = (drop + 1) % 3, ay = (drop + 2) % 3;
    if (normal[drop] < 0) {
        int s = ax;
        ax = ay, ay = s;
    }
    bool convex = true;
    for (uint32_t i = 0; i < n; i++) {
        p[i].x = positions[3 * (size_t)i + (size_t)ax] - positions[ax];
        p[i].y = positions[3 * (size_t)i + (size_t)ay] - positions[ay];
    }
    for (uint32_t i = 0; i < n && convex; i++) convex = cross(p[i], p[(i + 1) % n], p[(i + 2) % n]) >= 0;
    if (n == 4) {
        /* The diagonal 0-2 stays inside when both halves turn left. */
        bool first = cross(p[0], p[1], p[2]) >= 0 && cross(p[0], p[2], p[3]) >= 0;
        bool second = cross(p[1], p[2], p[3]) >= 0 && cross(p[1], p[3], p[0]) >= 0;
        if (first || !second) {
            fan(4, triangles);
        } else {
            put(triangles, 1, 2, 3);
            put(triangles + 3, 1, 3, 0);
        }
        return SVO_OK;
    }
    if (convex) {
        /* A star (winding number above one) turns left everywhere too; its fan crosses. It is rare and has no
         * agreed filling, so the fan stands. */
        fan(n, triangles);
        return SVO_OK;
    }
    uint32_t *links = (uint32_t *)(void *)(p + n);
    ears e = {p, links, links + n, (uint64_t)n * 1024};
    if (!clip_ears(&e, n, triangles)) *fanned = true;
    return SVO_OK;
}
