/* Joint trees and skinning weights: what holds for every mesh, and shapes where the answer is known. */
#include "skel_skin.h"

#include "skel_shapes.h"
#include "test.h"

static svo_error err;

typedef struct model { shape s; svo_part part; svo_shape sh; svo_instance in; svo_mesh mesh; skel_skeleton k; skel_tree tree; skel_skin skin; } model;

/* The mesh with a skeleton, its tree and its weights. Everything is freed by unmake. */
static void make(model *m, shape s, double omega, uint32_t influences, uint32_t smoothing)
{
    *m = (model){.s = s};
    m->part = (svo_part){.material = SVO_NONE, .vertex_count = s.points, .triangle_count = s.triangles, .positions = s.p, .indices = s.t};
    m->sh = (svo_shape){.part_count = 1, .parts = &m->part};
    m->in = (svo_instance){.transform = svo_mat4_identity()};
    m->mesh = (svo_mesh){.shape_count = 1, .instance_count = 1, .shapes = &m->sh, .instances = &m->in};
    skel_options o = skel_default_options();
    o.omega = omega;
    o.search = SKEL_SEARCH_GRID;
    o.threads = 1;
    CHECK_OK(skel_build_mesh(&m->mesh, &o, &m->k, &err));
    CHECK_OK(skel_tree_make(&m->k, NULL, &m->tree, &err));
    skel_skin_options w = {.influences = influences, .smoothing = smoothing};
    CHECK_OK(skel_skin_make(&m->mesh, &m->k, &m->tree, &w, &m->skin, &err));
}

static void unmake(model *m)
{
    skel_skin_free(&m->skin);
    skel_tree_free(&m->tree);
    skel_skeleton_free(&m->k);
    shape_free(&m->s);
}

static bool has_bone(const skel_skeleton *s, uint32_t a, uint32_t b)
{
    for (uint32_t i = 0; i < s->bone_count; i++)
        if ((s->bones[i].a == a && s->bones[i].b == b) || (s->bones[i].a == b && s->bones[i].b == a)) return true;
    return false;
}

static void check_rules(const model *m)
{
    const skel_tree *t = &m->tree;
    CHECK_U64(t->root_count, m->k.report.components);
    CHECK_U64(t->loop_count, m->k.report.loops);
    CHECK_U64(t->joint_count, m->k.joint_count);
    uint8_t *seen = calloc(t->joint_count, 1);
    uint32_t roots = 0;
    for (uint32_t i = 0; i < t->joint_count; i++) {
        uint32_t j = t->order[i], p = t->parent[j];
        CHECK(j < t->joint_count && !seen[j]);
        seen[j] = 1;
        roots += p == SVO_NONE;
        if (p != SVO_NONE) CHECK(seen[p] && has_bone(&m->k, j, p));
    }
    free(seen);
    CHECK_U64(roots, t->root_count);
    const skel_skin *w = &m->skin;
    CHECK_U64(w->count, m->s.points);
    uint32_t most = 0;
    for (uint64_t v = 0; v < w->count; v++) {
        double sum = 0;
        uint32_t used = 0;
        for (uint32_t i = 0; i < w->influences; i++) {
            float x = w->weight[v * w->influences + i];
            uint32_t j = w->joint[v * w->influences + i];
            CHECK(x >= 0 && x <= 1 && j < m->k.joint_count);
            if (x == 0) CHECK_U64(j, 0);
            if (i > 0) CHECK(x <= w->weight[v * w->influences + i - 1]);
            for (uint32_t n = 0; n < i; n++) CHECK(x == 0 || j != w->joint[v * w->influences + n]);
            sum += x;
            used += x > 0;
        }
        CHECK_MSG(fabs(sum - 1) <= 1e-6, "weights of vertex %llu sum up to %.9g", (unsigned long long)v, sum);
        if (used > most) most = used;
    }
    CHECK_U64(most, w->most);
}

TEST(tube)
{
    for (uint32_t influences = 1; influences <= 8; influences++) {
        model m;
        make(&m, shape_tube(4, 0.25, 80, 12), 0.03, influences, 8);
        check_rules(&m);
        if (influences > 1) CHECK(m.skin.most > 1);
        unmake(&m);
    }
}

/* Without smoothing a vertex follows two joints of one bone, and along the tube the weighted joint position is where the vertex is. */
TEST(tube_without_smoothing_is_linear_along_the_bone)
{
    model m;
    make(&m, shape_tube(4, 0.25, 80, 12), 0.03, 4, 0);
    check_rules(&m);
    CHECK_U64(m.skin.most, 2);
    double low = INFINITY, high = -INFINITY;
    for (uint32_t j = 0; j < m.k.joint_count; j++) {
        low = fmin(low, m.k.joints[j].position[0]);
        high = fmax(high, m.k.joints[j].position[0]);
    }
    for (uint64_t v = 0; v < m.s.points; v++) {
        double x = 0, at = m.s.p[3 * v];
        for (uint32_t i = 0; i < 4; i++) x += m.skin.weight[4 * v + i] * m.k.joints[m.skin.joint[4 * v + i]].position[0];
        at = at < low ? low : at > high ? high : at;
        CHECK_MSG(fabs(x - at) < 0.02, "vertex at %g follows joints at %g", at, x);
    }
    unmake(&m);
}

