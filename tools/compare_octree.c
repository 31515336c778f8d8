#include <string.h>

#include "compare.h"
#include "fmt_svdag.h"
#include "fmt_svo.h"
#include "svo_compare.h"
#include "svo_morton.h"
#include "svo_unpack.h"

/* An octree opened for one pass. */
typedef struct octree {
    fmt_input *in;
    fmt_svo_reader *reader;
    bool packed;
    fmt_svdag svdag;
    svo_unpack unpack;
    svo_tree_info info;
    svo_chunk_source source;
    uint64_t known_voxels; /* from the header of a .svdag, else 0 */
} octree;

/* The source of a file, with its name in the messages: both are read at once. */
typedef struct named_source { svo_chunk_source inner; const char *path; } named_source;

static svo_result named_fetch(void *user, svo_buffer *packed, bool *more, svo_error *err)
{
    named_source *s = user;
    return cli_about(s->path, s->inner.fetch(s->inner.user, packed, more, err), err);
}

static svo_result named_decode(void *user, const svo_buffer *packed, svo_buffer *storage, svo_chunk *out, svo_error *err)
{
    named_source *s = user;
    return cli_about(s->path, s->inner.decode(s->inner.user, packed, storage, out, err), err);
}

static svo_result open_octree(compare_job *j, compare_input *in, octree *t, svo_error *err)
{
    if (in->kind == FMT_KIND_SVDAG) {
        SVO_TRY(compare_load(in, j->c, j->allocator, err));
        SVO_TRY(fmt_svdag_open(in->bytes.data, in->bytes.size, j->allocator, &t->svdag, err));
        t->packed = true;
        svo_unpack_begin(&t->unpack, &t->svdag.view);
        t->info = svo_unpack_info(&t->svdag.view);
        t->source = svo_unpack_source(&t->unpack);
        t->known_voxels = t->svdag.view.nodes[t->svdag.view.depth];
        return SVO_OK;
    }
    if (in->loaded) SVO_TRY(fmt_input_open_memory(in->bytes.data, in->bytes.size, &t->in, err));
    else SVO_TRY(fmt_input_open(in->path, &t->in, err));
    SVO_TRY(fmt_svo_reader_open(t->in, j->allocator, &t->reader, err));
    t->info = *fmt_svo_reader_info(t->reader);
    t->source = fmt_svo_reader_source(t->reader);
    return SVO_OK;
}

static void close_octree(octree *t)
{
    if (t->packed) fmt_svdag_close(&t->svdag);
    fmt_svo_reader_close(t->reader);
    fmt_input_close(t->in);
}

static json_t *place_json(uint64_t code)
{
    uint32_t x, y, z;
    svo_morton_decode(code, &x, &y, &z);
    return json_pack("[i,i,i]", (int)x, (int)y, (int)z);
}

static const char *unit_of(svo_channel_kind kind)
{
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: return "deltaE94";
    case SVO_KIND_NORMAL_OCT32: return "degrees";
    case SVO_KIND_UNORM8: return "value";
    case SVO_KIND_ID16:
    case SVO_KIND_ID32: break;
    }
    return "label";
}

static void judge_channel(compare_job *j, const svo_compare_channel *ch)
{
    const compare_tolerance *t = &j->tolerance;
    if (t->geometry_only) return;
    if (!ch->in_a || !ch->in_b) {
        compare_reason(j, "%s: only %s has this channel", ch->name, ch->in_a ? "A" : "B");
    } else if (!ch->comparable) {
        compare_reason(j, "%s: the channels are of different kinds", ch->name);
    } else if (ch->kind == SVO_KIND_ID16 || ch->kind == SVO_KIND_ID32) {
        if (ch->different > 0) compare_reason(j, "%s: %llu labels differ", ch->name, (unsigned long long)ch->different);
    } else {
        double most = ch->kind == SVO_KIND_COLOR_SRGB8 ? t->delta_e : ch->kind == SVO_KIND_NORMAL_OCT32 ? t->degrees : t->value;
        if (ch->max > most) compare_reason(j, "%s: the largest difference is %.6g, above %.10g", ch->name, ch->max, most);
    }
}

static json_t *channel_json(const svo_compare_channel *ch, json_t *errors)
{
    json_t *o = json_object();
    cli_put_text(o, "name", ch->name);
    json_object_set_new(o, "in_a", json_boolean(ch->in_a));
    json_object_set_new(o, "in_b", json_boolean(ch->in_b));
    if (!ch->comparable) return o;
    cli_put_text(o, "unit", unit_of(ch->kind));
    cli_put_u64(o, "different", ch->different);
    cli_put_f64(o, "mean", ch->mean);
    cli_put_f64(o, "max", ch->max);
    if (ch->different > 0) json_object_set_new(o, "worst", place_json(ch->worst));
    json_object_set(errors, ch->name, o);
    return o;
}

