#include "svo_unpack.h"

#include <string.h>

svo_tree_info svo_unpack_info(const svo_view *v)
{
    svo_tree_info info = {.depth = v->depth, .surface = v->surface, .fill = v->fill, .channel_count = v->channel_count};
    memcpy(info.voxel_to_world, v->voxel_to_world, sizeof info.voxel_to_world);
    for (uint32_t i = 0; i < v->channel_count; i++) info.channels[i] = v->channels[i].channel;
    return info;
}

void svo_unpack_begin(svo_unpack *u, const svo_view *view)
{
    memset(u, 0, sizeof *u);
    u->view = view;
}

/* What fetch hands to decode: where the chunk's root is. */
typedef struct place {
    uint64_t code; /* at `level` */
    uint32_t level; /* less than that of chunks only of a full leaf */
    svo_view_node node;
} place;

static bool next_root(svo_unpack *u, place *out)
{
    const svo_view *v = u->view;
    uint32_t cut = svo_chunk_level(v->depth);
    if (v->empty) return false;
    if (!u->started) {
        u->started = true;
        u->node[0] = svo_view_root(v);
        if (cut == 0) {
            *out = (place){0, 0, u->node[0]};
            return true;
        }
        u->left[0] = svo_view_mask(v, 0, u->node[0]);
    } else if (cut == 0) {
        return false;
    }
    for (;;) {
        while (u->left[u->level] == 0) {
            if (u->level == 0) return false;
            u->level--;
            u->code >>= 3;
        }
        uint32_t octant = (uint32_t)__builtin_ctz(u->left[u->level]);
        u->left[u->level] &= (uint8_t)(u->left[u->level] - 1);
        svo_view_node child = svo_view_child(v, u->level, u->node[u->level], octant);
        if (u->level + 1 == cut || child.full) {
            *out = (place){u->code << 3 | octant, u->level + 1, child};
            return true;
        }
        u->code = u->code << 3 | octant;
        u->level++;
        u->node[u->level] = child;
        u->left[u->level] = svo_view_mask(v, u->level, child);
    }
}

