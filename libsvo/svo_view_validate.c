/* The proof that a view can be traversed without checks. Rules are those of docs/format/svdag.md. */
#include <string.h>

#include "svo_algorithm1.h"
#include "svoi_best.h"
#include "svoi_view.h"

/* Where nodes start in a level, and their numbers by rank. */
typedef struct starts {
    uint64_t *bit;
    uint32_t *before; /* starts in the words of `bit` before this one */
    uint64_t words;   /* of `bit` */
} starts;

typedef struct validate {
    const svo_view *v;
    const svo_allocator *a;
    svo_error *err;
    svo_rules *rules; /* NULL: the first violation is enough */
    starts level[SVO_MAX_DEPTH];
    uint64_t *size[2], *times[2]; /* of the level worked on and its neighbour */
    uint64_t size_count[2], times_count[2];
} validate;

static svo_result bad(validate *c, const char *rule, uint32_t level, uint64_t index, const char *why)
{
    svo_fail(c->err, SVO_INVALID_DATA, "%s: level %u, element %llu: %s", rule, level, (unsigned long long)index, why);
    if (c->err != NULL) c->err->index = index;
    return SVO_INVALID_DATA;
}

static svo_result go_on(validate *c, svo_result r) { return svo_go_on(c->rules, r, c->err); }

static svo_result no_memory(validate *c) { return svo_fail(c->err, SVO_OUT_OF_MEMORY, "out of memory (validation)"); }

static svo_result find_starts(validate *c, uint32_t level)
{
    const svo_view_level *l = &c->v->levels[level];
    starts *s = &c->level[level];
    if (c->v->unnumbered ? l->offset_words != 0 : l->offset_words != 1 && l->offset_words != 2)
        return bad(c, "DAG-03", level, 0, "offsets have 1 or 2 words, 0 where nothing is numbered");
    if (l->word_count > UINT32_MAX) return bad(c, "DAG-03", level, 0, "number of words out of range");
    s->words = l->word_count / 64 + 1;
    s->bit = svo_calloc(c->a, s->words, sizeof *s->bit);
    s->before = svo_alloc(c->a, s->words, sizeof *s->before);
    if (s->bit == NULL || s->before == NULL) return no_memory(c);
    uint64_t nodes = 0;
    for (uint64_t w = 0; w < l->word_count; nodes++) {
        uint32_t mask = l->words[w] & 0xff, full = l->words[w] >> 8;
        if (mask == 0 || (full & ~mask) != 0) return bad(c, "DAG-04", level, w, "mask is empty, has unused bits or full leaves that are not in it");
        uint32_t k = (uint32_t)__builtin_popcount(mask);
        uint64_t words = 1 + (uint64_t)__builtin_popcount(mask & ~full) + (k - 1) * (uint64_t)l->offset_words;
        if (words > l->word_count - w) return bad(c, "DAG-03", level, w, "node reaches beyond its level");
        s->bit[w / 64] |= (uint64_t)1 << w % 64;
        w += words;
    }
    if (nodes != l->node_count) return bad(c, "DAG-07", level, nodes, "number of nodes is wrong");
    uint32_t before = 0;
    for (uint64_t i = 0; i < s->words; i++) {
        s->before[i] = before;
        before += (uint32_t)__builtin_popcountll(s->bit[i]);
    }
    return SVO_OK;
}

static bool is_start(const validate *c, uint32_t level, uint32_t ref)
{
    return ref < c->v->levels[level].word_count && (c->level[level].bit[ref / 64] >> ref % 64 & 1);
}

static uint64_t number(const validate *c, uint32_t level, uint32_t ref)
{
    const starts *s = &c->level[level];
    return s->before[ref / 64] + (uint64_t)__builtin_popcountll(s->bit[ref / 64] & (((uint64_t)1 << ref % 64) - 1));
}

/* Number of a child that is known to be in order: of the next level, or the brick. */
static uint64_t child_number(const validate *c, uint32_t level, uint32_t ref)
{
    return level + 1 == c->v->brick_level ? ref : number(c, level + 1, ref);
}

static bool renew(validate *c, uint64_t **array, uint64_t *count, uint64_t want)
{
    svo_free(c->a, *array, *count, sizeof **array);
    *count = want != 0 ? want : 1;
    *array = svo_calloc(c->a, *count, sizeof **array);
    return *array != NULL;
}

static uint64_t brick_size(bool lod, uint64_t brick)
{
    uint64_t n = (uint64_t)__builtin_popcountll(brick);
    return lod ? n + 1 + (uint64_t)__builtin_popcountll(svo_brick_octants(brick)) : n;
}

