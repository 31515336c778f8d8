/* .vox and binvox files. A few bytes may stand for many voxels (runs, models placed many times): then memory ends, which is told, and is no finding. */
#include "fmt_import_voxels.h"
#include "../fuzz.h"
#include "svo_morton.h"

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_voxels v;
    if (fmt_is_voxels(bytes, size) != fmt_is_voxels(bytes, size)) fuzz_fail("it is and is not a file of voxels");
    svo_result r = fmt_import_voxels(bytes, size, a, &v, err);
    if (r == SVO_OUT_OF_MEMORY) return svo_fail(err, SVO_LIMIT, "more voxels than memory");
    if (r != SVO_OK) return r;
    const fmt_cell *c = (const fmt_cell *)(const void *)v.cells.data;
    uint64_t count = v.cells.size / sizeof *c, last = 0;
    if (v.cells.size % sizeof *c != 0 || (v.side == 0 && count != 0)) fuzz_fail("half a voxel, or no grid");
    for (uint64_t i = 0; i < count; i++) {
        for (int k = 0; k < 3; k++)
            if (c[i].at[k] >= v.side) fuzz_fail("voxel %llu lies outside", (unsigned long long)i);
        uint64_t code = svo_morton_encode(c[i].at[0], c[i].at[1], c[i].at[2]);
        if (i != 0 && code <= last) fuzz_fail("voxel %llu is out of order", (unsigned long long)i);
        last = code;
    }
    for (int k = 0; k < 16; k++)
        if (!(v.to_world[k] - v.to_world[k] == 0)) fuzz_fail("a transform that is not finite");
    svo_buffer_free(&v.cells);
    return SVO_OK;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20};
