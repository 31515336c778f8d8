#include "svoi_pack.h"

#include <string.h>

void svoi_pose_table_init(svoi_pose_table *t, const svo_allocator *a)
{
    memset(t, 0, sizeof *t);
    t->allocator = a;
    svo_buffer_init(&t->poses, a);
    svo_buffer_init(&t->matrices, a);
    svo_buffer_init(&t->run_length, a);
}

void svoi_pose_table_free(svoi_pose_table *t)
{
    svo_buffer_free(&t->poses);
    svo_buffer_free(&t->matrices);
    svo_buffer_free(&t->run_length);
    svo_free(t->allocator, t->pose_slot, t->pose_slots, sizeof *t->pose_slot);
    svo_free(t->allocator, t->run_slot, t->run_slots, sizeof *t->run_slot);
    t->pose_slot = t->run_slot = NULL;
}

enum { POSE_BYTES = sizeof(svo_pose), MATRIX_BYTES = 12 * sizeof(float) };

/* NULL while there is none: even zero may not be added to a null pointer. */
static svo_pose *pose_at(const svoi_pose_table *t, uint64_t i) { return t->poses.data != NULL ? (svo_pose *)(void *)t->poses.data + i : NULL; }
static uint64_t pose_count(const svoi_pose_table *t) { return t->poses.size / POSE_BYTES; }
static const float *matrix_at(const svoi_pose_table *t, uint64_t i) { return t->matrices.data != NULL ? (const float *)(const void *)t->matrices.data + 12 * i : NULL; }
static uint64_t matrix_count(const svoi_pose_table *t) { return t->matrices.size / MATRIX_BYTES; }
static uint32_t run_length(const svoi_pose_table *t, uint64_t i) { return ((const uint32_t *)(const void *)t->run_length.data)[i]; }

svo_poses svoi_pose_table_get(const svoi_pose_table *t)
{
    return (svo_poses){.count = (uint32_t)pose_count(t), .pose = pose_at(t, 0), .matrix_count = matrix_count(t), .matrix = matrix_at(t, 0)};
}