/* References and offsets of a level; its subtree sizes from those of the level below. *whole: all references lead somewhere. */
static svo_result check_level(validate *c, uint32_t level, bool *whole)
{
    const svo_view *v = c->v;
    const svo_view_level *l = &v->levels[level];
    uint32_t own = level & 1;
    bool above_bricks = level + 1 == v->brick_level;
    const uint64_t *below = c->size[own ^ 1];
    if (!renew(c, &c->size[own], &c->size_count[own], l->node_count)) return no_memory(c);
    uint64_t w = 0;
    for (uint64_t i = 0; i < l->node_count; i++) {
        const uint32_t *node = l->words + w;
        uint32_t mask = node[0] & 0xff, full = node[0] >> 8, r = (uint32_t)__builtin_popcount(mask & ~full), refs = 0;
        const uint32_t *o = node + 1 + r;
        uint64_t size = v->lod ? 1 : 0;
        for (uint32_t m = mask; m != 0; m &= m - 1) {
            if (m != mask && l->offset_words != 0) { /* not the first child */
                uint64_t offset = *o++;
                if (l->offset_words == 2) offset |= (uint64_t)*o++ << 32;
                if (offset != size) SVO_TRY(go_on(c, bad(c, "DAG-06", level, w, "an offset is not the size of the subtrees before it")));
            }
            if (full >> __builtin_ctz(m) & 1) {
                size++;
                continue;
            }
            uint32_t ref = node[1 + refs++];
            if (above_bricks ? ref >= v->brick_count : !is_start(c, level + 1, ref)) {
                SVO_TRY(go_on(c, bad(c, "DAG-05", level, w, "a reference does not point to a node")));
                *whole = false;
                continue;
            }
            size += above_bricks ? brick_size(svo_view_brick_lod(v), v->bricks[ref]) : below[number(c, level + 1, ref)];
        }
        c->size[own][i] = size;
        w += 1 + r + ((uint32_t)__builtin_popcount(mask) - 1) * (uint64_t)l->offset_words;
    }
    return SVO_OK;
}

/* How often each node appears in the expanded octree, from the root down. There are at most 8^level places. */
static svo_result count_nodes(validate *c)
{
    const svo_view *v = c->v;
    uint64_t nodes[SVO_MAX_DEPTH + 1] = {0};
    bool whole = true;
    if (!renew(c, &c->times[0], &c->times_count[0], v->brick_level == 0 ? v->brick_count : v->levels[0].node_count)) return no_memory(c);
    c->times[0][v->brick_level == 0 ? v->root : number(c, 0, v->root)] = 1;
    for (uint32_t level = 0; level < v->brick_level; level++) {
        const svo_view_level *l = &v->levels[level];
        uint32_t own = level & 1;
        bool above_bricks = level + 1 == v->brick_level;
        if (!renew(c, &c->times[own ^ 1], &c->times_count[own ^ 1], above_bricks ? v->brick_count : v->levels[level + 1].node_count)) return no_memory(c);
        uint64_t w = 0;
        for (uint64_t i = 0; i < l->node_count; i++) {
            uint32_t mask = l->words[w] & 0xff, full = l->words[w] >> 8, r = (uint32_t)__builtin_popcount(mask & ~full);
            uint64_t times = c->times[own][i];
            if (times == 0) SVO_TRY(go_on(c, bad(c, "DAG-05", level, w, "a node that nothing refers to")));
            whole = whole && times != 0;
            nodes[level] += times;
            for (uint32_t j = 0; j < r; j++) c->times[own ^ 1][child_number(c, level, l->words[w + 1 + j])] += times;
            uint64_t leaves = times * (uint64_t)__builtin_popcount(full);
            for (uint32_t below = level + 1; leaves != 0 && below <= v->depth; below++) nodes[below] += leaves << 3 * (below - level - 1);
            w += 1 + r + ((uint32_t)__builtin_popcount(mask) - 1) * (uint64_t)l->offset_words;
        }
        if (!whole) return SVO_OK; /* nodes below may be counted too seldom for that */
    }
    uint64_t parts[3] = {0}; /* bricks, octants, voxels */
    for (uint64_t i = 0; i < v->brick_count; i++) {
        uint64_t times = c->times[v->brick_level & 1][i];
        if (times == 0) SVO_TRY(go_on(c, bad(c, "DAG-05", v->brick_level, i, "a brick that nothing refers to")));
        parts[0] += times;
        parts[1] += times * (uint64_t)__builtin_popcountll(svo_brick_octants(v->bricks[i]));
        parts[2] += times * (uint64_t)__builtin_popcountll(v->bricks[i]);
    }
    for (uint32_t i = 0; i < 3; i++) {
        uint32_t virtual_levels = v->tree_depth - v->depth, level = v->brick_level + i;
        if (level >= virtual_levels) nodes[level - virtual_levels] += parts[i];
    }
    for (uint32_t level = 0; level <= SVO_MAX_DEPTH; level++)
        if (nodes[level] != v->nodes[level]) SVO_TRY(go_on(c, bad(c, "DAG-07", level, nodes[level], "number of octree nodes is wrong")));
    return SVO_OK;
}

