/* Packing in five steps: look at the assets, classify the instances, merge equal assets, split the instances into
 * pages by a k-d tree, write the arrays. Poses: svo_pack_pose.c. */
#include "svo_pack.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "svo_algorithm1.h"
#include "svo_skin.h"
#include "svo_task.h"
#include "svo_text.h"
#include "svoi_pack.h"

#define DEFAULT_PAGE_INSTANCES 1024u
/* Single precision keeps 2^-24 of a coordinate. An asset whose coordinates exceed 2^18 of its voxels would lose more
 * than 1/64 voxel to it, so its coordinates are moved to the middle of its grid. */
#define FAR_VOXELS 262144.0

/* A used asset of the input. */
typedef struct source {
    svo_view view; /* shallow copy; voxel_to_world may be moved */
    double shift[3]; /* mesh coordinates = moved coordinates + shift */
    svo_extent extent;
} source;

struct svo_packed_scene {
    svo_scene scene;
    svo_pack_report report;
    const svo_allocator *allocator;
    uint32_t input_assets;
    source *sources; /* input_assets; zero where not used */
    const svo_view **views; /* input_assets slots; the first scene.asset_count are used */
    const char **asset_names;
    uint64_t capacity; /* slots of the instance arrays */
    uint32_t *asset, *name;
    float *transform;
    uint64_t *id;
    uint32_t page_capacity;
    svo_scene_page *pages;
    svo_buffer names;
    svoi_pose_table poses;
    uint32_t *pose; /* of each instance, or NULL */
};

const svo_scene *svo_packed_scene_get(const svo_packed_scene *p) { return &p->scene; }
const svo_pack_report *svo_packed_scene_report(const svo_packed_scene *p) { return &p->report; }

void svo_packed_scene_free(svo_packed_scene *p)
{
    if (p == NULL) return;
    const svo_allocator *a = p->allocator;
    for (uint32_t i = 0; p->sources != NULL && i < p->input_assets; i++) svo_extent_free(&p->sources[i].extent);
    svo_free(a, p->sources, p->input_assets, sizeof *p->sources);
    svo_free(a, p->report.assets, p->input_assets, sizeof *p->report.assets);
    svo_free(a, p->views, p->input_assets, sizeof *p->views);
    svo_free(a, p->asset_names, p->input_assets, sizeof *p->asset_names);
    svo_free(a, p->asset, p->capacity, sizeof *p->asset);
    svo_free(a, p->name, p->capacity, sizeof *p->name);
    svo_free(a, p->transform, p->capacity, 12 * sizeof *p->transform);
    svo_free(a, p->id, p->capacity, sizeof *p->id);
    svo_free(a, p->pages, p->page_capacity, sizeof *p->pages);
    svo_free(a, p->pose, p->capacity, sizeof *p->pose);
    svo_buffer_free(&p->names);
    svoi_pose_table_free(&p->poses);
    svo_free(a, p, 1, sizeof *p);
}

/* Scratch of one call. */
typedef struct packer {
    const svo_pack_input *in;
    svo_packed_scene *out;
    const svo_allocator *allocator;
    svo_warnings *warnings;
    uint32_t threads;
    uint64_t page_instances;
    uint64_t kept;
    uint64_t *order;   /* kept places, input order, then grouped by page */
    uint64_t *scratch; /* kept */
    uint64_t *keys;    /* kept */
    double *centre;    /* 3 for every place of the input */
    uint32_t *pose;    /* of every place of the input: number in the table, or SVO_NO_POSE; NULL when the input has none */
    bool keep_bones;
} packer;

static void packer_free(packer *p)
{
    svo_free(p->allocator, p->order, p->in->place_count, 8);
    svo_free(p->allocator, p->scratch, p->kept, 8);
    svo_free(p->allocator, p->keys, p->kept, 8);
    svo_free(p->allocator, p->centre, p->in->place_count, 24);
    svo_free(p->allocator, p->pose, p->in->place_count, sizeof *p->pose);
}

