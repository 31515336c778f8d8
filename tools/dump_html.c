/* A file as one page that draws it; docs/format/html.md says what its data look like. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "cli_scene.h"
#include "dump.h"
#include "dump_cut.h"
#include "dump_pose.h"
#include "embed.h"

enum {
    PLANES = 11,
    INSTANCE_BYTES = 52,
    NODE_LIMIT = 1 << 24, /* of an octree: the shader keeps a child's number in 24 bits */
    TOTAL_LIMIT = 1 << 25,
    NAMED = 1000,
    RAW_FACTOR = 16 /* decoded data may be so many times the page's size */
};

/* ---- one octree ---------------------------------------------------------------------------------------------------- */

/* Where a byte of a value goes. */
typedef struct plane { const char *name; uint32_t channel, byte; } plane;

typedef struct asset {
    const svo_view *v;
    uint32_t depth, color, normal, emissive, label, coverage, planes;
    plane plane[PLANES];
    uint8_t constant[PLANES]; /* in the order of plane_names */
    svo_buffer masks[SVO_MAX_DEPTH + 1], values[SVO_MAX_DEPTH + 1]; /* by level; values interleaved */
    uint64_t nodes, inner, leaves;
    double low[3], high[3];
    uint64_t *budget; /* bytes left */
} asset;

static const char *const plane_names[PLANES] = {"r", "g", "b", "u", "v", "i", "j", "er", "eg", "eb", "c"};

static uint8_t fold(float x) { return (uint8_t)lrintf(127 + 127 * fmaxf(-1, fminf(1, x))); }

/* A normal as two bytes, of the map from the grid to the mesh: the shader needs it as a covector of the grid. */
static void fold_normal(const svo_view *v, const uint8_t *value, uint8_t out[2])
{
    float n[3];
    svo_oct32_decode(value, n);
    const double *m = v->voxel_to_world;
    double g[3], sum = 0;
    for (int k = 0; k < 3; k++) g[k] = m[k] * (double)n[0] + m[4 + k] * (double)n[1] + m[8 + k] * (double)n[2], sum += fabs(g[k]);
    if (!(sum > 0)) sum = 1;
    float x = (float)(g[0] / sum), y = (float)(g[1] / sum);
    if (g[2] < 0) {
        float fx = (1 - fabsf(y)) * (x < 0 ? -1.0f : 1.0f), fy = (1 - fabsf(x)) * (y < 0 ? -1.0f : 1.0f);
        x = fx, y = fy;
    }
    out[0] = fold(x), out[1] = fold(y);
}

/* All bytes that a leaf can have, in the order of plane_names. */
static void leaf_bytes(const asset *a, const uint8_t *const *values, uint8_t out[PLANES])
{
    memcpy(out, a->constant, PLANES);
    if (a->color != SVO_MAX_CHANNELS) memcpy(out, values[a->color], 3);
    if (a->normal != SVO_MAX_CHANNELS) fold_normal(a->v, values[a->normal], out + 3);
    if (a->label != SVO_MAX_CHANNELS) memcpy(out + 5, values[a->label], 2);
    if (a->emissive != SVO_MAX_CHANNELS) memcpy(out + 7, values[a->emissive], 3);
    if (a->coverage != SVO_MAX_CHANNELS) out[10] = values[a->coverage][0];
}

static uint32_t find(const svo_view *v, const char *name, svo_channel_kind kind)
{
    uint32_t c = svo_view_find_channel(v, name);
    return c != SVO_MAX_CHANNELS && v->channels[c].channel.kind == kind ? c : SVO_MAX_CHANNELS;
}

