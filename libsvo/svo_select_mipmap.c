/* The direct output by mipmaps (Willcocks 2013, 4.4, figure 32): a box sets at most nine texels, of the level at which its rectangle is at most three texels wide, and in the end the
 * levels are merged from the coarsest down. What a box costs does not depend on how large it looks; what is larger than two samples has the shape of texels. */
#include <math.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_select.h"

typedef struct pyramid {
    const svo_selection *selection;
    const uint8_t *cover;
    svoi_look look;
    uint32_t levels;
    uint64_t *nearest[SVOI_DEPTH_LEVELS]; /* as in svoi_draw_nearest; [0] is the picture */
    uint32_t level; /* being merged from level + 1 */
} pyramid;

static uint32_t texels(uint32_t samples, uint32_t level) { return (samples + (1u << level) - 1) >> level; }

typedef struct exact { const svo_selection *selection; uint64_t *nearest; uint32_t width, number; } exact;

static void add_exact(void *user, uint32_t x, uint32_t y, float depth, float leave)
{
    const exact *e = user;
    uint32_t bits;
    (void)leave;
    memcpy(&bits, &depth, 4);
    svoi_set_nearest(e->selection, &e->nearest[(uint64_t)y * e->width + x], (uint64_t)bits << 32 | e->number);
}

static svo_result scatter(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const pyramid *p = user;
    for (uint64_t i = begin; i < end; i++) {
        const svo_selected *b = &p->selection->boxes[i];
        double low[3], high[3];
        if (p->cover != NULL && p->cover[i] != svoi_covers) continue;
        for (int k = 0; k < 3; k++) low[k] = b->low[k], high[k] = b->high[k];
        const svoi_rect r = svoi_project(&p->look, low, high);
        if (r.near <= 0) { /* has no rectangle */
            exact e = {p->selection, p->nearest[0], p->look.width, (uint32_t)i};
            svoi_draw_box(&p->look, b->low, b->high, add_exact, &e);
            continue;
        }
        const svoi_span s = svoi_samples(&p->look, &r);
        if (s.x0 >= s.x1 || s.y0 >= s.y1) continue;
        const uint32_t size = s.x1 - s.x0 > s.y1 - s.y0 ? s.x1 - s.x0 : s.y1 - s.y0;
        uint32_t l = 0, bits;
        while (l < p->levels && size > 2u << l) l++;
        const float near = (float)r.near;
        memcpy(&bits, &near, 4);
        const uint32_t width = texels(p->look.width, l);
        for (uint32_t y = s.y0 >> l; y <= (s.y1 - 1) >> l; y++)
            for (uint32_t x = s.x0 >> l; x <= (s.x1 - 1) >> l; x++) svoi_set_nearest(p->selection, &p->nearest[l][(uint64_t)y * width + x], (uint64_t)bits << 32 | i);
    }
    return SVO_OK;
}

static svo_result merge_rows(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    const pyramid *p = user;
    const uint32_t width = texels(p->look.width, p->level), above = texels(p->look.width, p->level + 1);
    for (uint64_t y = begin; y < end; y++)
        for (uint32_t x = 0; x < width; x++) {
            const uint64_t coarse = p->nearest[p->level + 1][(y >> 1) * above + (x >> 1)];
            uint64_t *to = &p->nearest[p->level][y * width + x];
            if (svoi_is_nearer(p->selection, coarse, *to)) *to = coarse;
        }
    return SVO_OK;
}

svo_result svoi_draw_mipmap(const svo_selection *s, const uint8_t *cover, const svoi_look *look, uint32_t threads, const svo_allocator *a, uint64_t *nearest, svo_error *err)
{
    pyramid p = {.selection = s, .cover = cover, .look = *look};
    p.nearest[0] = nearest;
    bool ok = true;
    for (uint32_t l = 1; l < SVOI_DEPTH_LEVELS && ok; l++) {
        const uint64_t count = (uint64_t)texels(look->width, l) * texels(look->height, l);
        p.nearest[l] = svo_alloc(a, count, sizeof *nearest);
        ok = p.nearest[l] != NULL;
        if (!ok) break;
        memset(p.nearest[l], 0xff, count * sizeof *nearest);
        p.levels = l;
        if (count == 1) break;
    }
    svo_result result = ok ? svo_parallel_for(threads, s->count, 0, scatter, &p, err) : svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for a picture");
    for (uint32_t l = p.levels; l-- > 0 && result == SVO_OK;) {
        p.level = l;
        result = svo_parallel_for(threads, texels(look->height, l), 0, merge_rows, &p, err);
    }
    for (uint32_t l = 1; l <= p.levels; l++) svo_free(a, p.nearest[l], (uint64_t)texels(look->width, l) * texels(look->height, l), sizeof *nearest);
    return result;
}
