/* Making svo_winding: triangles are snapped and sorted, told apart by their edges, and get trees of boxes, moments and boundary edges. */
#include <math.h>
#include <string.h>

#include "svo_soup.h"
#include "svo_task.h"
#include "svoi_winding.h"

enum { BLOCK = 8192, PIECE = 1024, FEW_EDGES = 256 /* boundary edges that are rather summed one by one */ };

/* --- snapped triangles -------------------------------------------------------------------------------------------- */

typedef struct scan {
    const svo_placement *placement;
    const svo_grid *grid;
    svoi_triangle *out;
    uint64_t sum[256][2];
} scan;

/* The corner with which the corners are least in order. */
static uint32_t first_corner(const int32_t q[3][3])
{
    uint32_t first = 0;
    for (uint32_t f = 1; f < 3; f++)
        for (uint32_t i = 0; i < 9; i++) {
            const int32_t a = q[(f + i / 3) % 3][i % 3], b = q[(first + i / 3) % 3][i % 3];
            if (a < b) first = f;
            if (a != b) break;
        }
    return first;
}

/* False where a corner is not finite. */
static bool snap(const svo_grid *grid, const svo_vec3 v[3], uint64_t number, svoi_triangle *out, uint64_t sum[2])
{
    double z = 0; /* 0 * x is NaN for infinities and NaNs */
    for (int k = 0; k < 3; k++) z += v[k].x * 0 + v[k].y * 0 + v[k].z * 0;
    if (!(z == 0)) return false;
    int32_t q[3][3];
    for (int k = 0; k < 3; k++) svo_grid_snap(grid, v[k], q[k]);
    svoi_edge_sum((const int32_t(*)[3])q, sum);
    const uint32_t first = first_corner((const int32_t(*)[3])q);
    for (uint32_t k = 0; k < 3; k++) memcpy(out->q[k], q[(first + k) % 3], sizeof q[k]);
    out->number = (uint32_t)number;
    out->turned = first << 1;
    return true;
}

static svo_result scan_block(void *user, uint64_t begin, uint64_t end, uint32_t worker, svo_error *err)
{
    (void)err;
    scan *s = user;
    const svo_placement *p = s->placement;
    uint64_t g = svo_placement_group(p, begin);
    for (uint64_t t = begin; t < end; t++) {
        while (t - p->groups[g].first >= p->groups[g].part->triangle_count) g++;
        svo_vec3 v[3];
        svo_placement_world(p, &p->groups[g], t - p->groups[g].first, v);
        if (!snap(s->grid, v, t, &s->out[t], s->sum[worker])) s->out[t].number = UINT32_MAX;
    }
    return SVO_OK;
}

/* All of them into the run of a sorter that has room for them. */
static svo_result scan_memory(scan *s, svoi_sorter *sorter, uint32_t threads, svo_error *err)
{
    const uint64_t n = s->placement->triangle_count;
    s->out = (svoi_triangle *)(void *)sorter->run;
    SVO_TRY(svo_parallel_for(threads, n, BLOCK, scan_block, s, err));
    for (uint64_t t = 0; t < n; t++)
        if (s->out[t].number != UINT32_MAX) s->out[sorter->count++] = s->out[t];
    for (int i = 1; i < 256; i++)
        for (int k = 0; k < 2; k++) s->sum[0][k] += s->sum[i][k];
    return SVO_OK;
}

static svo_result scan_soup(scan *s, const svo_group *g, uint8_t *records, svoi_sorter *sorter, svo_error *err)
{
    const struct svo_soup *soup = g->part->soup;
    const svo_mat4 *m = &s->placement->mesh->instances[g->instance].transform;
    const svo_soup_piece *pieces = (const svo_soup_piece *)(const void *)soup->pieces.data;
    uint64_t number = g->first;
    for (uint64_t i = 0; i < soup->pieces.size / sizeof *pieces; i++)
        for (uint64_t first = 0; first < pieces[i].count; first += PIECE) {
            const uint64_t n = pieces[i].count - first < PIECE ? pieces[i].count - first : PIECE;
            SVO_TRY(svo_soup_read(soup, &pieces[i], first, n, records, err));
            for (uint64_t k = 0; k < n; k++, number++) {
                double c[9];
                svo_vec3 v[3];
                svoi_triangle t;
                svo_soup_corners(&soup->layout, records + k * soup->layout.stride, c);
                for (int e = 0; e < 3; e++) v[e] = svo_mat4_point(m, svo_v3(c[3 * e], c[3 * e + 1], c[3 * e + 2]));
                if (snap(s->grid, (const svo_vec3 *)v, number, &t, s->sum[0])) SVO_TRY(svoi_sorter_put(sorter, &t, err));
            }
        }
    return SVO_OK;
}