static void choose_planes(asset *a)
{
    const svo_view *v = a->v;
    a->color = find(v, "color", SVO_KIND_COLOR_SRGB8);
    a->normal = find(v, "normal", SVO_KIND_NORMAL_OCT32);
    a->emissive = find(v, "emissive", SVO_KIND_COLOR_SRGB8);
    a->coverage = find(v, "coverage", SVO_KIND_UNORM8);
    a->label = find(v, "bone", SVO_KIND_ID16);
    if (a->label == SVO_MAX_CHANNELS) a->label = find(v, "bone", SVO_KIND_ID32); /* of a pose: numbers of 16 bits all the same */
    if (a->label == SVO_MAX_CHANNELS) a->label = find(v, "material", SVO_KIND_ID16);
    const uint32_t of[PLANES] = {a->color, a->color, a->color, a->normal, a->normal, a->label, a->label, a->emissive, a->emissive, a->emissive, a->coverage};
    for (int i = 0; i < 3; i++) a->constant[i] = svo_linear_to_srgb(0.6f); /* as svo-render draws what has no colour */
    a->constant[10] = 255;
    const uint8_t *values[SVO_MAX_CHANNELS];
    for (uint32_t i = 0; i < v->channel_count; i++) values[i] = v->channels[i].channel.value;
    leaf_bytes(a, values, a->constant);
    for (uint32_t i = 0; i < PLANES; i++) {
        if (of[i] == SVO_MAX_CHANNELS || v->channels[of[i]].channel.constant) continue;
        a->plane[a->planes++] = (plane){plane_names[i], of[i], i};
    }
}

static svo_result add_node(void *user, const dump_cut_node *n, svo_error *err)
{
    asset *a = user;
    uint64_t bytes = (n->level < a->depth ? 1 : 0) + (n->leaf ? a->planes : 0);
    if (a->nodes == NODE_LIMIT || bytes > *a->budget) return SVO_CANCELLED;
    *a->budget -= bytes;
    a->nodes++;
    if (n->level < a->depth) {
        a->inner++;
        if (svo_buffer_append(&a->masks[n->level], &n->mask, 1) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the page's octree");
    }
    if (!n->leaf) return SVO_OK;
    a->leaves++;
    uint8_t all[PLANES], row[PLANES];
    leaf_bytes(a, n->values, all);
    for (uint32_t i = 0; i < a->planes; i++) row[i] = all[a->plane[i].byte];
    if (a->planes != 0 && svo_buffer_append(&a->values[n->level], row, a->planes) == NULL)
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the page's attributes");
    double edge = ldexp(1, -(int)n->level);
    for (int k = 0; k < 3; k++) {
        a->low[k] = fmin(a->low[k], n->cell[k] * edge);
        a->high[k] = fmax(a->high[k], (n->cell[k] + 1) * edge);
    }
    return SVO_OK;
}

static void asset_free(asset *a)
{
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) {
        svo_buffer_free(&a->masks[l]);
        svo_buffer_free(&a->values[l]);
    }
}

static svo_result asset_make(asset *a, const svo_view *v, uint32_t depth, uint64_t *budget, const svo_allocator *allocator, svo_error *err)
{
    memset(a, 0, sizeof *a);
    a->v = v;
    a->depth = depth;
    a->budget = budget;
    for (int k = 0; k < 3; k++) a->low[k] = 1;
    for (uint32_t l = 0; l <= SVO_MAX_DEPTH; l++) {
        svo_buffer_init(&a->masks[l], allocator);
        svo_buffer_init(&a->values[l], allocator);
    }
    choose_planes(a);
    return dump_cut(v, a->depth, add_node, a, err);
}

static json_t *asset_json(const asset *a, const char *name)
{
    json_t *o = json_object(), *planes = json_array(), *constant = json_object();
    cli_put_text(o, "name", name);
    cli_put_u64(o, "depth", a->depth);
    cli_put_u64(o, "inner", a->inner);
    cli_put_u64(o, "nodes", a->nodes);
    cli_put_u64(o, "leaves", a->leaves);
    for (uint32_t i = 0; i < a->planes; i++) json_array_append_new(planes, json_string(a->plane[i].name));
    for (uint32_t i = 0; i < PLANES; i++) json_object_set_new(constant, plane_names[i], json_integer(a->constant[i]));
    json_object_set_new(o, "planes", planes);
    json_object_set_new(o, "constant", constant);
    json_object_set_new(o, "unnumbered", json_boolean(a->planes == 0));
    json_object_set_new(o, "normal", json_boolean(a->normal != SVO_MAX_CHANNELS));
    json_object_set_new(o, "emissive", json_boolean(a->emissive != SVO_MAX_CHANNELS));
    json_object_set_new(o, "coverage", json_boolean(a->coverage != SVO_MAX_CHANNELS && (!a->v->channels[a->coverage].channel.constant || a->constant[10] != 255)));
    json_object_set_new(o, "thin", json_boolean(a->v->surface == SVO_SURFACE_THIN));
    json_object_set_new(o, "label", a->label != SVO_MAX_CHANNELS ? json_string(a->v->channels[a->label].channel.name) : json_null());
    json_object_set_new(o, "low", dump_reals(a->low, 3));
    json_object_set_new(o, "high", dump_reals(a->high, 3));
    return o;
}

