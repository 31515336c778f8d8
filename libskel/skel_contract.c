/* Contraction (Willcocks 2013, sections 5.4, 5.5): every sweep moves each vertex to m + beta (s - m), where m is the mean of the vertices within omega
 * (5.4.2, over G, the ball), s the mean of its one-ring (5.4.1) and beta = a / rho its one-ring area now over that at the start
 * (5.4.4), clamped to [0, 1]; rho = 0 gives beta = 0. All of a sweep reads the positions before it (Jacobi), and between sweeps positions are
 * whole lattice steps, so that sums are exact and no thread count or search structure changes the result.
 *
 * SKEL_METHOD_FAST does the same on fewer and fewer vertices, and with momentum: those that come within omega/8 are welded, with their count as weight
 * in m, 4 smoothing steps share one ball search, and what a vertex moved goes on in part (the heavy ball, Polyak 1964). docs/design/005-skeletons.md has the reasons and the figures. */
#include "skeli_internal.h"
#include "skeli_solid.h"
#include "skeli_thick.h"

#include <math.h>
#include <string.h>

#include "svo_task.h"

enum {
    STILL_SWEEPS = 8,      /* that must be quiet in a row */
    CLUSTER_BALL = 14,      /* vertices a ball of radius omega from which on connected ones are clustered before the first sweep */
    DENSE_BALL = 200,      /* the same, for those that share no triangles */
    FIRST_INTERVAL = 5,    /* sweeps between welds */
    LAST_INTERVAL = 40,
    SETTLED_AFTER = 150,   /* sweeps without a weld after which any vertex may be damped */
    REVERSAL = 8,          /* what turning round adds to a vertex's reversals; going on in the same direction takes one away */
    REVERSALS_FREE = 8 * REVERSAL,   /* a vertex may turn round that often before it is damped */
    REVERSALS_MOST = 204 * REVERSAL, /* to a fiftieth */
    SMOOTHING_STEPS = 4,   /* a ball search, fast method */
    THICK_INTERVAL = 10,   /* sweeps between looks at what is thick */
    MOMENTUM_WORK = 3000000, /* vertices times sweeps from which on there is momentum: what takes less is left as it is */
    SLOW_WORK = 10000000,  /* vertices times sweeps */
    SLOW_COUNT = 20000,    /* vertices that are left then where there is far to go: the quick way costs detail, so others do without */
    SWEEPS = 6000,         /* unless stated */
    MOST_SWEEPS = 20000,   /* the same, while no more than FEW vertices are left: fat shapes shrink on for thousands of sweeps that take next to no time */
    FEW = 2000,
    PARALLEL_FROM = 4096,  /* fewer items are not worth a thread: they are one block */
    GRAIN = 1024           /* items of a block otherwise */
};
#define STILL 1e-3 /* of omega: largest movement of a quiet sweep */
/* What of its last step a vertex goes on with where beta is MOMENTUM_BETA or more; below, where a limb has become thin, the less the smaller beta is, so that ends do not run on into their limbs.
 * It adds no more than MOMENTUM_MOST of the radius of the vertex's ball: slow parts are what it is for. */
#define MOMENTUM 0.9
#define MOMENTUM_BETA 0.25
#define MOMENTUM_MOST 0.045
#define LATTICE_END (SKEL_LATTICE - 1.0)

typedef struct contraction {
    skeli_state *s;
    const skel_options *options;
    double omega; /* lattice steps */
    uint64_t work; /* vertices times sweeps */
    bool merged_lately; /* damping waits for the welds to have done what they can */
    bool fast;
    struct skeli_solid *solid;
    skeli_pool *pool;
    uint8_t *doublings; /* of the radius of each vertex's ball */
    float *way;         /* that each vertex has left before it meets another part of the surface */
    uint32_t thick;     /* vertices with any */
    bool ways;          /* are known: where there are few vertices there is no need */
    skel_flann *flann;  /* NULL: the grid */
    bool same;          /* vertices (and radii of their balls) as in the sweep before */
    bool placed;        /* points are where vertices are, fast method */
    /* search */
    int32_t *point;
    uint32_t *point_weight, *point_of, *order;
    uint64_t *key;
    skel_ball_sum *sum;
    struct movement *moved; /* of each block of vertices */
} contraction;

