/* The builder. encode (parallel): a chunk becomes local tables of bricks and nodes and its attributes in stored order.
 * commit (ordered): local tables are merged into the global ones, levels above the chunks are folded on a stack of
 * open nodes. Numbers in a local table follow first appearance, chunks come in order, so global numbers do too. */
#include <string.h>

#include "svo_task.h"
#include "svoi_dag.h"

typedef struct blob {
    uint64_t code;  /* chunks that it covers: code .. end - 1 */
    uint64_t end;
    uint32_t level; /* of its root; a full leaf's may be less than the chunks' */
    bool full;      /* a full leaf as a whole */
    svo_tree_counts counts;
    svoi_bricks bricks;
    svoi_nodes nodes[SVO_CHUNK_LEVELS]; /* of levels chunk_level .. */
    uint32_t root;
    uint64_t size; /* attributes */
    uint8_t *values[SVO_MAX_CHANNELS];
    svoi_sum sum[SVO_MAX_CHANNELS];
    svoi_labels labels[SVO_MAX_CHANNELS];
} blob;

enum { LITTLE = 64 << 20 }; /* bytes: where values take less than a quarter of the memory */

/* A node above the chunks whose children are still coming. */
typedef struct frame {
    uint32_t mask, full, refs[8];
    uint64_t size, index;
    svoi_sum sum[SVO_MAX_CHANNELS];
    svoi_labels labels[SVO_MAX_CHANNELS];
} frame;

struct svo_dag_builder {
    svo_tree_info info;
    svo_dag_options options;
    svo_packed *packed;
    const svo_allocator *a; /* charged to options.memory */
    uint32_t chunk_level, tree_depth, brick_level;
    svoi_bricks bricks;
    svoi_nodes nodes[SVO_MAX_DEPTH];
    svoi_store store;
    svoi_values values[SVO_MAX_CHANNELS];
    svo_tree_counts counts;
    uint64_t attributes;
    bool has_previous;
    uint64_t previous, end; /* chunks that the last item covers: previous .. end - 1 */
    uint32_t open;          /* frames 0 .. open - 1 are open: the levels above the last item */
    frame frames[SVO_MAX_DEPTH];
    uint32_t root;
    svo_buffer map[2]; /* local number -> global number */
    double started;
};

svo_dag_options svo_default_dag_options(void)
{
    svo_dag_options o = {.lod = true, .averaged = true};
    return o;
}

svo_result svoi_no_memory(const svo_packed *p, const char *what, svo_error *err)
{
    if (p->limit != 0)
        return svo_fail(err, SVO_LIMIT, "more memory than the limit of %llu bytes is needed (%s)",
                        (unsigned long long)p->limit, what);
    return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (%s)", what);
}

static svo_result table_failed(svo_dag_builder *b, svo_result r, svo_error *err)
{
    if (r == SVO_LIMIT) return svo_fail(err, SVO_LIMIT, "a level has more than 2^32 words of distinct nodes");
    return svoi_no_memory(b->packed, "geometry", err);
}

static svo_result check_options(const svo_dag_options *o, svo_error *err)
{
    if (o->color_bits > 16) return svo_fail(err, SVO_INVALID_ARGUMENT, "colour bits are 1 to 16, not %u", o->color_bits);
    if (o->normal_bits != 0 && (o->normal_bits < 4 || o->normal_bits > 32 || o->normal_bits % 2 != 0))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "normal bits are even numbers from 4 to 32, not %u", o->normal_bits);
    if (!(o->color_delta_e >= 0 && o->normal_degrees >= 0))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "an error bound must be a positive number");
    if (!(o->color_mean >= 0 && o->color_psnr >= 0) || (o->color_mean > 0 && o->color_psnr > 0) ||
        ((o->color_mean > 0 || o->color_psnr > 0) && !(o->color_delta_e > 0)))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "a mean error or a PSNR is a positive number, one of the two, and needs a bound");
    if ((o->color_bits != 0 && o->color_delta_e > 0) || (o->normal_bits != 0 && o->normal_degrees > 0))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "bits and a bound cannot be given for the same channel");
    return SVO_OK;
}

