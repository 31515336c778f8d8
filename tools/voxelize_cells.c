#include "voxelize_cells.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli_sources.h"
#include "fmt_import_voxels.h"
#include "fmt_svo.h"
#include "fmt_volume.h"
#include "svo_math.h"

bool voxelize_is_cells(const char *path)
{
    uint8_t head[16];
    size_t n = 0;
    FILE *f = fopen(path, "rb");
    if (f != NULL) {
        n = fread(head, 1, sizeof head, f);
        fclose(f);
    }
    return fmt_is_voxels(head, n) || fmt_is_nrrd(head, n);
}

/* What was read: voxels one by one, or a volume. */
typedef struct grid_file {
    fmt_voxels v;
    fmt_volume *volume;
    uint64_t voxels;
    uint32_t side;
    bool colored, one_color;
    uint8_t color[3];
    const double *to_world;
} grid_file;

static svo_result read_file(cli *c, const cells_options *o, const fmt_bytes *b, const svo_allocator *a, sources *read, grid_file *g, svo_error *err)
{
    if (o->raw != NULL || fmt_is_nrrd(b->data, b->size)) {
        const fmt_volume_options how = {.raw = o->raw, .raw_size = o->raw_size, .threshold = o->threshold, .threads = (uint32_t)c->threads, .mapped = b->mapped, .memory = c->memory,
                                        .temporary = o->temp_size, .allocator = a, .file_read = sources_add, .file_read_user = read};
        SVO_TRY(fmt_volume_open(c->inputs[0], b->data, b->size, &how, &g->volume, err));
        const fmt_volume_facts *f = fmt_volume_about(g->volume);
        g->voxels = f->voxels;
        g->side = f->side;
        g->colored = f->colored;
        g->one_color = f->one_color;
        memcpy(g->color, f->color, 3);
        g->to_world = f->to_world;
        json_t *in = cli_section(c, "input"), *size = json_array();
        for (int k = 0; k < 3; k++) json_array_append_new(size, json_integer((json_int_t)f->size[k]));
        json_object_set_new(in, "size", size);
        cli_put_f64(in, "value_low", f->low);
        cli_put_f64(in, "value_high", f->high);
    } else {
        SVO_TRY(fmt_import_voxels(b->data, b->size, a, &g->v, err));
        const fmt_cell *cell = (const fmt_cell *)(const void *)g->v.cells.data;
        g->voxels = g->v.cells.size / sizeof *cell;
        g->side = g->v.side;
        g->colored = g->v.colored;
        g->one_color = true;
        for (uint64_t i = 1; i < g->voxels && g->one_color; i++) g->one_color = memcmp(cell[i].rgb, cell[0].rgb, 3) == 0;
        if (g->voxels != 0) memcpy(g->color, cell[0].rgb, 3);
        g->to_world = g->v.to_world;
    }
    cli_put_u64(cli_section(c, "input"), "voxels", g->voxels);
    return SVO_OK;
}

static void free_file(grid_file *g)
{
    if (g->volume == NULL) svo_buffer_free(&g->v.cells);
    fmt_volume_close(g->volume);
}

static svo_result describe(const cells_options *o, const grid_file *g, svo_tree_info *info, svo_error *err)
{
    uint32_t depth = 0;
    while (((uint32_t)1 << depth) < g->side) depth++;
    memset(info, 0, sizeof *info);
    if (o->has_depth && o->depth < depth)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "--depth %u is too small: the voxels of this file need %u (they are taken as they are, not resampled)", o->depth, depth);
    info->depth = o->has_depth ? o->depth : depth;
    memcpy(info->voxel_to_world, g->to_world, sizeof info->voxel_to_world);
    svo_mat4 m, inverse;
    memcpy(m.m, g->to_world, sizeof m.m);
    if (!svo_mat4_affine_inverse(&m, &inverse)) return svo_fail(err, SVO_INVALID_DATA, "the directions of the file's axes are no basis");
    const char *list = o->attributes;
    const bool both = strcmp(list, "color,intensity") == 0 || strcmp(list, "intensity,color") == 0;
    const bool color = both || strcmp(list, "auto") == 0 || strcmp(list, "color") == 0, intensity = both || strcmp(list, "intensity") == 0;
    if (!color && !intensity && strcmp(list, "none") != 0)
        return svo_fail(err, SVO_UNSUPPORTED, "--attributes of voxel files: auto, none, color, and of volumes intensity");
    if (intensity && g->volume == NULL) return svo_fail(err, SVO_INVALID_ARGUMENT, "--attributes intensity is for volumes");
    if (color && g->colored) {
        svo_channel *channel = &info->channels[info->channel_count++];
        strcpy(channel->name, "color");
        channel->kind = SVO_KIND_COLOR_SRGB8;
        channel->constant = g->one_color;
        if (g->one_color) memcpy(channel->value, g->color, 3);
    }
    if (intensity) {
        svo_channel *channel = &info->channels[info->channel_count++];
        strcpy(channel->name, "intensity");
        channel->kind = SVO_KIND_UNORM8;
    }
    return SVO_OK;
}

