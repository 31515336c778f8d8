/* Between the files that make attributes: svo_shade.c (materials, triangles, sums), svo_shade_texture.c and svo_shade_lanes.c. */
#ifndef SVOI_SHADE_H
#define SVOI_SHADE_H

#include "svo_shade.h"
#include "svo_texture.h"

enum { BASE, OPACITY, EMISSIVE, METALLIC_ROUGHNESS }; /* svo_facet.texture */

typedef struct shade_material {
    svo_material m;
    const svo_pyramid *base, *opacity, *emissive, *metallic_roughness; /* NULL: not read */
    bool alpha_matters; /* colours are weighted by alpha (MASK, BLEND) */
} shade_material;

struct svo_shader {
    const svo_placement *placement;
    const svo_allocator *allocator;
    svo_grid grid;
    svo_shade_layout layout;
    shade_material *materials; /* material_count + 1: the last is the default */
    svo_pyramid *pyramids;     /* 3 an image, by svo_texel; levels 0: not built */
    bool *mirrored;            /* by instance: the transform turns triangles inside out */
    uint32_t image_count, material_count, instance_count; /* of the arrays above */
};

static inline const shade_material *svoi_material_of(const svo_shader *s, uint32_t material)
{
    uint32_t count = s->placement->mesh->material_count;
    return &s->materials[material < count ? material : count];
}

/* Where on the triangle a point (on its plane, or near) is. */
void svoi_barycentric(const svo_facet *t, const double p[3], double b[3]);

/* A texture's coordinates over a facet; slot: one of BASE ... */
const svo_facet_texture *svoi_facet_texture(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p);
/* Average of a texture over a piece. */
void svoi_read_texture(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p, const svo_piece *piece, float out[4]);
/* Colours are stored times alpha: divide by it; where it is 0, find a colour in coarser levels. */
void svoi_unmultiply(svo_facet *t, const svo_texture *how, const svo_pyramid *p, const svo_piece *piece, float texel[4]);
/* Largest alpha (red for a linear image) that a texture has anywhere in the polygon. */
double svoi_most_alpha(svo_facet *t, uint32_t slot, const svo_texture *how, const svo_pyramid *p, const svo_polygon *polygon, const double centre[3]);

#endif
