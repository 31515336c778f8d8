/* Everything that is wrong with a .svo. */
#include "fmti_svo.h"
#include "svo_rules.h"

static svo_result every_subtree(fmt_svo_reader *r, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    svo_buffer packed, storage;
    svo_chunk chunk;
    svo_chunk_source s = fmt_svo_reader_source(r);
    svo_result result = SVO_OK;
    svo_buffer_init(&packed, a);
    svo_buffer_init(&storage, a);
    fmti_svo_reader_rules(r, rules);
    for (bool more = true; result == SVO_OK && more;) {
        result = s.fetch(s.user, &packed, &more, err);
        if (result != SVO_OK || !more) break;
        result = s.decode(s.user, &packed, &storage, &chunk, err);
        if (result == SVO_OK) continue;
        fmti_svo_reader_left_out(r);
        result = svo_go_on(rules, result, err);
    }
    svo_buffer_free(&packed);
    svo_buffer_free(&storage);
    return result;
}

svo_result fmt_svo_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    svo_error here = {0};
    fmt_input *in;
    fmt_svo_reader *r = NULL;
    if (err == NULL) err = &here;
    SVO_TRY(fmt_input_open_memory(data, size, &in, err));
    svo_result result = fmt_svo_reader_open(in, a, &r, err);
    if (result == SVO_OK) result = every_subtree(r, a, rules, err);
    if (r != NULL) fmt_svo_reader_close(r);
    fmt_input_close(in);
    return svo_go_on(rules, result, err);
}
