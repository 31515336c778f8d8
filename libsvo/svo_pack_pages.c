/* Pages of a packed scene: instances near each other, with an origin in double precision and bounds. */
#include <math.h>
#include <string.h>

#include "svo_task.h"
#include "svoi_packer.h"

/* Bounds of a place (a number in the input); false when they are not finite. */
static bool place_box(const svoi_packer *p, const svo_mat4 *transform, uint64_t number, double low[3], double high[3])
{
    const svo_place *place = &p->in->places[number];
    const svoi_pack_source *s = &p->out->sources[place->asset];
    svo_poses all = svoi_pose_table_get(&p->out->poses);
    const svo_pose *pose = p->pose != NULL && p->pose[number] != SVO_NO_POSE ? &all.pose[p->pose[number]] : NULL;
    svo_mat4 grid;
    memcpy(grid.m, s->view.voxel_to_world, sizeof grid.m);
    return svo_deform_bounds(&all, pose, &grid, transform, &s->extent, low, high);
}

static svo_result find_centres(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    svoi_packer *p = user;
    for (uint64_t i = begin; i < end; i++) {
        const svo_place *place = &p->in->places[p->order[i]];
        svo_mat4 m = svoi_pack_transform(p, place);
        double low[3], high[3], *c = p->centre + 3 * p->order[i];
        bool finite = place_box(p, &m, p->order[i], low, high);
        for (int k = 0; k < 3; k++) {
            c[k] = low[k] / 2 + high[k] / 2 + 0.0; /* + 0.0: no negative zero */
            if (finite) continue;
            /* its transform is finite, as classify has seen */
            svo_fail(err, SVO_LIMIT, "instance %llu: its asset is too large there: its bounds are not finite", (unsigned long long)p->order[i]);
            if (err != NULL) err->index = p->order[i];
            return SVO_LIMIT;
        }
    }
    return SVO_OK;
}

/* Unsigned order of the result is the numeric order of the doubles. */
static inline uint64_t sortable(double v)
{
    uint64_t bits;
    memcpy(&bits, &v, 8);
    return bits >> 63 ? ~bits : bits | (uint64_t)1 << 63;
}

/* The key of rank *rank (from 0) of n keys, which are overwritten; *rank becomes its rank among the equal ones. Radix
 * selection from the top digit: linear time whatever the values, which a pivot does not promise. */
static uint64_t select_key(uint64_t *keys, uint64_t n, uint64_t *rank)
{
    for (int shift = 53; n > 1; shift = shift > 11 ? shift - 11 : 0) {
        uint64_t histogram[2048] = {0};
        for (uint64_t i = 0; i < n; i++) histogram[keys[i] >> shift & 2047]++;
        uint64_t digit = 0;
        while (*rank >= histogram[digit]) *rank -= histogram[digit++];
        uint64_t left = 0;
        for (uint64_t i = 0; i < n; i++)
            if ((keys[i] >> shift & 2047) == digit) keys[left++] = keys[i];
        n = left;
        if (shift == 0) break;
    }
    return keys[0];
}

/* Put the `left` places with the smallest centres along the longest axis of the range first; both halves keep the
 * order of the input, and of equal centres the earlier ones go left. */
static void split(svoi_packer *p, uint64_t begin, uint64_t end, uint64_t left)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint64_t i = begin; i < end; i++)
        for (int k = 0; k < 3; k++) {
            double c = p->centre[3 * p->order[i] + (uint64_t)k];
            low[k] = fmin(low[k], c), high[k] = fmax(high[k], c);
        }
    uint64_t axis = 0;
    for (uint64_t k = 1; k < 3; k++)
        if (high[k] / 2 - low[k] / 2 > high[axis] / 2 - low[axis] / 2) axis = k;
    for (uint64_t i = begin; i < end; i++) p->keys[i] = sortable(p->centre[3 * p->order[i] + axis]);
    uint64_t equal = left;
    uint64_t pivot = select_key(p->keys + begin, end - begin, &equal);
    uint64_t l = begin, r = begin + left;
    for (uint64_t i = begin; i < end; i++) {
        uint64_t key = sortable(p->centre[3 * p->order[i] + axis]);
        bool goes_left = key < pivot || (key == pivot && equal > 0);
        if (key == pivot && goes_left) equal--;
        p->scratch[goes_left ? l++ : r++] = p->order[i];
    }
    memcpy(p->order + begin, p->scratch + begin, (size_t)(end - begin) * 8);
}

