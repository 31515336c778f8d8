/* Two curves become one: what was left of the first, and what was made anew of the surface of the bones that were taken away. The second one was made of some
 * more surface than theirs, so that the cut through the surface lies where nothing of it is kept (Willcocks 2013, section 5.6, Refinement). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "skeli_geometry.h"
#include "skeli_refine.h"

/* Nodes are the joints of the base, then those of the new curve. */
typedef struct crossing {
    double length;
    uint32_t node, base, port; /* new joint, what it is joined to there, the selected bone of that which it replaces */
} crossing;

typedef struct joining {
    skeli_pool *pool;
    const skeli_part *p;
    uint32_t base, nodes;   /* joints of the base; all nodes */
    uint8_t *kept;          /* of each node: it is in the result (before near ones become one) */
    uint8_t *border;        /* joints of the base: kept, with a selected bone */
    uint32_t *group;        /* of kept new joints and of borders: group of bones they stand for */
    uint32_t *owner;        /* new joints that are not kept: what stands for them, or SVO_NONE */
    uint32_t *into;         /* of each node */
    uint32_t *set;          /* union-find of borders and new joints */
    crossing *cross;
    uint32_t crossings;
    uint32_t *bone;         /* 2 each, of the result, in nodes */
    uint64_t bones, room;
} joining;

static const double *position(const joining *j, uint32_t node)
{
    return node < j->base ? j->p->base->joints[node].position : j->p->curve->joints[node - j->base].position;
}

static double apart(const joining *j, uint32_t a, uint32_t b)
{
    return skeli_apart_far(position(j, a), position(j, b));
}

static bool unite(joining *j, uint32_t a, uint32_t b)
{
    uint32_t x = skeli_root(j->set, a), y = skeli_root(j->set, b);
    if (x == y) return false;
    j->set[x > y ? x : y] = x > y ? y : x;
    return true;
}

static void add_bone(joining *j, uint32_t a, uint32_t b)
{
    SVO_ASSERT(j->bones < j->room);
    j->bone[2 * j->bones] = a;
    j->bone[2 * j->bones++ + 1] = b;
}

/* --- which joints stay ------------------------------------------------------------------------------------------------ */

static void keep_base(joining *j)
{
    const skeli_part *p = j->p;
    for (uint32_t i = 0; i < j->base; i++) {
        bool some = false, all = p->spokes->start[i + 1] > p->spokes->start[i];
        for (uint32_t k = p->spokes->start[i]; k < p->spokes->start[i + 1]; k++) {
            bool selected = p->selected[p->spokes->bone[k]] != 0;
            some |= selected;
            all &= selected;
            if (selected) j->group[i] = p->bone_group[p->spokes->bone[k]];
        }
        j->kept[i] = !all;
        j->border[i] = some && !all;
    }
}

/* Keys are (joint << 32 | value), `order` lists those that count: every joint gets its most frequent value, the lowest of equal ones. */
static void take_majority(uint32_t *order, uint32_t *scratch, uint32_t count, const uint64_t *key, uint32_t *value)
{
    skeli_sort_by64(order, scratch, count, key, 64);
    for (uint32_t i = 0, end, most = 0; i < count; i = end) {
        uint32_t c = (uint32_t)(key[order[i]] >> 32);
        if (i == 0 || c != (uint32_t)(key[order[i - 1]] >> 32)) most = 0;
        for (end = i + 1; end < count && key[order[end]] == key[order[i]];) end++;
        if (end - i <= most) continue;
        most = end - i;
        value[c] = (uint32_t)key[order[i]];
    }
}

