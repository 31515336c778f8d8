/* How much two octrees, or two images, differ. A is the reference. */
#ifndef SVO_COMPARE_H
#define SVO_COMPARE_H

#include "svo_mesh.h"
#include "svo_stream.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Error of one channel over the voxels that both octrees have.
 *   colours   delta E CIE94 (svo_color.h), the value of A is the reference
 *   normals   degrees between them
 *   UNORM8    absolute difference, 0..1
 *   labels    1 where they differ, so that mean is the share that differs */
typedef struct svo_compare_channel {
    char name[16];
    bool in_a, in_b;
    bool comparable;    /* in both, of the same kind; the rest is 0 otherwise */
    svo_channel_kind kind;
    uint64_t different; /* voxels whose bytes differ */
    double mean, max;
    uint64_t worst;     /* Morton code of the first voxel with that maximum, when different > 0 */
} svo_compare_channel;

typedef struct svo_compare_result {
    bool same_depth;     /* otherwise only voxels_a and voxels_b are filled */
    bool same_transform; /* voxel_to_world, bit for bit */
    double transform_distance; /* largest distance between the images of a grid corner, in the world's unit */
    uint64_t voxels_a, voxels_b;
    uint64_t only_a, only_b, both;
    uint64_t first;      /* Morton code of the first voxel that only one has, when only_a + only_b > 0 */
    bool first_in_a;
    uint32_t channel_count; /* union of both, in A's order, then B's */
    svo_compare_channel channels[2 * SVO_MAX_CHANNELS];
} svo_compare_result;

typedef struct svo_compare_options {
    uint64_t max_voxels; /* over both; 0 = no limit; more is SVO_LIMIT */
    const svo_allocator *allocator;
    /* Called now and then with the voxels read so far; false cancels (SVO_CANCELLED). May be NULL. */
    bool (*progress)(void *user, uint64_t voxels);
    void *user;
} svo_compare_options;

/* Read both sources to their ends, chunk by chunk in Morton order: memory is that of two chunks. Every chunk is checked. */
svo_result svo_compare_trees(const svo_tree_info *a, const svo_chunk_source *source_a, const svo_tree_info *b,
                             const svo_chunk_source *source_b, const svo_compare_options *options, svo_compare_result *out,
                             svo_error *err);

typedef struct svo_compare_image {
    uint64_t pixels, different;     /* pixels with some channel that differs (alpha counts) */
    uint32_t max_difference;        /* 0..255, over all channels */
    bool alpha;                     /* one of the images has an alpha below 255; then `all` is over four channels */
    double mse[4], mse_all;         /* mean squared error of R, G, B, A on the 0..255 scale */
    double psnr[4], psnr_all;       /* 10 log10(255^2 / mse) dB; INFINITY where mse is 0 */
    double ssim;                    /* mean structural similarity; NaN when a side is below 11 pixels */
} svo_compare_image;

/* Two images of the same size (that is the caller's check). SSIM is that of Wang, Bovik, Sheikh and Simoncelli 2004:
 * Gaussian window of 11 x 11 with sigma 1.5, K1 = 0.01, K2 = 0.03, L = 255, over all positions where the window lies
 * inside, without downsampling, on the luma 0.299 R + 0.587 G + 0.114 B of the stored values; alpha plays no part.
 * Memory: 55 doubles a column. */
svo_result svo_compare_images(const svo_image *a, const svo_image *b, const svo_allocator *allocator, svo_compare_image *out,
                              svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