static svo_result no_memory(svo_error *err, const char *what, uint64_t count)
{
    return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %s of %llu instances", what, (unsigned long long)count);
}

/* ---- 1. assets ---- */

static svo_result look_at_asset(packer *p, uint32_t a, svo_error *err)
{
    source *s = &p->out->sources[a];
    s->view = *p->in->assets[a];
    SVO_TRY(svo_extent_make(&s->view, false, p->allocator, &s->extent, err));
    if (s->view.empty) return SVO_OK;
    double *m = s->view.voxel_to_world;
    svo_mat4 to_world;
    memcpy(to_world.m, m, sizeof to_world.m);
    double from[3], to[3], far_out = 0, edge = 0;
    svo_box_transform(&to_world, s->extent.low, s->extent.high, 0, from, to);
    for (int k = 0; k < 3; k++) {
        far_out = fmax(far_out, fmax(fabs(from[k]), fabs(to[k])));
        double e = svo_length(svo_v3(m[k], m[4 + k], m[8 + k]));
        edge = k == 0 ? e : fmin(edge, e);
    }
    if (far_out > FAR_VOXELS * edge) {
        double half = ldexp(0.5, (int)s->view.depth);
        svo_vec3 c = svo_mat4_point(&to_world, svo_v3(half, half, half));
        s->shift[0] = c.x, s->shift[1] = c.y, s->shift[2] = c.z;
        for (int k = 0; k < 3; k++) m[4 * k + 3] -= s->shift[k];
        p->out->report.assets[a].moved = true;
    }
    return SVO_OK;
}

/* The transform of a place, for the moved coordinates of its asset. */
static svo_mat4 place_transform(const packer *p, const svo_place *place)
{
    svo_mat4 m = svo_mat4_identity();
    memcpy(m.m, place->transform, sizeof place->transform);
    const double *c = p->out->sources[place->asset].shift;
    if (c[0] != 0 || c[1] != 0 || c[2] != 0) {
        svo_vec3 t = svo_mat4_point(&m, svo_v3(c[0], c[1], c[2]));
        m.m[3] = t.x, m.m[7] = t.y, m.m[11] = t.z;
    }
    return m;
}

/* ---- 2. instances ---- */

/* The 3x3 part as it will be stored. */
static svo_mat4 rounded(const double t[12])
{
    svo_mat4 m = svo_mat4_identity();
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) m.m[4 * i + j] = (float)t[4 * i + j];
    return m;
}

/* Fills order with the places that are kept; counts the others. */
static svo_result classify(packer *p, svo_error *err)
{
    svo_pack_report *r = &p->out->report;
    for (uint64_t i = 0; i < p->in->place_count; i++) {
        const svo_place *place = &p->in->places[i];
        SVO_ASSERT(place->asset < p->in->asset_count && p->in->assets[place->asset] != NULL);
        bool finite = true, hidden = true;
        for (int k = 0; k < 12; k++) {
            finite = finite && isfinite(place->transform[k]) && fabs(place->transform[k]) <= 3e38;
            if (k % 4 != 3 && place->transform[k] != 0) hidden = false;
        }
        if (!finite) {
            svo_fail(err, SVO_INVALID_DATA, "instance %llu: its transform is not finite in single precision", (unsigned long long)i);
            if (err != NULL) err->index = i;
            return SVO_INVALID_DATA;
        }
        svo_pack_asset *asset = &r->assets[place->asset];
        if (hidden) {
            r->dropped_hidden++;
            continue;
        }
        svo_mat4 m = rounded(place->transform), inverse;
        if (!svo_mat4_affine_inverse(&m, &inverse)) {
            r->dropped_flat++;
            continue;
        }
        if (p->in->assets[place->asset]->empty) {
            asset->fate = SVO_PACK_EMPTY;
            r->dropped_empty++;
            continue;
        }
        asset->fate = SVO_PACK_KEPT;
        p->order[p->kept++] = i;
    }
    if (r->dropped_empty != 0)
        svo_warn(p->warnings, "%llu instances of assets without voxels are left out", (unsigned long long)r->dropped_empty);
    if (r->dropped_flat != 0)
        svo_warn(p->warnings, "%llu instances are left out: their transforms are singular, nothing of them has a volume",
                 (unsigned long long)r->dropped_flat);
    r->kept = p->kept;
    return SVO_OK;
}

