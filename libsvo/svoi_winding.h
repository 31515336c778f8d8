/* Internal to libsvo: parts of svo_winding. */
#ifndef SVOI_WINDING_H
#define SVOI_WINDING_H

#include "svo_winding.h"
#include "svoi_sorted.h"
#include "svoi_tritree.h"

enum { SVOI_ORIENTED = 0, SVOI_EVEN = 1, SVOI_OPEN = 2, SVOI_CLASSES = 3, SVOI_TURNED = 4 /* a bit beside the class */ };

/* A snapped triangle with its number in the placement. Its corners begin with the least of them (by x, then y, then z), and triangles are sorted by the Morton code of
 * their middles, then by their corners, so that what is made of them depends neither on their order nor on which of their corners came first. */
typedef struct svoi_triangle {
    int32_t q[3][3];
    uint32_t number, turned; /* turned: bit 0: the last two corners have changed places; the rest: before that, which corner of the placement came first */
} svoi_triangle;

/* An edge at which open parts end. */
typedef struct svoi_boundary_edge {
    int32_t a[3], b[3]; /* in the direction in which more faces use it */
    uint32_t times;     /* uses in that direction that the other does not have */
} svoi_boundary_edge;

/* Classify sorted triangles by the edges of the snapped mesh: *kind receives a store of a byte for each, the class and SVOI_TURNED, and
 * *boundary the edges (svoi_boundary_edge) in Morton order. To be freed by the caller, also on failure. */
svo_result svoi_edges_classify(const svoi_room *room, const svoi_store *triangles, uint64_t count, uint32_t lattice_bits, svoi_store *kind, svoi_store *boundary,
                               uint64_t *boundary_count, svo_error *err);

/* Order of boundary edges in a store. */
void svoi_boundary_order(const uint32_t *lattice_bits, svoi_order *out);

/* Sum over the directed edges of a triangle of a random number for the edge, negative in one direction: over a mesh whose edges are all
 * used equally often in both directions it is 0, over others it is not but for one in 2^128. */
void svoi_edge_sum(const int32_t q[3][3], uint64_t sum[2]);

#define SVOI_FOUR_PI 12.566370614359172
#define SVOI_ACCEPT 2.3 /* distance over radius from which a node is one term */

/* On which side of the edge a -> b, seen along z, the point lies. The point is moved by (e, e^2) for an e that is smaller than everything, so that
 * it lies on no edge; 0 only where the edge is a point. The other direction gives the negative. */
int svoi_side_of(const int32_t a[3], const int32_t b[3], const int32_t p[3]);
/* Signed sum of crossings of the open parts by the ray along +z. */
double svoi_open_crossings(const svo_winding *w, const int32_t p[3]);
/* svo_winding_inside, from the winding number of the open parts. */
bool svoi_winding_verdict(const svo_winding *w, const int32_t p[3], double open, double *margin);

/* What a node of the tree of open triangles is from afar: area-weighted centre, area vector, and first moments of it. */
typedef struct svoi_moment {
    double centre[3];
    double normal[3];
    float trace, symmetric[6]; /* of sum of (centroid - centre) x area vector: xx yy zz xy xz yz, halves added */
    float radius;
} svoi_moment;

/* What a node of boundary edges is from afar: sums of times * length, and of times * (b - a). */
typedef struct svoi_lines { double length, sum[3]; } svoi_lines;

/* The shape of svoi_tree over a store whose items are in the order of the leaves already. */
typedef struct svoi_bounds_tree {
    uint64_t count, node_count;
    uint32_t levels; /* 0 when there are no items; the root is the only node of level levels - 1 */
    uint64_t first[SVOI_TREE_LEVELS + 1], size[SVOI_TREE_LEVELS + 1]; /* nodes of a level */
    svoi_store box;
} svoi_bounds_tree;

static inline uint64_t svoi_node_number(const svoi_bounds_tree *t, svoi_tree_node n) { return t->first[n.level] + n.at; }
static inline const svoi_box *svoi_node_box(const svoi_bounds_tree *t, svoi_tree_node n) { return svoi_at(&t->box, svoi_node_number(t, n)); }
static inline void svoi_leaf_items(const svoi_bounds_tree *t, svoi_tree_node leaf, uint64_t *begin, uint64_t *end)
{
    svoi_leaf_range(t->count, leaf, begin, end);
}
/* Children of an inner node; returns 1 or 2. */
static inline uint32_t svoi_node_children(const svoi_bounds_tree *t, svoi_tree_node n, svoi_tree_node out[2])
{
    return svoi_two_below(t->size, n, out);
}

struct svo_winding {
    svoi_room room;
    svoi_store triangles[SVOI_CLASSES]; /* svoi_triangle, turned as their parts want */
    svoi_bounds_tree tree[SVOI_CLASSES];
    svoi_store moments; /* of the tree of open triangles; none where there are few boundary edges */
    svoi_store boundary;
    uint64_t boundary_count;
    svoi_bounds_tree edges;
    svoi_store lines; /* nodes of `edges` */
};

static inline void svoi_edge_box(const svoi_boundary_edge *e, svoi_box *box)
{
    for (int k = 0; k < 3; k++) {
        box->low[k] = e->a[k] < e->b[k] ? e->a[k] : e->b[k];
        box->high[k] = e->a[k] < e->b[k] ? e->b[k] : e->a[k];
    }
}

static inline void svoi_triangle_box(const int32_t (*q)[3], svoi_box *box)
{
    for (int k = 0; k < 3; k++) {
        const int32_t a = q[0][k], b = q[1][k], c = q[2][k];
        box->low[k] = a < b ? a < c ? a : c : b < c ? b : c;
        box->high[k] = a > b ? a > c ? a : c : b > c ? b : c;
    }
}

#endif
