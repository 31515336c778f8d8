/* Real models as shapes for the skeleton tests. */
#ifndef SKEL_MODELS_H
#define SKEL_MODELS_H

#include "fmt_import.h"
#include "skel_shapes.h"
#include "test.h"

/* The first shape of a model of the folder of real models, its parts together. False where it is not there. */
static inline bool shape_of_model(const char *model, shape *s)
{
    const char *path = test_model(model);
    if (path == NULL) return false;
    svo_mesh m;
    svo_error e;
    fmt_import_options o = {.skip_images = true};
    memset(s, 0, sizeof *s);
    if (fmt_import_mesh(path, &o, &m, &e) != SVO_OK) return false;
    for (uint32_t i = 0; i < m.shapes[0].part_count; i++) {
        const svo_part *part = &m.shapes[0].parts[i];
        uint32_t base = (uint32_t)s->points;
        for (uint64_t v = 0; v < part->vertex_count; v++) shape_point(s, part->positions[3 * v], part->positions[3 * v + 1], part->positions[3 * v + 2]);
        for (uint64_t t = 0; t < part->triangle_count; t++) shape_triangle(s, base + part->indices[3 * t], base + part->indices[3 * t + 1], base + part->indices[3 * t + 2]);
    }
    svo_mesh_free(&m);
    return true;
}

#endif
