#include "skel_bind.h"

#include <math.h>
#include <string.h>

#include "skeli_internal.h"
#include "svo_task.h"

/* --- nearest surface sample: a balanced k-d tree in one array --------------------------------------------------------- */

/* The tree of [begin, end) has its root in the middle, smaller coordinates on `axis` before it. */
struct skel_binder {
    const svo_allocator *allocator;
    const skel_skeleton *s;
    uint64_t count;
    uint32_t *order; /* sample numbers */
    uint8_t *axis;   /* of the node at this place */
    uint32_t *start, *bone; /* bones of each joint */
};

static bool sample_before(const skel_skeleton *s, uint32_t a, uint32_t b, uint32_t axis)
{
    double x = s->samples[3 * (uint64_t)a + axis], y = s->samples[3 * (uint64_t)b + axis];
    return x < y || (x == y && a < b);
}

static void select_middle(const skel_skeleton *s, uint32_t *order, uint64_t begin, uint64_t end, uint32_t axis)
{
    const uint64_t middle = begin + (end - begin) / 2;
    while (end - begin > 1) { /* quickselect; keys are distinct, the pivot is the median of three */
        uint32_t a = order[begin], b = order[begin + (end - begin) / 2], c = order[end - 1];
        uint32_t pivot = sample_before(s, a, b, axis) ? (sample_before(s, b, c, axis) ? b : sample_before(s, a, c, axis) ? c : a)
                                                      : (sample_before(s, a, c, axis) ? a : sample_before(s, b, c, axis) ? c : b);
        uint64_t i = begin, j = end - 1;
        for (;;) {
            while (sample_before(s, order[i], pivot, axis)) i++;
            while (sample_before(s, pivot, order[j], axis)) j--;
            if (i >= j) break;
            uint32_t t = order[i];
            order[i++] = order[j];
            order[j--] = t;
            if (i > j) break;
        }
        /* [begin, i) <= pivot <= [i, end), or the pivot is at i == j */
        if (i == j && order[i] == pivot) {
            if (middle == i) return;
            if (middle < i) end = i;
            else begin = i + 1;
        } else if (middle < i) {
            end = i;
        } else {
            begin = i;
        }
    }
}

typedef struct span { uint64_t begin, end; } span;
enum { STACK = 80 }; /* a tree of 2^32 samples has 32 levels */

static void build_tree(skel_binder *b)
{
    span stack[STACK];
    uint32_t top = 0;
    stack[top++] = (span){0, b->count};
    while (top > 0) {
        span n = stack[--top];
        if (n.end - n.begin == 0) continue;
        double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
        for (uint64_t i = n.begin; i < n.end; i++)
            for (int k = 0; k < 3; k++) {
                double x = b->s->samples[3 * (uint64_t)b->order[i] + (uint64_t)k];
                low[k] = fmin(low[k], x);
                high[k] = fmax(high[k], x);
            }
        uint8_t axis = 0;
        for (uint8_t k = 1; k < 3; k++)
            if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
        select_middle(b->s, b->order, n.begin, n.end, axis);
        uint64_t middle = n.begin + (n.end - n.begin) / 2;
        b->axis[middle] = axis;
        stack[top++] = (span){n.begin, middle};
        stack[top++] = (span){middle + 1, n.end};
    }
}

static uint32_t nearest_sample(const skel_binder *b, const double *p, double *distance2)
{
    struct { span n; double reach; } stack[STACK]; /* reach: squared distance of the subtree's side of its plane, at least */
    uint32_t top = 0, best = SVO_NONE;
    double best2 = INFINITY;
    stack[top].n = (span){0, b->count};
    stack[top++].reach = 0;
    while (top > 0) {
        span n = stack[--top].n;
        if (stack[top].reach > best2) continue;
        while (n.end > n.begin) {
            uint64_t middle = n.begin + (n.end - n.begin) / 2;
            uint32_t i = b->order[middle], axis = b->axis[middle];
            const double *q = b->s->samples + 3 * (uint64_t)i;
            double x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2], d2 = x * x + y * y + z * z, side = p[axis] - q[axis];
            if (d2 < best2 || (d2 == best2 && i < best)) {
                best2 = d2;
                best = i;
            }
            span near = {n.begin, middle}, far = {middle + 1, n.end};
            if (side > 0) {
                span t = near;
                near = far;
                far = t;
            }
            if (far.end > far.begin && side * side <= best2) {
                stack[top].n = far;
                stack[top++].reach = side * side;
            }
            n = near;
        }
    }
    *distance2 = best2;
    return best;
}

/* --- the bone of a point ---------------------------------------------------------------------------------------------- */