svo_result svo_dag_builder_create(const svo_tree_info *info, const svo_dag_options *options, svo_dag_builder **out, svo_error *err)
{
    SVO_ASSERT(info->depth <= SVO_MAX_DEPTH && info->channel_count <= SVO_MAX_CHANNELS);
    svo_dag_options o = options != NULL ? *options : svo_default_dag_options();
    SVO_TRY(check_options(&o, err));
    svo_dag_builder *b = svo_calloc(o.allocator, 1, sizeof *b);
    svo_packed *p = svo_calloc(o.allocator, 1, sizeof *p);
    if (b == NULL || p == NULL) {
        svo_free(o.allocator, b, 1, sizeof *b);
        svo_free(o.allocator, p, 1, sizeof *p);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    }
    p->limit = o.memory;
    svo_limit_allocator_init(&p->memory, o.memory != 0 ? o.memory : UINT64_MAX, o.allocator);
    b->info = *info;
    b->options = o;
    b->packed = p;
    b->a = &p->memory.base;
    b->chunk_level = svo_chunk_level(info->depth);
    b->tree_depth = info->depth < 2 ? 2 : info->depth;
    b->brick_level = b->tree_depth - 2;
    b->store.spill = o.spill;
    b->store.budget = o.value_memory != 0 ? o.value_memory : o.memory != 0 ? o.memory / (o.memory < LITTLE ? 8 : 4) : (uint64_t)256 << 20;
    b->bricks.a = b->a;
    for (uint32_t i = 0; i < SVO_MAX_DEPTH; i++) b->nodes[i].a = b->a;
    for (uint32_t i = 0; i < info->channel_count; i++) {
        b->values[i] = (svoi_values){.a = b->a, .stride = svo_channel_stride(info->channels[i].kind), .store = &b->store};
        for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) b->frames[l].labels[i].a = b->a;
    }
    svo_buffer_init(&b->map[0], b->a);
    svo_buffer_init(&b->map[1], b->a);
    b->started = svo_seconds();
    *out = b;
    return SVO_OK;
}

static void builder_free_parts(svo_dag_builder *b)
{
    svoi_bricks_free(&b->bricks);
    for (uint32_t i = 0; i < SVO_MAX_DEPTH; i++) svoi_nodes_free(&b->nodes[i]);
    for (uint32_t i = 0; i < SVO_MAX_CHANNELS; i++) {
        svoi_values_free(&b->values[i]);
        for (uint32_t l = 0; l < SVO_MAX_DEPTH; l++) svoi_labels_free(&b->frames[l].labels[i]);
    }
    svo_buffer_free(&b->map[0]);
    svo_buffer_free(&b->map[1]);
}

void svo_dag_builder_free(svo_dag_builder *b)
{
    if (b == NULL) return;
    builder_free_parts(b);
    svo_packed_free(b->packed);
    svo_free(b->options.allocator, b, 1, sizeof *b);
}

/* --- encode ------------------------------------------------------------------------------------------------------ */

static void blob_free(svo_dag_builder *b, blob *c)
{
    if (c == NULL) return;
    svoi_bricks_free(&c->bricks);
    for (uint32_t i = 0; i < SVO_CHUNK_LEVELS; i++) svoi_nodes_free(&c->nodes[i]);
    for (uint32_t i = 0; i < b->info.channel_count; i++) {
        svo_free(b->a, c->values[i], c->size, b->values[i].stride);
        svoi_labels_free(&c->labels[i]);
    }
    svo_free(b->a, c, 1, sizeof *c);
}

typedef struct walk {
    const uint8_t *mask;
    uint32_t brick_level, chunk_level;
    bool lod, brick_lod;
    blob *to;
    svo_result result;
} walk;

