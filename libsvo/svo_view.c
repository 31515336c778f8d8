#include "svoi_best.h"

#include <string.h>

#include "svo_morton.h"
#include "svo_algorithm1.h"
#include "svoi_view.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "files are mapped and used in place: little-endian hosts only");

svo_palette svo_view_palette(const svo_view *v, uint32_t channel)
{
    const svo_view_channel *c = &v->channels[channel];
    return (svo_palette){.kind = c->channel.kind, .count = v->attribute_count, .table = c->table, .table_count = c->table_count,
                         .directory = c->directory, .superblock_count = c->superblock_count, .payload = c->payload, .payload_size = c->payload_size,
                         .repeats = c->encoding == SVO_ENCODING_BLOCKS ? c->repeats : NULL};
}

void svo_view_attribute(const svo_view *v, uint32_t channel, uint64_t index, uint8_t *out)
{
    const svo_view_channel *c = &v->channels[channel];
    uint32_t stride = svo_channel_stride(c->channel.kind);
    if (index >> SVO_AVERAGE_SHIFT != 0 && !v->unnumbered && c->encoding != SVO_ENCODING_CONSTANT) {
        uint32_t value = svoi_view_average(v, channel, index);
        memcpy(out, &value, stride);
        return;
    }
    SVO_ASSERT(channel < v->channel_count && (svo_average_first(index) < v->attribute_count || v->unnumbered));
    switch (c->encoding) {
    case SVO_ENCODING_CONSTANT: memcpy(out, c->channel.value, stride); break;
    case SVO_ENCODING_RAW: memcpy(out, c->raw + index * stride, stride); break;
    case SVO_ENCODING_BLOCKS: {
        svo_palette p = svo_view_palette(v, channel);
        uint32_t value = svo_palette_value(&p, index);
        memcpy(out, &value, stride);
        break;
    }
    case SVO_ENCODING_LONG_BLOCKS: {
        svo_palette p = svo_view_palette(v, channel);
        uint32_t value = svo_algorithm1_value(&p, index);
        memcpy(out, &value, stride);
        break;
    }
    }
}

uint32_t svo_view_find_channel(const svo_view *v, const char *name)
{
    for (uint32_t i = 0; i < v->channel_count; i++)
        if (strncmp(v->channels[i].channel.name, name, sizeof v->channels[i].channel.name) == 0) return i;
    return SVO_MAX_CHANNELS;
}

bool svo_view_voxel(const svo_view *v, uint32_t x, uint32_t y, uint32_t z, uint64_t *index)
{
    SVO_ASSERT(x >> v->depth == 0 && y >> v->depth == 0 && z >> v->depth == 0);
    if (v->empty) return false;
    if (v->layout == SVO_LAYOUT_BEST) return svo_view_best_voxel(v, x, y, z, index);
    if (v->layout == SVO_LAYOUT_FAST) return svo_view_fast_voxel(v, x, y, z, index);
    svo_view_node n = svo_view_root(v);
    for (uint32_t level = 0; level < v->brick_level; level++) {
        uint32_t bit = v->tree_depth - 1 - level;
        uint32_t octant = (x >> bit & 1) | (y >> bit & 1) << 1 | (z >> bit & 1) << 2;
        if (!(svo_view_mask(v, level, n) >> octant & 1)) return false;
        n = svo_view_child(v, level, n, octant);
    }
    uint32_t b = (uint32_t)svo_morton_encode(x & 3, y & 3, z & 3);
    uint64_t brick = svo_view_brick(v, n);
    if (!(brick >> b & 1)) return false;
    if (index != NULL) *index = svo_view_brick_voxel(v, n, brick, b);
    return true;
}

bool svo_view_voxels(const svo_view *v, svo_view_voxel_fn fn, void *user)
{
    if (v->empty) return true;
    struct { svo_view_node node; uint64_t code; uint32_t left; } stack[SVO_MAX_DEPTH]; /* left: children not yet visited */
    uint32_t level = 0;
    stack[0].node = svo_view_root(v);
    stack[0].code = 0;
    stack[0].left = v->brick_level != 0 ? svo_view_mask(v, 0, stack[0].node) : 0;
    for (;;) {
        if (level == v->brick_level) {
            uint64_t brick = svo_view_brick(v, stack[level].node);
            for (uint64_t m = brick; m != 0; m &= m - 1) {
                uint32_t b = (uint32_t)__builtin_ctzll(m), x, y, z;
                svo_morton_decode(stack[level].code << 6 | b, &x, &y, &z);
                if (!fn(user, x, y, z, svo_view_brick_voxel(v, stack[level].node, brick, b))) return false;
            }
            if (level == 0) return true;
            level--;
        }
        while (stack[level].left == 0) {
            if (level == 0) return true;
            level--;
        }
        uint32_t octant = (uint32_t)__builtin_ctz(stack[level].left);
        stack[level].left &= stack[level].left - 1;
        stack[level + 1].node = svo_view_child(v, level, stack[level].node, octant);
        stack[level + 1].code = stack[level].code << 3 | octant;
        level++;
        if (level < v->brick_level) stack[level].left = svo_view_mask(v, level, stack[level].node);
    }
}

