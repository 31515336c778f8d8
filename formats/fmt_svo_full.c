/* FULL chunks of .svo: full leaves that cover chunks, as records in runs between TREE chunks. */
#include "fmti_svo.h"

static uint64_t record_place(const fmti_full *f, uint64_t i) { return fmt_load64(f->records.data + i * f->stride); }

uint64_t fmti_place(uint32_t level, uint64_t code) { return (uint64_t)1 << 3 * level | code; }

bool fmti_parse_place(uint64_t place, uint32_t chunk_level, uint32_t *level, uint64_t *code)
{
    uint32_t top = place != 0 ? 63 - (uint32_t)__builtin_clzll(place) : 1;
    if (top % 3 != 0 || top == 0 || top / 3 > chunk_level) return false;
    *level = top / 3;
    *code = place ^ (uint64_t)1 << top;
    return true;
}

void fmti_count_full(svo_tree_counts *counts, uint32_t level, uint32_t end)
{
    for (uint32_t l = level; l < end; l++) counts->nodes[l] += (uint64_t)1 << 3 * (l - level);
}

void fmti_full_init(fmti_full *f, const svo_tree_info *info, const svo_allocator *a)
{
    *f = (fmti_full){.chunk_level = svo_chunk_level(info->depth), .stride = 8 + fmti_voxel_bytes(info)};
    svo_buffer_init(&f->records, a);
}

void fmti_full_free(fmti_full *f) { svo_buffer_free(&f->records); }

svo_result fmti_full_flush(fmti_full *f, fmt_writer *w, svo_error *err)
{
    if (f->records.size == 0) return SVO_OK;
    uint32_t level = 0;
    uint64_t code = 0, size = f->records.size;
    bool good = fmti_parse_place(record_place(f, 0), f->chunk_level, &level, &code);
    SVO_ASSERT(good);
    (void)good;
    fmt_chunk c = {.type = FMTI_SVO_FULL, .flags = FMT_CHUNK_CRITICAL, .stored_size = size, .decoded_size = size, .element_count = size / f->stride,
                   .element_stride = f->stride, .id = code << 3 * (f->chunk_level - level)};
    f->records.size = 0;
    return fmt_writer_chunk(w, &c, f->records.data, err);
}

svo_result fmti_full_add(fmti_full *f, fmt_writer *w, const uint8_t *record, svo_error *err)
{
    if (f->records.size == (size_t)f->stride * FMTI_FULL_MOST) SVO_TRY(fmti_full_flush(f, w, err));
    if (svo_buffer_append(&f->records, record, f->stride) == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for a full leaf");
    return SVO_OK;
}
