/* zstd payloads, with contexts that are kept for the next call: making one costs more than coding a small chunk. */
#include <pthread.h>
#include <string.h>
#include <zstd.h>

#include "fmt_container.h"

enum { KEPT = 64 };

struct fmt_zstd_pool {
    pthread_mutex_t lock;
    ZSTD_CCtx *encoders[KEPT];
    ZSTD_DCtx *decoders[KEPT];
    uint32_t encoder_count, decoder_count;
};

svo_result fmt_zstd_pool_new(fmt_zstd_pool **out, svo_error *err)
{
    fmt_zstd_pool *p = svo_calloc(NULL, 1, sizeof *p);
    if (p == NULL || pthread_mutex_init(&p->lock, NULL) != 0) {
        svo_free(NULL, p, 1, sizeof *p);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the codec");
    }
    *out = p;
    return SVO_OK;
}

void fmt_zstd_pool_free(fmt_zstd_pool *p)
{
    if (p == NULL) return;
    for (uint32_t i = 0; i < p->encoder_count; i++) ZSTD_freeCCtx(p->encoders[i]);
    for (uint32_t i = 0; i < p->decoder_count; i++) ZSTD_freeDCtx(p->decoders[i]);
    pthread_mutex_destroy(&p->lock);
    svo_free(NULL, p, 1, sizeof *p);
}

static ZSTD_CCtx *take_encoder(fmt_zstd_pool *p)
{
    ZSTD_CCtx *c = NULL;
    if (p != NULL) {
        pthread_mutex_lock(&p->lock);
        if (p->encoder_count != 0) c = p->encoders[--p->encoder_count];
        pthread_mutex_unlock(&p->lock);
    }
    return c != NULL ? c : ZSTD_createCCtx();
}

static void give_encoder(fmt_zstd_pool *p, ZSTD_CCtx *c)
{
    if (p != NULL) {
        pthread_mutex_lock(&p->lock);
        if (p->encoder_count < KEPT) p->encoders[p->encoder_count++] = c, c = NULL;
        pthread_mutex_unlock(&p->lock);
    }
    ZSTD_freeCCtx(c);
}

static ZSTD_DCtx *take_decoder(fmt_zstd_pool *p)
{
    ZSTD_DCtx *c = NULL;
    if (p != NULL) {
        pthread_mutex_lock(&p->lock);
        if (p->decoder_count != 0) c = p->decoders[--p->decoder_count];
        pthread_mutex_unlock(&p->lock);
    }
    return c != NULL ? c : ZSTD_createDCtx();
}

static void give_decoder(fmt_zstd_pool *p, ZSTD_DCtx *c)
{
    if (p != NULL) {
        pthread_mutex_lock(&p->lock);
        if (p->decoder_count < KEPT) p->decoders[p->decoder_count++] = c, c = NULL;
        pthread_mutex_unlock(&p->lock);
    }
    ZSTD_freeDCtx(c);
}

svo_result fmt_zstd_encode(fmt_zstd_pool *p, const void *bytes, size_t size, int level, svo_buffer *to, svo_error *err)
{
    to->size = 0;
    if (!svo_buffer_reserve(to, ZSTD_compressBound(size))) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to compress %zu bytes", size);
    ZSTD_CCtx *c = take_encoder(p);
    if (c == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a zstd context");
    size_t n = ZSTD_compressCCtx(c, to->data, to->capacity, bytes, size, level);
    give_encoder(p, c);
    if (ZSTD_isError(n)) return svo_fail(err, SVO_RUNTIME, "zstd cannot compress %zu bytes: %s", size, ZSTD_getErrorName(n));
    to->size = n;
    return SVO_OK;
}

size_t fmt_zstd_encode_to(fmt_zstd_pool *p, const void *bytes, size_t size, int level, void *to, size_t capacity)
{
    ZSTD_CCtx *c = take_encoder(p);
    if (c == NULL) return 0;
    size_t n = ZSTD_compressCCtx(c, to, capacity, bytes, size, level);
    give_encoder(p, c);
    return ZSTD_isError(n) ? 0 : n;
}

/* Is it one frame of decoded_size bytes? Before memory is taken for them. */
static svo_result check_frame(const uint8_t *b, size_t stored_size, uint64_t decoded_size, svo_error *err)
{
    /* A block of a frame takes at least 4 bytes and gives at most 128 KiB. */
    if (decoded_size / ((128u << 10) / 4) > stored_size)
        return svo_fail(err, SVO_INVALID_DATA, "%zu bytes cannot decode to %llu (CON-10)", stored_size, (unsigned long long)decoded_size);
    if (stored_size < 5 || fmt_load32(b) != ZSTD_MAGICNUMBER || ZSTD_findFrameCompressedSize(b, stored_size) != stored_size)
        return svo_fail(err, SVO_INVALID_DATA, "the payload is not one zstd frame (CON-10)");
    if (ZSTD_getFrameContentSize(b, stored_size) != decoded_size)
        return svo_fail(err, SVO_INVALID_DATA, "the zstd frame does not hold the %llu bytes it should (CON-10)", (unsigned long long)decoded_size);
    return SVO_OK;
}

svo_result fmt_zstd_decode_to(fmt_zstd_pool *p, const void *stored, size_t stored_size, void *to, uint64_t decoded_size, svo_error *err)
{
    SVO_TRY(check_frame(stored, stored_size, decoded_size, err));
    ZSTD_DCtx *c = take_decoder(p);
    if (c == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a zstd context");
    size_t n = ZSTD_decompressDCtx(c, to, (size_t)decoded_size, stored, stored_size);
    give_decoder(p, c);
    if (ZSTD_isError(n)) return svo_fail(err, SVO_INVALID_DATA, "zstd cannot decode the payload: %s (CON-10)", ZSTD_getErrorName(n));
    if (n != decoded_size) return svo_fail(err, SVO_INVALID_DATA, "zstd decodes %zu bytes instead of %llu (CON-10)", n, (unsigned long long)decoded_size);
    return SVO_OK;
}

svo_result fmt_zstd_decode(fmt_zstd_pool *p, const void *stored, size_t stored_size, uint64_t decoded_size, svo_buffer *to, svo_error *err)
{
    SVO_TRY(check_frame(stored, stored_size, decoded_size, err));
    to->size = 0;
    if (!svo_buffer_reserve(to, (size_t)decoded_size + 1)) /* + 1: never a NULL pointer */
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %llu decoded bytes", (unsigned long long)decoded_size);
    SVO_TRY(fmt_zstd_decode_to(p, stored, stored_size, to->data, decoded_size, err));
    to->size = (size_t)decoded_size;
    return SVO_OK;
}