static svo_result check_geometry(validate *c)
{
    const svo_view *v = c->v;
    if ((v->brick_count == 0 && v->brick_level == 0) || v->brick_count > UINT32_MAX) return bad(c, "DAG-04", v->brick_level, 0, "number of bricks out of range");
    uint64_t allowed = v->depth == 0 ? 1 : v->depth == 1 ? 0xff : ~(uint64_t)0;
    for (uint64_t i = 0; i < v->brick_count; i++)
        if (v->bricks[i] == 0 || (v->bricks[i] & ~allowed) != 0)
            SVO_TRY(go_on(c, bad(c, "DAG-04", v->brick_level, i, "a brick is empty or has voxels outside the grid")));
    bool whole = true;
    for (uint32_t level = v->brick_level; level-- > 0;) {
        svo_result r = find_starts(c, level);
        SVO_TRY(go_on(c, r));
        whole = whole && r == SVO_OK; /* levels above are then looked at one by one; what their references say cannot be told */
        if (whole) SVO_TRY(check_level(c, level, &whole));
    }
    if (!whole) return SVO_OK;
    uint64_t total;
    if (v->brick_level == 0) {
        if (v->root >= v->brick_count) return bad(c, "DAG-05", 0, v->root, "the root is no brick");
        total = brick_size(svo_view_brick_lod(v), v->bricks[v->root]);
    } else {
        if (!is_start(c, 0, v->root)) return bad(c, "DAG-05", 0, v->root, "the root is no node");
        total = c->size[0][number(c, 0, v->root)];
    }
    if (total != v->attribute_count) SVO_TRY(go_on(c, bad(c, "DAG-06", 0, total, "number of attributes is not the size of the tree")));
    return count_nodes(c);
}

/* -32768 is no octahedral coordinate. */
static svo_result check_normals(validate *c, uint32_t channel, const uint8_t *values, uint64_t count)
{
    for (uint64_t i = 0; i < 2 * count; i++)
        if (values[2 * i] == 0 && values[2 * i + 1] == 0x80) SVO_TRY(go_on(c, bad(c, "DAG-10", channel, i / 2, "a normal holds -32768")));
    return SVO_OK;
}

static svo_result check_corrections(validate *c, uint32_t i)
{
    const svo_view *v = c->v;
    const svo_view_channel *ch = &v->channels[i];
    const uint32_t stride = svo_channel_stride(ch->channel.kind);
    uint64_t last = 0;
    if (ch->correction_count != 0 && (!v->averaged || ch->encoding == SVO_ENCODING_CONSTANT)) return bad(c, "DAG-22", i, 0, "corrections of a channel without averages");
    for (uint64_t k = 0; k < ch->correction_count; k++) {
        const uint8_t *p = ch->corrections + k * SVO_CORRECTION;
        uint64_t key, voxels;
        uint32_t value;
        memcpy(&key, p, sizeof key);
        memcpy(&value, p + 8, sizeof value);
        voxels = (key & 63) + 1;
        if ((k != 0 && key <= last) || voxels < 2 || key >> 6 >= v->attribute_count || voxels > v->attribute_count - (key >> 6))
            SVO_TRY(go_on(c, bad(c, "DAG-22", i, k, "corrections are not ascending, or one is of values that are not there")));
        if (stride < 4 && value >> 8 * stride != 0) SVO_TRY(go_on(c, bad(c, "DAG-22", i, k, "unused bytes of a correction are not 0")));
        if (ch->channel.kind == SVO_KIND_NORMAL_OCT32 && ((value & 0xffff) == 0x8000 || value >> 16 == 0x8000))
            SVO_TRY(go_on(c, bad(c, "DAG-10", i, k, "a normal holds -32768")));
        last = key;
    }
    return SVO_OK;
}

