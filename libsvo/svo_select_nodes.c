/* From the top of a subtree down: deform a node, look where it is in the picture, take it, leave it out or go on with its children. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "svoi_select_jobs.h"

/* ---- a box in the picture -------------------------------------------------------------------------------------------- */

/* Hidden where all samples of its rectangle show something nearer. */
static bool is_hidden(const svoi_selecting *s, const svoi_rect *r)
{
    if (r->near <= 0) return false;
    const svoi_span samples = svoi_samples(&s->look, r);
    return svoi_depth_hides(&s->depth, &samples, r->near * (1 - 1e-6));
}

double svoi_overhang(const double overhang[2], const double low[3], const double high[3], double *longest)
{
    double shortest = INFINITY;
    *longest = 0;
    for (int k = 0; k < 3; k++) {
        const double side = high[k] - low[k];
        shortest = side < shortest ? side : shortest, *longest = side > *longest ? side : *longest;
    }
    return overhang[0] * shortest + overhang[1] * *longest;
}

/* *size is the longer side of its rectangle in samples (3.2.3), infinite for a box that reaches behind the eye's plane. What is out of sight or hidden is so with all that the cells made of it
 * can cover. */
static svoi_sight project(const svoi_selecting *s, const double low[3], const double high[3], double *size, svoi_place *place)
{
    svoi_rect r = place->box = svoi_project(&s->look, low, high);
    double longest, l[3], h[3];
    *size = r.x1 - r.x0 > r.y1 - r.y0 ? r.x1 - r.x0 : r.y1 - r.y0;
    if (s->o->overhang[0] > 0 || s->o->overhang[1] > 0) {
        const double over = svoi_overhang(s->o->overhang, low, high, &longest);
        for (int k = 0; k < 3; k++) l[k] = low[k] - over, h[k] = high[k] + over;
        low = l, high = h;
        r = svoi_project(&s->look, l, h);
    }
    place->reach = r;
    if (s->o->frustum && (r.far <= 0 || svoi_outside(&s->look, low, high))) return SVOI_OUT_OF_SIGHT;
    if (s->o->occlusion && is_hidden(s, &r)) return SVOI_HIDDEN;
    return SVOI_SEEN;
}

double svoi_size_at_distance(const svoi_selecting *s, const double low[3], const double high[3])
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
static bool at_surface(const svoi_visit *n)
{
    uint32_t mask = (1u << (n->level - n->full_level)) - 1;
    for (int k = 0; k < 3; k++) {
        uint32_t local = n->cell[k] & mask;
        if (local == 0 || local == mask) return true;
    }
    return false;
}

