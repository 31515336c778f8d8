/* The model that every subtree starts from: what it has learnt from planes and balls drawn by a fixed generator. The
 * surfaces of real meshes look alike in 5^3 voxels, so this stands in for tables of trained numbers. */
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "fmti_svo_masks.h"

enum { LESSONS = 96, LESSON_LEVELS = 5, LESSON_SIZE = 1 << LESSON_LEVELS, TRUST = 2 };

/* xorshift32 (Marsaglia 2003) */
static uint32_t draw(uint32_t *state, uint32_t n)
{
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return (uint32_t)((uint64_t)*state * n >> 32);
}

typedef struct shape {
    bool ball, cut;
    int32_t normal[3], cut_normal[3], center[3]; /* positions count half voxels */
    int32_t radius, offset, cut_offset;
} shape;

static void draw_vector(uint32_t *state, int32_t most, int32_t v[3])
{
    do {
        for (int i = 0; i < 3; i++) v[i] = (int32_t)draw(state, (uint32_t)(2 * most + 1)) - most;
    } while (v[0] == 0 && v[1] == 0 && v[2] == 0);
}

static int32_t dot(const int32_t a[3], const int32_t b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static shape draw_shape(uint32_t *state)
{
    const uint32_t span = 2 * LESSON_SIZE;
    shape s = {0};
    uint32_t kind = draw(state, 8); /* 0 a plane across an axis, 1..5 planes, 6 a ball, 7 part of a large one */
    int32_t point[3];
    if (kind == 0) s.normal[draw(state, 3)] = 1;
    else if (kind < 6) draw_vector(state, kind < 3 ? 1 : kind < 5 ? 4 : 40, s.normal);
    draw_vector(state, 4, s.cut_normal);
    for (int i = 0; i < 3; i++) point[i] = (int32_t)draw(state, span);
    for (int i = 0; i < 3; i++) s.center[i] = kind == 7 ? (int32_t)draw(state, 3 * span) - (int32_t)span : (int32_t)draw(state, span);
    s.radius = kind == 7 ? LESSON_SIZE + (int32_t)draw(state, 3 * LESSON_SIZE) : 3 + (int32_t)draw(state, span);
    s.cut = draw(state, 2) == 1;
    s.ball = kind >= 6;
    s.offset = dot(s.normal, point);
    s.cut_offset = dot(s.cut_normal, point);
    return s;
}

/* Does the surface meet the closed cube around p (odd coordinates, so cubes have half an edge of 1)? */
static bool meets(const shape *s, const int32_t p[3])
{
    if (s->cut && dot(s->cut_normal, p) < s->cut_offset) return false;
    if (!s->ball) return abs(dot(s->normal, p) - s->offset) <= abs(s->normal[0]) + abs(s->normal[1]) + abs(s->normal[2]);
    int32_t near = 0, far = 0;
    for (int i = 0; i < 3; i++) {
        int32_t d = abs(p[i] - s->center[i]), low = d > 1 ? d - 1 : 0;
        near += low * low;
        far += (d + 1) * (d + 1);
    }
    return near <= s->radius * s->radius && s->radius * s->radius <= far;
}

static void draw_lesson(uint32_t *state, fmti_grid *nodes)
{
    for (uint32_t l = 0; l <= LESSON_LEVELS; l++) memset(nodes[l].bits, 0, fmti_grid_bytes(nodes[l].size));
    for (uint32_t shapes = 1 + draw(state, 4); shapes != 0; shapes--) {
        shape s = draw_shape(state);
        for (uint32_t z = 0; z < LESSON_SIZE; z++)
            for (uint32_t y = 0; y < LESSON_SIZE; y++)
                for (uint32_t x = 0; x < LESSON_SIZE; x++) {
                    const int32_t p[3] = {(int32_t)(2 * x + 1), (int32_t)(2 * y + 1), (int32_t)(2 * z + 1)};
                    if (!meets(&s, p)) continue;
                    for (uint32_t l = 0; l <= LESSON_LEVELS; l++)
                        fmti_grid_set(&nodes[l], x >> (LESSON_LEVELS - l), y >> (LESSON_LEVELS - l), z >> (LESSON_LEVELS - l));
                }
    }
}

static fmti_masks_model prior;
static uint8_t lesson_bits[(LESSON_SIZE + 2 * FMTI_GRID_PAD) * (LESSON_SIZE + 2 * FMTI_GRID_PAD) * FMTI_GRID_STRIDE * 2];

static void make_prior(void)
{
    fmti_grid nodes[LESSON_LEVELS + 1];
    uint8_t *at = lesson_bits;
    for (uint32_t l = 0; l <= LESSON_LEVELS; l++) {
        nodes[l] = (fmti_grid){at, 1u << l};
        at += fmti_grid_bytes(1u << l);
    }
    SVO_ASSERT(at <= lesson_bits + sizeof lesson_bits);
    for (uint32_t k = 0; k < FMTI_MASKS_MODELS; k++)
        for (uint32_t i = 0; i < FMTI_MASKS_SLOTS; i++) prior.slot[k][i] = 1u << 31;
    for (uint32_t i = 0; i < FMTI_MASKS_SETS; i++)
        for (uint32_t k = 0; k < FMTI_MASKS_MODELS; k++) prior.weight[i][k] = 26214;
    uint32_t state = 1;
    for (uint32_t i = 0; i < LESSONS; i++) {
        draw_lesson(&state, nodes);
        if ((fmti_grid_row(&nodes[0], 0, 0)[1] & 1) != 0) fmti_masks_learn(&prior, nodes, LESSON_LEVELS);
    }
    /* What was learnt is soon overruled by what a subtree shows. */
    for (uint32_t k = 0; k < FMTI_MASKS_MODELS; k++)
        for (uint32_t i = 0; i < FMTI_MASKS_SLOTS; i++) {
            uint32_t s = prior.slot[k][i];
            if ((s >> 8 & 63) > TRUST) prior.slot[k][i] = (s & ~(63u << 8)) | TRUST << 8;
        }
}

const fmti_masks_model *fmti_masks_prior(void)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, make_prior);
    return &prior;
}