static uint32_t add_brick(walk *w, uint64_t bits, uint64_t *size)
{
    uint32_t number = 0;
    svo_result r = svoi_bricks_insert(&w->to->bricks, bits, &number);
    if (r != SVO_OK) w->result = r;
    *size = svoi_brick_size(w->brick_lod, bits);
    return number;
}

/* Depth is bounded by SVO_CHUNK_LEVELS; the chunk has been checked. */
static uint32_t walk_node(walk *w, uint32_t level, uint64_t *size)
{
    uint32_t mask = *w->mask++;
    if (level == w->brick_level) {
        uint64_t bits = 0;
        for (uint32_t m = mask; m != 0; m &= m - 1) {
            uint64_t voxels = *w->mask++;
            bits |= (voxels != 0 ? voxels : 255) << (8 * (uint32_t)__builtin_ctz(m)); /* an octant that is a full leaf is eight voxels */
        }
        return add_brick(w, bits, size);
    }
    uint32_t refs[8], full = 0, k = 0, number = 0;
    *size = w->lod ? 1 : 0;
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        uint64_t below = 1;
        if (*w->mask == 0) { /* a full leaf */
            w->mask++;
            full |= m & (0u - m);
        } else {
            refs[k++] = walk_node(w, level + 1, &below);
        }
        *size += below;
    }
    if (w->result != SVO_OK) return 0;
    svo_result r = svoi_nodes_insert(&w->to->nodes[level - w->chunk_level], mask | full << 8, refs, *size, &number);
    if (r != SVO_OK) w->result = r;
    return number;
}

static svo_result encode(void *user, const svo_chunk *chunk, uint32_t worker, void **out, svo_error *err)
{
    (void)worker;
    svo_dag_builder *b = user;
    svo_tree_counts counts = {0};
    SVO_TRY(svo_chunk_check(&b->info, chunk, &counts, err));
    blob *c = svo_calloc(b->a, 1, sizeof *c);
    if (c == NULL) return svoi_no_memory(b->packed, "a chunk", err);
    c->code = svo_chunk_first(chunk);
    c->end = svo_chunk_end(chunk);
    c->level = chunk->level;
    c->full = svo_chunk_full(chunk);
    c->counts = counts;
    c->bricks.a = b->a;
    for (uint32_t i = 0; i < SVO_CHUNK_LEVELS; i++) c->nodes[i].a = b->a;
    walk w = {chunk->masks, b->brick_level, b->chunk_level, b->options.lod, b->options.lod && !b->options.averaged, c, SVO_OK};
    if (c->full) c->size = 1;
    else if (b->info.depth == 0) c->root = add_brick(&w, 1, &c->size);
    else if (b->info.depth == 1) c->root = add_brick(&w, chunk->masks[0], &c->size);
    else c->root = walk_node(&w, b->chunk_level, &c->size);
    svoi_bricks_seal(&c->bricks);
    for (uint32_t i = 0; i < SVO_CHUNK_LEVELS; i++) svoi_nodes_seal(&c->nodes[i]);
    svo_result r = w.result;
    for (uint32_t i = 0; i < b->info.channel_count && r == SVO_OK; i++) {
        c->labels[i].a = b->a;
        if (b->info.channels[i].constant) continue;
        c->values[i] = svo_alloc(b->a, c->size, b->values[i].stride);
        r = c->values[i] == NULL ? SVO_OUT_OF_MEMORY
                                 : svoi_chunk_attributes(chunk, i, b->info.channels[i].kind, b->options.lod, b->options.averaged,
                                                         b->tree_depth - b->info.depth, c->values[i], &c->sum[i], &c->labels[i]);
    }
    if (r != SVO_OK) {
        blob_free(b, c);
        return table_failed(b, r, err);
    }
    *out = c;
    return SVO_OK;
}

