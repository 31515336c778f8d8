/* A curve with exactly the handles of the solid. The points of a grid that are inside, with the edges between them that do not cross the surface, and the squares and cubes
 * whose edges are all there, are a model of the solid made of cells. A cell with a free side (one that is a side of no other cell) can be taken away together with that side without changing
 * how the rest hangs together, so what is left when no free side is left has as many loops as the solid has handles. Sides near the surface go first, so what is left lies deep. */
#include "skeli_cells.h"

#include <math.h>
#include <string.h>

#include "svo_task.h"

enum { INSIDE = 1, NEAR = 2, PRESENT = 1, ANCHOR = 2, STRAIGHT = 3, DIAGONAL = 4, CORNER = 5 /* chamfer distances */, FIRST_SIDE = 64, ROUNDS = 4, ISLAND = 64 /* points */, CAP = 8 /* vertices */ };
#define MOST_CELLS ((uint64_t)1 << 26)
#define OFF_THE_GRID 0.37 /* of a step: flat sides at round coordinates do not lie on points */

/* Cells of all dimensions on one grid of 2 n - 1 places an axis: an odd coordinate stands for the stretch between two points. */
typedef struct cells {
    const skeli_surface *surface;
    double low[3], step;
    uint32_t n[3];      /* points an axis */
    uint64_t stride[3]; /* of places */
    uint64_t points, places;
    uint8_t *link;  /* of each point: INSIDE, NEAR */
    uint8_t *edge;  /* of each point: bit k: the edge to the next point on axis k is inside */
    uint16_t *deep; /* chamfer distance to what is not inside */
    uint8_t *place;
} cells;

static uint64_t point_at(const cells *g, uint32_t x, uint32_t y, uint32_t z) { return ((uint64_t)z * g->n[1] + y) * g->n[0] + x; }
static void where(const cells *g, uint32_t x, uint32_t y, uint32_t z, double p[3])
{
    const uint32_t at[3] = {x, y, z};
    for (int k = 0; k < 3; k++) p[k] = g->low[k] + g->step * at[k];
}

/* --- which points and edges are inside ----------------------------------------------------------------------------------- */

/* Points at most a step from a triangle's box. Between two neighbours that are not, the surface does not pass. */
static void mark_near(cells *g, const skeli_soup *mesh)
{
    memset(g->link, 0, g->points);
    for (uint64_t t = 0; t < mesh->triangle_count; t++) {
        int64_t first[3], last[3];
        for (int k = 0; k < 3; k++) {
            double low = INFINITY, high = -INFINITY;
            for (int c = 0; c < 3; c++) {
                const double x = mesh->position[3 * (uint64_t)mesh->corner[3 * t + (uint64_t)c] + (uint64_t)k];
                low = fmin(low, x);
                high = fmax(high, x);
            }
            first[k] = (int64_t)ceil((low - g->low[k]) / g->step - 1.01);
            last[k] = (int64_t)floor((high - g->low[k]) / g->step + 1.01);
            if (first[k] < 0) first[k] = 0;
            if (last[k] >= g->n[k]) last[k] = (int64_t)g->n[k] - 1;
        }
        for (int64_t z = first[2]; z <= last[2]; z++)
            for (int64_t y = first[1]; y <= last[1]; y++)
                if (first[0] <= last[0]) memset(g->link + point_at(g, (uint32_t)first[0], (uint32_t)y, (uint32_t)z), NEAR, (size_t)(last[0] - first[0] + 1));
    }
}

static svo_result look_inside(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    cells *g = user;
    for (uint64_t row = begin; row < end; row++) {
        uint32_t y = (uint32_t)(row % g->n[1]), z = (uint32_t)(row / g->n[1]);
        bool inside = false, known = true; /* the first point of a row is beside the model */
        for (uint32_t x = 0; x < g->n[0]; x++) {
            double p[3];
            uint8_t *link = g->link + point_at(g, x, y, z);
            if ((*link & NEAR) != 0 || !known) {
                where(g, x, y, z, p);
                inside = skeli_surface_inside(g->surface, p);
                known = (*link & NEAR) == 0;
            }
            if (inside) *link |= INSIDE;
        }
    }
    return SVO_OK;
}

