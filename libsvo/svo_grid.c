/* svo_voxelize_plan: where the grid lies, how deep it is, and which channels say something. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "svo_voxelize.h"
#include "svoi_scatter.h"

svo_voxelize_options svo_default_voxelize_options(void)
{
    svo_voxelize_options o = {.depth = 10, .surface = SVO_SURFACE_CONSERVATIVE, .fill = SVO_FILL_SURFACE, .channels = SVO_WANT_AUTO};
    return o;
}

/* Beyond these the determinant of voxel_to_world or its products leave the range of doubles. */
static const double least_size = 1e-90, most_extent = 1e90;

static svo_result grid_by_depth(const double low[3], const double high[3], uint32_t depth, svo_grid *g, svo_error *err)
{
    double extent = 0;
    for (int i = 0; i < 3; i++) {
        if (high[i] - low[i] > extent) extent = high[i] - low[i];
        g->origin[i] = low[i];
    }
    if (!(extent < most_extent)) return svo_fail(err, SVO_LIMIT, "the mesh is %g units long; at most %g can be voxelized", extent, most_extent);
    g->depth = depth;
    g->size = ldexp(extent > 0 ? extent : 1, -(int)depth);
    if (g->size < least_size) g->size = least_size;
    return SVO_OK;
}

static svo_result grid_by_size(const double low[3], const double high[3], double size, svo_grid *g, svo_error *err)
{
    if (!(size >= least_size) || !(size < most_extent))
        return svo_fail(err, SVO_INVALID_ARGUMENT, "a voxel size of %g is outside of %g to %g", size, least_size, most_extent);
    double cells = 1;
    for (int i = 0; i < 3; i++) {
        g->origin[i] = floor(low[i] / size) * size;
        if (g->origin[i] > low[i]) g->origin[i] -= size; /* rounding of the product */
        double n = floor((high[i] - g->origin[i]) / size) + 1;
        if (!isfinite(g->origin[i]) || !isfinite(n)) n = INFINITY;
        if (n > cells) cells = n;
    }
    uint32_t depth = 0;
    while (depth < SVO_MAX_DEPTH && ldexp(1, (int)depth) < cells) depth++;
    if (ldexp(1, (int)depth) < cells)
        return svo_fail(err, SVO_LIMIT, "voxels of size %g need %.3g cells along one side; at most 2^%u = %u are possible: use a voxel size of %g or more",
                        size, cells, SVO_MAX_DEPTH, 1u << SVO_MAX_DEPTH, size * (cells / ldexp(1, (int)SVO_MAX_DEPTH)) * 1.000001);
    g->depth = depth;
    g->size = size;
    return SVO_OK;
}

svo_result svo_grid_plan(bool any, const double low[3], const double high[3], uint32_t depth, double voxel_size, svo_grid *out, svo_error *err)
{
    const double zero[3] = {0, 0, 0};
    svo_grid g = {.size = ldexp(1, -(int)depth), .depth = depth};
    if (voxel_size != 0) SVO_TRY(grid_by_size(any ? low : zero, any ? high : zero, voxel_size, &g, err));
    else if (any) SVO_TRY(grid_by_depth(low, high, depth, &g, err));
    *out = g;
    return SVO_OK;
}

/* Is p - origin >= k * size, exactly? k * size is within a few units in the last place of p - origin. */
static bool reaches(double p, double origin, double k, double size)
{
    const double d = p - origin, back = p - d, rest = (p - (d + back)) + (back - origin); /* d + rest = p - origin */
    const double product = k * size, low = fma(k, size, -product);                         /* product + low = k * size */
    const double first = d - product;                                                      /* exact: they are close */
    const double t = rest - low, virtual = rest - t, u = (rest - (t + virtual)) + (virtual - low);
    const double v = first + t, again = v - first, w = (first - (v - again)) + (t - again);
    return v + (w + u) >= 0;
}

void svo_grid_cell(const svo_grid *g, const double p[3], uint32_t cell[3])
{
    const double last = ldexp(1, (int)g->depth) - 1, near = ldexp(1, -28); /* the quotient is within 2^-30 */
    for (int i = 0; i < 3; i++) {
        const double q = (p[i] - g->origin[i]) / g->size, k = floor(q + 0.5);
        double c = floor(q);
        if (k > 0 && fabs(q - k) < near) c = reaches(p[i], g->origin[i], k, g->size) ? k : k - 1;
        cell[i] = c > 0 ? c < last ? (uint32_t)c : (uint32_t)last : 0;
    }
}