static void discard(void *user, void *p) { blob_free(user, p); }

/* --- commit ------------------------------------------------------------------------------------------------------ */

/* Local tables into the global ones; *root becomes the global number of the chunk's root. */
static svo_result merge_tables(svo_dag_builder *b, blob *c, uint32_t *root, svo_error *err)
{
    svo_buffer *lower = &b->map[0], *upper = &b->map[1];
    lower->size = 0;
    uint32_t *map = svo_buffer_append(lower, NULL, (size_t)c->bricks.count * sizeof *map);
    if (map == NULL) return svoi_no_memory(b->packed, "geometry", err);
    for (uint64_t i = 0; i < c->bricks.count; i++) {
        svo_result r = svoi_bricks_insert(&b->bricks, c->bricks.bits[i], &map[i]);
        if (r != SVO_OK) return table_failed(b, r, err);
    }
    for (uint32_t level = b->brick_level; level-- > b->chunk_level;) {
        const svoi_nodes *from = &c->nodes[level - b->chunk_level];
        upper->size = 0;
        uint32_t *to = svo_buffer_append(upper, NULL, (size_t)from->count * sizeof *to);
        if (to == NULL) return svoi_no_memory(b->packed, "geometry", err);
        for (uint64_t i = 0; i < from->count; i++) {
            const uint32_t *item = from->items + from->start[i];
            uint32_t refs[8], k = svoi_node_refs(item[0]);
            for (uint32_t j = 0; j < k; j++) refs[j] = map[item[1 + j]];
            svo_result r = svoi_nodes_insert(&b->nodes[level], item[0], refs, from->size[i], &to[i]);
            if (r != SVO_OK) return table_failed(b, r, err);
        }
        svo_buffer *swap = lower;
        lower = upper;
        upper = swap;
        map = to;
    }
    *root = map[c->root];
    return SVO_OK;
}

/* `ref` NULL: a full leaf. */
static svo_result add_child(svo_dag_builder *b, frame *f, uint32_t octant, const uint32_t *ref, uint64_t size, const svoi_sum *sum,
                            const svoi_labels *labels, svo_error *err)
{
    if (ref != NULL) f->refs[svoi_node_refs(f->mask | f->full << 8)] = *ref;
    else f->full |= 1u << octant;
    f->mask |= 1u << octant;
    f->size += size;
    if (!b->options.lod) return SVO_OK;
    for (uint32_t i = 0; i < b->info.channel_count; i++) {
        if (b->info.channels[i].constant) continue;
        if (!svoi_is_label(b->info.channels[i].kind)) svoi_sum_add(&f->sum[i], &sum[i]);
        else if (!svoi_labels_merge(&f->labels[i], labels[i].label, labels[i].count))
            return svoi_no_memory(b->packed, "labels", err);
    }
    return SVO_OK;
}

static svo_result append(svo_dag_builder *b, uint32_t channel, const uint8_t *values, uint64_t count, svo_error *err)
{
    svo_result r = svoi_values_append(&b->values[channel], values, count, err);
    return r == SVO_OUT_OF_MEMORY ? svoi_no_memory(b->packed, "attributes", err) : r;
}

static svo_result open_frame(svo_dag_builder *b, uint32_t level, svo_error *err)
{
    frame *f = &b->frames[level];
    f->mask = f->full = 0;
    f->size = b->options.lod ? 1 : 0;
    f->index = b->attributes;
    for (uint32_t i = 0; i < b->info.channel_count; i++) {
        f->sum[i] = (svoi_sum){0};
        f->labels[i].count = 0;
        if (b->options.lod && !b->info.channels[i].constant) SVO_TRY(append(b, i, NULL, 1, err));
    }
    if (b->options.lod) b->attributes++;
    return SVO_OK;
}

