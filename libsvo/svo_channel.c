#include "svoi_channel.h"

#include <math.h>
#include <string.h>

uint32_t svo_channel_stride(uint32_t kind)
{
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: return 3;
    case SVO_KIND_NORMAL_OCT32: return 4;
    case SVO_KIND_UNORM8: return 1;
    case SVO_KIND_ID16: return 2;
    case SVO_KIND_ID32: return 4;
    }
    return 0;
}

/* The 256 decoded values and the 255 thresholds between neighbours (midpoints in sRGB space, in linear light), so
 * that encoding needs no transcendental function and is the same on every machine. Generated from the definition:
 * c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055)^2.4, rounded to float. */
#include "svo_srgb_table.inc"
#include "svo_srgb_step.inc"

float svo_srgb_to_linear(uint8_t v) { return svoi_srgb_linear[v]; }

/* The bits of what is encoded: between the first threshold and the last. */
static inline uint32_t srgb_bits(float v)
{
    const float least = 0x1p-13f, most = 0x1.fffffep-1f; /* below the first threshold; above the last */
    v = v >= least ? v : least; /* NaN too */
    v = v < most ? v : most;
    uint32_t bits;
    memcpy(&bits, &v, sizeof bits);
    return bits;
}

/* The number of thresholds that are not above. Without branches: colours are all over the place. */
static inline uint8_t encode_srgb(uint32_t bits)
{
    const uint32_t step = svoi_srgb_step[(bits >> 16) - 0x3900];
    return (uint8_t)((step >> 17) + ((bits & 0xffff) >= (step & 0x1ffff)));
}

const uint32_t *svoi_srgb_steps(void) { return svoi_srgb_step; }

uint8_t svo_linear_to_srgb(float v) { return encode_srgb(srgb_bits(v)); }

void svoi_linear_to_srgb(const float *v, uint64_t count, uint8_t *out)
{
    enum { AT_A_TIME = 64 };
    uint32_t bits[AT_A_TIME]; /* the first loop becomes vector code, the other one cannot */
    for (uint64_t done = 0; done < count; done += AT_A_TIME) {
        const uint64_t n = count - done < AT_A_TIME ? count - done : AT_A_TIME;
        for (uint64_t i = 0; i < n; i++) bits[i] = srgb_bits(v[done + i]);
        for (uint64_t i = 0; i < n; i++) out[done + i] = encode_srgb(bits[i]);
    }
}

static int16_t load16(const uint8_t *p) { return (int16_t)(uint16_t)(p[0] | p[1] << 8); }

static void oct_decode(int x, int y, double n[3])
{
    double u = x / 32767.0, v = y / 32767.0;
    if (u < -1) u = -1;
    if (v < -1) v = -1;
    double z = 1 - fabs(u) - fabs(v);
    if (z < 0) {
        double a = (1 - fabs(v)) * (u < 0 ? -1 : 1), b = (1 - fabs(u)) * (v < 0 ? -1 : 1);
        u = a, v = b;
    }
    double k = 1 / sqrt(u * u + v * v + z * z);
    n[0] = u * k, n[1] = v * k, n[2] = z * k;
}

void svo_oct32_decode(const uint8_t in[4], float n[3])
{
    double d[3];
    oct_decode(load16(in), load16(in + 2), d);
    for (int i = 0; i < 3; i++) n[i] = (float)d[i];
}

/* Rounded down, of what an int32_t can hold: no call to a library where the machine has no instruction for it. */
static inline double below(double x)
{
    const double whole = (double)(int32_t)x;
    return whole - (double)(whole > x);
}

