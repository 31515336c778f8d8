/* Scenes of which a part is damaged. */
#include <string.h>

#include "fmti_scene.h"

svo_result fmti_scene_damage_page(fmti_scene_damage *d, uint32_t page_count, uint32_t page, svo_error *err)
{
    if (d->page == NULL) {
        d->page = svo_calloc(d->allocator, page_count, 1);
        if (d->page == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the pages of a scene");
        d->page_count = page_count;
    }
    d->page[page] = 1;
    d->pages++;
    return SVO_OK;
}

void fmti_scene_damage_free(fmti_scene_damage *d) { svo_free(d->allocator, d->page, d->page_count, 1); }

enum { PAGES, ASSETS, TRANSFORMS, IDS, NAMES, POSES };

static bool copy(svo_buffer *to, const void *array, uint64_t index, size_t stride)
{
    return array == NULL || svo_buffer_append(to, (const uint8_t *)array + index * stride, stride) != NULL;
}

svo_result fmti_scene_drop_damaged(fmt_scene *f, fmti_scene_damage *d, svo_error *err)
{
    svo_scene *s = &f->scene;
    bool ok = true;
    uint64_t kept = 0;
    for (int i = 0; i < FMT_SCENE_ARRAYS; i++) svo_buffer_init(&f->copies[i], f->allocator);
    for (uint32_t p = 0; p < s->page_count && ok; p++) {
        svo_scene_page page = s->pages[p];
        if (d->page != NULL && d->page[p]) {
            d->instances += page.count;
            continue;
        }
        uint64_t first = kept;
        for (uint64_t i = page.first; i < page.first + page.count && ok; i++) {
            uint32_t asset = s->instance_asset[i];
            if (asset < s->asset_count && s->assets[asset]->empty) {
                d->instances++;
                continue;
            }
            ok = copy(&f->copies[ASSETS], s->instance_asset, i, 4) && copy(&f->copies[TRANSFORMS], s->instance_transform, i, 48) &&
                 copy(&f->copies[IDS], s->instance_id, i, 8) && copy(&f->copies[NAMES], s->instance_name, i, 4) && copy(&f->copies[POSES], s->instance_pose, i, 4);
            kept++;
        }
        if (kept == first) continue;
        page.first = first, page.count = kept - first;
        ok = ok && svo_buffer_append(&f->copies[PAGES], &page, sizeof page) != NULL;
    }
    if (!ok) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for what is left of a damaged scene");
    s->page_count = (uint32_t)(f->copies[PAGES].size / sizeof(svo_scene_page));
    s->instance_count = kept;
    s->pages = (const svo_scene_page *)(const void *)f->copies[PAGES].data;
    s->instance_asset = (const uint32_t *)(const void *)f->copies[ASSETS].data;
    s->instance_transform = (const float *)(const void *)f->copies[TRANSFORMS].data;
    s->instance_id = (const uint64_t *)(const void *)f->copies[IDS].data;
    if (s->instance_name != NULL) s->instance_name = (const uint32_t *)(const void *)f->copies[NAMES].data;
    if (s->instance_pose != NULL) s->instance_pose = (const uint32_t *)(const void *)f->copies[POSES].data;
    return SVO_OK;
}