static svo_result look_along(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    cells *g = user;
    const uint64_t next[3] = {1, g->n[0], (uint64_t)g->n[0] * g->n[1]};
    for (uint64_t row = begin; row < end; row++) {
        uint32_t at[3] = {0, (uint32_t)(row % g->n[1]), (uint32_t)(row / g->n[1])};
        for (; at[0] < g->n[0]; at[0]++) {
            uint64_t i = point_at(g, at[0], at[1], at[2]);
            if ((g->link[i] & INSIDE) == 0) continue;
            for (int k = 0; k < 3; k++) {
                double p[3], d[3] = {0, 0, 0};
                if (at[k] + 1 == g->n[k] || (g->link[i + next[k]] & INSIDE) == 0) continue;
                d[k] = 1;
                where(g, at[0], at[1], at[2], p);
                bool near = (g->link[i] & g->link[i + next[k]] & NEAR) != 0;
                if (!near || !(skeli_surface_ray(g->surface, p, d, g->step) < g->step)) g->edge[i] |= (uint8_t)(1 << k);
            }
        }
    }
    return SVO_OK;
}

/* Chamfer distance to points outside, and to edges that are cut, in two passes. */
static void deepen(cells *g)
{
    const int64_t nx = g->n[0], ny = g->n[1], nz = g->n[2];
    for (uint64_t i = 0; i < g->points; i++) g->deep[i] = (g->link[i] & INSIDE) != 0 ? UINT16_MAX : 0;
    for (int64_t z = 0; z < nz; z++)
        for (int64_t y = 0; y < ny; y++)
            for (int64_t x = 0; x < nx; x++) {
                uint64_t i = point_at(g, (uint32_t)x, (uint32_t)y, (uint32_t)z);
                const uint64_t next[3] = {1, (uint64_t)nx, (uint64_t)(nx * ny)};
                const bool more[3] = {x + 1 < nx, y + 1 < ny, z + 1 < nz};
                for (int k = 0; k < 3; k++)
                    if ((g->link[i] & INSIDE) != 0 && (g->edge[i] >> k & 1) == 0 && more[k] && (g->link[i + next[k]] & INSIDE) != 0) g->deep[i] = g->deep[i + next[k]] = STRAIGHT;
            }
    for (int pass = 0; pass < 2; pass++)
        for (int64_t t = 0; t < (int64_t)g->points; t++) {
            int64_t i = pass == 0 ? t : (int64_t)g->points - 1 - t, x = i % nx, y = i / nx % ny, z = i / nx / ny;
            uint32_t best = g->deep[i];
            if (best == 0) continue;
            for (int64_t dz = -1; dz <= 0; dz++)
                for (int64_t dy = -1; dy <= (dz == 0 ? 0 : 1); dy++)
                    for (int64_t dx = -1; dx <= (dz == 0 && dy == 0 ? -1 : 1); dx++) {
                        int64_t f = pass == 0 ? 1 : -1, a = x + f * dx, b = y + f * dy, c = z + f * dz;
                        uint32_t way = dx != 0 && dy != 0 && dz != 0 ? CORNER : (dx != 0) + (dy != 0) + (dz != 0) == 2 ? DIAGONAL : STRAIGHT;
                        uint32_t from = a < 0 || b < 0 || c < 0 || a >= nx || b >= ny || c >= nz ? 0 : g->deep[(c * ny + b) * nx + a];
                        if (from + way < best) best = from + way;
                    }
            g->deep[i] = (uint16_t)best;
        }
}

