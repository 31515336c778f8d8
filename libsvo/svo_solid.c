#include "svo_solid.h"

#include <math.h>
#include <string.h>

#include "svo_morton.h"

enum { UNKNOWN = 0, OUT = 1, IN = 2, MAX_SIZE = 5 /* a region of 8^5 bricks is the block */ };

typedef struct place { uint16_t brick, size; } place; /* an empty node: 8^size bricks from this one on */

struct svo_solid {
    const svo_allocator *allocator;
    /* of bricks that the surface touches, and of empty ones that are on both sides */
    uint64_t known[SVO_BLOCK_BRICKS], inside[SVO_BLOCK_BRICKS];
    uint64_t seed[SVO_BLOCK_BRICKS]; /* voxels of a touched brick that the flood has reached and not gone on from */
    uint8_t side0[32768], side1[4096], side2[512], side3[64], side4[8], side5[1]; /* of empty nodes, by size */
    uint8_t *side[MAX_SIZE + 1];
    uint64_t touched[512]; /* bit i of word j: brick 64 j + i has walls */
    uint64_t coarse[8];    /* the same for words of touched */
    uint64_t mixed[512];   /* empty bricks with bits in known */
    place queue[SVO_BLOCK_BRICKS]; /* a stack: nodes that the flood goes on from; size MAX_SIZE + 1 stands for a touched brick */
    uint32_t waiting;
    /* of the call */
    const svo_block *block;
    const svo_winding *winding;
    int32_t corner[3];
    uint64_t outside_grid; /* bits of brick 0 beyond a grid of less than 4 voxels */
    uint32_t region, region_size; /* the flood stays in it */
    bool closed;
    svo_solid_counts *counts;
    svo_buffer *masks, *entries;
    uint64_t values;
};

svo_solid *svo_solid_create(const svo_allocator *a)
{
    svo_solid *s = svo_calloc(a, 1, sizeof *s);
    if (s == NULL) return NULL;
    s->allocator = a;
    uint8_t *const side[MAX_SIZE + 1] = {s->side0, s->side1, s->side2, s->side3, s->side4, s->side5};
    memcpy(s->side, side, sizeof side);
    return s;
}

void svo_solid_free(svo_solid *s)
{
    if (s != NULL) svo_free(s->allocator, s, 1, sizeof *s);
}

static inline uint64_t walls(const svo_solid *s, uint32_t brick)
{
    uint64_t w = s->block->bricks[brick] | s->block->masked[brick];
    return brick == 0 ? w | s->outside_grid : w;
}

/* --- questions ---------------------------------------------------------------------------------------------------- */

static bool ask(const svo_winding *w, const int32_t p[3], double *margin, svo_solid_counts *counts)
{
    bool inside = svo_winding_inside(w, p, margin);
    counts->asked++;
    if (*margin < 0.1) counts->ambiguous++;
    return inside;
}

/* Middle of a voxel given by its local code, in lattice units. */
static void centre_of(const svo_solid *s, uint32_t code, int32_t p[3])
{
    uint32_t at[3];
    svo_morton_decode(code, &at[0], &at[1], &at[2]);
    for (int k = 0; k < 3; k++) p[k] = (s->corner[k] + (int32_t)at[k]) * 256 + 128;
}

/* What the winding number can change by in a region of 8^size bricks, between centres of voxels. */
static double change_in(const svo_solid *s, uint32_t brick, uint32_t size)
{
    if (s->closed) return 0;
    int32_t low[3], high[3];
    centre_of(s, brick << 6, low);
    for (int k = 0; k < 3; k++) high[k] = low[k] + ((4 << size) - 1) * 256;
    return svo_winding_change(s->winding, low, high) + SVO_WINDING_ERROR;
}

/* --- the flood ---------------------------------------------------------------------------------------------------- */

