/* svo-dump --tree and --histogram: the nodes themselves, and how children and values are spread. */
#include <math.h>
#include <string.h>

#include "cli_scene.h"
#include "dump.h"
#include "dump_cut.h"
#include "svo_color.h"

enum { LISTED = 10000, BINS = 16, IDS = 65536 };

/* --- nodes --- */

typedef struct lister {
    const svo_view *v;
    json_t *list;
    uint32_t skip, last; /* levels of the tree above the octree's root, and the last one to list */
    uint32_t asset;
    bool many, full; /* several assets; more than are listed */
} lister;

/* Returns false when no more are wanted. */
static bool list_node(lister *t, uint32_t level, const uint32_t cell[3], const char *kind, uint8_t mask, uint64_t attribute, const uint64_t *slot)
{
    if (level < t->skip) return true;
    if (json_array_size(t->list) >= LISTED) {
        t->full = false;
        return false;
    }
    json_t *o = json_object();
    if (t->many) cli_put_u64(o, "asset", t->asset);
    cli_put_u64(o, "level", level - t->skip);
    json_object_set_new(o, "cell", json_pack("[I,I,I]", (json_int_t)cell[0], (json_int_t)cell[1], (json_int_t)cell[2]));
    cli_put_text(o, "kind", kind);
    cli_put_u64(o, "mask", mask);
    cli_put_u64(o, "children", (uint64_t)__builtin_popcount(mask));
    cli_put_u64(o, "attribute", svo_average_first(attribute));
    if (svo_average_voxels(attribute) > 1) cli_put_u64(o, "average_of", svo_average_voxels(attribute));
    if (slot != NULL) cli_put_u64(o, "slot", *slot);
    json_array_append_new(t->list, o);
    return true;
}

static void below(const uint32_t cell[3], uint32_t octant, uint32_t out[3])
{
    for (uint32_t k = 0; k < 3; k++) out[k] = 2 * cell[k] + (octant >> k & 1);
}

static bool list_brick(lister *t, svo_view_node node, const uint32_t cell[3])
{
    const svo_view *v = t->v;
    const uint64_t brick = svo_view_brick(v, node), octants = svo_brick_octants(brick);
    const uint32_t level = v->brick_level;
    uint32_t half[3], voxel[3];
    uint8_t mask = 0;
    for (uint32_t a = 0; a < 8; a++) mask = (uint8_t)(mask | (octants >> 8 * a & 1) << a);
    if (!list_node(t, level, cell, "brick", mask, svo_view_node_attribute(v, level, node), v->layout == SVO_LAYOUT_PLAIN ? &node.at : NULL)) return false;
    for (uint32_t a = 0; a < 8 && level < t->last; a++) {
        const uint8_t bits = (uint8_t)(brick >> 8 * a);
        if (bits == 0) continue;
        below(cell, a, half);
        if (!list_node(t, level + 1, half, "inner", bits, v->lod ? svo_view_brick_octant(v, node, brick, a) : svo_view_brick_voxel(v, node, brick, 8 * a + (uint32_t)__builtin_ctz(bits)), NULL)) return false;
        for (uint32_t b = 0; b < 8 && level + 1 < t->last; b++) {
            if (!(bits >> b & 1)) continue;
            below(half, b, voxel);
            if (!list_node(t, level + 2, voxel, "voxel", 0, svo_view_brick_voxel(v, node, brick, 8 * a + b), NULL)) return false;
        }
    }
    return true;
}

/* At most SVO_MAX_DEPTH deep. */
static bool list_nodes(lister *t, uint32_t level, svo_view_node node, const uint32_t cell[3])
{
    const svo_view *v = t->v;
    if (node.full) return list_node(t, level, cell, "full", 0, node.attribute, NULL);
    if (level == v->brick_level) return list_brick(t, node, cell);
    const uint8_t mask = svo_view_mask(v, level, node);
    if (!list_node(t, level, cell, "inner", mask, node.attribute, &node.at)) return false;
    for (uint32_t left = mask; left != 0 && level < t->last; left &= left - 1) {
        const uint32_t octant = (uint32_t)__builtin_ctz(left);
        uint32_t child[3];
        below(cell, octant, child);
        if (!list_nodes(t, level + 1, svo_view_child(v, level, node, octant), child)) return false;
    }
    return true;
}

static void put_tree(dump_job *j, const svo_scene *s)
{
    lister t = {.list = json_array(), .many = s->asset_count > 1, .full = true};
    for (uint32_t i = 0; i < s->asset_count; i++) {
        const uint32_t origin[3] = {0, 0, 0};
        t.v = s->assets[i];
        t.asset = i;
        t.skip = t.v->tree_depth - t.v->depth;
        t.last = t.skip + (j->tree < t.v->depth ? (uint32_t)j->tree : t.v->depth);
        if (!t.v->empty && !list_nodes(&t, 0, svo_view_root(t.v), origin)) break;
    }
    json_object_set_new(j->json, "tree", t.list);
    json_object_set_new(j->json, "tree_listed_in_full", json_boolean(t.full));
}

