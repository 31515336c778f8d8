#include "dump_cut.h"

#include <string.h>

typedef struct cut {
    const svo_view *v;
    uint32_t level;
    dump_cut_fn fn;
    void *user;
    svo_error *err;
    uint8_t value[SVO_MAX_CHANNELS][SVO_MAX_STRIDE];
    const uint8_t *values[SVO_MAX_CHANNELS];
    svo_average average[SVO_MAX_CHANNELS];
    bool any; /* something was averaged; value[] holds the first */
} cut;

static void take(cut *c, uint64_t index)
{
    for (uint32_t i = 0; i < c->v->channel_count; i++) svo_view_attribute(c->v, i, index, c->value[i]);
}

static void gather(cut *c, uint64_t index, double weight)
{
    uint8_t value[SVO_MAX_STRIDE];
    for (uint32_t i = 0; i < c->v->channel_count; i++) {
        if (c->v->channels[i].channel.constant) continue;
        svo_view_attribute(c->v, i, index, value);
        if (!c->any) memcpy(c->value[i], value, sizeof value);
        svo_average_add(&c->average[i], c->v->channels[i].channel.kind, value, weight);
    }
    c->any = true;
}

/* Finest voxels below a node above the bricks or of bricks. The depth is at most SVO_MAX_DEPTH. */
static void gather_node(cut *c, uint32_t level, svo_view_node node)
{
    const svo_view *v = c->v;
    if (node.full) {
        double side = (double)((uint64_t)1 << (v->tree_depth - level));
        gather(c, node.attribute, side * side * side);
    } else if (level == v->brick_level) {
        uint64_t brick = svo_view_brick(v, node);
        for (uint64_t left = brick; left != 0; left &= left - 1) gather(c, svo_view_brick_voxel(v, node, brick, (uint32_t)__builtin_ctzll(left)), 1);
    } else {
        for (uint32_t mask = svo_view_mask(v, level, node); mask != 0; mask &= mask - 1)
            gather_node(c, level + 1, svo_view_child(v, level, node, (uint32_t)__builtin_ctz(mask)));
    }
}

static void begin_average(cut *c)
{
    memset(c->average, 0, sizeof c->average);
    c->any = false;
    take(c, 0); /* constants */
}

static void end_average(cut *c)
{
    for (uint32_t i = 0; i < c->v->channel_count; i++) {
        uint8_t out[SVO_MAX_STRIDE];
        if (c->v->channels[i].channel.constant) continue;
        svo_average_get(&c->average[i], c->v->channels[i].channel.kind, c->value[i], out);
        memcpy(c->value[i], out, sizeof out);
    }
}

static svo_result emit(cut *c, uint32_t level, const uint32_t cell[3], uint8_t mask, bool leaf)
{
    dump_cut_node n = {level, {cell[0], cell[1], cell[2]}, mask, leaf, leaf ? c->values : NULL};
    return c->fn(c->user, &n, c->err);
}

static void below(const uint32_t cell[3], uint32_t octant, uint32_t out[3])
{
    for (uint32_t k = 0; k < 3; k++) out[k] = 2 * cell[k] + (octant >> k & 1);
}

static svo_result walk_brick(cut *c, svo_view_node node, const uint32_t cell[3])
{
    const svo_view *v = c->v;
    uint64_t brick = svo_view_brick(v, node), octants = svo_brick_octants(brick);
    uint32_t level = v->brick_level, half[3], voxel[3];
    uint8_t mask = 0;
    for (uint32_t a = 0; a < 8; a++) mask = (uint8_t)(mask | (octants >> 8 * a & 1) << a);
    SVO_TRY(emit(c, level, cell, mask, false));
    for (uint32_t a = 0; a < 8; a++) {
        uint8_t bits = (uint8_t)(brick >> 8 * a);
        if (bits == 0) continue;
        below(cell, a, half);
        if (level + 1 == c->level) {
            if (v->lod) {
                take(c, svo_view_brick_octant(v, node, brick, a));
            } else {
                begin_average(c);
                for (uint32_t b = 0; b < 8; b++)
                    if (bits >> b & 1) gather(c, svo_view_brick_voxel(v, node, brick, 8 * a + b), 1);
                end_average(c);
            }
            SVO_TRY(emit(c, level + 1, half, 0, true));
            continue;
        }
        SVO_TRY(emit(c, level + 1, half, bits, false));
        for (uint32_t b = 0; b < 8; b++) {
            if ((bits >> b & 1) == 0) continue;
            below(half, b, voxel);
            take(c, svo_view_brick_voxel(v, node, brick, 8 * a + b));
            SVO_TRY(emit(c, level + 2, voxel, 0, true));
        }
    }
    return SVO_OK;
}

static svo_result walk(cut *c, uint32_t level, svo_view_node node, const uint32_t cell[3])
{
    const svo_view *v = c->v;
    if (level == c->level || node.full) {
        if (v->lod || node.full) {
            take(c, svo_view_node_attribute(v, level, node));
        } else {
            begin_average(c);
            gather_node(c, level, node);
            end_average(c);
        }
        return emit(c, level, cell, 0, true);
    }
    if (level == v->brick_level) return walk_brick(c, node, cell);
    uint8_t mask = svo_view_mask(v, level, node);
    SVO_TRY(emit(c, level, cell, mask, false));
    for (uint32_t left = mask; left != 0; left &= left - 1) {
        uint32_t octant = (uint32_t)__builtin_ctz(left), child[3];
        below(cell, octant, child);
        SVO_TRY(walk(c, level + 1, svo_view_child(v, level, node, octant), child));
    }
    return SVO_OK;
}

svo_result dump_cut(const svo_view *v, uint32_t level, dump_cut_fn fn, void *user, svo_error *err)
{
    if (v->empty) return SVO_OK;
    cut c = {.v = v, .level = level, .fn = fn, .user = user, .err = err};
    for (uint32_t i = 0; i < SVO_MAX_CHANNELS; i++) c.values[i] = c.value[i];
    const uint32_t origin[3] = {0, 0, 0};
    return walk(&c, 0, svo_view_root(v), origin);
}
