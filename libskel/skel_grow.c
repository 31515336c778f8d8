/* Limbs that the contraction has merged with each other, or with the body, get a branch. Where a limb has none, its surface is far from the balls around the curve. The vertex whose way along the
 * surface to what the balls cover is longest is its tip; that way, put into the middle of the solid, is the new branch, and what its balls cover needs no other. So whether a limb has a branch
 * depends on its shape, and not on what the contraction made of it. */
#include <math.h>
#include <string.h>

#include "skeli_curve.h"
#include "svo_morton.h"
#include "svo_task.h"

enum { MOST_TRIES = 256, MOST_LIMBS = 128, MOST_POINTS = 64, SHRINKS = 12, BLOCK = 64 };
#define FAR (4.0 * SKEL_LATTICE)
#define COVERS 0.35    /* of a ball's radius: the surface that is so near to it is its */
#define NEAR_OMEGA 0.5 /* and what is so near in omega */
#define BENT 1.25      /* way along a limb by the straight way to its tip */
#define AT_TIP 0.3     /* the end's ball by its distance to the tip */
#define LEAST 1.5      /* omega: ways that are shorter are no limb's */

typedef struct ball { double at[3], radius; uint32_t joint; } ball;
typedef struct entry { double way; uint32_t vertex; } entry;

typedef struct growing {
    const skeli_soup *mesh;
    const skeli_surface *surface;
    skeli_curve *curve;
    double omega;
    ball *balls;
    uint64_t ball_count, ball_room;
    uint32_t *order; /* vertices, those that lie together near each other */
    uint32_t *near;  /* of each worker: numbers of balls */
    double *gap;      /* of each vertex to the balls */
    uint32_t *ball_of;
    double *way;      /* along the surface to what is covered; INFINITY: none */
    uint32_t *from;   /* next vertex on that way */
    uint8_t *tried;
    uint32_t *open;   /* vertices that are not covered at first */
    uint32_t opened;
    uint32_t *edge_start, *edge; /* of open vertices */
    entry *heap;
    uint64_t heap_count, heap_room;
} growing;

static bool covers(const growing *g, uint32_t v) { return g->gap[v] <= fmax(COVERS * g->balls[g->ball_of[v]].radius, NEAR_OMEGA * g->omega); }

static double gap_to(const growing *g, const ball *b, uint32_t v)
{
    const int32_t *q = g->mesh->position + 3 * (uint64_t)v;
    const double x = q[0] - b->at[0], y = q[1] - b->at[1], z = q[2] - b->at[2];
    return sqrt(x * x + y * y + z * z) - b->radius;
}

/* Vertices that lie together have the same balls near them: those that could be nearest to some point of a block's bounding sphere are looked for once. */
static uint32_t near_block(const growing *g, const uint32_t *block, uint32_t count, uint32_t *near)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, middle[3], reach = 0, best = INFINITY;
    for (uint32_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) {
            const double x = g->mesh->position[3 * (uint64_t)block[i] + (uint64_t)k];
            low[k] = fmin(low[k], x), high[k] = fmax(high[k], x);
        }
    for (int k = 0; k < 3; k++) middle[k] = (low[k] + high[k]) / 2, reach += (high[k] - middle[k]) * (high[k] - middle[k]);
    reach = sqrt(reach);
    for (uint32_t k = 0; k < g->ball_count; k++) best = fmin(best, skeli_apart(middle, g->balls[k].at) - g->balls[k].radius);
    const double most = best + 2 * reach + 1e-6 * (reach + fabs(best)) + 1; /* of the gap at the middle; a lattice step of slack for rounding */
    uint32_t found = 0;
    for (uint32_t k = 0; k < g->ball_count; k++)
        if (skeli_apart(middle, g->balls[k].at) - g->balls[k].radius <= most) near[found++] = k;
    return found;
}