/* ---- compression --------------------------------------------------------------------------------------------------- */

typedef struct packer {
    z_stream z;
    svo_buffer out;
    uint64_t limit; /* bytes */
} packer;

static void *zlib_alloc(void *user, unsigned count, unsigned size)
{
    (void)user;
    return calloc(count, size);
}
static void zlib_free(void *user, void *p)
{
    (void)user;
    free(p);
}

/* SVO_CANCELLED when the limit is passed. */
static svo_result squeeze(packer *p, const void *bytes, uint64_t size, bool last, svo_error *err)
{
    const uint8_t *from = bytes;
    do {
        uint32_t part = size > 1u << 20 ? 1u << 20 : (uint32_t)size;
        p->z.next_in = (Bytef *)(uintptr_t)from;
        p->z.avail_in = part;
        from += part, size -= part;
        do {
            if (!svo_buffer_reserve(&p->out, 1 << 16)) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the page's data");
            p->z.next_out = p->out.data + p->out.size;
            p->z.avail_out = 1 << 16;
            if (deflate(&p->z, last && size == 0 ? Z_FINISH : Z_NO_FLUSH) == Z_STREAM_ERROR) return svo_fail(err, SVO_RUNTIME, "zlib failed");
            p->out.size += (1 << 16) - p->z.avail_out;
            if (p->out.size > p->limit) return SVO_CANCELLED;
        } while (p->z.avail_out == 0);
    } while (size != 0);
    return SVO_OK;
}

/* Masks of all levels, then the planes, each the differences of a leaf's value to that of the leaf before. */
static svo_result squeeze_asset(packer *p, const asset *a, svo_error *err)
{
    uint8_t block[4096];
    for (uint32_t l = 0; l < a->depth; l++) SVO_TRY(squeeze(p, a->masks[l].data, a->masks[l].size, false, err));
    for (uint32_t i = 0; i < a->planes; i++) {
        uint8_t before = 0;
        uint32_t n = 0;
        for (uint32_t l = 0; l <= a->depth; l++) {
            for (uint64_t at = i; at < a->values[l].size; at += a->planes) {
                uint8_t v = a->values[l].data[at];
                block[n++] = (uint8_t)(v - before);
                before = v;
                if (n < sizeof block) continue;
                SVO_TRY(squeeze(p, block, n, false, err));
                n = 0;
            }
        }
        SVO_TRY(squeeze(p, block, n, false, err));
    }
    return SVO_OK;
}

static svo_mat4 cube_to_scene(const svo_scene *s, uint32_t page, uint64_t i, const double origin[3])
{
    const svo_view *v = s->assets[s->instance_asset[i]];
    svo_mat4 place = svo_scene_instance_transform(s, page, i), grid;
    memcpy(grid.m, v->voxel_to_world, sizeof grid.m);
    svo_mat4 m = svo_mat4_mul(place, grid);
    double side = ldexp(1, (int)v->tree_depth);
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++) m.m[4 * r + k] *= side;
        m.m[4 * r + 3] -= origin[r];
    }
    return m;
}

static svo_result squeeze_instances(packer *p, const svo_scene *s, const double origin[3], svo_error *err)
{
    for (uint32_t page = 0; page < s->page_count; page++)
        for (uint64_t i = s->pages[page].first; i < s->pages[page].first + s->pages[page].count; i++) {
            uint8_t row[INSTANCE_BYTES];
            svo_mat4 m = cube_to_scene(s, page, i, origin);
            memcpy(row, &s->instance_asset[i], 4);
            for (int k = 0; k < 12; k++) {
                float f = (float)m.m[k];
                memcpy(row + 4 + 4 * k, &f, 4);
            }
            SVO_TRY(squeeze(p, row, sizeof row, false, err));
        }
    return SVO_OK;
}

/* ---- the page ------------------------------------------------------------------------------------------------------ */

typedef struct page {
    dump_job *job;
    const svo_scene *scene;
    double origin[3];
    uint32_t deepest, level; /* level: the finest that is on the page */
    bool crowded;            /* of the last level that was too much: by its nodes, whatever their bytes */
    const dump_baked *baked; /* NULL: no instance has a pose */
    json_t *assets;
    packer data;
} page;