static svo_result write_file(cli *c, const cells_options *o, const grid_file *g, const char *provenance, const svo_allocator *a, svo_error *err)
{
    svo_tree_info info;
    fmt_output *out = NULL;
    fmt_svo_writer *writer = NULL;
    svo_tree_counts counts = {0};
    SVO_TRY(describe(o, g, &info, err));
    SVO_TRY(fmt_output_open(c->output, c->force, &out, err));
    svo_result r = fmt_svo_writer_begin(out, &info, provenance, o->level, a, &writer, err);
    if (r == SVO_OK && o->small) r = fmt_svo_writer_small(writer, err);
    if (r == SVO_OK) {
        svo_chunk_sink sink = fmt_svo_writer_sink(writer);
        r = g->volume != NULL ? fmt_volume_emit(g->volume, &info, &sink, err) : fmt_voxels_emit(&g->v, &info, &sink, err);
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

/* The options that decide the output, and the inputs, as text. NULL: out of memory. */
static char *provenance_of(const cli *c, const cells_options *o, const sources *read)
{
    json_t *inputs = json_array(), *how = json_object();
    for (size_t i = 0; i < read->count; i++) json_array_append_new(inputs, cli_provenance_input(read->list[i].path, read->list[i].hash));
    if (o->has_depth) cli_put_u64(how, "depth", o->depth);
    if (o->threshold != NULL) cli_put_f64(how, "threshold", *o->threshold);
    if (o->raw != NULL) cli_put_text(how, "raw", o->raw);
    if (o->raw_size > 0) cli_put_f64(how, "voxel_size", o->raw_size);
    cli_put_text(how, "attributes", o->attributes);
    return cli_provenance(c, how, inputs);
}

static svo_result print_key(const cells_options *o, const sources *read, const char *provenance, svo_error *err)
{
    uint8_t key[16];
    char *what = malloc(strlen(provenance) + 80), hex[33];
    if (what == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    sprintf(what, "%s\nvoxels, format 1.0 level %d disk %d", provenance, o->level, o->small);
    svo_result r = sources_key(read, what, key, err);
    if (r == SVO_OK) fmt_hash_text(key, hex), puts(hex);
    free(what);
    return r;
}

static svo_result make(cli *c, const cells_options *o, const fmt_bytes *b, const svo_allocator *a, sources *read, svo_error *err)
{
    grid_file g = {0};
    cli_phase(c, "import");
    sources_add(read, c->inputs[0], b->data, b->size, b->mapped);
    svo_result r = cli_about(c->inputs[0], read_file(c, o, b, a, read, &g, err), err);
    if (r != SVO_OK) return r;
    char *provenance = read->failed ? NULL : provenance_of(c, o, read);
    if (provenance == NULL) r = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    if (r == SVO_OK && o->key) {
        r = print_key(o, read, provenance, err);
    } else if (r == SVO_OK) {
        cli_phase(c, "write");
        r = sources_check_depfile(read, o->depfile, c->force, err);
        if (r == SVO_OK) r = write_file(c, o, &g, provenance, a, err);
        if (r == SVO_OK && o->depfile != NULL) r = sources_depfile(read, o->depfile, c->output, c->force, err);
    }
    cli_phase(c, NULL);
    free_file(&g);
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
