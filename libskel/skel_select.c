/* Which bones a refinement takes: its text, and the choice. */
#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "skeli_refine.h"

/* --- text --------------------------------------------------------------------------------------------------------- */

static svo_result bad(const char *item, size_t length, const char *what, svo_error *err)
{
    return svo_fail(err, SVO_INVALID_ARGUMENT, "refinement \"%.*s\": %s", length < 200 ? (int)length : 200, item, what);
}

/* n numbers with commas between, and nothing after them up to `end`. */
static bool read_numbers(const char *text, const char *end, int n, double *out)
{
    for (int i = 0; i < n; i++) {
        char *after;
        if (text >= end || isspace((unsigned char)*text)) return false;
        out[i] = strtod(text, &after);
        if (after == text || after > end || !isfinite(out[i])) return false;
        text = after;
        if (i + 1 < n && (text >= end || *text++ != ',')) return false;
    }
    return text == end;
}

static bool read_number(const char **text, const char *end, uint32_t *out)
{
    uint64_t v = 0;
    const char *p = *text;
    while (p < end && isdigit((unsigned char)*p) && v < UINT32_MAX) v = 10 * v + (uint64_t)(*p++ - '0');
    if (p == *text || v >= SVO_NONE) return false;
    *text = p;
    *out = (uint32_t)v;
    return true;
}

/* 3,7-12: pairs into range (NULL: only counted); false where it is none. */
static bool read_ranges(const char *p, const char *end, uint32_t *range, uint32_t *count)
{
    for (*count = 0;; p++) {
        uint32_t first, last;
        if (!read_number(&p, end, &first)) return false;
        last = first;
        if (p < end && *p == '-' && (p++, !read_number(&p, end, &last))) return false;
        if (last < first) return false;
        if (range != NULL) {
            range[2 * *count] = first;
            range[2 * *count + 1] = last;
        }
        ++*count;
        if (p == end) return true;
        if (*p != ',') return false;
    }
}

static bool begins(const char *text, const char *end, const char *word) { return (size_t)(end - text) >= strlen(word) && memcmp(text, word, strlen(word)) == 0; }

static svo_result parse_one(const char *text, size_t length, const svo_allocator *a, skel_refine *r, svo_error *err)
{
    const char *end = text + length, *at = memchr(text, '@', length);
    if (at == NULL) return bad(text, length, "needs @ and an omega after what it selects", err);
    if (!read_numbers(at + 1, end, 1, &r->omega)) return bad(text, length, "there is no number after the @", err);
    if (!(r->omega >= SKEL_MIN_OMEGA && r->omega <= SKEL_MAX_OMEGA)) return bad(text, length, "its omega must be 0.0001 to 4", err);
    if (begins(text, at, "box:")) {
        r->select = SKEL_SELECT_BOX;
        if (!read_numbers(text + 4, at, 6, r->where)) return bad(text, length, "a box is box:X0,Y0,Z0,X1,Y1,Z1", err);
    } else if (begins(text, at, "ball:")) {
        r->select = SKEL_SELECT_BALL;
        if (!read_numbers(text + 5, at, 4, r->where) || !(r->where[3] > 0)) return bad(text, length, "a ball is ball:X,Y,Z,R with a radius above 0", err);
    } else if (begins(text, at, "thin:")) {
        r->select = SKEL_SELECT_THIN;
        if (!read_numbers(text + 5, at, 1, r->where) || !(r->where[0] > 0)) return bad(text, length, "thin:R needs a radius above 0, as a part of the model's size", err);
    } else if (at - text == 4 && memcmp(text, "ends", 4) == 0) {
        r->select = SKEL_SELECT_ENDS;
    } else {
        r->select = SKEL_SELECT_BONES;
        if (!read_ranges(text, at, NULL, &r->range_count)) return bad(text, length, "selects nothing: write bone numbers (3,7-12), ends, thin:R, ball:X,Y,Z,R or box:X0,Y0,Z0,X1,Y1,Z1", err);
        r->range = svo_alloc(a, 2 * (uint64_t)r->range_count, sizeof *r->range);
        if (r->range == NULL) return skeli_no_memory(err);
        (void)read_ranges(text, at, r->range, &r->range_count);
    }
    return SVO_OK;
}

svo_result skel_refine_parse(const char *text, const svo_allocator *a, skel_refine **out, uint32_t *count, svo_error *err)
{
    uint32_t n = 1;
    for (const char *p = text; *p != 0; p++) n += *p == ';';
    skel_refine *list = svo_calloc(a, n, sizeof *list);
    if (list == NULL) return skeli_no_memory(err);
    svo_result r = SVO_OK;
    const char *p = text;
    for (uint32_t i = 0; i < n && r == SVO_OK; i++) {
        size_t length = strcspn(p, ";");
        r = parse_one(p, length, a, &list[i], err);
        p += length + 1;
    }
    if (r != SVO_OK) {
        skel_refine_free(a, list, n);
        return r;
    }
    *out = list;
    *count = n;
    return SVO_OK;
}