static svo_result look(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    growing *g = user;
    uint32_t *near = g->near + worker * g->ball_count;
    (void)err;
    for (uint64_t block = begin; block < end; block++) {
        const uint64_t first = block * BLOCK, left = g->mesh->vertex_count - first;
        const uint32_t *vertices = g->order + first, count = left < BLOCK ? (uint32_t)left : BLOCK, balls = near_block(g, vertices, count, near);
        for (uint32_t i = 0; i < count; i++) {
            const uint32_t v = vertices[i];
            const int32_t *q = g->mesh->position + 3 * (uint64_t)v;
            double best = INFINITY;
            for (uint32_t k = 0; k < balls; k++) {
                const ball *b = &g->balls[near[k]];
                const double x = q[0] - b->at[0], y = q[1] - b->at[1], z = q[2] - b->at[2], d2 = x * x + y * y + z * z, most = best + b->radius;
                if (most <= 0 || d2 >= most * most) continue;
                best = sqrt(d2) - b->radius;
                g->ball_of[v] = near[k];
            }
            g->gap[v] = best;
        }
    }
    return SVO_OK;
}

/* The gap of each vertex to the balls, and the ball it is to. */
static svo_result measure(skeli_pool *pool, growing *g, uint32_t threads, svo_error *err)
{
    const uint64_t n = g->mesh->vertex_count;
    if (threads == 0) threads = svo_processor_count();
    int32_t low[3] = {INT32_MAX, INT32_MAX, INT32_MAX};
    uint64_t *code = skeli_take(pool, n, sizeof *code);
    uint32_t *scratch = skeli_take(pool, n, sizeof *scratch);
    g->order = skeli_take(pool, n, sizeof *g->order);
    g->near = skeli_take(pool, threads * g->ball_count, sizeof *g->near);
    if (code == NULL || scratch == NULL || g->order == NULL || g->near == NULL) return skeli_no_memory(err);
    for (uint64_t i = 0; i < 3 * n; i++)
        if (g->mesh->position[i] < low[i % 3]) low[i % 3] = g->mesh->position[i];
    for (uint64_t v = 0; v < n; v++) {
        uint32_t cell[3]; /* some 2^13 across the mesh */
        for (uint64_t k = 0; k < 3; k++) cell[k] = ((uint32_t)g->mesh->position[3 * v + k] - (uint32_t)low[k]) >> 11;
        code[v] = svo_morton_encode(cell[0], cell[1], cell[2]);
        g->order[v] = (uint32_t)v;
    }
    skeli_sort_by64(g->order, scratch, n, code, 63);
    skeli_give(pool, code);
    skeli_give(pool, scratch);
    return svo_parallel_for(threads, (n + BLOCK - 1) / BLOCK, 16, look, g, err);
}

/* --- the way along the surface ------------------------------------------------------------------------------------------- */

static bool before(const entry *a, const entry *b) { return a->way < b->way || (a->way == b->way && a->vertex < b->vertex); }

static void push(growing *g, double way, uint32_t vertex)
{
    SVO_ASSERT(g->heap_count < g->heap_room);
    uint64_t i = g->heap_count++;
    const entry e = {way, vertex};
    for (; i > 0 && before(&e, &g->heap[(i - 1) / 2]); i = (i - 1) / 2) g->heap[i] = g->heap[(i - 1) / 2];
    g->heap[i] = e;
}

static entry pop(growing *g)
{
    const entry top = g->heap[0], last = g->heap[--g->heap_count];
    uint64_t i = 0;
    for (;;) {
        uint64_t k = 2 * i + 1;
        if (k >= g->heap_count) break;
        if (k + 1 < g->heap_count && before(&g->heap[k + 1], &g->heap[k])) k++;
        if (!before(&g->heap[k], &last)) break;
        g->heap[i] = g->heap[k];
        i = k;
    }
    g->heap[i] = last;
    return top;
}

