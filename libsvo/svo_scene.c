#include "svo_scene.h"

#include <math.h>

svo_mat4 svo_scene_instance_transform(const svo_scene *s, uint32_t page, uint64_t instance)
{
    const float *t = s->instance_transform + 12 * instance;
    svo_mat4 m = svo_mat4_identity();
    for (int i = 0; i < 12; i++) m.m[i] = t[i];
    for (int k = 0; k < 3; k++) m.m[4 * k + 3] += s->pages[page].origin[k];
    return m;
}

bool svo_scene_bounds(const svo_scene *s, double low[3], double high[3])
{
    for (int k = 0; k < 3; k++) low[k] = INFINITY, high[k] = -INFINITY;
    for (uint32_t p = 0; p < s->page_count; p++)
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], s->pages[p].low[k]);
            high[k] = fmax(high[k], s->pages[p].high[k]);
        }
    return s->page_count != 0;
}