/* All children of the open node are there. */
static svo_result close_frame(svo_dag_builder *b, uint32_t level, svo_error *err)
{
    frame *f = &b->frames[level];
    uint32_t number;
    svo_result r = svoi_nodes_insert(&b->nodes[level], f->mask | f->full << 8, f->refs, f->size, &number);
    if (r != SVO_OK) return table_failed(b, r, err);
    for (uint32_t i = 0; i < b->info.channel_count && b->options.lod; i++) {
        if (b->info.channels[i].constant) continue;
        svo_channel_kind kind = b->info.channels[i].kind;
        uint8_t value[4];
        if (svoi_is_label(kind)) svoi_labels_value(f->labels[i].label, f->labels[i].count, kind, value);
        else svoi_sum_value(&f->sum[i], kind, value);
        if (svoi_values_set(&b->values[i], f->index, value) != SVO_OK) return svoi_no_memory(b->packed, "attributes", err);
    }
    if (level == 0) {
        b->root = number;
        return SVO_OK;
    }
    uint32_t octant = (uint32_t)(b->previous >> (3 * (b->chunk_level - level))) & 7;
    return add_child(b, &b->frames[level - 1], octant, &number, f->size, f->sum, f->labels, err);
}

static svo_result close_frames(svo_dag_builder *b, uint32_t first, svo_error *err)
{
    while (b->open > first) {
        SVO_TRY(close_frame(b, b->open - 1, err));
        b->open--;
    }
    return SVO_OK;
}

static svo_result commit_blob(svo_dag_builder *b, blob *c, svo_error *err)
{
    if (b->has_previous && c->code < b->end)
        return svo_fail(err, SVO_INVALID_DATA, "chunk %llx is out of order", (unsigned long long)c->code);
    uint32_t root = 0;
    if (!c->full) SVO_TRY(merge_tables(b, c, &root, err));
    uint32_t first = 0; /* highest level at which a new node begins */
    if (b->has_previous) {
        while (first < b->open && b->previous >> (3 * (b->chunk_level - first)) == c->code >> (3 * (b->chunk_level - first))) first++;
        SVO_TRY(close_frames(b, first, err));
    }
    for (uint32_t level = first; level < c->level; level++) SVO_TRY(open_frame(b, level, err));
    b->open = c->level;
    svo_counts_ancestors(&b->counts, b->chunk_level, c->level, b->has_previous, b->previous, c->code);
    svo_counts_add(&b->counts, &c->counts);
    for (uint32_t i = 0; i < b->info.channel_count; i++)
        if (!b->info.channels[i].constant) SVO_TRY(append(b, i, c->values[i], c->size, err));
    b->attributes += c->size;
    b->previous = c->code;
    b->end = c->end;
    b->has_previous = true;
    if (b->chunk_level == 0) {
        b->root = root;
        return SVO_OK;
    }
    uint32_t octant = (uint32_t)(c->code >> 3 * (b->chunk_level - c->level)) & 7;
    return add_child(b, &b->frames[c->level - 1], octant, c->full ? NULL : &root, c->size, c->sum, c->labels, err);
}

static svo_result commit(void *user, void *p, svo_error *err)
{
    svo_result r = commit_blob(user, p, err);
    blob_free(user, p);
    return r;
}

svo_chunk_sink svo_dag_builder_sink(svo_dag_builder *b)
{
    svo_chunk_sink s = {b, encode, commit, discard};
    return s;
}

/* --- finish ------------------------------------------------------------------------------------------------------ */

static void fill_view(const svo_dag_builder *b, svo_view *v)
{
    v->layout = SVO_LAYOUT_PLAIN;
    v->unnumbered = true;
    for (uint32_t i = 0; i < b->info.channel_count; i++) v->unnumbered = v->unnumbered && !b->values[i].varies;
    v->depth = b->info.depth;
    v->tree_depth = b->tree_depth;
    v->brick_level = b->brick_level;
    v->empty = !b->has_previous;
    v->lod = b->options.lod;
    v->averaged = b->options.lod && b->options.averaged;
    v->attribute_count = b->attributes;
    memcpy(v->nodes, b->counts.nodes, sizeof v->nodes);
    memcpy(v->voxel_to_world, b->info.voxel_to_world, sizeof v->voxel_to_world);
    v->surface = b->info.surface;
    v->fill = b->info.fill;
    v->root = b->root;
    v->channel_count = b->info.channel_count;
    for (uint32_t i = 0; i < v->channel_count; i++) v->channels[i].channel = b->info.channels[i];
}