/* Every place all of whose ends are there; edges as they were found. Places of one dimension, in planes across z: their ends, of the dimension below, are there already. */
typedef struct fill { cells *g; uint32_t dimension; } fill;
static svo_result fill_planes(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    const fill *f = user;
    cells *g = f->g;
    for (uint64_t z = begin; z < end; z++)
        for (uint32_t odd = z % 2 != 0 ? 4 : 0; odd < (z % 2 != 0 ? 8 : 4); odd++) {
            if ((odd & 1) + (odd >> 1 & 1) + (odd >> 2) != f->dimension) continue;
            for (uint32_t y = odd >> 1 & 1; y < 2 * g->n[1] - 1; y += 2)
                for (uint32_t x = odd & 1; x < 2 * g->n[0] - 1; x += 2) {
                    uint64_t i = x + y * g->stride[1] + z * g->stride[2];
                    const uint64_t point = point_at(g, x / 2, y / 2, (uint32_t)z / 2);
                    bool there = (g->link[point] & INSIDE) != 0 && (f->dimension != 1 || (g->edge[point] & odd) != 0);
                    for (int k = 0; k < 3 && there; k++)
                        if ((odd >> k & 1) != 0) there = g->place[i - g->stride[k]] != 0 && g->place[i + g->stride[k]] != 0;
                    g->place[i] = there ? PRESENT : 0;
                }
        }
    return SVO_OK;
}

static svo_result fill_places(cells *g, uint32_t threads, svo_error *err)
{
    for (uint32_t dimension = 0; dimension <= 3; dimension++) {
        fill f = {g, dimension};
        SVO_TRY(svo_parallel_for(threads, 2 * (uint64_t)g->n[2] - 1, 8, fill_planes, &f, err));
    }
    return SVO_OK;
}

/* --- taking cells away ----------------------------------------------------------------------------------------------- */

/* A place by its coordinates: dividing its number by the strides, again and again, took a third of the time. */
typedef struct spot { uint16_t at[3]; } spot;
_Static_assert(ROUNDS == 4 && 2 * (FIRST_SIDE * 27 / 8 + 3) < UINT16_MAX, "a grid of the last round has coordinates of 16 bits");
static uint64_t place_of(const cells *g, spot p) { return p.at[0] + p.at[1] * g->stride[1] + p.at[2] * g->stride[2]; }

/* The place beside it: which is 2 k for that before it on axis k, 2 k + 1 for that after it. */
static spot neighbour(spot p, int which)
{
    p.at[which / 2] = (uint16_t)(which % 2 == 0 ? p.at[which / 2] - 1 : p.at[which / 2] + 1);
    return p;
}

/* Free sides by depth: lists in one growing array, whose entries are used again. */
typedef struct waiting { spot p; uint32_t next; } waiting;
typedef struct queue {
    svo_buffer entries; /* waiting */
    uint32_t *head, spare, count;
} queue;

static bool push(queue *q, uint32_t key, spot p)
{
    uint32_t i = q->spare;
    if (i != SVO_NONE) {
        q->spare = ((waiting *)(void *)q->entries.data)[i].next;
    } else {
        const waiting none = {{{0, 0, 0}}, 0};
        if (svo_buffer_append(&q->entries, &none, sizeof none) == NULL) return false;
        i = q->count++;
    }
    ((waiting *)(void *)q->entries.data)[i] = (waiting){p, q->head[key]};
    q->head[key] = i;
    return true;
}

/* The one cell of the next dimension that this is a side of, as in neighbour(); -1: none or several. */
static int only_cell(const cells *g, spot p, uint64_t place)
{
    int found = -1;
    for (int k = 0; k < 3; k++) {
        if (p.at[k] % 2 != 0) continue;
        if (p.at[k] != 0 && g->place[place - g->stride[k]] != 0) {
            if (found >= 0) return -1;
            found = 2 * k;
        }
        if (p.at[k] != 2 * g->n[k] - 2 && g->place[place + g->stride[k]] != 0) {
            if (found >= 0) return -1;
            found = 2 * k + 1;
        }
    }
    return found;
}

static uint32_t key_of(const cells *g, spot p)
{
    const uint32_t x = p.at[0], y = p.at[1], z = p.at[2];
    return ((uint32_t)g->deep[point_at(g, x / 2, y / 2, z / 2)] + g->deep[point_at(g, (x + 1) / 2, (y + 1) / 2, (z + 1) / 2)]) / 2;
}

