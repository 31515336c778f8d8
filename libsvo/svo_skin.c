#include "svo_skin.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "svo_mesh.h"
#include "svoi_tritree.h"

/* Boxes of triangles are kept in 2^-6 of a voxel, in a range that single integers hold for any grid and some way around it. */
#define BOX_UNIT 64.0
#define BOX_LIMIT 1e9

struct svo_skin {
    const svo_allocator *allocator;
    svo_skin_mesh mesh;
    svo_tree_info info;
    uint32_t first_channel, slots; /* the channels: slots labels, then slots - 1 weights */
    double *corner; /* 3 a vertex, grid coordinates */
    svoi_tree tree;
    const svo_chunk_sink *to;
};

bool svo_skin_is_channel(const char *name)
{
    static const char *const names[] = {"bone", "bone1", "bone2", "bone3", "weight1", "weight2", "weight3"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(name, names[i]) == 0) return true;
    return false;
}

/* ---- weights --------------------------------------------------------------------------------------------------------- */

double svo_skin_pick(const uint16_t *bones, const double *weights, uint32_t count, uint16_t out_bone[SVO_SKIN_BONES], uint8_t out_weight[SVO_SKIN_BONES])
{
    uint16_t bone[SVO_SKIN_CANDIDATES];
    double weight[SVO_SKIN_CANDIDATES], total = 0, kept = 0;
    uint32_t n = 0;
    SVO_ASSERT(count <= SVO_SKIN_CANDIDATES);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t k = 0;
        if (!(weights[i] > 0) || !isfinite(weights[i])) continue;
        while (k < n && bone[k] != bones[i]) k++;
        if (k == n) bone[n] = bones[i], weight[n++] = 0;
        weight[k] += weights[i];
        total += weights[i];
    }
    for (uint32_t i = 1; i < n; i++) /* sort by weight */
        for (uint32_t k = i; k > 0 && (weight[k] > weight[k - 1] || (weight[k] == weight[k - 1] && bone[k] < bone[k - 1])); k--) {
            double w = weight[k];
            uint16_t b = bone[k];
            weight[k] = weight[k - 1], bone[k] = bone[k - 1];
            weight[k - 1] = w, bone[k - 1] = b;
        }
    for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) out_bone[i] = SVO_SKIN_REST, out_weight[i] = 0;
    out_weight[0] = 255;
    if (n == 0) return 0;
    uint32_t used = n < SVO_SKIN_BONES ? n : SVO_SKIN_BONES, left = 255;
    for (uint32_t i = 0; i < used; i++) kept += weight[i];
    for (uint32_t i = used; i-- > 1;) { /* the first one, the greatest, takes what rounding leaves */
        uint32_t w = (uint32_t)lround(255 * weight[i] / kept);
        if (w == 0) continue; /* (greater ones come after it, so those of weight 0 are the last) */
        out_bone[i] = bone[i], out_weight[i] = (uint8_t)w;
        left -= w;
    }
    out_bone[0] = bone[0], out_weight[0] = (uint8_t)left;
    return fmax(0, 1 - kept / total);
}

/* The most bones that a triangle's corners have together. */
static uint32_t most_bones(const svo_skin_mesh *m)
{
    uint32_t most = 1;
    for (uint64_t t = 0; t < m->triangle_count && most < SVO_SKIN_BONES; t++) {
        uint16_t seen[3 * SVO_SKIN_BONES];
        uint32_t n = 0;
        for (int c = 0; c < 3; c++) {
            const svo_influence *f = &m->influences[m->indices[3 * t + (uint64_t)c]];
            for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) {
                uint32_t k = 0;
                if (!(f->weight[i] > 0)) continue;
                while (k < n && seen[k] != f->bone[i]) k++;
                if (k == n) seen[n++] = f->bone[i];
            }
        }
        if (n > most) most = n;
    }
    return most < SVO_SKIN_BONES ? most : SVO_SKIN_BONES;
}

/* ---- the nearest triangle --------------------------------------------------------------------------------------------- */

static const double *corner_of(const svo_skin *s, uint32_t triangle, int c) { return s->corner + 3 * (uint64_t)s->mesh.indices[3 * (uint64_t)triangle + (uint64_t)c]; }

