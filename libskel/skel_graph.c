/* The graph of a curve in the making: neighbours, merging of joints, division of bones. */
#include <math.h>
#include <string.h>

#include "skeli_curve.h"

svo_result skeli_fans_make(skeli_pool *pool, const skeli_curve *c, skeli_fans *out, svo_error *err)
{
    out->start = skeli_take(pool, (uint64_t)c->joints + 2, sizeof *out->start);
    out->bone = skeli_take(pool, 2 * c->bones, sizeof *out->bone);
    if (out->start == NULL || out->bone == NULL) return skeli_no_memory(err);
    memset(out->start, 0, ((size_t)c->joints + 2) * sizeof *out->start);
    for (uint64_t i = 0; i < 2 * c->bones; i++) out->start[c->bone[i] + 2]++;
    for (uint32_t j = 0; j < c->joints; j++) out->start[j + 2] += out->start[j + 1];
    for (uint64_t i = 0; i < 2 * c->bones; i++) out->bone[out->start[c->bone[i] + 1]++] = (uint32_t)(i / 2);
    return SVO_OK;
}

void skeli_fans_free(skeli_pool *pool, skeli_fans *f)
{
    skeli_give(pool, f->start);
    skeli_give(pool, f->bone);
}

static void walk_chain(const skeli_curve *c, const skeli_fans *fans, uint32_t from, uint32_t bone, bool *walked, skeli_chains *out)
{
    uint32_t n = out->start[out->count], at = from;
    out->joint[n++] = at;
    for (;;) {
        walked[bone] = true;
        at = c->bone[2 * (uint64_t)bone] == at ? c->bone[2 * (uint64_t)bone + 1] : c->bone[2 * (uint64_t)bone];
        out->joint[n++] = at;
        if (at == from || fans->start[at + 1] - fans->start[at] != 2) break;
        bone = fans->bone[fans->start[at]] == bone ? fans->bone[fans->start[at] + 1] : fans->bone[fans->start[at]];
    }
    out->start[++out->count] = n;
}

svo_result skeli_chains_make(skeli_pool *pool, const skeli_curve *c, skeli_chains *out, svo_error *err)
{
    skeli_fans fans;
    memset(out, 0, sizeof *out);
    SVO_TRY(skeli_fans_make(pool, c, &fans, err));
    out->start = skeli_take(pool, c->bones + 1, sizeof *out->start);
    out->joint = skeli_take(pool, 2 * c->bones, sizeof *out->joint);
    bool *walked = skeli_take(pool, c->bones, sizeof *walked);
    if (out->start == NULL || out->joint == NULL || walked == NULL) return skeli_no_memory(err);
    memset(walked, 0, c->bones * sizeof *walked);
    out->start[0] = 0;
    for (int loops = 0; loops < 2; loops++) /* what is left after the first pass are loops of joints with two bones */
        for (uint32_t j = 0; j < c->joints; j++) {
            if (loops == 0 && fans.start[j + 1] - fans.start[j] == 2) continue;
            for (uint32_t k = fans.start[j]; k < fans.start[j + 1]; k++)
                if (!walked[fans.bone[k]]) walk_chain(c, &fans, j, fans.bone[k], walked, out);
        }
    skeli_give(pool, walked);
    skeli_fans_free(pool, &fans);
    return SVO_OK;
}

void skeli_chains_free(skeli_pool *pool, skeli_chains *f)
{
    skeli_give(pool, f->start);
    skeli_give(pool, f->joint);
}

/* Order ends within bones, sort, drop double ones and those that are points. */
static svo_result tidy(skeli_pool *pool, skeli_curve *c, svo_error *err)
{
    uint32_t *scratch = skeli_take(pool, 2 * c->bones, sizeof *scratch), *bucket = skeli_take(pool, (uint64_t)c->joints + 1, sizeof *bucket);
    if (scratch == NULL || bucket == NULL) return skeli_no_memory(err);
    uint64_t kept = 0;
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t x = c->bone[2 * b], y = c->bone[2 * b + 1];
        if (x == y) continue;
        c->bone[2 * kept] = x < y ? x : y;
        c->bone[2 * kept++ + 1] = x < y ? y : x;
    }
    c->bones = skeli_sort_unique(c->bone, kept, 2, c->joints, scratch, bucket);
    skeli_give(pool, scratch);
    skeli_give(pool, bucket);
    return SVO_OK;
}