static svo_result no_memory(svo_error *err) { return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the poses of a scene"); }

static uint64_t hash_bytes(const void *bytes, uint64_t size)
{
    const uint8_t *b = bytes;
    uint64_t h = size * 0x9e3779b97f4a7c15u, w;
    for (uint64_t i = 0; i < size; i += 4) {
        uint32_t part;
        memcpy(&part, b + i, 4);
        w = part;
        h = (h ^ w) * 0x9e3779b97f4a7c15u;
        h ^= h >> 29;
    }
    return h;
}

/* Slots of twice the size, with the numbers + 1 of what was in the old ones put again by `hash`. */
static bool grow(svoi_pose_table *t, uint32_t **slot, uint64_t *slots, uint64_t (*hash)(const svoi_pose_table *, uint64_t))
{
    uint64_t more = *slots == 0 ? 64 : 2 * *slots;
    uint32_t *to = svo_calloc(t->allocator, more, sizeof *to);
    if (to == NULL) return false;
    for (uint64_t i = 0; i < *slots; i++) {
        if ((*slot)[i] == 0) continue;
        uint64_t at = hash(t, (*slot)[i] - 1) & (more - 1);
        while (to[at] != 0) at = (at + 1) & (more - 1);
        to[at] = (*slot)[i];
    }
    svo_free(t->allocator, *slot, *slots, sizeof **slot);
    *slot = to, *slots = more;
    return true;
}

static uint64_t hash_pose(const svoi_pose_table *t, uint64_t i) { return hash_bytes(pose_at(t, i), POSE_BYTES); }
static uint64_t hash_run(const svoi_pose_table *t, uint64_t i) { return hash_bytes(matrix_at(t, i), (uint64_t)run_length(t, i) * MATRIX_BYTES); }

/* Where a run of matrices is, or is put. */
static svo_result add_run(svoi_pose_table *t, const float *m, uint32_t count, uint32_t *out, svo_error *err)
{
    uint64_t bytes = (uint64_t)count * MATRIX_BYTES;
    if (2 * (t->runs + 1) > t->run_slots && !grow(t, &t->run_slot, &t->run_slots, hash_run)) return no_memory(err);
    uint64_t at = hash_bytes(m, bytes) & (t->run_slots - 1);
    for (; t->run_slot[at] != 0; at = (at + 1) & (t->run_slots - 1)) {
        uint64_t first = t->run_slot[at] - 1;
        if (run_length(t, first) != count || memcmp(matrix_at(t, first), m, (size_t)bytes) != 0) continue;
        t->matrices_shared += count;
        *out = (uint32_t)first;
        return SVO_OK;
    }
    uint64_t first = matrix_count(t);
    if (first + count >= UINT32_MAX) return svo_fail(err, SVO_LIMIT, "the poses have more than 2^32 - 1 matrices");
    uint32_t *length = NULL;
    if (svo_buffer_append(&t->matrices, m, (size_t)bytes) != NULL) length = svo_buffer_append(&t->run_length, NULL, count * sizeof *length);
    if (length == NULL) return no_memory(err);
    *length = count;
    t->run_slot[at] = (uint32_t)first + 1;
    t->runs++;
    *out = (uint32_t)first;
    return SVO_OK;
}

static svo_result add_matrices(svoi_pose_table *t, const svo_poses *from, svo_pose *p, const double shift[3], svo_error *err)
{
    static const uint32_t limit = 1u << 20;
    double back[3] = {-shift[0], -shift[1], -shift[2]};
    float one[12];
    if ((p->flags & SVO_POSE_MATRIX) != 0) {
        memcpy(one, from->matrix + 12 * (uint64_t)p->matrix, sizeof one);
        svo_pose_shift(one, back);
        if (svo_pose_matrix_is_identity(one)) p->flags &= ~(uint32_t)SVO_POSE_MATRIX, p->matrix = 0;
        else SVO_TRY(add_run(t, one, 1, &p->matrix, err));
    }
    if ((p->flags & SVO_POSE_BONES) == 0) return SVO_OK;
    while (p->bone_count != 0 && svo_pose_matrix_is_identity(from->matrix + 12 * ((uint64_t)p->bone_first + p->bone_count - 1))) p->bone_count--, t->bones_rest++;
    if (p->bone_count == 0) {
        p->flags &= ~(uint32_t)SVO_POSE_BONES, p->bone_first = 0;
        return SVO_OK;
    }
    if (p->bone_count > limit) return svo_fail(err, SVO_LIMIT, "a pose has more than %u bones", limit);
    float *m = svo_alloc(t->allocator, p->bone_count, MATRIX_BYTES);
    if (m == NULL) return no_memory(err);
    memcpy(m, from->matrix + 12 * (uint64_t)p->bone_first, (size_t)p->bone_count * MATRIX_BYTES);
    for (uint64_t b = 0; b < p->bone_count; b++) svo_pose_shift(m + 12 * b, back);
    svo_result result = add_run(t, m, p->bone_count, &p->bone_first, err);
    svo_free(t->allocator, m, p->bone_count, MATRIX_BYTES);
    return result;
}

svo_result svoi_pose_table_add(svoi_pose_table *t, const svo_poses *from, uint32_t number, const double low[3], const double high[3], const double shift[3],
                               uint32_t *out, svo_error *err)
{
    svo_pose p = from->pose[number];
    svo_pose_resolve(&p, low, high);
    *out = SVO_NO_POSE;
    const char *fault = svo_pose_fault(from, &p);
    if (fault != NULL) return svo_fail(err, SVO_INVALID_DATA, "a pose cannot be used: %s", fault);
    if (svo_pose_is_rest(from, &p)) {
        t->rest++;
        return SVO_OK;
    }
    if ((p.flags & (SVO_POSE_TWIST | SVO_POSE_BEND)) != 0)
        for (int k = 0; k < 3; k++) p.pivot[k] = (float)(p.pivot[k] - shift[k]);
    SVO_TRY(add_matrices(t, from, &p, shift, err));
    if (2 * (pose_count(t) + 1) > t->pose_slots && !grow(t, &t->pose_slot, &t->pose_slots, hash_pose)) return no_memory(err);
    uint64_t at = hash_bytes(&p, POSE_BYTES) & (t->pose_slots - 1);
    for (; t->pose_slot[at] != 0; at = (at + 1) & (t->pose_slots - 1)) {
        if (memcmp(pose_at(t, t->pose_slot[at] - 1), &p, POSE_BYTES) != 0) continue;
        t->shared++;
        *out = t->pose_slot[at] - 1;
        return SVO_OK;
    }
    uint64_t n = pose_count(t);
    if (n >= UINT32_MAX - 1) return svo_fail(err, SVO_LIMIT, "more than 2^32 - 2 poses");
    if (svo_buffer_append(&t->poses, &p, sizeof p) == NULL) return no_memory(err);
    t->pose_slot[at] = (uint32_t)n + 1;
    *out = (uint32_t)n;
    return SVO_OK;
}
