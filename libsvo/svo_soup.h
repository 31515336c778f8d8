/* Triangles of a part outside of memory: unshared corners, one record a triangle, in pieces of a spill's file. What an
 * importer makes of a mesh that is larger than memory, and what the voxelizer bins. */
#ifndef SVO_SOUP_H
#define SVO_SOUP_H

#include "svo_mesh.h"
#include "svo_spill.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a record holds, in this order: 9 position values, 9 of normals, 6 of each set of texture coordinates, 12 of colours.
 * All are floats but positions that floats cannot hold exactly. */
typedef struct svo_soup_layout {
    bool wide; /* positions are doubles */
    bool normals, colors, uvs[SVO_MAX_UV_SETS];
    uint32_t stride; /* bytes a triangle */
} svo_soup_layout;
svo_soup_layout svo_soup_layout_make(bool wide, bool normals, const bool uvs[SVO_MAX_UV_SETS], bool colors);
/* The layout that a part in memory needs (looks at all its positions). */
svo_soup_layout svo_soup_layout_of(const svo_part *part);
#define SVO_SOUP_MAX_STRIDE (72u + 36u + 24u * SVO_MAX_UV_SETS + 48u)

/* Triangle `local` of a part in memory as a record (layout->stride bytes). */
void svo_soup_pack(const svo_soup_layout *layout, const svo_part *part, uint64_t local, uint8_t *to);
/* The positions of a record. */
void svo_soup_corners(const svo_soup_layout *layout, const uint8_t *record, double corner[9]);
/* The record as triangle `local` of a part in memory, whose arrays have room and whose vertices are unshared: vertices
 * 3 local .. 3 local + 2. Indices are not touched. */
void svo_soup_unpack(const svo_soup_layout *layout, const uint8_t *record, svo_part *part, uint64_t local);

/* A file that parts share. Reference counted (not atomically: parts are made and freed by one thread). */
typedef struct svo_soup_file svo_soup_file;
svo_result svo_soup_file_create(const svo_spill *spill, const svo_allocator *a, svo_soup_file **out, svo_error *err);
void svo_soup_file_release(svo_soup_file *f);

typedef struct svo_soup_piece { uint64_t offset, count; } svo_soup_piece;

/* What svo_part.soup points to. */
struct svo_soup {
    const svo_allocator *allocator;
    svo_soup_file *file;
    svo_soup_layout layout;
    svo_buffer pieces; /* svo_soup_piece, in the order of triangles */
    float color[4];    /* of the first corner; (layout.colors) */
    bool many_colors;  /* another corner has another one */
};
/* `count` records to the end of the part, as one piece; part->triangle_count and vertex_count follow. Makes part->soup first
 * where there is none. */
svo_result svo_soup_append(svo_part *part, svo_soup_file *file, const svo_soup_layout *layout, const svo_allocator *a, const uint8_t *records,
                           uint64_t count, svo_error *err);
void svo_soup_free(struct svo_soup *s);
/* Records [first, first + count) of a piece; callable from several threads. */
svo_result svo_soup_read(const struct svo_soup *s, const svo_soup_piece *piece, uint64_t first, uint64_t count, uint8_t *to, svo_error *err);
/* Give fn the corners (9 doubles, the part's own coordinates) of every triangle of pieces [begin, end), in order. Callable from several threads. */
typedef void (*svo_soup_triangle_fn)(void *user, const double corner[9]);
svo_result svo_soup_triangles(const struct svo_soup *s, uint64_t begin, uint64_t end, svo_soup_triangle_fn fn, void *user, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
