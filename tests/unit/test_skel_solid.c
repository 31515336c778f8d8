/* Solids from the contraction, and the closed surfaces made of them. */
#include "skel_shapes.h"
#include "skel_solid.h"
#include "svo_morton.h"
#include "test.h"

static svo_error err;

typedef struct work { shape s; svo_part part; svo_shape sh; svo_instance in; svo_mesh mesh; skel_skeleton k; } work;

static void begin(work *w, shape s, double omega, uint32_t divide)
{
    memset(w, 0, sizeof *w);
    w->s = s;
    w->part = (svo_part){.material = SVO_NONE, .vertex_count = s.points, .triangle_count = s.triangles, .positions = s.p, .indices = s.t};
    w->sh = (svo_shape){.part_count = 1, .parts = &w->part};
    w->in = (svo_instance){.transform = svo_mat4_identity()};
    w->mesh = (svo_mesh){.shape_count = 1, .instance_count = 1, .shapes = &w->sh, .instances = &w->in};
    skel_options o = skel_default_options();
    o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    o.solid_divide = divide;
    o.skip_quality = true;
    CHECK_OK(skel_build_mesh(&w->mesh, &o, &w->k, &err));
}

static void end(work *w)
{
    skel_skeleton_free(&w->k);
    shape_free(&w->s);
}

static bool has(const skel_solid *s, uint64_t code)
{
    uint64_t low = 0, high = s->count;
    while (low < high) {
        uint64_t middle = (low + high) / 2;
        if (s->codes[middle] < code) low = middle + 1;
        else high = middle;
    }
    return low < s->count && s->codes[low] == code;
}

/* Compare with what the torus says: every voxel whose centre is inside by more than its half diagonal is there, none whose centre is outside by more. */
static void compare_torus(const skel_solid *s, double big, double small, double allowed)
{
    double edge = s->voxel_to_world[0];
    uint32_t n = 1u << s->depth;
    uint64_t missing = 0, extra = 0, last = 0;
    for (uint32_t z = 0; z < n; z++)
        for (uint32_t y = 0; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                double p[3] = {s->voxel_to_world[3] + edge * (x + 0.5), s->voxel_to_world[7] + edge * (y + 0.5), s->voxel_to_world[11] + edge * (z + 0.5)};
                double d = hypot(hypot(p[0], p[1]) - big, p[2]) - small;
                bool in = has(s, svo_morton_encode(x, y, z));
                missing += !in && d < -allowed;
                extra += in && d > allowed;
            }
    CHECK_U64(missing, 0);
    CHECK_U64(extra, 0);
    for (uint64_t i = 0; i < s->count; i++) {
        CHECK(i == 0 || s->codes[i] > last);
        last = s->codes[i];
    }
}

TEST(torus)
{
    for (uint32_t divide = 1; divide <= 2; divide *= 2) {
        work w;
        begin(&w, shape_torus(1, 0.3, 80, 24), 0.04, divide);
        compare_torus(&w.k.solid, 1, 0.3, 0.87 * w.k.solid.voxel_to_world[0] + 0.01);
        CHECK_U64(w.k.solid.filled, 0); /* what is closed is passed everywhere */
        end(&w);
    }
}

/* The side of the torus that looks up is cut away: no triangle passes what is below the cut, so the winding number fills it. */
TEST(torus_with_a_hole)
{
    work w;
    shape s = shape_torus(1, 0.3, 80, 24);
    uint64_t kept = 0;
    for (uint64_t t = 0; t < s.triangles; t++) {
        const double *p = s.p + 3 * (uint64_t)s.t[3 * t];
        if (p[2] > 0.2 && p[0] > 0.6) continue;
        memmove(s.t + 3 * kept++, s.t + 3 * t, 3 * sizeof *s.t);
    }
    CHECK(kept < s.triangles - 50);
    s.triangles = kept;
    begin(&w, s, 0.04, 2);
    compare_torus(&w.k.solid, 1, 0.3, 0.11); /* the cap that is cut off is 0.1 high */
    end(&w);
}

