/* svo-dump --validate --source: is a packed octree what its source says, within the bounds that it promises? */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "dump.h"
#include "fmt_svdag.h"
#include "fmt_svo.h"
#include "svo_color.h"
#include "svo_compare.h"
#include "svo_dag.h"
#include "svo_unpack.h"

/* What is promised of a kind of channel: an error of at most `bound`, or INFINITY where only a number of bits was. */
static double promised(const json_t *options, svo_channel_kind kind)
{
    const char *text = kind == SVO_KIND_COLOR_SRGB8 ? json_string_value(json_object_get(options, "color"))
                       : kind == SVO_KIND_NORMAL_OCT32 ? json_string_value(json_object_get(options, "normal"))
                                                       : "lossless"; /* the others have no lossy form */
    if (text == NULL) return INFINITY;
    if (strcmp(text, "lossless") == 0) return 0;
    const char *prefix = kind == SVO_KIND_COLOR_SRGB8 ? "deltaE=" : "deg=";
    for (const char *p = text; p != NULL; p = strchr(p, ',') != NULL ? strchr(p, ',') + 1 : NULL)
        if (strncmp(p, prefix, strlen(prefix)) == 0) return strtod(p + strlen(prefix), NULL);
    return INFINITY;
}

/* The stated bound decides, with room for the rounding of this program's own arithmetic. */
static bool beyond(double error, double bound) { return error > bound * (1 + 1e-6) + (bound > 0 ? 1e-6 : 0); }

static double value_error(svo_channel_kind kind, const uint8_t *a, const uint8_t *b)
{
    if (memcmp(a, b, svo_channel_stride(kind)) == 0) return 0;
    switch (kind) {
    case SVO_KIND_COLOR_SRGB8: {
        float x[3], y[3];
        svo_srgb8_to_lab(a, x);
        svo_srgb8_to_lab(b, y);
        return svo_delta_e94(x, y);
    }
    case SVO_KIND_NORMAL_OCT32: {
        float x[3], y[3];
        svo_oct32_decode(a, x);
        svo_oct32_decode(b, y);
        double s = 0, d = 0; /* half the angle by its sine and cosine: exact for small angles too */
        for (int k = 0; k < 3; k++) {
            s += ((double)x[k] - y[k]) * ((double)x[k] - y[k]);
            d += ((double)x[k] + y[k]) * ((double)x[k] + y[k]);
        }
        return 2 * atan2(sqrt(s), sqrt(d)) * 57.295779513082320877;
    }
    case SVO_KIND_UNORM8: return fabs((double)a[0] - b[0]) / 255;
    case SVO_KIND_ID16:
    case SVO_KIND_ID32: break;
    }
    return 1;
}

static json_t *channel_result(const char *name, double mean, double max, double bound)
{
    json_t *o = json_object();
    cli_put_text(o, "name", name);
    cli_put_f64(o, "mean", mean);
    cli_put_f64(o, "max", max);
    json_object_set_new(o, "bound", isfinite(bound) ? json_real(bound) : json_null());
    json_object_set_new(o, "holds", json_boolean(!beyond(max, bound)));
    return o;
}

typedef struct comparing {
    const svo_view *v, *w;
    uint32_t c, d; /* the channel in each */
    double sum, max;
    uint64_t count, worst;
} comparing;

static bool compare_attribute(void *user, uint64_t attribute)
{
    comparing *k = user;
    uint8_t a[SVO_MAX_STRIDE], b[SVO_MAX_STRIDE];
    svo_view_attribute(k->w, k->d, attribute, a);
    svo_view_attribute(k->v, k->c, attribute, b);
    double e = value_error(k->v->channels[k->c].channel.kind, a, b);
    k->sum += e;
    k->count++;
    if (e > k->max) k->max = e, k->worst = attribute;
    return true;
}

/* Every attribute, those of inner nodes too, against the averages of the source: it is packed again without loss, in memory. Attributes are numbered alike in
 * every layout. */
