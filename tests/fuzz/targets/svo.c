/* .svo as tools read it, a stream: every chunk decoded and every voxel and value looked at. */
#include "../fuzz.h"
#include "fmt_svo.h"

static bool visit(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    uint32_t depth = *(const uint32_t *)user;
    if ((x | y | z) >> depth != 0) fuzz_fail("voxel %llu lies outside of the grid", (unsigned long long)index);
    return true;
}

static svo_result use(const svo_tree_info *info, svo_chunk_source s, const svo_buffer *packed, svo_buffer *storage, uint64_t *voxels, svo_error *err)
{
    svo_chunk chunk;
    SVO_TRY(s.decode(s.user, packed, storage, &chunk, err));
    uint32_t depth = info->depth;
    svo_chunk_voxels(&chunk, visit, &depth);
    volatile uint64_t sum = 0; /* a sanitizer sees every byte */
    for (uint32_t i = 0; i < info->channel_count; i++)
        for (uint64_t k = 0; chunk.channels[i] != NULL && k < chunk.voxel_count * svo_channel_stride(info->channels[i].kind); k++) sum += chunk.channels[i][k];
    (void)sum;
    *voxels += chunk.voxel_count;
    return SVO_OK;
}

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_input *in;
    fmt_svo_reader *r = NULL;
    SVO_TRY(fmt_input_open_memory(bytes, size, &in, err));
    svo_result result = fmt_svo_reader_open(in, a, &r, err);
    svo_buffer packed, storage;
    svo_buffer_init(&packed, a);
    svo_buffer_init(&storage, a);
    uint64_t voxels = 0;
    for (bool more = true; result == SVO_OK && more;) {
        svo_chunk_source s = fmt_svo_reader_source(r);
        result = s.fetch(s.user, &packed, &more, err);
        if (result == SVO_OK && more) result = use(fmt_svo_reader_info(r), s, &packed, &storage, &voxels, err);
    }
    if (result == SVO_OK && fmt_svo_reader_counts(r)->nodes[fmt_svo_reader_info(r)->depth] != voxels) fuzz_fail("a wrong count of voxels is accepted");
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    if (r != NULL) fmt_svo_reader_close(r);
    fmt_input_close(in);
    return result;
}

const fuzz_target fuzz_this = {.read = read, .memory = 256 << 20};
