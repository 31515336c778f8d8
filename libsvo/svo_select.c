#include "svo_select.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_bones.h"
#include "svo_task.h"
#include "svoi_select.h"

/* A node to look at. */
typedef struct visit {
    svo_view_node node;
    uint32_t cell[3]; /* on its level */
    uint8_t level, full_level; /* full_level: of the full leaf it is in */
} visit;

/* What a thread takes at a time: a subtree of an instance, or all instances of a page. */
typedef struct job {
    visit top;
    uint32_t page;
    uint64_t instance; /* WHOLE_PAGE */
} job;
#define WHOLE_PAGE UINT64_MAX
/* More instances than this go to threads by pages. */
enum { BY_PAGES = 4096 };

typedef struct output {
    svo_buffer boxes;
    svo_select_report report;
} output;

/* Where the boxes of a job went. */
typedef struct span { uint32_t worker; uint64_t first, count; } span;

typedef struct selecting {
    const svo_scene *scene;
    const svo_select_options *o;
    double origin[3];
    svoi_look look;
    svoi_depth depth;    /* with occlusion */
    uint32_t *normal_channel; /* of each asset */
    uint8_t *copy;            /* of each instance: it is where another is */
    svo_bones **bones;        /* of each asset that an instance moves by its bones, else NULL */
    bool by_pages;
    const job *jobs;
    span *spans;
    output *outputs;
} selecting;

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the selected voxels"); }

/* ---- a box in the picture -------------------------------------------------------------------------------------------- */

typedef enum sight { OUT_OF_SIGHT, HIDDEN, SEEN } sight;

/* Hidden where all samples that it, or cells made of it, can cover show something nearer. */
static bool is_hidden(const selecting *s, const double low[3], const double high[3], const svoi_rect *r)
{
    double shortest = INFINITY, longest = 0, l[3], h[3];
    for (int k = 0; k < 3; k++) shortest = fmin(shortest, high[k] - low[k]), longest = fmax(longest, high[k] - low[k]);
    double over = s->o->overhang[0] * shortest + s->o->overhang[1] * longest;
    svoi_rect wide = *r;
    if (over > 0) {
        for (int k = 0; k < 3; k++) l[k] = low[k] - over, h[k] = high[k] + over;
        wide = svoi_project(&s->look, l, h);
    }
    if (wide.near <= 0) return false;
    svoi_span samples = svoi_samples(&s->look, &wide);
    return svoi_depth_hides(&s->depth, &samples, wide.near * (1 - 1e-6));
}

/* *size is the longer side of its rectangle in samples (3.2.3), infinite for a box that reaches behind the eye's plane. */
static sight project(const selecting *s, const double low[3], const double high[3], double *size)
{
    svoi_rect r = svoi_project(&s->look, low, high);
    *size = fmax(r.x1 - r.x0, r.y1 - r.y0);
    if (s->o->frustum && (r.far <= 0 || svoi_outside(&s->look, low, high))) return OUT_OF_SIGHT;
    if (s->o->occlusion && is_hidden(s, low, high, &r)) return HIDDEN;
    return SEEN;
}

/* Behind the eye there is no picture: what a box of that size would show at its distance. */
static double size_at_distance(const selecting *s, const double low[3], const double high[3])
{
    double longest = 0, near = 0;
    for (int k = 0; k < 3; k++) {
        longest = fmax(longest, high[k] - low[k]);
        double away = fmax(0, fmax(low[k], -high[k]));
        near += away * away;
    }
    return s->look.focal * longest / sqrt(near);
}

/* ---- nodes ----------------------------------------------------------------------------------------------------------- */

/* Nodes inside a full leaf that touch none of its faces are never seen. */
static bool at_surface(const visit *n)
{
    uint32_t mask = (1u << (n->level - n->full_level)) - 1;
    for (int k = 0; k < 3; k++) {
        uint32_t local = n->cell[k] & mask;
        if (local == 0 || local == mask) return true;
    }
    return false;
}