static int32_t boxed(double v) { return (int32_t)fmin(fmax(v * BOX_UNIT, -BOX_LIMIT), BOX_LIMIT); }

static void box_of(void *user, uint32_t item, svoi_box *box)
{
    const svo_skin *s = user;
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (int c = 0; c < 3; c++) low = fmin(low, corner_of(s, item, c)[k]), high = fmax(high, corner_of(s, item, c)[k]);
        box->low[k] = boxed(low) - 1, box->high[k] = boxed(high) + 1;
    }
}

static double box_distance2(const svoi_box *b, const double p[3])
{
    double sum = 0;
    for (int k = 0; k < 3; k++) {
        double d = fmax(0, fmax(b->low[k] - p[k] * BOX_UNIT, p[k] * BOX_UNIT - b->high[k]));
        sum += d * d;
    }
    return sum / (BOX_UNIT * BOX_UNIT);
}

static double dot3(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* Square of the distance from p to segment a b; *t is where on it. */
static double to_segment2(const double p[3], const double *a, const double *b, double *t)
{
    double d[3], e[3];
    for (int k = 0; k < 3; k++) d[k] = b[k] - a[k], e[k] = p[k] - a[k];
    double length = dot3(d, d);
    *t = length > 0 ? fmin(fmax(dot3(d, e) / length, 0), 1) : 0;
    for (int k = 0; k < 3; k++) e[k] -= *t * d[k];
    return dot3(e, e);
}

/* Square of the distance to a triangle, and the weights of its corners at the nearest point. */
static double to_triangle2(const svo_skin *s, uint32_t triangle, const double p[3], double w[3])
{
    const double *c[3] = {corner_of(s, triangle, 0), corner_of(s, triangle, 1), corner_of(s, triangle, 2)};
    double a[3], b[3], e[3], best = INFINITY, t;
    for (int k = 0; k < 3; k++) a[k] = c[1][k] - c[0][k], b[k] = c[2][k] - c[0][k], e[k] = p[k] - c[0][k];
    double aa = dot3(a, a), ab = dot3(a, b), bb = dot3(b, b), ea = dot3(e, a), eb = dot3(e, b);
    double u = ea * bb - eb * ab, v = eb * aa - ea * ab, whole = aa * bb - ab * ab;
    if (whole > 0 && u >= 0 && v >= 0 && u + v <= whole) {
        w[1] = u / whole, w[2] = v / whole, w[0] = 1 - w[1] - w[2];
        for (int k = 0; k < 3; k++) e[k] -= w[1] * a[k] + w[2] * b[k];
        return dot3(e, e);
    }
    for (int i = 0; i < 3; i++) {
        double d = to_segment2(p, c[i], c[(i + 1) % 3], &t);
        if (d >= best) continue;
        best = d;
        w[i] = 1 - t, w[(i + 1) % 3] = t, w[(i + 2) % 3] = 0;
    }
    return best;
}

bool svo_skin_nearest(const svo_skin *s, const double grid[3], uint32_t near, uint32_t *triangle, double weight[3])
{
    struct { svoi_tree_node node; double distance; } stack[SVOI_TREE_STACK];
    uint32_t top = 0, best = SVO_NONE;
    double least = INFINITY, w[3];
    if (s->tree.count == 0) return false;
    if (near != SVO_NONE) best = near, least = to_triangle2(s, near, grid, weight);
    stack[0].node = (svoi_tree_node){s->tree.levels - 1, 0};
    stack[0].distance = box_distance2(svoi_tree_box(&s->tree, stack[0].node), grid);
    top = 1;
    while (top != 0) {
        top--;
        if (stack[top].distance > least) continue;
        svoi_tree_node n = stack[top].node;
        if (n.level == 0) {
            uint64_t begin, end;
            svoi_tree_items(&s->tree, n, &begin, &end);
            for (uint64_t i = begin; i < end; i++) {
                uint32_t t = s->tree.order[i];
                double d = to_triangle2(s, t, grid, w);
                if (d > least || (d == least && t >= best)) continue; /* of several the first one, wherever the search began */
                least = d, best = t;
                memcpy(weight, w, sizeof w);
            }
            continue;
        }
        svoi_tree_node c[2];
        uint32_t count = svoi_tree_children(&s->tree, n, c);
        double d[2] = {0, 0};
        for (uint32_t i = 0; i < count; i++) d[i] = box_distance2(svoi_tree_box(&s->tree, c[i]), grid);
        for (uint32_t i = 0; i < count; i++) { /* the nearer one on top */
            uint32_t k = count == 2 && d[0] < d[1] ? 1 - i : i;
            stack[top].node = c[k], stack[top].distance = d[k];
            top++;
        }
    }
    *triangle = best;
    return best != SVO_NONE;
}

static svo_result build_tree(svo_skin *s, svo_error *err)
{
    const svo_skin_mesh *m = &s->mesh;
    const svo_allocator *a = s->allocator;
    uint32_t *order = svo_alloc(a, m->triangle_count, sizeof *order);
    uint64_t *keys = svo_alloc(a, m->triangle_count, sizeof *keys), count = 0;
    bool ok = m->triangle_count == 0 || (order != NULL && keys != NULL);
    uint32_t bits = s->info.depth + 1;
    for (uint64_t t = 0; ok && t < m->triangle_count; t++) {
        double middle[3] = {0, 0, 0};
        int32_t at[3];
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 3; k++) middle[k] += corner_of(s, (uint32_t)t, c)[k] / 3;
        for (int k = 0; k < 3; k++) at[k] = (int32_t)fmin(fmax(2 * middle[k], 0), ldexp(1, (int)bits) - 1);
        keys[t] = svoi_tree_key(at, bits);
        if (isfinite(middle[0] + middle[1] + middle[2])) order[count++] = (uint32_t)t;
    }
    if (ok && count < m->triangle_count) { /* (the tree frees as many as it has) */
        uint32_t *fewer = svo_alloc(a, count, sizeof *fewer);
        if (count != 0 && fewer == NULL) ok = false;
        else {
            if (count != 0) memcpy(fewer, order, count * sizeof *fewer);
            svo_free(a, order, m->triangle_count, sizeof *order);
            order = fewer;
        }
    }
    if (ok) ok = svoi_tree_build(&s->tree, order, count, keys, box_of, s, a);
    else svo_free(a, order, m->triangle_count, sizeof *order);
    svo_free(a, keys, m->triangle_count, sizeof *keys);
    return ok ? SVO_OK : svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the skin of a mesh");
}