/* ---- 3. equal assets ---- */

#define COMPARE(x, y) if ((x) != (y)) return (x) < (y) ? -1 : 1
static int compare_bytes(const void *a, const void *b, uint64_t size) { return size == 0 || a == b ? 0 : memcmp(a, b, (size_t)size); }

static int compare_channels(const svo_view *v, const svo_view_channel *a, const svo_view_channel *b)
{
    int c;
    if ((c = memcmp(a->channel.name, b->channel.name, sizeof a->channel.name)) != 0) return c;
    COMPARE(a->channel.kind, b->channel.kind);
    COMPARE(a->channel.constant, b->channel.constant);
    if ((c = memcmp(a->channel.value, b->channel.value, sizeof a->channel.value)) != 0) return c;
    COMPARE(a->encoding, b->encoding);
    uint64_t stride = svo_channel_stride(a->channel.kind);
    if (a->encoding == SVO_ENCODING_RAW) return compare_bytes(a->raw, b->raw, v->attribute_count * stride);
    if (a->encoding != SVO_ENCODING_BLOCKS && a->encoding != SVO_ENCODING_LONG_BLOCKS) return 0;
    uint64_t entry = a->encoding == SVO_ENCODING_BLOCKS ? SVO_PALETTE_ENTRY : SVO_ALGORITHM1_ENTRY;
    COMPARE(a->table_count, b->table_count);
    COMPARE(a->superblock_count, b->superblock_count);
    COMPARE(a->payload_size, b->payload_size);
    if ((c = compare_bytes(a->table, b->table, a->table_count * stride)) != 0) return c;
    if ((c = compare_bytes(a->directory, b->directory, a->superblock_count * entry)) != 0) return c;
    return compare_bytes(a->payload, b->payload, a->payload_size);
}

/* A total order of everything that a file stores, cheap fields first. */
static int compare_views(const svo_view *a, const svo_view *b)
{
    int c;
    COMPARE(a->depth, b->depth);
    COMPARE(a->attribute_count, b->attribute_count);
    COMPARE(a->channel_count, b->channel_count);
    COMPARE(a->lod, b->lod);
    COMPARE(a->surface, b->surface);
    COMPARE(a->fill, b->fill);
    if ((c = memcmp(a->nodes, b->nodes, sizeof a->nodes)) != 0) return c;
    for (int i = 0; i < 16; i++) COMPARE(a->voxel_to_world[i], b->voxel_to_world[i]);
    if ((c = svo_view_compare_geometry(a, b)) != 0) return c;
    for (uint32_t i = 0; i < a->channel_count; i++)
        if ((c = compare_channels(a, &a->channels[i], &b->channels[i])) != 0) return c;
    return 0;
}

static int compare_sources(const void *a, const void *b)
{
    const source *x = *(const source *const *)a, *y = *(const source *const *)b;
    int c = compare_views(&x->view, &y->view);
    if (c != 0) return c;
    return x < y ? -1 : x > y; /* the same array: input order */
}