/* A new joint stays where most of its surface is that of the selected bones. Joints without surface do as their neighbours. */
static svo_result keep_new(joining *j, svo_error *err)
{
    const skeli_part *p = j->p;
    uint32_t n = p->curve->joint_count, vertices = p->mesh->vertex_count;
    uint32_t *in = skeli_take(j->pool, n, sizeof *in), *out = skeli_take(j->pool, n, sizeof *out);
    uint32_t *order = skeli_take(j->pool, vertices, sizeof *order), *scratch = skeli_take(j->pool, vertices, sizeof *scratch);
    uint64_t *key = skeli_take(j->pool, vertices, sizeof *key);
    if (in == NULL || out == NULL || order == NULL || scratch == NULL || key == NULL) return skeli_no_memory(err);
    memset(in, 0, n * sizeof *in);
    memset(out, 0, n * sizeof *out);
    for (int inside = 0; inside < 2; inside++) {
        uint32_t count = 0;
        for (uint32_t v = 0; v < vertices; v++) {
            uint32_t c = p->curve_of[v], value = inside ? p->group_of[v] : p->owner[v];
            if (p->inside[v] != inside) continue;
            (inside ? in : out)[c]++;
            if (value == SVO_NONE) continue;
            key[v] = (uint64_t)c << 32 | value;
            order[count++] = v;
        }
        take_majority(order, scratch, count, key, inside ? j->group + j->base : j->owner);
    }
    for (uint32_t c = 0; c < n; c++) j->kept[j->base + c] = in[c] > out[c];
    for (bool more = true; more;) {
        more = false;
        for (uint32_t b = 0; b < p->curve->bone_count; b++)
            for (int turn = 0; turn < 2; turn++) {
                uint32_t x = turn ? p->curve->bones[b].b : p->curve->bones[b].a, y = turn ? p->curve->bones[b].a : p->curve->bones[b].b;
                if (in[x] + out[x] > 0 || in[y] + out[y] == 0) continue;
                j->kept[j->base + x] = j->kept[j->base + y];
                j->group[j->base + x] = j->group[j->base + y];
                j->owner[x] = j->owner[y];
                in[x] = 1; /* known */
                more = true;
            }
    }
    skeli_give(j->pool, in);
    skeli_give(j->pool, out);
    skeli_give(j->pool, order);
    skeli_give(j->pool, scratch);
    skeli_give(j->pool, key);
    return SVO_OK;
}

/* --- how they are connected ------------------------------------------------------------------------------------------- */

static int by_length(const void *a, const void *b)
{
    const crossing *x = a, *y = b;
    if (x->length != y->length) return x->length < y->length ? -1 : 1;
    if (x->node != y->node) return x->node < y->node ? -1 : 1;
    return x->base < y->base ? -1 : x->base > y->base;
}

/* The selected bone of a border that is nearest to a new joint. */
static uint32_t port_of(const joining *j, uint32_t border, uint32_t node)
{
    const skeli_part *p = j->p;
    double best = INFINITY, foot;
    uint32_t port = SVO_NONE;
    for (uint32_t k = p->spokes->start[border]; k < p->spokes->start[border + 1]; k++) {
        uint32_t b = p->spokes->bone[k];
        if (!p->selected[b]) continue;
        double d = skeli_segment_distance(position(j, node), p->base->joints[p->base->bones[b].a].position, p->base->joints[p->base->bones[b].b].position, &foot);
        if (d >= best) continue;
        best = d;
        port = b;
    }
    return port;
}

/* The border that new joint `node` of a group may be joined to: `owner` if it is one of the group's, else the nearest one; SVO_NONE where the group has none. */
static uint32_t border_for(const joining *j, uint32_t node, uint32_t owner)
{
    double best = INFINITY;
    uint32_t found = SVO_NONE;
    if (owner != SVO_NONE && j->border[owner] && j->group[owner] == j->group[node]) return owner;
    for (uint32_t i = 0; i < j->base; i++) {
        double d = j->border[i] && j->group[i] == j->group[node] ? apart(j, i, node) : INFINITY;
        if (!(d < best)) continue;
        best = d;
        found = i;
    }
    return found;
}

static bool same_part(const joining *j, uint32_t a, uint32_t b) { return j->kept[a] && j->kept[b] && j->group[a] == j->group[b]; }

