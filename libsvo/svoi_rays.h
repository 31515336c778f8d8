/* Internal to libsvo: the second form of an octree that svo_rays traverses. Not installed.
 *
 * A tree of 4x4x4 nodes over the levels of the octree, from the bricks upwards two at a time. (Where the number of levels is odd,
 * the root node is virtual above the octree's root.) Bit x + 4y + 16z of a node's mask: cell x, y, z is not empty. All is in
 * units of 8 bytes:
 *     node    mask; u32 unit of its first child; u32 box        2 units
 *     brick   mask                                              1 unit
 * The children of a node lie side by side in the order of their bits; nodes that are equal in the file share them. The box is
 * what is inside the node, in sixteenths of its edge: six fields of 4 bits, low x y z and high x y z, both inclusive. Of nodes of 16^3
 * voxels that is exact, and a bit above tells those whose box has no empty voxel (SVOI_RAYS_SOLID): walls that are parallel to an axis.
 *
 * Beside it, where attributes have numbers: for each child, at its unit, the number of its attribute less that of its parent's, times 2, and 1
 * where it is (inside) a full leaf. So the number of a hit's attribute is a sum over the nodes on the ray's stack, which only
 * hits take.
 *
 * Positions are fixed-point numbers: 30 bits across the root, the lower `fraction` of them inside a finest voxel. */
#ifndef SVOI_RAYS_H
#define SVOI_RAYS_H

#include "svo_alloc.h"
#include "svo_rays.h"
#include "svoi_raycast.h"

enum {
    SVOI_RAYS_BITS = 30,
    SVOI_RAYS_BATCH = 256,
    SVOI_RAYS_PACKET = 64, /* rays that are traced with one beam around them, at most */
    SVOI_RAYS_LEVELS = (SVO_MAX_DEPTH + 2) / 2,
    SVOI_RAYS_PAD = 16, /* what vector loads may read past the end of arrays */
    SVOI_RAYS_SOLID = 1 << 24 /* in a node's box */
};

typedef struct svoi_ray_batch svoi_ray_batch;
typedef struct svoi_ray_list svoi_ray_list;

/* One kind of processor. */
typedef struct svoi_rays_code {
    /* Fill in a batch from at most SVOI_RAYS_BATCH rays; true if some of them may stop above the finest voxels. */
    bool (*prepare)(const svo_rays *r, const svo_ray *rays, uint32_t count, svoi_ray_batch *b);
    /* Set `s`, `node` and `stack` of rays first .. first + count of a list: the smallest node that a ray begins in, or one above; not below one that it may stop at for its
     * level of detail. */
    void (*begin)(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t first, uint32_t count);
    /* All rays in lanes: those of `in`, or those of `start`, from where `s`, `node` and `stack` say; what is found is appended. */
    void (*trace)(const svo_rays *r, bool lod, bool start, svoi_ray_batch *b);
    /* hits[ray] of what was found, all but the attributes, which are 0 unless b->numbered is set; b->again tells by number of what was found which are not what svo_raycast finds. */
    void (*hits)(const svo_rays *r, bool lod, svoi_ray_batch *b, svo_hit *hits);
    /* `count` rays of `in` from `first` on, at most SVOI_RAYS_PACKET, together, to where they must part: there they are appended to
     * `start`. With `any`, rays stay together, and what is appended are the parts of them that may be blocked: one ray may be there several times, and
     * svoi_rays_settle is called when `start` is full. False, and nothing done, where they do not go the same way. */
    bool (*packet)(const svo_rays *r, bool lod, bool any, svoi_ray_batch *b, uint32_t first, uint32_t count);
} svoi_rays_code;

struct svo_rays {
    const svo_view *view;
    const svoi_rays_code *code; /* NULL: svo_raycast */
    const svo_allocator *allocator;
    svo_ray_kernel kernel;
    uint64_t *units; /* the root at 0 */
    uint64_t unit_count, unit_capacity;
    uint32_t levels;   /* of 4x4x4 nodes, bricks included: 1 .. SVOI_RAYS_LEVELS */
    uint32_t fraction; /* SVOI_RAYS_BITS - 2 * levels */
    int32_t low[3], high[3];           /* box of the root's contents, in fixed-point units */
    int32_t root_low[3], root_high[3]; /* the octree's root */
    uint64_t nodes, bricks;
    uint64_t earlier[64]; /* by cell of a 4x4x4 node: those that come before it in depth-first order */
    uint32_t *before;     /* of unit_capacity units, see above; NULL: not numbered, or numbers need more than 31 bits */
};