/* ---- the channels ----------------------------------------------------------------------------------------------------- */

static svo_result add_channels(svo_skin *s, svo_error *err)
{
    svo_tree_info *o = &s->info;
    s->slots = most_bones(&s->mesh);
    s->first_channel = o->channel_count;
    if (o->channel_count + 2 * s->slots - 1 > SVO_MAX_CHANNELS) return svo_fail(err, SVO_LIMIT, "there is no room for the channels of a skin beside %u others", o->channel_count);
    for (uint32_t i = 0; i < 2 * s->slots - 1; i++) {
        svo_channel *c = &o->channels[o->channel_count++];
        memset(c, 0, sizeof *c);
        if (i == 0) memcpy(c->name, "bone", 5);
        else snprintf(c->name, sizeof c->name, i < s->slots ? "bone%u" : "weight%u", i < s->slots ? i : i - s->slots + 1);
        c->kind = i < s->slots ? SVO_KIND_ID16 : SVO_KIND_UNORM8;
    }
    return SVO_OK;
}

svo_result svo_skin_create(const svo_skin_mesh *mesh, const svo_tree_info *info, const svo_allocator *a, svo_skin **out, svo_error *err)
{
    svo_mat4 to_world, to_grid;
    memcpy(to_world.m, info->voxel_to_world, sizeof to_world.m);
    if (!svo_mat4_affine_inverse(&to_world, &to_grid)) return svo_fail(err, SVO_INVALID_ARGUMENT, "the octree's grid is flat");
    svo_skin *s = svo_calloc(a, 1, sizeof *s);
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the skin of a mesh");
    s->allocator = a;
    s->mesh = *mesh;
    s->info = *info;
    svo_result result = add_channels(s, err);
    s->corner = svo_alloc(a, mesh->vertex_count, 3 * sizeof(double));
    if (result == SVO_OK && s->corner == NULL && mesh->vertex_count != 0) result = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the skin of a mesh");
    for (uint64_t i = 0; result == SVO_OK && i < mesh->vertex_count; i++) {
        svo_vec3 p = svo_mat4_point(&to_grid, svo_v3(mesh->positions[3 * i], mesh->positions[3 * i + 1], mesh->positions[3 * i + 2]));
        s->corner[3 * i] = p.x, s->corner[3 * i + 1] = p.y, s->corner[3 * i + 2] = p.z;
    }
    if (result == SVO_OK) result = build_tree(s, err);
    if (result != SVO_OK) {
        svo_skin_free(s);
        return result;
    }
    *out = s;
    return SVO_OK;
}