static void put_result(compare_job *j, const octree t[2], const svo_compare_result *r)
{
    json_t *o = j->json, *geometry = json_object(), *channels = json_array();
    json_t *errors = cli_section(j->c, "errors");
    bool equal = r->same_depth && r->only_a == 0 && r->only_b == 0, same_values = true;
    for (int i = 0; i < 2; i++) {
        json_t *side = json_object_get(o, i == 0 ? "a" : "b");
        cli_put_text(side, "format", t[i].packed ? "svdag" : "svo");
        cli_put_u64(side, "depth", t[i].info.depth);
        cli_put_u64(side, "voxels", i == 0 ? r->voxels_a : r->voxels_b);
    }
    if (!r->same_depth) compare_reason(j, "the depths differ: %u and %u", t[0].info.depth, t[1].info.depth);
    if (r->same_depth) {
        cli_put_u64(geometry, "only_a", r->only_a);
        cli_put_u64(geometry, "only_b", r->only_b);
        cli_put_u64(geometry, "both", r->both);
        if (!equal) {
            json_object_set_new(geometry, "first", place_json(r->first));
            cli_put_text(geometry, "first_in", r->first_in_a ? "a" : "b");
            compare_reason(j, "voxels differ: %llu only in A, %llu only in B", (unsigned long long)r->only_a, (unsigned long long)r->only_b);
        }
        json_object_set_new(o, "same_transform", json_boolean(r->same_transform));
        cli_put_f64(o, "transform_distance", r->transform_distance);
        if (!r->same_transform) compare_reason(j, "voxel_to_world differs: by up to %.6g at the corners of the grid", r->transform_distance);
        for (uint32_t i = 0; i < r->channel_count; i++) {
            const svo_compare_channel *ch = &r->channels[i];
            json_array_append_new(channels, channel_json(ch, errors));
            judge_channel(j, ch);
            same_values &= ch->comparable && ch->different == 0;
        }
        cli_put_u64(errors, "voxels_only_a", r->only_a);
        cli_put_u64(errors, "voxels_only_b", r->only_b);
    }
    json_object_set_new(geometry, "equal", json_boolean(equal));
    json_object_set_new(o, "geometry", geometry);
    json_object_set_new(o, "channels", channels);
    json_object_set_new(o, "identical", json_boolean(equal && r->same_transform && same_values));
}

typedef struct progress { cli *c; uint64_t total; } progress;

static bool show_progress(void *user, uint64_t voxels)
{
    progress *p = user;
    cli_progress(p->c, "comparing", p->total != 0 ? (double)voxels / (double)p->total : -1);
    return true;
}

svo_result compare_octrees(compare_job *j, svo_error *err)
{
    octree t[2];
    memset(t, 0, sizeof t);
    svo_result r = SVO_OK;
    uint64_t known = 0;
    for (int i = 0; i < 2 && r == SVO_OK; i++) {
        r = cli_about(j->in[i].path, open_octree(j, &j->in[i], &t[i], err), err);
        known = known + t[i].known_voxels < known ? UINT64_MAX : known + t[i].known_voxels;
    }
    /* A small packed file can describe more voxels than can ever be read: refuse before beginning. */
    if (r == SVO_OK && j->tolerance.max_voxels != 0 && known > j->tolerance.max_voxels)
        r = svo_fail(err, SVO_LIMIT, "%llu voxels to compare are more than --max-voxels %llu", (unsigned long long)known,
                     (unsigned long long)j->tolerance.max_voxels);
    if (r == SVO_OK) {
        progress p = {j->c, t[0].known_voxels != 0 ? 2 * t[0].known_voxels : 2 * t[1].known_voxels};
        svo_compare_options options = {.max_voxels = j->tolerance.max_voxels, .allocator = j->allocator, .progress = show_progress, .user = &p};
        svo_compare_result result;
        named_source named[2];
        svo_chunk_source source[2];
        for (int i = 0; i < 2; i++) {
            named[i] = (named_source){t[i].source, j->in[i].path};
            source[i] = (svo_chunk_source){&named[i], named_fetch, named_decode};
        }
        r = svo_compare_trees(&t[0].info, &source[0], &t[1].info, &source[1], &options, &result, err);
        if (r == SVO_OK) put_result(j, t, &result);
    }
    for (int i = 0; i < 2; i++) close_octree(&t[i]);
    return r;
}
