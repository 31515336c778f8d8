/* Values of hits: neighbouring rays meet the same voxels, so each node is looked up once for as long as it is remembered, and
 * lookups go many at a time. */
#include "svo_rays.h"

#include <string.h>

enum { BATCH = 256, KNOWN_BITS = 6 };

/* Distinct numbers of a batch, nearly: those that come again within the last few. */
typedef struct lookup {
    uint64_t number[BATCH + 1]; /* of each hit; one more: what is written before it is known to be needed */
    uint64_t index[BATCH + 1];
    uint32_t value[BATCH];
    uint32_t count, hits;
    uint16_t of[BATCH + 1], hit[BATCH + 1]; /* of each hit: which of them; its place in the batch */
} lookup;

/* Without branches: whether a ray hits, and whether its neighbour hit the same, can hardly be predicted. */
static void distinct(const svo_hit *hits, uint32_t count, lookup *l)
{
    uint16_t known[1 << KNOWN_BITS];
    memset(known, 0, sizeof known);
    l->count = l->hits = 0;
    l->index[0] = ~(uint64_t)0;
    for (uint32_t i = 0; i < count; i++) {
        l->hit[l->hits] = (uint16_t)i;
        l->number[l->hits] = hits[i].attribute;
        l->hits += hits[i].hit;
    }
    for (uint32_t i = 0; i < l->hits; i++) {
        const uint64_t index = l->number[i];
        const uint32_t slot = (uint32_t)(index * 0x9e3779b97f4a7c15u >> (64 - KNOWN_BITS));
        const bool new = l->index[known[slot]] != index;
        const uint16_t at = new ? (uint16_t)l->count : known[slot];
        l->index[l->count] = new ? index : 0;
        l->count += new;
        known[slot] = l->of[i] = at;
    }
}

static void read_values(const svo_view *v, uint32_t channel, lookup *l)
{
    const svo_view_channel *c = &v->channels[channel];
    const uint32_t stride = svo_channel_stride(c->channel.kind);
    uint64_t any = 0;
    for (uint32_t i = 0; i < l->count; i++) any |= l->index[i];
    if (c->encoding == SVO_ENCODING_BLOCKS && any >> SVO_AVERAGE_SHIFT == 0) {
        svo_palette p = svo_view_palette(v, channel);
        svo_palette_values(&p, l->index, l->count, l->value);
        return;
    }
    if (c->encoding == SVO_ENCODING_RAW)
        for (uint32_t i = 0; i < l->count; i++) __builtin_prefetch(c->raw + svo_average_first(l->index[i]) * stride);
    for (uint32_t i = 0; i < l->count; i++) {
        uint8_t value[SVO_MAX_STRIDE];
        svo_view_attribute(v, channel, l->index[i], value);
        memcpy(&l->value[i], value, stride);
    }
}

/* Of a channel that has one value. */
static void put_constant(const uint8_t *value, uint32_t stride, const svo_hit *hits, uint64_t count, uint8_t *out)
{
    static const uint8_t none[SVO_MAX_STRIDE];
    for (uint64_t i = 0; i < count; i++, out += stride) {
        const uint8_t *from = hits[i].hit ? value : none;
        for (uint32_t k = 0; k < stride; k++) out[k] = from[k];
    }
}

/* Values to their places. (A copy of a length that the compiler does not know is a call.) */
static void put_values(const lookup *l, uint32_t stride, uint8_t *out)
{
    switch (stride) {
    case 4:
        for (uint32_t i = 0; i < l->hits; i++) memcpy(out + 4u * l->hit[i], &l->value[l->of[i]], 4);
        break;
    case 3:
        for (uint32_t i = 0; i < l->hits; i++) memcpy(out + 3u * l->hit[i], &l->value[l->of[i]], 3);
        break;
    default:
        for (uint32_t i = 0; i < l->hits; i++) memcpy(out + stride * l->hit[i], &l->value[l->of[i]], stride);
    }
}

void svo_rays_values(const svo_view *view, uint32_t channel, const svo_hit *hits, uint64_t count, uint8_t *out)
{
    const uint32_t stride = svo_channel_stride(view->channels[channel].channel.kind);
    lookup l;
    SVO_ASSERT(stride <= sizeof *l.value);
    if (view->channels[channel].encoding == SVO_ENCODING_CONSTANT) {
        put_constant(view->channels[channel].channel.value, stride, hits, count, out);
        return;
    }
    for (uint64_t first = 0; first < count; first += BATCH) {
        uint32_t n = count - first < BATCH ? (uint32_t)(count - first) : BATCH;
        distinct(hits + first, n, &l);
        read_values(view, channel, &l);
        memset(out, 0, (size_t)n * stride);
        put_values(&l, stride, out);
        out += (size_t)n * stride;
    }
}