/* The tree of a tube is rooted in its middle, the tree of a torus cuts its loop once. */
TEST(roots)
{
    model m;
    make(&m, shape_tube(4, 0.25, 80, 12), 0.03, 4, 2);
    uint32_t root = m.tree.order[0];
    CHECK(m.tree.parent[root] == SVO_NONE);
    CHECK_MSG(fabs(m.k.joints[root].position[0] - 2) < 0.3, "root at %g", m.k.joints[root].position[0]);
    unmake(&m);
    make(&m, shape_torus(1, 0.2, 90, 20), 0.06, 4, 2);
    check_rules(&m);
    CHECK_U64(m.tree.loop_count, 1);
    unmake(&m);
}

/* Unshared triangles: vertices at one place get the same weights, so that a posed seam does not open. */
TEST(seams_stay_closed)
{
    shape t = shape_star(1.5, 0.2, 24, 10), s = {0};
    for (uint64_t i = 0; i < 3 * t.triangles; i++) {
        const double *p = t.p + 3 * (uint64_t)t.t[i];
        shape_point(&s, p[0], p[1], p[2]);
    }
    for (uint32_t i = 0; i < t.triangles; i++) shape_triangle(&s, 3 * i, 3 * i + 1, 3 * i + 2);
    model m;
    make(&m, s, 0.05, 4, 8);
    check_rules(&m);
    for (uint64_t a = 0; a < m.s.points; a += 7)
        for (uint64_t b = 0; b < m.s.points; b++) {
            if (memcmp(m.s.p + 3 * a, m.s.p + 3 * b, 24) != 0) continue;
            CHECK(memcmp(m.skin.joint + 4 * a, m.skin.joint + 4 * b, 16) == 0 && memcmp(m.skin.weight + 4 * a, m.skin.weight + 4 * b, 16) == 0);
        }
    unmake(&m);
    shape_free(&t);
}

/* Parts that are not connected to each other share no joint. */
TEST(parts_do_not_pull_each_other)
{
    shape s = shape_tube(1, 0.1, 30, 10);
    const uint32_t base = (uint32_t)s.points;
    const uint64_t triangles = s.triangles;
    for (uint32_t i = 0; i < base; i++) shape_point(&s, s.p[3 * i], s.p[3 * i + 1] + 2, s.p[3 * i + 2]);
    for (uint64_t i = 0; i < triangles; i++) shape_triangle(&s, base + s.t[3 * i], base + s.t[3 * i + 1], base + s.t[3 * i + 2]);
    model m;
    make(&m, s, 0.05, 8, 30);
    check_rules(&m);
    CHECK_U64(m.tree.root_count, 2);
    for (uint64_t v = 0; v < m.s.points; v++)
        for (uint32_t i = 0; i < 8; i++)
            if (m.skin.weight[8 * v + i] > 0) CHECK((m.k.joints[m.skin.joint[8 * v + i]].position[1] > 1) == (v >= base));
    unmake(&m);
}

TEST(dropped_vertices_have_weights_too)
{
    shape s = shape_tube(2, 0.2, 30, 10);
    shape_point(&s, 5, 5, 5); /* no triangle */
    uint32_t bad = shape_point(&s, NAN, 0, 0);
    shape_triangle(&s, 0, 1, bad);
    model m;
    make(&m, s, 0.05, 4, 4);
    check_rules(&m);
    CHECK_U64(m.skin.joint[4 * (uint64_t)bad], m.tree.order[0]);
    unmake(&m);
}

TEST(one_triangle)
{
    shape s = {0};
    shape_point(&s, 0, 0, 0);
    shape_point(&s, 1, 0, 0);
    shape_point(&s, 0, 1, 0);
    shape_triangle(&s, 0, 1, 2);
    model m;
    make(&m, s, 0.5, 4, 8);
    check_rules(&m);
    unmake(&m);
}

TEST(another_mesh_is_refused)
{
    model m;
    make(&m, shape_tube(1, 0.1, 20, 8), 0.05, 4, 1);
    shape other = shape_tube(1, 0.1, 21, 8);
    svo_part part = {.material = SVO_NONE, .vertex_count = other.points, .triangle_count = other.triangles, .positions = other.p, .indices = other.t};
    svo_shape sh = {.part_count = 1, .parts = &part};
    svo_mesh mesh = {.shape_count = 1, .instance_count = 1, .shapes = &sh, .instances = &m.in};
    skel_skin_options o = skel_default_skin_options();
    skel_skin skin;
    CHECK_U64(skel_skin_make(&mesh, &m.k, &m.tree, &o, &skin, &err), SVO_INVALID_ARGUMENT);
    o.influences = 9;
    CHECK_U64(skel_skin_make(&m.mesh, &m.k, &m.tree, &o, &skin, &err), SVO_INVALID_ARGUMENT);
    shape_free(&other);
    unmake(&m);
}

TEST(out_of_memory)
{
    model m;
    make(&m, shape_tube(1, 0.1, 20, 8), 0.05, 4, 2);
    for (uint64_t n = 1;; n++) {
        svo_limit_allocator a;
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = n;
        skel_tree tree = {0};
        skel_skin skin = {0};
        skel_skin_options o = {.influences = 4, .smoothing = 2, .allocator = &a.base};
        svo_result r = skel_tree_make(&m.k, &a.base, &tree, &err);
        if (r == SVO_OK) r = skel_skin_make(&m.mesh, &m.k, &tree, &o, &skin, &err);
        bool done = r == SVO_OK;
        if (!done) CHECK_U64(r, SVO_OUT_OF_MEMORY);
        skel_skin_free(&skin);
        skel_tree_free(&tree);
        CHECK_U64(svo_limit_in_use(&a), 0);
        if (done) break;
    }
    unmake(&m);
}
