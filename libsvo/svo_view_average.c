/* Averaged views: attributes of bricks and their octants are worked out from the values of their finest voxels, which lie one
 * behind another, unless a correction is stored. The arithmetic is that of the builder (svoi_sum), so that a file without loss
 * gives the very values that would have been stored. */
#include <string.h>

#include "svo_algorithm1.h"
#include "svoi_dag.h"
#include "svoi_view.h"

static uint32_t majority(const uint32_t *values, uint32_t count)
{
    uint32_t label[64], voxels[64], n = 0, best = 0;
    for (uint32_t i = 0; i < count; i++) {
        uint32_t k = 0;
        while (k < n && label[k] != values[i]) k++;
        if (k == n) label[n] = values[i], voxels[n++] = 0;
        voxels[k]++;
    }
    for (uint32_t k = 1; k < n; k++)
        if (voxels[k] > voxels[best] || (voxels[k] == voxels[best] && label[k] < label[best])) best = k;
    return label[best];
}

uint32_t svoi_average(svo_channel_kind kind, const uint32_t *values, uint32_t count)
{
    uint32_t differ = 0, value = 0;
    for (uint32_t i = 1; i < count; i++) differ |= values[i] ^ values[0];
    if (differ == 0) return values[0];
    if (svoi_is_label(kind)) return majority(values, count);
    svoi_sum sum;
    uint8_t out[4] = {0};
    svoi_sum_values(kind, values, count, &sum);
    svoi_sum_value(&sum, kind, out);
    memcpy(&value, out, sizeof value);
    return value;
}

void svo_view_values(const svo_view *v, uint32_t channel, uint64_t first, uint32_t count, uint32_t *values)
{
    const svo_view_channel *c = &v->channels[channel];
    const uint32_t stride = svo_channel_stride(c->channel.kind);
    svo_palette p;
    SVO_ASSERT(v->unnumbered || (first < v->attribute_count && count <= v->attribute_count - first));
    switch (c->encoding) {
    case SVO_ENCODING_CONSTANT:
        for (uint32_t i = 0; i < count; i++) values[i] = svoi_load_value(c->channel.value, stride);
        break;
    case SVO_ENCODING_RAW:
        for (uint32_t i = 0; i < count; i++) values[i] = svoi_load_value(c->raw + (first + i) * stride, stride);
        break;
    case SVO_ENCODING_BLOCKS:
        p = svo_view_palette(v, channel);
        svo_palette_range(&p, first, count, values);
        break;
    case SVO_ENCODING_LONG_BLOCKS:
        p = svo_view_palette(v, channel);
        for (uint32_t i = 0; i < count; i++) values[i] = svo_algorithm1_value(&p, first + i);
        break;
    }
}

/* Binary search of a few corrections: nearly all averages have none. */
static bool corrected(const svo_view_channel *c, uint64_t attribute, uint32_t *value)
{
    const uint64_t key = svo_average_first(attribute) << 6 | attribute >> SVO_AVERAGE_SHIFT;
    uint64_t low = 0, high = c->correction_count, at;
    while (low < high) {
        uint64_t middle = low + (high - low) / 2;
        memcpy(&at, c->corrections + middle * SVO_CORRECTION, sizeof at);
        if (at == key) {
            memcpy(value, c->corrections + middle * SVO_CORRECTION + 8, sizeof *value);
            return true;
        }
        if (at < key) low = middle + 1;
        else high = middle;
    }
    return false;
}

uint32_t svoi_view_average(const svo_view *v, uint32_t channel, uint64_t attribute)
{
    const svo_view_channel *c = &v->channels[channel];
    const uint32_t count = svo_average_voxels(attribute);
    uint32_t values[64], value;
    if (c->correction_count != 0 && corrected(c, attribute, &value)) return value;
    svo_view_values(v, channel, svo_average_first(attribute), count, values);
    return svoi_average(c->channel.kind, values, count);
}

/* Those of one brick whose first voxel has index i. */
static bool averages_of(uint64_t brick, uint64_t i, svo_view_average_fn fn, void *user)
{
    const uint32_t voxels = (uint32_t)__builtin_popcountll(brick);
    uint64_t all = voxels > 1 ? svo_average_of(i, voxels) : 0; /* comes after the first octant */
    for (; brick != 0; brick >>= 8) {
        const uint32_t n = (uint32_t)__builtin_popcountll(brick & 0xff);
        if (n > 1 && n < voxels && !fn(user, svo_average_of(i, n))) return false;
        if (n != 0 && all != 0 && !fn(user, all)) return false;
        if (n != 0) all = 0;
        i += n;
    }
    return true;
}

bool svo_view_averages(const svo_view *v, uint32_t level, svo_view_node node, svo_view_average_fn fn, void *user)
{
    svo_view_node stack[SVO_MAX_DEPTH + 1];
    uint8_t left[SVO_MAX_DEPTH + 1]; /* children not yet visited */
    const uint32_t top = level;
    if (v->empty || !v->averaged || v->unnumbered || node.full) return true;
    if (level == v->brick_level) return averages_of(svo_view_brick(v, node), node.attribute, fn, user);
    stack[level] = node;
    left[level] = (uint8_t)(svo_view_mask(v, level, node) & ~svo_view_full(v, level, node));
    for (;;) {
        while (left[level] == 0) {
            if (level == top) return true;
            level--;
        }
        const uint32_t octant = (uint32_t)__builtin_ctz(left[level]);
        left[level] &= (uint8_t)(left[level] - 1);
        const svo_view_node child = svo_view_child(v, level, stack[level], octant);
        if (level + 1 == v->brick_level) {
            if (!averages_of(svo_view_brick(v, child), child.attribute, fn, user)) return false;
            continue;
        }
        stack[++level] = child;
        left[level] = (uint8_t)(svo_view_mask(v, level, child) & ~svo_view_full(v, level, child));
    }
}
