/* svo-bench: the sweeps of skeletons, by omega and by how they are made. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "fmt_skel.h"

/* What the literal iteration gave, by omega and place. */
struct bench_literals {
    double omega;
    int place;
    skel_skeleton s;
    bench_literals *next;
};

void bench_literals_free(bench_literals *l)
{
    while (l != NULL) {
        bench_literals *next = l->next;
        skel_skeleton_free(&l->s);
        free(l);
        l = next;
    }
}

/* --- values ------------------------------------------------------------------------------------------------------- */

static bool take_word(const char *word, size_t length, bench_value *out)
{
    static const struct { const char *name; int method, search, place, delta; } words[] = {
        {"fast", SKEL_METHOD_FAST, -1, -1, -1}, {"literal", SKEL_METHOD_LITERAL, -1, -1, -1}, {"flann", -1, SKEL_SEARCH_FLANN, -1, -1}, {"grid", -1, SKEL_SEARCH_GRID, -1, -1},
        {"inside", -1, -1, SKEL_PLACE_INSIDE, -1}, {"centroid", -1, -1, SKEL_PLACE_CENTROID, -1}, {"contracted", -1, -1, SKEL_PLACE_CONTRACTED, -1}, {"delta", -1, -1, -1, 1}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        if (strlen(words[i].name) != length || strncmp(words[i].name, word, length) != 0) continue;
        if (words[i].method >= 0) out->method = words[i].method;
        if (words[i].search >= 0) out->search = words[i].search;
        if (words[i].place >= 0) out->place = words[i].place;
        if (words[i].delta >= 0) out->by_delta = true;
        return true;
    }
    return false;
}

bool bench_parse_method(const char *item, bench_value *out)
{
    *out = (bench_value){.kind = VALUE_METHOD, .method = SKEL_METHOD_FAST, .search = SKEL_SEARCH_FLANN, .place = SKEL_PLACE_INSIDE};
    const char *at = strchr(item, '@');
    if (at == NULL || strlen(item) >= sizeof out->label) return false;
    for (const char *word = item; word < at;) {
        size_t length = strcspn(word, "+@");
        if (!take_word(word, length, out)) return false;
        word += length + 1;
    }
    char *end;
    if ((at[1] < '0' || at[1] > '9') && at[1] != '.') return false; /* no blanks, signs, inf, nan */
    out->number = strtod(at + 1, &end);
    if (end == at + 1 || *end != 0 || strpbrk(at, "xXpP") != NULL || !(out->number >= SKEL_MIN_OMEGA && out->number <= SKEL_MAX_OMEGA)) return false;
    snprintf(out->label, sizeof out->label, "%s", item);
    return at > item && at[-1] != '+';
}

/* --- a point ------------------------------------------------------------------------------------------------------ */

static void note_skeleton(const skel_skeleton *s, double *v)
{
    const skel_report *r = &s->report;
    v[COL_CONVERGED] = r->converged;
    v[COL_ITERATIONS] = (double)r->iterations;
    v[COL_VERTICES] = (double)r->tessellated_vertices;
    v[COL_JOINTS] = s->joint_count;
    v[COL_BONES] = s->bone_count;
    v[COL_COMPONENTS] = r->components;
    v[COL_ENDS] = r->ends;
    v[COL_BRANCHES] = r->branches;
    v[COL_LOOPS] = r->loops;
    v[COL_THINNESS] = r->thinness_error;
    v[COL_SURFACE_MEAN] = r->surface_distance_mean;
    v[COL_SURFACE_MAX] = r->surface_distance_max;
    v[COL_RECONSTRUCTION_MEAN] = r->reconstruction_mean;
    v[COL_RECONSTRUCTION_MAX] = r->reconstruction_max;
}

static svo_result skeleton_bytes(const skel_skeleton *s, double *bytes, svo_error *err)
{
    fmt_output *out;
    SVO_TRY(fmt_output_open("/dev/null", true, &out, err));
    svo_result r = fmt_skel_write(out, s, NULL, err);
    if (r == SVO_OK) *bytes = (double)fmt_output_offset(out);
    fmt_output_discard(out);
    return r;
}