static uint32_t finest_of(const page *p, uint32_t i) { return p->baked != NULL ? p->baked->finest[i] : p->scene->assets[i]->tree_depth; }

/* Fill assets and data with everything cut at p->level; SVO_CANCELLED when that is too much. */
static svo_result fill(page *p, uint64_t room, svo_error *err)
{
    uint64_t budget = RAW_FACTOR * room, nodes = 0;
    bool crowded = false;
    p->data.out.size = 0;
    p->data.limit = room;
    p->data.z = (z_stream){.zalloc = zlib_alloc, .zfree = zlib_free};
    json_decref(p->assets);
    p->assets = json_array();
    if (deflateInit(&p->data.z, 6) != Z_OK) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to compress the page");
    svo_result r = SVO_OK;
    for (uint32_t i = 0; i < p->scene->asset_count && r == SVO_OK; i++) {
        const uint32_t finest = finest_of(p, i);
        asset a;
        r = asset_make(&a, p->scene->assets[i], finest < p->level ? finest : p->level, &budget, p->job->allocator, err);
        nodes += a.nodes;
        if (r == SVO_OK && nodes > TOTAL_LIMIT) r = SVO_CANCELLED;
        crowded = r == SVO_CANCELLED && (a.nodes == NODE_LIMIT || nodes > TOTAL_LIMIT);
        if (r == SVO_OK) r = squeeze_asset(&p->data, &a, err);
        if (r == SVO_OK) json_array_append_new(p->assets, asset_json(&a, p->scene->asset_names[i]));
        asset_free(&a);
    }
    if (r == SVO_OK) r = squeeze_instances(&p->data, p->scene, p->origin, err);
    if (r == SVO_OK) r = squeeze(&p->data, NULL, 0, true, err);
    deflateEnd(&p->data.z);
    if (r == SVO_CANCELLED) p->crowded = crowded;
    return r;
}

static json_t *camera_json(const svo_scene *s)
{
    if (!s->has_camera) return json_null();
    svo_vec3 zero = {0, 0, 0}, eye = svo_mat4_point(&s->camera_transform, zero);
    svo_vec3 forward = svo_normalize(svo_mat4_vector(&s->camera_transform, svo_v3(0, 0, -1)));
    double low[3], high[3], reach = 1;
    if (svo_scene_bounds(s, low, high)) {
        svo_vec3 middle = {0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])};
        reach = svo_dot(svo_sub(middle, eye), forward);
        if (!(reach > 0)) reach = svo_length(svo_sub(svo_v3(high[0], high[1], high[2]), svo_v3(low[0], low[1], low[2])));
        if (!(reach > 0) || !isfinite(reach)) reach = 1;
    }
    svo_vec3 target = svo_add(eye, svo_scale(forward, reach));
    return json_pack("{s:[f,f,f],s:[f,f,f],s:f}", "eye", eye.x, eye.y, eye.z, "target", target.x, target.y, target.z, "fov",
                     s->camera_yfov * (180 / 3.14159265358979323846));
}

static json_t *meta_json(const page *p)
{
    static const char *const leave_out[] = {"instances", "pages", "assets", "listed_in_full"};
    const svo_scene *s = p->scene;
    json_t *o = json_object(), *names = json_object(), *summary = json_copy(p->job->json);
    const char *slash = strrchr(p->job->path, '/');
    cli_put_text(summary, "file", strcmp(p->job->path, "-") == 0 ? "stdin" : slash != NULL ? slash + 1 : p->job->path);
    for (size_t i = 0; i < sizeof leave_out / sizeof leave_out[0]; i++) json_object_del(summary, leave_out[i]);
    for (uint64_t i = 0; i < s->instance_count && i < NAMED; i++) {
        char key[24];
        if (svo_scene_instance_name(s, i)[0] == 0) continue;
        snprintf(key, sizeof key, "%llu", (unsigned long long)i);
        cli_put_text(names, key, svo_scene_instance_name(s, i));
    }
    json_object_set_new(o, "origin", dump_reals(p->origin, 3));
    json_object_set(o, "assets", p->assets);
    cli_put_u64(o, "instance_count", s->instance_count);
    json_object_set_new(o, "instance_names", names);
    json_object_set_new(o, "camera", camera_json(s));
    cli_put_u64(o, "dropped_levels", p->deepest - p->level);
    cli_put_u64(o, "posed", p->baked != NULL ? p->baked->posed : 0);
    cli_put_u64(o, "rested", p->baked != NULL ? p->baked->rested : 0);
    json_object_set_new(o, "summary", summary);
    return o;
}