/* A single brick has nothing to gain: it is always laid out plainly (layout fast: so are full leaves alone). */
static svo_result lay_out(svo_dag_builder *b, svo_error *err)
{
    if (b->options.geometry == SVO_GEOMETRY_FAST && b->brick_level != 0 && b->bricks.count != 0)
        return svoi_layout_fast(b->packed, b->nodes, &b->bricks, b->options.threads, err);
    if (b->options.geometry != SVO_GEOMETRY_SVDAG && b->options.geometry != SVO_GEOMETRY_FAST && b->brick_level != 0)
        return svoi_layout_best(b->packed, b->nodes, &b->bricks, b->options.geometry == SVO_GEOMETRY_SYMMETRIC, b->options.threads, err);
    return svoi_layout_plain(b->packed, b->nodes, &b->bricks, err);
}

static svo_result finish(svo_dag_builder *b, svo_dag_report *report, svo_error *err)
{
    svo_packed *p = b->packed;
    if (b->has_previous) SVO_TRY(close_frames(b, 0, err));
    svoi_bricks_seal(&b->bricks);
    for (uint32_t l = 0; l < b->brick_level; l++) svoi_nodes_seal(&b->nodes[l]);
    svo_buffer_free(&b->map[0]);
    svo_buffer_free(&b->map[1]);
    fill_view(b, &p->view);
    report->counts = b->counts;
    report->attributes = b->attributes;
    report->channel_count = b->info.channel_count;
    for (uint32_t l = 0; l < b->brick_level; l++) report->unique[l] = b->nodes[l].count;
    report->unique[b->brick_level] = b->bricks.count;
    if (b->options.phase != NULL) b->options.phase(b->options.phase_user, "geometry");
    double read = svo_seconds();
    report->seconds_read = read - b->started;
    if (b->options.memory != 0 && svo_limit_in_use(&p->memory) > b->options.memory / 2) /* what follows needs it more than values that are read in order */
        for (uint32_t i = 0; i < b->info.channel_count; i++) SVO_TRY(svoi_values_spill(&b->values[i], err));
    if (b->has_previous) SVO_TRY(lay_out(b, err));
    if (b->options.phase != NULL) b->options.phase(b->options.phase_user, "attributes");
    double geometry = svo_seconds();
    report->seconds_geometry = geometry - read;
    svo_view_section parts[SVO_VIEW_SECTIONS];
    uint32_t part_count = svo_view_sections(&p->view, parts);
    for (uint32_t i = 0; i < part_count; i++) report->geometry_bytes += parts[i].bytes;
    svoi_allow_output(p, report->geometry_bytes);
    for (uint32_t i = 0; i < b->info.channel_count; i++) {
        memcpy(report->channels[i].name, b->info.channels[i].name, sizeof report->channels[i].name);
        SVO_TRY(svoi_pack_channel(p, i, &b->values[i], &b->options, &report->channels[i], err));
        report->attribute_bytes += report->channels[i].bytes;
    }
    svo_view_accelerate(&p->view, &p->memory.base);
    report->seconds_attributes = svo_seconds() - geometry;
    report->peak_bytes = svo_limit_peak(&p->memory);
    return SVO_OK;
}

