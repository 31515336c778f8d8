#include "svo_quantize.h"

#include <math.h>
#include <string.h>

#include "svo_color.h"
#include "svo_task.h"
#include "svoi_quantize.h"

typedef struct job {
    const uint32_t *values;
    const uint64_t *times;
    uint64_t count;
    float (*lab)[3];
    uint32_t *mapped;
    double *error; /* of each value */
    uint32_t bits;
    double bound; /* stop early when an error is above it */
    uint32_t over; /* atomic: some error is above the bound */
} job;

/* --- normals --- */

static void decode(uint32_t value, double n[3])
{
    uint8_t bytes[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};
    float f[3];
    svo_oct32_decode(bytes, f);
    for (int i = 0; i < 3; i++) n[i] = f[i];
}

double svo_normal_degrees(uint32_t a, uint32_t b)
{
    double x[3], y[3];
    decode(a, x);
    decode(b, y);
    double c[3] = {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]};
    double dot = x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    return atan2(sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]), dot) * (180 / 3.14159265358979323846);
}

/* Grid coordinate -m..m as a snorm16. */
static uint32_t grid_code(int32_t q, int32_t m)
{
    int32_t v = (2 * q * 32767 + (q < 0 ? -m : m)) / (2 * m); /* to nearest, away from 0 */
    return (uint16_t)(int16_t)v;
}

uint32_t svo_quantize_normal(uint32_t value, uint32_t bits)
{
    int32_t m = (1 << (bits / 2 - 1)) - 1;
    if (m >= 32767) return value;
    double n[3], best = INFINITY;
    decode(value, n);
    double u = (int16_t)(uint16_t)value / 32767.0 * m, v = (int16_t)(uint16_t)(value >> 16) / 32767.0 * m;
    int32_t fu = (int32_t)floor(u), fv = (int32_t)floor(v);
    uint32_t out = 0;
    for (int i = 0; i < 4; i++) {
        int32_t cu = fu + (i & 1), cv = fv + (i >> 1);
        if (cu < -m || cu > m || cv < -m || cv > m) continue;
        uint32_t code = grid_code(cu, m) | grid_code(cv, m) << 16;
        double d[3], chord = 0; /* not the dot product, which cannot tell small angles apart in floats */
        decode(code, d);
        for (int k = 0; k < 3; k++) chord += (d[k] - n[k]) * (d[k] - n[k]);
        if (chord < best) best = chord, out = code;
    }
    return out;
}

static svo_result map_normals(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    job *j = user;
    for (uint64_t i = begin; i < end; i++) {
        j->mapped[i] = svo_quantize_normal(j->values[i], j->bits);
        j->error[i] = j->mapped[i] == j->values[i] ? 0 : svo_normal_degrees(j->values[i], j->mapped[i]);
        if (j->error[i] > j->bound) {
            __atomic_store_n(&j->over, 1, __ATOMIC_RELAXED);
            return SVO_OK;
        }
        if (i % 256 == 0 && __atomic_load_n(&j->over, __ATOMIC_RELAXED)) return SVO_OK;
    }
    return SVO_OK;
}

static svo_result take_errors(job *j, const svo_allocator *a, svo_error *err)
{
    j->error = svo_calloc(a, j->count, sizeof *j->error);
    return j->error != NULL ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (quantisation)");
}

static svo_result quantize_normals(job *j, const svo_dag_options *o, const svo_allocator *a, svo_error *err)
{
    SVO_TRY(take_errors(j, a, err));
    j->bound = o->normal_degrees > 0 ? o->normal_degrees : INFINITY;
    /* With a bound: the fewest bits whose measured largest error keeps it; 32 bits are exact. */
    for (j->bits = o->normal_bits != 0 ? o->normal_bits : 4;; j->bits += 2) {
        j->over = 0;
        SVO_TRY(svo_parallel_for(o->threads, j->count, 4096, map_normals, j, err));
        if (!j->over || j->bits == 32) return SVO_OK;
    }
}

/* --- colours --- */

static svo_result to_lab(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    job *j = user;
    for (uint64_t i = begin; i < end; i++) {
        uint8_t rgb[3];
        svoi_rgb_bytes(j->values[i], rgb);
        svo_srgb8_to_lab(rgb, j->lab[i]);
    }
    return SVO_OK;
}

static svo_result color_errors(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    job *j = user;
    for (uint64_t i = begin; i < end; i++) {
        uint8_t rgb[3];
        float lab[3];
        svoi_rgb_bytes(j->mapped[i], rgb);
        svo_srgb8_to_lab(rgb, lab);
        j->error[i] = j->mapped[i] == j->values[i] ? 0 : svo_delta_e94(j->lab[i], lab);
    }
    return SVO_OK;
}

static svo_result quantize_colors(job *j, const svo_dag_options *o, const svo_allocator *a, svo_error *err)
{
    j->lab = svo_alloc(a, j->count, sizeof *j->lab);
    if (j->lab == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (colours)");
    svoi_colors c = {a, o->threads, j->values, j->times, j->lab, j->count};
    svo_result r = svo_parallel_for(o->threads, j->count, 4096, to_lab, j, err);
    if (r == SVO_OK)
        r = o->color_bits != 0 ? svoi_cluster_colors(&c, 1u << o->color_bits, j->mapped, err)
                               : svoi_cover_colors(&c, o->color_delta_e, j->mapped, err);
    if (r == SVO_OK) r = take_errors(j, a, err);
    if (r == SVO_OK) r = svo_parallel_for(o->threads, j->count, 4096, color_errors, j, err);
    svo_free(a, j->lab, j->count, sizeof *j->lab);
    return r;
}

svo_result svo_quantize(svo_channel_kind kind, const uint32_t *values, const uint64_t *times, uint64_t count,
                        const svo_dag_options *options, const svo_allocator *a, uint32_t *mapped, svo_quantize_result *result,
                        svo_error *err)
{
    svo_quantize_result q = {0};
    if (count != 0) memcpy(mapped, values, (size_t)count * sizeof *mapped);
    bool color = kind == SVO_KIND_COLOR_SRGB8 && (options->color_bits != 0 || options->color_delta_e > 0);
    bool normal = kind == SVO_KIND_NORMAL_OCT32 && (options->normal_bits != 0 || options->normal_degrees > 0);
    if (count == 0 || (!color && !normal)) {
        *result = q;
        return SVO_OK;
    }
    job j = {.values = values, .times = times, .count = count, .mapped = mapped};
    svo_result r = color ? quantize_colors(&j, options, a, err) : quantize_normals(&j, options, a, err);
    double sum = 0, weight = 0;
    for (uint64_t i = 0; i < count && r == SVO_OK; i++) {
        sum += j.error[i] * (double)times[i];
        weight += (double)times[i];
        if (j.error[i] > q.error_max) q.error_max = j.error[i];
        if (mapped[i] != values[i]) q.lossy = true;
    }
    svo_free(a, j.error, count, sizeof *j.error);
    if (r != SVO_OK) return r;
    q.error_mean = sum / weight;
    *result = q;
    return SVO_OK;
}