static svo_result each(const contraction *c, uint64_t count, svo_range_fn fn, void *user)
{
    return svo_parallel_for(count < PARALLEL_FROM ? 1 : c->options->threads, count, count < PARALLEL_FROM ? count : GRAIN, fn, user, NULL);
}

/* --- ball means --------------------------------------------------------------------------------------------------- */

/* The literal method keeps all vertices: those that coincide are searched once, with their number as weight. The sums are exact, so
 * this changes nothing but the time. */
static uint64_t distinct_points(contraction *c)
{
    skeli_state *s = c->s;
    uint32_t n = s->count;
    for (uint32_t i = 0; i < n; i++) c->order[i] = i;
    for (int axis = 0; axis < 3; axis++) {
        for (uint32_t i = 0; i < n; i++) c->key[i] = (uint64_t)((int64_t)s->position[3 * (uint64_t)i + (uint64_t)axis] + SKEL_LATTICE);
        skeli_sort_by64(c->order, c->point_of, n, c->key, 25);
    }
    uint64_t points = 0;
    for (uint32_t k = 0; k < n; k++) {
        const double *p = s->position + 3 * (uint64_t)c->order[k];
        int32_t q[3] = {(int32_t)p[0], (int32_t)p[1], (int32_t)p[2]};
        if (k == 0 || memcmp(q, c->point + 3 * (points - 1), sizeof q) != 0) {
            memcpy(c->point + 3 * points, q, sizeof q);
            c->point_weight[points++] = 0;
        }
        c->point_weight[points - 1] += s->weight[c->order[k]];
        c->point_of[c->order[k]] = (uint32_t)(points - 1);
    }
    return points;
}

static svo_result ball_sums(contraction *c, svo_error *err)
{
    uint64_t points = c->s->count;
    const uint8_t *doublings = c->thick > 0 ? c->doublings : NULL;
    if (!c->fast) {
        points = distinct_points(c);
    } else if (!c->placed) {
        for (uint64_t i = 0; i < 3 * points; i++) c->point[i] = (int32_t)c->s->position[i];
        memcpy(c->point_weight, c->s->weight, points * sizeof *c->point_weight);
        c->placed = true;
    }
    if (c->flann == NULL) SVO_TRY(skel_radius_grid(c->options->allocator, c->point, c->point_weight, doublings, points, c->omega / SKEL_LATTICE, c->options->threads, c->sum, err));
    else SVO_TRY(skel_flann_sums(c->flann, c->point, c->point_weight, doublings, points, c->same && c->fast, c->sum, err));
    c->same = true;
    return SVO_OK;
}

/* --- a sweep ------------------------------------------------------------------------------------------------------ */

/* Lattice steps. sum (over original vertices) and max are of the steps that equation 5.4.4 asks for, far is how far vertices went. */
typedef struct movement { double sum, max, far; } movement;

/* Four numbers a vertex, of which three are used: vectors of four are added in one step. They lie as doubles do. */
typedef double four __attribute__((vector_size(32), aligned(8), may_alias));

/* A smoothing step. The first learns the thickness of each vertex before it, the last moves it after it: both concern the vertex alone, and threads meet once less for each. */
typedef struct smoothing {
    contraction *c;
    const four *from;
    four *to;
    bool first, last;
} smoothing;

static void area(skeli_state *s, uint64_t t)
{
    const uint32_t *c = s->corner + 3 * t;
    s->area[t] = skeli_area(s->position + 3 * (uint64_t)c[0], s->position + 3 * (uint64_t)c[1], s->position + 3 * (uint64_t)c[2]);
}

