#include "svo_select.h"

#include <string.h>

#include "svo_bones.h"
#include "svo_task.h"
#include "svoi_select_jobs.h"

/* More instances than this go to threads by pages. */
enum { BY_PAGES = 4096 };
/* Depths that a thread has for itself, at most. */
enum { OWN_SAMPLES = 1 << 24 };

svo_result svoi_select_no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the selected voxels"); }

const uint8_t svoi_covers = 255;

uint32_t *svoi_find_channels(const svo_scene *scene, const char *name, svo_channel_kind kind, const uint8_t *plain, const svo_allocator *a, bool *any)
{
    uint32_t *of = svo_alloc(a, scene->asset_count, sizeof *of);
    *any = false;
    for (uint32_t i = 0; i < scene->asset_count && of != NULL; i++) {
        const svo_view *v = scene->assets[i];
        const uint32_t c = svo_view_find_channel(v, name);
        of[i] = SVO_MAX_CHANNELS;
        if (c >= v->channel_count || v->channels[c].channel.kind != kind) continue;
        if (plain != NULL && v->channels[c].encoding == SVO_ENCODING_CONSTANT && memcmp(v->channels[c].channel.value, plain, svo_channel_stride(kind)) == 0) continue;
        of[i] = c;
        *any = true;
    }
    return of;
}

/* ---- jobs ------------------------------------------------------------------------------------------------------------ */

static svo_result list_jobs(svoi_selecting *s, svo_buffer *jobs, svo_select_report *r, svo_error *err)
{
    const svo_scene *scene = s->scene;
    uint64_t seen = 0;
    for (uint32_t p = 0; p < scene->page_count; p++) {
        const svo_scene_page *page = &scene->pages[p];
        uint64_t instances = 0;
        for (uint64_t i = page->first; i < page->first + page->count; i++) instances += svoi_wanted(s, i);
        if (instances == 0) continue;
        r->pages++;
        r->instances += instances;
        if (svoi_see_page(s, p) != SVOI_SEEN) continue;
        seen += instances;
        svoi_job j = {.page = p, .instance = SVOI_WHOLE_PAGE};
        if (svo_buffer_append(jobs, &j, sizeof j) == NULL) return svoi_select_no_memory(err);
    }
    s->by_pages = seen > BY_PAGES;
    if (s->by_pages) return SVO_OK;
    uint64_t pages = jobs->size / sizeof(svoi_job);
    svo_buffer each;
    svo_buffer_init(&each, s->o->allocator);
    bool ok = true;
    r->pages_seen = pages;
    for (uint64_t n = 0; n < pages && ok; n++) {
        uint32_t p = ((const svoi_job *)(const void *)jobs->data)[n].page;
        const svo_scene_page *page = &scene->pages[p];
        for (uint64_t i = page->first; i < page->first + page->count && ok; i++) {
            svoi_job j = {.page = p, .instance = i};
            if (!svoi_wanted(s, i)) continue;
            j.top = svoi_root_of(scene->assets[scene->instance_asset[i]]);
            ok = svo_buffer_append(&each, &j, sizeof j) != NULL;
        }
    }
    svo_buffer_free(jobs);
    *jobs = each;
    return ok ? SVO_OK : svoi_select_no_memory(err);
}