/* Rays made ready: in fixed-point units, structure of arrays. */
struct svoi_ray_list {
    _Alignas(64) double o[3][SVOI_RAYS_BATCH + SVOI_RAYS_PAD], d[3][SVOI_RAYS_BATCH + SVOI_RAYS_PAD], inv[3][SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
    _Alignas(64) double t[SVOI_RAYS_BATCH + SVOI_RAYS_PAD], t_max[SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
    _Alignas(64) double spread[SVOI_RAYS_BATCH + SVOI_RAYS_PAD], offset[SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
    _Alignas(64) int32_t q[3][SVOI_RAYS_BATCH + SVOI_RAYS_PAD]; /* where the ray is at t */
    _Alignas(64) int32_t ray[SVOI_RAYS_BATCH + SVOI_RAYS_PAD];  /* number in the batch */
};

struct svoi_ray_batch {
    svoi_ray_list in; /* those that can hit anything */
    uint32_t count;
    svoi_ray_list start; /* rays that a packet has brought to a node, and others to be traced with them */
    uint32_t starts;
    /* Where the rays of `start` begin, or of `in` where `start` is not used: log2 of the edge of the node's cells, its unit, and the nodes above it by level from the finest. */
    _Alignas(64) int32_t s[SVOI_RAYS_BATCH + SVOI_RAYS_PAD], node[SVOI_RAYS_BATCH + SVOI_RAYS_PAD], stack[SVOI_RAYS_LEVELS][SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
    uint8_t unsure[SVOI_RAYS_BATCH / 8]; /* by number of ray: the kernel cannot tell; set by `prepare` and svoi_rays_settle */
    uint8_t blocked[SVOI_RAYS_BATCH / 8]; /* by number of ray, where only that is asked */
    const svo_ray *rays; /* of the batch, by number */
    /* What was found, in no order: number of ray; state: SVOI_RAY_DOUBT, or 1 + log2 of the edge of the node hit, in
     * fixed-point units; where the ray was then. */
    bool numbers; /* `base` and `node_found` are wanted */
    bool numbered; /* `hits` has set the numbers of attributes */
    uint32_t found;
    _Alignas(64) int32_t found_ray[SVOI_RAYS_BATCH + SVOI_RAYS_PAD], state[SVOI_RAYS_BATCH + SVOI_RAYS_PAD], at[3][SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
    /* Of finest voxels, where no ray has a level of detail; not set in doubt, nor by every kernel: where the ray enters it, and its face. */
    _Alignas(64) double t_found[SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
    _Alignas(64) int32_t face_found[SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
    uint8_t again[SVOI_RAYS_BATCH / 8 + 2];
    /* For numbers: unit of the node (or brick) whose cell was hit, and the number of its attribute. Not set in doubt. */
    _Alignas(64) int32_t node_found[SVOI_RAYS_BATCH + SVOI_RAYS_PAD], base[SVOI_RAYS_BATCH + SVOI_RAYS_PAD];
};
enum { SVOI_RAY_DOUBT = 0x100 };

#if defined(__x86_64__) && defined(__AVX512F__) && defined(__AVX512VL__) && defined(__AVX512DQ__) && defined(__AVX512BW__) && \
    defined(__AVX512VPOPCNTDQ__) && defined(__AVX512CD__)
#define SVOI_HAVE_AVX512
#endif

#if defined(__x86_64__) && defined(__AVX2__) && defined(__FMA__) && defined(__BMI2__) && defined(__POPCNT__)
#define SVOI_HAVE_AVX2
#endif

bool svoi_rays_have_avx512(void);
bool svoi_rays_prepare_avx512(const svo_rays *r, const svo_ray *rays, uint32_t count, svoi_ray_batch *b);
void svoi_rays_begin_avx512(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t first, uint32_t count);
void svoi_rays_trace_avx512(const svo_rays *r, bool lod, bool start, svoi_ray_batch *b);
void svoi_rays_hits_avx512(const svo_rays *r, bool lod, svoi_ray_batch *b, svo_hit *hits);
bool svoi_rays_packet_avx512(const svo_rays *r, bool lod, bool any, svoi_ray_batch *b, uint32_t first, uint32_t count);
bool svoi_rays_have_avx2(void);
bool svoi_rays_prepare_avx2(const svo_rays *r, const svo_ray *rays, uint32_t count, svoi_ray_batch *b);
void svoi_rays_begin_avx2(const svo_rays *r, bool lod, svoi_ray_list *l, svoi_ray_batch *b, uint32_t first, uint32_t count);
void svoi_rays_trace_avx2(const svo_rays *r, bool lod, bool start, svoi_ray_batch *b);
void svoi_rays_hits_avx2(const svo_rays *r, bool lod, svoi_ray_batch *b, svo_hit *hits);
bool svoi_rays_packet_avx2(const svo_rays *r, bool lod, bool any, svoi_ray_batch *b, uint32_t first, uint32_t count);
/* Trace `start` for rays of which is asked only whether they are blocked, mark them in `blocked` or `unsure`, and empty it and what was found. */
void svoi_rays_settle(const svo_rays *r, bool lod, svoi_ray_batch *b);

#endif