static svo_result merge_assets(packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    uint32_t count = p->in->asset_count, used = 0;
    const source **sorted = svo_alloc(p->allocator, count, sizeof *sorted);
    if (sorted == NULL && count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to compare %u assets", count);
    for (uint32_t a = 0; a < count; a++)
        if (o->report.assets[a].fate == SVO_PACK_KEPT) sorted[used++] = &o->sources[a];
    if (used > 1) qsort(sorted, used, sizeof *sorted, compare_sources);
    for (uint32_t i = 1, first = 0; i < used; i++) {
        if (compare_views(&sorted[first]->view, &sorted[i]->view) != 0) first = i;
        else {
            svo_pack_asset *asset = &o->report.assets[sorted[i] - o->sources];
            asset->fate = SVO_PACK_EQUAL;
            asset->packed = (uint32_t)(sorted[first] - o->sources); /* for the moment: its number in the input */
        }
    }
    svo_free(p->allocator, sorted, count, sizeof *sorted);
    for (uint32_t a = 0; a < count; a++)
        if (o->report.assets[a].fate == SVO_PACK_KEPT) {
            o->report.assets[a].packed = o->scene.asset_count;
            o->views[o->scene.asset_count] = &o->sources[a].view;
            o->asset_names[o->scene.asset_count++] = p->in->asset_names[a];
        }
    for (uint32_t a = 0; a < count; a++)
        if (o->report.assets[a].fate == SVO_PACK_EQUAL)
            o->report.assets[a].packed = o->report.assets[o->report.assets[a].packed].packed;
    return SVO_OK;
}

/* ---- 4. pages ---- */

/* Bounds of a place (a number in the input); false when they are not finite. */
static bool place_box(const packer *p, const svo_mat4 *transform, uint64_t number, double low[3], double high[3])
{
    const svo_place *place = &p->in->places[number];
    const source *s = &p->out->sources[place->asset];
    svo_poses all = svoi_pose_table_get(&p->out->poses);
    const svo_pose *pose = p->pose != NULL && p->pose[number] != SVO_NO_POSE ? &all.pose[p->pose[number]] : NULL;
    svo_mat4 grid;
    memcpy(grid.m, s->view.voxel_to_world, sizeof grid.m);
    return svo_deform_bounds(&all, pose, &grid, transform, &s->extent, low, high);
}

static svo_result find_centres(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    packer *p = user;
    for (uint64_t i = begin; i < end; i++) {
        const svo_place *place = &p->in->places[p->order[i]];
        svo_mat4 m = place_transform(p, place);
        double low[3], high[3], *c = p->centre + 3 * p->order[i];
        bool finite = place_box(p, &m, p->order[i], low, high);
        for (int k = 0; k < 3; k++) {
            c[k] = low[k] / 2 + high[k] / 2 + 0.0; /* + 0.0: no negative zero */
            if (finite) continue;
            svo_fail(err, SVO_INVALID_DATA, "instance %llu: its bounds are not finite", (unsigned long long)p->order[i]);
            if (err != NULL) err->index = p->order[i];
            return SVO_INVALID_DATA;
        }
    }
    return SVO_OK;
}

/* Unsigned order of the result is the numeric order of the doubles. */
static inline uint64_t sortable(double v)
{
    uint64_t bits;
    memcpy(&bits, &v, 8);
    return bits >> 63 ? ~bits : bits | (uint64_t)1 << 63;
}

/* The key of rank *rank (from 0) of n keys, which are overwritten; *rank becomes its rank among the equal ones. Radix
 * selection from the top digit: linear time whatever the values, which a pivot does not promise. */
static uint64_t select_key(uint64_t *keys, uint64_t n, uint64_t *rank)
{
    for (int shift = 53; n > 1; shift = shift > 11 ? shift - 11 : 0) {
        uint64_t histogram[2048] = {0};
        for (uint64_t i = 0; i < n; i++) histogram[keys[i] >> shift & 2047]++;
        uint64_t digit = 0;
        while (*rank >= histogram[digit]) *rank -= histogram[digit++];
        uint64_t left = 0;
        for (uint64_t i = 0; i < n; i++)
            if ((keys[i] >> shift & 2047) == digit) keys[left++] = keys[i];
        n = left;
        if (shift == 0) break;
    }
    return keys[0];
}

/* Put the `left` places with the smallest centres along the longest axis of the range first; both halves keep the
 * order of the input, and of equal centres the earlier ones go left. */
static void split(packer *p, uint64_t begin, uint64_t end, uint64_t left)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint64_t i = begin; i < end; i++)
        for (int k = 0; k < 3; k++) {
            double c = p->centre[3 * p->order[i] + (uint64_t)k];
            low[k] = fmin(low[k], c), high[k] = fmax(high[k], c);
        }
    uint64_t axis = 0;
    for (uint64_t k = 1; k < 3; k++)
        if (high[k] / 2 - low[k] / 2 > high[axis] / 2 - low[axis] / 2) axis = k;
    for (uint64_t i = begin; i < end; i++) p->keys[i] = sortable(p->centre[3 * p->order[i] + axis]);
    uint64_t equal = left;
    uint64_t pivot = select_key(p->keys + begin, end - begin, &equal);
    uint64_t l = begin, r = begin + left;
    for (uint64_t i = begin; i < end; i++) {
        uint64_t key = sortable(p->centre[3 * p->order[i] + axis]);
        bool goes_left = key < pivot || (key == pivot && equal > 0);
        if (key == pivot && goes_left) equal--;
        p->scratch[goes_left ? l++ : r++] = p->order[i];
    }
    memcpy(p->order + begin, p->scratch + begin, (size_t)(end - begin) * 8);
}