/* Few instances: cut them, so that all threads have work. Depends on the scene only. */
static svo_result split_jobs(svoi_selecting *s, svo_buffer *jobs, svo_error *err)
{
    enum { ENOUGH = 1024, ROUNDS = 5 };
    for (int round = 0; round < ROUNDS && jobs->size / sizeof(svoi_job) < ENOUGH && !s->by_pages; round++) {
        svo_buffer more;
        svo_buffer_init(&more, s->o->allocator);
        bool ok = true;
        for (size_t i = 0; i < jobs->size / sizeof(svoi_job) && ok; i++) {
            const svoi_job *j = (const svoi_job *)(const void *)jobs->data + i;
            svoi_posed p = svoi_posed_make(s, j->page, j->instance);
            double low[3], high[3];
            svoi_place place;
            if (j->top.level != round || j->top.level + 6u > p.view->depth || svoi_judge(s, &p, &j->top, low, high, &place) != SVOI_DESCEND) {
                ok = svo_buffer_append(&more, j, sizeof *j) != NULL;
                continue;
            }
            svoi_visit next[8];
            uint32_t count = svoi_children(p.view, &j->top, next);
            for (uint32_t c = 0; c < count && ok; c++) {
                svoi_job part = {next[c], j->page, j->instance};
                ok = svo_buffer_append(&more, &part, sizeof part) != NULL;
            }
        }
        svo_buffer_free(jobs);
        *jobs = more;
        if (!ok) return svoi_select_no_memory(err);
    }
    return SVO_OK;
}

/* ---- all ------------------------------------------------------------------------------------------------------------- */

static void add_report(svo_select_report *to, const svo_select_report *r)
{
    to->pages_seen += r->pages_seen, to->overflowed += r->overflowed, to->visited += r->visited, to->outside += r->outside, to->hidden += r->hidden;
    to->selected += r->selected, to->finest += r->finest;
}