svo_result skel_binder_create(const skel_skeleton *s, const svo_allocator *a, skel_binder **out, svo_error *err)
{
    if (s->sample_count == 0) return svo_fail(err, SVO_INVALID_ARGUMENT, "the skeleton has no surface samples (keep_samples)");
    skel_binder *b = svo_calloc(a, 1, sizeof *b);
    if (b == NULL) return skeli_no_memory(err);
    b->allocator = a;
    b->s = s;
    b->count = s->sample_count;
    b->order = svo_alloc(a, b->count, sizeof *b->order);
    b->axis = svo_alloc(a, b->count, sizeof *b->axis);
    b->start = svo_calloc(a, (uint64_t)s->joint_count + 2, sizeof *b->start);
    b->bone = svo_alloc(a, 2 * (uint64_t)s->bone_count + 1, sizeof *b->bone);
    if (b->order == NULL || b->axis == NULL || b->start == NULL || b->bone == NULL) {
        skel_binder_free(b);
        return skeli_no_memory(err);
    }
    for (uint64_t i = 0; i < b->count; i++) b->order[i] = (uint32_t)i;
    build_tree(b);
    for (uint32_t i = 0; i < s->bone_count; i++) {
        b->start[s->bones[i].a + 2]++;
        b->start[s->bones[i].b + 2]++;
    }
    for (uint32_t j = 0; j < s->joint_count; j++) b->start[j + 2] += b->start[j + 1];
    for (uint32_t i = 0; i < s->bone_count; i++) {
        b->bone[b->start[s->bones[i].a + 1]++] = i;
        b->bone[b->start[s->bones[i].b + 1]++] = i;
    }
    *out = b;
    return SVO_OK;
}

void skel_binder_free(skel_binder *b)
{
    if (b == NULL) return;
    svo_free(b->allocator, b->order, b->count, sizeof *b->order);
    svo_free(b->allocator, b->axis, b->count, sizeof *b->axis);
    svo_free(b->allocator, b->start, (uint64_t)b->s->joint_count + 2, sizeof *b->start);
    svo_free(b->allocator, b->bone, 2 * (uint64_t)b->s->bone_count + 1, sizeof *b->bone);
    svo_free(b->allocator, b, 1, sizeof *b);
}

uint32_t skel_binder_bone(const skel_binder *b, const double point[3], double *distance)
{
    double d2, nearest = INFINITY, foot;
    uint32_t joint = b->s->sample_joint[nearest_sample(b, point, &d2)], best = SVO_NONE;
    if (distance != NULL) *distance = sqrt(d2);
    for (uint32_t k = b->start[joint]; k < b->start[joint + 1]; k++) {
        skel_bone bone = b->s->bones[b->bone[k]];
        double d = skeli_segment_distance(point, b->s->joints[bone.a].position, b->s->joints[bone.b].position, &foot);
        if (d < nearest || best == SVO_NONE) {
            nearest = d;
            best = b->bone[k];
        }
    }
    return best;
}

/* --- octrees ----------------------------------------------------------------------------------------------------------- */

svo_result skel_bind_info(const skel_skeleton *s, const svo_tree_info *from, svo_tree_info *out, svo_error *err)
{
    *out = *from;
    out->channel_count = 0;
    memset(out->channels, 0, sizeof out->channels);
    for (uint32_t c = 0; c < from->channel_count; c++)
        if (strcmp(from->channels[c].name, "bone") != 0) out->channels[out->channel_count++] = from->channels[c];
    if (out->channel_count == SVO_MAX_CHANNELS) return svo_fail(err, SVO_LIMIT, "the octree has %u channels already, there is no room for the bones", SVO_MAX_CHANNELS);
    svo_channel *bone = &out->channels[out->channel_count++];
    memcpy(bone->name, "bone", 5);
    bone->kind = s->bone_count < UINT16_MAX ? SVO_KIND_ID16 : SVO_KIND_ID32;
    return SVO_OK;
}

typedef struct binding {
    const skel_binder *b;
    const svo_tree_info *from, *info;
    const svo_chunk_source *source;
    const svo_chunk_sink *sink;
    const svo_allocator *allocator;
    skel_bind_report *report;
    uint8_t *used; /* of each bone, set by commit */
    double voxel;  /* edge of a voxel in the model's coordinates */
    bool has_previous;
    uint64_t previous;
} binding;

typedef struct item {
    const binding *owner;
    svo_buffer packed, storage, bones, used;
    void *blob;
    bool has_blob;
    svo_tree_counts counts;
    uint64_t first;
    uint32_t level;
    uint64_t unbound;
    double sum, most;
} item;

static svo_result produce(void *user, void *slot, bool *more, svo_error *err)
{
    binding *u = user;
    item *it = slot;
    if (it->owner == NULL) {
        it->owner = u;
        svo_buffer *const buffers[] = {&it->packed, &it->storage, &it->bones, &it->used};
        for (int i = 0; i < 4; i++) svo_buffer_init(buffers[i], u->allocator);
    }
    it->has_blob = false;
    return u->source->fetch(u->source->user, &it->packed, more, err);
}

typedef struct valued { const binding *u; item *it; uint32_t stride; } valued;