/* Items are vertices, then triangles. */
static svo_result means_and_areas(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    const smoothing *m = user;
    const contraction *c = m->c;
    const uint64_t vertices = c->s->count;
    for (uint64_t k = begin > vertices ? begin : vertices; k < end; k++) area(c->s, k - vertices);
    for (uint64_t i = begin; i < end && i < vertices; i++) {
        const skel_ball_sum *b = &c->sum[c->fast ? i : c->point_of[i]];
        const double *p = c->s->position + 3 * i, weight = (double)b->weight;
        double *mean = c->s->mean + 3 * i;
        mean[0] = (double)b->x / weight;
        mean[1] = (double)b->y / weight;
        mean[2] = (double)b->z / weight;
        m->to[i] = (four){p[0], p[1], p[2], 0};
    }
    return SVO_OK;
}

static double thickness(const skeli_state *s, uint64_t i)
{
    double a = 0;
    for (uint32_t k = s->incident_start[i]; k < s->incident_start[i + 1]; k++) a += s->area[s->incident[k]];
    const double b = s->rho[i] > 0 && s->edge_start[i + 1] > s->edge_start[i] ? a / s->rho[i] : 0;
    return b < 1 ? b : 1;
}

/* How much of its last step, which was `last` long, vertex i goes on with: nothing where it is slowed down. */
static double momentum(const contraction *c, uint64_t i, double last)
{
    const skeli_state *s = c->s;
    if (!c->fast || c->work < MOMENTUM_WORK || s->reversals[i] > REVERSALS_FREE) return 0;
    const double thick = s->beta[i] < MOMENTUM_BETA ? s->beta[i] / MOMENTUM_BETA : 1;
    const double most = MOMENTUM_MOST * c->omega * (c->thick > 0 ? 1u << c->doublings[i] : 1), kept = MOMENTUM * thick;
    return kept * last > most ? most / last : kept;
}

/* Take the step to `target`, and a part of the last step. A vertex that keeps turning round where it should rest is slowed down: such cycles come
 * from balls that gain and lose a member each sweep. The movement that counts is that before damping and without momentum, which is zero where nothing is left to do:
 * slowing a vertex down is not convergence. */
static void move(const contraction *c, uint64_t i, const four target, movement *m)
{
    skeli_state *s = c->s;
    const double noise = 1e-10 * c->omega * c->omega;
    double step[3], length2 = 0, last2 = 0, along = 0, far2 = 0, *last = s->step + 3 * i, *p = s->position + 3 * i;
    for (int k = 0; k < 3; k++) {
        step[k] = target[k] - p[k];
        length2 += step[k] * step[k];
        last2 += last[k] * last[k];
        along += step[k] * last[k];
    }
    double length = sqrt(length2), f = 1;
    m->sum += length * s->weight[i];
    if (length > m->max) m->max = length;
    if (c->fast) {
        if ((s->beta[i] < 0.05 || !c->merged_lately) && along < -0.3 * sqrt(length2 * last2) && length2 > noise) s->reversals[i] += REVERSAL;
        else if (c->work >= MOMENTUM_WORK && s->reversals[i] > 0 && along > 0.9 * sqrt(length2 * last2)) s->reversals[i]--;
        if (s->reversals[i] > REVERSALS_MOST) s->reversals[i] = REVERSALS_MOST;
        if (s->reversals[i] > REVERSALS_FREE) f = 1 / (1 + 0.25 / REVERSAL * (s->reversals[i] - REVERSALS_FREE));
    }
    const double kept = momentum(c, i, sqrt(last2));
    for (int k = 0; k < 3; k++) {
        last[k] = f * step[k] + kept * last[k];
        far2 += last[k] * last[k];
        p[k] = fmax(-LATTICE_END, fmin(LATTICE_END, rint(p[k] + last[k]))); /* with momentum a vertex may leave the hull of the others, and must not leave the lattice */
        if (c->fast) c->point[3 * i + (uint64_t)k] = (int32_t)p[k];
    }
    const double far = sqrt(far2);
    if (far > m->far) m->far = far;
    if (c->ways) c->way[i] -= (float)(2 * far); /* what it is on its way to may come as fast */
}