static svo_result make_pages(packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    uint64_t count = (p->kept + p->page_instances - 1) / p->page_instances;
    if (count > UINT32_MAX) return svo_fail(err, SVO_LIMIT, "%llu pages are more than a scene can have", (unsigned long long)count);
    o->pages = svo_calloc(p->allocator, count, sizeof *o->pages);
    o->page_capacity = (uint32_t)count;
    if (o->pages == NULL) return no_memory(err, "the pages", p->kept);
    struct { uint64_t begin, end; } stack[66];
    int top = 0;
    stack[0].begin = 0, stack[0].end = p->kept;
    while (top >= 0) {
        uint64_t begin = stack[top].begin, end = stack[top].end;
        if (end - begin <= p->page_instances) {
            o->pages[o->scene.page_count].first = begin;
            o->pages[o->scene.page_count++].count = end - begin;
            top--;
            continue;
        }
        /* Halves of whole pages, so that all but the last page are full. */
        uint64_t pages = (end - begin + p->page_instances - 1) / p->page_instances;
        uint64_t middle = begin + pages / 2 * p->page_instances;
        split(p, begin, end, middle - begin);
        stack[top].begin = middle;
        stack[top + 1].begin = begin, stack[top + 1].end = middle;
        top++;
    }
    SVO_ASSERT(o->scene.page_count == count);
    return SVO_OK;
}

/* ---- 5. arrays ---- */

/* Zero where all translations of the page fit single precision as they are, else the middle of them. */
static void choose_origin(packer *p, svo_scene_page *page)
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    bool fits = true;
    for (uint64_t i = page->first; i < page->first + page->count; i++) {
        svo_mat4 m = place_transform(p, &p->in->places[p->order[i]]);
        for (int k = 0; k < 3; k++) {
            double t = m.m[4 * k + 3];
            low[k] = fmin(low[k], t), high[k] = fmax(high[k], t);
            fits = fits && (double)(float)t == t;
        }
    }
    for (int k = 0; k < 3; k++) page->origin[k] = fits ? 0 : low[k] / 2 + high[k] / 2;
}

static svo_result fill_pages(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)worker;
    packer *p = user;
    svo_packed_scene *o = p->out;
    for (uint64_t g = begin; g < end; g++) {
        svo_scene_page *page = &o->pages[g];
        choose_origin(p, page);
        for (int k = 0; k < 3; k++) page->low[k] = INFINITY, page->high[k] = -INFINITY;
        for (uint64_t i = page->first; i < page->first + page->count; i++) {
            const svo_place *place = &p->in->places[p->order[i]];
            svo_mat4 m = place_transform(p, place), inverse;
            float *t = o->transform + 12 * i;
            for (int k = 0; k < 12; k++) t[k] = (float)(k % 4 == 3 ? m.m[k] - page->origin[k / 4] : m.m[k]);
            o->asset[i] = o->report.assets[place->asset].packed;
            o->id[i] = place->id;
            m = svo_scene_instance_transform(&o->scene, (uint32_t)g, i);
            double low[3], high[3];
            bool good = place_box(p, &m, p->order[i], low, high) && svo_mat4_affine_inverse(&m, &inverse);
            if (o->pose != NULL) o->pose[i] = p->pose[p->order[i]];
            for (int k = 0; k < 3; k++) {
                page->low[k] = fmin(page->low[k], low[k]), page->high[k] = fmax(page->high[k], high[k]);
            }
            if (good) continue;
            svo_fail(err, SVO_INVALID_DATA, "instance %llu: its place cannot be stored in single precision", (unsigned long long)p->order[i]);
            if (err != NULL) err->index = p->order[i];
            return SVO_INVALID_DATA;
        }
    }
    return SVO_OK;
}

