/* NRRD files, with data in them, compressed, or beside them (where there are none); and the chunks that are made of them. */
#include <string.h>

#include "../fuzz.h"
#include "fmt_volume.h"

typedef struct sink_state {
    const svo_tree_info *info;
    svo_tree_counts counts;
} sink_state;

static svo_result encode(void *user, const svo_chunk *chunk, uint32_t worker, void **blob, svo_error *err)
{
    sink_state *s = user;
    (void)worker;
    *blob = s;
    if (svo_chunk_check(s->info, chunk, &s->counts, err) != SVO_OK) fuzz_fail("a chunk that is not sound: %s", err != NULL ? err->message : "");
    return SVO_OK;
}

static svo_result commit(void *user, void *blob, svo_error *err)
{
    (void)user, (void)blob, (void)err;
    return SVO_OK;
}

static void discard(void *user, void *blob) { (void)user, (void)blob; }

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    static const double half = 0.5;
    if (!fmt_is_nrrd(bytes, size)) return svo_fail(err, SVO_INVALID_DATA, "no NRRD");
    const fmt_volume_options o = {.threshold = size % 2 == 0 ? &half : NULL, .threads = 1, .allocator = a};
    fmt_volume *v;
    SVO_TRY(fmt_volume_open("/nowhere/x.nrrd", bytes, size, &o, &v, err));
    const fmt_volume_facts *f = fmt_volume_about(v);
    svo_tree_info info = {.channel_count = 1, .channels = {{.name = "intensity", .kind = SVO_KIND_UNORM8}}};
    if (f->colored) info.channels[0] = (svo_channel){.name = "color", .kind = SVO_KIND_COLOR_SRGB8};
    while (((uint32_t)1 << info.depth) < f->side) info.depth++;
    for (int k = 0; k < 16; k++)
        if (!(f->to_world[k] - f->to_world[k] == 0)) fuzz_fail("a transform that is not finite");
    sink_state state = {.info = &info};
    const svo_chunk_sink sink = {&state, encode, commit, discard};
    svo_result r = fmt_volume_emit(v, &info, &sink, err);
    if (r == SVO_OK && state.counts.values != f->voxels) fuzz_fail("%llu voxels became %llu", (unsigned long long)f->voxels, (unsigned long long)state.counts.values);
    fmt_volume_close(v);
    return r;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20, .opens_files = true};