/* What the materials in use say about one channel. */
typedef struct uses { bool varies, first_seen; float value[3]; } uses;

static void use(uses *u, const float *value, int count, bool varies)
{
    if (varies) u->varies = true;
    if (!u->first_seen) {
        u->first_seen = true;
        memcpy(u->value, value, (size_t)count * sizeof *value);
    } else if (memcmp(u->value, value, (size_t)count * sizeof *value) != 0) {
        u->varies = true;
    }
}

static bool textured(const svo_mesh *mesh, const svo_texture *t) { return t->image != SVO_NONE && t->image < mesh->image_count; }

static svo_channel *add_channel(svo_tree_info *info, const char *name, svo_channel_kind kind)
{
    svo_channel *c = &info->channels[info->channel_count++];
    memset(c, 0, sizeof *c);
    snprintf(c->name, sizeof c->name, "%s", name);
    c->kind = kind;
    return c;
}

/* Have all corners of a part's triangles one colour? White where it has none. */
static bool one_color(const svo_part *part, float color[4])
{
    for (int k = 0; k < 4; k++) color[k] = 1;
    if (part->soup != NULL) {
        if (part->soup->layout.colors) memcpy(color, part->soup->color, sizeof part->soup->color);
        return !part->soup->layout.colors || !part->soup->many_colors;
    }
    if (part->colors == NULL || part->triangle_count == 0) return true;
    memcpy(color, part->colors + 4 * (uint64_t)part->indices[0], 4 * sizeof *color);
    for (uint64_t i = 1; i < 3 * part->triangle_count; i++)
        if (memcmp(part->colors + 4 * (uint64_t)part->indices[i], color, 4 * sizeof *color) != 0) return false;
    return true;
}

static uint8_t unorm8(float v) { return v > 0 ? v < 1 ? (uint8_t)(v * 255 + 0.5f) : 255 : 0; }