typedef struct edge { uint32_t a, b; } edge;
static int by_edge(const void *x, const void *y)
{
    const edge *p = x, *q = y;
    return p->a != q->a ? (p->a < q->a ? -1 : 1) : p->b < q->b ? -1 : p->b > q->b;
}

/* Every directed edge once, its reverse once; the volume positive, the Euler characteristic as told. */
static void check_closed(const skel_closed *c, int64_t euler)
{
    uint64_t n = 3 * c->triangle_count;
    edge *e = calloc(n, sizeof *e);
    double volume = 0;
    for (uint64_t t = 0; t < c->triangle_count; t++) {
        const uint32_t *v = c->corner + 3 * t;
        const double *p = c->position + 3 * (uint64_t)v[0], *q = c->position + 3 * (uint64_t)v[1], *r = c->position + 3 * (uint64_t)v[2];
        for (int k = 0; k < 3; k++) {
            CHECK(v[k] < c->vertex_count);
            e[3 * t + (uint64_t)k] = (edge){v[k], v[(k + 1) % 3]};
        }
        volume += p[0] * (q[1] * r[2] - q[2] * r[1]) - p[1] * (q[0] * r[2] - q[2] * r[0]) + p[2] * (q[0] * r[1] - q[1] * r[0]);
    }
    CHECK(volume > 0);
    qsort(e, n, sizeof *e, by_edge);
    for (uint64_t i = 0; i < n; i++) {
        CHECK(i == 0 || by_edge(e + i, e + i - 1) != 0);
        edge back = {e[i].b, e[i].a};
        CHECK(bsearch(&back, e, n, sizeof *e, by_edge) != NULL);
    }
    free(e);
    CHECK((int64_t)c->vertex_count - (int64_t)(n / 2) + (int64_t)c->triangle_count == euler);
}

TEST(reconstructed_torus)
{
    for (int hole = 0; hole < 2; hole++) {
        work w;
        shape s = shape_torus(1, 0.3, 80, 24);
        uint64_t kept = 0;
        for (uint64_t t = 0; t < s.triangles; t++) {
            const double *p = s.p + 3 * (uint64_t)s.t[3 * t];
            if (hole && p[2] > 0.2 && p[0] > 0.6) continue;
            memmove(s.t + 3 * kept++, s.t + 3 * t, 3 * sizeof *s.t);
        }
        s.triangles = kept;
        begin(&w, s, 0.04, 2);
        skel_closed c;
        CHECK_OK(skel_reconstruct(&w.mesh, &w.k, NULL, &c, &err));
        check_closed(&c, 0); /* genus 1 */
        uint64_t invented = 0;
        for (uint64_t v = 0; v < c.vertex_count; v++) {
            const double *p = c.position + 3 * v;
            invented += c.invented[v];
            CHECK_MSG(fabs(hypot(hypot(p[0], p[1]) - 1, p[2]) - 0.3) < (c.invented[v] ? 0.12 : 0.02), "%g %g %g", p[0], p[1], p[2]);
            if (c.invented[v]) CHECK(hole && p[2] > 0 && p[0] > 0.5);
        }
        CHECK_U64(invented, c.invented_count);
        CHECK((invented > 0) == (hole == 1));
        skel_closed_free(&c);
        end(&w);
    }
}

/* 10 % of the faces lost, and a soup without shared corners: still one closed surface around the tube. */
TEST(damaged_tube)
{
    shape t = shape_tube(3, 0.3, 60, 24), s = {0};
    uint64_t seed = 7;
    for (uint64_t i = 0; i < t.triangles; i++) {
        seed = seed * 6364136223846793005u + 1442695040888963407u;
        if ((seed >> 33) % 10 == 0) continue;
        uint32_t c[3];
        for (int k = 0; k < 3; k++) {
            const double *p = t.p + 3 * (uint64_t)t.t[3 * i + (uint64_t)k];
            c[k] = shape_point(&s, p[0], p[1], p[2]);
        }
        shape_triangle(&s, c[0], c[1], c[2]);
    }
    shape_free(&t);
    work w;
    begin(&w, s, 0.05, 2);
    skel_closed c;
    CHECK_OK(skel_reconstruct(&w.mesh, &w.k, NULL, &c, &err));
    check_closed(&c, 2);
    skel_closed_free(&c);
    end(&w);
}

