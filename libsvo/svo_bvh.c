#include "svoi_bvh.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "svo_alloc.h"
#include "svo_task.h"

/* What is sorted while building. */
typedef struct entry {
    float low[3];
    uint32_t item;
    float high[3];
    uint32_t unused;
} entry;

enum { BINS = 16, MAX_LEAF = 4 };

/* ---- placing instances -------------------------------------------------------------------------------------------- */

/* Largest singular value of a 3x3 matrix, never too small: Jacobi rotations of A^T A, then Gershgorin's bound. */
static double largest_stretch(const double a[9])
{
    double g[3][3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) g[i][j] = a[i] * a[j] + a[3 + i] * a[3 + j] + a[6 + i] * a[6 + j];
    double trace = g[0][0] + g[1][1] + g[2][2];
    for (int sweep = 0; sweep < 8; sweep++) {
        if (fabs(g[0][1]) + fabs(g[0][2]) + fabs(g[1][2]) <= 1e-9 * trace) break;
        for (int p = 0; p < 2; p++)
            for (int q = p + 1; q < 3; q++) {
                if (g[p][q] == 0) continue;
                double theta = (g[q][q] - g[p][p]) / (2 * g[p][q]);
                double t = (theta >= 0 ? 1 : -1) / (fabs(theta) + sqrt(theta * theta + 1));
                double c = 1 / sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 3; k++) {
                    double x = g[k][p], y = g[k][q];
                    g[k][p] = c * x - s * y, g[k][q] = s * x + c * y;
                }
                for (int k = 0; k < 3; k++) {
                    double x = g[p][k], y = g[q][k];
                    g[p][k] = c * x - s * y, g[q][k] = s * x + c * y;
                }
            }
    }
    double most = 0;
    for (int i = 0; i < 3; i++) most = fmax(most, fabs(g[i][0]) + fabs(g[i][1]) + fabs(g[i][2]));
    return sqrt(most);
}

svo_mat4 svoi_grid_to_scene(const svo_scene *s, uint32_t page, uint64_t instance)
{
    svo_mat4 grid, place = svo_scene_instance_transform(s, page, instance);
    memcpy(grid.m, s->assets[s->instance_asset[instance]]->voxel_to_world, sizeof grid.m);
    return svo_mat4_mul(place, grid);
}

typedef enum fate { PLACED, EMPTY, SINGULAR } fate;

static fate place(const svo_scene *s, uint32_t page, uint64_t instance, svo_placed *out)
{
    uint32_t asset = s->instance_asset[instance];
    if (s->assets[asset]->empty) return EMPTY;
    svo_mat4 m = svoi_grid_to_scene(s, page, instance), inverse;
    for (int i = 0; i < 12; i++)
        if (!isfinite(m.m[i])) return SINGULAR;
    if (!svo_mat4_affine_inverse(&m, &inverse)) return SINGULAR;
    double linear[9];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            linear[3 * i + j] = m.m[4 * i + j];
            out->to_grid[3 * i + j] = inverse.m[4 * i + j];
        }
        out->origin[i] = m.m[4 * i + 3];
    }
    out->stretch = largest_stretch(linear);
    out->instance = instance;
    out->asset = asset;
    out->page = page;
    return out->stretch > 0 && isfinite(out->stretch) ? PLACED : SINGULAR;
}

typedef struct placing {
    const svo_scene *scene;
    svo_placed *placed;
    uint8_t *fates;
} placing;

/* Items are pages: the page of an instance is then known without a search. */
static svo_result place_pages(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    placing *p = user;
    for (uint64_t page = begin; page < end; page++) {
        const svo_scene_page *g = &p->scene->pages[page];
        for (uint64_t i = g->first; i < g->first + g->count; i++) p->fates[i] = (uint8_t)place(p->scene, (uint32_t)page, i, &p->placed[i]);
    }
    return SVO_OK;
}

static uint64_t hash_place(const svo_placed *p)
{
    uint64_t h = p->asset, w;
    for (int i = 0; i < 12; i++) {
        memcpy(&w, i < 9 ? &p->to_grid[i] : &p->origin[i - 9], 8);
        h = (h ^ w) * 0x9e3779b97f4a7c15u;
        h ^= h >> 29;
    }
    return h;
}

