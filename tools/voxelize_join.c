#include "voxelize_join.h"

#include <string.h>

static void move_texture(svo_texture *t, uint32_t images)
{
    if (t->image != SVO_NONE) t->image += images;
}

/* Append one mesh's arrays to those of `to`, which are long enough, with its references shifted. */
static void append(svo_mesh *to, svo_mesh *from)
{
    for (uint32_t s = 0; s < from->shape_count; s++) {
        svo_shape *shape = &from->shapes[s];
        for (uint32_t p = 0; p < shape->part_count; p++)
            if (shape->parts[p].material != SVO_NONE) shape->parts[p].material += to->material_count;
        to->shapes[to->shape_count + s] = *shape;
    }
    for (uint32_t i = 0; i < from->instance_count; i++) {
        from->instances[i].shape += to->shape_count;
        to->instances[to->instance_count + i] = from->instances[i];
    }
    for (uint32_t i = 0; i < from->material_count; i++) {
        svo_material *m = &from->materials[i];
        move_texture(&m->base_color_texture, to->image_count);
        move_texture(&m->emissive_texture, to->image_count);
        move_texture(&m->metallic_roughness_texture, to->image_count);
        move_texture(&m->opacity_texture, to->image_count);
        to->materials[to->material_count + i] = *m;
    }
    for (uint32_t i = 0; i < from->image_count; i++) to->images[to->image_count + i] = from->images[i];
    for (uint32_t i = 0; i < from->camera_count; i++) to->cameras[to->camera_count + i] = from->cameras[i];
    to->shape_count += from->shape_count;
    to->instance_count += from->instance_count;
    to->material_count += from->material_count;
    to->image_count += from->image_count;
    to->camera_count += from->camera_count;
}

/* Free the arrays of a mesh whose elements have moved away. */
static void release(svo_mesh *m)
{
    const svo_allocator *a = m->allocator;
    svo_free(a, m->shapes, m->shape_count, sizeof *m->shapes);
    svo_free(a, m->instances, m->instance_count, sizeof *m->instances);
    svo_free(a, m->materials, m->material_count, sizeof *m->materials);
    svo_free(a, m->images, m->image_count, sizeof *m->images);
    svo_free(a, m->cameras, m->camera_count, sizeof *m->cameras);
    memset(m, 0, sizeof *m);
    m->allocator = a;
}

svo_result join_meshes(svo_mesh *meshes, uint32_t count, const svo_allocator *a, svo_mesh *out, svo_error *err)
{
    uint64_t shapes = 0, instances = 0, materials = 0, images = 0, cameras = 0;
    for (uint32_t i = 0; i < count; i++) {
        shapes += meshes[i].shape_count;
        instances += meshes[i].instance_count;
        materials += meshes[i].material_count;
        images += meshes[i].image_count;
        cameras += meshes[i].camera_count;
    }
    if (shapes >= SVO_NONE || instances >= SVO_NONE || materials >= SVO_NONE || images >= SVO_NONE || cameras >= SVO_NONE)
        return svo_fail(err, SVO_LIMIT, "the inputs have more than 4294967294 shapes, instances, materials or images together");
    svo_mesh m = {.allocator = a};
    m.shapes = svo_calloc(a, shapes, sizeof *m.shapes);
    m.instances = svo_calloc(a, instances, sizeof *m.instances);
    m.materials = svo_calloc(a, materials, sizeof *m.materials);
    m.images = svo_calloc(a, images, sizeof *m.images);
    m.cameras = svo_calloc(a, cameras, sizeof *m.cameras);
    if ((shapes != 0 && m.shapes == NULL) || (instances != 0 && m.instances == NULL) || (materials != 0 && m.materials == NULL) ||
        (images != 0 && m.images == NULL) || (cameras != 0 && m.cameras == NULL)) {
        svo_free(a, m.shapes, shapes, sizeof *m.shapes);
        svo_free(a, m.instances, instances, sizeof *m.instances);
        svo_free(a, m.materials, materials, sizeof *m.materials);
        svo_free(a, m.images, images, sizeof *m.images);
        svo_free(a, m.cameras, cameras, sizeof *m.cameras);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while joining %u inputs", count);
    }
    for (uint32_t i = 0; i < count; i++) {
        append(&m, &meshes[i]);
        release(&meshes[i]);
    }
    *out = m;
    return SVO_OK;
}