static uint32_t children(const svo_view *v, const visit *n, visit out[8])
{
    uint32_t count = 0;
    uint8_t mask;
    uint64_t brick = 0;
    bool octant_of_brick = n->level + 1u == v->depth, inner = n->level < v->brick_level;
    if (n->node.full) mask = 0xff;
    else if (octant_of_brick) mask = (uint8_t)n->node.at; /* its byte of the brick, see below and root_of */
    else if (inner) mask = svo_view_mask(v, n->level, n->node);
    else {
        brick = svo_view_brick(v, n->node);
        uint64_t octants = svo_brick_octants(brick);
        mask = 0;
        for (uint32_t a = 0; a < 8; a++) mask |= (uint8_t)((octants >> 8 * a & 1) << a);
    }
    for (uint32_t m = mask; m != 0; m &= m - 1) {
        uint32_t octant = (uint32_t)__builtin_ctz(m);
        visit *c = &out[count];
        *c = (visit){.level = (uint8_t)(n->level + 1), .full_level = n->full_level};
        for (uint32_t k = 0; k < 3; k++) c->cell[k] = 2 * n->cell[k] + (octant >> k & 1);
        if (n->node.full) {
            c->node = n->node;
            if (!at_surface(c)) continue;
        } else if (octant_of_brick) { /* voxels: with lod the octant's own attribute comes first */
            uint32_t before = (uint32_t)__builtin_popcount((uint32_t)n->node.at & ((1u << octant) - 1));
            c->node.attribute = v->unnumbered ? 0 : n->node.attribute + (v->lod ? 1 : 0) + before;
        } else if (inner) {
            c->node = svo_view_child(v, n->level, n->node, octant);
            if (c->node.full) c->full_level = c->level;
        } else {
            c->node.attribute = svo_view_brick_octant(v, n->node, brick, octant);
            c->node.at = brick >> 8 * octant & 0xff;
        }
        count++;
    }
    return count;
}

static const svo_bone_range resting = {SVO_NO_BONE, 255, 255, {0, 0}};

static bool take(const selecting *s, const svo_deform *d, const svo_view *v, const svo_bones *bones, uint64_t instance, const visit *n, const double low[3], const double high[3],
                 double edge, output *out)
{
    svo_selected b = {.instance = (uint32_t)instance, .attribute = n->node.attribute};
    for (int k = 0; k < 3; k++) {
        b.low[k] = (float)low[k], b.high[k] = (float)high[k];
        if (b.low[k] > low[k]) b.low[k] = nextafterf(b.low[k], -INFINITY);
        if (b.high[k] < high[k]) b.high[k] = nextafterf(b.high[k], INFINITY);
    }
    svo_vec3 normal = {0, 0, 0};
    uint32_t channel = s->normal_channel[s->scene->instance_asset[instance]];
    if (channel != SVO_MAX_CHANNELS) {
        uint8_t value[SVO_MAX_STRIDE];
        float f[3];
        svo_view_attribute(v, channel, n->node.attribute, value);
        svo_oct32_decode(value, f);
        svo_bone_list list = bones != NULL ? svo_bones_at(bones, n->level, n->cell) : (svo_bone_list){&resting, 1};
        svo_vec3 middle = {(n->cell[0] + 0.5) * edge, (n->cell[1] + 0.5) * edge, (n->cell[2] + 0.5) * edge};
        normal = svo_deform_blended_normal(d, list, middle, edge, svo_v3(f[0], f[1], f[2]));
    }
    if (svo_dot(normal, normal) == 0) normal = svo_normalize(svo_v3(-0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -0.5 * (low[2] + high[2])));
    float f[3] = {(float)normal.x, (float)normal.y, (float)normal.z};
    svo_oct32_encode(f, b.normal);
    out->report.selected++;
    out->report.finest += n->level == v->depth;
    if (s->o->occlusion) svoi_draw_box(&s->look, b.low, b.high, svoi_depth_add, (void *)&s->depth);
    return svo_buffer_append(&out->boxes, &b, sizeof b) != NULL;
}

typedef enum fate { OUTSIDE, BEHIND, TAKE, DESCEND, OVERFLOW } fate;

/* Bounds of a page relative to the eye, a little wider than they are stored: sines differ in their last bits between machines. */
static void page_box(const selecting *s, uint32_t page, double low[3], double high[3])
{
    const svo_scene_page *g = &s->scene->pages[page];
    for (int k = 0; k < 3; k++) {
        double slack = 1e-9 * fmax(fabs(g->low[k]), fabs(g->high[k]));
        low[k] = g->low[k] - s->origin[k] - slack, high[k] = g->high[k] - s->origin[k] + slack;
    }
}