/* Where the new curve leaves the selection: to what lies beside it, or to another group of selected bones. */
static void find_crossings(joining *j)
{
    const skel_skeleton *c = j->p->curve;
    for (uint32_t b = 0; b < c->bone_count; b++)
        for (int turn = 0; turn < 2; turn++) {
            uint32_t x = turn ? c->bones[b].b : c->bones[b].a, y = turn ? c->bones[b].a : c->bones[b].b, node = j->base + x;
            if (!j->kept[node] || same_part(j, node, j->base + y)) continue;
            uint32_t border = border_for(j, node, j->kept[j->base + y] ? SVO_NONE : j->owner[y]);
            if (border != SVO_NONE) j->cross[j->crossings++] = (crossing){apart(j, node, border), node, border, port_of(j, border, node)};
        }
    qsort(j->cross, j->crossings, sizeof *j->cross, by_length);
    uint32_t n = 0;
    for (uint32_t i = 0; i < j->crossings; i++)
        if (i == 0 || by_length(&j->cross[i], &j->cross[i - 1]) != 0) j->cross[n++] = j->cross[i];
    j->crossings = n;
}

/* Loops of the selected bones that go through a border: so many crossings may close a loop. */
static uint32_t loops_through_borders(joining *j, uint32_t *scratch)
{
    const skeli_part *p = j->p;
    uint32_t loops[2] = {0, 0};
    for (int inner = 0; inner < 2; inner++) {
        for (uint32_t i = 0; i < j->base; i++) scratch[i] = i;
        for (uint32_t b = 0; b < p->base->bone_count; b++) {
            uint32_t x = p->base->bones[b].a, y = p->base->bones[b].b;
            if (!p->selected[b] || (inner && (j->kept[x] || j->kept[y]))) continue;
            uint32_t s = skeli_root(scratch, x), t = skeli_root(scratch, y);
            if (s == t) loops[inner]++;
            else scratch[s > t ? s : t] = s > t ? t : s;
        }
    }
    return loops[0] - loops[1];
}

/* The way from a new joint to what it is joined to. */
static void take_crossing(joining *j, const crossing *c)
{
    if (c->length < j->p->near && j->into[c->node] == c->node) j->into[c->node] = c->base; /* bones of points fall away */
    else add_bone(j, c->node, c->base);
}

static svo_result connect(joining *j, svo_error *err)
{
    const skeli_part *p = j->p;
    for (uint32_t b = 0; b < p->base->bone_count; b++)
        if (!p->selected[b]) add_bone(j, p->base->bones[b].a, p->base->bones[b].b);
    for (uint32_t b = 0; b < p->curve->bone_count; b++) {
        uint32_t x = j->base + p->curve->bones[b].a, y = j->base + p->curve->bones[b].b;
        if (!same_part(j, x, y)) continue;
        add_bone(j, x, y);
        unite(j, x, y);
    }
    uint32_t *scratch = skeli_take(j->pool, j->base, sizeof *scratch);
    uint8_t *taken = skeli_take(j->pool, j->crossings, 1);
    if (scratch == NULL || taken == NULL) return skeli_no_memory(err);
    uint32_t spare = loops_through_borders(j, scratch);
    for (uint32_t i = 0; i < j->crossings; i++)
        if ((taken[i] = unite(j, j->cross[i].node, j->cross[i].base))) take_crossing(j, &j->cross[i]);
    for (uint32_t i = 0; i < j->crossings && spare > 0; i++) {
        bool other = !taken[i];
        for (uint32_t k = 0; k < j->crossings && other; k++) other = !taken[k] || j->cross[k].base != j->cross[i].base || j->cross[k].port != j->cross[i].port;
        if (!other) continue;
        taken[i] = 1;
        take_crossing(j, &j->cross[i]);
        spare--;
    }
    skeli_give(j->pool, scratch);
    skeli_give(j->pool, taken);
    return SVO_OK;
}