/* Steps of one voxel in a brick: bits that can step without a carry between the two digits of a coordinate, and those that carry. */
#define X_EVEN 0x5555555555555555u
#define X_ONE 0x00aa00aa00aa00aau /* x = 1 */
#define Y_EVEN 0x3333333333333333u
#define Y_ONE 0x0000cccc0000ccccu
#define Z_EVEN 0x0f0f0f0f0f0f0f0fu
#define Z_ONE 0x00000000f0f0f0f0u

static inline uint64_t grow(uint64_t s, uint64_t even, uint64_t one, uint32_t step, uint32_t carry)
{
    uint64_t up = (s & even) << step | (s & one) << carry, down = (s >> step & even) | (s >> carry & one);
    return s | up | down;
}

/* All voxels of `space` connected to the seeds. */
static uint64_t flood_brick(uint64_t seeds, uint64_t space)
{
    for (;;) {
        uint64_t s = seeds;
        s = grow(s, X_EVEN, X_ONE, 1, 7) & space;
        s = grow(s, Y_EVEN, Y_ONE, 2, 14) & space;
        s = grow(s, Z_EVEN, Z_ONE, 4, 28) & space;
        if (s == seeds) return s;
        seeds = s;
    }
}

/* Low faces of a brick by axis; high faces are `<<` by 9, 18, 36. */
static const uint64_t low_face[3] = {0x0055005500550055u, 0x0000333300003333u, 0x000000000f0f0f0fu};
static const uint32_t face_shift[3] = {9, 18, 36};

/* Number of empty bricks around an empty one that make a node, as a power of 8, inside the region. */
static uint32_t empty_size(const svo_solid *s, uint32_t brick)
{
    uint32_t most = s->region_size, size = 0;
    if (most >= 1 && (s->touched[brick >> 6] >> (brick & 56) & 255) == 0) size = 1;
    if (size == 1 && most >= 2 && s->touched[brick >> 6] == 0) size = 2;
    if (size == 2 && most >= 3 && (s->coarse[brick >> 12] >> (brick >> 6 & 56) & 255) == 0) size = 3;
    if (size == 3 && most >= 4 && s->coarse[brick >> 12] == 0) size = 4;
    if (size == 4 && most >= 5) {
        uint64_t any = 0;
        for (int i = 0; i < 8; i++) any |= s->coarse[i];
        if (any == 0) size = 5;
    }
    return size;
}

static inline bool is_touched(const svo_solid *s, uint32_t brick) { return (s->touched[brick >> 6] >> (brick & 63) & 1) != 0; }

/* Is the whole node empty? (size <= that of the region) */
static bool is_empty(const svo_solid *s, uint32_t brick, uint32_t size)
{
    switch (size) {
    case 0: return !is_touched(s, brick);
    case 1: return (s->touched[brick >> 6] >> (brick & 56) & 255) == 0;
    case 2: return s->touched[brick >> 6] == 0;
    case 3: return (s->coarse[brick >> 12] >> (brick >> 6 & 56) & 255) == 0;
    default: return s->coarse[brick >> 12] == 0;
    }
}

static void reach_empty(svo_solid *s, uint32_t brick, uint8_t side)
{
    uint32_t size = empty_size(s, brick), index = brick >> 3 * size;
    if (s->side[size][index] != UNKNOWN) return;
    s->side[size][index] = side;
    s->queue[s->waiting++] = (place){(uint16_t)(index << 3 * size), (uint16_t)size};
}

static void reach_touched(svo_solid *s, uint32_t brick, uint64_t voxels)
{
    voxels &= ~walls(s, brick) & ~s->known[brick] & ~s->seed[brick];
    if (voxels == 0) return;
    if (s->seed[brick] == 0) s->queue[s->waiting++] = (place){(uint16_t)brick, MAX_SIZE + 1};
    s->seed[brick] |= voxels;
}