static svo_result smooth(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    (void)err;
    const smoothing *m = user;
    skeli_state *s = m->c->s;
    movement moved = {0, 0, 0};
    for (uint64_t i = begin; i < end; i++) {
        if (m->first) s->beta[i] = thickness(s, i);
        const double b = s->beta[i];
        const four mean = {s->mean[3 * i], s->mean[3 * i + 1], s->mean[3 * i + 2], 0};
        const uint64_t first = s->edge_start[i], last = s->edge_start[i + 1];
        four to = mean, sum = {0, 0, 0, 0};
        if (b > 0) {
            for (uint64_t e = first; e < last; e++) sum += m->from[s->edge[2 * e + 1]];
            to = mean + b * (sum * (1.0 / (double)(last - first)) - mean);
        }
        if (m->last) move(m->c, i, to, &moved);
        else m->to[i] = to;
    }
    if (m->last) m->c->moved[begin / GRAIN] = moved;
    return SVO_OK;
}

/* What is read while vertices move are the copies that the last smoothing step began from. */
static svo_result sweep(contraction *c, movement *m, svo_error *err)
{
    skeli_state *s = c->s;
    SVO_TRY(ball_sums(c, err));
    smoothing work = {.c = c, .to = (four *)s->next};
    const int steps = c->fast ? SMOOTHING_STEPS : 1;
    SVO_TRY(each(c, s->count + (uint64_t)s->triangle_count, means_and_areas, &work));
    for (int i = 0; i < steps; i++) {
        work.from = work.to;
        work.to = (four *)s->next + (i % 2 == 0 ? s->original_count : 0);
        work.first = i == 0;
        work.last = i == steps - 1;
        SVO_TRY(each(c, s->count, smooth, &work));
    }
    *m = (movement){0, 0, 0};
    for (uint64_t k = 0; k * GRAIN < s->count; k += s->count < PARALLEL_FROM ? PARALLEL_FROM : 1) { /* blocks of each() */
        m->sum += c->moved[k].sum;
        if (c->moved[k].max > m->max) m->max = c->moved[k].max;
        if (c->moved[k].far > m->far) m->far = c->moved[k].far;
    }
    return SVO_OK;
}

/* --- state -------------------------------------------------------------------------------------------------------- */

/* Edges in both directions. They are made distinct in one direction first: most are sides of two triangles, and it is here that the run needs most memory. Before
 * the large arrays of the state are taken. */
static svo_result begin_edges(skeli_pool *pool, const skeli_soup *mesh, skeli_state *s, svo_error *err)
{
    uint64_t f = mesh->triangle_count, n = 0;
    uint32_t *side = skeli_take(pool, 6 * f, sizeof *side), *scratch = skeli_take(pool, 6 * f, sizeof *scratch);
    s->bucket = skeli_take(pool, (uint64_t)mesh->vertex_count + 2, sizeof *s->bucket);
    if (side == NULL || scratch == NULL || s->bucket == NULL) return skeli_no_memory(err);
    for (uint64_t t = 0; t < f; t++) {
        const uint32_t *c = mesh->corner + 3 * t; /* they ascend */
        for (int k = 0; k < 3; k++) {
            uint32_t a = c[k == 2 ? 0 : k], b = c[k == 2 ? 2 : k + 1];
            if (a == b) continue;
            side[2 * n] = a;
            side[2 * n++ + 1] = b;
        }
    }
    n = skeli_sort_unique(side, n, 2, mesh->vertex_count, scratch, s->bucket);
    skeli_give(pool, scratch);
    s->edge = skeli_take(pool, 4 * n, sizeof *s->edge);
    if (s->edge == NULL) return skeli_no_memory(err);
    for (uint64_t e = 0; e < n; e++) {
        s->edge[4 * e] = s->edge[4 * e + 3] = side[2 * e];
        s->edge[4 * e + 1] = s->edge[4 * e + 2] = side[2 * e + 1];
    }
    skeli_give(pool, side);
    s->scratch = skeli_take(pool, 4 * n > 3 * f ? 4 * n : 3 * f, sizeof *s->scratch);
    if (s->scratch == NULL) return skeli_no_memory(err);
    s->edge_count = skeli_sort_unique(s->edge, 2 * n, 2, mesh->vertex_count, s->scratch, s->bucket);
    return SVO_OK;
}

