/* Faces of cells whose corners have been moved: an octree under a pose, as a mesh. */
#include <math.h>
#include <string.h>

#include "fmt_cells.h"
#include "fmti_cells.h"

/* A corner of some face, and the images that it has been given. */
typedef struct moved {
    uint32_t at[3]; /* UINT32_MAX in at[0]: a free slot */
    uint32_t images : 31, sure : 1;
    double sum[3];
} moved;

typedef struct corners {
    const svo_allocator *allocator;
    moved *slot;
    uint64_t slots, used;
} corners;

static uint64_t hash(const uint32_t at[3])
{
    uint64_t h = ((uint64_t)at[0] << 43 ^ (uint64_t)at[1] << 22 ^ at[2]) * 0x9e3779b97f4a7c15u;
    return h ^ h >> 29;
}

/* Where a corner is, or the free slot for it. */
static moved *find(const corners *t, const uint32_t at[3])
{
    uint64_t i = hash(at) & (t->slots - 1);
    while (t->slot[i].at[0] != UINT32_MAX && memcmp(t->slot[i].at, at, sizeof t->slot[i].at) != 0) i = (i + 1) & (t->slots - 1);
    return &t->slot[i];
}

static svo_result resize(corners *t, uint64_t slots, svo_error *err)
{
    corners bigger = {.allocator = t->allocator, .slots = slots, .used = t->used, .slot = svo_alloc(t->allocator, slots, sizeof *t->slot)};
    if (bigger.slot == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the corners of the faces");
    for (uint64_t i = 0; i < slots; i++) bigger.slot[i] = (moved){.at = {UINT32_MAX}};
    for (uint64_t i = 0; i < t->slots; i++)
        if (t->slot[i].at[0] != UINT32_MAX) *find(&bigger, t->slot[i].at) = t->slot[i];
    svo_free(t->allocator, t->slot, t->slots, sizeof *t->slot);
    *t = bigger;
    return SVO_OK;
}

static svo_result add(corners *t, const uint32_t at[3], svo_error *err)
{
    if (2 * (t->used + 1) > t->slots) SVO_TRY(resize(t, t->slots == 0 ? 1024 : 2 * t->slots, err));
    moved *m = find(t, at);
    if (m->at[0] != UINT32_MAX) return SVO_OK;
    memcpy(m->at, at, sizeof m->at);
    t->used++;
    return SVO_OK;
}

static svo_result bend_all(const fmt_cells *c, const fmt_cells_bend *bend, const fmt_cell_face *f, uint64_t count, corners *t, svo_buffer *out, svo_error *err)
{
    uint32_t at[3];
    for (uint64_t i = 0; i < 4 * count; i++) {
        fmt_cell_corner(&f[i / 4], i % 4, at);
        SVO_TRY(add(t, at, err));
    }
    for (uint64_t i = 0; i < c->count; i++)
        for (uint32_t k = 0; k < 8; k++) {
            for (uint32_t a = 0; a < 3; a++) at[a] = c->cell[i].at[a] + (k >> a & 1);
            moved *m = find(t, at);
            if (m->at[0] == UINT32_MAX) continue; /* inside */
            double image[3];
            const bool sure = bend->corner(bend->user, i, at, image);
            if (m->sure && !sure) continue;
            if (sure && !m->sure) *m = (moved){.at = {at[0], at[1], at[2]}, .sure = 1};
            for (int a = 0; a < 3; a++) m->sum[a] += image[a];
            m->images++;
        }
    for (uint64_t i = 0; i < count; i++) {
        fmt_bent_face b;
        memcpy(b.rgb, f[i].rgb, sizeof b.rgb);
        for (uint32_t k = 0; k < 4; k++) {
            fmt_cell_corner(&f[i], bend->mirrored ? 3 - k : k, at);
            const moved *m = find(t, at);
            for (int a = 0; a < 3; a++) {
                b.corner[k][a] = (float)(m->sum[a] / m->images);
                if (!isfinite(b.corner[k][a])) return svo_fail(err, SVO_INVALID_DATA, "a corner of a voxel goes beyond what single precision holds");
            }
        }
        if (svo_buffer_append(out, &b, sizeof b) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the faces");
    }
    return SVO_OK;
}

svo_result fmt_cells_bent_faces(const fmt_cells *c, const fmt_cells_bend *bend, svo_buffer *out, svo_error *err)
{
    svo_buffer list;
    corners t = {.allocator = c->allocator};
    svo_buffer_init(&list, c->allocator);
    svo_result r = fmti_cells_faces(c, true, &list, err);
    if (r == SVO_OK) r = bend_all(c, bend, (const fmt_cell_face *)(const void *)list.data, list.size / sizeof(fmt_cell_face), &t, out, err);
    svo_free(c->allocator, t.slot, t.slots, sizeof *t.slot);
    svo_buffer_free(&list);
    return r;
}