/* --- histograms --- */

typedef struct spread {
    const svo_view *v;
    uint32_t skip;
    uint64_t children[SVO_MAX_DEPTH + 1][9], full[SVO_MAX_DEPTH + 1];
    char names[SVO_MAX_CHANNELS][16]; /* of all assets, by name */
    uint32_t kinds[SVO_MAX_CHANNELS], count;
    uint32_t use[SVO_MAX_CHANNELS]; /* the view's channel for each */
    uint64_t bins[SVO_MAX_CHANNELS][BINS];
    uint64_t *ids[SVO_MAX_CHANNELS], others[SVO_MAX_CHANNELS];
} spread;

static uint32_t bin_of(svo_channel_kind kind, const uint8_t *value)
{
    if (kind == SVO_KIND_COLOR_SRGB8) {
        float lab[3];
        svo_srgb8_to_lab(value, lab);
        const double bin = floor((double)lab[0] / (100.0 / BINS));
        return bin < 0 ? 0 : bin >= BINS ? BINS - 1 : (uint32_t)bin;
    }
    if (kind == SVO_KIND_NORMAL_OCT32) { /* the axis it is nearest to: -x +x -y +y -z +z */
        float n[3];
        svo_oct32_decode(value, n);
        uint32_t axis = 0;
        for (uint32_t k = 1; k < 3; k++)
            if (fabsf(n[k]) > fabsf(n[axis])) axis = k;
        return 2 * axis + (n[axis] > 0);
    }
    return value[0] / (256 / BINS);
}

static svo_result add_node(void *user, const dump_cut_node *n, svo_error *err)
{
    spread *t = user;
    (void)err;
    if (n->level < t->skip) return SVO_OK;
    const uint32_t level = n->level - t->skip;
    if (!n->leaf) {
        t->children[level][__builtin_popcount(n->mask)]++;
        return SVO_OK;
    }
    const uint32_t below_it = t->v->tree_depth - n->level;
    if (below_it != 0) t->full[level]++;
    const uint64_t voxels = (uint64_t)1 << (3 * below_it < 63 ? 3 * below_it : 63);
    for (uint32_t i = 0; i < t->count; i++) {
        if (t->use[i] == SVO_MAX_CHANNELS) continue;
        const uint8_t *value = n->values[t->use[i]];
        if (t->kinds[i] == SVO_KIND_ID16 || t->kinds[i] == SVO_KIND_ID32) {
            const uint32_t id = t->kinds[i] == SVO_KIND_ID16 ? fmt_load16(value) : fmt_load32(value);
            *(id < IDS ? &t->ids[i][id] : &t->others[i]) += voxels;
        } else {
            t->bins[i][bin_of((svo_channel_kind)t->kinds[i], value)] += voxels;
        }
    }
    return SVO_OK;
}

static void put_bin(json_t *list, json_t *label, uint64_t voxels)
{
    json_t *o = json_object();
    json_object_set_new(o, "value", label);
    cli_put_u64(o, "voxels", voxels);
    json_array_append_new(list, o);
}

static void put_bins(const spread *t, uint32_t i, json_t *list)
{
    static const char *const sides[] = {"-x", "+x", "-y", "+y", "-z", "+z"};
    if (t->ids[i] != NULL) { /* the sixteen most common */
        uint32_t best[BINS], count = 0;
        for (uint32_t id = 0; id < IDS; id++) {
            if (t->ids[i][id] == 0) continue;
            uint32_t at = count < BINS ? count++ : BINS;
            while (at > 0 && t->ids[i][id] > t->ids[i][best[at - 1]]) {
                if (at < BINS) best[at] = best[at - 1];
                at--;
            }
            if (at < BINS) best[at] = id;
        }
        uint64_t rest = t->others[i];
        for (uint32_t id = 0; id < IDS; id++) rest += t->ids[i][id];
        for (uint32_t k = 0; k < count; k++) {
            put_bin(list, json_integer(best[k]), t->ids[i][best[k]]);
            rest -= t->ids[i][best[k]];
        }
        if (rest != 0) put_bin(list, json_string("others"), rest);
        return;
    }
    const bool color = t->kinds[i] == SVO_KIND_COLOR_SRGB8, normal = t->kinds[i] == SVO_KIND_NORMAL_OCT32;
    for (uint32_t k = 0; k < (normal ? 6 : BINS); k++) {
        json_t *label = normal ? json_string(sides[k]) : color ? json_sprintf("L* %.4g-%.4g", k * 100.0 / BINS, (k + 1) * 100.0 / BINS) : json_sprintf("%u-%u", k * (256 / BINS), (k + 1) * (256 / BINS) - 1);
        put_bin(list, label, t->bins[i][k]);
    }
}

