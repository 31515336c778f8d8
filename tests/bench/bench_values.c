/* Packed values of a .svo file against zstd on byte planes:  bench_values FILE.svo...
 * For each channel bytes a value and MB a second of a thread (raw bytes), packing and unpacking. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmt_svo.h"
#include "fmti_svo_values.h"

static svo_error err;

static double cpu_seconds(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

static void demand(bool ok)
{
    if (ok) return;
    fprintf(stderr, "bench_values: %s\n", err.message);
    exit(1);
}

typedef struct sums { double raw, packed, zipped, seconds[4]; } sums;

static void planes_of(const uint8_t *values, uint64_t count, uint32_t stride, uint8_t *planes)
{
    for (uint32_t b = 0; b < stride; b++)
        for (uint64_t i = 0; i < count; i++) planes[b * count + i] = values[i * stride + b];
}

static void measure(const svo_channel *channel, const uint8_t *values, uint64_t count, fmt_zstd_pool *pool, sums *s)
{
    const uint32_t stride = svo_channel_stride(channel->kind);
    const size_t size = (size_t)(count * stride);
    static svo_buffer packed, zipped;
    uint8_t *planes = malloc(size), *back = malloc(size);
    double at = cpu_seconds(), then;
    packed.size = 0;
    demand(fmti_values_encode(channel->kind, values, count, NULL, &packed, &err) == SVO_OK);
    then = cpu_seconds(), s->seconds[0] += then - at, at = then;
    const uint8_t *p = packed.data;
    demand(fmti_values_decode(channel->kind, &p, packed.data + packed.size, count, NULL, back, &err) == SVO_OK && memcmp(back, values, size) == 0);
    then = cpu_seconds(), s->seconds[1] += then - at, at = then;
    planes_of(values, count, stride, planes);
    demand(fmt_zstd_encode(pool, planes, size, 3, &zipped, &err) == SVO_OK);
    then = cpu_seconds(), s->seconds[2] += then - at, at = then;
    demand(fmt_zstd_decode_to(pool, zipped.data, zipped.size, planes, size, &err) == SVO_OK);
    s->seconds[3] += cpu_seconds() - at;
    s->raw += (double)size, s->packed += (double)packed.size, s->zipped += (double)zipped.size;
    free(planes);
    free(back);
}

static void bench(const char *path)
{
    fmt_input *in = NULL;
    fmt_svo_reader *r = NULL;
    fmt_zstd_pool *pool = NULL;
    svo_buffer packed, storage;
    svo_chunk chunk;
    sums s[SVO_MAX_CHANNELS] = {0};
    svo_buffer_init(&packed, NULL);
    svo_buffer_init(&storage, NULL);
    demand(fmt_input_open(path, &in, &err) == SVO_OK && fmt_svo_reader_open(in, NULL, &r, &err) == SVO_OK && fmt_zstd_pool_new(&pool, &err) == SVO_OK);
    const svo_tree_info *info = fmt_svo_reader_info(r);
    svo_chunk_source source = fmt_svo_reader_source(r);
    for (bool more = true;;) {
        demand(source.fetch(source.user, &packed, &more, &err) == SVO_OK);
        if (!more) break;
        demand(source.decode(source.user, &packed, &storage, &chunk, &err) == SVO_OK);
        for (uint32_t c = 0; c < info->channel_count; c++)
            if (!info->channels[c].constant) measure(&info->channels[c], chunk.channels[c], chunk.value_count, pool, &s[c]);
    }
    for (uint32_t c = 0; c < info->channel_count; c++) {
        if (info->channels[c].constant || s[c].raw == 0) continue;
        const double values = s[c].raw / svo_channel_stride(info->channels[c].kind);
        printf("%s %s: packed %.3f bytes, %.0f and %.0f MB/s; zstd 3 %.3f bytes, %.0f and %.0f MB/s\n", path, info->channels[c].name, s[c].packed / values,
               s[c].raw / s[c].seconds[0] / 1e6, s[c].raw / s[c].seconds[1] / 1e6, s[c].zipped / values, s[c].raw / s[c].seconds[2] / 1e6,
               s[c].raw / s[c].seconds[3] / 1e6);
    }
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    fmt_zstd_pool_free(pool);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
}

int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++) bench(argv[i]);
    return 0;
}