void skel_refine_free(const svo_allocator *a, skel_refine *list, uint32_t count)
{
    for (uint32_t i = 0; list != NULL && i < count; i++) svo_free(a, list[i].range, 2 * (uint64_t)list[i].range_count, sizeof *list[i].range);
    svo_free(a, list, count, sizeof *list);
}

/* --- choice ------------------------------------------------------------------------------------------------------- */

static bool takes(const skel_skeleton *s, const skel_refine *r, uint32_t bone)
{
    const skel_joint *a = &s->joints[s->bones[bone].a], *b = &s->joints[s->bones[bone].b];
    double d2 = 0;
    switch (r->select) {
    case SKEL_SELECT_BOX:
        for (int k = 0; k < 3; k++) {
            double m = 0.5 * (a->position[k] + b->position[k]);
            if (!(m >= r->where[k] && m <= r->where[3 + k])) return false;
        }
        return true;
    case SKEL_SELECT_BALL:
        for (int k = 0; k < 3; k++) {
            double d = 0.5 * (a->position[k] + b->position[k]) - r->where[k];
            d2 += d * d;
        }
        return d2 <= r->where[3] * r->where[3];
    case SKEL_SELECT_THIN: return 0.5 * (a->radius + b->radius) <= r->where[0] * s->report.unit;
    case SKEL_SELECT_BONES:
        for (uint32_t i = 0; i < r->range_count; i++)
            if (bone >= r->range[2 * i] && bone <= r->range[2 * i + 1]) return true;
        return false;
    case SKEL_SELECT_ENDS: break; /* below: it needs the whole curve */
    }
    return false;
}

svo_result skeli_spokes_make(skeli_pool *pool, const skel_skeleton *s, skeli_spokes *out, svo_error *err)
{
    out->start = skeli_take(pool, (uint64_t)s->joint_count + 2, sizeof *out->start);
    out->bone = skeli_take(pool, 2 * (uint64_t)s->bone_count, sizeof *out->bone);
    if (out->start == NULL || out->bone == NULL) return skeli_no_memory(err);
    memset(out->start, 0, ((size_t)s->joint_count + 2) * sizeof *out->start);
    for (uint32_t b = 0; b < s->bone_count; b++) {
        out->start[s->bones[b].a + 2]++;
        out->start[s->bones[b].b + 2]++;
    }
    for (uint32_t j = 0; j < s->joint_count; j++) out->start[j + 2] += out->start[j + 1];
    for (uint32_t b = 0; b < s->bone_count; b++) {
        out->bone[out->start[s->bones[b].a + 1]++] = b;
        out->bone[out->start[s->bones[b].b + 1]++] = b;
    }
    return SVO_OK;
}

static void take_ends(const skel_skeleton *s, const skeli_spokes *spokes, uint32_t number, uint32_t *chosen)
{
    for (uint32_t end = 0; end < s->joint_count; end++) {
        uint32_t at = end, from = SVO_NONE;
        if (spokes->start[at + 1] - spokes->start[at] != 1) continue;
        do { /* a chain that begins at an end cannot come back to it but at another end */
            uint32_t k = spokes->start[at], bone = spokes->bone[k] != from ? spokes->bone[k] : spokes->bone[k + 1];
            if (chosen[bone] == SVO_NONE) chosen[bone] = number;
            at = s->bones[bone].a == at ? s->bones[bone].b : s->bones[bone].a;
            from = bone;
        } while (spokes->start[at + 1] - spokes->start[at] == 2);
    }
}

svo_result skeli_select(const skel_skeleton *s, const skel_refine *list, uint32_t count, uint32_t *chosen, svo_error *err)
{
    for (uint32_t b = 0; b < s->bone_count; b++) chosen[b] = SVO_NONE;
    skeli_pool pool = {.allocator = s->allocator};
    skeli_spokes spokes;
    svo_result result = skeli_spokes_make(&pool, s, &spokes, err);
    for (uint32_t i = 0; i < count && result == SVO_OK; i++) {
        const skel_refine *r = &list[i];
        for (uint32_t k = 0; r->select == SKEL_SELECT_BONES && k < r->range_count; k++)
            if (r->range[2 * k + 1] >= s->bone_count)
                result = svo_fail(err, SVO_INVALID_ARGUMENT, "there is no bone %u to refine; without refinement the skeleton has %u bones, numbered from 0", r->range[2 * k + 1], s->bone_count);
        if (r->select == SKEL_SELECT_ENDS && result == SVO_OK) take_ends(s, &spokes, i, chosen);
        for (uint32_t b = 0; b < s->bone_count && result == SVO_OK && r->select != SKEL_SELECT_ENDS; b++)
            if (chosen[b] == SVO_NONE && takes(s, r, b)) chosen[b] = i;
    }
    skeli_pool_free(&pool);
    return result;
}