/* --- stored geometry --------------------------------------------------------------------------------------------- */

uint64_t svo_view_stored(const svo_view *v, uint32_t level)
{
    SVO_ASSERT(level <= v->brick_level);
    if (v->empty) return 0;
    if (level == v->brick_level) return v->brick_count;
    if (v->layout == SVO_LAYOUT_FAST) return v->fast.level[level].node_count;
    return v->layout == SVO_LAYOUT_BEST ? v->best_levels[level].nodes : v->levels[level].node_count;
}

uint32_t svo_view_sections(const svo_view *v, svo_view_section out[SVO_VIEW_SECTIONS])
{
    uint32_t n = 0;
    if (v->empty) return 0;
    if (v->layout == SVO_LAYOUT_FAST) {
        out[n++] = (svo_view_section){"CODE", SVO_MAX_DEPTH + 1, 72 + 32 * (uint64_t)v->brick_level};
        out[n++] = (svo_view_section){"TREE", SVO_MAX_DEPTH + 1, v->fast.tree_bytes};
    } else if (v->layout == SVO_LAYOUT_BEST) {
        out[n++] = (svo_view_section){"LVLS", SVO_MAX_DEPTH + 1, v->brick_level * sizeof *v->best_levels};
        out[n++] = (svo_view_section){"CODE", SVO_MAX_DEPTH + 1, v->best_code_bytes};
        out[n++] = (svo_view_section){"TREE", SVO_MAX_DEPTH + 1, v->best_stream_bytes};
    } else {
        for (uint32_t l = 0; l < v->brick_level; l++) out[n++] = (svo_view_section){"NODE", l, 4 * v->levels[l].word_count};
    }
    out[n++] = (svo_view_section){"BRCK", v->brick_level, 8 * v->brick_count};
    return n;
}

#define COMPARE(x, y) \
    if ((x) != (y)) return (x) < (y) ? -1 : 1

static int compare_fast(const svo_view *a, const svo_view *b)
{
    const svo_view_fast *x = &a->fast, *y = &b->fast;
    int c = 0;
    COMPARE(x->tree_bytes, y->tree_bytes);
    COMPARE(x->full, y->full);
    if ((c = memcmp(x->code_bits, y->code_bits, sizeof x->code_bits)) != 0) return c;
    if ((c = memcmp(x->id_bits, y->id_bits, sizeof x->id_bits)) != 0) return c;
    if ((c = memcmp(x->turn, y->turn, sizeof x->turn)) != 0) return c;
    for (uint32_t l = 0; l < a->brick_level; l++) {
        COMPARE(x->level[l].begin, y->level[l].begin);
        COMPARE(x->level[l].skip_bits, y->level[l].skip_bits);
        COMPARE(x->level[l].size_bits, y->level[l].size_bits);
        if ((c = memcmp(x->level[l].code_bits, y->level[l].code_bits, sizeof x->level[l].code_bits)) != 0) return c;
    }
    if (a->brick_count != 0 && (c = memcmp(a->bricks, b->bricks, (size_t)a->brick_count * 8)) != 0) return c;
    return memcmp(x->tree, y->tree, (size_t)x->tree_bytes);
}

int svo_view_compare_geometry(const svo_view *a, const svo_view *b)
{
    int c = 0;
    COMPARE(a->layout, b->layout);
    COMPARE(a->empty, b->empty);
    if (a->empty) return 0;
    COMPARE(a->tree_depth, b->tree_depth);
    COMPARE(a->brick_count, b->brick_count);
    COMPARE(a->root, b->root);
    COMPARE(a->unnumbered, b->unnumbered);
    if (a->layout == SVO_LAYOUT_FAST) return compare_fast(a, b);
    if (a->layout == SVO_LAYOUT_BEST) {
        COMPARE(a->best_stream_bytes, b->best_stream_bytes);
        COMPARE(a->best_code_bytes, b->best_code_bytes);
        if ((c = memcmp(a->bricks, b->bricks, (size_t)a->brick_count * 8)) != 0) return c;
        if ((c = memcmp(a->best_codes, b->best_codes, (size_t)a->best_code_bytes)) != 0) return c;
        if ((c = memcmp(a->best_levels, b->best_levels, a->brick_level * sizeof *a->best_levels)) != 0) return c;
        return memcmp(a->best_stream, b->best_stream, (size_t)a->best_stream_bytes);
    }
    for (uint32_t l = 0; l < a->brick_level; l++) {
        COMPARE(a->levels[l].word_count, b->levels[l].word_count);
        COMPARE(a->levels[l].node_count, b->levels[l].node_count);
        COMPARE(a->levels[l].offset_words, b->levels[l].offset_words);
    }
    if ((c = memcmp(a->bricks, b->bricks, (size_t)a->brick_count * 8)) != 0) return c;
    for (uint32_t l = 0; l < a->brick_level && c == 0; l++)
        c = memcmp(a->levels[l].words, b->levels[l].words, (size_t)a->levels[l].word_count * 4);
    return c;
}
