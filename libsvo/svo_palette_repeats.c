/* Superblocks of one value that the superblock before ends with: channels that are constant over large parts (metallic, emissive, coverage,
 * labels) are mostly such superblocks, and their entries and headers most of what they take. */
#include <string.h>

#include "svoi_palette.h"

static bool repeats(const svo_palette *p, uint64_t s)
{
    uint64_t map;
    uint16_t header;
    const uint8_t *entry = p->directory + s * SVO_PALETTE_ENTRY;
    uint32_t offset;
    uint64_t base;
    memcpy(&map, entry, sizeof map);
    if (s == 0 || map != 1) return false;
    memcpy(&offset, entry + 8, sizeof offset);
    memcpy(&base, p->payload + s / SVO_PALETTE_GROUP * 8, sizeof base);
    memcpy(&header, p->payload + base + offset, sizeof header);
    return (header & 31) <= SVO_BLOCK_ONE_WIDE && svo_palette_value(p, s * SVO_SUPERBLOCK) == svo_palette_value(p, s * SVO_SUPERBLOCK - 1);
}

svo_result svoi_palette_skip_repeats(const svo_palette *p, svo_buffer *directory, svo_buffer *payload, uint64_t *words, svo_error *err)
{
    const uint64_t all = p->superblock_count, records = svo_palette_repeat_words(p->count);
    const svo_allocator *a = directory->allocator;
    uint64_t skipped = 0, kept = 0, base, new_base = 0;
    *words = 0;
    uint64_t *bits = svo_calloc(a, records, sizeof *bits);
    if (bits == NULL && records != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    for (uint64_t s = 0; s < all; s++) {
        const bool repeat = repeats(p, s);
        skipped += repeat;
        bits[s / 64] |= (uint64_t)!repeat << s % 64;
    }
    if (skipped * (SVO_PALETTE_ENTRY + 2) <= records * SVO_PALETTE_ENTRY) {
        svo_free(a, bits, records, sizeof *bits);
        return SVO_OK;
    }
    const uint64_t groups = (all + SVO_PALETTE_GROUP - 1) / SVO_PALETTE_GROUP;
    uint64_t *bases = svo_alloc(a, groups, sizeof *bases); /* of superblocks as they were: fewer groups leave less room in front */
    svo_buffer out;
    svo_buffer_init(&out, a);
    uint8_t *record = svo_buffer_append(&out, NULL, (size_t)(records + all - skipped) * SVO_PALETTE_ENTRY);
    if (record == NULL || bases == NULL) {
        svo_buffer_free(&out);
        svo_free(a, bases, groups, sizeof *bases);
        svo_free(a, bits, records, sizeof *bits);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory (palettes)");
    }
    memcpy(bases, payload->data, (size_t)groups * sizeof *bases);
    /* From the front: nothing is moved to where something that is still needed lies. */
    const uint64_t end = payload->size - SVO_PALETTE_PADDING;
    uint64_t to = 8 * ((all - skipped + SVO_PALETTE_GROUP - 1) / SVO_PALETTE_GROUP);
    uint8_t *entry = record + records * SVO_PALETTE_ENTRY;
    for (uint64_t s = 0; s < all; s++) {
        const uint8_t *from = directory->data + s * SVO_PALETTE_ENTRY;
        uint64_t next = end, at;
        uint32_t offset;
        base = bases[s / SVO_PALETTE_GROUP];
        memcpy(&offset, from + 8, sizeof offset);
        at = base + offset;
        if (s % 64 == 0) {
            const uint32_t before = (uint32_t)kept;
            memcpy(record + s / 64 * SVO_PALETTE_ENTRY, &bits[s / 64], sizeof bits[0]);
            memcpy(record + s / 64 * SVO_PALETTE_ENTRY + 8, &before, sizeof before);
        }
        if (!(bits[s / 64] >> s % 64 & 1)) continue;
        if (s + 1 < all) {
            memcpy(&offset, from + SVO_PALETTE_ENTRY + 8, sizeof offset);
            next = bases[(s + 1) / SVO_PALETTE_GROUP] + offset;
        }
        if (kept % SVO_PALETTE_GROUP == 0) {
            new_base = to;
            memcpy(payload->data + kept / SVO_PALETTE_GROUP * 8, &new_base, sizeof new_base);
        }
        memmove(payload->data + to, payload->data + at, (size_t)(next - at));
        offset = (uint32_t)(to - new_base);
        memcpy(entry, from, 8);
        memcpy(entry + 8, &offset, sizeof offset);
        entry += SVO_PALETTE_ENTRY;
        to += next - at;
        kept++;
    }
    memset(payload->data + to, 0, SVO_PALETTE_PADDING);
    payload->size = (size_t)to + SVO_PALETTE_PADDING;
    svo_free(a, bases, groups, sizeof *bases);
    svo_free(a, bits, records, sizeof *bits);
    svo_buffer_free(directory);
    *directory = out;
    *words = records;
    return SVO_OK;
}
