/* .skel: read, its rules checked again, its parts counted, written again. */
#include "../fuzz.h"
#include "fmt_skel.h"
#include "rules_agree.h"

static void use(const skel_skeleton *s, const svo_allocator *a)
{
    svo_error err;
    if (skel_check(s, &err) != SVO_OK) fuzz_fail("accepted, but skel_check says: %s", err.message);
    for (uint64_t i = 0; i < s->map_count; i++)
        if (s->map[i] != SVO_NONE && s->map[i] >= s->joint_count) fuzz_fail("map[%llu]", (unsigned long long)i);
    skel_component *c = svo_alloc(a, s->report.components, sizeof *c);
    if (c != NULL) skel_components(s, c);
    svo_free(a, c, s->report.components, sizeof *c);
    svo_buffer copy;
    fmt_output *out;
    svo_buffer_init(&copy, a);
    if (fmt_output_open_memory(&copy, &out, &err) != SVO_OK || fmt_skel_write(out, s, NULL, &err) != SVO_OK || fmt_output_commit(out, &err) != SVO_OK)
        fuzz_fail("accepted, but cannot be written: %s", err.message);
    svo_buffer_free(&copy);
}

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    skel_skeleton s;
    char *meta;
    svo_result r = fmt_skel_read(bytes, size, a, &s, &meta, err);
    const char *differ = rules_agree(fmt_skel_violations, bytes, size, a, r, err, true);
    if (differ != NULL) fuzz_fail("%s", differ);
    if (r != SVO_OK) return r;
    use(&s, a);
    fmt_meta_free(a, meta);
    skel_skeleton_free(&s);
    return SVO_OK;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20};
