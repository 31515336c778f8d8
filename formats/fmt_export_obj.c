/* A skeleton's curve as Wavefront OBJ: points and lines that any viewer shows. */
#include <stdio.h>
#include <string.h>

#include "fmt_skel.h"

svo_result fmt_export_skel_obj(fmt_output *out, const skel_skeleton *s, svo_error *err)
{
    char line[128];
    int n = snprintf(line, sizeof line, "# curve skeleton: %u joints, %u bones\n", s->joint_count, s->bone_count);
    SVO_TRY(fmt_output_write(out, line, (size_t)n, err));
    for (uint32_t j = 0; j < s->joint_count; j++) {
        const double *p = s->joints[j].position;
        n = snprintf(line, sizeof line, "v %.17g %.17g %.17g\n", p[0], p[1], p[2]);
        SVO_TRY(fmt_output_write(out, line, (size_t)n, err));
    }
    for (uint32_t b = 0; b < s->bone_count; b++) {
        n = snprintf(line, sizeof line, "l %u %u\n", s->bones[b].a + 1, s->bones[b].b + 1);
        SVO_TRY(fmt_output_write(out, line, (size_t)n, err));
    }
    uint8_t *used = svo_calloc(s->allocator, s->joint_count, 1);
    if (used == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the curve");
    for (uint32_t b = 0; b < s->bone_count; b++) used[s->bones[b].a] = used[s->bones[b].b] = 1;
    svo_result result = SVO_OK;
    for (uint32_t j = 0; j < s->joint_count && result == SVO_OK; j++) {
        if (used[j]) continue;
        n = snprintf(line, sizeof line, "p %u\n", j + 1);
        result = fmt_output_write(out, line, (size_t)n, err);
    }
    svo_free(s->allocator, used, s->joint_count, 1);
    return result;
}