/* Shorten ways from what is in the heap. Each vertex enters it when its way gets shorter; the heap has room for once an edge. */
static void spread(growing *g)
{
    while (g->heap_count > 0) {
        const entry e = pop(g);
        if (e.way > g->way[e.vertex]) continue;
        const int32_t *p = g->mesh->position + 3 * (uint64_t)e.vertex;
        for (uint32_t k = g->edge_start[e.vertex]; k < g->edge_start[e.vertex + 1]; k++) {
            const uint32_t n = g->edge[k];
            const int32_t *q = g->mesh->position + 3 * (uint64_t)n;
            const double x = (double)p[0] - q[0], y = (double)p[1] - q[1], z = (double)p[2] - q[2], way = e.way + sqrt(x * x + y * y + z * z);
            if (!(way < g->way[n]) || g->heap_count == g->heap_room) continue;
            g->way[n] = way;
            g->from[n] = e.vertex;
            push(g, way, n);
        }
    }
}

/* --- from the surface into the middle ------------------------------------------------------------------------------------ */

/* The largest ball inside that touches the surface at vertex v. */
static bool ball_at(const growing *g, uint32_t v, const double n[3], double most, double at[3], double *radius)
{
    const int32_t *q = g->mesh->position + 3 * (uint64_t)v;
    const double p[3] = {q[0], q[1], q[2]};
    double start[3], r, near[3];
    for (int k = 0; k < 3; k++) start[k] = p[k] + 16 * n[k];
    r = fmin(skeli_surface_ray(g->surface, start, n, FAR) / 2 + 8, most);
    for (int i = 0; i < SHRINKS; i++) {
        for (int k = 0; k < 3; k++) at[k] = p[k] + r * n[k];
        const double d = skeli_surface_distance(g->surface, at, 1.001 * r, near);
        *radius = d < r ? d : r;
        if (d >= 0.97 * r) break;
        double away2 = 0, along = 0;
        for (int k = 0; k < 3; k++) {
            away2 += (near[k] - p[k]) * (near[k] - p[k]);
            along += n[k] * (near[k] - p[k]);
        }
        if (!(along > 0)) break;
        const double next = away2 / (2 * along);
        if (!(next < 0.99 * r)) break;
        r = next;
    }
    return *radius > 0 && skeli_surface_inside(g->surface, at);
}

/* The unit normal of the largest triangle at v, turned inwards. */
static bool inwards(const growing *g, const uint32_t *incident_start, const uint32_t *incident, uint32_t v, double n[3])
{
    double most = 0;
    for (uint32_t k = incident_start[v]; k < incident_start[v + 1]; k++) {
        const uint32_t *c = g->mesh->corner + 3 * (uint64_t)incident[k];
        double a[2][3], x[3], l = 0;
        for (int e = 0; e < 2; e++)
            for (int i = 0; i < 3; i++) a[e][i] = (double)g->mesh->position[3 * (uint64_t)c[e + 1] + (uint64_t)i] - g->mesh->position[3 * (uint64_t)c[0] + (uint64_t)i];
        for (int i = 0; i < 3; i++) {
            x[i] = a[0][(i + 1) % 3] * a[1][(i + 2) % 3] - a[0][(i + 2) % 3] * a[1][(i + 1) % 3];
            l += x[i] * x[i];
        }
        if (!(l > most)) continue;
        most = l;
        for (int i = 0; i < 3; i++) n[i] = x[i] / sqrt(l);
    }
    if (!(most > 0)) return false;
    for (int side = 0; side < 2; side++) {
        double p[3];
        for (int k = 0; k < 3; k++) p[k] = g->mesh->position[3 * (uint64_t)v + (uint64_t)k] + g->omega / 64 * n[k];
        if (skeli_surface_inside(g->surface, p)) return true;
        for (int k = 0; k < 3; k++) n[k] = -n[k];
    }
    return false;
}

/* --- a branch ------------------------------------------------------------------------------------------------------------- */

