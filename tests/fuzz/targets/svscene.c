/* .svscene: opened, its assets walked, its hierarchy built and traced. */
#include <string.h>

#include "view_use.h"
#include "fmt_scene.h"
#include "rules_agree.h"
#include "svo_bvh.h"

static svo_result trace(const svo_scene *s, const svo_allocator *a, svo_error *err)
{
    svo_bvh *bvh;
    svo_bvh_report report;
    SVO_TRY(svo_bvh_build(s, 1, a, NULL, &bvh, &report, err));
    double low[3], high[3];
    if (svo_bvh_bounds(bvh, low, high)) {
        for (int i = 0; i < 16; i++) {
            svo_scene_ray ray = {.t_max = 1e30, .spread = i % 2 != 0 ? 0.01 : 0};
            svo_scene_hit hit;
            for (int k = 0; k < 3; k++) {
                double at = (i >> k & 1) != 0 ? low[k] - 1 : high[k] + 1;
                ((double *)&ray.origin)[k] = at;
                ((double *)&ray.direction)[k] = low[k] / 2 + high[k] / 2 - at;
            }
            svo_scene_trace(bvh, &ray, 1, &hit);
            if (svo_scene_blocked(bvh, &ray) != hit.node.hit) fuzz_fail("ray %d: hit and blocked differ", i);
            if (hit.node.hit) view_value(svo_bvh_view(bvh, hit.item), hit.node.attribute);
        }
    }
    svo_bvh_free(bvh);
    return SVO_OK;
}

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_scene f;
    svo_result r = fmt_scene_open(bytes, size, a, &f, err);
    const char *differ = rules_agree(fmt_scene_violations, bytes, size, a, r, err, false);
    if (differ != NULL) fuzz_fail("%s", differ);
    if (r != SVO_OK) return r;
    const svo_scene *s = &f.scene;
    for (uint32_t i = 0; i < s->asset_count; i++) view_check(s->assets[i]);
    for (uint64_t i = 0; i < s->instance_count; i++)
        if (s->instance_asset[i] >= s->asset_count || strlen(svo_scene_instance_name(s, i)) >= s->names_size) fuzz_fail("instance %llu", (unsigned long long)i);
    r = trace(s, a, err);
    fmt_scene_close(&f);
    return r;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20};
