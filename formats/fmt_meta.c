/* The META chunk: JSON text about how a file was made. */
#include <jansson.h>
#include <string.h>

#include "fmt_container.h"
#include "fmt_memory.h"

/* A JSON object in UTF-8, nothing after it: SVO_OK; SVO_INVALID_DATA when it is none, SVO_OUT_OF_MEMORY when that cannot be told. */
static svo_result check_json_object(const char *text, size_t size)
{
    json_error_t e;
    uint64_t failures = fmt_json_failures();
    json_t *j = json_loadb(text, size, JSON_REJECT_DUPLICATES, &e);
    bool ok = json_is_object(j);
    json_decref(j);
    if (fmt_json_failures() != failures) return SVO_OUT_OF_MEMORY;
    return ok ? SVO_OK : SVO_INVALID_DATA;
}

svo_result fmt_writer_meta(fmt_writer *w, const char *json, svo_error *err)
{
    if (json == NULL || json[0] == 0) return SVO_OK;
    size_t size = strlen(json);
    svo_result sound = size > FMT_META_MAX ? SVO_INVALID_DATA : check_json_object(json, size);
    if (sound == SVO_OUT_OF_MEMORY) return svo_fail(err, sound, "no memory to check the provenance");
    if (sound != SVO_OK)
        return svo_fail(err, SVO_INVALID_ARGUMENT, "the provenance is not a JSON object of at most 16 MiB");
    fmt_chunk c = {.type = FMT_TYPE_META, .stored_size = size, .decoded_size = size};
    return fmt_writer_chunk(w, &c, json, err);
}

svo_result fmt_meta_text(const fmt_chunk *chunk, const uint8_t *bytes, uint64_t size, const svo_allocator *a, char **text, svo_error *err)
{
    uint64_t at = chunk->offset - 64;
    if (chunk->codec != FMT_CODEC_NONE || (chunk->flags & FMT_CHUNK_CRITICAL) != 0)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "it must be optional and not compressed (CON-12)");
    if (size > FMT_META_MAX) return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "longer than 16 MiB (CON-12)");
    svo_result sound = size == 0 || memchr(bytes, 0, (size_t)size) != NULL ? SVO_INVALID_DATA : check_json_object((const char *)bytes, (size_t)size);
    if (sound == SVO_OUT_OF_MEMORY) return svo_fail(err, sound, "no memory to check the provenance");
    if (sound != SVO_OK)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "its text is not a JSON object (CON-12)");
    char *copy = svo_alloc(a, size + 1, 1);
    if (copy == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %llu bytes of provenance", (unsigned long long)size);
    memcpy(copy, bytes, (size_t)size);
    copy[size] = 0;
    *text = copy;
    return SVO_OK;
}

svo_result fmt_container_meta(const fmt_container *c, const svo_allocator *a, char **text, svo_error *err)
{
    const fmt_chunk *found = NULL;
    for (uint32_t i = 0; i < c->chunk_count; i++) {
        if (c->chunks[i].type != FMT_TYPE_META) continue;
        if (found != NULL) return fmt_chunk_fail(err, SVO_INVALID_DATA, FMT_TYPE_META, c->chunks[i].offset - 64, "a second META chunk (CON-12)");
        found = &c->chunks[i];
    }
    if (found != NULL) {
        const uint8_t *bytes;
        SVO_TRY(fmt_container_payload(c, found, &bytes, err));
        return fmt_meta_text(found, bytes, found->stored_size, a, text, err);
    }
    char *empty = svo_calloc(a, 1, 1);
    if (empty == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the provenance");
    *text = empty;
    return SVO_OK;
}

void fmt_meta_free(const svo_allocator *a, char *text)
{
    if (text != NULL) svo_free(a, text, strlen(text) + 1, 1);
}