/* The node of this size on the other side of a face; false when that is outside of the region. */
static bool neighbour(const svo_solid *s, uint32_t brick, uint32_t size, uint32_t axis, bool up, uint32_t *out)
{
    const uint32_t mask = 0x1249u << axis & 0x7fff;
    uint32_t unit = 1u << (3 * size + axis), low = mask & (unit - 1);
    uint32_t moved = up ? ((brick | ~mask) + unit) & mask : ((brick & mask) - unit) & mask;
    *out = (moved & ~low) | (brick & ~mask);
    if (up ? (*out & mask) <= (brick & mask) : (*out & mask) >= (brick & mask)) return false; /* it wrapped */
    return *out >> 3 * s->region_size == s->region >> 3 * s->region_size;
}

/* Reach what lies behind one face of an empty node: the near layer of the node `brick` of the same size. */
static void reach_layer(svo_solid *s, uint32_t brick, uint32_t size, uint32_t axis, bool up, uint8_t side)
{
    struct { uint32_t brick, size; } stack[4 * MAX_SIZE + 4];
    uint32_t top = 0;
    stack[top].brick = brick, stack[top++].size = size;
    while (top != 0) {
        top--;
        brick = stack[top].brick, size = stack[top].size;
        if (is_empty(s, brick, size)) {
            reach_empty(s, brick, side);
        } else if (size == 0) {
            reach_touched(s, brick, up ? low_face[axis] : low_face[axis] << face_shift[axis]);
        } else {
            for (uint32_t o = 0; o < 8; o++) {
                if ((o >> axis & 1) == (up ? 1u : 0u)) continue; /* the far half */
                stack[top].brick = brick + (o << 3 * (size - 1));
                stack[top++].size = size - 1;
            }
        }
    }
}

static void flood(svo_solid *s, uint8_t side)
{
    while (s->waiting != 0) {
        place p = s->queue[--s->waiting];
        uint32_t other;
        if (p.size <= MAX_SIZE) {
            for (uint32_t axis = 0; axis < 3; axis++)
                for (int up = 0; up < 2; up++)
                    if (neighbour(s, p.brick, p.size, axis, up != 0, &other)) reach_layer(s, other, p.size, axis, up != 0, side);
            continue;
        }
        uint64_t part = flood_brick(s->seed[p.brick], ~walls(s, p.brick));
        s->seed[p.brick] = 0;
        s->known[p.brick] |= part;
        if (side == IN) s->inside[p.brick] |= part;
        for (uint32_t axis = 0; axis < 3; axis++)
            for (int up = 0; up < 2; up++) {
                uint64_t high = low_face[axis] << face_shift[axis];
                uint64_t face = up ? (part & high) >> face_shift[axis] : (part & low_face[axis]) << face_shift[axis];
                if (face == 0 || !neighbour(s, p.brick, 0, axis, up != 0, &other)) continue;
                if (is_touched(s, other)) reach_touched(s, other, face);
                else reach_empty(s, other, side);
            }
    }
}

/* --- regions ------------------------------------------------------------------------------------------------------ */

/* Ask for every voxel of a brick that is not known yet. */
static void ask_voxels(svo_solid *s, uint32_t brick, uint64_t voxels)
{
    int32_t p[SVO_WINDING_MANY][3];
    bool inside[SVO_WINDING_MANY];
    double margin[SVO_WINDING_MANY];
    uint32_t count = 0;
    for (uint64_t v = voxels; v != 0; v &= v - 1) centre_of(s, brick << 6 | (uint32_t)__builtin_ctzll(v), p[count++]);
    svo_winding_inside_many(s->winding, (const int32_t(*)[3])p, count, inside, margin);
    s->counts->asked += count;
    count = 0;
    for (uint64_t v = voxels; v != 0; v &= v - 1, count++) {
        if (inside[count]) s->inside[brick] |= v & (0 - v);
        s->counts->ambiguous += margin[count] < 0.1;
    }
    s->known[brick] |= voxels;
    if (!is_touched(s, brick)) s->mixed[brick >> 6] |= (uint64_t)1 << (brick & 63);
}

