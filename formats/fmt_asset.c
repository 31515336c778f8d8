#include "fmt_asset.h"

#include <string.h>

#include "fmt_import.h"
#include "fmt_svo.h"
#include "svo_voxelize.h"

struct fmt_asset {
    const svo_allocator *allocator;
    fmt_bytes bytes; /* of a .svdag */
    bool opened;
    fmt_svdag svdag;
    svo_packed *packed; /* of anything else */
};

/* Kind of one of our containers, 0 for other content. */
static uint32_t kind_of(const fmt_bytes *b)
{
    static const uint8_t signature[8] = {0x89, 'S', 'V', 'X', 0x0d, 0x0a, 0x1a, 0x0a};
    if (b->size < 64 || memcmp(b->data, signature, 8) != 0) return 0;
    return fmt_load32(b->data + 16);
}

static svo_result build_svo(fmt_asset *a, const svo_dag_options *options, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *reader = NULL;
    SVO_TRY(fmt_input_open_memory(a->bytes.data, a->bytes.size, &in, err));
    svo_result r = fmt_svo_reader_open(in, options->allocator, &reader, err);
    if (r == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        r = svo_dag_build(fmt_svo_reader_info(reader), &source, options, &a->packed, NULL, err);
    }
    fmt_svo_reader_close(reader);
    fmt_input_close(in);
    return r;
}

static svo_result voxelize(fmt_asset *a, const svo_mesh *mesh, uint32_t depth, const svo_dag_options *options, svo_error *err)
{
    svo_voxelize_options o = svo_default_voxelize_options();
    o.depth = depth;
    o.threads = options->threads;
    o.memory = options->memory;
    o.allocator = options->allocator;
    o.warnings = options->warnings;
    svo_tree_info info;
    svo_dag_builder *b;
    SVO_TRY(svo_voxelize_plan(mesh, &o, &info, err));
    SVO_TRY(svo_dag_builder_create(&info, options, &b, err));
    svo_chunk_sink sink = svo_dag_builder_sink(b);
    svo_result r = svo_voxelize(mesh, &o, &info, &sink, NULL, err);
    if (r == SVO_OK) return svo_dag_builder_finish(b, &a->packed, NULL, err);
    svo_dag_builder_free(b);
    return r;
}

static svo_result build_mesh(fmt_asset *a, const char *path, uint32_t depth, const svo_dag_options *options, svo_error *err)
{
    fmt_import_options o = {.allocator = options->allocator, .warnings = options->warnings};
    svo_mesh mesh;
    if (strcmp(path, "-") == 0)
        return svo_fail(err, SVO_UNSUPPORTED, "stdin holds no .svo or .svdag; a mesh must be given as a file");
    SVO_TRY(fmt_import_mesh(path, &o, &mesh, err));
    svo_result r = voxelize(a, &mesh, depth, options, err);
    svo_mesh_free(&mesh);
    return r;
}

static svo_result open_content(fmt_asset *a, const char *path, uint32_t depth, const svo_dag_options *options, svo_error *err)
{
    switch (kind_of(&a->bytes)) {
    case FMT_KIND_SVDAG:
        SVO_TRY(fmt_svdag_open(a->bytes.data, a->bytes.size, a->allocator, &a->svdag, err));
        a->opened = true;
        return SVO_OK;
    case FMT_KIND_SVO: return build_svo(a, options, err);
    case FMT_KIND_SKEL:
    case FMT_KIND_SCENE: return svo_fail(err, SVO_INVALID_DATA, "%s holds no voxels: it is neither a .svo, a .svdag nor a mesh", path);
    }
    return build_mesh(a, path, depth, options, err);
}

svo_result fmt_asset_open(const char *path, uint32_t depth, const svo_dag_options *options, fmt_asset **out, svo_error *err)
{
    svo_dag_options o = options != NULL ? *options : svo_default_dag_options();
    fmt_asset *a = svo_calloc(o.allocator, 1, sizeof *a);
    if (a == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    a->allocator = o.allocator;
    svo_result r = fmt_bytes_open(path, o.memory, o.allocator, &a->bytes, err);
    if (r == SVO_OK) r = open_content(a, path, depth, &o, err);
    if (r == SVO_OK && !a->opened) fmt_bytes_close(&a->bytes);
    if (r != SVO_OK) {
        fmt_asset_close(a);
        return r;
    }
    *out = a;
    return SVO_OK;
}

const svo_view *fmt_asset_view(const fmt_asset *a) { return a->opened ? &a->svdag.view : svo_packed_view(a->packed); }

void fmt_asset_close(fmt_asset *a)
{
    if (a == NULL) return;
    if (a->opened) fmt_svdag_close(&a->svdag);
    fmt_bytes_close(&a->bytes);
    svo_packed_free(a->packed);
    svo_free(a->allocator, a, 1, sizeof *a);
}