/* Sides of a place that was taken away, as far as they are free now. What waits at a depth that is done is taken at this one. */
static bool push_sides(queue *q, const cells *g, spot p, uint32_t key)
{
    for (int which = 0; which < 6; which++) {
        if (p.at[which / 2] % 2 == 0) continue;
        const spot side = neighbour(p, which);
        const uint64_t i = place_of(g, side);
        if (g->place[i] != PRESENT || only_cell(g, side, i) < 0) continue;
        const uint32_t deep = key_of(g, side);
        if (!push(q, deep > key ? deep : key, side)) return false;
    }
    return true;
}

static bool push_all(queue *q, const cells *g)
{
    spot p;
    uint64_t i = 0;
    for (p.at[2] = 0; p.at[2] < 2 * g->n[2] - 1; p.at[2]++)
        for (p.at[1] = 0; p.at[1] < 2 * g->n[1] - 1; p.at[1]++)
            for (p.at[0] = 0; p.at[0] < 2 * g->n[0] - 1; p.at[0]++, i++)
                if (g->place[i] == PRESENT && only_cell(g, p, i) >= 0 && !push(q, key_of(g, p), p)) return false;
    return true;
}

static svo_result take_away(skeli_pool *pool, cells *g, svo_error *err)
{
    uint32_t deepest = 0;
    for (uint64_t i = 0; i < g->points; i++) deepest = g->deep[i] > deepest ? g->deep[i] : deepest;
    queue q = {.spare = SVO_NONE};
    svo_buffer_init(&q.entries, pool->allocator);
    q.head = skeli_take(pool, (uint64_t)deepest + 1, sizeof *q.head);
    if (q.head == NULL) return skeli_no_memory(err);
    memset(q.head, 0xff, ((size_t)deepest + 1) * sizeof *q.head);
    bool ok = push_all(&q, g);
    for (uint32_t key = 0; key <= deepest && ok;) {
        uint32_t e = q.head[key];
        if (e == SVO_NONE) {
            key++;
            continue;
        }
        waiting *w = (waiting *)(void *)q.entries.data + e;
        const spot side = w->p;
        const uint64_t i = place_of(g, side);
        int which;
        q.head[key] = w->next;
        w->next = q.spare;
        q.spare = e;
        if (g->place[i] != PRESENT || (which = only_cell(g, side, i)) < 0) continue;
        const spot cell = neighbour(side, which);
        g->place[i] = g->place[place_of(g, cell)] = 0;
        /* of the side, too: it may have been the last but one cell around its own sides */
        ok = push_sides(&q, g, cell, key) && push_sides(&q, g, side, key);
    }
    skeli_give(pool, q.head);
    svo_buffer_free(&q.entries);
    return ok ? SVO_OK : skeli_no_memory(err);
}

/* --- to a curve -------------------------------------------------------------------------------------------------------- */

/* Give every point inside the number of the place of the curve that is nearest to it along edges inside. */
static void spread(const cells *g, uint32_t *label, uint32_t *line, uint64_t begun)
{
    const int64_t next[3] = {1, g->n[0], (int64_t)g->n[0] * g->n[1]};
    for (uint64_t at = 0; at < begun; at++) {
        int64_t i = line[at];
        for (int k = 0; k < 3; k++) {
            if ((g->edge[i] >> k & 1) != 0 && label[i + next[k]] == SVO_NONE) {
                label[i + next[k]] = label[i];
                line[begun++] = (uint32_t)(i + next[k]);
            }
            if (i >= next[k] && (g->edge[i - next[k]] >> k & 1) != 0 && label[i - next[k]] == SVO_NONE) {
                label[i - next[k]] = label[i];
                line[begun++] = (uint32_t)(i - next[k]);
            }
        }
    }
}