static bool bind_value(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    valued *v = user;
    const double *m = v->u->from->voxel_to_world;
    double half = 0.5 * size, c[3], p[3], distance;
    for (int k = 0; k < 3; k++) c[k] = low[k] + half;
    for (int k = 0; k < 3; k++) p[k] = m[4 * k] * c[0] + m[4 * k + 1] * c[1] + m[4 * k + 2] * c[2] + m[4 * k + 3];
    uint32_t bone = skel_binder_bone(v->u->b, p, &distance);
    uint8_t *to = v->it->bones.data + index * v->stride;
    for (uint32_t k = 0; k < v->stride; k++) to[k] = (uint8_t)(bone >> 8 * k);
    if (bone == SVO_NONE) v->it->unbound++;
    else v->it->used.data[bone] = 1;
    v->it->sum += distance;
    if (distance > v->it->most) v->it->most = distance;
    return true;
}

static svo_result work(void *user, void *slot, uint32_t worker, svo_error *err)
{
    binding *u = user;
    item *it = slot;
    svo_chunk from, chunk;
    SVO_TRY(u->source->decode(u->source->user, &it->packed, &it->storage, &from, err));
    const uint32_t last = u->info->channel_count - 1, stride = svo_channel_stride(u->info->channels[last].kind);
    it->counts = (svo_tree_counts){0};
    it->first = svo_chunk_first(&from);
    it->level = from.level;
    it->unbound = 0;
    it->sum = it->most = 0;
    it->bones.size = it->used.size = 0;
    if (svo_buffer_append(&it->bones, NULL, from.value_count * stride) == NULL || svo_buffer_append(&it->used, NULL, (size_t)u->b->s->bone_count + 1) == NULL)
        return skeli_no_memory(err);
    valued v = {u, it, stride};
    svo_chunk_values(&from, bind_value, &v);
    chunk = from;
    memset(chunk.channels, 0, sizeof chunk.channels);
    for (uint32_t c = 0, n = 0; c < u->from->channel_count; c++)
        if (strcmp(u->from->channels[c].name, "bone") != 0) chunk.channels[n++] = from.channels[c];
    chunk.channels[last] = it->bones.data;
    SVO_TRY(svo_chunk_check(u->info, &chunk, &it->counts, err));
    SVO_TRY(u->sink->encode(u->sink->user, &chunk, worker, &it->blob, err));
    it->has_blob = true;
    return SVO_OK;
}

static svo_result commit(void *user, void *slot, svo_error *err)
{
    binding *u = user;
    item *it = slot;
    skel_bind_report *r = u->report;
    svo_counts_ancestors(&r->counts, svo_chunk_level(u->info->depth), it->level, u->has_previous, u->previous, it->first);
    svo_counts_add(&r->counts, &it->counts);
    u->has_previous = true;
    u->previous = it->first;
    for (uint32_t i = 0; i < u->b->s->bone_count; i++) u->used[i] |= it->used.data[i];
    r->unbound += it->unbound;
    r->distance_mean += it->sum / u->voxel; /* the sum until the end */
    if (it->most / u->voxel > r->distance_max) r->distance_max = it->most / u->voxel;
    it->has_blob = false;
    return u->sink->commit(u->sink->user, it->blob, err);
}

static void destroy(void *user, void *slot)
{
    binding *u = user;
    item *it = slot;
    if (it->owner == NULL) return;
    if (it->has_blob) u->sink->discard(u->sink->user, it->blob);
    svo_buffer_free(&it->packed);
    svo_buffer_free(&it->storage);
    svo_buffer_free(&it->bones);
    svo_buffer_free(&it->used);
}

svo_result skel_bind_octree(const skel_binder *b, const svo_tree_info *from, const svo_chunk_source *source, const svo_tree_info *info, const svo_chunk_sink *sink,
                            uint32_t threads, const svo_allocator *a, skel_bind_report *report, svo_error *err)
{
    skel_bind_report unused;
    if (report == NULL) report = &unused;
    *report = (skel_bind_report){0};
    binding u = {.b = b, .from = from, .info = info, .source = source, .sink = sink, .allocator = a, .report = report};
    svo_mat4 to_world;
    memcpy(to_world.m, from->voxel_to_world, sizeof to_world.m);
    u.voxel = cbrt(fabs(svo_mat4_det3(&to_world)));
    if (!(u.voxel > 0) || !isfinite(u.voxel)) u.voxel = 1; /* beyond what cubes of doubles hold */
    u.used = svo_calloc(a, (uint64_t)b->s->bone_count + 1, 1);
    if (u.used == NULL) return skeli_no_memory(err);
    svo_pipeline p = {.threads = threads, .item_size = sizeof(item), .user = &u, .produce = produce, .work = work, .commit = commit, .destroy = destroy};
    svo_result r = svo_pipeline_run(&p, err);
    for (uint32_t i = 0; i < b->s->bone_count; i++) report->bones_used += u.used[i];
    if (report->counts.values > 0) report->distance_mean /= (double)report->counts.values;
    svo_free(a, u.used, (uint64_t)b->s->bone_count + 1, 1);
    return r;
}