static svo_result write_base64(fmt_output *o, const uint8_t *bytes, uint64_t size, svo_error *err)
{
    static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    char block[4096];
    uint32_t n = 0;
    for (uint64_t i = 0; i < size; i += 3) {
        uint32_t left = size - i < 3 ? (uint32_t)(size - i) : 3;
        uint32_t v = (uint32_t)bytes[i] << 16 | (left > 1 ? (uint32_t)bytes[i + 1] << 8 : 0) | (left > 2 ? bytes[i + 2] : 0u);
        block[n++] = letters[v >> 18];
        block[n++] = letters[v >> 12 & 63];
        block[n++] = left > 1 ? letters[v >> 6 & 63] : '=';
        block[n++] = left > 2 ? letters[v & 63] : '=';
        if (n < sizeof block) continue;
        SVO_TRY(fmt_output_write(o, block, n, err));
        n = 0;
    }
    return fmt_output_write(o, block, n, err);
}

/* Text in which no < can end a script element, and in JSON no character is lost by that. */
static svo_result write_escaped(fmt_output *o, const char *text, const char *less, svo_error *err)
{
    while (*text != 0) {
        size_t n = strcspn(text, "<&");
        SVO_TRY(fmt_output_write(o, text, n, err));
        text += n;
        if (*text == 0) break;
        const char *as = *text == '&' ? (less[0] == '&' ? "&amp;" : "&") : less;
        SVO_TRY(fmt_output_write(o, as, strlen(as), err));
        text++;
    }
    return SVO_OK;
}

static svo_result write_part(fmt_output *o, const page *p, const char *meta, const char *name, size_t length, svo_error *err)
{
#define IS(word) (length == strlen(word) && memcmp(name, word, length) == 0)
    const char *slash = strrchr(p->job->path, '/');
    if (IS("title")) return write_escaped(o, slash != NULL ? slash + 1 : p->job->path, "&lt;", err);
    if (IS("style")) return fmt_output_write(o, embed_style_css, embed_style_css_size, err);
    if (IS("script")) return fmt_output_write(o, embed_viewer_js, embed_viewer_js_size, err);
    if (IS("shader")) return fmt_output_write(o, embed_trace_glsl, embed_trace_glsl_size, err);
    if (IS("meta")) return write_escaped(o, meta, "\\u003c", err);
    if (IS("data")) return write_base64(o, p->data.out.data, p->data.out.size, err);
    return svo_fail(err, SVO_RUNTIME, "the page's template has an unknown part");
#undef IS
}