/* The nearest point of the grid in the 4^3 around p that has a label, or, where label is NULL, that is inside; UINT64_MAX: none. */
static uint64_t near_point(const cells *g, const double p[3], const uint32_t *label)
{
    int64_t first[3];
    uint64_t best = UINT64_MAX;
    double best2 = INFINITY;
    for (int k = 0; k < 3; k++) first[k] = (int64_t)floor((p[k] - g->low[k]) / g->step) - 1;
    for (int64_t z = first[2]; z < first[2] + 4; z++)
        for (int64_t y = first[1]; y < first[1] + 4; y++)
            for (int64_t x = first[0]; x < first[0] + 4; x++) {
                if (x < 0 || y < 0 || z < 0 || x >= g->n[0] || y >= g->n[1] || z >= g->n[2]) continue;
                uint64_t i = point_at(g, (uint32_t)x, (uint32_t)y, (uint32_t)z);
                double q[3];
                if (label != NULL ? label[i] == SVO_NONE : (g->link[i] & INSIDE) == 0) continue;
                where(g, (uint32_t)x, (uint32_t)y, (uint32_t)z, q);
                double d2 = (q[0] - p[0]) * (q[0] - p[0]) + (q[1] - p[1]) * (q[1] - p[1]) + (q[2] - p[2]) * (q[2] - p[2]);
                if (d2 >= best2) continue;
                best2 = d2;
                best = i;
            }
    return best;
}

static void map_vertices(const cells *g, const skeli_soup *mesh, const uint32_t *label, skeli_curve *c)
{
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const double p[3] = {mesh->position[3 * (uint64_t)v], mesh->position[3 * (uint64_t)v + 1], mesh->position[3 * (uint64_t)v + 2]};
        uint64_t i = near_point(g, p, label);
        if (i != UINT64_MAX) {
            c->joint_of[v] = label[i];
            continue;
        }
        double best = INFINITY; /* on parts thinner than the grid */
        for (uint32_t j = 0; j < c->joints; j++) {
            double d = skeli_apart(p, c->position + 3 * (uint64_t)j);
            if (d >= best) continue;
            best = d;
            c->joint_of[v] = j;
        }
    }
}

/* Where a solid is thinner than the grid, points of it come to be alone. Such islands have few points and come down to single joints that are no end of the
 * curve; the smallest are left out, as many as there are parts too many. */
static uint32_t drop_islands(const cells *g, const uint32_t *label, const uint32_t *line, uint32_t joints, uint32_t *parent, uint32_t components, uint32_t want, uint32_t *size, uint8_t *drop)
{
    memset(size, 0, joints * sizeof *size);
    memset(drop, 0, joints);
    for (uint32_t j = 0; j < joints; j++) {
        const uint64_t i = line[j], x = i % g->n[0], y = i / g->n[0] % g->n[1], z = i / g->n[0] / g->n[1];
        const uint32_t root = skeli_root(parent, j);
        if (root != j || g->place[2 * (x + y * g->stride[1] + z * g->stride[2])] != PRESENT) drop[root] = 2;
    }
    for (uint64_t i = 0; i < g->points; i++)
        if (label[i] != SVO_NONE) size[skeli_root(parent, label[i])]++;
    while (components > want) {
        uint32_t least = SVO_NONE;
        for (uint32_t j = 0; j < joints; j++)
            if (parent[j] == j && drop[j] == 0 && size[j] <= ISLAND && (least == SVO_NONE || size[j] < size[least])) least = j;
        if (least == SVO_NONE) break;
        drop[least] = 1;
        components--;
    }
    return components;
}

