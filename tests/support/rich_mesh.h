/* A mesh with everything that can differ between runs of the voxelizer. */
#ifndef RICH_MESH_H
#define RICH_MESH_H

#include "voxel_set.h"

/* A mesh with all that can differ between runs: textures, masks, vertex colours, two materials, two instances. */
typedef struct rich_mesh {
    loose_mesh loose;
    svo_part parts[2];
    svo_material materials[2];
    svo_image image;
    svo_instance instances[2];
} rich_mesh;

static inline void rich_make(rich_mesh *m, uint64_t triangles, uint64_t seed)
{
    memset(m, 0, sizeof *m);
    double *positions = malloc(72 * triangles);
    for (uint64_t t = 0; t < triangles; t++) {
        double c[3] = {test_random_unit(&seed), test_random_unit(&seed), test_random_unit(&seed)}, size = t % 50 == 0 ? 1 : 0.05;
        for (int i = 0; i < 9; i++) positions[9 * t + (uint64_t)i] = c[i % 3] + size * test_random_unit(&seed);
    }
    loose_make(&m->loose, positions, triangles);
    free(positions);
    svo_part *p = &m->loose.part;
    p->uvs[0] = malloc(triangles * 24);
    p->colors = malloc(triangles * 48);
    p->normals = malloc(triangles * 36);
    for (uint64_t i = 0; i < triangles * 6; i++) p->uvs[0][i] = (float)(4 * test_random_unit(&seed) - 2);
    for (uint64_t i = 0; i < triangles * 12; i++) p->colors[i] = (float)test_random_unit(&seed);
    for (uint64_t i = 0; i < triangles * 9; i++) p->normals[i] = (float)(2 * test_random_unit(&seed) - 1);
    m->image.width = 37;
    m->image.height = 21;
    m->image.has_alpha = true;
    m->image.pixels = malloc(37 * 21 * 4);
    for (int i = 0; i < 37 * 21 * 4; i++) m->image.pixels[i] = (uint8_t)test_random(&seed);
    for (int i = 0; i < 2; i++) {
        m->materials[i] = svo_material_default();
        m->materials[i].base_color_texture.image = 0;
        m->materials[i].metallic = 0.5f * (float)i;
        m->materials[i].emissive[i] = 0.5f;
        m->materials[i].alpha_mode = i == 0 ? SVO_ALPHA_MASK : SVO_ALPHA_OPAQUE;
        m->materials[i].alpha_cutoff = 0.6f;
        m->parts[i] = *p;
        m->parts[i].material = (uint32_t)i;
        m->instances[i] = m->loose.instance;
    }
    uint64_t half = triangles / 2;
    m->parts[0].triangle_count = half;
    m->parts[1].triangle_count = triangles - half;
    m->parts[1].indices = p->indices + 3 * half;
    m->instances[1].transform.m[0] = -0.7; /* mirrored */
    m->instances[1].transform.m[3] = 0.9;
    m->loose.shape.part_count = 2;
    m->loose.shape.parts = m->parts;
    m->loose.mesh.instances = m->instances;
    m->loose.mesh.instance_count = 2;
    m->loose.mesh.materials = m->materials;
    m->loose.mesh.material_count = 2;
    m->loose.mesh.images = &m->image;
    m->loose.mesh.image_count = 1;
}
static inline void rich_free(rich_mesh *m)
{
    free(m->image.pixels);
    loose_free(&m->loose);
}

enum { EVERYTHING = SVO_WANT_COLOR | SVO_WANT_NORMAL | SVO_WANT_EMISSIVE | SVO_WANT_METALLIC | SVO_WANT_ROUGHNESS | SVO_WANT_MATERIAL };

#endif