void svo_skin_free(svo_skin *s)
{
    if (s == NULL) return;
    svoi_tree_free(&s->tree);
    svo_free(s->allocator, s->corner, s->mesh.vertex_count, 3 * sizeof(double));
    svo_free(s->allocator, s, 1, sizeof *s);
}

const svo_tree_info *svo_skin_info(const svo_skin *s) { return &s->info; }

typedef struct binding {
    const svo_skin *s;
    uint16_t *label[SVO_SKIN_BONES];
    uint8_t *weight[SVO_SKIN_BONES];
    uint32_t near;
} binding;

static bool bind(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    binding *b = user;
    const svo_skin *s = b->s;
    double at[3], w[3], weight[3 * SVO_SKIN_BONES];
    uint16_t bone[3 * SVO_SKIN_BONES], label[SVO_SKIN_BONES] = {SVO_SKIN_REST, SVO_SKIN_REST, SVO_SKIN_REST, SVO_SKIN_REST};
    uint8_t part[SVO_SKIN_BONES] = {255, 0, 0, 0};
    for (int k = 0; k < 3; k++) at[k] = low[k] + 0.5 * size;
    if (svo_skin_nearest(s, at, b->near, &b->near, w)) {
        for (uint32_t c = 0; c < 3; c++) {
            const svo_influence *f = &s->mesh.influences[s->mesh.indices[3 * (uint64_t)b->near + c]];
            double total = 0;
            for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) total += f->weight[i] > 0 ? (double)f->weight[i] : 0;
            for (uint32_t i = 0; i < SVO_SKIN_BONES; i++) {
                bone[SVO_SKIN_BONES * c + i] = f->bone[i];
                weight[SVO_SKIN_BONES * c + i] = total > 0 ? w[c] * (double)f->weight[i] / total : 0;
            }
            if (!(total > 0)) bone[SVO_SKIN_BONES * c] = SVO_SKIN_REST, weight[SVO_SKIN_BONES * c] = w[c];
        }
        svo_skin_pick(bone, weight, 3 * SVO_SKIN_BONES, label, part);
    }
    for (uint32_t i = 0; i < s->slots; i++) {
        b->label[i][index] = label[i];
        if (i != 0) b->weight[i][index] = part[i];
    }
    return true;
}

static svo_result encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    svo_skin *s = user;
    uint64_t n = chunk->value_count;
    uint8_t *memory = svo_alloc(s->allocator, n, 3 * s->slots - 1);
    if (memory == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the bones of a chunk");
    binding b = {.s = s, .near = SVO_NONE};
    svo_chunk more = *chunk;
    for (uint32_t i = 0; i < s->slots; i++) {
        b.label[i] = (uint16_t *)(void *)(memory + 2 * n * i);
        more.channels[s->first_channel + i] = memory + 2 * n * i;
        if (i == 0) continue;
        b.weight[i] = memory + 2 * n * s->slots + n * (i - 1);
        more.channels[s->first_channel + s->slots + i - 1] = b.weight[i];
    }
    svo_chunk_values(chunk, bind, &b);
    svo_result result = s->to->encode(s->to->user, &more, worker, blob, err);
    svo_free(s->allocator, memory, n, 3 * s->slots - 1);
    return result;
}

static svo_result commit(void *user, void *blob, svo_error *err)
{
    const svo_skin *s = user;
    return s->to->commit(s->to->user, blob, err);
}

static void discard(void *user, void *blob)
{
    const svo_skin *s = user;
    s->to->discard(s->to->user, blob);
}

svo_chunk_sink svo_skin_sink(svo_skin *s, const svo_chunk_sink *to)
{
    s->to = to;
    return (svo_chunk_sink){.user = s, .encode = encode, .commit = commit, .discard = discard};
}