/* Deform a node and say what is to be done with it. The images of all its points are in its box and in the page's, so its box is cut to that: what a page that is not seen
 * leaves out is then the same as what its nodes would. */
static fate judge(const selecting *s, const svo_deform *d, uint32_t page, const svo_view *v, const svo_bones *bones, const visit *n, double edge, double low[3], double high[3])
{
    double from[3], to[3], size;
    for (int k = 0; k < 3; k++) from[k] = n->cell[k] * edge, to[k] = from[k] + edge;
    if (bones != NULL) svo_deform_blended_box(d, svo_bones_at(bones, n->level, n->cell), from, to, low, high);
    else svo_deform_box(d, SVO_NO_BONE, from, to, low, high);
    for (int k = 0; k < 3; k++)
        if (!(fabs(low[k]) < 0.5 * FLT_MAX) || !(fabs(high[k]) < 0.5 * FLT_MAX)) return OVERFLOW;
    page_box(s, page, from, to);
    for (int k = 0; k < 3; k++) {
        low[k] = fmax(low[k], from[k]), high[k] = fmin(high[k], to[k]);
        if (low[k] > high[k]) return OUTSIDE;
    }
    sight seen = project(s, low, high, &size);
    if (seen != SEEN) return seen == HIDDEN ? BEHIND : OUTSIDE;
    if (n->level >= v->depth) return TAKE;
    if (s->o->whole) return DESCEND;
    if (size == INFINITY) size = size_at_distance(s, low, high);
    return size < s->o->delta ? TAKE : DESCEND;
}

static svo_deform deform_of(const selecting *s, const job *j)
{
    const svo_scene *scene = s->scene;
    svo_mat4 grid, place = svo_scene_instance_transform(scene, j->page, j->instance);
    memcpy(grid.m, scene->assets[scene->instance_asset[j->instance]]->voxel_to_world, sizeof grid.m);
    for (int k = 0; k < 3; k++) place.m[4 * k + 3] -= s->origin[k];
    return svo_deform_make(&scene->poses, svo_scene_instance_pose(scene, j->instance), &grid, &place);
}

/* Of an instance whose pose has bones; NULL otherwise. */
static const svo_bones *bones_of(const selecting *s, const svo_deform *d, uint64_t instance)
{
    return (d->flags & SVO_POSE_BONES) != 0 ? s->bones[s->scene->instance_asset[instance]] : NULL;
}

static svo_result run_job(const selecting *s, const job *j, output *out, svo_error *err)
{
    const svo_scene *scene = s->scene;
    const svo_view *v = scene->assets[scene->instance_asset[j->instance]];
    svo_deform d = deform_of(s, j);
    visit stack[8 * SVO_MAX_DEPTH + 8], next[8];
    uint32_t top = 0;
    uint64_t first = out->boxes.size;
    stack[top++] = j->top;
    while (top != 0) {
        visit n = stack[--top];
        double low[3], high[3], edge = ldexp(1, (int)(v->depth - n.level));
        out->report.visited++;
        switch (judge(s, &d, j->page, v, bones_of(s, &d, j->instance), &n, edge, low, high)) {
        case OVERFLOW:
            out->boxes.size = (size_t)first;
            out->report.overflowed++;
            return SVO_OK;
        case OUTSIDE: out->report.outside++; break;
        case BEHIND: out->report.hidden++; break;
        case TAKE:
            if (!take(s, &d, v, bones_of(s, &d, j->instance), j->instance, &n, low, high, edge, out)) return no_memory(err);
            break;
        case DESCEND: {
            uint32_t count = children(v, &n, next);
            while (count != 0) stack[top++] = next[--count];
        }
        }
    }
    return SVO_OK;
}

/* Levels above the root of an octree of depth 0 or 1 are virtual: begin at its root all the same. */
static visit root_of(const svo_view *v)
{
    visit n = {.node = svo_view_root(v)};
    if (v->depth >= 2) return n;
    uint64_t brick = svo_view_brick(v, n.node);
    if (v->depth == 0) n.node.attribute = svo_view_brick_voxel(v, n.node, brick, 0);
    else n.node.attribute = svo_view_brick_octant(v, n.node, brick, 0), n.node.at = brick & 0xff;
    return n;
}