/* Decide the connected parts of a region from one point each. False when that is not certain for one of them. */
static bool decide_parts(svo_solid *s, uint32_t region, uint32_t size, double change)
{
    s->region = region;
    s->region_size = size;
    const uint32_t end = region + (1u << 3 * size);
    for (uint32_t brick = region; brick < end;) {
        int32_t p[3];
        double margin;
        uint64_t unknown = 0;
        uint32_t step = 1;
        if (is_touched(s, brick)) {
            unknown = ~walls(s, brick) & ~s->known[brick];
            if (unknown == 0) {
                brick++;
                continue;
            }
            centre_of(s, brick << 6 | (uint32_t)__builtin_ctzll(unknown), p);
        } else {
            uint32_t n = empty_size(s, brick);
            step = 1u << 3 * n;
            if (s->side[n][brick >> 3 * n] != UNKNOWN) {
                brick += step;
                continue;
            }
            centre_of(s, brick << 6, p);
            for (int k = 0; k < 3; k++) p[k] += (2 << n) * 256;
        }
        bool inside = ask(s->winding, p, &margin, s->counts);
        if (!s->closed && !(margin > change)) return false;
        if (unknown != 0) reach_touched(s, brick, unknown & (0 - unknown));
        else reach_empty(s, brick, inside ? IN : OUT);
        flood(s, inside ? IN : OUT);
        if (unknown == 0) brick += step;
    }
    return true;
}

static void decide(svo_solid *s, uint32_t region, uint32_t size)
{
    struct { uint32_t region, size; } stack[8 * MAX_SIZE + 8];
    uint32_t top = 0;
    stack[top].region = region, stack[top++].size = size;
    while (top != 0) {
        top--;
        region = stack[top].region, size = stack[top].size;
        double change = change_in(s, region, size);
        if (change < 0.5 && decide_parts(s, region, size, change)) continue;
        if (size > 0) {
            for (uint32_t o = 0; o < 8; o++) {
                stack[top].region = region + (o << 3 * (size - 1));
                stack[top++].size = size - 1;
            }
            continue;
        }
        if (is_touched(s, region)) ask_voxels(s, region, ~walls(s, region) & ~s->known[region]);
        else if (s->side0[region] == UNKNOWN) ask_voxels(s, region, ~s->known[region]);
    }
}

/* --- masks -------------------------------------------------------------------------------------------------------- */

enum { NONE, SOME, ALL, NO_MEMORY }; /* what a node holds: nothing, something, one full leaf */

static bool put(svo_solid *s, uint32_t code, uint32_t height, bool surface)
{
    uint32_t entry = code | height << 21 | (surface ? SVO_SOLID_SURFACE : 0);
    s->values++;
    return s->entries == NULL || svo_buffer_append(s->entries, &entry, sizeof entry) != NULL;
}

/* Where masks and entries were before a node. */
typedef struct mark { size_t masks, entries; uint64_t values; } mark;
static mark here(const svo_solid *s) { return (mark){s->masks->size, s->entries != NULL ? s->entries->size : 0, s->values}; }

/* A node turned out to be one full leaf. */
static int make_full(svo_solid *s, mark m, uint32_t code, uint32_t height)
{
    static const uint8_t zero = 0;
    s->masks->size = m.masks;
    if (s->entries != NULL) s->entries->size = m.entries;
    s->values = m.values;
    return svo_buffer_append(s->masks, &zero, 1) != NULL && put(s, code, height, false) ? ALL : NO_MEMORY;
}