static svo_result begin_state(skeli_pool *pool, const skeli_soup *mesh, skeli_state *s, svo_error *err)
{
    uint64_t n = mesh->vertex_count, f = mesh->triangle_count;
    memset(s, 0, sizeof *s);
    s->count = s->original_count = mesh->vertex_count;
    SVO_TRY(begin_edges(pool, mesh, s, err));
    s->position = skeli_take(pool, 3 * n, sizeof *s->position);
    s->weight = skeli_take(pool, n, sizeof *s->weight);
    s->rho = skeli_take(pool, n, sizeof *s->rho);
    s->beta = skeli_take(pool, n, sizeof *s->beta);
    s->step = skeli_take(pool, 3 * n, sizeof *s->step);
    s->reversals = skeli_take(pool, n, sizeof *s->reversals);
    s->corner = skeli_take(pool, 3 * f, sizeof *s->corner);
    s->edge_start = skeli_take(pool, n + 1, sizeof *s->edge_start);
    s->incident_start = skeli_take(pool, n + 1, sizeof *s->incident_start);
    s->incident = skeli_take(pool, 3 * f, sizeof *s->incident);
    s->area = skeli_take(pool, f, sizeof *s->area);
    s->live = skeli_take(pool, n, sizeof *s->live);
    s->label = skeli_take(pool, n, sizeof *s->label);
    s->mean = skeli_take(pool, 3 * n, sizeof *s->mean);
    s->next = s->gather = skeli_take(pool, 8 * n, sizeof *s->gather); /* never at the same time */
    if (s->position == NULL || s->weight == NULL || s->rho == NULL || s->beta == NULL || s->step == NULL || s->reversals == NULL ||
        s->corner == NULL || s->edge_start == NULL || s->incident_start == NULL || s->incident == NULL ||
        s->area == NULL || s->live == NULL || s->bucket == NULL || s->label == NULL || s->mean == NULL ||
        s->gather == NULL)
        return skeli_no_memory(err);
    for (uint64_t i = 0; i < 3 * n; i++) s->position[i] = mesh->position[i];
    memset(s->step, 0, 3 * n * sizeof *s->step);
    memset(s->reversals, 0, n * sizeof *s->reversals);
    for (uint32_t i = 0; i < n; i++) {
        s->weight[i] = 1;
        s->beta[i] = 1;
        s->live[i] = i;
    }
    skeli_rings(mesh, s->position, s->rho);
    for (uint64_t t = 0; t < f; t++) {
        const uint32_t *c = mesh->corner + 3 * t;
        if (c[0] != c[1] && c[1] != c[2]) memcpy(s->corner + 3 * (uint64_t)s->triangle_count++, c, 3 * sizeof *c);
    }
    skeli_index(s);
    return SVO_OK;
}

/* A group has the shortest way of its members. */
static svo_result collapse(contraction *c, uint32_t groups, svo_error *err)
{
    skeli_state *s = c->s;
    float *shortest = (float *)c->sum; /* not in use between sweeps */
    c->placed = false;
    if (c->thick > 0) c->same = false; /* a group may get another radius */
    if (c->flann != NULL && c->same) SVO_TRY(skel_flann_weld(c->flann, s->label, groups, err));
    if (c->ways) {
        for (uint32_t g = 0; g < groups; g++) shortest[g] = INFINITY;
        for (uint32_t i = 0; i < s->count; i++)
            if (c->way[i] < shortest[s->label[i]]) shortest[s->label[i]] = c->way[i];
        memcpy(c->way, shortest, groups * sizeof *shortest);
        if (c->thick > 0) c->thick = skeli_doublings(c->way, groups, c->omega, c->doublings);
    }
    skeli_collapse(s, groups);
    return SVO_OK;
}

/* Thick parts: wider balls, and clusters of a quarter of their radius. */
static svo_result weld_thick(contraction *c, svo_error *err)
{
    skeli_state *s = c->s;
    c->thick = skeli_doublings(c->way, s->count, c->omega, c->doublings);
    c->same = false;
    if (c->thick == 0) return SVO_OK;
    const uint32_t clusters = skeli_cluster(s, c->omega / 4, c->doublings);
    return clusters < s->count ? collapse(c, clusters, err) : SVO_OK;
}