svo_result svoi_pack_make_pages(svoi_packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    p->scratch = svo_alloc(p->allocator, p->kept, 8);
    p->keys = svo_alloc(p->allocator, p->kept, 8);
    p->centre = svo_alloc(p->allocator, p->in->place_count, 24);
    if (p->scratch == NULL || p->keys == NULL || p->centre == NULL) return svoi_pack_no_memory(err, "the grouping", p->kept);
    SVO_TRY(svo_parallel_for(p->threads, p->kept, 4096, find_centres, p, err));
    uint64_t count = (p->kept + p->page_instances - 1) / p->page_instances;
    if (count > UINT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu pages are more than a scene can have", (unsigned long long)count);
    o->pages = svo_calloc(p->allocator, count, sizeof *o->pages);
    o->page_capacity = (uint32_t)count;
    if (o->pages == NULL) return svoi_pack_no_memory(err, "the pages", p->kept);
    struct { uint64_t begin, end; } stack[66];
    int top = 0;
    stack[0].begin = 0, stack[0].end = p->kept;
    while (top >= 0) {
        uint64_t begin = stack[top].begin, end = stack[top].end;
        if (end - begin <= p->page_instances) {
            o->pages[o->scene.page_count].first = begin;
            o->pages[o->scene.page_count++].count = end - begin;
            top--;
            continue;
        }
        /* Halves of whole pages, so that all but the last page are full. */
        uint64_t pages = (end - begin + p->page_instances - 1) / p->page_instances;
        uint64_t middle = begin + pages / 2 * p->page_instances;
        split(p, begin, end, middle - begin);
        stack[top].begin = middle;
        stack[top + 1].begin = begin, stack[top + 1].end = middle;
        top++;
    }
    SVO_ASSERT(o->scene.page_count == count);
    return SVO_OK;
}

/* Zero where all translations of the page fit single precision as they are, else the middle of them. */
static void choose_origin(svoi_packer *p, svo_scene_page *page)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    bool fits = true;
    for (uint64_t i = page->first; i < page->first + page->count; i++) {
        svo_mat4 m = svoi_pack_transform(p, &p->in->places[p->order[i]]);
        for (int k = 0; k < 3; k++) {
            double t = m.m[4 * k + 3];
            low[k] = fmin(low[k], t), high[k] = fmax(high[k], t);
            fits = fits && (double)(float)t == t;
        }
    }
    for (int k = 0; k < 3; k++) page->origin[k] = fits ? 0 : low[k] / 2 + high[k] / 2;
}

static svo_result fill_pages(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    svoi_packer *p = user;
    svo_packed_scene *o = p->out;
    for (uint64_t g = begin; g < end; g++) {
        svo_scene_page *page = &o->pages[g];
        choose_origin(p, page);
        for (int k = 0; k < 3; k++) page->low[k] = INFINITY, page->high[k] = -INFINITY;
        for (uint64_t i = page->first; i < page->first + page->count; i++) {
            const svo_place *place = &p->in->places[p->order[i]];
            svo_mat4 m = svoi_pack_transform(p, place), inverse;
            float *t = o->transform + 12 * i;
            for (int k = 0; k < 12; k++) t[k] = (float)(k % 4 == 3 ? m.m[k] - page->origin[k / 4] : m.m[k]);
            o->asset[i] = o->report.assets[place->asset].packed;
            o->id[i] = place->id;
            m = svo_scene_instance_transform(&o->scene, (uint32_t)g, i);
            double low[3], high[3];
            bool good = place_box(p, &m, p->order[i], low, high) && svo_mat4_affine_inverse(&m, &inverse);
            if (o->pose != NULL) o->pose[i] = p->pose[p->order[i]];
            for (int k = 0; k < 3; k++) {
                page->low[k] = fmin(page->low[k], low[k]), page->high[k] = fmax(page->high[k], high[k]);
            }
            if (good) continue;
            /* as it was given its transform can be stored (classify), but not beside an asset of such a size */
            svo_fail(err, SVO_LIMIT, "instance %llu: its asset is too large, or too far from the others, to be placed in single precision (3.4e38)", (unsigned long long)p->order[i]);
            if (err != NULL) err->index = p->order[i];
            return SVO_LIMIT;
        }
    }
    return SVO_OK;
}

svo_result svoi_pack_fill_pages(svoi_packer *p, svo_error *err)
{
    return svo_parallel_for(p->threads, p->out->scene.page_count, 4, fill_pages, p, err);
}