/* What the literal iteration makes of the mesh, from before or made now (its time is not the point's). */
static svo_result literal_of(const bench *b, const svo_mesh *mesh, const svo_allocator *memory, const bench_value *value, bench_literals **all, const skel_skeleton **out, svo_error *err)
{
    for (bench_literals *l = *all; l != NULL; l = l->next)
        if (l->omega == value->number && l->place == value->place) {
            *out = &l->s;
            return SVO_OK;
        }
    skel_options o = skel_default_options();
    o.allocator = memory;
    o.omega = value->number;
    o.place = (skel_place)value->place;
    o.method = SKEL_METHOD_LITERAL;
    o.search = SKEL_SEARCH_GRID; /* the same curve, sooner */
    o.threads = (uint32_t)b->c->threads;
    o.skip_quality = true;
    bench_literals *l = calloc(1, sizeof *l);
    if (l == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_result r = skel_build_mesh(mesh, &o, &l->s, err);
    if (r != SVO_OK) {
        free(l);
        return r;
    }
    l->omega = value->number;
    l->place = value->place;
    l->next = *all;
    *all = l;
    *out = &l->s;
    return SVO_OK;
}

/* Of the sweep of methods: how good the curve is, by the same samples of the surface for every omega, and how far from the literal one. */
static svo_result judge(const bench *b, const svo_mesh *mesh, const svo_allocator *memory, const bench_value *value, const skel_skeleton *s, bench_literals **literals, double *v,
                        svo_error *err)
{
    skel_quality q;
    const skel_skeleton *literal = NULL;
    skel_distance d;
    SVO_TRY(skel_measure_quality(mesh, s, (uint32_t)b->c->threads, memory, &q, err));
    v[COL_INSIDE] = q.length_inside;
    v[COL_OFF_CENTRE] = q.off_centre_median;
    v[COL_BALLS_MEAN] = q.balls_mean;
    v[COL_BALLS_MAX] = q.balls_max;
    SVO_TRY(literal_of(b, mesh, memory, value, literals, &literal, err));
    skel_curve_distance(s, literal, &d);
    v[COL_LITERAL_MEAN] = fmax(d.mean[0], d.mean[1]) / (value->number * s->report.unit);
    v[COL_LITERAL_MAX] = 100 * fmax(d.max[0], d.max[1]) / s->report.unit;
    return SVO_OK;
}

svo_result bench_skeleton(bench *b, const svo_mesh *mesh, const svo_allocator *memory, const bench_value *value, bench_watch *watch, bench_literals **literals, double *v, svo_error *err)
{
    cli_phase(b->c, "skeleton");
    skel_options o = skel_default_options();
    o.omega = value->number;
    o.threads = (uint32_t)b->c->threads;
    if (value->kind == VALUE_METHOD) {
        o.method = (skel_method)value->method;
        o.search = (skel_search)value->search;
        o.place = (skel_place)value->place;
        o.delta = value->by_delta ? 0.05 : 0;
        o.skip_quality = true;
    }
    watch->count = 0;
    uint64_t peak = 0;
    for (uint64_t i = 0; i < b->repeat; i++) {
        svo_limit_allocator charged;
        svo_limit_allocator_init(&charged, UINT64_MAX, memory);
        o.allocator = &charged.base;
        o.warnings = i == 0 ? &b->c->warnings : NULL;
        skel_skeleton s = {0};
        bench_watch_start(watch);
        SVO_TRY(skel_build_mesh(mesh, &o, &s, err));
        bench_watch_stop(watch);
        svo_result r = SVO_OK;
        if (svo_limit_peak(&charged) > peak) peak = svo_limit_peak(&charged);
        if (i == 0) {
            note_skeleton(&s, v);
            r = skeleton_bytes(&s, &v[COL_SKEL_BYTES], err);
            if (r == SVO_OK && value->kind == VALUE_METHOD) r = judge(b, mesh, memory, value, &s, literals, v, err);
        }
        skel_skeleton_free(&s);
        if (r != SVO_OK) return r;
    }
    v[COL_SKELETON_WALL] = bench_median(watch->wall, watch->count);
    v[COL_SKELETON_CPU] = bench_median(watch->cpu, watch->count);
    v[COL_SKELETON_PEAK] = (double)peak;
    return SVO_OK;
}