/* Names that are used, each once, in the order of the packed instances. */
static svo_result gather_names(packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    if (svo_buffer_append(&o->names, "", 1) == NULL) return no_memory(err, "the names", p->kept);
    uint64_t named = 0;
    for (uint64_t i = 0; i < p->kept; i++) {
        uint32_t name = p->in->places[p->order[i]].name;
        SVO_ASSERT(name == 0 || name < p->in->names_size);
        named += name != 0 && p->in->names[name] != 0;
    }
    if (named == 0) return SVO_OK;
    o->name = svo_calloc(p->allocator, p->kept, sizeof *o->name);
    uint64_t slots = 16;
    while (slots < 2 * named) slots *= 2;
    uint32_t *table = svo_calloc(p->allocator, slots, sizeof *table); /* open addressing; 0 = free */
    svo_result result = o->name == NULL || table == NULL ? no_memory(err, "the names", p->kept) : SVO_OK;
    for (uint64_t i = 0; i < p->kept && result == SVO_OK; i++) {
        uint32_t offset = p->in->places[p->order[i]].name;
        if (offset == 0 || p->in->names[offset] == 0) continue;
        const char *text = p->in->names + offset;
        uint64_t size, slot = svo_text_hash(text, &size) & (slots - 1);
        while (table[slot] != 0 && strcmp((const char *)o->names.data + table[slot], text) != 0) slot = (slot + 1) & (slots - 1);
        if (table[slot] == 0) {
            if (o->names.size + size + 1 > UINT32_MAX) result = svo_fail(err, SVO_LIMIT, "names of instances take more than 4 GiB");
            else {
                table[slot] = (uint32_t)o->names.size;
                if (svo_buffer_append(&o->names, text, (size_t)size + 1) == NULL) result = no_memory(err, "the names", p->kept);
            }
        }
        o->name[i] = table[slot];
    }
    svo_free(p->allocator, table, slots, sizeof *table);
    return result;
}

static void measure_translations(packer *p)
{
    svo_packed_scene *o = p->out;
    for (uint32_t g = 0; g < o->scene.page_count; g++)
        for (uint64_t i = o->pages[g].first; i < o->pages[g].first + o->pages[g].count; i++) {
            svo_mat4 m = place_transform(p, &p->in->places[p->order[i]]), s = svo_scene_instance_transform(&o->scene, g, i);
            double e = svo_length(svo_v3(m.m[3] - s.m[3], m.m[7] - s.m[7], m.m[11] - s.m[11]));
            o->report.translation_error = fmax(o->report.translation_error, e);
        }
}

