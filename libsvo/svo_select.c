#include "svo_select.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "svo_task.h"

/* A node to look at. */
typedef struct visit {
    svo_view_node node;
    uint32_t cell[3]; /* on its level */
    uint8_t level, full_level; /* full_level: of the full leaf it is in */
} visit;

/* A subtree of an instance: what a thread takes at a time. */
typedef struct job {
    visit top;
    uint32_t page;
    uint64_t instance;
} job;

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
    double axis[3][3];   /* right, up, forward */
    double plane[4][3];  /* of the picture's sides, inside positive */
    double focal;        /* samples at depth 1 */
    uint32_t *normal_channel; /* of each asset */
    const job *jobs;
    span *spans;
    output *outputs;
} selecting;

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the selected voxels"); }

/* ---- a box in the picture -------------------------------------------------------------------------------------------- */

/* False when nothing of it is in the picture; else *size is the longer side of its rectangle in samples (3.2.3), infinite for a box that reaches behind the
 * eye's plane. */
static bool project(const selecting *s, const double low[3], const double high[3], double *size)
{
    double x[8], y[8], z[8], near = INFINITY, far = -INFINITY;
    for (int i = 0; i < 8; i++) {
        double px = i & 1 ? high[0] : low[0], py = i & 2 ? high[1] : low[1], pz = i & 4 ? high[2] : low[2];
        x[i] = s->axis[0][0] * px + s->axis[0][1] * py + s->axis[0][2] * pz;
        y[i] = s->axis[1][0] * px + s->axis[1][1] * py + s->axis[1][2] * pz;
        z[i] = s->axis[2][0] * px + s->axis[2][1] * py + s->axis[2][2] * pz;
    }
    for (int i = 0; i < 8; i++) near = fmin(near, z[i]), far = fmax(far, z[i]);
    if (far <= 0) {
        *size = INFINITY;
        return !s->o->frustum;
    }
    if (s->o->frustum)
        for (int p = 0; p < 4; p++) {
            double most = 0;
            for (int k = 0; k < 3; k++) most += fmax(s->plane[p][k] * low[k], s->plane[p][k] * high[k]);
            if (most < 0) return false;
        }
    *size = INFINITY;
    if (near <= 0) return true;
    double x0 = INFINITY, x1 = -INFINITY, y0 = INFINITY, y1 = -INFINITY;
    for (int i = 0; i < 8; i++) {
        double w = 1 / z[i], u = x[i] * w, v = y[i] * w;
        x0 = fmin(x0, u), x1 = fmax(x1, u), y0 = fmin(y0, v), y1 = fmax(y1, v);
    }
    *size = s->focal * fmax(x1 - x0, y1 - y0);
    return true;
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
    return s->focal * longest / sqrt(near);
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

static bool take(const selecting *s, const svo_deform *d, const svo_view *v, uint64_t instance, const visit *n, const double low[3], const double high[3],
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
        svo_vec3 middle = {(n->cell[0] + 0.5) * edge, (n->cell[1] + 0.5) * edge, (n->cell[2] + 0.5) * edge};
        normal = svo_deform_normal(d, SVO_NO_BONE, middle, edge, svo_v3(f[0], f[1], f[2]));
    }
    if (svo_dot(normal, normal) == 0) normal = svo_normalize(svo_v3(-0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -0.5 * (low[2] + high[2])));
    float f[3] = {(float)normal.x, (float)normal.y, (float)normal.z};
    svo_oct32_encode(f, b.normal);
    out->report.selected++;
    out->report.finest += n->level == v->depth;
    return svo_buffer_append(&out->boxes, &b, sizeof b) != NULL;
}

typedef enum fate { OUTSIDE, TAKE, DESCEND, OVERFLOW } fate;

