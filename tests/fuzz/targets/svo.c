/* .svo as tools read it, a stream: every chunk decoded and every value looked at. */
#include "../fuzz.h"
#include "fmt_svo.h"
#include "rules_agree.h"

typedef struct walk { uint32_t depth; uint64_t voxels, values; } walk;

static bool visit(void *user, const uint32_t low[3], uint32_t size, uint64_t index)
{
    walk *w = user;
    if ((low[0] | low[1] | low[2]) >> w->depth != 0 || (low[0] | low[1] | low[2]) % size != 0) fuzz_fail("value %llu lies outside of the grid", (unsigned long long)index);
    w->voxels += (uint64_t)size * size * size;
    w->values++;
    return true;
}

static svo_result use(const svo_tree_info *info, svo_chunk_source s, const svo_buffer *packed, svo_buffer *storage, walk *w, svo_error *err)
{
    svo_chunk chunk;
    SVO_TRY(s.decode(s.user, packed, storage, &chunk, err));
    uint64_t before = w->values;
    svo_chunk_values(&chunk, visit, w);
    if (w->values - before != chunk.value_count) fuzz_fail("a chunk with a wrong count of values is accepted");
    volatile uint64_t sum = 0; /* a sanitizer sees every byte */
    for (uint32_t i = 0; i < info->channel_count; i++)
        for (uint64_t k = 0; chunk.channels[i] != NULL && k < chunk.value_count * svo_channel_stride(info->channels[i].kind); k++) sum += chunk.channels[i][k];
    (void)sum;
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
    walk w = {.voxels = 0};
    if (result == SVO_OK) w.depth = fmt_svo_reader_info(r)->depth;
    for (bool more = true; result == SVO_OK && more;) {
        svo_chunk_source s = fmt_svo_reader_source(r);
        result = s.fetch(s.user, &packed, &more, err);
        if (result == SVO_OK && more) result = use(fmt_svo_reader_info(r), s, &packed, &storage, &w, err);
    }
    if (result == SVO_OK && fmt_svo_reader_counts(r)->nodes[w.depth] != w.voxels) fuzz_fail("a wrong count of voxels is accepted");
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    if (r != NULL) fmt_svo_reader_close(r);
    fmt_input_close(in);
    const char *fault = rules_agree(fmt_svo_violations, bytes, size, a, result, err, true);
    if (fault != NULL) fuzz_fail("the list of all violations: %s", fault);
    return result;
}

const fuzz_target fuzz_this = {.read = read, .memory = 256 << 20};