/* Pieces of one group of bones that are not connected: from the piece with the lowest node, the nearest node of another piece is joined, until there is one piece. Two joints
 * of the base are joined only where nothing new is between them: they may have a bone already. */
static svo_result link_pieces(joining *j, uint32_t *links, svo_error *err)
{
    uint32_t *member = skeli_take(j->pool, j->nodes, sizeof *member), *from = skeli_take(j->pool, j->nodes, sizeof *from);
    uint32_t *order = skeli_take(j->pool, j->nodes, sizeof *order), *scratch = skeli_take(j->pool, j->nodes, sizeof *scratch);
    double *distance = skeli_take(j->pool, j->nodes, sizeof *distance);
    uint64_t *key = skeli_take(j->pool, j->nodes, sizeof *key);
    if (member == NULL || from == NULL || order == NULL || scratch == NULL || distance == NULL || key == NULL) return skeli_no_memory(err);
    uint32_t n = 0;
    for (uint32_t i = 0; i < j->nodes; i++) {
        key[i] = j->group[i];
        if (i < j->base ? j->border[i] : j->kept[i]) order[n++] = i;
    }
    skeli_sort_by64(order, scratch, n, key, 32);
    for (uint32_t first = 0, end; first < n; first = end) {
        for (end = first + 1; end < n && key[order[end]] == key[order[first]];) end++;
        uint32_t left = 0, last;
        const bool some_new = order[end - 1] >= j->base;
        for (uint32_t i = first; i < end; i++) {
            if (skeli_root(j->set, order[i]) == skeli_root(j->set, order[first])) continue;
            distance[left] = INFINITY;
            member[left++] = order[i];
        }
        if (left == 0) continue;
        uint32_t fresh = 0; /* members of the connected piece, listed in scratch */
        for (uint32_t i = first; i < end; i++)
            if (skeli_root(j->set, order[i]) == skeli_root(j->set, order[first])) scratch[fresh++] = order[i];
        while (left > 0) {
            for (uint32_t i = 0; i < left; i++)
                for (uint32_t k = 0; k < fresh; k++) {
                    if (some_new && member[i] < j->base && scratch[k] < j->base) continue;
                    double d = apart(j, member[i], scratch[k]);
                    if (d >= distance[i]) continue;
                    distance[i] = d;
                    from[i] = scratch[k];
                }
            uint32_t best = 0;
            for (uint32_t i = 1; i < left; i++)
                if (distance[i] < distance[best]) best = i;
            add_bone(j, member[best], from[best]);
            ++*links;
            uint32_t root = skeli_root(j->set, member[best]);
            fresh = last = 0;
            for (uint32_t i = 0; i < left; i++) {
                if (skeli_root(j->set, member[i]) == root) {
                    scratch[fresh++] = member[i];
                    continue;
                }
                member[last] = member[i];
                distance[last] = distance[i];
                from[last++] = from[i];
            }
            left = last;
            for (uint32_t k = 0; k < fresh; k++) unite(j, scratch[k], order[first]);
        }
    }
    skeli_give(j->pool, member);
    skeli_give(j->pool, from);
    skeli_give(j->pool, order);
    skeli_give(j->pool, scratch);
    skeli_give(j->pool, distance);
    skeli_give(j->pool, key);
    return SVO_OK;
}

/* --- the result ------------------------------------------------------------------------------------------------------ */