typedef struct gathered { svo_tree_counts counts; svo_tree_info info; uint64_t voxels, wrong; const skel_solid *solid; } gathered;
static bool take_value(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    (void)index;
    gathered *g = user;
    for (uint32_t z = 0; z < size; z++)
        for (uint32_t y = 0; y < size; y++)
            for (uint32_t x = 0; x < size; x++) {
                g->wrong += !has(g->solid, svo_morton_encode(low[0] + x, low[1] + y, low[2] + z));
                g->voxels++;
            }
    return true;
}
static svo_result encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *e)
{
    (void)worker;
    gathered *g = user;
    *blob = NULL;
    SVO_TRY(svo_chunk_check(&g->info, chunk, &g->counts, e));
    g->wrong += !svo_chunk_values(chunk, take_value, g);
    return SVO_OK;
}
static svo_result commit(void *user, void *blob, svo_error *e)
{
    (void)user;
    (void)blob;
    (void)e;
    return SVO_OK;
}

TEST(octree_holds_the_voxels)
{
    for (uint32_t divide = 1; divide <= 5; divide += 4) { /* one chunk, and several */
        work w;
        begin(&w, shape_torus(1, 0.3, 60, 20), 0.06, divide);
        gathered g = {.solid = &w.k.solid};
        svo_tree_counts counts;
        CHECK_OK(skel_solid_info(&w.k, &g.info, &err));
        svo_chunk_sink sink = {.user = &g, .encode = encode, .commit = commit};
        CHECK_OK(skel_solid_stream(&w.k, &sink, NULL, &counts, &err));
        CHECK_U64(g.voxels, w.k.solid.count);
        CHECK_U64(g.wrong, 0);
        CHECK_U64(counts.nodes[w.k.solid.depth], w.k.solid.count);
        CHECK(counts.full_leaves > 0);
        end(&w);
    }
}

TEST(without_a_solid)
{
    work w;
    begin(&w, shape_tube(2, 0.3, 20, 12), 0.1, 0);
    skel_closed c;
    svo_tree_info info;
    CHECK_U64(skel_reconstruct(&w.mesh, &w.k, NULL, &c, &err), SVO_INVALID_ARGUMENT);
    CHECK_U64(skel_solid_info(&w.k, &info, &err), SVO_INVALID_ARGUMENT);
    end(&w);
}

TEST(out_of_memory)
{
    shape s = shape_torus(1, 0.3, 30, 12);
    svo_part part = {.material = SVO_NONE, .vertex_count = s.points, .triangle_count = s.triangles, .positions = s.p, .indices = s.t};
    svo_shape sh = {.part_count = 1, .parts = &part};
    svo_instance in = {.transform = svo_mat4_identity()};
    svo_mesh mesh = {.shape_count = 1, .instance_count = 1, .shapes = &sh, .instances = &in};
    bool done = false;
    for (uint64_t budget = 1 << 16; budget < 1 << 27 && !done; budget = budget * 5 / 4) {
        svo_limit_allocator limit;
        svo_limit_allocator_init(&limit, budget, NULL);
        skel_options o = skel_default_options();
        o.omega = 0.06;
        o.search = SKEL_SEARCH_GRID;
        o.solid_divide = 2;
        o.allocator = &limit.base;
        skel_skeleton k;
        skel_closed c;
        svo_result r = skel_build_mesh(&mesh, &o, &k, &err);
        if (r == SVO_OK) {
            r = skel_reconstruct(&mesh, &k, &limit.base, &c, &err);
            done = r == SVO_OK;
            if (done) skel_closed_free(&c);
            skel_skeleton_free(&k);
        }
        CHECK(r == SVO_OK || r == SVO_OUT_OF_MEMORY || r == SVO_LIMIT);
    }
    CHECK(done);
    shape_free(&s);
}
