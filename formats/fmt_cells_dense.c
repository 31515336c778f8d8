/* A box of the grid as a dense volume, with a NRRD header or without. */
#include <stdio.h>
#include <string.h>

#include "fmt_cells.h"

static svo_result write_header(const fmt_cells *c, bool rgba, fmt_output *out, svo_error *err)
{
    char text[1200];
    const double *m = c->to_world;
    double origin[3];
    for (int r = 0; r < 3; r++) /* NRRD places samples at cell centres */
        origin[r] = m[4 * r] * (c->low[0] + 0.5) + m[4 * r + 1] * (c->low[1] + 0.5) + m[4 * r + 2] * (c->low[2] + 0.5) + m[4 * r + 3];
    int n = snprintf(text, sizeof text, "NRRD0005\n# %s; x fastest\ntype: uint8\ndimension: %d\nspace dimension: 3\nsizes: %s%u %u %u\nspace directions: %s(%.17g,%.17g,%.17g) "
                     "(%.17g,%.17g,%.17g) (%.17g,%.17g,%.17g)\ncenters: %scell cell cell\nkinds: %sdomain domain domain\nspace origin: (%.17g,%.17g,%.17g)\nencoding: raw\n\n",
                     rgba ? "sRGB colour and 255, or 0 0 0 0" : "255 in voxels", rgba ? 4 : 3, rgba ? "4 " : "", c->high[0] - c->low[0] + 1, c->high[1] - c->low[1] + 1,
                     c->high[2] - c->low[2] + 1, rgba ? "none " : "", m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10], rgba ? "none " : "", rgba ? "RGBA-color " : "",
                     origin[0], origin[1], origin[2]);
    return fmt_output_write(out, text, (size_t)n, err);
}

svo_result fmt_cells_dense(const fmt_cells *c, bool rgba, bool header, fmt_output *out, svo_error *err)
{
    uint64_t size[3], width = rgba ? 4 : 1;
    for (int k = 0; k < 3; k++) size[k] = (uint64_t)c->high[k] - c->low[k] + 1;
    uint64_t total = size[0] * size[1] * size[2]; /* at most 2^63 */
    size_t bytes;
    if (!svo_mul_size(total, (size_t)width, &bytes)) return svo_fail(err, SVO_LIMIT, "the volume is too large; export a box of it or a coarser level");
    uint8_t *volume = svo_calloc(c->allocator, total, (size_t)width);
    if (volume == NULL)
        return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a dense volume of %llu x %llu x %llu cells; export a box of it (--low, --high) or a coarser level (--level)",
                        (unsigned long long)size[0], (unsigned long long)size[1], (unsigned long long)size[2]);
    for (uint64_t i = 0; i < c->count; i++) {
        const uint32_t *at = c->cell[i].at;
        uint8_t *to = volume + width * ((at[2] - c->low[2]) * size[0] * size[1] + (at[1] - c->low[1]) * size[0] + (at[0] - c->low[0]));
        if (rgba) memcpy(to, c->cell[i].rgb, 4);
        else *to = 255;
    }
    svo_result r = header ? write_header(c, rgba, out, err) : SVO_OK;
    if (r == SVO_OK) r = fmt_output_write(out, volume, bytes, err);
    svo_free(c->allocator, volume, total, (size_t)width);
    return r;
}
