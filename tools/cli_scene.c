#include "cli_scene.h"

#include <string.h>

#include "fmt_svo.h"

static svo_result pack(cli *c, const uint8_t *data, uint64_t size, const svo_allocator *a, cli_scene *out, svo_error *err)
{
    fmt_input *stream = NULL;
    fmt_svo_reader *reader = NULL;
    svo_result r = fmt_input_open_memory(data, size, &stream, err);
    if (r == SVO_OK) r = fmt_svo_reader_open(stream, a, &reader, err);
    if (r == SVO_OK) {
        svo_dag_options o = svo_default_dag_options();
        o.threads = (uint32_t)c->threads;
        o.allocator = a;
        o.warnings = &c->warnings;
        svo_chunk_source source = fmt_svo_reader_source(reader);
        r = svo_dag_build(fmt_svo_reader_info(reader), &source, &o, &out->packed, NULL, err);
    }
    fmt_svo_reader_close(reader);
    fmt_input_close(stream);
    return r;
}

static svo_result single(cli_scene *out, const svo_view *view, const svo_allocator *a, svo_error *err)
{
    SVO_TRY(svo_scene_single(view, "", a, &out->single, err));
    out->scene = &out->single.scene;
    return SVO_OK;
}

static svo_result open_kind(cli *c, const char *name, const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_scene_loss *loss, cli_scene *out,
                            svo_error *err)
{
    switch ((fmt_kind)fmt_container_kind(data, size)) {
    case FMT_KIND_SCENE:
        out->kind = "svscene";
        if (loss != NULL) SVO_TRY(fmt_scene_open_partly(data, size, a, &out->file, loss, err));
        else SVO_TRY(fmt_scene_open(data, size, a, &out->file, err));
        out->scene = &out->file.scene;
        return SVO_OK;
    case FMT_KIND_SVDAG:
        out->kind = "svdag";
        SVO_TRY(fmt_svdag_open(data, size, a, &out->dag, err));
        return single(out, &out->dag.view, a, err);
    case FMT_KIND_SVO:
        out->kind = "svo";
        SVO_TRY(pack(c, data, size, a, out, err));
        return single(out, svo_packed_view(out->packed), a, err);
    case FMT_KIND_SKEL: return svo_fail(err, SVO_UNSUPPORTED, "%.100s is a skeleton; this needs an .svo, .svdag or .svscene file", name);
    }
    return svo_fail(err, SVO_INVALID_DATA, "%.100s is not an .svo, .svdag or .svscene file (meshes go through svo-voxelize first)", name);
}

svo_result cli_scene_open(cli *c, const char *name, const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_scene_loss *loss, cli_scene *out, svo_error *err)
{
    memset(out, 0, sizeof *out);
    svo_result r = open_kind(c, name, data, size, a, loss, out, err);
    if (r != SVO_OK) cli_scene_close(out);
    return r;
}

void cli_scene_close(cli_scene *s)
{
    fmt_scene_close(&s->file);
    fmt_svdag_close(&s->dag);
    svo_packed_free(s->packed);
    memset(s, 0, sizeof *s);
}