svo_result skeli_curve_merge(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, uint32_t *into, svo_error *err)
{
    uint32_t *number = skeli_take(pool, c->joints, sizeof *number), n = 0;
    if (number == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < c->joints; j++) {
        uint32_t r = j;
        while (into[r] != r) r = into[r];
        into[j] = r;
    }
    for (uint32_t j = 0; j < c->joints; j++) {
        if (into[j] != j) continue;
        memmove(c->position + 3 * (uint64_t)n, c->position + 3 * (uint64_t)j, 3 * sizeof *c->position);
        number[j] = n++;
    }
    for (uint64_t i = 0; i < 2 * c->bones; i++) c->bone[i] = number[into[c->bone[i]]];
    for (uint32_t v = 0; v < mesh->vertex_count; v++) c->joint_of[v] = number[into[c->joint_of[v]]];
    c->joints = n;
    skeli_give(pool, number);
    return tidy(pool, c, err);
}

svo_result skeli_curve_betti(skeli_pool *pool, const skeli_curve *c, uint32_t *components, uint64_t *loops, svo_error *err)
{
    uint32_t *parent = skeli_take(pool, c->joints, sizeof *parent);
    if (parent == NULL) return skeli_no_memory(err);
    for (uint32_t j = 0; j < c->joints; j++) parent[j] = j;
    *components = c->joints;
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t p = skeli_root(parent, c->bone[2 * b]), q = skeli_root(parent, c->bone[2 * b + 1]);
        if (p == q) continue;
        parent[p > q ? p : q] = p > q ? q : p;
        --*components;
    }
    *loops = c->bones + *components - c->joints;
    skeli_give(pool, parent);
    return SVO_OK;
}

static double distance2(const double *p, const int32_t *q)
{
    double x = p[0] - q[0], y = p[1] - q[1], z = p[2] - q[2];
    return x * x + y * y + z * z;
}

svo_result skeli_curve_insert(skeli_pool *pool, const skeli_soup *mesh, skeli_curve *c, const uint32_t *count, const uint64_t *first, const double *point, svo_error *err)
{
    uint64_t more = 0;
    for (uint64_t b = 0; b < c->bones; b++) more += count[b];
    if (more == 0) return SVO_OK;
    skeli_fans fans;
    SVO_TRY(skeli_fans_make(pool, c, &fans, err));
    double *position = skeli_take(pool, 3 * (c->joints + more), sizeof *position);
    uint32_t *bone = skeli_take(pool, 2 * (c->bones + more), sizeof *bone), *begin = skeli_take(pool, c->bones, sizeof *begin);
    if (position == NULL || bone == NULL || begin == NULL) return skeli_no_memory(err);
    memcpy(position, c->position, 3 * (uint64_t)c->joints * sizeof *position);
    uint32_t next = c->joints;
    uint64_t bones = 0;
    for (uint64_t b = 0; b < c->bones; b++) {
        uint32_t from = c->bone[2 * b];
        begin[b] = next;
        for (uint32_t k = 0; k < count[b]; k++) {
            memcpy(position + 3 * (uint64_t)next, point + 3 * (first[b] + k), 3 * sizeof *position);
            bone[2 * bones] = from;
            bone[2 * bones++ + 1] = next;
            from = next++;
        }
        bone[2 * bones] = from;
        bone[2 * bones++ + 1] = c->bone[2 * b + 1];
    }
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
        const int32_t *q = mesh->position + 3 * (uint64_t)v;
        uint32_t j = c->joint_of[v], best = j;
        double best2 = distance2(position + 3 * (uint64_t)j, q);
        for (uint32_t k = fans.start[j]; k < fans.start[j + 1]; k++) {
            uint32_t b = fans.bone[k];
            for (uint32_t i = 0; i < count[b]; i++) {
                double d2 = distance2(position + 3 * (uint64_t)(begin[b] + i), q);
                if (d2 >= best2) continue;
                best2 = d2;
                best = begin[b] + i;
            }
        }
        c->joint_of[v] = best;
    }
    skeli_give(pool, c->position);
    skeli_give(pool, c->bone);
    skeli_give(pool, begin);
    skeli_fans_free(pool, &fans);
    c->position = position;
    c->bone = bone;
    c->joints = next;
    c->bones = bones;
    return tidy(pool, c, err);
}
