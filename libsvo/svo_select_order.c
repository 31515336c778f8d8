/* Selection from near to far, so that what is near hides what is behind it. */
#include <math.h>
#include <stdlib.h>

#include "svo_task.h"
#include "svoi_select_jobs.h"

typedef struct nearness { double near; uint64_t job; } nearness;

static int compare_nearness(const void *a, const void *b)
{
    const nearness *x = a, *y = b;
    if (x->near != y->near) return x->near < y->near ? -1 : 1;
    return x->job < y->job ? -1 : x->job > y->job;
}

/* Square of the distance from the eye: of a page's box, or of the middle of a node. */
static double distance_of(const svoi_selecting *s, const svoi_job *j)
{
    double sum = 0;
    if (j->instance == SVOI_WHOLE_PAGE) {
        const svo_scene_page *g = &s->scene->pages[j->page];
        for (int k = 0; k < 3; k++) {
            double d = fmax(0, fmax(g->low[k] - s->origin[k], s->origin[k] - g->high[k]));
            sum += d * d;
        }
    } else {
        svoi_posed p = svoi_posed_make(s, j->page, j->instance);
        double edge = ldexp(1, (int)(p.view->depth - j->top.level));
        svo_vec3 at = svo_deform_point(&p.map, SVO_NO_BONE, svo_v3((j->top.cell[0] + 0.5) * edge, (j->top.cell[1] + 0.5) * edge, (j->top.cell[2] + 0.5) * edge));
        sum = svo_dot(at, at);
    }
    return isfinite(sum) ? sum : INFINITY;
}

static svo_result sort_jobs(const svoi_selecting *s, svo_buffer *jobs, svo_error *err)
{
    uint64_t count = jobs->size / sizeof(svoi_job);
    const svoi_job *from = (const svoi_job *)(const void *)jobs->data;
    nearness *order = svo_alloc(s->o->allocator, count, sizeof *order);
    svo_buffer sorted;
    svo_buffer_init(&sorted, s->o->allocator);
    if (count != 0 && (order == NULL || !svo_buffer_reserve(&sorted, jobs->size))) {
        svo_free(s->o->allocator, order, count, sizeof *order);
        return svoi_select_no_memory(err);
    }
    for (uint64_t i = 0; i < count; i++) order[i] = (nearness){distance_of(s, &from[i]), i};
    if (count > 1) qsort(order, count, sizeof *order, compare_nearness);
    for (uint64_t i = 0; i < count; i++) svo_buffer_append(&sorted, &from[order[i].job], sizeof(svoi_job));
    svo_free(s->o->allocator, order, count, sizeof *order);
    svo_buffer_free(jobs);
    *jobs = sorted;
    return SVO_OK;
}

/* Cut a node that looks large into parts, so that near parts can hide far ones. */
static svo_result cut(const svoi_selecting *s, const svoi_job *whole, svo_buffer *to, svo_error *err)
{
    enum { LARGE = 64 }; /* samples */
    svoi_posed p = svoi_posed_make(s, whole->page, whole->instance);
    svoi_visit stack[8 * SVO_MAX_DEPTH + 8], next[8];
    uint32_t top = 0;
    stack[top++] = whole->top;
    while (top != 0) {
        svoi_job part = {stack[--top], whole->page, whole->instance};
        double low[3], high[3], size = 0;
        svoi_place place;
        svoi_fate f = svoi_judge(s, &p, &part.top, low, high, &place);
        if (f == SVOI_OUTSIDE || f == SVOI_BEHIND) continue;
        if (f == SVOI_DESCEND) size = place.box.near > 0 ? fmax(place.box.x1 - place.box.x0, place.box.y1 - place.box.y0) : svoi_size_at_distance(s, low, high);
        if (f == SVOI_DESCEND && size > LARGE && part.top.level + 4u <= p.view->depth) {
            uint32_t count = svoi_children(p.view, &part.top, next);
            while (count != 0) stack[top++] = next[--count];
        } else if (svo_buffer_append(to, &part, sizeof part) == NULL) return svoi_select_no_memory(err);
    }
    return SVO_OK;
}

/* Pages that look large become their instances, and these their parts. */
static svo_result cut_pages(const svoi_selecting *s, const svoi_job *pages, uint64_t count, svo_buffer *to, svo_select_report *report, svo_error *err)
{
    for (uint64_t n = 0; n < count; n++) {
        const svo_scene_page *g = &s->scene->pages[pages[n].page];
        if (pages[n].instance != SVOI_WHOLE_PAGE) {
            SVO_TRY(cut(s, &pages[n], to, err));
            continue;
        }
        double low[3], high[3];
        svoi_page_box(s, pages[n].page, low, high);
        svoi_rect r = svoi_project(&s->look, low, high);
        double size = r.near > 0 ? fmax(r.x1 - r.x0, r.y1 - r.y0) : svoi_size_at_distance(s, low, high), apart = sqrt((double)g->count);
        if (size / apart < 24) { /* its instances are small */
            if (svo_buffer_append(to, &pages[n], sizeof pages[n]) == NULL) return svoi_select_no_memory(err);
            continue;
        }
        if (svoi_see_page(s, pages[n].page) != SVOI_SEEN) continue;
        report->pages_seen++;
        for (uint64_t i = g->first; i < g->first + g->count; i++) {
            if (!svoi_wanted(s, i)) continue;
            svoi_job j = {svoi_root_of(s->scene->assets[s->scene->instance_asset[i]]), pages[n].page, i};
            SVO_TRY(cut(s, &j, to, err));
        }
    }
    return SVO_OK;
}

svo_result svoi_run_by_depth(svoi_selecting *s, svo_buffer *jobs, svo_buffer *spans, uint32_t threads, svo_select_report *r, svo_error *err)
{
    enum { PAGES_AT_A_TIME = 8 };
    SVO_TRY(sort_jobs(s, jobs, err));
    uint64_t count = jobs->size / sizeof(svoi_job), step = s->by_pages ? PAGES_AT_A_TIME : count;
    svo_result result = SVO_OK;
    uint64_t size = 32;
    for (uint64_t n = 0; n < count && result == SVO_OK; n += step) {
        svo_buffer parts;
        svo_buffer_init(&parts, s->o->allocator);
        result = cut_pages(s, (const svoi_job *)(const void *)jobs->data + n, count - n < step ? count - n : step, &parts, r, err);
        if (result == SVO_OK) result = sort_jobs(s, &parts, err);
        uint64_t all = parts.size / sizeof(svoi_job);
        for (uint64_t first = 0; first < all && result == SVO_OK; first += size) {
            if (first != 0) size += size / 8;
            uint64_t some = all - first < size ? all - first : size;
            svoi_job_span *to = svo_buffer_append(spans, NULL, some * sizeof(svoi_job_span));
            if (to == NULL) result = svoi_select_no_memory(err);
            s->jobs = (const svoi_job *)(const void *)parts.data + first, s->spans = to;
            if (result == SVO_OK) result = svo_parallel_for(threads, some, 2, svoi_run_jobs, s, err);
            svoi_depth_update(&s->depth);
            r->rounds++;
        }
        svo_buffer_free(&parts);
    }
    return result;
}