static int emit_brick(svo_solid *s, uint32_t brick)
{
    uint64_t surface = s->block->bricks[brick], fill = s->inside[brick], all = surface | fill;
    if (all == 0) return NONE;
    if (fill == UINT64_MAX) return make_full(s, here(s), brick << 6, 2);
    if (!svo_buffer_reserve(s->masks, 9)) return NO_MEMORY;
    if (s->entries != NULL && !svo_buffer_reserve(s->entries, 64 * sizeof(uint32_t))) return NO_MEMORY;
    uint8_t *out = s->masks->data + s->masks->size, *octants = out++;
    *octants = 0;
    for (uint32_t a = 0; a < 8; a++) {
        uint32_t mask = (uint32_t)(all >> 8 * a) & 255, filled = (uint32_t)(fill >> 8 * a) & 255;
        if (mask == 0) continue;
        *octants |= (uint8_t)(1u << a);
        if (filled == 255) {
            *out++ = 0;
            if (!put(s, brick << 6 | a << 3, 1, false)) return NO_MEMORY;
            continue;
        }
        *out++ = (uint8_t)mask;
        if (s->entries == NULL) {
            s->values += (uint32_t)__builtin_popcount(mask);
            continue;
        }
        for (; mask != 0; mask &= mask - 1) {
            uint32_t b = (uint32_t)__builtin_ctz(mask);
            if (!put(s, brick << 6 | a << 3 | b, 0, !(filled >> b & 1))) return NO_MEMORY;
        }
    }
    s->masks->size = (size_t)(out - s->masks->data);
    return SOME;
}

/* Recursion of at most MAX_SIZE. */
static int emit(svo_solid *s, uint32_t brick, uint32_t size)
{
    if (size == 0 && is_touched(s, brick)) return emit_brick(s, brick);
    bool any = false;
    for (int i = 0; size == MAX_SIZE && i < 8; i++) any |= s->coarse[i] != 0;
    if (size == MAX_SIZE ? !any : is_empty(s, brick, size)) {
        uint8_t side = s->side[size][brick >> 3 * size];
        if (side == OUT) return NONE;
        if (side == IN) return make_full(s, here(s), brick << 6, size + 2);
        if (size == 0) return emit_brick(s, brick);
    }
    static const uint8_t zero = 0;
    mark before = here(s);
    if (svo_buffer_append(s->masks, &zero, 1) == NULL) return NO_MEMORY;
    uint32_t mask = 0, full = 0;
    for (uint32_t o = 0; o < 8; o++) {
        int r = emit(s, brick + (o << 3 * (size - 1)), size - 1);
        if (r == NO_MEMORY) return NO_MEMORY;
        if (r != NONE) mask |= 1u << o;
        full += r == ALL;
    }
    if (full == 8) return make_full(s, before, brick << 6, size + 2);
    if (mask == 0) {
        s->masks->size = before.masks;
        return NONE;
    }
    s->masks->data[before.masks] = (uint8_t)mask;
    return SOME;
}

/* --- a block ------------------------------------------------------------------------------------------------------ */

static void begin(svo_solid *s, const svo_block *block, uint32_t levels)
{
    for (uint32_t i = 0; i < 512; i++) {
        s->touched[i] = block->used[i];
        for (uint64_t d = block->dirty[i] & ~block->used[i]; d != 0; d &= d - 1)
            if (block->masked[i * 64 + (uint32_t)__builtin_ctzll(d)] != 0) s->touched[i] |= d & (0 - d);
    }
    s->outside_grid = levels == 0 ? ~(uint64_t)1 : levels == 1 ? ~(uint64_t)255 : 0;
    if (s->outside_grid != 0) s->touched[0] |= 1;
    for (uint32_t j = 0; j < 8; j++) {
        s->coarse[j] = 0;
        for (uint32_t i = 0; i < 64; i++) s->coarse[j] |= (uint64_t)(s->touched[j * 64 + i] != 0) << i;
    }
}