static bool wanted(const selecting *s, uint64_t instance)
{
    const svo_scene *scene = s->scene;
    return !s->copy[instance] && !scene->assets[scene->instance_asset[instance]]->empty && (s->o->everything || svo_scene_instance_pose(scene, instance) != NULL);
}

static sight see_page(const selecting *s, uint32_t page)
{
    double low[3], high[3], size;
    page_box(s, page, low, high);
    return project(s, low, high, &size);
}

static svo_result run_page(const selecting *s, uint32_t page, output *out, svo_error *err)
{
    const svo_scene_page *g = &s->scene->pages[page];
    if (see_page(s, page) != SEEN) return SVO_OK;
    out->report.pages_seen++;
    for (uint64_t i = g->first; i < g->first + g->count; i++) {
        if (!wanted(s, i)) continue;
        job j = {root_of(s->scene->assets[s->scene->instance_asset[i]]), page, i};
        SVO_TRY(run_job(s, &j, out, err));
    }
    return SVO_OK;
}

static svo_result run_jobs(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    selecting *s = user;
    output *out = &s->outputs[worker];
    for (uint64_t i = begin; i < end; i++) {
        s->spans[i] = (span){worker, out->boxes.size / sizeof(svo_selected), 0};
        SVO_TRY(s->jobs[i].instance == WHOLE_PAGE ? run_page(s, s->jobs[i].page, out, err) : run_job(s, &s->jobs[i], out, err));
        s->spans[i].count = out->boxes.size / sizeof(svo_selected) - s->spans[i].first;
    }
    return SVO_OK;
}

/* ---- jobs ------------------------------------------------------------------------------------------------------------ */

static svo_result list_jobs(selecting *s, svo_buffer *jobs, svo_select_report *r, svo_error *err)
{
    const svo_scene *scene = s->scene;
    uint64_t seen = 0;
    for (uint32_t p = 0; p < scene->page_count; p++) {
        const svo_scene_page *page = &scene->pages[p];
        uint64_t instances = 0;
        for (uint64_t i = page->first; i < page->first + page->count; i++) instances += wanted(s, i);
        if (instances == 0) continue;
        r->pages++;
        r->instances += instances;
        if (see_page(s, p) != SEEN) continue;
        seen += instances;
        job j = {.page = p, .instance = WHOLE_PAGE};
        if (svo_buffer_append(jobs, &j, sizeof j) == NULL) return no_memory(err);
    }
    s->by_pages = seen > BY_PAGES;
    if (s->by_pages) return SVO_OK;
    uint64_t pages = jobs->size / sizeof(job);
    svo_buffer each;
    svo_buffer_init(&each, s->o->allocator);
    bool ok = true;
    r->pages_seen = pages;
    for (uint64_t n = 0; n < pages && ok; n++) {
        uint32_t p = ((const job *)(const void *)jobs->data)[n].page;
        const svo_scene_page *page = &scene->pages[p];
        for (uint64_t i = page->first; i < page->first + page->count && ok; i++) {
            job j = {.page = p, .instance = i};
            if (!wanted(s, i)) continue;
            j.top = root_of(scene->assets[scene->instance_asset[i]]);
            ok = svo_buffer_append(&each, &j, sizeof j) != NULL;
        }
    }
    svo_buffer_free(jobs);
    *jobs = each;
    return ok ? SVO_OK : no_memory(err);
}