/* Deform a node and say what is to be done with it. */
static fate judge(const selecting *s, const svo_deform *d, const svo_view *v, const visit *n, double edge, double low[3], double high[3])
{
    double from[3], to[3], size;
    for (int k = 0; k < 3; k++) from[k] = n->cell[k] * edge, to[k] = from[k] + edge;
    svo_deform_box(d, SVO_NO_BONE, from, to, low, high);
    for (int k = 0; k < 3; k++)
        if (!(fabs(low[k]) < 0.5 * FLT_MAX) || !(fabs(high[k]) < 0.5 * FLT_MAX)) return OVERFLOW;
    if (!project(s, low, high, &size)) return OUTSIDE;
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
        switch (judge(s, &d, v, &n, edge, low, high)) {
        case OVERFLOW:
            out->boxes.size = (size_t)first;
            out->report.overflowed++;
            return SVO_OK;
        case OUTSIDE: out->report.outside++; break;
        case TAKE:
            if (!take(s, &d, v, j->instance, &n, low, high, edge, out)) return no_memory(err);
            break;
        case DESCEND: {
            uint32_t count = children(v, &n, next);
            while (count != 0) stack[top++] = next[--count];
        }
        }
    }
    return SVO_OK;
}

static svo_result run_jobs(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    selecting *s = user;
    output *out = &s->outputs[worker];
    for (uint64_t i = begin; i < end; i++) {
        s->spans[i] = (span){worker, out->boxes.size / sizeof(svo_selected), 0};
        SVO_TRY(run_job(s, &s->jobs[i], out, err));
        s->spans[i].count = out->boxes.size / sizeof(svo_selected) - s->spans[i].first;
    }
    return SVO_OK;
}

/* ---- jobs ------------------------------------------------------------------------------------------------------------ */

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

static svo_result list_jobs(selecting *s, svo_buffer *jobs, svo_select_report *r, svo_error *err)
{
    const svo_scene *scene = s->scene;
    double size;
    for (uint32_t p = 0; p < scene->page_count; p++) {
        const svo_scene_page *page = &scene->pages[p];
        double low[3], high[3];
        uint64_t wanted = 0;
        if (s->o->everything) wanted = page->count;
        else if (scene->instance_pose != NULL)
            for (uint64_t i = page->first; i < page->first + page->count; i++) wanted += scene->instance_pose[i] != SVO_NO_POSE;
        if (wanted == 0) continue;
        r->pages++;
        r->instances += wanted;
        for (int k = 0; k < 3; k++) low[k] = page->low[k] - s->origin[k], high[k] = page->high[k] - s->origin[k];
        if (!project(s, low, high, &size)) continue;
        r->pages_seen++;
        for (uint64_t i = page->first; i < page->first + page->count; i++) {
            const svo_view *v = scene->assets[scene->instance_asset[i]];
            if (v->empty || (!s->o->everything && scene->instance_pose[i] == SVO_NO_POSE)) continue;
            job j = {root_of(v), p, i};
            if (svo_buffer_append(jobs, &j, sizeof j) == NULL) return no_memory(err);
        }
    }
    return SVO_OK;
}