static void clear(svo_solid *s)
{
    for (uint32_t i = 0; i < 512; i++) {
        for (uint64_t bits = s->touched[i] | s->mixed[i]; bits != 0; bits &= bits - 1) {
            uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(bits);
            s->known[brick] = s->inside[brick] = s->seed[brick] = 0;
        }
        s->mixed[i] = 0;
    }
    memset(s->side0, 0, sizeof s->side0);
    memset(s->side1, 0, sizeof s->side1);
    memset(s->side2, 0, sizeof s->side2);
    memset(s->side3, 0, sizeof s->side3);
    memset(s->side4, 0, sizeof s->side4);
    s->side5[0] = 0;
    s->waiting = 0;
}

/* Masks of a grid of 1 or 2 voxels an axis, which lies in the first octant of brick 0. */
static bool emit_small(svo_solid *s, uint32_t levels)
{
    uint64_t surface = s->block->bricks[0], all = (surface | s->inside[0]) & ~s->outside_grid;
    if (all == 0) return true;
    if (levels == 1) {
        uint8_t mask = (uint8_t)all;
        if (svo_buffer_append(s->masks, &mask, 1) == NULL) return false;
    }
    for (uint64_t m = all; m != 0; m &= m - 1)
        if (!put(s, (uint32_t)__builtin_ctzll(m), 0, (surface & m & (0 - m)) != 0)) return false;
    return true;
}

bool svo_solid_fill(svo_solid *s, const svo_block *block, const svo_winding *w, const int32_t corner[3], uint32_t levels, bool root_full,
                    svo_buffer *masks, svo_buffer *entries, uint64_t *values, bool *full, svo_solid_counts *counts)
{
    s->block = block;
    s->winding = w;
    memcpy(s->corner, corner, sizeof s->corner);
    s->closed = svo_winding_closed(w);
    s->counts = counts;
    s->masks = masks;
    s->entries = entries;
    s->values = 0;
    *full = false;
    begin(s, block, levels);
    const uint32_t size = levels < 2 ? 0 : levels - 2;
    decide(s, 0, size);
    /* what alpha MASK has cut away may be inside or outside, whatever is around it */
    for (uint32_t i = 0; i < 512; i++)
        for (uint64_t d = block->dirty[i]; d != 0; d &= d - 1) {
            uint32_t brick = i * 64 + (uint32_t)__builtin_ctzll(d);
            uint64_t cut = block->masked[brick] & ~block->bricks[brick];
            if (cut != 0) ask_voxels(s, brick, cut);
        }
    bool ok;
    if (levels < 2) {
        ok = emit_small(s, levels);
    } else {
        size_t masks_before = masks->size;
        int r = emit(s, 0, size);
        ok = r != NO_MEMORY;
        if (r == ALL && root_full) {
            masks->size = masks_before;
            *full = true;
        } else if (r == ALL) { /* the root of the octree: eight full leaves instead */
            static const uint8_t eight[9] = {255};
            masks->size = masks_before;
            if (entries != NULL) entries->size -= sizeof(uint32_t);
            s->values = 0;
            ok = svo_buffer_append(masks, eight, sizeof eight) != NULL;
            for (uint32_t o = 0; ok && o < 8; o++) ok = put(s, o << 3 * (levels - 1), levels - 1, false);
        }
    }
    *values = s->values;
    clear(s);
    return ok;
}

svo_side svo_solid_node(const svo_winding *w, const int32_t corner[3], int32_t size, svo_solid_counts *counts)
{
    int32_t low[3], high[3], p[3];
    double margin;
    for (int k = 0; k < 3; k++) {
        low[k] = corner[k] * 256 + 128;
        high[k] = low[k] + (size - 1) * 256;
        p[k] = low[k] + size / 2 * 256;
    }
    double change = svo_winding_closed(w) ? 0 : svo_winding_change(w, low, high) + SVO_WINDING_ERROR;
    if (!(change < 0.5)) return SVO_SIDE_MIXED;
    bool inside = ask(w, p, &margin, counts);
    if (!(margin > change)) return SVO_SIDE_MIXED;
    return inside ? SVO_SIDE_INSIDE : SVO_SIDE_OUTSIDE;
}
