/* Internal to libsvo: parts of svo_winding. */
#ifndef SVOI_WINDING_H
#define SVOI_WINDING_H

#include "svo_winding.h"
#include "svoi_tritree.h"

enum { SVOI_ORIENTED = 0, SVOI_EVEN = 1, SVOI_OPEN = 2, SVOI_SKIPPED = 3, SVOI_CLASSES = 3, SVOI_TURNED = 4 /* a bit beside the class */ };

/* An edge at which open parts end. */
typedef struct svoi_boundary_edge {
    int32_t a[3], b[3]; /* in the direction in which more faces use it */
    uint32_t times;     /* uses in that direction that the other does not have */
} svoi_boundary_edge;

typedef struct svoi_edges_input {
    const svo_bins *bins;
    uint64_t count;  /* triangles */
    uint8_t *kind;   /* of each triangle: SVOI_SKIPPED on entry where it is not to be looked at, else 0; the class and SVOI_TURNED on return */
    uint32_t threads;
    const svo_allocator *allocator;
} svoi_edges_input;

/* Classify triangles by the edges of the snapped mesh. `balanced` may be told by the caller (see svoi_edge_sum): then nothing has to be
 * done. Boundary edges are appended to `boundary` (svoi_boundary_edge). */
svo_result svoi_edges_classify(const svoi_edges_input *in, svo_buffer *boundary, svo_error *err);

/* Sum over the directed edges of a triangle of a random number for the edge, negative in one direction: over a mesh whose edges are all
 * used equally often in both directions it is 0, over others it is not but for one in 2^128. */
void svoi_edge_sum(const int32_t q[3][3], uint64_t sum[2]);

#define SVOI_FOUR_PI 12.566370614359172

/* What a node of the tree of open triangles is from afar: area-weighted centre, area vector, and first moments of it. */
typedef struct svoi_moment {
    double centre[3];
    double normal[3];
    float trace, symmetric[6]; /* of sum of (centroid - centre) x area vector: xx yy zz xy xz yz, halves added */
    float radius;
} svoi_moment;

/* What a node of boundary edges is from afar: sums of times * length, and of times * (b - a). */
typedef struct svoi_lines { double length, sum[3]; } svoi_lines;

struct svo_winding {
    const svo_bins *bins;
    const svo_allocator *allocator;
    uint64_t count;
    uint8_t *kind; /* of each triangle */
    svoi_tree tree[SVOI_CLASSES];
    svoi_moment *moments; /* of the tree of open triangles */
    svoi_boundary_edge *boundary;
    uint64_t boundary_count;
    svoi_tree edges;
    svoi_lines *lines; /* nodes of `edges` */
};

static inline void svoi_edge_box(const svoi_boundary_edge *e, svoi_box *box)
{
    for (int k = 0; k < 3; k++) {
        box->low[k] = e->a[k] < e->b[k] ? e->a[k] : e->b[k];
        box->high[k] = e->a[k] < e->b[k] ? e->b[k] : e->a[k];
    }
}

#endif