static svo_result compare_attributes(const svo_view *v, const svo_view *w, const json_t *options, json_t *channels, svo_error *err)
{
    if (v->attribute_count != w->attribute_count)
        return svo_fail(err, SVO_INVALID_DATA, "it has %llu attributes, its source makes %llu", (unsigned long long)v->attribute_count, (unsigned long long)w->attribute_count);
    for (uint32_t c = 0; c < v->channel_count; c++) {
        const svo_channel *k = &v->channels[c].channel;
        uint32_t d = svo_view_find_channel(w, k->name);
        if (d == SVO_MAX_CHANNELS || w->channels[d].channel.kind != k->kind) return svo_fail(err, SVO_INVALID_DATA, "its source has no channel %s of this kind", k->name);
        const double bound = promised(options, k->kind);
        comparing pair = {.v = v, .w = w, .c = c, .d = d};
        for (uint64_t i = 0; i < v->attribute_count; i++) compare_attribute(&pair, i);
        if (!v->empty && v->channels[c].encoding != SVO_ENCODING_CONSTANT) svo_view_averages(w, 0, svo_view_root(w), compare_attribute, &pair);
        json_array_append_new(channels, channel_result(k->name, pair.count > 0 ? pair.sum / (double)pair.count : 0, pair.max, bound));
        if (beyond(pair.max, bound))
            return svo_fail(err, SVO_INVALID_DATA, "channel %s: attribute %llu%s is %.6g from its source, more than the %.6g that were promised", k->name,
                            (unsigned long long)svo_average_first(pair.worst), svo_average_voxels(pair.worst) > 1 ? " (an average)" : "", pair.max, bound);
    }
    return SVO_OK;
}

static svo_result pack_again(dump_job *j, const svo_view *v, const json_t *options, json_t *channels, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *reader = NULL;
    svo_packed *packed = NULL;
    svo_dag_options o = svo_default_dag_options();
    o.lod = v->lod;
    o.averaged = v->averaged;
    o.threads = (uint32_t)j->c->threads;
    o.allocator = j->allocator;
    SVO_TRY(fmt_input_open(j->source, &in, err));
    svo_result r = fmt_svo_reader_open(in, j->allocator, &reader, err);
    if (r == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        r = svo_dag_build(fmt_svo_reader_info(reader), &source, &o, &packed, NULL, err);
    }
    if (r == SVO_OK) r = compare_attributes(v, svo_packed_view(packed), options, channels, err);
    svo_packed_free(packed);
    if (reader != NULL) fmt_svo_reader_close(reader);
    fmt_input_close(in);
    return r;
}

static svo_result compare_voxels(dump_job *j, const svo_view *v, svo_compare_result *result, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *reader = NULL;
    svo_unpack unpack;
    svo_unpack_begin(&unpack, v);
    svo_tree_info info = svo_unpack_info(v);
    svo_chunk_source ours = svo_unpack_source(&unpack);
    svo_compare_options o = {.max_voxels = j->limit > UINT64_MAX / 2 ? 0 : 2 * j->limit, .allocator = j->allocator};
    SVO_TRY(fmt_input_open(j->source, &in, err));
    svo_result r = fmt_svo_reader_open(in, j->allocator, &reader, err);
    if (r == SVO_OK) {
        svo_chunk_source source = fmt_svo_reader_source(reader);
        r = svo_compare_trees(fmt_svo_reader_info(reader), &source, &info, &ours, &o, result, err);
    }
    if (reader != NULL) fmt_svo_reader_close(reader);
    fmt_input_close(in);
    return r;
}

svo_result dump_against_source(dump_job *j, const svo_view *v, const char *provenance, svo_error *err)
{
    svo_compare_result result;
    json_t *o = json_object(), *channels = json_array();
    cli_put_text(o, "file", j->source);
    json_object_set_new(o, "channels", channels);
    json_object_set_new(j->json, "source", o);
    SVO_TRY(compare_voxels(j, v, &result, err));
    json_object_set_new(o, "same_voxels", json_boolean(result.same_depth && result.only_a == 0 && result.only_b == 0));
    if (!result.same_depth) return svo_fail(err, SVO_INVALID_DATA, "its depth is not that of its source");
    if (result.only_a + result.only_b > 0)
        return svo_fail(err, SVO_INVALID_DATA, "%llu voxels of its source are missing, %llu are not in its source", (unsigned long long)result.only_a, (unsigned long long)result.only_b);
    if (!result.same_transform) return svo_fail(err, SVO_INVALID_DATA, "voxel_to_world is not that of its source");
    for (uint32_t c = 0; c < result.channel_count; c++)
        if (!result.channels[c].in_b || !result.channels[c].comparable) return svo_fail(err, SVO_INVALID_DATA, "channel %s of its source is missing or of another kind", result.channels[c].name);
    json_t *meta = json_loads(provenance, 0, NULL), *options = json_object_get(meta, "options");
    svo_result r = SVO_OK;
    bool varies = false;
    for (uint32_t c = 0; c < v->channel_count; c++) varies |= v->channels[c].encoding != SVO_ENCODING_CONSTANT;
    if (varies) r = pack_again(j, v, options, channels, err);
    json_decref(meta);
    return r;
}
