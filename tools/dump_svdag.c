/* svo-dump of a .svdag. */
#include "dump.h"

#include <string.h>

#include "fmt_svdag.h"
#include "svo_scene.h"

json_t *dump_view_channels(const svo_view *v, const fmt_container *c)
{
    static const char *const encodings[] = {"constant", "raw", "blocks"};
    json_t *list = json_array();
    for (uint32_t i = 0; i < v->channel_count; i++) {
        const svo_view_channel *k = &v->channels[i];
        json_t *a = dump_channel(&k->channel);
        cli_put_text(a, "encoding", k->encoding <= SVO_ENCODING_BLOCKS ? encodings[k->encoding] : "?");
        if (k->encoding == SVO_ENCODING_BLOCKS) cli_put_u64(a, "table_entries", k->table_count);
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

/* How often nodes are really stored, beside how often they appear. */
static void put_stored(json_t *o, const svo_view *v)
{
    json_t *levels = json_object_get(o, "levels");
    uint64_t stored = 0;
    for (uint32_t l = 0; l <= v->brick_level; l++) {
        uint64_t n = svo_view_stored(v, l);
        if (l <= v->depth) cli_put_u64(json_array_get(levels, l), "stored", n);
        if (l < v->brick_level) stored += n;
    }
    cli_put_u64(o, "stored_nodes", stored);
    cli_put_u64(o, "stored_bricks", svo_view_stored(v, v->brick_level));
}

static svo_result summarise(dump_job *j, const fmt_svdag *f, svo_error *err)
{
    const svo_view *v = &f->view;
    bool any = false;
    uint32_t low[3] = {0}, high[3] = {0};
    if (!j->quick) SVO_TRY(svo_view_grid_bounds(v, j->allocator, &any, low, high, err));
    if (j->voxels != NULL) SVO_TRY(write_voxels(j, v, err));
    dump_container(j, &f->container);
    dump_grid(j->json, v->depth, v->voxel_to_world, v->surface, v->fill);
    if (!j->quick) dump_bounds(j->json, any, low, high, v->voxel_to_world);
    dump_counts(j->json, v->depth, v->nodes, j->size);
    put_stored(j->json, v);
    json_object_set_new(j->json, "lod", json_boolean(v->lod));
    cli_put_u64(j->json, "attribute_count", v->attribute_count);
    json_object_set_new(j->json, "attributes", dump_view_channels(v, &f->container));
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