/* Channels in a fixed order; those in which every voxel would get the same value are constant. */
static svo_result plan_channels(const svo_placement *p, uint32_t wanted, bool any, svo_tree_info *info, svo_error *err)
{
    const svo_mesh *mesh = p->mesh;
    uses color = {0}, emissive = {0}, metallic = {0}, roughness = {0}, material = {0}, coverage = {0};
    bool blends = false;
    for (uint64_t g = 0; any && g < p->group_count; g++) {
        const svo_part *part = p->groups[g].part;
        bool named = part->material < mesh->material_count;
        svo_material m = named ? mesh->materials[part->material] : svo_material_default();
        float id = named ? (float)part->material : -1;
        float glow[3];
        for (int i = 0; i < 3; i++) glow[i] = m.emissive[i] > 0 ? m.emissive[i] < 1 ? m.emissive[i] : 1 : 0;
        bool glows = glow[0] > 0 || glow[1] > 0 || glow[2] > 0, mr = textured(mesh, &m.metallic_roughness_texture);
        float painted[4];
        const bool plain = one_color(part, painted);
        for (int i = 0; i < 4; i++) painted[i] *= m.base_color[i];
        use(&color, painted, 3, textured(mesh, &m.base_color_texture) || !plain);
        use(&emissive, glow, 3, glows && textured(mesh, &m.emissive_texture));
        use(&metallic, &m.metallic, 1, mr && m.metallic > 0);
        use(&roughness, &m.roughness, 1, mr && m.roughness > 0);
        use(&material, &id, 1, false);
        const bool alpha = m.alpha_mode != SVO_ALPHA_OPAQUE;
        const float covers = !alpha ? 1 : painted[3] > 0 ? painted[3] < 1 ? painted[3] : 1 : 0;
        const bool seen_through = textured(mesh, &m.base_color_texture) && mesh->images[m.base_color_texture.image].has_alpha;
        use(&coverage, &covers, 1, alpha && (seen_through || textured(mesh, &m.opacity_texture) || !plain));
        blends |= m.alpha_mode == SVO_ALPHA_BLEND;
        if (named && part->material >= UINT16_MAX && wanted & SVO_WANT_MATERIAL)
            return svo_fail(err, SVO_LIMIT, "the material channel holds at most %u materials", UINT16_MAX);
    }
    if (!any) color.value[0] = color.value[1] = color.value[2] = 1, roughness.value[0] = 1;
    bool automatic = (wanted & SVO_WANT_AUTO) != 0 && any;
    if (wanted & SVO_WANT_COLOR || (automatic && (color.varies || color.value[0] != 1 || color.value[1] != 1 || color.value[2] != 1))) {
        svo_channel *c = add_channel(info, "color", SVO_KIND_COLOR_SRGB8);
        c->constant = !color.varies;
        for (int i = 0; i < 3 && c->constant; i++) c->value[i] = svo_linear_to_srgb(color.value[i]);
    }
    if (wanted & SVO_WANT_NORMAL || automatic) add_channel(info, "normal", SVO_KIND_NORMAL_OCT32);
    if (wanted & SVO_WANT_EMISSIVE || (automatic && (emissive.varies || emissive.value[0] > 0 || emissive.value[1] > 0 || emissive.value[2] > 0))) {
        svo_channel *c = add_channel(info, "emissive", SVO_KIND_COLOR_SRGB8);
        c->constant = !emissive.varies;
        for (int i = 0; i < 3 && c->constant; i++) c->value[i] = svo_linear_to_srgb(emissive.value[i]);
    }
    if (wanted & SVO_WANT_METALLIC || (automatic && (metallic.varies || metallic.value[0] != 0))) {
        svo_channel *c = add_channel(info, "metallic", SVO_KIND_UNORM8);
        c->constant = !metallic.varies;
        if (c->constant) c->value[0] = unorm8(metallic.value[0]);
    }
    if (wanted & SVO_WANT_ROUGHNESS || (automatic && (roughness.varies || roughness.value[0] != 1))) {
        svo_channel *c = add_channel(info, "roughness", SVO_KIND_UNORM8);
        c->constant = !roughness.varies;
        if (c->constant) c->value[0] = unorm8(roughness.value[0]);
    }
    if (wanted & SVO_WANT_MATERIAL) {
        svo_channel *c = add_channel(info, "material", SVO_KIND_ID16);
        c->constant = !material.varies;
        uint32_t id = material.value[0] >= 0 && material.first_seen ? (uint32_t)material.value[0] : UINT16_MAX;
        if (c->constant) c->value[0] = (uint8_t)id, c->value[1] = (uint8_t)(id >> 8);
    }
    if (!coverage.first_seen) coverage.value[0] = 1;
    if (wanted & SVO_WANT_COVERAGE || (automatic && blends && (coverage.varies || coverage.value[0] < 1))) {
        svo_channel *c = add_channel(info, "coverage", SVO_KIND_UNORM8);
        c->constant = !coverage.varies;
        if (c->constant) c->value[0] = unorm8(coverage.value[0]);
    }
    return SVO_OK;
}

svo_result svo_voxelize_plan(const svo_mesh *mesh, const svo_voxelize_options *options, svo_tree_info *info, svo_error *err)
{
    if (options->depth > SVO_MAX_DEPTH) return svo_fail(err, SVO_LIMIT, "a depth of %u is more than %u", options->depth, SVO_MAX_DEPTH);
    svo_placement p;
    SVO_TRY(svo_placement_create(mesh, options->allocator, &p, err));
    double low[3], high[3];
    bool any = false;
    svo_result r = svoi_bounds(&p, options->threads, options->allocator, &any, low, high, err);
    svo_grid g = {0};
    if (r == SVO_OK) r = svo_grid_plan(any, low, high, options->depth, options->voxel_size, &g, err);
    svo_tree_info planned = {.depth = g.depth, .surface = options->surface, .fill = options->fill};
    for (int i = 0; i < 3; i++) {
        planned.voxel_to_world[5 * i] = g.size;
        planned.voxel_to_world[4 * i + 3] = g.origin[i];
    }
    planned.voxel_to_world[15] = 1;
    if (r == SVO_OK) r = plan_channels(&p, options->channels, any, &planned, err);
    svo_placement_free(&p);
    if (r == SVO_OK) *info = planned;
    return r;
}