static svo_result check_channel(validate *c, uint32_t i)
{
    const svo_view *v = c->v;
    const svo_view_channel *ch = &v->channels[i];
    uint32_t stride = svo_channel_stride(ch->channel.kind);
    bool normals = ch->channel.kind == SVO_KIND_NORMAL_OCT32;
    svo_palette p;
    if (stride == 0) return bad(c, "DAG-02", i, 0, "unknown kind of channel");
    SVO_TRY(check_corrections(c, i));
    switch (ch->encoding) {
    case SVO_ENCODING_CONSTANT: return normals ? check_normals(c, i, ch->channel.value, 1) : SVO_OK;
    case SVO_ENCODING_RAW: return normals ? check_normals(c, i, ch->raw, v->attribute_count) : SVO_OK;
    case SVO_ENCODING_BLOCKS:
    case SVO_ENCODING_LONG_BLOCKS:
        p = svo_view_palette(v, i);
        if (ch->encoding == SVO_ENCODING_BLOCKS) SVO_TRY(go_on(c, svo_palette_check_all(&p, NULL, c->rules, c->err)));
        else SVO_TRY(go_on(c, svo_algorithm1_check_all(&p, NULL, c->rules, c->err)));
        return normals ? check_normals(c, i, ch->table, ch->table_count) : SVO_OK;
    }
    return bad(c, "DAG-02", i, 0, "unknown encoding of a channel");
}

svo_result svo_view_validate(const svo_view *v, const svo_allocator *a, svo_error *err) { return svo_view_violations(v, a, UINT64_MAX, NULL, err); }

svo_result svo_view_violations(const svo_view *v, const svo_allocator *a, uint64_t usable, svo_rules *rules, svo_error *err)
{
    svo_error here = {0};
    if (rules != NULL && err == NULL) err = &here;
    validate c = {.v = v, .a = a, .err = err, .rules = rules};
    if (v->depth > SVO_MAX_DEPTH || v->tree_depth != (v->depth < 2 ? 2 : v->depth) || v->brick_level != v->tree_depth - 2 ||
        v->channel_count > SVO_MAX_CHANNELS)
        return bad(&c, "DAG-02", 0, 0, "depth or number of channels out of range");
    svo_result r = SVO_OK;
    if (v->layout != SVO_LAYOUT_PLAIN && v->layout != SVO_LAYOUT_FAST && v->layout != SVO_LAYOUT_BEST) return bad(&c, "DAG-01", 0, (uint64_t)v->layout, "unknown layout");
    if (v->layout == SVO_LAYOUT_BEST && !v->empty && v->best == NULL)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "svo_view_prepare comes before svo_view_validate");
    for (uint32_t i = 0; i < v->channel_count && v->unnumbered; i++)
        if (v->channels[i].encoding != SVO_ENCODING_CONSTANT) SVO_TRY(go_on(&c, bad(&c, "DAG-06", 0, i, "a channel varies, but attributes are not numbered")));
    if (v->averaged && !v->lod) SVO_TRY(go_on(&c, bad(&c, "DAG-02", 0, 0, "averages without attributes of inner nodes")));
    if (v->averaged && !v->unnumbered && v->attribute_count >> SVO_AVERAGE_SHIFT != 0) return bad(&c, "DAG-22", 0, v->attribute_count, "too many attributes for averages");
    if (v->empty) {
        bool zero = v->attribute_count == 0 && v->brick_count == 0 && v->root == 0 && v->layout == SVO_LAYOUT_PLAIN;
        for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) zero = zero && v->nodes[l] == 0;
        if (!zero) r = bad(&c, "DAG-07", 0, 0, "an empty octree with nodes");
    } else {
        r = v->layout == SVO_LAYOUT_FAST ? svoi_fast_validate(v, a, rules, err) : v->layout == SVO_LAYOUT_BEST ? svoi_best_validate(v, a, rules, err) : check_geometry(&c);
    }
    r = go_on(&c, r);
    for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) {
        svo_free(a, c.level[l].bit, c.level[l].words, sizeof *c.level[l].bit);
        svo_free(a, c.level[l].before, c.level[l].words, sizeof *c.level[l].before);
    }
    for (int i = 0; i < 2; i++) {
        svo_free(a, c.size[i], c.size_count[i], sizeof *c.size[i]);
        svo_free(a, c.times[i], c.times_count[i], sizeof *c.times[i]);
    }
    for (uint32_t i = 0; i < v->channel_count && r == SVO_OK; i++)
        if (usable >> i & 1) r = go_on(&c, check_channel(&c, i));
    return r;
}