/* Few instances: cut them, so that all threads have work. Depends on the scene only. */
static svo_result split_jobs(selecting *s, svo_buffer *jobs, svo_error *err)
{
    enum { ENOUGH = 1024, ROUNDS = 5 };
    for (int round = 0; round < ROUNDS && jobs->size / sizeof(job) < ENOUGH && !s->by_pages; round++) {
        svo_buffer more;
        svo_buffer_init(&more, s->o->allocator);
        bool ok = true;
        for (size_t i = 0; i < jobs->size / sizeof(job) && ok; i++) {
            const job *j = (const job *)(const void *)jobs->data + i;
            const svo_view *v = s->scene->assets[s->scene->instance_asset[j->instance]];
            svo_deform d = deform_of(s, j);
            double low[3], high[3];
            if (j->top.level != round || j->top.level + 6u > v->depth ||
                judge(s, &d, j->page, v, bones_of(s, &d, j->instance), &j->top, ldexp(1, (int)(v->depth - j->top.level)), low, high) != DESCEND) {
                ok = svo_buffer_append(&more, j, sizeof *j) != NULL;
                continue;
            }
            visit next[8];
            uint32_t count = children(v, &j->top, next);
            for (uint32_t c = 0; c < count && ok; c++) {
                job part = {next[c], j->page, j->instance};
                ok = svo_buffer_append(&more, &part, sizeof part) != NULL;
            }
        }
        svo_buffer_free(jobs);
        *jobs = more;
        if (!ok) return no_memory(err);
    }
    return SVO_OK;
}

/* ---- all ------------------------------------------------------------------------------------------------------------- */

static void add_report(svo_select_report *to, const svo_select_report *r)
{
    to->pages_seen += r->pages_seen, to->overflowed += r->overflowed, to->visited += r->visited, to->outside += r->outside, to->hidden += r->hidden;
    to->selected += r->selected, to->finest += r->finest;
}

/* Jobs from near to far, so that what is near hides what is far. */
typedef struct nearness { double near; uint64_t job; } nearness;

static int compare_nearness(const void *a, const void *b)
{
    const nearness *x = a, *y = b;
    if (x->near != y->near) return x->near < y->near ? -1 : 1;
    return x->job < y->job ? -1 : x->job > y->job;
}

/* Square of the distance from the eye: of a page's box, or of the middle of a node. */
static double distance_of(const selecting *s, const job *j)
{
    double sum = 0;
    if (j->instance == WHOLE_PAGE) {
        const svo_scene_page *g = &s->scene->pages[j->page];
        for (int k = 0; k < 3; k++) {
            double d = fmax(0, fmax(g->low[k] - s->origin[k], s->origin[k] - g->high[k]));
            sum += d * d;
        }
    } else {
        const svo_view *v = s->scene->assets[s->scene->instance_asset[j->instance]];
        svo_deform d = deform_of(s, j);
        double edge = ldexp(1, (int)(v->depth - j->top.level));
        svo_vec3 at = svo_deform_point(&d, SVO_NO_BONE, svo_v3((j->top.cell[0] + 0.5) * edge, (j->top.cell[1] + 0.5) * edge, (j->top.cell[2] + 0.5) * edge));
        sum = svo_dot(at, at);
    }
    return isfinite(sum) ? sum : INFINITY;
}

static svo_result sort_jobs(const selecting *s, svo_buffer *jobs, svo_error *err)
{
    uint64_t count = jobs->size / sizeof(job);
    const job *from = (const job *)(const void *)jobs->data;
    nearness *order = svo_alloc(s->o->allocator, count, sizeof *order);
    svo_buffer sorted;
    svo_buffer_init(&sorted, s->o->allocator);
    if (count != 0 && (order == NULL || !svo_buffer_reserve(&sorted, jobs->size))) {
        svo_free(s->o->allocator, order, count, sizeof *order);
        return no_memory(err);
    }
    for (uint64_t i = 0; i < count; i++) order[i] = (nearness){distance_of(s, &from[i]), i};
    if (count > 1) qsort(order, count, sizeof *order, compare_nearness);
    for (uint64_t i = 0; i < count; i++) svo_buffer_append(&sorted, &from[order[i].job], sizeof(job));
    svo_free(s->o->allocator, order, count, sizeof *order);
    svo_buffer_free(jobs);
    *jobs = sorted;
    return SVO_OK;
}