/* The poses of the kept places, each once, for the coordinates that their assets have now. */
static svo_result take_poses(packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    const svo_pack_input *in = p->in;
    bool any = false;
    for (uint64_t i = 0; i < p->kept && !any; i++) any = in->places[p->order[i]].pose != 0;
    if (!any) return SVO_OK;
    p->pose = svo_alloc(p->allocator, in->place_count, sizeof *p->pose);
    if (p->pose == NULL) return no_memory(err, "the poses", p->kept);
    for (uint64_t i = 0; i < in->place_count; i++) p->pose[i] = SVO_NO_POSE;
    for (uint64_t i = 0; i < p->kept; i++) {
        const svo_place *place = &in->places[p->order[i]];
        const source *s = &o->sources[place->asset];
        if (place->pose == 0) continue;
        SVO_ASSERT(place->pose - 1 < in->poses.count);
        svo_mat4 grid;
        double low[3], high[3];
        memcpy(grid.m, s->view.voxel_to_world, sizeof grid.m);
        svo_box_transform(&grid, s->extent.low, s->extent.high, 0, low, high);
        for (int k = 0; k < 3; k++) low[k] += s->shift[k], high[k] += s->shift[k];
        svo_result result = svoi_pose_table_add(&o->poses, &in->poses, place->pose - 1, low, high, s->shift, &p->pose[p->order[i]], err);
        if (result != SVO_OK) {
            if (err != NULL) err->index = p->order[i];
            return result;
        }
        if (p->pose[p->order[i]] == SVO_NO_POSE) continue;
        o->report.posed++;
        const svo_pose *pose = (const svo_pose *)(const void *)o->poses.poses.data + p->pose[p->order[i]];
        if ((pose->flags & SVO_POSE_BONES) != 0) o->report.assets[place->asset].bones = true;
    }
    for (uint32_t a = 0; a < in->asset_count; a++)
        if (o->report.assets[a].bones) SVO_TRY(svo_extent_make(&o->sources[a].view, true, p->allocator, &o->sources[a].extent, err));
    o->report.poses_rest = o->poses.rest, o->report.poses_shared = o->poses.shared;
    o->report.bones_rest = o->poses.bones_rest, o->report.matrices_shared = o->poses.matrices_shared;
    return SVO_OK;
}

static uint64_t channel_bytes(const svo_view *v, const svo_view_channel *k)
{
    uint64_t stride = svo_channel_stride(k->channel.kind);
    if (k->encoding == SVO_ENCODING_RAW) return v->attribute_count * stride;
    if (k->encoding == SVO_ENCODING_LONG_BLOCKS) return k->table_count * stride + k->superblock_count * SVO_ALGORITHM1_ENTRY + k->payload_size;
    return k->encoding == SVO_ENCODING_BLOCKS ? k->table_count * stride + k->superblock_count * SVO_PALETTE_ENTRY + k->payload_size : 0;
}

/* Channels of bones (svo_skin.h) that no pose asks for. Where nothing else varies they stay: without them the octree's numbering would have to go as well. */
static void drop_bones(packer *p)
{
    svo_pack_report *r = &p->out->report;
    for (uint32_t a = 0; a < p->in->asset_count; a++) {
        svo_view *v = &p->out->sources[a].view;
        uint32_t varying = 0, kept = 0;
        if (r->assets[a].fate != SVO_PACK_KEPT || r->assets[a].bones || p->keep_bones) continue;
        for (uint32_t i = 0; i < v->channel_count; i++) varying += !svo_skin_is_channel(v->channels[i].channel.name) && v->channels[i].encoding != SVO_ENCODING_CONSTANT;
        if (varying == 0 && !v->unnumbered) continue;
        for (uint32_t i = 0; i < v->channel_count; i++) {
            if (!svo_skin_is_channel(v->channels[i].channel.name)) {
                if (kept != i) v->channels[kept] = v->channels[i];
                kept++;
                continue;
            }
            r->bone_channel_bytes += channel_bytes(v, &v->channels[i]);
            r->bone_channels++;
        }
        v->channel_count = kept;
    }
}