/* Centres of balls along the way of vertex v, and where it ends on the curve; false where that is no limb. */
static bool branch_of(const growing *g, const uint32_t *incident_start, const uint32_t *incident, uint32_t v, double point[3 * MOST_POINTS], uint32_t *points, uint32_t *joint)
{
    uint32_t n = 0, root = v;
    while (g->from[root] != root) root = g->from[root];
    const ball *to = &g->balls[g->ball_of[root]];
    const double space = fmax(g->omega / 2, g->way[v] / (MOST_POINTS - 4));
    double last = INFINITY;
    for (uint32_t at = v;; at = g->from[at]) {
        double normal[3], p[3], radius;
        if (last - g->way[at] >= space && n + 2 < MOST_POINTS) {
            if (inwards(g, incident_start, incident, at, normal) && ball_at(g, at, normal, to->radius, p, &radius)) {
                if (skeli_apart(p, to->at) < to->radius) break;
                const int32_t *q = g->mesh->position + 3 * (uint64_t)v;
                const double tip[3] = {q[0], q[1], q[2]};
                if (n == 0 ? radius >= AT_TIP * skeli_apart(p, tip) : skeli_apart(p, point + 3 * ((uint64_t)n - 1)) >= fmax(g->omega / 2, radius / 2)) memcpy(point + 3 * (uint64_t)n++, p, sizeof p);
                last = g->way[at];
            }
        }
        if (at == root) break;
    }
    if (n == 0) return false;
    *joint = to->joint;
    memcpy(point + 3 * (uint64_t)n++, g->curve->position + 3 * (uint64_t)to->joint, 3 * sizeof *point);
    *points = n;
    double ratio;
    return skeli_is_limb(g->surface, g->omega, SKELI_LIMB_NEW, BENT * g->gap[v], point, n, &ratio);
}

static void add_ball(growing *g, const double at[3], double most, uint32_t joint)
{
    const double r = skeli_surface_inside(g->surface, at) ? skeli_surface_distance(g->surface, at, most, NULL) : 0;
    g->balls[g->ball_count] = (ball){.radius = r, .joint = joint};
    memcpy(g->balls[g->ball_count++].at, at, sizeof g->balls->at);
}

/* Balls along a bone. */
static void add_balls(growing *g, uint32_t a, uint32_t b)
{
    const double *p = g->curve->position + 3 * (uint64_t)a, *q = g->curve->position + 3 * (uint64_t)b, length = skeli_apart(p, q);
    double at[3], most = FAR;
    for (double done = 0; done < length && g->ball_count < g->ball_room;) {
        for (int k = 0; k < 3; k++) at[k] = p[k] + (q[k] - p[k]) * done / length;
        add_ball(g, at, most, 2 * done < length ? a : b);
        const double r = g->balls[g->ball_count - 1].radius, step = fmax(g->omega / 2, r / 4);
        most = r > 0 ? r + step + 1 : FAR; /* that is how far the surface is from the next one at most */
        done += step;
    }
    if (g->ball_count < g->ball_room) add_ball(g, q, most, b);
}

/* Joints and bones of a branch that ends at `joint`; vertices that are nearer to its balls than to others are its, and what it covers is covered. */
static void add_branch(growing *g, const double *point, uint32_t points, uint32_t joint)
{
    skeli_curve *c = g->curve;
    const uint64_t first = g->ball_count;
    for (uint32_t i = points - 1, last = joint; i-- > 0;) {
        memcpy(c->position + 3 * (uint64_t)c->joints, point + 3 * (uint64_t)i, 3 * sizeof *point);
        c->bone[2 * c->bones] = last;
        c->bone[2 * c->bones++ + 1] = c->joints;
        add_balls(g, last, c->joints);
        last = c->joints++;
    }
    for (uint32_t i = 0; i < g->opened; i++) {
        const uint32_t v = g->open[i];
        double best = g->gap[v];
        uint32_t of = SVO_NONE;
        for (uint64_t k = first; k < g->ball_count; k++) {
            const double gap = gap_to(g, &g->balls[k], v);
            if (gap >= best) continue;
            best = gap;
            of = (uint32_t)k;
        }
        if (of == SVO_NONE) continue;
        g->gap[v] = best;
        g->ball_of[v] = of;
        c->joint_of[v] = g->balls[of].joint;
        if (g->way[v] > 0 && covers(g, v)) {
            g->way[v] = 0;
            g->from[v] = v;
            push(g, 0, v);
        }
    }
    spread(g);
}