static bool same_place(const svo_placed *a, const svo_placed *b)
{
    return a->asset == b->asset && memcmp(a->to_grid, b->to_grid, sizeof a->to_grid) == 0 && memcmp(a->origin, b->origin, sizeof a->origin) == 0;
}

/* Keep what can be hit and seen, in scene order. */
static svo_result compact(svo_bvh *b, const uint8_t *fates, uint64_t count, svo_bvh_report *report, svo_error *err)
{
    uint64_t size = 16;
    while (size < 2 * count) size *= 2;
    uint32_t *table = svo_alloc(b->allocator, size, sizeof *table);
    if (table == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %llu instances", (unsigned long long)count);
    memset(table, 0xff, size * sizeof *table);
    uint64_t kept = 0;
    for (uint64_t i = 0; i < count; i++) {
        if (fates[i] == EMPTY) report->empty++;
        if (fates[i] == SINGULAR) report->singular++;
        if (fates[i] != PLACED) continue;
        uint64_t slot = hash_place(&b->placed[i]) & (size - 1);
        while (table[slot] != UINT32_MAX && !same_place(&b->placed[table[slot]], &b->placed[i])) slot = (slot + 1) & (size - 1);
        if (table[slot] != UINT32_MAX) {
            report->duplicates++;
            continue;
        }
        table[slot] = (uint32_t)kept;
        b->placed[kept++] = b->placed[i];
    }
    svo_free(b->allocator, table, size, sizeof *table);
    b->placed_count = kept;
    return SVO_OK;
}

/* ---- boxes -------------------------------------------------------------------------------------------------------- */

typedef struct boxing {
    const svo_bvh *bvh;
    const double (*bounds)[6]; /* per asset: centre and half size of the voxels, in the grid */
    entry *entries;
} boxing;

static float round_down(double x) { float f = (float)x; return (double)f > x ? nextafterf(f, -INFINITY) : f; }
static float round_up(double x) { float f = (float)x; return (double)f < x ? nextafterf(f, INFINITY) : f; }

static void item_box(const svo_bvh *b, const svo_placed *p, const double bounds[6], double low[3], double high[3])
{
    svo_mat4 m = svoi_grid_to_scene(b->scene, p->page, p->instance);
    for (int i = 0; i < 3; i++) {
        double c = m.m[4 * i + 3], h = 0, size = fabs(c);
        for (int j = 0; j < 3; j++) {
            double x = m.m[4 * i + j] * bounds[j];
            c += x, size += fabs(x);
            h += fabs(m.m[4 * i + j]) * bounds[3 + j];
        }
        h += 1e-15 * size + 1e-13 * h; /* rounding of this sum and of to_grid */
        low[i] = c - h, high[i] = c + h;
    }
}

static svo_result box_items(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker, (void)err;
    boxing *x = user;
    for (uint64_t i = begin; i < end; i++) {
        double low[3], high[3];
        item_box(x->bvh, &x->bvh->placed[i], x->bounds[x->bvh->placed[i].asset], low, high);
        for (int k = 0; k < 3; k++) {
            x->entries[i].low[k] = round_down(low[k] - x->bvh->centre[k]);
            x->entries[i].high[k] = round_up(high[k] - x->bvh->centre[k]);
        }
        x->entries[i].item = (uint32_t)i;
        x->entries[i].unused = 0;
    }
    return SVO_OK;
}

/* ---- the hierarchy: binned surface-area heuristic (Wald 2007), top down -------------------------------------------- */

typedef struct box { float low[3], high[3]; } box;

static void box_clear(box *b)
{
    for (int k = 0; k < 3; k++) b->low[k] = INFINITY, b->high[k] = -INFINITY;
}
static void box_add(box *b, const float low[3], const float high[3])
{
    for (int k = 0; k < 3; k++) {
        b->low[k] = low[k] < b->low[k] ? low[k] : b->low[k];
        b->high[k] = high[k] > b->high[k] ? high[k] : b->high[k];
    }
}
static double box_area(const box *b)
{
    double x = (double)b->high[0] - b->low[0], y = (double)b->high[1] - b->low[1], z = (double)b->high[2] - b->low[2];
    return x >= 0 ? x * y + y * z + z * x : 0;
}
static float middle(const entry *e, int k) { return 0.5f * e->low[k] + 0.5f * e->high[k]; }

typedef struct split { double cost; int axis; float low, scale; uint32_t bin; } split;

static uint32_t bin_of(float x, float low, float scale)
{
    float f = (x - low) * scale;
    return f >= BINS - 1 ? BINS - 1 : f > 0 ? (uint32_t)f : 0;
}

/* Cheapest split of entries between two bins of an axis; axis < 0 when all middles coincide. */
static split best_split(const entry *e, uint64_t count)
{
    split best = {INFINITY, -1, 0, 0, 0};
    float low[3], scale[3];
    box middles;
    box_clear(&middles);
    for (uint64_t i = 0; i < count; i++) {
        float m[3] = {middle(&e[i], 0), middle(&e[i], 1), middle(&e[i], 2)};
        box_add(&middles, m, m);
    }
    box bins[3][BINS];
    uint64_t counts[3][BINS] = {{0}};
    for (int k = 0; k < 3; k++) {
        low[k] = middles.low[k];
        float extent = middles.high[k] - low[k];
        scale[k] = extent > 0 && isfinite(extent) && isfinite(BINS / extent) ? BINS / extent : 0;
        for (int b = 0; b < BINS; b++) box_clear(&bins[k][b]);
    }
    for (uint64_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) {
            uint32_t b = bin_of(middle(&e[i], k), low[k], scale[k]);
            box_add(&bins[k][b], e[i].low, e[i].high);
            counts[k][b]++;
        }
    for (int k = 0; k < 3; k++) {
        if (scale[k] == 0) continue;
        double right[BINS];
        box sum;
        uint64_t n = 0;
        box_clear(&sum);
        for (int b = BINS - 1; b > 0; b--) {
            box_add(&sum, bins[k][b].low, bins[k][b].high);
            n += counts[k][b];
            right[b] = box_area(&sum) * (double)n;
        }
        box_clear(&sum);
        n = 0;
        for (uint32_t b = 0; b + 1 < BINS; b++) {
            box_add(&sum, bins[k][b].low, bins[k][b].high);
            n += counts[k][b];
            double cost = box_area(&sum) * (double)n + right[b + 1];
            if (n != 0 && n != count && cost < best.cost) best = (split){cost, k, low[k], scale[k], b};
        }
    }
    return best;
}

static uint64_t partition(entry *e, uint64_t count, const split *s)
{
    uint64_t i = 0, j = count;
    while (i < j) {
        if (bin_of(middle(&e[i], s->axis), s->low, s->scale) <= s->bin) i++;
        else {
            entry t = e[--j];
            e[j] = e[i];
            e[i] = t;
        }
    }
    return i;
}

static void build_nodes(svo_bvh *b, entry *entries, svo_bvh_report *report)
{
    struct { uint64_t begin, end; uint32_t at, depth; } stack[SVOI_BVH_STACK], w;
    uint32_t top = 0;
    b->node_count = 1;
    w.begin = 0, w.end = b->placed_count, w.at = 0, w.depth = 0;
    stack[top++] = w;
    while (top != 0) {
        w = stack[--top];
        uint64_t count = w.end - w.begin, left;
        entry *e = entries + w.begin;
        svoi_bvh_node *n = &b->nodes[w.at];
        box all;
        box_clear(&all);
        for (uint64_t i = 0; i < count; i++) box_add(&all, e[i].low, e[i].high);
        memcpy(n->low, all.low, sizeof n->low);
        memcpy(n->high, all.high, sizeof n->high);
        if (w.depth > report->depth) report->depth = w.depth;
        split s = {INFINITY, -1, 0, 0, 0};
        if (count > 1 && w.depth < SVOI_BVH_COST_LEVELS) s = best_split(e, count);
        /* An instance costs about eight boxes: only what overlaps almost wholly shares a leaf. */
        bool worth = 8 * s.cost + box_area(&all) < 8 * box_area(&all) * (double)count;
        if (count == 1 || (count <= MAX_LEAF && !worth)) {
            n->first = (uint32_t)w.begin;
            n->count = (uint32_t)count;
            continue;
        }
        left = s.axis >= 0 ? partition(e, count, &s) : count / 2;
        n->first = (uint32_t)b->node_count;
        n->count = 0;
        uint32_t child = n->first;
        b->node_count += 2;
        uint64_t middle_at = w.begin + left, end = w.end;
        uint32_t depth = w.depth + 1;
        w.begin = middle_at, w.end = end, w.at = child + 1, w.depth = depth;
        stack[top++] = w;
        w.end = middle_at, w.begin = middle_at - left, w.at = child;
        stack[top++] = w;
    }
}

static svo_result build(svo_bvh *b, uint32_t threads, svo_bvh_report *report, svo_error *err)
{
    const svo_scene *s = b->scene;
    const svo_allocator *a = b->allocator;
    svo_result result = SVO_OK;
    uint64_t count = s->instance_count;
    uint8_t *fates = NULL;
    entry *entries = NULL;
    double(*bounds)[6] = NULL;
    if (count == 0) return SVO_OK;
    if (count > UINT32_MAX / 2) return svo_fail(err, SVO_LIMIT, "a scene can have at most 2^31 instances to be drawn");

    b->placed_capacity = count;
    b->placed = svo_alloc(a, count, sizeof *b->placed);
    fates = svo_alloc(a, count, 1);
    if (b->placed == NULL || fates == NULL) goto no_memory;
    placing p = {s, b->placed, fates};
    result = svo_parallel_for(threads, s->page_count, 0, place_pages, &p, err);
    if (result != SVO_OK) goto done;
    result = compact(b, fates, count, report, err);
    if (result != SVO_OK || b->placed_count == 0) goto done;

    bounds = svo_alloc(a, s->asset_count, sizeof *bounds);
    if (bounds == NULL) goto no_memory;
    for (uint32_t i = 0; i < s->asset_count; i++) {
        /* (cells, both inclusive; linear in the stored nodes, which a search of the voxels' nodes is not) */
        uint32_t low[3], high[3];
        bool any;
        result = svo_view_grid_bounds(s->assets[i], a, &any, low, high, err);
        if (result != SVO_OK) goto done;
        for (int k = 0; k < 3; k++) {
            double end = any ? (double)high[k] + 1 : 0;
            bounds[i][k] = 0.5 * ((double)low[k] + end), bounds[i][3 + k] = 0.5 * (end - (double)low[k]);
        }
    }
    double low[3], high[3];
    if (svo_scene_bounds(s, low, high))
        for (int k = 0; k < 3; k++) {
            double c = 0.5 * low[k] + 0.5 * high[k];
            b->centre[k] = isfinite(c) ? c : 0;
        }
    entries = svo_alloc(a, b->placed_count, sizeof *entries);
    b->node_capacity = 2 * b->placed_count;
    b->nodes = svo_alloc(a, b->node_capacity, sizeof *b->nodes);
    if (entries == NULL || b->nodes == NULL) goto no_memory;
    boxing x = {b, (const double(*)[6])bounds, entries};
    result = svo_parallel_for(threads, b->placed_count, 0, box_items, &x, err);
    if (result != SVO_OK) goto done;
    build_nodes(b, entries, report);

    /* Items in the order of the leaves; the old array is as large as the scene, the new one as what is kept. */
    svo_placed *sorted = svo_alloc(a, b->placed_count, sizeof *sorted);
    if (sorted == NULL) goto no_memory;
    for (uint64_t i = 0; i < b->placed_count; i++) sorted[i] = b->placed[entries[i].item];
    svo_free(a, b->placed, b->placed_capacity, sizeof *b->placed);
    b->placed = sorted;
    b->placed_capacity = b->placed_count;
    goto done;
no_memory:
    result = svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for the hierarchy of %llu instances", (unsigned long long)count);
done:
    if (entries != NULL) svo_free(a, entries, b->placed_count, sizeof *entries);
    if (bounds != NULL) svo_free(a, bounds, s->asset_count, sizeof *bounds);
    if (fates != NULL) svo_free(a, fates, count, 1);
    return result;
}

svo_result svo_bvh_build(const svo_scene *scene, uint32_t threads, const svo_allocator *a, svo_warnings *warnings, svo_bvh **out,
                         svo_bvh_report *report, svo_error *err)
{
    svo_bvh_report r = {.instances = scene->instance_count};
    double start = svo_seconds();
    svo_bvh *b = svo_calloc(a, 1, sizeof *b);
    if (b == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    b->scene = scene;
    b->allocator = a;
    svo_result result = build(b, threads, &r, err);
    if (result != SVO_OK) {
        svo_bvh_free(b);
        return result;
    }
    if (r.singular != 0)
        svo_warn(warnings, "%llu instances have transforms without an inverse (flat, or not finite) and are not drawn", (unsigned long long)r.singular);
    r.placed = b->placed_count;
    r.nodes = b->node_count;
    r.bytes = b->placed_capacity * sizeof *b->placed + b->node_capacity * sizeof *b->nodes;
    r.seconds = svo_seconds() - start;
    if (report != NULL) *report = r;
    *out = b;
    return SVO_OK;
}

void svo_bvh_free(svo_bvh *b)
{
    if (b == NULL) return;
    for (uint32_t i = 0; b->rays != NULL && i < b->scene->asset_count; i++) svo_rays_free(b->rays[i]);
    if (b->rays != NULL) svo_free(b->allocator, b->rays, b->scene->asset_count, sizeof *b->rays);
    svo_free(b->allocator, b->placed, b->placed_capacity, sizeof *b->placed);
    svo_free(b->allocator, b->nodes, b->node_capacity, sizeof *b->nodes);
    svo_free(b->allocator, b, 1, sizeof *b);
}

bool svo_bvh_bounds(const svo_bvh *b, double low[3], double high[3])
{
    if (b->placed_count == 0) return false;
    for (int k = 0; k < 3; k++) low[k] = b->centre[k] + b->nodes[0].low[k], high[k] = b->centre[k] + b->nodes[0].high[k];
    return true;
}

svo_result svo_bvh_use_rays(svo_bvh *b, const svo_rays_options *options, svo_rays_report *report, svo_error *err)
{
    svo_rays_options o = options != NULL ? *options : svo_default_rays_options();
    const uint64_t limit = o.memory != 0 ? o.memory : (uint64_t)1 << 30;
    svo_rays_report sum = {.kernel = SVO_KERNEL_PORTABLE};
    if (report != NULL) memset(report, 0, sizeof *report);
    if (b->placed_count == 0 || b->rays != NULL) return SVO_OK;
    b->rays = svo_calloc(b->allocator, b->scene->asset_count, sizeof *b->rays);
    if (b->rays == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory for %u assets", b->scene->asset_count);
    for (uint64_t i = 0; i < b->placed_count && sum.bytes < limit; i++) {
        uint32_t asset = b->placed[i].asset;
        if (b->rays[asset] != NULL) continue;
        svo_rays_report made;
        o.memory = limit - sum.bytes;
        SVO_TRY(svo_rays_build(b->scene->assets[asset], &o, &b->rays[asset], &made, err));
        if (made.kernel != SVO_KERNEL_PORTABLE) sum.kernel = made.kernel;
        sum.bytes += made.bytes, sum.nodes += made.nodes, sum.bricks += made.bricks, sum.seconds += made.seconds;
    }
    if (sum.kernel == SVO_KERNEL_PORTABLE) { /* the ordinary way is the same, and remembers nodes from call to call */
        for (uint32_t i = 0; i < b->scene->asset_count; i++) svo_rays_free(b->rays[i]);
        svo_free(b->allocator, b->rays, b->scene->asset_count, sizeof *b->rays);
        b->rays = NULL;
    }
    if (report != NULL) *report = sum;
    return SVO_OK;
}