/* Cut a node that looks large into parts, so that near parts can hide far ones. */
static svo_result cut(const selecting *s, const job *whole, svo_buffer *to, svo_error *err)
{
    enum { LARGE = 64 }; /* samples */
    const svo_view *v = s->scene->assets[s->scene->instance_asset[whole->instance]];
    svo_deform d = deform_of(s, whole);
    visit stack[8 * SVO_MAX_DEPTH + 8], next[8];
    uint32_t top = 0;
    stack[top++] = whole->top;
    while (top != 0) {
        job part = {stack[--top], whole->page, whole->instance};
        double low[3], high[3], size = 0;
        fate f = judge(s, &d, whole->page, v, bones_of(s, &d, whole->instance), &part.top, ldexp(1, (int)(v->depth - part.top.level)), low, high);
        if (f == OUTSIDE || f == BEHIND) continue;
        if (f == DESCEND) {
            svoi_rect r = svoi_project(&s->look, low, high);
            size = fmax(r.x1 - r.x0, r.y1 - r.y0);
        }
        if (f == DESCEND && size > LARGE && part.top.level + 4u <= v->depth) {
            uint32_t count = children(v, &part.top, next);
            while (count != 0) stack[top++] = next[--count];
        } else if (svo_buffer_append(to, &part, sizeof part) == NULL) return no_memory(err);
    }
    return SVO_OK;
}

/* Pages that look large become their instances, and these their parts. */
static svo_result cut_pages(const selecting *s, const job *pages, uint64_t count, svo_buffer *to, svo_select_report *report, svo_error *err)
{
    for (uint64_t n = 0; n < count; n++) {
        const svo_scene_page *g = &s->scene->pages[pages[n].page];
        if (pages[n].instance != WHOLE_PAGE) {
            SVO_TRY(cut(s, &pages[n], to, err));
            continue;
        }
        double low[3], high[3];
        page_box(s, pages[n].page, low, high);
        svoi_rect r = svoi_project(&s->look, low, high);
        double size = fmax(r.x1 - r.x0, r.y1 - r.y0), apart = sqrt((double)g->count);
        if (size / apart < 24) { /* its instances are small */
            if (svo_buffer_append(to, &pages[n], sizeof pages[n]) == NULL) return no_memory(err);
            continue;
        }
        if (see_page(s, pages[n].page) != SEEN) continue;
        report->pages_seen++;
        for (uint64_t i = g->first; i < g->first + g->count; i++) {
            if (!wanted(s, i)) continue;
            job j = {root_of(s->scene->assets[s->scene->instance_asset[i]]), pages[n].page, i};
            SVO_TRY(cut(s, &j, to, err));
        }
    }
    return SVO_OK;
}

/* From near to far in rounds that grow; the pyramid is that of the rounds before, so the result does not depend on threads. Jobs are replaced by their parts. */
static svo_result run_by_depth(selecting *s, svo_buffer *jobs, svo_buffer *spans, uint32_t threads, svo_select_report *r, svo_error *err)
{
    enum { PAGES_AT_A_TIME = 8 };
    SVO_TRY(sort_jobs(s, jobs, err));
    uint64_t count = jobs->size / sizeof(job), step = s->by_pages ? PAGES_AT_A_TIME : count;
    svo_result result = SVO_OK;
    uint64_t size = 32;
    for (uint64_t n = 0; n < count && result == SVO_OK; n += step) {
        svo_buffer parts;
        svo_buffer_init(&parts, s->o->allocator);
        result = cut_pages(s, (const job *)(const void *)jobs->data + n, count - n < step ? count - n : step, &parts, r, err);
        if (result == SVO_OK) result = sort_jobs(s, &parts, err);
        uint64_t all = parts.size / sizeof(job);
        for (uint64_t first = 0; first < all && result == SVO_OK; first += size) {
            if (first != 0) size += size / 8;
            uint64_t some = all - first < size ? all - first : size;
            span *to = svo_buffer_append(spans, NULL, some * sizeof(span));
            if (to == NULL) result = no_memory(err);
            s->jobs = (const job *)(const void *)parts.data + first, s->spans = to;
            if (result == SVO_OK) result = svo_parallel_for(threads, some, 2, run_jobs, s, err);
            svoi_depth_update(&s->depth);
            r->rounds++;
        }
        svo_buffer_free(&parts);
    }
    return result;
}

