#include "svo_mesh.h"

#include <math.h>
#include <string.h>

#include "svo_soup.h"

char *svo_string_copy(const svo_allocator *a, const char *text)
{
    if (text == NULL) text = "";
    size_t n = strlen(text) + 1;
    char *copy = svo_alloc(a, n, 1);
    if (copy != NULL) memcpy(copy, text, n);
    return copy;
}

void svo_string_free(const svo_allocator *a, char *text)
{
    if (text != NULL) svo_free(a, text, strlen(text) + 1, 1);
}

svo_texture svo_texture_none(void)
{
    svo_texture t = {.image = SVO_NONE, .transform = {1, 0, 0, 0, 1, 0}};
    return t;
}

svo_material svo_material_default(void)
{
    svo_material m = {.base_color = {1, 1, 1, 1}, .roughness = 1, .alpha_cutoff = 0.5f};
    m.base_color_texture = m.emissive_texture = m.metallic_roughness_texture = m.opacity_texture = svo_texture_none();
    return m;
}

void svo_image_free_pixels(const svo_allocator *a, svo_image *image)
{
    if (image->paged != NULL) svo_paged_free(image->paged);
    else svo_free(a, image->pixels, (uint64_t)image->width * image->height, 4);
    image->paged = NULL;
    image->pixels = NULL;
}

void svo_mesh_free(svo_mesh *mesh)
{
    if (mesh == NULL) return;
    const svo_allocator *a = mesh->allocator;
    for (uint32_t s = 0; mesh->shapes != NULL && s < mesh->shape_count; s++) {
        svo_shape *shape = &mesh->shapes[s];
        for (uint32_t p = 0; shape->parts != NULL && p < shape->part_count; p++) {
            svo_part *part = &shape->parts[p];
            svo_soup_free(part->soup);
            if (part->soup != NULL) continue;
            svo_free(a, part->positions, part->vertex_count, 3 * sizeof(double));
            svo_free(a, part->normals, part->vertex_count, 3 * sizeof(float));
            for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) svo_free(a, part->uvs[u], part->vertex_count, 2 * sizeof(float));
            svo_free(a, part->colors, part->vertex_count, 4 * sizeof(float));
            svo_free(a, part->indices, part->triangle_count, 3 * sizeof(uint32_t));
        }
        svo_free(a, shape->parts, shape->part_count, sizeof(svo_part));
        svo_string_free(a, shape->name);
    }
    for (uint32_t i = 0; mesh->instances != NULL && i < mesh->instance_count; i++)
        svo_string_free(a, mesh->instances[i].name);
    for (uint32_t i = 0; mesh->materials != NULL && i < mesh->material_count; i++)
        svo_string_free(a, mesh->materials[i].name);
    for (uint32_t i = 0; mesh->cameras != NULL && i < mesh->camera_count; i++)
        svo_string_free(a, mesh->cameras[i].name);
    for (uint32_t i = 0; mesh->images != NULL && i < mesh->image_count; i++) {
        svo_image *image = &mesh->images[i];
        svo_image_free_pixels(a, image);
        svo_string_free(a, image->name);
    }
    svo_free(a, mesh->shapes, mesh->shape_count, sizeof(svo_shape));
    svo_free(a, mesh->instances, mesh->instance_count, sizeof(svo_instance));
    svo_free(a, mesh->materials, mesh->material_count, sizeof(svo_material));
    svo_free(a, mesh->images, mesh->image_count, sizeof(svo_image));
    svo_free(a, mesh->cameras, mesh->camera_count, sizeof(svo_camera));
    memset(mesh, 0, sizeof *mesh);
    mesh->allocator = a;
}

bool svo_part_has_colors(const svo_part *part) { return part->soup != NULL ? part->soup->layout.colors : part->colors != NULL; }

svo_mesh_counts svo_mesh_count(const svo_mesh *mesh)
{
    svo_mesh_counts c = {0};
    for (uint32_t s = 0; s < mesh->shape_count; s++)
        for (uint32_t p = 0; p < mesh->shapes[s].part_count; p++) {
            const svo_part *part = &mesh->shapes[s].parts[p];
            if (part->soup != NULL) {
                c.vertices += part->vertex_count;
                c.triangles += part->triangle_count;
                c.spilled_triangles += part->triangle_count;
                c.spilled_bytes += part->triangle_count * part->soup->layout.stride;
                continue;
            }
            uint64_t per_vertex = 3 * sizeof(double) + (part->normals != NULL ? 12 : 0) + (part->colors != NULL ? 16 : 0);
            for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++) per_vertex += part->uvs[u] != NULL ? 8 : 0;
            c.vertices += part->vertex_count;
            c.triangles += part->triangle_count;
            c.bytes += part->vertex_count * per_vertex + part->triangle_count * 12;
        }
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_shape *shape = &mesh->shapes[mesh->instances[i].shape];
        for (uint32_t p = 0; p < shape->part_count; p++) c.placed_triangles += shape->parts[p].triangle_count;
    }
    for (uint32_t i = 0; i < mesh->image_count; i++) {
        const uint64_t bytes = (uint64_t)mesh->images[i].width * mesh->images[i].height * 4;
        const bool paged = mesh->images[i].paged != NULL;
        c.paged_images += paged;
        *(paged ? &c.paged_bytes : &c.bytes) += bytes;
    }
    return c;
}

static bool finite3(svo_vec3 v) { return isfinite(v.x) && isfinite(v.y) && isfinite(v.z); }

bool svo_mesh_bounds(const svo_mesh *mesh, double low[3], double high[3])
{
    svo_vec3 lo = {INFINITY, INFINITY, INFINITY}, hi = {-INFINITY, -INFINITY, -INFINITY};
    bool any = false;
    for (uint32_t i = 0; i < mesh->instance_count; i++) {
        const svo_instance *instance = &mesh->instances[i];
        const svo_shape *shape = &mesh->shapes[instance->shape];
        for (uint32_t p = 0; p < shape->part_count; p++) {
            const svo_part *part = &shape->parts[p];
            SVO_ASSERT(part->soup == NULL);
            for (uint64_t t = 0; t < part->triangle_count; t++) {
                svo_vec3 v[3];
                for (int k = 0; k < 3; k++) {
                    const double *q = part->positions + 3 * (uint64_t)part->indices[3 * t + (uint64_t)k];
                    v[k] = svo_mat4_point(&instance->transform, svo_v3(q[0], q[1], q[2]));
                }
                if (!finite3(v[0]) || !finite3(v[1]) || !finite3(v[2])) continue;
                any = true;
                for (int k = 0; k < 3; k++) {
                    lo = svo_v3(fmin(lo.x, v[k].x), fmin(lo.y, v[k].y), fmin(lo.z, v[k].z));
                    hi = svo_v3(fmax(hi.x, v[k].x), fmax(hi.y, v[k].y), fmax(hi.z, v[k].z));
                }
            }
        }
    }
    if (!any) return false;
    low[0] = lo.x, low[1] = lo.y, low[2] = lo.z;
    high[0] = hi.x, high[1] = hi.y, high[2] = hi.z;
    return true;
}
