/* svo-dump of a .svdag. */
#include "dump.h"

#include <stdio.h>
#include <string.h>

#include "fmt_svdag.h"
#include "svo_algorithm1.h"
#include "svo_scene.h"

json_t *dump_view_channels(const svo_view *v, const fmt_container *c)
{
    static const char *const encodings[] = {"constant", "raw", "blocks", "long blocks"};
    json_t *list = json_array();
    for (uint32_t i = 0; i < v->channel_count; i++) {
        const svo_view_channel *k = &v->channels[i];
        json_t *a = dump_channel(&k->channel);
        cli_put_text(a, "encoding", k->encoding <= SVO_ENCODING_LONG_BLOCKS ? encodings[k->encoding] : "?");
        if (k->encoding >= SVO_ENCODING_BLOCKS) cli_put_u64(a, "table_entries", k->table_count);
        uint64_t bytes = 0;
        for (uint32_t n = 0; c != NULL && n < c->chunk_count; n++) {
            uint32_t type = c->chunks[n].type;
            if (c->chunks[n].id == i && (type & 0xff) == 'A') bytes += c->chunks[n].stored_size; /* ARAW, ATBL, ADIR, APAY */
        }
        if (c != NULL) cli_put_u64(a, "bytes", bytes);
        json_array_append_new(list, a);
    }
    return list;
}

typedef struct rows {
    const svo_view *v;
    const uint32_t *use;
    uint32_t columns;
    dump_ply *ply;
    svo_result result;
    svo_error *err;
} rows;

static bool write_row(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    rows *r = user;
    uint8_t values[SVO_MAX_CHANNELS][SVO_MAX_STRIDE];
    const uint8_t *pointers[SVO_MAX_CHANNELS];
    for (uint32_t i = 0; i < r->columns; i++) {
        svo_view_attribute(r->v, r->use[i], index, values[i]);
        pointers[i] = values[i];
    }
    r->result = dump_ply_voxel(r->ply, x, y, z, pointers, r->err);
    return r->result == SVO_OK;
}

svo_result dump_view_voxels(const svo_view *v, const uint32_t *use, uint32_t columns, dump_ply *p, svo_error *err)
{
    rows r = {v, use, columns, p, SVO_OK, err};
    if (!v->empty) svo_view_voxels(v, write_row, &r);
    return r.result;
}

static svo_result write_voxels(dump_job *j, const svo_view *v, svo_error *err)
{
    svo_channel channels[SVO_MAX_CHANNELS];
    uint32_t use[SVO_MAX_CHANNELS];
    dump_ply *p;
    for (uint32_t i = 0; i < v->channel_count; i++) {
        channels[i] = v->channels[i].channel;
        use[i] = i;
    }
    SVO_TRY(dump_ply_begin(j, v->nodes[v->depth], channels, v->channel_count, false, &p, err));
    dump_ply_place(p, v->voxel_to_world, NULL, 0);
    svo_result r = dump_view_voxels(v, use, v->channel_count, p, err);
    if (r == SVO_OK) return dump_ply_end(p, err);
    dump_ply_discard(p);
    return r;
}

/* Layout fast: where the bits of a level's nodes are. */
static void put_tree(json_t *level, const svo_view_fast_parts *p, bool blocks)
{
    static const char *const codes[] = {"codes_narrow", "codes_wide", "codes_turned", "bricks_written_out"};
    json_t *o = json_object();
    cli_put_u64(o, "masks", p->masks);
    cli_put_u64(o, "tags", p->tags);
    if (!blocks) {
        cli_put_u64(o, "skips", p->skips);
        cli_put_u64(o, "sizes", p->sizes);
        cli_put_u64(o, "references", p->references);
    }
    for (int i = 0; i < 4 && blocks; i++) cli_put_u64(o, codes[i], p->codes[i]);
    json_object_set_new(level, "tree_bits", o);
    cli_put_u64(level, "bytes", p->bytes);
}

