/* The META chunk: JSON text about how a file was made. */
#include <jansson.h>
#include <string.h>

#include "fmt_container.h"

/* A JSON object in UTF-8, nothing after it. */
static bool is_json_object(const char *text, size_t size, char *why, size_t why_size)
{
    json_error_t e;
    json_t *j = json_loadb(text, size, JSON_REJECT_DUPLICATES, &e);
    bool ok = json_is_object(j);
    if (!ok) {
        size_t n = strnlen(j == NULL ? e.text : "not an object", why_size - 1);
        memcpy(why, j == NULL ? e.text : "not an object", n);
        why[n] = 0;
    }
    json_decref(j);
    return ok;
}

svo_result fmt_writer_meta(fmt_writer *w, const char *json, svo_error *err)
{
    if (json == NULL || json[0] == 0) return SVO_OK;
    char why[100];
    size_t size = strlen(json);
    if (size > FMT_META_MAX || !is_json_object(json, size, why, sizeof why))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "the provenance is not a JSON object of at most 16 MiB");
    fmt_chunk c = {.type = FMT_TYPE_META, .stored_size = size, .decoded_size = size};
    return fmt_writer_chunk(w, &c, json, err);
}

svo_result fmt_meta_text(const fmt_chunk *chunk, const uint8_t *bytes, uint64_t size, const svo_allocator *a, char **text, svo_error *err)
{
    uint64_t at = chunk->offset - 64;
    char why[100];
    if (chunk->codec != FMT_CODEC_NONE || (chunk->flags & FMT_CHUNK_CRITICAL) != 0)
        return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "it must be optional and not compressed (CON-12)");
    if (size > FMT_META_MAX) return fmt_chunk_fail(err, SVO_INVALID_DATA, chunk->type, at, "longer than 16 MiB (CON-12)");
    if (size == 0 || memchr(bytes, 0, (size_t)size) != NULL || !is_json_object((const char *)bytes, (size_t)size, why, sizeof why))
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
