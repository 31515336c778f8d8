/* The mesh as every importer delivers it and every builder takes it: shapes made of parts (one material each), and
 * instances that place shapes in the world. Plain data; an importer guarantees the rules marked "always".
 *
 * Axes: right-handed, +Y up, metres, as glTF (formats that state no axes or units are taken as they are).
 * Texture coordinates: (0,0) is the TOP-LEFT corner of the image, v grows downwards (glTF's convention; importers
 * of formats with a bottom-left origin flip v). */
#ifndef SVO_MESH_H
#define SVO_MESH_H

#include "svo_alloc.h"
#include "svo_math.h"
#include "svo_pager.h"

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_NONE UINT32_MAX
#define SVO_MAX_UV_SETS 4u

/* 8-bit RGBA, row 0 is the top row, alpha not premultiplied. Values are as stored in the file; whether they are sRGB
 * is a matter of use (base colour and emissive are, others are linear). width, height >= 1 always. */
typedef struct svo_image {
    char *name;
    uint32_t width, height;
    uint8_t *pixels; /* width * height * 4 */
    bool has_alpha;  /* some pixel has alpha < 255 */
    svo_paged *paged; /* not NULL: pixels are its data, and are touched before they are read. Only importers that are given a pager do that */
} svo_image;
/* Make pixels [x, x + count) of row y ready to be used. */
static inline void svo_image_touch(const svo_image *image, uint32_t x, uint32_t y, uint32_t count)
{
    if (image->paged != NULL) svo_paged_touch(image->paged, image->pixels + 4 * ((uint64_t)y * image->width + x), 4 * (uint64_t)count);
}
/* Frees the pixels alone. */
void svo_image_free_pixels(const svo_allocator *a, svo_image *image);

typedef enum svo_wrap { SVO_WRAP_REPEAT, SVO_WRAP_CLAMP, SVO_WRAP_MIRROR } svo_wrap;

/* How a material looks into an image. image == SVO_NONE: no texture (factor alone). uv' = A * (u, v, 1). */
typedef struct svo_texture {
    uint32_t image;
    uint32_t uv_set; /* < SVO_MAX_UV_SETS always */
    svo_wrap wrap_u, wrap_v;
    bool nearest;       /* magnification filter of the source; minification always averages */
    double transform[6]; /* row-major 2x3, identity where the format has none */
} svo_texture;

typedef enum svo_alpha_mode { SVO_ALPHA_OPAQUE, SVO_ALPHA_MASK, SVO_ALPHA_BLEND } svo_alpha_mode;

/* glTF metallic-roughness; other formats are mapped to it. Factors are linear. */
typedef struct svo_material {
    char *name;
    float base_color[4]; /* linear RGB, alpha */
    svo_texture base_color_texture; /* sRGB, alpha linear */
    float emissive[3];              /* linear, may exceed 1 */
    svo_texture emissive_texture;   /* sRGB */
    float metallic, roughness;
    svo_texture metallic_roughness_texture; /* linear: G roughness, B metallic */
    svo_texture opacity_texture; /* linear, red channel multiplies alpha (MTL map_d); usually none */
    svo_alpha_mode alpha_mode;
    float alpha_cutoff;
    bool double_sided;
} svo_material;

/* Triangles with one material. Indices are < vertex_count always. Positions may be anything a file can hold, NaN
 * and infinity too: a builder skips (and counts) triangles that are not finite. Arrays other than positions and
 * indices may be NULL. */
typedef struct svo_part {
    uint32_t material; /* index into materials, or SVO_NONE: white, opaque */
    uint64_t vertex_count, triangle_count;
    double *positions;           /* 3 * vertex_count */
    float *normals;              /* 3 * vertex_count, not necessarily unit */
    float *uvs[SVO_MAX_UV_SETS]; /* 2 * vertex_count each */
    float *colors;               /* 4 * vertex_count, linear RGBA, multiplies base_color */
    uint32_t *indices;           /* 3 * triangle_count */
    /* Not NULL: the triangles lie outside of memory (svo_soup.h) and the arrays above are NULL. Importers do that only where
     * they are given a spill; of all builders only the voxelizer takes it. */
    struct svo_soup *soup;
} svo_part;
/* Has the part colours of its own? */
bool svo_part_has_colors(const svo_part *part);

/* What instances refer to: one mesh of a glTF file, or everything in a file of another format. */
typedef struct svo_shape {
    char *name; /* never NULL */
    uint32_t part_count;
    svo_part *parts;
} svo_shape;

typedef struct svo_instance {
    char *name;       /* never NULL, may be empty */
    uint32_t shape;   /* < shape_count always */
    svo_mat4 transform; /* shape to world; may mirror, may be singular */
} svo_instance;

typedef struct svo_camera {
    char *name;
    svo_mat4 transform; /* camera to world; looks along -Z, +Y up */
    double yfov;        /* radians */
} svo_camera;

/* Everything is allocated from `allocator` (NULL = default). */
typedef struct svo_mesh {
    const svo_allocator *allocator;
    uint32_t shape_count, instance_count, material_count, image_count, camera_count;
    svo_shape *shapes;
    svo_instance *instances;
    svo_material *materials;
    svo_image *images;
    svo_camera *cameras;
} svo_mesh;

/* Frees all members and zeroes *mesh (not the struct itself). */
void svo_mesh_free(svo_mesh *mesh);

/* White, opaque, no textures, metallic 0, roughness 1, cutoff 0.5; name NULL. */
svo_material svo_material_default(void);
svo_texture svo_texture_none(void);

/* A copy of text in memory of `a`, freed with svo_string_free; NULL when out of memory. NULL text copies as "". */
char *svo_string_copy(const svo_allocator *a, const char *text);
void svo_string_free(const svo_allocator *a, char *text);

typedef struct svo_mesh_counts {
    uint64_t vertices, triangles;             /* stored, each shape once */
    uint64_t placed_triangles;                /* with instances */
    uint64_t bytes;                           /* of all arrays and images in memory */
    uint64_t spilled_triangles, spilled_bytes; /* of the above: outside of memory, and what they take there */
    uint64_t paged_images, paged_bytes;        /* images in temporary files; not in `bytes` */
} svo_mesh_counts;
/* Counted in time linear in parts and instances; names and the structs themselves are not in `bytes`. */
svo_mesh_counts svo_mesh_count(const svo_mesh *mesh);

/* Bounds of all instances of finite triangles, corner by corner; false when there is none. */
bool svo_mesh_bounds(const svo_mesh *mesh, double low[3], double high[3]);

#ifdef __cplusplus
}
#endif
#endif