/* What is left, as joints and bones, if it is a curve with the loops and components that are asked for. */
static svo_result to_curve(skeli_pool *pool, const cells *g, const skeli_soup *mesh, const skeli_genus *want, skeli_curve *c, bool *done, svo_error *err)
{
    uint64_t joints = 0, bones = 0, place = 0;
    for (uint32_t z = 0; z < 2 * g->n[2] - 1; z++)
        for (uint32_t y = 0; y < 2 * g->n[1] - 1; y++)
            for (uint32_t x = 0; x < 2 * g->n[0] - 1; x++, place++) {
                if (g->place[place] == 0) continue;
                const uint32_t dimension = x % 2 + y % 2 + z % 2;
                if (dimension > 1) return SVO_OK; /* a cavity, or a knot of squares that has no free side */
                joints += dimension == 0;
                bones += dimension == 1;
            }
    if (joints == 0) return SVO_OK;
    uint32_t *label = skeli_take(pool, g->points, sizeof *label), *line = skeli_take(pool, g->points, sizeof *line), *parent = skeli_take(pool, joints, sizeof *parent);
    uint32_t *bone = skeli_take(pool, 2 * bones, sizeof *bone), *size = skeli_take(pool, joints, sizeof *size);
    uint8_t *drop = skeli_take(pool, joints, 1);
    double *position = skeli_take(pool, 3 * joints, sizeof *position);
    if (label == NULL || line == NULL || parent == NULL || bone == NULL || position == NULL || size == NULL || drop == NULL) return skeli_no_memory(err);
    memset(label, 0xff, g->points * sizeof *label);
    uint32_t n = 0, components = (uint32_t)joints;
    for (uint32_t z = 0; z < g->n[2]; z++)
        for (uint32_t y = 0; y < g->n[1]; y++)
            for (uint32_t x = 0; x < g->n[0]; x++) {
                if (g->place[2 * (x + y * g->stride[1] + z * g->stride[2])] == 0) continue;
                where(g, x, y, z, position + 3 * (uint64_t)n);
                parent[n] = n;
                line[n] = (uint32_t)point_at(g, x, y, z);
                label[line[n]] = n;
                n++;
            }
    uint64_t b = 0;
    const uint64_t next[3] = {1, g->n[0], (uint64_t)g->n[0] * g->n[1]};
    for (uint32_t j = 0; j < n; j++) {
        uint64_t i = line[j], x = i % g->n[0], y = i / g->n[0] % g->n[1], z = i / next[2], even = 2 * (x + y * g->stride[1] + z * g->stride[2]);
        const uint64_t at[3] = {x, y, z};
        for (int k = 0; k < 3; k++) {
            if (at[k] + 1 == g->n[k] || g->place[even + g->stride[k]] == 0) continue;
            bone[2 * b] = j;
            bone[2 * b++ + 1] = label[i + next[k]];
            uint32_t p = skeli_root(parent, j), q = skeli_root(parent, label[i + next[k]]);
            if (p == q) continue;
            parent[p > q ? p : q] = p > q ? q : p;
            components--;
        }
    }
    if (components >= want->components && bones + components == joints + want->genus) {
        spread(g, label, line, n);
        *done = drop_islands(g, label, line, n, parent, components, want->components, size, drop) == want->components;
    }
    if (*done) {
        for (uint64_t i = 0; i < g->points; i++)
            if (label[i] != SVO_NONE && drop[label[i]] == 1) label[i] = SVO_NONE;
        uint32_t kept = 0; /* size takes the new numbers */
        for (uint32_t j = 0; j < n; j++) {
            if (drop[j] == 1) continue;
            memmove(position + 3 * (uint64_t)kept, position + 3 * (uint64_t)j, 3 * sizeof *position);
            size[j] = kept++;
        }
        for (uint64_t i = 0; i < g->points; i++)
            if (label[i] != SVO_NONE) label[i] = size[label[i]];
        for (uint64_t i = 0; i < 2 * b; i++) bone[i] = size[bone[i]];
        skeli_give(pool, c->position);
        skeli_give(pool, c->bone);
        c->position = position;
        c->bone = bone;
        c->joints = kept;
        c->bones = b;
        map_vertices(g, mesh, label, c);
    } else {
        skeli_give(pool, position);
        skeli_give(pool, bone);
    }
    skeli_give(pool, label);
    skeli_give(pool, line);
    skeli_give(pool, parent);
    skeli_give(pool, size);
    skeli_give(pool, drop);
    return SVO_OK;
}

/* --- all ----------------------------------------------------------------------------------------------------------------- */

static void size_up(cells *g, const skeli_soup *mesh, uint32_t side)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, longest = 0;
    for (uint64_t i = 0; i < 3 * (uint64_t)mesh->vertex_count; i++) {
        low[i % 3] = fmin(low[i % 3], mesh->position[i]);
        high[i % 3] = fmax(high[i % 3], mesh->position[i]);
    }
    for (int k = 0; k < 3; k++) longest = fmax(longest, high[k] - low[k]);
    g->step = fmax(longest, 1) / side;
    g->points = g->places = 1;
    for (int k = 0; k < 3; k++) {
        g->low[k] = low[k] - OFF_THE_GRID * g->step;
        g->n[k] = (uint32_t)ceil((high[k] - g->low[k]) / g->step) + 1;
        g->stride[k] = g->places;
        g->points *= g->n[k];
        g->places *= 2 * (uint64_t)g->n[k] - 1;
    }
}