/* How often nodes are really stored, beside how often they appear, and the bytes of what is stored level by level. */
static void put_stored(json_t *o, const svo_view *v)
{
    json_t *levels = json_object_get(o, "levels");
    svo_view_section part[SVO_VIEW_SECTIONS];
    uint32_t parts = svo_view_sections(v, part);
    uint64_t stored = 0;
    svo_view_fast_parts tree[SVO_MAX_DEPTH];
    bool fast = v->layout == SVO_LAYOUT_FAST && !v->empty;
    if (fast) svo_view_fast_count(v, tree);
    for (uint32_t l = 0; l <= v->brick_level; l++) {
        uint64_t n = svo_view_stored(v, l), bytes = 0;
        for (uint32_t i = 0; i < parts; i++) bytes += part[i].level == l ? part[i].bytes : 0;
        if (l < v->brick_level) stored += n;
        if (l > v->depth) continue;
        json_t *level = json_array_get(levels, l);
        cli_put_u64(level, "stored", n);
        if (n != 0) cli_put_f64(level, "sharing", (double)v->nodes[l] / (double)n);
        if (bytes != 0) cli_put_u64(level, "bytes", bytes);
        if (fast && l < v->brick_level) put_tree(level, &tree[l], l + 1 == v->brick_level);
    }
    cli_put_u64(o, "stored_nodes", stored);
    cli_put_u64(o, "stored_bricks", svo_view_stored(v, v->brick_level));
}

/* Blocks of the attribute coder by mode: how many, of how many values, in how many bits. */
static svo_result put_blocks(json_t *o, const svo_view *v, svo_error *err)
{
    json_t *list = json_array();
    json_object_set_new(o, "blocks", list);
    for (uint32_t c = 0; c < v->channel_count; c++) {
        if (v->channels[c].encoding != SVO_ENCODING_BLOCKS && v->channels[c].encoding != SVO_ENCODING_LONG_BLOCKS) continue;
        svo_palette p = svo_view_palette(v, c);
        svo_palette_stats stats;
        SVO_TRY(v->channels[c].encoding == SVO_ENCODING_BLOCKS ? svo_palette_check(&p, &stats, err) : svo_algorithm1_check(&p, &stats, err));
        stats.blocks[0] += stats.blocks[1]; /* one mode, whose number has a bit of the index */
        stats.values[0] += stats.values[1];
        stats.bits[0] += stats.bits[1];
        for (uint32_t m = 0; m < SVO_BLOCK_MODES; m++) {
            if (stats.blocks[m] == 0 || m == 1) continue;
            char name[32];
            json_t *b = json_object();
            cli_put_text(b, "channel", v->channels[c].channel.name);
            svo_block_name(m, name, sizeof name);
            cli_put_text(b, "mode", name);
            cli_put_u64(b, "blocks", stats.blocks[m]);
            cli_put_u64(b, "values", stats.values[m]);
            cli_put_f64(b, "bits_per_value", stats.values[m] != 0 ? (double)stats.bits[m] / (double)stats.values[m] : 0);
            json_array_append_new(list, b);
        }
    }
    return SVO_OK;
}

enum { COSTS = 6 };
typedef struct cost { char what[48]; uint64_t bytes; } cost;

static void add_cost(cost *list, uint32_t *count, const char *what, uint64_t bytes)
{
    uint32_t at = *count < COSTS ? (*count)++ : COSTS;
    while (at > 0 && bytes > list[at - 1].bytes) {
        if (at < COSTS) list[at] = list[at - 1];
        at--;
    }
    if (at == COSTS) return;
    snprintf(list[at].what, sizeof list[at].what, "%s", what);
    list[at].bytes = bytes;
}

/* The parts that take most of the file. */
static void put_costs(const dump_job *j, const svo_view *v)
{
    cost list[COSTS + 1];
    uint32_t count = 0;
    char what[48];
    svo_view_section part[SVO_VIEW_SECTIONS];
    uint32_t parts = svo_view_sections(v, part);
    for (uint32_t i = 0; i < parts; i++) {
        if (v->layout == SVO_LAYOUT_FAST && strcmp(part[i].type, "TREE") == 0) continue; /* level by level */
        if (part[i].level <= SVO_MAX_DEPTH) snprintf(what, sizeof what, "geometry, %.4s of level %u", part[i].type, part[i].level);
        else snprintf(what, sizeof what, "geometry, %.4s", part[i].type);
        add_cost(list, &count, what, part[i].bytes);
    }
    svo_view_fast_parts tree[SVO_MAX_DEPTH];
    bool fast = v->layout == SVO_LAYOUT_FAST && !v->empty;
    if (fast) svo_view_fast_count(v, tree);
    for (uint32_t l = 0; fast && l < v->brick_level; l++) {
        snprintf(what, sizeof what, "geometry, TREE of level %u", l);
        add_cost(list, &count, what, tree[l].bytes);
    }
    for (uint32_t c = 0; c < v->channel_count; c++) {
        const svo_view_channel *k = &v->channels[c];
        uint32_t stride = svo_channel_stride(k->channel.kind);
        if (k->encoding == SVO_ENCODING_CONSTANT) continue;
        if (k->encoding == SVO_ENCODING_RAW) {
            snprintf(what, sizeof what, "%.16s, values", k->channel.name);
            add_cost(list, &count, what, stride * v->attribute_count);
            continue;
        }
        const char *const names[] = {"blocks", "directory", "table"};
        uint64_t entry = k->encoding == SVO_ENCODING_BLOCKS ? SVO_PALETTE_ENTRY : SVO_ALGORITHM1_ENTRY;
        const uint64_t bytes[] = {k->payload_size, entry * svo_view_directory_elements(v, k), stride * k->table_count};
        for (int i = 0; i < 3; i++) {
            snprintf(what, sizeof what, "%.16s, %s", k->channel.name, names[i]);
            add_cost(list, &count, what, bytes[i]);
        }
    }
    json_t *costs = json_array();
    for (uint32_t i = 0; i < count && list[i].bytes != 0; i++) {
        json_t *o = json_object();
        cli_put_text(o, "what", list[i].what);
        cli_put_u64(o, "bytes", list[i].bytes);
        cli_put_f64(o, "share", (double)list[i].bytes / (double)j->size);
        json_array_append_new(costs, o);
    }
    json_object_set_new(j->json, "largest_costs", costs);
}