/* Joints in order of their components, within them the base's first. */
static svo_result number_joints(joining *j, skeli_joined *out, svo_error *err)
{
    uint32_t *order = skeli_take(j->pool, j->nodes, sizeof *order), *scratch = skeli_take(j->pool, 2 * j->bones + j->nodes, sizeof *scratch);
    uint32_t *bucket = skeli_take(j->pool, (uint64_t)j->nodes + 1, sizeof *bucket);
    uint64_t *key = skeli_take(j->pool, j->nodes, sizeof *key);
    if (order == NULL || scratch == NULL || bucket == NULL || key == NULL) return skeli_no_memory(err);
    uint64_t bones = 0;
    for (uint32_t i = 0; i < j->nodes; i++) j->set[i] = i;
    for (uint64_t b = 0; b < j->bones; b++) {
        uint32_t x = j->into[j->bone[2 * b]], y = j->into[j->bone[2 * b + 1]];
        if (x == y) continue;
        j->bone[2 * bones] = x;
        j->bone[2 * bones++ + 1] = y;
        unite(j, x, y);
    }
    uint32_t n = 0;
    for (uint32_t i = 0; i < j->nodes; i++) {
        out->node[i] = SVO_NONE;
        key[i] = skeli_root(j->set, i);
        if (j->kept[i] && j->into[i] == i) order[n++] = i;
    }
    skeli_sort_by64(order, scratch, n, key, 32);
    for (uint32_t k = 0; k < n; k++) {
        out->node[order[k]] = k;
        memcpy(out->position + 3 * (uint64_t)k, position(j, order[k]), 3 * sizeof *out->position);
        out->kept += order[k] < j->base;
    }
    for (uint32_t i = 0; i < j->nodes; i++)
        if (j->kept[i]) out->node[i] = out->node[j->into[i]];
    for (uint64_t b = 0; b < bones; b++) {
        uint32_t x = out->node[j->bone[2 * b]], y = out->node[j->bone[2 * b + 1]];
        j->bone[2 * b] = x < y ? x : y;
        j->bone[2 * b + 1] = x < y ? y : x;
    }
    out->joints = n;
    out->bones = (uint32_t)skeli_sort_unique(j->bone, bones, 2, n, scratch, bucket);
    out->bone = j->bone;
    skeli_give(j->pool, order);
    skeli_give(j->pool, scratch);
    skeli_give(j->pool, bucket);
    skeli_give(j->pool, key);
    return SVO_OK;
}

svo_result skeli_join(skeli_pool *pool, const skeli_part *p, skeli_joined *out, svo_error *err)
{
    uint32_t base = p->base->joint_count, nodes = base + p->curve->joint_count;
    joining j = {.pool = pool, .p = p, .base = base, .nodes = nodes};
    j.room = (uint64_t)p->base->bone_count + 3 * (uint64_t)p->curve->bone_count + nodes;
    j.kept = skeli_take(pool, nodes, 1);
    j.border = skeli_take(pool, base, 1);
    j.group = skeli_take(pool, nodes, sizeof *j.group);
    j.owner = skeli_take(pool, p->curve->joint_count, sizeof *j.owner);
    j.into = skeli_take(pool, nodes, sizeof *j.into);
    j.set = skeli_take(pool, nodes, sizeof *j.set);
    j.cross = skeli_take(pool, 2 * (uint64_t)p->curve->bone_count, sizeof *j.cross);
    j.bone = skeli_take(pool, 2 * j.room, sizeof *j.bone);
    memset(out, 0, sizeof *out);
    out->node = skeli_take(pool, nodes, sizeof *out->node);
    out->position = skeli_take(pool, 3 * (uint64_t)nodes, sizeof *out->position);
    if (j.kept == NULL || j.border == NULL || j.group == NULL || j.owner == NULL || j.into == NULL || j.set == NULL || j.cross == NULL || j.bone == NULL ||
        out->node == NULL || out->position == NULL)
        return skeli_no_memory(err);
    for (uint32_t i = 0; i < nodes; i++) {
        j.into[i] = j.set[i] = i;
        j.group[i] = 0;
    }
    for (uint32_t i = 0; i < p->curve->joint_count; i++) j.owner[i] = SVO_NONE;
    keep_base(&j);
    SVO_TRY(keep_new(&j, err));
    find_crossings(&j);
    SVO_TRY(connect(&j, err));
    SVO_TRY(link_pieces(&j, &out->links, err));
    return number_joints(&j, out, err);
}