/* Neighbours of vertices that are not covered, and triangles at them. */
static svo_result connect(skeli_pool *pool, growing *g, uint32_t **incident_start, uint32_t **incident, svo_error *err)
{
    const skeli_soup *m = g->mesh;
    const uint64_t n = m->vertex_count;
    uint32_t *start = skeli_take(pool, n + 2, sizeof *start);
    g->edge_start = skeli_take(pool, n + 2, sizeof *g->edge_start);
    if (start == NULL || g->edge_start == NULL) return skeli_no_memory(err);
    memset(start, 0, (n + 2) * sizeof *start);
    for (uint64_t i = 0; i < 3 * (uint64_t)m->triangle_count; i++) start[m->corner[i] + 2]++;
    for (uint64_t v = 0; v < n; v++) start[v + 2] += start[v + 1];
    for (uint64_t v = 0; v < n + 2; v++) g->edge_start[v] = 2 * start[v];
    *incident = skeli_take(pool, 3 * (uint64_t)m->triangle_count, sizeof **incident);
    g->edge = skeli_take(pool, 6 * (uint64_t)m->triangle_count, sizeof *g->edge);
    if (*incident == NULL || g->edge == NULL) return skeli_no_memory(err);
    for (uint32_t t = 0; t < m->triangle_count; t++)
        for (uint64_t k = 0; k < 3; k++) {
            const uint32_t v = m->corner[3 * (uint64_t)t + k];
            (*incident)[start[v + 1]++] = t;
            g->edge[g->edge_start[v + 1]++] = m->corner[3 * (uint64_t)t + (k + 1) % 3];
            g->edge[g->edge_start[v + 1]++] = m->corner[3 * (uint64_t)t + (k + 2) % 3];
        }
    *incident_start = start;
    g->heap_room = 6 * (uint64_t)m->triangle_count + 2 * n + 2;
    g->heap = skeli_take(pool, g->heap_room, sizeof *g->heap);
    return g->heap == NULL ? skeli_no_memory(err) : SVO_OK;
}

static svo_result begin(skeli_pool *pool, growing *g, svo_error *err)
{
    skeli_curve *c = g->curve;
    const uint64_t n = g->mesh->vertex_count, more = (uint64_t)MOST_LIMBS * MOST_POINTS;
    double *position = skeli_take(pool, 3 * (c->joints + more), sizeof *position), total = 0;
    uint32_t *bone = skeli_take(pool, 2 * (c->bones + more), sizeof *bone);
    for (uint64_t b = 0; b < c->bones; b++) total += skeli_apart(c->position + 3 * (uint64_t)c->bone[2 * b], c->position + 3 * (uint64_t)c->bone[2 * b + 1]);
    g->ball_room = (uint64_t)fmin(2 * total / g->omega, 1e6) + 2 * c->bones + c->joints + 8 * more;
    g->balls = skeli_take(pool, g->ball_room, sizeof *g->balls);
    g->gap = skeli_take(pool, n, sizeof *g->gap);
    g->way = skeli_take(pool, n, sizeof *g->way);
    g->ball_of = skeli_take(pool, n, sizeof *g->ball_of);
    g->from = skeli_take(pool, n, sizeof *g->from);
    g->open = skeli_take(pool, n, sizeof *g->open);
    g->tried = skeli_take(pool, n, 1);
    if (position == NULL || bone == NULL || g->balls == NULL || g->gap == NULL || g->way == NULL || g->ball_of == NULL || g->from == NULL || g->open == NULL || g->tried == NULL)
        return skeli_no_memory(err);
    memcpy(position, c->position, 3 * (uint64_t)c->joints * sizeof *position);
    memcpy(bone, c->bone, 2 * c->bones * sizeof *bone);
    skeli_give(pool, c->position);
    skeli_give(pool, c->bone);
    c->position = position;
    c->bone = bone;
    memset(g->tried, 0, n);
    memset(g->ball_of, 0, n * sizeof *g->ball_of);
    return SVO_OK;
}

