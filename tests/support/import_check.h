/* What every imported mesh must satisfy, and small files for the tests of the importers. */
#ifndef IMPORT_CHECK_H
#define IMPORT_CHECK_H

#include <stdio.h>
#include <string.h>

#include "fmt_file.h"
#include "fmt_image.h"
#include "fmt_import.h"
#include "test.h"

/* The rules that svo_mesh.h marks "always"; returns what is broken, NULL if nothing. Reads every byte of every array, so
 * that a sanitizer sees wrong sizes. */
static inline const char *import_mesh_fault(const svo_mesh *m)
{
    volatile uint64_t sum = 0;
    for (uint32_t s = 0; s < m->shape_count; s++) {
        if (m->shapes[s].name == NULL) return "a shape without name";
        for (uint32_t p = 0; p < m->shapes[s].part_count; p++) {
            const svo_part *part = &m->shapes[s].parts[p];
            if (part->material != SVO_NONE && part->material >= m->material_count) return "a material index";
            if (part->triangle_count != 0 && (part->positions == NULL || part->indices == NULL)) return "missing arrays";
            for (uint64_t i = 0; i < 3 * part->triangle_count; i++)
                if (part->indices[i] >= part->vertex_count) return "a vertex index";
            const struct { const void *array; size_t size; } arrays[] = {
                {part->positions, 24}, {part->normals, 12}, {part->colors, 16}, {part->uvs[0], 8}, {part->uvs[1], 8}, {part->uvs[2], 8}, {part->uvs[3], 8}};
            for (size_t k = 0; k < sizeof arrays / sizeof *arrays; k++) {
                const uint8_t *b = arrays[k].array;
                for (uint64_t i = 0; b != NULL && i < part->vertex_count * arrays[k].size; i++) sum += b[i];
            }
            for (uint64_t i = 0; part->colors != NULL && i < 4 * part->vertex_count; i++)
                if (!(part->colors[i] >= 0 && part->colors[i] <= 1)) return "a colour outside of 0..1";
        }
    }
    for (uint32_t i = 0; i < m->instance_count; i++)
        if (m->instances[i].shape >= m->shape_count || m->instances[i].name == NULL) return "an instance";
    for (uint32_t i = 0; i < m->material_count; i++) {
        const svo_material *x = &m->materials[i];
        const svo_texture *t[] = {&x->base_color_texture, &x->emissive_texture, &x->metallic_roughness_texture, &x->opacity_texture};
        for (int k = 0; k < 4; k++)
            if ((t[k]->image != SVO_NONE && t[k]->image >= m->image_count) || t[k]->uv_set >= SVO_MAX_UV_SETS) return "a texture";
    }
    for (uint32_t i = 0; i < m->image_count; i++) {
        const svo_image *x = &m->images[i];
        if (x->width == 0 || x->height == 0 || x->pixels == NULL) return "an image";
        for (uint64_t k = 0; k < (uint64_t)x->width * x->height * 4; k++) sum += x->pixels[k];
    }
    (void)sum;
    return NULL;
}

/* A file in the test's folder; its path is in static storage that the next call reuses. NULL on failure. */
static inline const char *import_put(const char *name, const void *bytes, size_t size)
{
    static char path[4096];
    snprintf(path, sizeof path, "%s/%s", test_folder(), name);
    FILE *f = fopen(path, "wb");
    if (f == NULL) return NULL;
    bool ok = fwrite(bytes, 1, size, f) == size;
    return fclose(f) == 0 && ok ? path : NULL;
}
static inline const char *import_put_text(const char *name, const char *text) { return import_put(name, text, strlen(text)); }

/* A PNG of w x h pixels of 3 or 4 channels. */
static inline bool import_put_pixels(const char *name, const uint8_t *pixels, uint32_t channels, uint32_t w, uint32_t h)
{
    char path[4096];
    svo_error err = {0};
    fmt_output *o;
    snprintf(path, sizeof path, "%s/%s", test_folder(), name);
    if (fmt_output_open(path, true, &o, &err) != SVO_OK) return false;
    if (fmt_png_write(o, pixels, w, h, channels, &err) != SVO_OK) {
        fmt_output_discard(o);
        return false;
    }
    return fmt_output_commit(o, &err) == SVO_OK;
}

static inline bool import_put_png(const char *name, const uint8_t *rgba, uint32_t w, uint32_t h) { return import_put_pixels(name, rgba, 4, w, h); }

/* The texel that vertex v of a part sees through its material's base colour texture (nearest, wrap applied), as the
 * consumers of svo_mesh.h must compute it. */
static inline void import_texel(const svo_mesh *m, const svo_part *part, uint64_t v, uint8_t out[4])
{
    const svo_texture *t = &m->materials[part->material].base_color_texture;
    const svo_image *image = &m->images[t->image];
    const float *uv = part->uvs[t->uv_set] + 2 * v;
    double c[2];
    for (int k = 0; k < 2; k++) {
        c[k] = t->transform[3 * k] * (double)uv[0] + t->transform[3 * k + 1] * (double)uv[1] + t->transform[3 * k + 2];
        svo_wrap w = k == 0 ? t->wrap_u : t->wrap_v;
        if (w == SVO_WRAP_REPEAT) c[k] -= (double)(int64_t)(c[k] + 1000) - 1000;
        else if (w == SVO_WRAP_MIRROR) {
            int64_t n = (int64_t)(c[k] + 1000) - 1000;
            c[k] -= (double)n;
            if (n & 1) c[k] = 1 - c[k];
        }
        c[k] = c[k] < 0 ? 0 : c[k] > 0.999999 ? 0.999999 : c[k];
    }
    uint32_t x = (uint32_t)(c[0] * image->width), y = (uint32_t)(c[1] * image->height);
    memcpy(out, image->pixels + 4 * ((uint64_t)y * image->width + x), 4);
}

static inline bool import_has_warning(const svo_warnings *w, const char *part)
{
    for (uint32_t i = 0; i < w->count; i++)
        if (strstr(w->line[i].text, part) != NULL) return true;
    return false;
}

#endif