svo_result svo_dag_builder_finish(svo_dag_builder *b, svo_packed **out, svo_dag_report *report, svo_error *err)
{
    svo_dag_report local = {0};
    svo_result r = finish(b, &local, err);
    if (r == SVO_OK) {
        if (report != NULL) *report = local;
        *out = b->packed;
        b->packed = NULL;
        builder_free_parts(b);
        svo_free(b->options.allocator, b, 1, sizeof *b);
        return SVO_OK;
    }
    svo_dag_builder_free(b);
    return r;
}

const svo_view *svo_packed_view(const svo_packed *p) { return &p->view; }

void svo_packed_free(svo_packed *p)
{
    if (p == NULL) return;
    for (uint32_t i = 0; i < SVO_MAX_DEPTH; i++) svo_buffer_free(&p->words[i]);
    svo_buffer_free(&p->bricks);
    svo_buffer_free(&p->tree);
    svo_buffer_free(&p->best_stream);
    svo_buffer_free(&p->best_levels);
    svo_buffer_free(&p->best_codes);
    svo_view_release(&p->view, &p->memory.base);
    for (uint32_t i = 0; i < SVO_MAX_CHANNELS; i++) {
        svo_buffer_free(&p->raw[i]);
        svo_buffer_free(&p->table[i]);
        svo_buffer_free(&p->directory[i]);
        svo_buffer_free(&p->payload[i]);
        svo_buffer_free(&p->corrections[i]);
    }
    const svo_allocator *parent = p->memory.parent;
    svo_free(parent, p, 1, sizeof *p);
}

/* --- from a source ----------------------------------------------------------------------------------------------- */

typedef struct build {
    svo_dag_builder *b;
    const svo_chunk_source *source;
} build;

typedef struct item {
    svo_buffer packed, storage;
    void *blob;
} item;

static svo_result build_produce(void *user, void *p, bool *more, svo_error *err)
{
    build *u = user;
    item *it = p;
    it->packed.allocator = it->storage.allocator = u->b->a;
    svo_result r = u->source->fetch(u->source->user, &it->packed, more, err);
    return r == SVO_OUT_OF_MEMORY ? svoi_no_memory(u->b->packed, "reading a chunk", err) : r;
}

static svo_result build_work(void *user, void *p, uint32_t worker, svo_error *err)
{
    build *u = user;
    item *it = p;
    svo_chunk chunk;
    svo_result r = u->source->decode(u->source->user, &it->packed, &it->storage, &chunk, err);
    /* the source knows nothing of our limit */
    if (r == SVO_OUT_OF_MEMORY) return svoi_no_memory(u->b->packed, "reading a chunk", err);
    if (r != SVO_OK) return r;
    return encode(u->b, &chunk, worker, &it->blob, err);
}

static svo_result build_commit(void *user, void *p, svo_error *err)
{
    build *u = user;
    item *it = p;
    void *c = it->blob;
    it->blob = NULL;
    return commit(u->b, c, err);
}

static void build_destroy(void *user, void *p)
{
    build *u = user;
    item *it = p;
    blob_free(u->b, it->blob);
    svo_buffer_free(&it->packed);
    svo_buffer_free(&it->storage);
}

svo_result svo_dag_build(const svo_tree_info *info, const svo_chunk_source *source, const svo_dag_options *options,
                         svo_packed **out, svo_dag_report *report, svo_error *err)
{
    build u = {.source = source};
    SVO_TRY(svo_dag_builder_create(info, options, &u.b, err));
    const uint32_t window = options != NULL && options->memory != 0 && options->memory < LITTLE ? 2 : 0; /* each chunk that waits is memory */
    svo_pipeline p = {.threads = u.b->options.threads, .window = window, .item_size = sizeof(item), .user = &u, .produce = build_produce,
                      .work = build_work, .commit = build_commit, .destroy = build_destroy};
    svo_result r = svo_pipeline_run(&p, err);
    if (r != SVO_OK) {
        svo_dag_builder_free(u.b);
        return r;
    }
    return svo_dag_builder_finish(u.b, out, report, err);
}