/* Few instances: cut them, so that all threads have work. Depends on the scene only. */
static svo_result split_jobs(selecting *s, svo_buffer *jobs, svo_error *err)
{
    enum { ENOUGH = 1024, ROUNDS = 5 };
    for (int round = 0; round < ROUNDS && jobs->size / sizeof(job) < ENOUGH; round++) {
        svo_buffer more;
        svo_buffer_init(&more, s->o->allocator);
        bool ok = true;
        for (size_t i = 0; i < jobs->size / sizeof(job) && ok; i++) {
            const job *j = (const job *)(const void *)jobs->data + i;
            const svo_view *v = s->scene->assets[s->scene->instance_asset[j->instance]];
            svo_deform d = deform_of(s, j);
            double low[3], high[3];
            if (j->top.level != round || j->top.level + 6u > v->depth ||
                judge(s, &d, v, &j->top, ldexp(1, (int)(v->depth - j->top.level)), low, high) != DESCEND) {
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
    to->overflowed += r->overflowed, to->visited += r->visited, to->outside += r->outside;
    to->selected += r->selected, to->finest += r->finest;
}

static void look(selecting *s)
{
    const svo_select_options *o = s->o;
    const svo_vec3 axes[3] = {o->eye.right, o->eye.up, o->eye.forward};
    for (int i = 0; i < 3; i++) s->axis[i][0] = axes[i].x, s->axis[i][1] = axes[i].y, s->axis[i][2] = axes[i].z;
    double ty = tan(0.5 * o->eye.yfov), tx = ty * o->width / o->height;
    for (int k = 0; k < 3; k++) {
        s->plane[0][k] = s->axis[0][k] + tx * s->axis[2][k];
        s->plane[1][k] = -s->axis[0][k] + tx * s->axis[2][k];
        s->plane[2][k] = s->axis[1][k] + ty * s->axis[2][k];
        s->plane[3][k] = -s->axis[1][k] + ty * s->axis[2][k];
    }
    s->focal = 0.5 * o->height / ty;
    s->origin[0] = o->eye.position.x, s->origin[1] = o->eye.position.y, s->origin[2] = o->eye.position.z;
}

static svo_result gather(selecting *s, uint64_t jobs, svo_selection *out, svo_error *err)
{
    uint64_t total = 0, at = 0;
    for (uint64_t i = 0; i < jobs; i++) total += s->spans[i].count;
    if (total >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu deformed voxels are selected, more than 2^32 - 1; a larger --delta selects fewer", (unsigned long long)total);
    out->boxes = svo_alloc(out->allocator, total, sizeof *out->boxes);
    if (out->boxes == NULL && total != 0) return no_memory(err);
    out->count = total;
    uint64_t seen = 0, last = UINT64_MAX;
    for (uint64_t i = 0; i < jobs; i++) {
        const span *p = &s->spans[i];
        memcpy(out->boxes + at, (const svo_selected *)(const void *)s->outputs[p->worker].boxes.data + p->first, p->count * sizeof *out->boxes);
        at += p->count;
        if (p->count != 0 && s->jobs[i].instance != last) seen++, last = s->jobs[i].instance;
    }
    out->report.instances_seen = seen;
    return SVO_OK;
}

svo_result svo_select(const svo_scene *scene, const svo_select_options *o, svo_selection *out, svo_error *err)
{
    SVO_ASSERT(o->width > 0 && o->height > 0 && o->delta > 0);
    double began = svo_seconds();
    uint32_t threads = o->threads != 0 ? o->threads : svo_processor_count();
    selecting s = {.scene = scene, .o = o};
    svo_buffer jobs;
    svo_buffer_init(&jobs, o->allocator);
    memset(out, 0, sizeof *out);
    out->allocator = o->allocator;
    look(&s);
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
    if (result == SVO_OK) result = list_jobs(&s, &jobs, &out->report, err);
    if (result == SVO_OK) result = split_jobs(&s, &jobs, err);
    uint64_t count = jobs.size / sizeof(job);
    s.jobs = (const job *)(const void *)jobs.data;
    s.spans = svo_alloc(o->allocator, count, sizeof *s.spans);
    if (result == SVO_OK && s.spans == NULL && count != 0) result = no_memory(err);
    if (result == SVO_OK) result = svo_parallel_for(threads, count, 0, run_jobs, &s, err);
    if (result == SVO_OK) result = gather(&s, count, out, err);
    for (uint32_t t = 0; t < threads && s.outputs != NULL; t++) {
        add_report(&out->report, &s.outputs[t].report);
        svo_buffer_free(&s.outputs[t].boxes);
    }
    svo_free(o->allocator, s.spans, count, sizeof *s.spans);
    svo_free(o->allocator, s.outputs, threads, sizeof *s.outputs);
    svo_free(o->allocator, s.normal_channel, scene->asset_count, sizeof *s.normal_channel);
    svo_buffer_free(&jobs);
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
