/* Joints as a forest. */
#include "skel_skin.h"

#include <math.h>
#include <string.h>

#include "skeli_geometry.h"
#include "skeli_internal.h"

typedef struct graph {
    const skel_skeleton *s;
    uint32_t *start, *other; /* bones of each joint: the joint at the other end */
    double *length;          /* of each of these */
    double *distance;        /* scratch of a search */
    uint32_t *heap, *place;  /* scratch: a binary heap of joints and where each is in it */
    uint32_t heap_count;
} graph;

static svo_result make_graph(skeli_pool *pool, const skel_skeleton *s, graph *g, svo_error *err)
{
    uint64_t n = s->joint_count, b = s->bone_count;
    *g = (graph){.s = s};
    g->start = skeli_take(pool, n + 2, sizeof *g->start);
    g->other = skeli_take(pool, 2 * b, sizeof *g->other);
    g->length = skeli_take(pool, 2 * b, sizeof *g->length);
    g->distance = skeli_take(pool, n, sizeof *g->distance);
    g->heap = skeli_take(pool, n, sizeof *g->heap);
    g->place = skeli_take(pool, n, sizeof *g->place);
    if (g->start == NULL || g->other == NULL || g->length == NULL || g->distance == NULL || g->heap == NULL || g->place == NULL) return skeli_no_memory(err);
    memset(g->start, 0, (n + 2) * sizeof *g->start);
    for (uint64_t i = 0; i < b; i++) {
        g->start[s->bones[i].a + 2]++;
        g->start[s->bones[i].b + 2]++;
    }
    for (uint64_t j = 0; j < n; j++) g->start[j + 2] += g->start[j + 1];
    for (uint64_t i = 0; i < b; i++) {
        uint32_t x = s->bones[i].a, y = s->bones[i].b;
        double d = skeli_apart_far(s->joints[x].position, s->joints[y].position);
        g->length[g->start[x + 1]] = g->length[g->start[y + 1]] = d;
        g->other[g->start[x + 1]++] = y;
        g->other[g->start[y + 1]++] = x;
    }
    return SVO_OK;
}

/* --- shortest paths (Dijkstra), ties by joint number ----------------------------------------------------------------- */

static bool before(const graph *g, uint32_t a, uint32_t b) { return g->distance[a] < g->distance[b] || (g->distance[a] == g->distance[b] && a < b); }

static void swap_heap(graph *g, uint32_t i, uint32_t k)
{
    uint32_t a = g->heap[i], b = g->heap[k];
    g->heap[i] = b;
    g->heap[k] = a;
    g->place[b] = i;
    g->place[a] = k;
}

static void rise(graph *g, uint32_t i)
{
    for (; i > 0 && before(g, g->heap[i], g->heap[(i - 1) / 2]); i = (i - 1) / 2) swap_heap(g, i, (i - 1) / 2);
}

static uint32_t pop(graph *g)
{
    uint32_t top = g->heap[0];
    swap_heap(g, 0, --g->heap_count);
    g->place[top] = SVO_NONE;
    for (uint32_t i = 0;;) {
        uint32_t least = i, l = 2 * i + 1, r = l + 1;
        if (l < g->heap_count && before(g, g->heap[l], g->heap[least])) least = l;
        if (r < g->heap_count && before(g, g->heap[r], g->heap[least])) least = r;
        if (least == i) return top;
        swap_heap(g, i, least);
        i = least;
    }
}

/* Distances along the bones from `from`, whose component has joints first .. end - 1. Returns the last joint reached (a farthest one). `parent` and
 * `order` (both may be NULL) take the tree of shortest paths; order is filled from 0. */
static uint32_t search(graph *g, uint32_t from, uint32_t first, uint32_t end, uint32_t *parent, uint32_t *order)
{
    for (uint32_t j = first; j < end; j++) {
        g->distance[j] = NAN; /* not reached */
        g->place[j] = SVO_NONE;
    }
    g->distance[from] = 0;
    g->heap[0] = from;
    g->place[from] = 0;
    g->heap_count = 1;
    if (parent != NULL) parent[from] = SVO_NONE;
    uint32_t last = from;
    while (g->heap_count > 0) {
        uint32_t j = last = pop(g);
        if (order != NULL) *order++ = j;
        for (uint32_t k = g->start[j]; k < g->start[j + 1]; k++) {
            uint32_t o = g->other[k];
            double d = g->distance[j] + g->length[k];
            bool fresh = isnan(g->distance[o]);
            if (!fresh && !(d < g->distance[o])) continue;
            g->distance[o] = d;
            if (parent != NULL) parent[o] = j;
            if (fresh) {
                g->heap[g->heap_count] = o;
                g->place[o] = g->heap_count++;
            }
            rise(g, g->place[o]);
        }
    }
    return last;
}

/* The joint in the middle of a longest path found by two searches: the exact centre of a tree, a good one where there are loops. */
static uint32_t centre(graph *g, uint32_t first, uint32_t end, uint32_t *parent)
{
    uint32_t a = search(g, first, first, end, NULL, NULL), b = search(g, a, first, end, parent, NULL), best = b;
    double length = g->distance[b], least = INFINITY;
    for (uint32_t j = b; j != SVO_NONE; j = parent[j]) {
        double far = fmax(g->distance[j], length - g->distance[j]);
        uint32_t degree = g->start[j + 1] - g->start[j], best_degree = g->start[best + 1] - g->start[best];
        if (far < least || (far == least && (degree > best_degree || (degree == best_degree && j < best)))) {
            least = far;
            best = j;
        }
    }
    return best;
}

svo_result skel_tree_make(const skel_skeleton *s, const svo_allocator *a, skel_tree *out, svo_error *err)
{
    skeli_pool pool = {.allocator = a};
    skel_tree t = {.allocator = a, .joint_count = s->joint_count};
    t.parent = svo_alloc(a, s->joint_count, sizeof *t.parent);
    t.order = svo_alloc(a, s->joint_count, sizeof *t.order);
    graph g;
    svo_result r = t.parent == NULL || t.order == NULL ? skeli_no_memory(err) : make_graph(&pool, s, &g, err);
    if (r == SVO_OK) {
        /* joints are in the order of their components */
        for (uint32_t first = 0, end; first < s->joint_count; first = end) {
            for (end = first + 1; end < s->joint_count && s->joints[end].component == s->joints[first].component;) end++;
            uint32_t root = centre(&g, first, end, t.parent);
            search(&g, root, first, end, t.parent, t.order + first);
            t.root_count++;
        }
        t.loop_count = s->bone_count + t.root_count - s->joint_count;
    }
    skeli_pool_free(&pool);
    if (r == SVO_OK) *out = t;
    else skel_tree_free(&t);
    return r;
}

void skel_tree_free(skel_tree *t)
{
    svo_free(t->allocator, t->parent, t->joint_count, sizeof *t->parent);
    svo_free(t->allocator, t->order, t->joint_count, sizeof *t->order);
    memset(t, 0, sizeof *t);
}