static void end(skeli_pool *pool, growing *g)
{
    void *const all[] = {g->balls, g->gap, g->way, g->ball_of, g->from, g->open, g->tried, g->edge_start, g->edge, g->heap, g->order, g->near};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) skeli_give(pool, all[i]);
}

svo_result skeli_grow(skeli_pool *pool, const skeli_soup *mesh, const skeli_surface *surface, double omega, uint32_t threads, skeli_curve *c, bool *grown, svo_error *err)
{
    growing g = {.mesh = mesh, .surface = surface, .curve = c, .omega = omega};
    uint32_t *incident_start = NULL, *incident = NULL, limbs = 0;
    *grown = false;
    if (c->bones == 0) return SVO_OK;
    SVO_TRY(begin(pool, &g, err));
    for (uint64_t b = 0; b < c->bones; b++) add_balls(&g, c->bone[2 * b], c->bone[2 * b + 1]);
    SVO_TRY(measure(pool, &g, threads, err));
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const bool covered = covers(&g, v);
        g.way[v] = covered ? 0 : INFINITY;
        g.from[v] = v;
        if (!covered) g.open[g.opened++] = v;
    }
    if (g.opened > 0) {
        SVO_TRY(connect(pool, &g, &incident_start, &incident, err));
        for (uint32_t v = 0; v < mesh->vertex_count; v++)
            if (g.way[v] == 0) push(&g, 0, v);
        spread(&g);
    }
    for (uint32_t tries = 0; tries < MOST_TRIES && limbs < MOST_LIMBS && g.opened > 0; tries++) {
        uint32_t tip = SVO_NONE, points, joint;
        double point[3 * MOST_POINTS];
        for (uint32_t i = 0; i < g.opened; i++) {
            const uint32_t v = g.open[i];
            if (g.tried[v] == 0 && g.way[v] < INFINITY && (tip == SVO_NONE || g.way[v] > g.way[tip])) tip = v;
        }
        if (tip == SVO_NONE || g.way[tip] < LEAST * omega) break;
        const bool limb = branch_of(&g, incident_start, incident, tip, point, &points, &joint);
        if (limb) {
            add_branch(&g, point, points, joint);
            limbs++;
        }
        const double about = fmax(omega, g.way[tip] / 2);
        const int32_t *p = mesh->position + 3 * (uint64_t)tip;
        for (uint32_t i = 0; i < g.opened; i++) { /* not again */
            const int32_t *q = mesh->position + 3 * (uint64_t)g.open[i];
            const double x = (double)p[0] - q[0], y = (double)p[1] - q[1], z = (double)p[2] - q[2];
            if (x * x + y * y + z * z <= about * about) g.tried[g.open[i]] = 1;
        }
    }
    end(pool, &g);
    skeli_give(pool, incident_start);
    skeli_give(pool, incident);
    *grown = limbs > 0;
    if (limbs == 0) return SVO_OK;
    uint32_t *into = skeli_take(pool, c->joints, sizeof *into);
    if (into == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < c->joints; j++) into[j] = j;
    svo_result result = skeli_curve_merge(pool, mesh, c, into, err);
    skeli_give(pool, into);
    return result;
}