/* What is not in the file, and the bytes of its plain values. (Table entries that no block names: the report of svo-compress.) */
static void put_left_out(json_t *o, const svo_view *v)
{
    json_t *list = json_array();
    uint64_t nodes = 0;
    for (uint32_t l = 0; l <= v->depth; l++) nodes += v->nodes[l];
    for (uint32_t i = 0; i < v->channel_count; i++) {
        const svo_view_channel *c = &v->channels[i];
        const uint32_t stride = svo_channel_stride(c->channel.kind);
        const uint64_t inner = nodes > v->attribute_count + c->correction_count ? nodes - v->attribute_count - c->correction_count : 0;
        if (c->encoding == SVO_ENCODING_CONSTANT) cli_put_saving(list, "channel that is the same everywhere", c->channel.name, nodes, nodes * stride);
        else if (c->repeats != NULL) cli_put_saving(list, "superblocks of 1024 values that repeat the value before them", c->channel.name, svo_palette_superblocks(v->attribute_count) - c->superblock_count,
                                               (svo_palette_superblocks(v->attribute_count) - c->superblock_count) * (SVO_PALETTE_ENTRY + 2));
        if (c->encoding != SVO_ENCODING_CONSTANT) cli_put_saving(list, v->lod ? "attributes of inner nodes that are averages or in full leaves" : "attributes of inner nodes", c->channel.name, inner, inner * stride);
    }
    json_object_set_new(o, "left_out", list);
}

static svo_result summarise(dump_job *j, const fmt_svdag *f, svo_error *err)
{
    const svo_view *v = &f->view;
    bool any = false;
    uint32_t low[3] = {0}, high[3] = {0};
    if (!j->quick) SVO_TRY(svo_view_grid_bounds(v, j->allocator, &any, low, high, err));
    if (j->voxels != NULL) SVO_TRY(write_voxels(j, v, err));
    if (j->source != NULL) SVO_TRY(dump_against_source(j, v, f->provenance, err));
    dump_container(j, &f->container);
    dump_grid(j->json, v->depth, v->voxel_to_world, v->surface, v->fill);
    if (!j->quick) dump_bounds(j->json, any, low, high, v->voxel_to_world);
    dump_counts(j->json, v->depth, v->nodes, j->size);
    put_stored(j->json, v);
    json_object_set_new(j->json, "lod", json_boolean(v->lod));
    json_object_set_new(j->json, "averaged", json_boolean(v->averaged));
    put_left_out(j->json, v);
    cli_put_u64(j->json, "attribute_count", v->attribute_count);
    json_object_set_new(j->json, "attributes", dump_view_channels(v, &f->container));
    if (!j->quick) SVO_TRY(put_blocks(j->json, v, err));
    put_costs(j, v);
    dump_sections(j, &f->container);
    dump_provenance(j->json, f->provenance);
    return SVO_OK;
}

svo_result dump_svdag(dump_job *j, svo_error *err)
{
    fmt_svdag f;
    SVO_TRY(fmt_svdag_open(j->data, j->size, j->allocator, &f, err));
    svo_result r = summarise(j, &f, err);
    fmt_svdag_close(&f);
    return r;
}