static void put_histograms(dump_job *j, const spread *t, uint32_t depth)
{
    json_t *o = json_object(), *levels = json_array(), *channels = json_array();
    for (uint32_t l = 0; l <= depth; l++) {
        json_t *level = json_object(), *counts = json_array();
        uint64_t inner = 0;
        for (int k = 1; k <= 8; k++) {
            json_array_append_new(counts, json_integer((json_int_t)t->children[l][k]));
            inner += t->children[l][k];
        }
        cli_put_u64(level, "level", l);
        cli_put_u64(level, "inner", inner);
        cli_put_u64(level, "full_leaves", t->full[l]);
        json_object_set_new(level, "nodes_with_1_to_8_children", counts);
        json_array_append_new(levels, level);
    }
    for (uint32_t i = 0; i < t->count; i++) {
        json_t *channel = json_object(), *bins = json_array();
        put_bins(t, i, bins);
        cli_put_text(channel, "name", t->names[i]);
        json_object_set_new(channel, "bins", bins);
        json_array_append_new(channels, channel);
    }
    json_object_set_new(o, "levels", levels);
    json_object_set_new(o, "channels", channels);
    json_object_set_new(j->json, "histograms", o);
}

/* Channels of an asset beside those of the assets before it. */
static svo_result take_channels(spread *t, const svo_view *v, const svo_allocator *a, svo_error *err)
{
    for (uint32_t c = 0; c < v->channel_count; c++) {
        const svo_channel *k = &v->channels[c].channel;
        uint32_t i = 0;
        while (i < t->count && strcmp(t->names[i], k->name) != 0) i++;
        if (i < t->count || t->count == SVO_MAX_CHANNELS) continue;
        memcpy(t->names[i], k->name, sizeof t->names[i]);
        t->kinds[i] = k->kind;
        t->count++;
        if (k->kind != SVO_KIND_ID16 && k->kind != SVO_KIND_ID32) continue;
        t->ids[i] = svo_calloc(a, IDS, sizeof *t->ids[i]);
        if (t->ids[i] == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a histogram");
    }
    for (uint32_t i = 0; i < t->count; i++) {
        t->use[i] = svo_view_find_channel(v, t->names[i]);
        if (t->use[i] != SVO_MAX_CHANNELS && (uint32_t)v->channels[t->use[i]].channel.kind != t->kinds[i]) t->use[i] = SVO_MAX_CHANNELS;
    }
    return SVO_OK;
}

static svo_result make_histograms(dump_job *j, const svo_scene *s, spread *t, svo_error *err)
{
    uint64_t all = 0;
    uint32_t depth = 0;
    for (uint32_t i = 0; i < s->asset_count; i++) {
        const svo_view *v = s->assets[i];
        for (uint32_t l = 0; l <= v->depth; l++) all = all > UINT64_MAX - v->nodes[l] ? UINT64_MAX : all + v->nodes[l];
        depth = v->depth > depth ? v->depth : depth;
    }
    if (all > j->limit && j->limit != 0) /* full leaves are one visit, but shared nodes are many */
        return svo_fail(err, SVO_LIMIT, "%llu nodes are more than --limit; a histogram visits each where it appears", (unsigned long long)all);
    for (uint32_t i = 0; i < s->asset_count; i++) {
        t->v = s->assets[i];
        t->skip = t->v->tree_depth - t->v->depth;
        SVO_TRY(take_channels(t, t->v, j->allocator, err));
        SVO_TRY(dump_cut(t->v, t->v->tree_depth, add_node, t, err));
    }
    put_histograms(j, t, depth);
    return SVO_OK;
}

svo_result dump_inside(dump_job *j, svo_error *err)
{
    if (fmt_container_kind(j->data, j->size) == FMT_KIND_SKEL) return svo_fail(err, SVO_UNSUPPORTED, "--tree and --histogram are for octrees and scenes; --json lists the joints and bones of a skeleton");
    cli_scene s;
    SVO_TRY(cli_scene_open(j->c, j->path, j->data, j->size, j->allocator, NULL, &s, err));
    svo_result r = SVO_OK;
    if (j->has_tree) put_tree(j, s.scene);
    if (j->histogram) {
        spread *t = svo_calloc(j->allocator, 1, sizeof *t);
        r = t != NULL ? make_histograms(j, s.scene, t, err) : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for histograms");
        for (uint32_t i = 0; t != NULL && i < SVO_MAX_CHANNELS; i++) svo_free(j->allocator, t->ids[i], IDS, sizeof *t->ids[i]);
        svo_free(j->allocator, t, 1, sizeof *t);
    }
    cli_scene_close(&s);
    return r;
}