static svo_result write_page(fmt_output *o, const page *p, svo_error *err)
{
    json_t *meta = meta_json(p);
    char *text = json_dumps(meta, JSON_COMPACT | JSON_REAL_PRECISION(17));
    json_decref(meta);
    if (text == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the page's summary");
    svo_result r = SVO_OK;
    for (const char *at = (const char *)embed_page_html; *at != 0 && r == SVO_OK;) {
        const char *open = strstr(at, "{{"), *close = open != NULL ? strstr(open, "}}") : NULL;
        if (close == NULL) {
            r = fmt_output_write(o, at, strlen(at), err);
            break;
        }
        r = fmt_output_write(o, at, (size_t)(open - at), err);
        if (r == SVO_OK) r = write_part(o, p, text, open + 2, (size_t)(close - open - 2), err);
        at = close + 2;
    }
    free(text);
    return r;
}

static svo_result choose_level(page *p, uint64_t page_size, svo_error *err)
{
    json_t *meta = meta_json(p);
    char *text = json_dumps(meta, JSON_COMPACT);
    uint64_t fixed = embed_page_html_size + embed_style_css_size + embed_viewer_js_size + embed_trace_glsl_size + (text != NULL ? strlen(text) : 0) +
                     (uint64_t)p->scene->asset_count * 600 + 4096;
    free(text);
    json_decref(meta);
    for (p->level = p->deepest; fixed < page_size; p->level--) {
        cli_progress(p->job->c, "packing the page", -1);
        svo_result r = fill(p, (page_size - fixed) / 4 * 3, err);
        if (r != SVO_CANCELLED) return r;
        if (p->level == 0) break;
    }
    return svo_fail(err, SVO_LIMIT, "the page would be larger than %llu bytes even without any detail (%llu assets, %llu instances); raise --html-size%s",
                    (unsigned long long)page_size, (unsigned long long)p->scene->asset_count, (unsigned long long)p->scene->instance_count,
                    p->baked != NULL && p->baked->posed != 0 ? " or leave poses out (--rest)" : "");
}

static void tell_poses(const page *p)
{
    const dump_baked *t = p->baked;
    json_t *html = json_object_get(cli_section(p->job->c, "output"), "html");
    cli_put_u64(html, "posed_instances", t != NULL ? t->posed : 0);
    cli_put_u64(html, "poses_left_out", t != NULL ? t->rested : 0);
    cli_put_u64(html, "coarser_poses", t != NULL ? t->coarser : 0);
    if (t == NULL) return;
    if (t->coarser != 0)
        cli_info(p->job->c, "%s: instances whose poses are made of coarser nodes, for their number: %llu", p->job->html, (unsigned long long)t->coarser);
    if (t->rested != 0)
        cli_info(p->job->c, "%s: instances drawn without their pose: %llu%s", p->job->html, (unsigned long long)t->rested,
                 p->job->export.rest ? "" : " (it goes beyond the range of numbers, or there are more than 8192 poses)");
}

static svo_result make_page(dump_job *j, const svo_scene *scene, const dump_baked *baked, fmt_output *o, svo_error *err)
{
    page p = {.job = j, .scene = scene, .assets = json_array(), .baked = baked};
    double low[3], high[3];
    svo_buffer_init(&p.data.out, j->allocator);
    if (svo_scene_bounds(scene, low, high))
        for (int k = 0; k < 3; k++) p.origin[k] = 0.5 * low[k] + 0.5 * high[k];
    for (uint32_t i = 0; i < scene->asset_count; i++)
        if (finest_of(&p, i) > p.deepest) p.deepest = finest_of(&p, i);
    svo_result r = choose_level(&p, j->html_size, err);
    if (r == SVO_OK && p.level < p.deepest && p.crowded)
        cli_info(j->c, "%s: shows level %u of %u; with level %u it would have more nodes than a page draws (%d an octree, %d in all)", j->html, p.level, p.deepest, p.level + 1,
                 NODE_LIMIT, TOTAL_LIMIT);
    else if (r == SVO_OK && p.level < p.deepest)
        cli_info(j->c, "%s: shows level %u of %u, so that the page stays under %llu bytes (--html-size)", j->html, p.level, p.deepest,
                 (unsigned long long)j->html_size);
    if (r == SVO_OK) r = write_page(o, &p, err);
    if (r == SVO_OK) {
        json_t *html = json_object();
        cli_put_u64(html, "bytes", fmt_output_offset(o));
        cli_put_u64(html, "level", p.level);
        cli_put_u64(html, "levels_left_out", p.deepest - p.level);
        json_object_set_new(cli_section(j->c, "output"), "html", html);
        tell_poses(&p);
    }
    json_decref(p.assets);
    svo_buffer_free(&p.data.out);
    return r;
}

svo_result dump_html(dump_job *j, svo_error *err)
{
    cli_scene s;
    dump_baked baked = {0};
    fmt_output *o = NULL;
    SVO_TRY(fmt_output_open(j->html, j->c->force, &o, err)); /* before the work, so that a bad place is known at once */
    svo_result r = cli_scene_open(j->c, j->path, j->data, j->size, j->allocator, NULL, &s, err);
    if (r == SVO_OK) {
        const bool posed = s.scene->instance_pose != NULL;
        if (j->export.rest && strcmp(s.kind, "svscene") != 0) r = svo_fail(err, SVO_INVALID_ARGUMENT, "--rest is for scenes");
        if (r == SVO_OK && posed) r = dump_bake(j->c, s.scene, j->export.rest, j->allocator, &baked, err);
        if (r == SVO_OK) r = make_page(j, posed ? &baked.scene : s.scene, posed ? &baked : NULL, o, err);
        dump_baked_free(&baked);
        cli_scene_close(&s);
    }
    if (r == SVO_OK) return fmt_output_commit(o, err);
    fmt_output_discard(o);
    return r;
}
