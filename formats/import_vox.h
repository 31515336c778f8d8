/* Between the readers of voxel files. */
#ifndef IMPORT_VOX_H
#define IMPORT_VOX_H

#include "fmt_import_voxels.h"

svo_result import_vox(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_voxels *v, svo_error *err);
/* Append a voxel; rgb may be NULL. */
svo_result import_cell(fmt_voxels *v, uint32_t x, uint32_t y, uint32_t z, const uint8_t *rgb, svo_error *err);

#endif
