#include "voxelize_cells.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_import_voxels.h"
#include "fmt_svo.h"
#include "svo_math.h"
#include "voxelize_sources.h"

bool voxelize_is_cells(const char *path)
{
    uint8_t head[16];
    size_t n = 0;
    FILE *f = fopen(path, "rb");
    if (f != NULL) {
        n = fread(head, 1, sizeof head, f);
        fclose(f);
    }
    return fmt_is_voxels(head, n);
}

static svo_result describe(const cells_options *o, const fmt_voxels *v, svo_tree_info *info, svo_error *err)
{
    uint32_t depth = 0;
    while (((uint32_t)1 << depth) < v->side) depth++;
    memset(info, 0, sizeof *info);
    if (o->has_depth && o->depth < depth)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "--depth %u is too small: the voxels of this file need %u (they are taken as they are, not resampled)", o->depth, depth);
    info->depth = o->has_depth ? o->depth : depth;
    memcpy(info->voxel_to_world, v->to_world, sizeof info->voxel_to_world);
    svo_mat4 m, inverse;
    memcpy(m.m, v->to_world, sizeof m.m);
    if (!svo_mat4_affine_inverse(&m, &inverse)) return svo_fail(err, SVO_INVALID_DATA, "the directions of the file's axes are no basis");
    bool any = strcmp(o->attributes, "none") != 0;
    if (any && strcmp(o->attributes, "auto") != 0 && strcmp(o->attributes, "color") != 0)
        return svo_fail(err, SVO_UNSUPPORTED, "--attributes of voxel files: auto, none or color");
    if (!any || !v->colored) return SVO_OK;
    const fmt_cell *c = (const fmt_cell *)(const void *)v->cells.data;
    uint64_t count = v->cells.size / sizeof *c;
    svo_channel *channel = &info->channels[info->channel_count++];
    strcpy(channel->name, "color");
    channel->kind = SVO_KIND_COLOR_SRGB8;
    channel->constant = true;
    for (uint64_t i = 1; i < count && channel->constant; i++) channel->constant = memcmp(c[i].rgb, c[0].rgb, 3) == 0;
    if (channel->constant && count != 0) memcpy(channel->value, c[0].rgb, 3);
    return SVO_OK;
}

static svo_result write_file(cli *c, const cells_options *o, const fmt_voxels *v, const char *provenance, const svo_allocator *a, svo_error *err)
{
    svo_tree_info info;
    fmt_output *out = NULL;
    fmt_svo_writer *writer = NULL;
    svo_tree_counts counts = {0};
    SVO_TRY(describe(o, v, &info, err));
    SVO_TRY(fmt_output_open(c->output, c->force, &out, err));
    svo_result r = fmt_svo_writer_begin(out, &info, provenance, o->level, a, &writer, err);
    if (r == SVO_OK && o->small) r = fmt_svo_writer_small(writer, err);
    if (r == SVO_OK) {
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        r = fmt_voxels_emit(v, &info, &sink, err);
    }
    if (r == SVO_OK) {
        r = fmt_svo_writer_end(writer, &counts, err);
        writer = NULL;
    }
    fmt_svo_writer_discard(writer);
    if (r != SVO_OK) {
        fmt_output_discard(out);
        return r;
    }
    json_t *report = cli_section(c, "output");
    cli_put_u64(report, "bytes", fmt_output_offset(out));
    cli_put_u64(report, "depth", info.depth);
    cli_put_u64(report, "voxels", counts.nodes[info.depth]);
    return fmt_output_commit(out, err);
}

static svo_result make(cli *c, const cells_options *o, const fmt_bytes *b, const svo_allocator *a, sources *read, svo_error *err)
{
    fmt_voxels v;
    cli_phase(c, "import");
    sources_add(read, c->inputs[0], b->data, b->size, b->mapped);
    if (read->failed) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    json_t *inputs = json_array(), *how = json_object();
    json_array_append_new(inputs, cli_provenance_input(c->inputs[0], read->list[0].hash));
    if (o->has_depth) cli_put_u64(how, "depth", o->depth);
    if (o->threshold != NULL) cli_put_f64(how, "threshold", *o->threshold);
    cli_put_text(how, "attributes", o->attributes);
    char *provenance = cli_provenance(c, how, inputs);
    if (provenance == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_result r = SVO_OK;
    if (o->key) {
        uint8_t key[16];
        char *what = malloc(strlen(provenance) + 80), hex[33];
        r = what != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
        if (r == SVO_OK) sprintf(what, "%s\nvoxels, format 1.0 level %d disk %d", provenance, o->level, o->small);
        if (r == SVO_OK) r = sources_key(read, what, key, err);
        if (r == SVO_OK) fmt_hash_text(key, hex), puts(hex);
        free(what);
    } else {
        r = cli_about(c->inputs[0], fmt_import_voxels(b->data, b->size, o->threshold, a, &v, err), err);
        if (r == SVO_OK) {
            cli_put_u64(cli_section(c, "input"), "voxels", v.cells.size / sizeof(fmt_cell));
            cli_phase(c, "write");
            r = write_file(c, o, &v, provenance, a, err);
            svo_buffer_free(&v.cells);
        }
        if (r == SVO_OK && o->depfile != NULL) r = sources_depfile(read, o->depfile, c->output, c->force, err);
    }
    cli_phase(c, NULL);
    free(provenance);
    return r;
}

svo_result voxelize_cells(cli *c, const cells_options *o, svo_error *err)
{
    svo_limit_allocator limit;
    fmt_bytes b;
    sources read = {0};
    svo_limit_allocator_init(&limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    SVO_TRY(fmt_bytes_open(c->inputs[0], c->memory, &limit.base, &b, err));
    svo_result r = make(c, o, &b, &limit.base, &read, err);
    fmt_bytes_close(&b);
    sources_free(&read);
    if (r == SVO_OUT_OF_MEMORY && c->memory != 0) r = svo_fail(err, SVO_LIMIT, "the voxels do not fit into --memory");
    return r;
}