static svo_result weld_live(contraction *c, uint32_t *removed, svo_error *err)
{
    uint32_t groups;
    SVO_TRY(skeli_weld(c->options->allocator, c->s->position, c->s->count, NULL, c->omega / 8, c->s->label, &groups, err));
    *removed = c->s->count - groups;
    return groups < c->s->count ? collapse(c, groups, err) : SVO_OK;
}

/* Equation 5.7.1: area of the tessellated mesh with its vertices where they were contracted to, percent of the original. (Sums of
 * one-ring areas count every triangle three times, in both.) */
static double thinness_error(const skeli_soup *mesh, const skeli_state *s)
{
    double before = 0, after = 0;
    for (uint64_t t = 0; t < mesh->triangle_count; t++) {
        double p[3][3], q[3][3];
        for (int k = 0; k < 3; k++) {
            uint32_t v = mesh->corner[3 * t + (uint64_t)k];
            for (int j = 0; j < 3; j++) p[k][j] = mesh->position[3 * (uint64_t)v + (uint64_t)j];
            memcpy(q[k], s->position + 3 * (uint64_t)s->live[v], sizeof q[k]);
        }
        before += skeli_area(p[0], p[1], p[2]);
        after += skeli_area(q[0], q[1], q[2]);
    }
    return before > 0 ? 100 * after / before : 0;
}

/* The cost of a sweep grows with the vertices times those in a ball, so input that is much denser than omega (a scan, a fan of 100k
 * triangles) becomes connected clusters of omega/2 before the first sweep, each with the weight of its vertices. Groups of the radius omega
 * tell how many vertices a ball holds. Triangles that share no vertices do not cluster: what is very dense even then is welded by distance. */
static svo_result weld_dense(contraction *c, svo_error *err)
{
    skeli_state *s = c->s;
    uint32_t balls, removed;
    SVO_TRY(skeli_weld(c->options->allocator, s->position, s->count, NULL, c->omega, s->label, &balls, err));
    if (s->count / CLUSTER_BALL < balls) return SVO_OK;
    uint32_t clusters = skeli_cluster(s, c->omega / 2, NULL);
    if (clusters < s->count) SVO_TRY(collapse(c, clusters, err));
    return s->count / DENSE_BALL < balls ? SVO_OK : weld_live(c, &removed, err);
}

/* May another sweep be made after so many? */
static bool go_on(const contraction *c, uint64_t made)
{
    const uint64_t stated = c->options->max_iterations;
    return made < (stated != 0 ? stated : c->fast && c->s->count <= FEW ? MOST_SWEEPS : SWEEPS);
}

static double done(const contraction *c, uint64_t made)
{
    const uint64_t stated = c->options->max_iterations;
    if (stated != 0) return (double)made / (double)stated;
    return made <= SWEEPS ? 0.9 * (double)made / SWEEPS : 0.9 + 0.1 * (double)(made - SWEEPS) / (MOST_SWEEPS - SWEEPS);
}