uint32_t svoi_children(const svo_view *v, const svoi_visit *n, svoi_visit out[8])
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
        svoi_visit *c = &out[count];
        *c = (svoi_visit){.level = (uint8_t)(n->level + 1), .full_level = n->full_level};
        for (uint32_t k = 0; k < 3; k++) c->cell[k] = 2 * n->cell[k] + (octant >> k & 1);
        if (n->node.full) {
            c->node = n->node;
            if (!at_surface(c)) continue;
        } else if (octant_of_brick) { /* voxels: with lod the octant's own attribute comes first */
            uint32_t before = (uint32_t)__builtin_popcount((uint32_t)n->node.at & ((1u << octant) - 1));
            c->node.attribute = v->unnumbered ? 0 : svo_average_first(n->node.attribute) + (svo_view_brick_lod(v) ? 1 : 0) + before;
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

static double edge_of(const svoi_posed *p, const svoi_visit *n) { return (double)((uint64_t)1 << (p->view->depth - n->level)); }

/* Is nothing behind the node to be seen through it? */
static bool covers(const svoi_selecting *s, const svoi_posed *p, uint64_t attribute)
{
    const uint32_t channel = s->coverage_channel[s->scene->instance_asset[p->instance]];
    uint8_t value[SVO_MAX_STRIDE];
    if (channel == SVO_MAX_CHANNELS) return true;
    svo_view_attribute(p->view, channel, attribute, value);
    return value[0] == svoi_covers;
}

/* A box in the depths of all and of its job. */
typedef struct drawn { const svoi_selecting *s; svoi_own_depth *own; } drawn;
static void add_depth(void *user, uint32_t x, uint32_t y, float depth, float leave)
{
    const drawn *d = user;
    const svoi_span *own = &d->own->span;
    if (x >= own->x0 && x < own->x1 && y >= own->y0 && y < own->y1) {
        float *nearest = &d->own->nearest[(uint64_t)y * d->s->look.width + x];
        if (!(depth < *nearest)) return; /* nor is it the nearest of all */
        *nearest = depth;
    }
    svoi_depth_add((void *)&d->s->depth, x, y, depth, leave);
}

enum { OWN_SMALL = 16, OWN_TEXEL = 8 };
/* Forget the job before. The samples of `r` and those of texels that reach beyond it; none for what reaches behind the eye. */
static void begin_own(const svoi_selecting *s, const svoi_rect *r, svoi_own_depth *own)
{
    own->span = (svoi_span){0, 0, 0, 0};
    if (own->nearest == NULL || r->near <= 0) return;
    const double around = OWN_TEXEL;
    svoi_rect wide = {r->x0 - around, r->y0 - around, r->x1 + around, r->y1 + around, r->near, r->far};
    own->span = svoi_samples(&s->look, &wide);
    for (uint32_t y = own->span.y0; y < own->span.y1; y++)
        for (uint32_t x = own->span.x0; x < own->span.x1; x++) own->nearest[(uint64_t)y * s->look.width + x] = INFINITY;
}

/* Is it behind what its own job has drawn, with the texels that it has when drawn by mipmaps? Only small ones are looked at; parts of large ones will be small. */
static bool hides_itself(const svoi_selecting *s, const svoi_own_depth *own, const svoi_rect *r)
{
    if (r->near <= 0) return false;
    svoi_span a = svoi_samples(&s->look, r);
    const svoi_span *b = &own->span;
    const uint32_t size = a.x1 - a.x0 > a.y1 - a.y0 ? a.x1 - a.x0 : a.y1 - a.y0;
    if (a.x0 >= a.x1 || a.y0 >= a.y1 || size > OWN_SMALL) return false;
    const uint32_t rest = (size > 8 ? 8 : size > 4 ? 4 : size > 2 ? 2 : 1) - 1; /* of a texel */
    a.x0 &= ~rest, a.y0 &= ~rest, a.x1 = (a.x1 + rest) & ~rest, a.y1 = (a.y1 + rest) & ~rest;
    a.x1 = a.x1 < s->look.width ? a.x1 : s->look.width, a.y1 = a.y1 < s->look.height ? a.y1 : s->look.height;
    if (a.x0 < b->x0 || a.y0 < b->y0 || a.x1 > b->x1 || a.y1 > b->y1) return false;
    const double near = r->near * (1 - 1e-6);
    for (uint32_t y = a.y0; y < a.y1; y++)
        for (uint32_t x = a.x0; x < a.x1; x++)
            if (!(near > (double)own->nearest[(uint64_t)y * s->look.width + x])) return false;
    return true;
}

static bool take(const svoi_selecting *s, const svoi_posed *p, const svoi_visit *n, const double low[3], const double high[3], const svoi_rect *rect, svoi_output *out)
{
    const uint64_t attribute = p->view->depth >= 2 ? svo_view_node_attribute(p->view, n->level, n->node) : n->node.attribute;
    svo_selected b = {.instance = (uint32_t)p->instance, .attribute = attribute};
    for (int k = 0; k < 3; k++) b.low[k] = (float)low[k], b.high[k] = (float)high[k]; /* exactly */
    const uint32_t asset = s->scene->instance_asset[p->instance], channel = s->normal_channel[asset];
    const double edge = edge_of(p, n);
    const svo_bone_list list = p->bones != NULL ? svo_bones_at(p->bones, n->level, n->cell) : (svo_bone_list){&resting, 1};
    const svo_vec3 middle = {(n->cell[0] + 0.5) * edge, (n->cell[1] + 0.5) * edge, (n->cell[2] + 0.5) * edge};
    svo_vec3 stored = {0, 0, 0}, normal = {0, 0, 0};
    if (channel != SVO_MAX_CHANNELS) {
        uint8_t value[SVO_MAX_STRIDE];
        float f[3];
        svo_view_attribute(p->view, channel, attribute, value);
        svo_oct32_decode(value, f);
        stored = svo_v3(f[0], f[1], f[2]);
        normal = svo_deform_blended_normal(&p->map, list, middle, edge, stored);
    }
    if (s->coverage_channel[asset] != SVO_MAX_CHANNELS)
        b.area = (float)svo_deform_blended_area(&p->map, list, middle, edge, stored, p->view->surface == SVO_SURFACE_THIN);
    if (svo_dot(normal, normal) == 0) normal = svo_normalize(svo_v3(-0.5 * (low[0] + high[0]), -0.5 * (low[1] + high[1]), -0.5 * (low[2] + high[2])));
    float f[3] = {(float)normal.x, (float)normal.y, (float)normal.z};
    svo_oct32_encode(f, b.normal);
    out->report.selected++;
    out->report.finest += n->level == p->view->depth;
    if (s->o->occlusion && rect->far > 0 && covers(s, p, attribute)) {
        const svoi_span samples = svoi_samples(&s->look, rect);
        drawn d = {s, &out->own};
        svoi_draw_span(&s->look, low, high, &samples, add_depth, &d);
    }
    return svo_buffer_append(&out->boxes, &b, sizeof b) != NULL;
}

/* To single precision, outwards: what is judged is then the box that is drawn, to the last bit. (Without branches: a step more than is needed.) */
static void round_outwards(double low[3], double high[3])
{
    for (int k = 0; k < 3; k++) {
        low[k] = (float)(low[k] - 0x1p-23 * fabs(low[k]) - (double)FLT_MIN);
        high[k] = (float)(high[k] + 0x1p-23 * fabs(high[k]) + (double)FLT_MIN);
    }
}

void svoi_page_box(const svoi_selecting *s, uint32_t page, double low[3], double high[3])
{
    const svo_scene_page *g = &s->scene->pages[page];
    for (int k = 0; k < 3; k++) {
        const double a = fabs(g->low[k]), b = fabs(g->high[k]), slack = 1e-9 * (a > b ? a : b);
        low[k] = g->low[k] - s->origin[k] - slack, high[k] = g->high[k] - s->origin[k] + slack;
    }
}

/* The images of all points of a node are in its box and in the page's, so its box is cut to that: what a page that is not seen leaves out is then the same as what its
 * nodes would. */
svoi_fate svoi_judge(const svoi_selecting *s, const svoi_posed *p, const svoi_visit *n, double low[3], double high[3], svoi_place *place)
{
    double from[3], to[3], size, edge = edge_of(p, n);
    for (int k = 0; k < 3; k++) from[k] = n->cell[k] * edge, to[k] = from[k] + edge;
    if (p->bones != NULL) svo_deform_blended_box(&p->map, svo_bones_at(p->bones, n->level, n->cell), from, to, low, high);
    else svo_deform_box(&p->map, SVO_NO_BONE, from, to, low, high);
    for (int k = 0; k < 3; k++)
        if (!(fabs(low[k]) < 0.5 * FLT_MAX) || !(fabs(high[k]) < 0.5 * FLT_MAX)) return SVOI_OVERFLOW;
    svoi_page_box(s, p->page, from, to);
    for (int k = 0; k < 3; k++) {
        low[k] = low[k] > from[k] ? low[k] : from[k], high[k] = high[k] < to[k] ? high[k] : to[k];
        if (low[k] > high[k]) return SVOI_OUTSIDE;
    }
    round_outwards(low, high);
    svoi_sight seen = project(s, low, high, &size, place);
    if (seen != SVOI_SEEN && !svoi_can_shade(s->o, low, high)) return seen == SVOI_HIDDEN ? SVOI_BEHIND : SVOI_OUTSIDE;
    if (n->level >= p->view->depth) return SVOI_TAKE;
    if (s->o->whole) return high[0] - low[0] <= s->o->edge && high[1] - low[1] <= s->o->edge && high[2] - low[2] <= s->o->edge ? SVOI_TAKE : SVOI_DESCEND;
    if (size == INFINITY) size = svoi_size_at_distance(s, low, high);
    return size < s->o->delta ? SVOI_TAKE : SVOI_DESCEND;
}

svoi_posed svoi_posed_make(const svoi_selecting *s, uint32_t page, uint64_t instance)
{
    const svo_scene *scene = s->scene;
    uint32_t asset = scene->instance_asset[instance];
    svoi_posed p = {.view = scene->assets[asset], .page = page, .instance = instance};
    svo_mat4 grid, place = svo_scene_instance_transform(scene, page, instance);
    memcpy(grid.m, p.view->voxel_to_world, sizeof grid.m);
    for (int k = 0; k < 3; k++) place.m[4 * k + 3] -= s->origin[k];
    p.map = svo_deform_make(&scene->poses, svo_scene_instance_pose(scene, instance), &grid, &place);
    if ((p.map.flags & SVO_POSE_BONES) != 0) p.bones = s->bones[asset];
    return p;
}

/* A node that has been judged. */
typedef struct judged {
    svoi_visit n;
    double low[3], high[3];
    svoi_place place;
    bool take;
} judged;

/* Judge nodes and push those that are left, the nearest last. False: one overflows. */
static bool push(const svoi_selecting *s, const svoi_posed *p, const svoi_visit *nodes, uint32_t count, judged *stack, uint32_t *top, svoi_output *out)
{
    const uint32_t first = *top;
    for (uint32_t i = 0; i < count; i++) {
        judged j = {.n = nodes[i]};
        out->report.visited++;
        const svoi_fate fate = svoi_judge(s, p, &j.n, j.low, j.high, &j.place);
        if (fate == SVOI_OVERFLOW) return false;
        out->report.outside += fate == SVOI_OUTSIDE;
        out->report.hidden += fate == SVOI_BEHIND;
        if (fate != SVOI_TAKE && fate != SVOI_DESCEND) continue;
        j.take = fate == SVOI_TAKE;
        uint32_t at = (*top)++;
        for (; at > first && stack[at - 1].place.box.near < j.place.box.near; at--) stack[at] = stack[at - 1];
        stack[at] = j;
    }
    return true;
}

/* From near to far, so that what is near hides what is behind it. of_page: the thread's own depths are those of a whole page and stay; else they begin with this job. */
static svo_result run_job(const svoi_selecting *s, const svoi_job *j, bool of_page, svoi_output *out, svo_error *err)
{
    svoi_posed p = svoi_posed_make(s, j->page, j->instance);
    judged stack[8 * SVO_MAX_DEPTH + 8];
    svoi_visit next[8];
    uint32_t top = 0;
    uint64_t first = out->boxes.size;
    out->slices.map++;
    p.map.kept = &out->slices;
    bool finite = push(s, &p, &j->top, 1, stack, &top, out);
    if (s->o->occlusion && !of_page && top != 0) begin_own(s, &stack[0].place.reach, &out->own);
    while (top != 0 && finite) {
        const judged n = stack[--top];
        if (s->o->occlusion && hides_itself(s, &out->own, &n.place.reach) && !svoi_can_shade(s->o, n.low, n.high)) {
            out->report.hidden++;
        } else if (n.take) {
            if (!take(s, &p, &n.n, n.low, n.high, &n.place.box, out)) return svoi_select_no_memory(err);
        } else {
            const uint32_t count = svoi_children(p.view, &n.n, next);
            finite = push(s, &p, next, count, stack, &top, out);
        }
    }
    if (finite) return SVO_OK;
    out->boxes.size = (size_t)first;
    out->report.overflowed++;
    return SVO_OK;
}

/* Levels above the root of an octree of depth 0 or 1 are virtual: begin at its root all the same. */
svoi_visit svoi_root_of(const svo_view *v)
{
    svoi_visit n = {.node = svo_view_root(v)};
    if (v->depth >= 2) return n;
    uint64_t brick = svo_view_brick(v, n.node);
    if (v->depth == 0) n.node.attribute = svo_view_brick_voxel(v, n.node, brick, 0);
    else n.node.attribute = svo_view_brick_octant(v, n.node, brick, 0), n.node.at = brick & 0xff;
    return n;
}

bool svoi_wanted(const svoi_selecting *s, uint64_t instance)
{
    const svo_scene *scene = s->scene;
    return !s->copy[instance] && !scene->assets[scene->instance_asset[instance]]->empty && (s->o->everything || svo_scene_instance_pose(scene, instance) != NULL);
}

svoi_sight svoi_see_page(const svoi_selecting *s, uint32_t page)
{
    double low[3], high[3], size;
    svoi_place place;
    svoi_page_box(s, page, low, high);
    round_outwards(low, high);
    const svoi_sight seen = project(s, low, high, &size, &place);
    return seen != SVOI_SEEN && svoi_can_shade(s->o, low, high) ? SVOI_SEEN : seen;
}

static svo_result run_page(const svoi_selecting *s, uint32_t page, svoi_output *out, svo_error *err)
{
    const svo_scene_page *g = &s->scene->pages[page];
    if (svoi_see_page(s, page) != SVOI_SEEN) return SVO_OK;
    out->report.pages_seen++;
    if (s->o->occlusion) {
        double low[3], high[3];
        svoi_page_box(s, page, low, high);
        const svoi_rect r = svoi_project(&s->look, low, high);
        begin_own(s, &r, &out->own);
    }
    for (uint64_t i = g->first; i < g->first + g->count; i++) {
        if (!svoi_wanted(s, i)) continue;
        svoi_job j = {svoi_root_of(s->scene->assets[s->scene->instance_asset[i]]), page, i};
        SVO_TRY(run_job(s, &j, true, out, err));
    }
    return SVO_OK;
}

svo_result svoi_run_jobs(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    svoi_selecting *s = user;
    svoi_output *out = &s->outputs[worker];
    for (uint64_t i = begin; i < end; i++) {
        s->spans[i] = (svoi_job_span){worker, out->boxes.size / sizeof(svo_selected), 0};
        SVO_TRY(s->jobs[i].instance == SVOI_WHOLE_PAGE ? run_page(s, s->jobs[i].page, out, err) : run_job(s, &s->jobs[i], false, out, err));
        s->spans[i].count = out->boxes.size / sizeof(svo_selected) - s->spans[i].first;
    }
    return SVO_OK;
}