static svo_result fetch(void *user, svo_buffer *packed, bool *more, svo_error *err)
{
    place p;
    *more = next_root(user, &p);
    if (!*more) return SVO_OK;
    packed->size = 0;
    if (svo_buffer_append(packed, &p, sizeof p) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    return SVO_OK;
}

/* Most inner nodes of a chunk: 1 + 8 + ... + 8^6. */
enum { MAX_MASKS = 299593 };

static uint64_t brick_masks(uint64_t brick, uint8_t *to)
{
    uint64_t n = 1, octants = 0;
    for (uint32_t a = 0; a < 8; a++) {
        uint8_t byte = (uint8_t)(brick >> (8 * a));
        if (byte == 0) continue;
        octants |= (uint64_t)1 << a;
        to[n++] = byte;
    }
    to[0] = (uint8_t)octants;
    return n;
}

/* Child masks of the subtree in depth-first preorder; returns their number. */
static uint64_t collect_masks(const svo_view *v, uint32_t level, svo_view_node root, uint8_t *to)
{
    svo_view_node node[SVO_CHUNK_LEVELS + 1];
    uint8_t left[SVO_CHUNK_LEVELS + 1];
    uint32_t l = 0, bricks = v->brick_level - level; /* level of the bricks, counted from the chunk's root */
    uint64_t n = 0;
    if (bricks == 0) return brick_masks(svo_view_brick(v, root), to);
    node[0] = root;
    to[n++] = left[0] = svo_view_mask(v, level, root);
    for (;;) {
        while (left[l] == 0) {
            if (l == 0) return n;
            l--;
        }
        uint32_t octant = (uint32_t)__builtin_ctz(left[l]);
        left[l] &= (uint8_t)(left[l] - 1);
        svo_view_node child = svo_view_child(v, level + l, node[l], octant);
        if (child.full) {
            to[n++] = 0;
            continue;
        }
        if (l + 1 == bricks) {
            n += brick_masks(svo_view_brick(v, child), to + n);
            continue;
        }
        node[++l] = child;
        to[n++] = left[l] = svo_view_mask(v, level + l, child);
    }
}

static void read_values(const svo_view *v, uint32_t channel, uint64_t first, uint64_t count, uint8_t *to)
{
    uint32_t stride = svo_channel_stride(v->channels[channel].channel.kind);
    uint32_t values[64];
    for (uint64_t done = 0; done < count; done += 64) {
        const uint32_t n = count - done < 64 ? (uint32_t)(count - done) : 64;
        svo_view_values(v, channel, first + done, n, values);
        for (uint32_t i = 0; i < n; i++, to += stride) memcpy(to, &values[i], stride);
    }
}

/* Values of all finest voxels and full leaves below a chunk root whose attribute index is `index`. The index grows by one for every
 * node in preorder with lod, for every value without. */
static void collect_values(const svo_view *v, uint32_t channel, uint32_t levels, const uint8_t *masks, uint64_t mask_count,
                           uint64_t index, uint8_t *to)
{
    uint32_t stride = svo_channel_stride(v->channels[channel].channel.kind);
    uint8_t left[SVO_CHUNK_LEVELS + 1];
    uint32_t l = 0;
    for (uint64_t i = 0; i < mask_count; i++) {
        uint32_t k = (uint32_t)__builtin_popcount(masks[i]);
        if (v->lod && k != 0 && (!v->averaged || l + 2 < levels)) index++;
        if (k == 0) k = 1; /* a full leaf: its index is that of its value */
        else if (l + 1 < levels) {
            left[l++] = (uint8_t)k;
            continue;
        }
        read_values(v, channel, index, k, to);
        index += k;
        to += (size_t)k * stride;
        while (l > 0 && --left[l - 1] == 0) l--;
    }
}

static svo_result decode(void *user, const svo_buffer *packed, svo_buffer *storage, svo_chunk *out, svo_error *err)
{
    const svo_view *v = ((const svo_unpack *)user)->view;
    place p;
    memcpy(&p, packed->data, sizeof p);
    uint32_t level = svo_chunk_level(v->depth);
    storage->size = 0;
    if (!svo_buffer_reserve(storage, MAX_MASKS)) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_chunk c = {.code = p.code, .level = p.level, .depth = v->depth};
    uint64_t index = p.node.attribute;
    if (p.node.full) {
        c.value_count = 1;
    } else if (v->depth == 0) {
        index = svo_view_brick_voxel(v, p.node, svo_view_brick(v, p.node), 0);
        c.value_count = 1;
    } else if (v->depth == 1) { /* the octree is the brick's first octant */
        storage->data[0] = (uint8_t)svo_view_brick(v, p.node);
        index = svo_average_first(svo_view_brick_octant(v, p.node, svo_view_brick(v, p.node), 0));
        c.node_count = 1;
    } else {
        c.node_count = collect_masks(v, level, p.node, storage->data);
    }
    /* Voxels: children of the last level's masks. */
    uint32_t levels = v->depth - level, l = 0;
    uint8_t left[SVO_CHUNK_LEVELS + 1];
    for (uint64_t i = 0; i < c.node_count; i++) {
        uint32_t k = (uint32_t)__builtin_popcount(storage->data[i]);
        if (k == 0) k = 1; /* a full leaf */
        else if (l + 1 < levels) {
            left[l++] = (uint8_t)k;
            continue;
        }
        c.value_count += k;
        while (l > 0 && --left[l - 1] == 0) l--;
    }
    size_t at[SVO_MAX_CHANNELS] = {0}, end = c.node_count;
    for (uint32_t i = 0; i < v->channel_count; i++) {
        at[i] = end;
        if (!v->channels[i].channel.constant) end += (size_t)c.value_count * svo_channel_stride(v->channels[i].channel.kind);
    }
    storage->size = c.node_count; /* kept when it grows */
    if (!svo_buffer_reserve(storage, end - storage->size)) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    storage->size = end;
    c.masks = storage->data;
    for (uint32_t i = 0; i < v->channel_count; i++) {
        if (v->channels[i].channel.constant) continue;
        c.channels[i] = storage->data + at[i];
        if (c.node_count == 0) read_values(v, i, index, 1, storage->data + at[i]);
        else collect_values(v, i, levels, storage->data, c.node_count, index, storage->data + at[i]);
    }
    *out = c;
    return SVO_OK;
}

svo_chunk_source svo_unpack_source(svo_unpack *u)
{
    svo_chunk_source s = {u, fetch, decode};
    return s;
}