/* The same one after the other, in runs. */
static svo_result scan_stream(scan *s, svoi_sorter *sorter, const svo_allocator *a, svo_error *err)
{
    uint8_t *records = svo_alloc(a, PIECE, SVO_SOUP_MAX_STRIDE);
    if (records == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    svo_result r = SVO_OK;
    for (uint64_t i = 0; r == SVO_OK && i < s->placement->group_count; i++) {
        const svo_group *g = &s->placement->groups[i];
        if (g->part->soup != NULL) {
            r = scan_soup(s, g, records, sorter, err);
            continue;
        }
        for (uint64_t k = 0; r == SVO_OK && k < g->part->triangle_count; k++) {
            svo_vec3 v[3];
            svoi_triangle t;
            svo_placement_world(s->placement, g, k, v);
            if (snap(s->grid, (const svo_vec3 *)v, g->first + k, &t, s->sum[0])) r = svoi_sorter_put(sorter, &t, err);
        }
    }
    svo_free(a, records, PIECE, SVO_SOUP_MAX_STRIDE);
    return r;
}

static uint64_t triangle_key(const void *record, const void *user)
{
    const svoi_triangle *t = record;
    int32_t centre[3];
    for (int k = 0; k < 3; k++) centre[k] = (int32_t)(((int64_t)t->q[0][k] + t->q[1][k] + t->q[2][k]) / 3);
    return svoi_tree_key(centre, *(const uint32_t *)user);
}

static int compare_triangles(const void *a, const void *b)
{
    const svoi_triangle *s = a, *t = b;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            if (s->q[i][k] != t->q[i][k]) return s->q[i][k] < t->q[i][k] ? -1 : 1;
    return s->number < t->number ? -1 : s->number > t->number;
}

static uint64_t edge_key(const void *record, const void *user)
{
    const svoi_boundary_edge *e = record;
    int32_t middle[3];
    for (int k = 0; k < 3; k++) middle[k] = (int32_t)(((int64_t)e->a[k] + e->b[k]) / 2);
    return svoi_tree_key(middle, *(const uint32_t *)user);
}

static int compare_edges(const void *a, const void *b)
{
    const svoi_boundary_edge *s = a, *t = b;
    for (int k = 0; k < 3; k++)
        if (s->a[k] != t->a[k]) return s->a[k] < t->a[k] ? -1 : 1;
    for (int k = 0; k < 3; k++)
        if (s->b[k] != t->b[k]) return s->b[k] < t->b[k] ? -1 : 1;
    return 0; /* each is there once */
}

void svoi_boundary_order(const uint32_t *lattice_bits, svoi_order *out) { *out = (svoi_order){edge_key, compare_edges, lattice_bits}; }

/* --- trees -------------------------------------------------------------------------------------------------------- */

typedef void (*item_box_fn)(const void *item, svoi_box *box);

static void box_of_triangle(const void *item, svoi_box *box) { svoi_triangle_box((const int32_t(*)[3])((const svoi_triangle *)item)->q, box); }
static void box_of_edge(const void *item, svoi_box *box) { svoi_edge_box(item, box); }

static void join(svoi_box *to, const svoi_box *more)
{
    for (int k = 0; k < 3; k++) {
        if (more->low[k] < to->low[k]) to->low[k] = more->low[k];
        if (more->high[k] > to->high[k]) to->high[k] = more->high[k];
    }
}

static svo_result build_tree(const svoi_room *room, const svoi_store *items, uint64_t count, item_box_fn box, svoi_bounds_tree *t, svo_error *err)
{
    *t = (svoi_bounds_tree){.count = count};
    if (count == 0) return SVO_OK;
    for (uint64_t size = (count + SVOI_TREE_LEAF - 1) / SVOI_TREE_LEAF;; size = (size + 1) / 2) {
        t->first[t->levels] = t->node_count;
        t->size[t->levels++] = size;
        t->node_count += size;
        if (size == 1) break;
    }
    SVO_TRY(svoi_store_create(room, t->node_count, sizeof(svoi_box), &t->box, err));
    for (uint64_t i = 0; i < t->size[0]; i++) {
        uint64_t begin, end;
        svoi_box all, more;
        svoi_leaf_items(t, (svoi_tree_node){0, (uint32_t)i}, &begin, &end);
        box(svoi_at(items, begin), &all);
        for (uint64_t k = begin + 1; k < end; k++) {
            box(svoi_at(items, k), &more);
            join(&all, &more);
        }
        *(svoi_box *)svoi_at(&t->box, i) = all;
    }
    for (uint32_t l = 1; l < t->levels; l++)
        for (uint64_t i = 0; i < t->size[l]; i++) {
            svoi_box all = *(const svoi_box *)svoi_at(&t->box, t->first[l - 1] + 2 * i);
            if (2 * i + 1 < t->size[l - 1]) join(&all, svoi_at(&t->box, t->first[l - 1] + 2 * i + 1));
            *(svoi_box *)svoi_at(&t->box, t->first[l] + i) = all;
        }
    return SVO_OK;
}

static svo_result build_lines(svo_winding *w, svo_error *err)
{
    const svoi_bounds_tree *t = &w->edges;
    SVO_TRY(svoi_store_create(&w->room, t->node_count, sizeof(svoi_lines), &w->lines, err));
    for (uint64_t i = 0; i < w->boundary_count; i++) {
        const svoi_boundary_edge *e = svoi_at(&w->boundary, i);
        svoi_lines *to = svoi_at(&w->lines, i / SVOI_TREE_LEAF);
        double d2 = 0;
        for (int k = 0; k < 3; k++) {
            const double d = (double)e->b[k] - e->a[k];
            d2 += d * d;
            to->sum[k] += e->times * d;
        }
        to->length += e->times * sqrt(d2);
    }
    for (uint32_t l = 1; l < t->levels; l++)
        for (uint64_t i = 0; i < t->size[l - 1]; i++) {
            const svoi_lines *from = svoi_at(&w->lines, t->first[l - 1] + i);
            svoi_lines *to = svoi_at(&w->lines, t->first[l] + i / 2);
            to->length += from->length;
            for (int k = 0; k < 3; k++) to->sum[k] += from->sum[k];
        }
    return SVO_OK;
}

/* --- moments ------------------------------------------------------------------------------------------------------ */

static void area_vector(const int32_t (*q)[3], double n[3])
{
    double a[3], b[3];
    for (int k = 0; k < 3; k++) a[k] = (double)q[1][k] - q[0][k], b[k] = (double)q[2][k] - q[0][k];
    for (int k = 0; k < 3; k++) n[k] = 0.5 * (a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
}

/* Sums of a node before they are brought to its centre. */
typedef struct sums { double area, centre[3], normal[3], m[3][3]; } sums;

static void finish_moment(const svoi_box *box, const sums *s, svoi_moment *out)
{
    double m[3][3];
    for (int i = 0; i < 3; i++) out->centre[i] = s->area > 0 ? s->centre[i] / s->area : 0.5 * ((double)box->low[i] + box->high[i]);
    for (int i = 0; i < 3; i++) {
        out->normal[i] = s->normal[i];
        for (int j = 0; j < 3; j++) m[i][j] = s->m[i][j] - out->centre[i] * s->normal[j];
    }
    out->trace = (float)(m[0][0] + m[1][1] + m[2][2]);
    for (int i = 0; i < 3; i++) out->symmetric[i] = (float)m[i][i];
    out->symmetric[3] = (float)(m[0][1] + m[1][0]);
    out->symmetric[4] = (float)(m[0][2] + m[2][0]);
    out->symmetric[5] = (float)(m[1][2] + m[2][1]);
    double r2 = 0;
    for (int i = 0; i < 3; i++) {
        double d = fmax(out->centre[i] - box->low[i], box->high[i] - out->centre[i]);
        r2 += d * d;
    }
    out->radius = nextafterf((float)sqrt(r2), INFINITY);
}

static void add_triangle(const svoi_triangle *t, sums *to)
{
    double n[3], c[3];
    area_vector((const int32_t(*)[3])t->q, n);
    const double area = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    to->area += area;
    for (int k = 0; k < 3; k++) {
        c[k] = ((double)t->q[0][k] + t->q[1][k] + t->q[2][k]) / 3;
        to->centre[k] += area * c[k];
        to->normal[k] += n[k];
    }
    for (int k = 0; k < 3; k++)
        for (int j = 0; j < 3; j++) to->m[k][j] += c[k] * n[j];
}

static void add_sums(const sums *from, sums *to)
{
    to->area += from->area;
    for (int k = 0; k < 3; k++) {
        to->centre[k] += from->centre[k];
        to->normal[k] += from->normal[k];
        for (int j = 0; j < 3; j++) to->m[k][j] += from->m[k][j];
    }
}

/* Leaf by leaf; a node is finished after its last child, so one sum a level is enough. */
static svo_result build_moments(svo_winding *w, svo_error *err)
{
    const svoi_bounds_tree *t = &w->tree[SVOI_OPEN];
    sums level[SVOI_TREE_LEVELS + 1];
    memset(level, 0, sizeof level);
    SVO_TRY(svoi_store_create(&w->room, t->node_count, sizeof(svoi_moment), &w->moments, err));
    for (uint64_t leaf = 0; leaf < t->size[0]; leaf++) {
        uint64_t begin, end;
        for (svoi_leaf_items(t, (svoi_tree_node){0, (uint32_t)leaf}, &begin, &end); begin < end; begin++) add_triangle(svoi_at(&w->triangles[SVOI_OPEN], begin), &level[0]);
        uint64_t at = leaf;
        for (uint32_t l = 0; l < t->levels; l++, at /= 2) {
            finish_moment(svoi_at(&t->box, t->first[l] + at), &level[l], svoi_at(&w->moments, t->first[l] + at));
            if (l + 1 < t->levels) add_sums(&level[l], &level[l + 1]);
            memset(&level[l], 0, sizeof level[l]);
            if (at % 2 == 0 && at + 1 < t->size[l]) break; /* its sibling follows */
        }
    }
    return SVO_OK;
}

/* --- all of it ---------------------------------------------------------------------------------------------------- */

/* Sorted triangles into the stores of their classes, turned. */
static svo_result part_classes(svo_winding *w, svoi_store *sorted, uint64_t count, const svoi_store *kind, svo_winding_report *report, svo_error *err)
{
    uint64_t counts[SVOI_CLASSES] = {0}, at[SVOI_CLASSES] = {0};
    for (uint64_t i = 0; i < count; i++) {
        const uint8_t k = kind->data != NULL ? *(const uint8_t *)svoi_at(kind, i) : SVOI_ORIENTED;
        counts[k & 3]++;
        report->turned += (k & SVOI_TURNED) != 0;
    }
    report->oriented = counts[SVOI_ORIENTED];
    report->even = counts[SVOI_EVEN];
    report->open = counts[SVOI_OPEN];
    for (int c = 0; c < SVOI_CLASSES; c++) {
        w->tree[c].count = counts[c];
        if (counts[c] == count) w->triangles[c] = *sorted, *sorted = (svoi_store){0}; /* all of one class stay where they are */
        else SVO_TRY(svoi_store_create(&w->room, counts[c], sizeof(svoi_triangle), &w->triangles[c], err));
        if (count == 0) return SVO_OK;
    }
    for (uint64_t i = 0; i < count && kind->data != NULL; i++) {
        const uint8_t k = *(const uint8_t *)svoi_at(kind, i);
        const int c = k & 3;
        svoi_triangle *to = svoi_at(&w->triangles[c], at[c]++);
        if (sorted->data != NULL) *to = *(const svoi_triangle *)svoi_at(sorted, i);
        if (!(k & SVOI_TURNED)) continue;
        to->turned |= 1;
        int32_t swap[3];
        memcpy(swap, to->q[1], sizeof swap);
        memcpy(to->q[1], to->q[2], sizeof swap);
        memcpy(to->q[2], swap, sizeof swap);
    }
    return SVO_OK;
}

static svo_result build(svo_winding *w, const svo_placement *p, const svo_grid *grid, uint32_t threads, svo_winding_report *report, svo_error *err)
{
    const uint32_t lattice_bits = grid->depth + 8;
    const svoi_order order = {triangle_key, compare_triangles, &lattice_bits};
    scan s = {.placement = p, .grid = grid};
    svoi_sorter sorter;
    svoi_store sorted = {0}, kind = {0};
    uint64_t count = 0;
    svo_result r = svoi_sorter_begin(&sorter, &w->room, &order, sizeof(svoi_triangle), p->triangle_count, err);
    if (r == SVO_OK) r = w->room.pager == NULL ? scan_memory(&s, &sorter, threads, err) : scan_stream(&s, &sorter, w->room.allocator, err);
    if (r == SVO_OK) r = svoi_sorter_end(&sorter, &sorted, &count, err);
    else svoi_sorter_drop(&sorter);
    if (r == SVO_OK && (s.sum[0][0] != 0 || s.sum[0][1] != 0)) /* not every edge is balanced */
        r = svoi_edges_classify(&w->room, &sorted, count, lattice_bits, &kind, &w->boundary, &w->boundary_count, err);
    if (r == SVO_OK) r = part_classes(w, &sorted, count, &kind, report, err);
    svoi_store_free(&kind);
    svoi_store_free(&sorted);
    for (int c = 0; r == SVO_OK && c < SVOI_CLASSES; c++) r = build_tree(&w->room, &w->triangles[c], w->tree[c].count, box_of_triangle, &w->tree[c], err);
    if (r == SVO_OK && w->boundary_count != 0) r = build_tree(&w->room, &w->boundary, w->boundary_count, box_of_edge, &w->edges, err);
    if (r == SVO_OK && w->boundary_count != 0) r = build_lines(w, err);
    if (r == SVO_OK && w->tree[SVOI_OPEN].count != 0 && w->boundary_count > FEW_EDGES) r = build_moments(w, err);
    report->boundary_edges = w->boundary_count;
    return r;
}

svo_result svo_winding_create(const svo_placement *placement, const svo_grid *grid, uint32_t threads, const svo_allocator *a, const svo_winding_paging *paging,
                              svo_winding **out, svo_winding_report *report, svo_error *err)
{
    const double started = svo_seconds();
    *report = (svo_winding_report){0};
    if (placement->triangle_count >= UINT32_MAX)
        return svo_fail(err, SVO_LIMIT, "%llu placed triangles are more than a solid can have (4294967294); split the input", (unsigned long long)placement->triangle_count);
    svo_winding *w = svo_calloc(a, 1, sizeof *w);
    if (w == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    w->room = (svoi_room){.allocator = a};
    if (paging != NULL) w->room.pager = paging->pager, w->room.run_bytes = paging->run_bytes;
    const svo_result r = build(w, placement, grid, threads, report, err);
    if (r != SVO_OK) {
        svo_winding_free(w);
        return r;
    }
    report->seconds = svo_seconds() - started;
    *out = w;
    return SVO_OK;
}

void svo_winding_free(svo_winding *w)
{
    if (w == NULL) return;
    for (int c = 0; c < SVOI_CLASSES; c++) {
        svoi_store_free(&w->triangles[c]);
        svoi_store_free(&w->tree[c].box);
    }
    svoi_store_free(&w->moments);
    svoi_store_free(&w->lines);
    svoi_store_free(&w->edges.box);
    svoi_store_free(&w->boundary);
    svo_free(w->room.allocator, w, 1, sizeof *w);
}

bool svo_winding_closed(const svo_winding *w) { return w->tree[SVOI_OPEN].count == 0; }