static svo_result run(contraction *c, skel_report *report, svo_error *err)
{
    const skel_options *o = c->options;
    uint64_t last_weld = 0, last_removal = 0;
    uint32_t interval = FIRST_INTERVAL, quiet = 0;
    bool hurry = false;
    movement m = {0, 0, 0};
    if (c->fast) {
        SVO_TRY(weld_dense(c, err));
        c->ways = c->s->count >= SLOW_COUNT;
        if (c->ways) SVO_TRY(skeli_ways(c->pool, c->s, o->threads, c->way, err));
    }
    if (c->solid != NULL) SVO_TRY(skeli_solid_step(c->solid, c->s, 0, true, err));
    for (uint64_t it = 1; go_on(c, it - 1) && !report->converged; it++) {
        c->merged_lately = it - last_removal <= SETTLED_AFTER;
        SVO_TRY(sweep(c, &m, err));
        if (c->solid != NULL) SVO_TRY(skeli_solid_step(c->solid, c->s, m.far, false, err));
        report->iterations = it;
        quiet = m.max < STILL * c->omega ? quiet + 1 : 0;
        report->converged = o->delta > 0 ? m.sum < o->delta * SKEL_LATTICE : quiet >= STILL_SWEEPS;
        if (o->progress != NULL && !o->progress(o->user, done(c, it)))
            return svo_fail(err, SVO_CANCELLED, "cancelled after %llu sweeps", (unsigned long long)it);
        if (!c->fast) continue;
        c->work += c->s->count;
        hurry = hurry || (c->ways && c->work >= SLOW_WORK && c->s->count >= SLOW_COUNT);
        if (hurry && it % THICK_INTERVAL == 0) {
            SVO_TRY(weld_thick(c, err));
            if (c->solid != NULL) SVO_TRY(skeli_solid_step(c->solid, c->s, c->omega / 4 * (1 << SKELI_MOST_DOUBLINGS), false, err));
        }
        if (it - last_weld < interval) continue;
        uint32_t before = c->s->count, removed;
        SVO_TRY(weld_live(c, &removed, err));
        if (removed > 0) last_removal = it;
        if (removed * 100ull < before * 3ull) interval = interval * 2 < LAST_INTERVAL ? interval * 2 : LAST_INTERVAL;
        else interval = FIRST_INTERVAL;
        last_weld = it;
        if (c->solid != NULL && removed > 0) SVO_TRY(skeli_solid_step(c->solid, c->s, c->omega / 8, false, err));
    }
    if (c->solid != NULL) SVO_TRY(skeli_solid_step(c->solid, c->s, 0, true, err));
    report->final_movement_sum = m.sum / SKEL_LATTICE;
    report->final_movement_max = m.max / SKEL_LATTICE;
    return SVO_OK;
}

svo_result skeli_contract(skeli_pool *pool, const skeli_soup *mesh, const skel_options *options, struct skeli_solid *solid, skel_report *report, skeli_state *s,
                          svo_error *err)
{
    SVO_TRY(begin_state(pool, mesh, s, err));
    uint64_t n = s->count;
    contraction c = {.s = s, .options = options, .omega = options->omega * SKEL_LATTICE, .fast = options->method == SKEL_METHOD_FAST, .solid = solid, .pool = pool};
    c.point = skeli_take(pool, 3 * n, sizeof *c.point);
    c.point_weight = skeli_take(pool, n, sizeof *c.point_weight);
    c.sum = skeli_take(pool, n, sizeof *c.sum);
    c.doublings = skeli_take(pool, n, sizeof *c.doublings);
    c.way = skeli_take(pool, n, sizeof *c.way);
    c.moved = skeli_take(pool, n / GRAIN + 1, sizeof *c.moved);
    bool ok = c.point != NULL && c.point_weight != NULL && c.sum != NULL && c.doublings != NULL && c.way != NULL && c.moved != NULL;
    if (!c.fast) {
        c.point_of = skeli_take(pool, n, sizeof *c.point_of);
        c.order = skeli_take(pool, n, sizeof *c.order);
        c.key = skeli_take(pool, n, sizeof *c.key);
        ok = ok && c.point_of != NULL && c.order != NULL && c.key != NULL;
    }
    if (!ok) return skeli_no_memory(err);
    if (options->search != SKEL_SEARCH_GRID) SVO_TRY(skel_flann_open(options->omega, options->threads, &c.flann, err));
    const svo_result result = run(&c, report, err);
    skel_flann_close(c.flann);
    SVO_TRY(result);
    report->thinness_error = thinness_error(mesh, s);
    skeli_give(pool, c.point);
    skeli_give(pool, c.point_weight);
    skeli_give(pool, c.sum);
    skeli_give(pool, c.doublings);
    skeli_give(pool, c.way);
    skeli_give(pool, c.moved);
    skeli_give(pool, c.point_of);
    skeli_give(pool, c.order);
    skeli_give(pool, c.key);
    void *const rest[] = {s->rho, s->beta, s->step, s->reversals, s->corner, s->edge, s->edge_start, s->incident_start, s->incident, s->area, s->scratch, s->bucket, s->label,
                          s->mean, s->gather};
    for (size_t i = 0; i < sizeof rest / sizeof *rest; i++) skeli_give(pool, rest[i]);
    return SVO_OK;
}
