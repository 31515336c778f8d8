#include <string.h>

#include "svoi_select.h"

static const svo_scene_page *page_of(const svo_scene *s, uint64_t instance)
{
    uint32_t low = 0, count = s->page_count;
    while (count > 1) {
        uint32_t half = count / 2;
        if (s->pages[low + half].first <= instance) low += half;
        count -= half;
    }
    return &s->pages[low];
}

static bool same(const svo_scene *s, uint64_t a, uint64_t b)
{
    return s->instance_asset[a] == s->instance_asset[b] && svo_scene_instance_pose(s, a) == svo_scene_instance_pose(s, b) &&
           memcmp(s->instance_transform + 12 * a, s->instance_transform + 12 * b, 48) == 0 &&
           memcmp(page_of(s, a)->origin, page_of(s, b)->origin, 24) == 0;
}

svo_result svoi_find_copies(const svo_scene *s, const svo_allocator *a, uint8_t **out, svo_error *err)
{
    uint64_t slots = 16;
    while (slots < 2 * s->instance_count) slots *= 2;
    uint64_t *slot = svo_calloc(a, slots, sizeof *slot); /* instance + 1 */
    *out = svo_calloc(a, s->instance_count, 1);
    if (slot == NULL || (*out == NULL && s->instance_count != 0)) {
        svo_free(a, slot, slots, sizeof *slot);
        svo_free(a, *out, s->instance_count, 1);
        *out = NULL;
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the selected voxels");
    }
    for (uint64_t i = 0; i < s->instance_count; i++) {
        uint64_t h = s->instance_asset[i];
        for (int k = 0; k < 12; k++) {
            uint32_t w;
            memcpy(&w, s->instance_transform + 12 * i + (uint64_t)k, 4);
            h = (h ^ w) * 0x9e3779b97f4a7c15u;
            h ^= h >> 29;
        }
        h = (h ^ (s->instance_pose != NULL ? s->instance_pose[i] : 0)) * 0x9e3779b97f4a7c15u;
        uint64_t at = h >> 20 & (slots - 1);
        while (slot[at] != 0 && !same(s, slot[at] - 1, i)) at = (at + 1) & (slots - 1);
        if (slot[at] != 0) (*out)[i] = 1;
        else slot[at] = i + 1;
    }
    svo_free(a, slot, slots, sizeof *slot);
    return SVO_OK;
}