void svo_oct32_encode(const float n[3], uint8_t out[4])
{
    double x = n[0], y = n[1], z = n[2];
    double l1 = fabs(x) + fabs(y) + fabs(z);
    int best_u = 0, best_v = 0;
    if (l1 > 0 && isfinite(l1)) {
        double u = x / l1, v = y / l1;
        if (z < 0) {
            double a = (1 - fabs(v)) * (u < 0 ? -1 : 1), b = (1 - fabs(u)) * (v < 0 ? -1 : 1);
            u = a, v = b;
        }
        double fu = below(u * 32767), fv = below(v * 32767);
        fu = fu < 32766 ? fu : 32766, fv = fv < 32766 ? fv : 32766;
        /* Squared cosine of each of the four, whose vectors are 32767 times as long before they are made unit vectors. No branches: their
         * outcomes would be random. */
        double score[4];
        for (int i = 0; i < 4; i++) {
            double cu = fu + (i & 1), cv = fv + (i >> 1), au = fabs(cu), av = fabs(cv), c = 32767 - au - av;
            double su = copysign(32767 - av, cu), sv = copysign(32767 - au, cv);
            double a = c < 0 ? su : cu, b = c < 0 ? sv : cv, dot = a * x + b * y + c * z;
            score[i] = dot * dot / (a * a + b * b + c * c);
        }
        int best = 0;
        for (int i = 1; i < 4; i++) best = score[i] > score[best] ? i : best;
        best_u = (int)fu + (best & 1);
        best_v = (int)fv + (best >> 1);
    }
    uint16_t a = (uint16_t)(int16_t)best_u, b = (uint16_t)(int16_t)best_v;
    out[0] = (uint8_t)a, out[1] = (uint8_t)(a >> 8), out[2] = (uint8_t)b, out[3] = (uint8_t)(b >> 8);
}

static uint64_t load_id(svo_channel_kind kind, const uint8_t *v)
{
    uint64_t id = (uint64_t)v[0] | (uint64_t)v[1] << 8;
    if (kind == SVO_KIND_ID32) id |= (uint64_t)v[2] << 16 | (uint64_t)v[3] << 24;
    return id;
}

void svo_average_add(svo_average *a, svo_channel_kind kind, const uint8_t *value, double weight)
{
    if (!(weight > 0)) return;
    a->weight += weight;
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8:
        for (int i = 0; i < 3; i++) a->sum[i] += weight * svo_srgb_to_linear(value[i]);
        break;
    case SVO_KIND_NORMAL_OCT32: {
        double n[3];
        oct_decode(load16(value), load16(value + 2), n);
        for (int i = 0; i < 3; i++) a->sum[i] += weight * n[i];
        break;
    }
    case SVO_KIND_UNORM8: a->sum[0] += weight * value[0]; break;
    case SVO_KIND_ID16:
    case SVO_KIND_ID32: {
        uint64_t id = load_id(kind, value);
        int slot = -1, lightest = 0;
        for (int i = 0; i < 8; i++) {
            if (a->id_weight[i] > 0 && a->id[i] == id) slot = i;
            if (a->id_weight[i] < a->id_weight[lightest]) lightest = i;
        }
        if (slot < 0) {
            slot = lightest;
            a->id[slot] = id;
            a->id_weight[slot] = 0;
        }
        a->id_weight[slot] += weight;
        break;
    }
    }
}

void svo_average_get(const svo_average *a, svo_channel_kind kind, const uint8_t *fallback, uint8_t *out)
{
    uint32_t stride = svo_channel_stride(kind);
    memmove(out, fallback, stride);
    if (!(a->weight > 0)) return;
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8:
        for (int i = 0; i < 3; i++) out[i] = svo_linear_to_srgb((float)(a->sum[i] / a->weight));
        break;
    case SVO_KIND_NORMAL_OCT32: {
        double l = sqrt(a->sum[0] * a->sum[0] + a->sum[1] * a->sum[1] + a->sum[2] * a->sum[2]);
        if (!(l > 1e-6 * a->weight)) return;
        float n[3] = {(float)(a->sum[0] / l), (float)(a->sum[1] / l), (float)(a->sum[2] / l)};
        svo_oct32_encode(n, out);
        break;
    }
    case SVO_KIND_UNORM8: out[0] = (uint8_t)(a->sum[0] / a->weight + 0.5); break;
    case SVO_KIND_ID16:
    case SVO_KIND_ID32: {
        int best = 0;
        for (int i = 1; i < 8; i++)
            if (a->id_weight[i] > a->id_weight[best] ||
                (a->id_weight[i] == a->id_weight[best] && a->id_weight[i] > 0 && a->id[i] < a->id[best]))
                best = i;
        for (uint32_t i = 0; i < stride; i++) out[i] = (uint8_t)(a->id[best] >> 8 * i);
        break;
    }
    }
}
