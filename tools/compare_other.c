/* Scenes and skeletons: both must be valid; then their chunks are compared. */
#include <string.h>

#include "compare.h"
#include "fmt_scene.h"

/* Prove that the file is sound, as any other tool would before using it. */
static svo_result validate(compare_job *j, const compare_input *in, svo_error *err)
{
    if (in->kind == FMT_KIND_SCENE) {
        fmt_scene scene;
        SVO_TRY(fmt_scene_open(in->bytes.data, in->bytes.size, j->allocator, &scene, err));
        fmt_scene_close(&scene);
        return SVO_OK;
    }
    return svo_fail(err, SVO_UNSUPPORTED, "files of this kind cannot be compared");
}

static json_t *chunk_json(const fmt_chunk *chunk, const char *state)
{
    char type[5];
    fmt_fourcc_text(chunk->type, type);
    json_t *o = json_object();
    cli_put_text(o, "type", type);
    cli_put_u64(o, "id", chunk->id);
    cli_put_text(o, "state", state);
    return o;
}

enum { MOST_LISTED = 100 };

/* Chunks that only one has, or whose bytes differ. META says how a file was made and does not count. */
static void compare_chunks(compare_job *j, const fmt_container *a, const fmt_container *b)
{
    json_t *list = json_array();
    uint64_t different = 0;
    for (int pass = 0; pass < 2; pass++) {
        const fmt_container *from = pass == 0 ? a : b, *other = pass == 0 ? b : a;
        for (uint32_t i = 0; i < from->chunk_count; i++) {
            const fmt_chunk *chunk = &from->chunks[i];
            if (chunk->type == FMT_FOURCC('M', 'E', 'T', 'A')) continue;
            /* files of one writer have the same chunks in the same order, so the other's is most often at i */
            const fmt_chunk *twin = i < other->chunk_count ? &other->chunks[i] : NULL;
            if (twin == NULL || twin->type != chunk->type || twin->id != chunk->id)
                twin = fmt_container_find(other, chunk->type, false, chunk->id);
            const char *state = twin == NULL ? (pass == 0 ? "only in A" : "only in B") : "different";
            if (twin != NULL && (pass == 1 || (twin->hash == chunk->hash && twin->stored_size == chunk->stored_size))) continue;
            if (different++ < MOST_LISTED) json_array_append_new(list, chunk_json(chunk, state));
        }
    }
    if (different == 0 && memcmp(a->content_hash, b->content_hash, sizeof a->content_hash) != 0) different = 1; /* another order */
    json_object_set_new(j->json, "identical", json_boolean(different == 0));
    json_object_set_new(j->json, "chunks", list);
    cli_put_u64(j->json, "different_chunks", different);
    if (different > 0) compare_reason(j, "%llu chunks differ", (unsigned long long)different);
}

svo_result compare_containers(compare_job *j, svo_error *err)
{
    fmt_container c[2];
    memset(c, 0, sizeof c);
    svo_result r = SVO_OK;
    for (int i = 0; i < 2 && r == SVO_OK; i++) {
        compare_input *in = &j->in[i];
        r = compare_load(in, j->c, j->allocator, err);
        if (r == SVO_OK) r = fmt_container_open(in->bytes.data, in->bytes.size, j->allocator, &c[i], err);
        if (r == SVO_OK) r = validate(j, in, err);
        if (r != SVO_OK && err != NULL && strstr(err->message, in->path) == NULL) {
            svo_error inner = *err;
            svo_fail(err, r, "%s: %s", in->path, inner.message);
            err->chunk = inner.chunk, err->offset = inner.offset, err->index = inner.index;
        }
    }
    if (r == SVO_OK) compare_chunks(j, &c[0], &c[1]);
    for (int i = 0; i < 2; i++) fmt_container_close(&c[i]);
    return r;
}