static svo_result run(packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    const svo_pack_input *in = p->in;
    uint32_t assets = in->asset_count;
    o->input_assets = assets;
    if (assets != 0) {
        o->sources = svo_calloc(p->allocator, assets, sizeof *o->sources);
        o->report.assets = svo_calloc(p->allocator, assets, sizeof *o->report.assets);
        o->views = svo_calloc(p->allocator, assets, sizeof *o->views);
        o->asset_names = svo_calloc(p->allocator, assets, sizeof *o->asset_names);
        if (o->sources == NULL || o->report.assets == NULL || o->views == NULL || o->asset_names == NULL)
            return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for %u assets", assets);
        for (uint32_t a = 0; a < assets; a++) o->report.assets[a].fate = SVO_PACK_UNUSED;
    }
    if (in->place_count != 0) {
        p->order = svo_alloc(p->allocator, in->place_count, 8);
        if (p->order == NULL) return no_memory(err, "the order", in->place_count);
    }
    SVO_TRY(classify(p, err));
    for (uint32_t a = 0; a < assets; a++)
        if (o->report.assets[a].fate == SVO_PACK_KEPT) SVO_TRY(look_at_asset(p, a, err));
    SVO_TRY(take_poses(p, err));
    drop_bones(p);
    SVO_TRY(merge_assets(p, err));
    if (p->kept != 0) {
        p->scratch = svo_alloc(p->allocator, p->kept, 8);
        p->keys = svo_alloc(p->allocator, p->kept, 8);
        p->centre = svo_alloc(p->allocator, in->place_count, 24);
        if (p->scratch == NULL || p->keys == NULL || p->centre == NULL) return no_memory(err, "the grouping", p->kept);
        SVO_TRY(svo_parallel_for(p->threads, p->kept, 4096, find_centres, p, err));
        SVO_TRY(make_pages(p, err));
        o->capacity = p->kept;
        o->asset = svo_alloc(p->allocator, p->kept, sizeof *o->asset);
        o->transform = svo_alloc(p->allocator, p->kept, 12 * sizeof *o->transform);
        o->id = svo_alloc(p->allocator, p->kept, sizeof *o->id);
        if (o->report.posed != 0) o->pose = svo_alloc(p->allocator, p->kept, sizeof *o->pose);
        if (o->asset == NULL || o->transform == NULL || o->id == NULL || (o->pose == NULL && o->report.posed != 0)) return no_memory(err, "the arrays", p->kept);
    }
    svo_scene *s = &o->scene;
    s->instance_count = p->kept;
    s->assets = o->views;
    s->asset_names = o->asset_names;
    s->instance_asset = o->asset;
    s->instance_transform = o->transform;
    s->instance_id = o->id;
    s->pages = o->pages;
    s->instance_pose = o->pose;
    s->poses = svoi_pose_table_get(&o->poses);
    SVO_TRY(svo_parallel_for(p->threads, s->page_count, 4, fill_pages, p, err));
    SVO_TRY(gather_names(p, err));
    s->instance_name = o->name;
    s->names = (const char *)o->names.data;
    s->names_size = o->names.size;
    s->has_camera = in->has_camera;
    s->camera_transform = in->camera_transform;
    s->camera_yfov = in->camera_yfov;
    measure_translations(p);
    for (uint64_t i = 0; i < p->kept; i++) o->report.assets[in->places[p->order[i]].asset].instances++;
    return SVO_OK;
}

svo_result svo_pack(const svo_pack_input *input, const svo_pack_options *options, svo_packed_scene **out, svo_error *err)
{
    static const svo_pack_options defaults = {0};
    if (options == NULL) options = &defaults;
    const svo_allocator *a = options->allocator;
    packer p = {.in = input, .allocator = a, .warnings = options->warnings, .threads = options->threads,
                .page_instances = options->page_instances != 0 ? options->page_instances : DEFAULT_PAGE_INSTANCES};
    p.out = svo_calloc(a, 1, sizeof *p.out);
    if (p.out == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a scene");
    p.out->allocator = a;
    svo_buffer_init(&p.out->names, a);
    svoi_pose_table_init(&p.out->poses, a);
    p.keep_bones = options->keep_bones;
    svo_result result = run(&p, err);
    packer_free(&p);
    if (result != SVO_OK) {
        /* (the capacity of arrays that were not made is 0, and svo_free takes NULL) */
        svo_packed_scene_free(p.out);
        return result;
    }
    *out = p.out;
    return SVO_OK;
}
