#include "svo_quantize.h"

#include <string.h>

svo_result svo_quantize(svo_channel_kind kind, const uint32_t *values, const uint64_t *times, uint64_t count,
                        const svo_dag_options *options, uint32_t *mapped, svo_quantize_result *result, svo_error *err)
{
    (void)times;
    memcpy(mapped, values, (size_t)count * sizeof *mapped);
    *result = (svo_quantize_result){0};
    bool color = kind == SVO_KIND_COLOR_SRGB8 && (options->color_bits != 0 || options->color_delta_e > 0);
    bool normal = kind == SVO_KIND_NORMAL_OCT32 && (options->normal_bits != 0 || options->normal_degrees > 0);
    if (color || normal) return svo_fail(err, SVO_UNSUPPORTED, "lossy attributes are not built in");
    return SVO_OK;
}