/* Pieces of the surface that are mapped to one joint and hang together. A piece with one piece around it is a cap: the end of a limb, also where the contraction has put two limbs together. */
static svo_result caps(skeli_pool *pool, const skeli_soup *mesh, const skeli_curve *c, svo_buffer *ends, bool *merged, svo_error *err)
{
    const uint32_t n = mesh->vertex_count;
    uint32_t *piece = skeli_take(pool, n, sizeof *piece), *beside = skeli_take(pool, n, sizeof *beside), *degree = skeli_take(pool, c->joints, sizeof *degree);
    uint32_t *number = skeli_take(pool, c->joints, sizeof *number);
    uint32_t *large = skeli_take(pool, c->joints, sizeof *large), *all = skeli_take(pool, c->joints, sizeof *all);
    double *sum = skeli_take(pool, 4 * (uint64_t)n, sizeof *sum);
    if (piece == NULL || beside == NULL || degree == NULL || number == NULL || large == NULL || all == NULL || sum == NULL) return skeli_no_memory(err);
    memset(degree, 0, c->joints * sizeof *degree);
    memset(sum, 0, 4 * (size_t)n * sizeof *sum);
    for (uint64_t i = 0; i < 2 * c->bones; i++) degree[c->bone[i]]++;
    for (uint32_t v = 0; v < n; v++) {
        piece[v] = v;
        beside[v] = SVO_NONE;
    }
    for (int pass = 0; pass < 2; pass++)
        for (uint64_t t = 0; t < mesh->triangle_count; t++)
            for (uint64_t k = 0; k < 3; k++) {
                const uint32_t x = mesh->corner[3 * t + k], y = mesh->corner[3 * t + (k + 1) % 3], p = skeli_root(piece, x), q = skeli_root(piece, y);
                if (p == q) continue;
                if (pass == 0) {
                    if (c->joint_of[x] == c->joint_of[y]) piece[p > q ? p : q] = p > q ? q : p;
                    continue;
                }
                beside[p] = beside[p] == SVO_NONE || beside[p] == q ? q : n; /* n: several */
                beside[q] = beside[q] == SVO_NONE || beside[q] == p ? p : n;
            }
    for (uint32_t v = 0; v < n; v++) {
        double *s = sum + 4 * (uint64_t)skeli_root(piece, v);
        s[3] += 1;
        for (uint64_t k = 0; k < 3; k++) s[k] += mesh->position[3 * (uint64_t)v + k];
    }
    /* An end that is one cap is where the curve has it; several caps of one joint are ends of their own. */
    memset(number, 0, c->joints * sizeof *number);
    for (uint32_t v = 0; v < n; v++) number[c->joint_of[v]] += piece[v] == v && beside[v] < n && sum[4 * (uint64_t)v + 3] >= CAP;
    /* An end of the curve of which two caps are two fifths each is two ends that came together. */
    memset(large, 0, c->joints * sizeof *large);
    memset(all, 0, c->joints * sizeof *all);
    for (uint32_t v = 0; v < n; v++) all[c->joint_of[v]]++;
    *merged = false;
    for (uint32_t v = 0; v < n; v++) {
        const uint32_t j = c->joint_of[v];
        if (piece[v] != v || beside[v] >= n || degree[j] != 1 || sum[4 * (uint64_t)v + 3] < CAP || 5 * sum[4 * (uint64_t)v + 3] < 2 * all[j]) continue;
        *merged |= ++large[j] > 1;
    }
    skeli_give(pool, large);
    skeli_give(pool, all);
    bool ok = true;
    for (uint32_t v = 0; v < n && ok; v++) {
        const uint32_t j = c->joint_of[v];
        if (piece[v] != v || beside[v] >= n || sum[4 * (uint64_t)v + 3] < CAP || (degree[j] == 1 && number[j] == 1)) continue;
        double p[3];
        for (uint64_t k = 0; k < 3; k++) p[k] = sum[4 * (uint64_t)v + k] / sum[4 * (uint64_t)v + 3];
        ok = svo_buffer_append(ends, p, sizeof p) != NULL;
    }
    for (uint32_t j = 0; j < c->joints && ok; j++)
        if (degree[j] == 1 && number[j] <= 1) ok = svo_buffer_append(ends, c->position + 3 * (uint64_t)j, 3 * sizeof *c->position) != NULL;
    skeli_give(pool, number);
    skeli_give(pool, piece);
    skeli_give(pool, beside);
    skeli_give(pool, degree);
    skeli_give(pool, sum);
    return ok ? SVO_OK : skeli_no_memory(err);
}