static svo_result gather(svoi_selecting *s, uint64_t jobs, svo_selection *out, svo_error *err)
{
    uint64_t total = 0, at = 0;
    for (uint64_t i = 0; i < jobs; i++) total += s->spans[i].count;
    if (total >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu deformed voxels are selected, more than 2^32 - 1; a larger --delta selects fewer", (unsigned long long)total);
    out->boxes = svo_alloc(out->allocator, total, sizeof *out->boxes);
    if (out->boxes == NULL && total != 0) return svoi_select_no_memory(err);
    out->count = total;
    uint8_t *seen = svo_calloc(out->allocator, s->scene->instance_count, 1);
    if (seen == NULL && s->scene->instance_count != 0) return svoi_select_no_memory(err);
    for (uint64_t i = 0; i < jobs; i++) {
        const svoi_job_span *p = &s->spans[i];
        if (p->count == 0) continue; /* (there may be no boxes at all) */
        memcpy(out->boxes + at, (const svo_selected *)(const void *)s->outputs[p->worker].boxes.data + p->first, p->count * sizeof *out->boxes);
        at += p->count;
    }
    for (uint64_t i = 0; i < total; i++) {
        out->report.instances_seen += !seen[out->boxes[i].instance];
        seen[out->boxes[i].instance] = 1;
    }
    svo_free(out->allocator, seen, s->scene->instance_count, 1);
    return SVO_OK;
}

/* Bone sets of the assets that need them. */
static svo_result make_bones(svoi_selecting *s, svo_error *err)
{
    const svo_scene *scene = s->scene;
    s->bones = svo_calloc(s->o->allocator, scene->asset_count, sizeof *s->bones);
    if (s->bones == NULL && scene->asset_count != 0) return svoi_select_no_memory(err);
    for (uint64_t i = 0; i < scene->instance_count; i++) {
        const svo_pose *p = svo_scene_instance_pose(scene, i);
        uint32_t a = scene->instance_asset[i];
        if (p != NULL && (p->flags & SVO_POSE_BONES) != 0 && s->bones[a] == NULL)
            SVO_TRY(svo_bones_make(scene->assets[a], s->o->threads, s->o->allocator, &s->bones[a], err));
    }
    return SVO_OK;
}

svo_result svo_select(const svo_scene *scene, const svo_select_options *o, svo_selection *out, svo_error *err)
{
    SVO_ASSERT(o->width > 0 && o->height > 0 && o->delta > 0);
    double began = svo_seconds();
    uint32_t threads = o->threads != 0 ? o->threads : svo_processor_count();
    svoi_selecting s = {.scene = scene, .o = o};
    svo_buffer jobs, spans;
    svo_buffer_init(&jobs, o->allocator);
    svo_buffer_init(&spans, o->allocator);
    memset(out, 0, sizeof *out);
    out->allocator = o->allocator;
    s.look = svoi_look_make(&o->eye, o->width, o->height);
    s.origin[0] = o->eye.position.x, s.origin[1] = o->eye.position.y, s.origin[2] = o->eye.position.z;
    memcpy(out->origin, s.origin, sizeof out->origin);
    svo_result result = SVO_OK;
    bool any;
    s.normal_channel = svoi_find_channels(scene, "normal", SVO_KIND_NORMAL_OCT32, NULL, o->allocator, &any);
    s.coverage_channel = svoi_find_channels(scene, "coverage", SVO_KIND_UNORM8, &svoi_covers, o->allocator, &any);
    s.outputs = svo_calloc(o->allocator, threads, sizeof *s.outputs);
    if (s.outputs == NULL || ((s.normal_channel == NULL || s.coverage_channel == NULL) && scene->asset_count != 0)) result = svoi_select_no_memory(err);
    const uint64_t samples = (uint64_t)o->width * o->height;
    for (uint32_t t = 0; t < threads && s.outputs != NULL; t++) {
        svo_buffer_init(&s.outputs[t].boxes, o->allocator);
        if (o->occlusion && samples <= OWN_SAMPLES) s.outputs[t].own.nearest = svo_alloc(o->allocator, samples, sizeof(float)); /* without memory there is none */
    }
    if (result == SVO_OK && o->occlusion) result = svoi_depth_make(&s.depth, o->width, o->height, o->allocator, err);
    if (result == SVO_OK) result = make_bones(&s, err);
    if (result == SVO_OK) result = svoi_find_copies(scene, o->allocator, &s.copy, err);
    if (result == SVO_OK) result = list_jobs(&s, &jobs, &out->report, err);
    if (result == SVO_OK && !o->occlusion) result = split_jobs(&s, &jobs, err);
    if (result == SVO_OK && o->occlusion) result = svoi_run_by_depth(&s, &jobs, &spans, threads, &out->report, err);
    else if (result == SVO_OK && svo_buffer_append(&spans, NULL, jobs.size / sizeof(svoi_job) * sizeof(svoi_job_span)) == NULL && jobs.size != 0) result = svoi_select_no_memory(err);
    s.spans = (svoi_job_span *)(void *)spans.data;
    s.jobs = (const svoi_job *)(const void *)jobs.data;
    if (result == SVO_OK && !o->occlusion) result = svo_parallel_for(threads, jobs.size / sizeof(svoi_job), 0, svoi_run_jobs, &s, err);
    if (result == SVO_OK) result = gather(&s, spans.size / sizeof(svoi_job_span), out, err);
    for (uint32_t t = 0; t < threads && s.outputs != NULL; t++) {
        add_report(&out->report, &s.outputs[t].report);
        svo_buffer_free(&s.outputs[t].boxes);
        svo_free(o->allocator, s.outputs[t].own.nearest, samples, sizeof(float));
    }
    svo_buffer_free(&spans);
    svo_free(o->allocator, s.outputs, threads, sizeof *s.outputs);
    for (uint32_t a = 0; a < scene->asset_count && s.bones != NULL; a++) svo_bones_free(s.bones[a]);
    svo_free(o->allocator, s.copy, scene->instance_count, 1);
    svo_free(o->allocator, s.bones, scene->asset_count, sizeof *s.bones);
    svo_free(o->allocator, s.normal_channel, scene->asset_count, sizeof *s.normal_channel);
    svo_free(o->allocator, s.coverage_channel, scene->asset_count, sizeof *s.coverage_channel);
    svo_buffer_free(&jobs);
    svoi_depth_free(&s.depth);
    out->report.seconds = svo_seconds() - began;
    if (result != SVO_OK) svo_selection_free(out);
    return result;
}

void svo_selection_free(svo_selection *s)
{
    if (s == NULL) return;
    svo_free(s->allocator, s->boxes, s->count, sizeof *s->boxes);
    memset(s, 0, sizeof *s);
}