static svo_result gather(selecting *s, uint64_t jobs, svo_selection *out, svo_error *err)
{
    uint64_t total = 0, at = 0;
    for (uint64_t i = 0; i < jobs; i++) total += s->spans[i].count;
    if (total >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu deformed voxels are selected, more than 2^32 - 1; a larger --delta selects fewer", (unsigned long long)total);
    out->boxes = svo_alloc(out->allocator, total, sizeof *out->boxes);
    if (out->boxes == NULL && total != 0) return no_memory(err);
    out->count = total;
    uint8_t *seen = svo_calloc(out->allocator, s->scene->instance_count, 1);
    if (seen == NULL && s->scene->instance_count != 0) return no_memory(err);
    for (uint64_t i = 0; i < jobs; i++) {
        const span *p = &s->spans[i];
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
static svo_result make_bones(selecting *s, svo_error *err)
{
    const svo_scene *scene = s->scene;
    s->bones = svo_calloc(s->o->allocator, scene->asset_count, sizeof *s->bones);
    if (s->bones == NULL && scene->asset_count != 0) return no_memory(err);
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
    selecting s = {.scene = scene, .o = o};
    svo_buffer jobs, spans;
    svo_buffer_init(&jobs, o->allocator);
    svo_buffer_init(&spans, o->allocator);
    memset(out, 0, sizeof *out);
    out->allocator = o->allocator;
    s.look = svoi_look_make(&o->eye, o->width, o->height);
    s.origin[0] = o->eye.position.x, s.origin[1] = o->eye.position.y, s.origin[2] = o->eye.position.z;
    memcpy(out->origin, s.origin, sizeof out->origin);
    svo_result result = SVO_OK;
    s.normal_channel = svo_alloc(o->allocator, scene->asset_count, sizeof *s.normal_channel);
    s.outputs = svo_calloc(o->allocator, threads, sizeof *s.outputs);
    if (s.outputs == NULL || (s.normal_channel == NULL && scene->asset_count != 0)) result = no_memory(err);
    for (uint32_t t = 0; t < threads && s.outputs != NULL; t++) svo_buffer_init(&s.outputs[t].boxes, o->allocator);
    for (uint32_t a = 0; a < scene->asset_count && result == SVO_OK; a++) {
        uint32_t c = svo_view_find_channel(scene->assets[a], "normal");
        s.normal_channel[a] = c < scene->assets[a]->channel_count && scene->assets[a]->channels[c].channel.kind == SVO_KIND_NORMAL_OCT32 ? c : SVO_MAX_CHANNELS;
    }
    if (result == SVO_OK && o->occlusion) result = svoi_depth_make(&s.depth, o->width, o->height, o->allocator, err);
    if (result == SVO_OK) result = make_bones(&s, err);
    if (result == SVO_OK) result = svoi_find_copies(scene, o->allocator, &s.copy, err);
    if (result == SVO_OK) result = list_jobs(&s, &jobs, &out->report, err);
    if (result == SVO_OK && !o->occlusion) result = split_jobs(&s, &jobs, err);
    if (result == SVO_OK && o->occlusion) result = run_by_depth(&s, &jobs, &spans, threads, &out->report, err);
    else if (result == SVO_OK && svo_buffer_append(&spans, NULL, jobs.size / sizeof(job) * sizeof(span)) == NULL && jobs.size != 0) result = no_memory(err);
    s.spans = (span *)(void *)spans.data;
    s.jobs = (const job *)(const void *)jobs.data;
    if (result == SVO_OK && !o->occlusion) result = svo_parallel_for(threads, jobs.size / sizeof(job), 0, run_jobs, &s, err);
    if (result == SVO_OK) result = gather(&s, spans.size / sizeof(span), out, err);
    for (uint32_t t = 0; t < threads && s.outputs != NULL; t++) {
        add_report(&out->report, &s.outputs[t].report);
        svo_buffer_free(&s.outputs[t].boxes);
    }
    svo_buffer_free(&spans);
    svo_free(o->allocator, s.outputs, threads, sizeof *s.outputs);
    for (uint32_t a = 0; a < scene->asset_count && s.bones != NULL; a++) svo_bones_free(s.bones[a]);
    svo_free(o->allocator, s.copy, scene->instance_count, 1);
    svo_free(o->allocator, s.bones, scene->asset_count, sizeof *s.bones);
    svo_free(o->allocator, s.normal_channel, scene->asset_count, sizeof *s.normal_channel);
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