/* False where the grid has no point near an end. */
static bool anchor_ends(cells *g, const svo_buffer *ends)
{
    for (uint64_t e = 0; e < ends->size / (3 * sizeof(double)); e++) {
        const double *p = (const double *)(const void *)ends->data + 3 * e;
        double near[3];
        if (!skeli_surface_inside(g->surface, p) && skeli_surface_distance(g->surface, p, 4.0 * SKEL_LATTICE, near) < 4.0 * SKEL_LATTICE) p = near;
        uint64_t i = near_point(g, p, NULL);
        if (i == UINT64_MAX) return false;
        uint64_t x = i % g->n[0], y = i / g->n[0] % g->n[1], z = i / g->n[0] / g->n[1];
        g->place[2 * (x + y * g->stride[1] + z * g->stride[2])] = PRESENT | ANCHOR;
    }
    return true;
}

static svo_result at_side(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, const skeli_genus *want, uint32_t side, uint32_t threads, const svo_buffer *ends,
                          skeli_curve *c, bool *done, bool *beyond, svo_error *err)
{
    cells g = {.surface = surface};
    size_up(&g, mesh, side);
    *beyond = g.places > MOST_CELLS;
    if (*beyond) return SVO_OK;
    g.link = skeli_take(pool, g.points, 1);
    g.edge = skeli_take(pool, g.points, 1);
    g.deep = skeli_take(pool, g.points, sizeof *g.deep);
    if (g.link == NULL || g.edge == NULL || g.deep == NULL) return skeli_no_memory(err);
    mark_near(&g, mesh);
    memset(g.edge, 0, g.points);
    SVO_TRY(svo_parallel_for(threads, (uint64_t)g.n[1] * g.n[2], 16, look_inside, &g, err));
    SVO_TRY(svo_parallel_for(threads, (uint64_t)g.n[1] * g.n[2], 16, look_along, &g, err));
    deepen(&g);
    g.place = skeli_take(pool, g.places, 1);
    if (g.place == NULL) return skeli_no_memory(err);
    SVO_TRY(fill_places(&g, threads, err));
    if (anchor_ends(&g, ends)) {
        SVO_TRY(take_away(pool, &g, err));
        SVO_TRY(to_curve(pool, &g, mesh, want, c, done, err));
    }
    skeli_give(pool, g.link);
    skeli_give(pool, g.edge);
    skeli_give(pool, g.deep);
    skeli_give(pool, g.place);
    return SVO_OK;
}

svo_result skeli_curve_of_cells(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, const skeli_genus *want, bool differs, uint32_t threads, skeli_curve *c, bool *done,
                                svo_error *err)
{
    bool beyond = false;
    svo_buffer ends;
    svo_buffer_init(&ends, pool->allocator);
    bool merged = false;
    svo_result result = caps(pool, mesh, c, &ends, &merged, err);
    *done = false;
    if (!merged && !differs) beyond = true; /* nothing to do */
    for (uint32_t round = 0, side = FIRST_SIDE; round < (differs ? ROUNDS : 1) && result == SVO_OK && !*done && !beyond; round++, side += side / 2)
        result = at_side(pool, mesh, surface, want, side, threads, &ends, c, done, &beyond, err);
    svo_buffer_free(&ends);
    return result;
}
