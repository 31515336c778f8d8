/* Assets that are equal after packing, byte for byte, are stored once. */
#include <stdlib.h>
#include <string.h>

#include "svo_algorithm1.h"
#include "svoi_packer.h"

#define COMPARE(x, y) if ((x) != (y)) return (x) < (y) ? -1 : 1
static int compare_bytes(const void *a, const void *b, uint64_t size) { return size == 0 || a == b ? 0 : memcmp(a, b, (size_t)size); }

static int compare_channels(const svo_view *v, const svo_view_channel *a, const svo_view_channel *b)
{
    int c;
    if ((c = memcmp(a->channel.name, b->channel.name, sizeof a->channel.name)) != 0) return c;
    COMPARE(a->channel.kind, b->channel.kind);
    COMPARE(a->channel.constant, b->channel.constant);
    if ((c = memcmp(a->channel.value, b->channel.value, sizeof a->channel.value)) != 0) return c;
    COMPARE(a->encoding, b->encoding);
    uint64_t stride = svo_channel_stride(a->channel.kind);
    COMPARE(a->correction_count, b->correction_count);
    if ((c = compare_bytes(a->corrections, b->corrections, a->correction_count * SVO_CORRECTION)) != 0) return c;
    if (a->encoding == SVO_ENCODING_RAW) return compare_bytes(a->raw, b->raw, v->attribute_count * stride);
    if (a->encoding != SVO_ENCODING_BLOCKS && a->encoding != SVO_ENCODING_LONG_BLOCKS) return 0;
    uint64_t entry = a->encoding == SVO_ENCODING_BLOCKS ? SVO_PALETTE_ENTRY : SVO_ALGORITHM1_ENTRY;
    COMPARE(a->table_count, b->table_count);
    COMPARE(a->superblock_count, b->superblock_count);
    COMPARE(a->payload_size, b->payload_size);
    COMPARE(a->repeats != NULL, b->repeats != NULL);
    if (a->repeats != NULL && (c = compare_bytes(a->repeats, b->repeats, svo_palette_repeat_words(v->attribute_count) * SVO_PALETTE_ENTRY)) != 0) return c;
    if ((c = compare_bytes(a->table, b->table, a->table_count * stride)) != 0) return c;
    if ((c = compare_bytes(a->directory, b->directory, a->superblock_count * entry)) != 0) return c;
    return compare_bytes(a->payload, b->payload, a->payload_size);
}

/* A total order of everything that a file stores, cheap fields first. */
static int compare_views(const svo_view *a, const svo_view *b)
{
    int c;
    COMPARE(a->depth, b->depth);
    COMPARE(a->attribute_count, b->attribute_count);
    COMPARE(a->channel_count, b->channel_count);
    COMPARE(a->lod, b->lod);
    COMPARE(a->averaged, b->averaged);
    COMPARE(a->surface, b->surface);
    COMPARE(a->fill, b->fill);
    if ((c = memcmp(a->nodes, b->nodes, sizeof a->nodes)) != 0) return c;
    for (int i = 0; i < 16; i++) COMPARE(a->voxel_to_world[i], b->voxel_to_world[i]);
    if ((c = svo_view_compare_geometry(a, b)) != 0) return c;
    for (uint32_t i = 0; i < a->channel_count; i++)
        if ((c = compare_channels(a, &a->channels[i], &b->channels[i])) != 0) return c;
    return 0;
}

static int compare_sources(const void *a, const void *b)
{
    const svoi_pack_source *x = *(const svoi_pack_source *const *)a, *y = *(const svoi_pack_source *const *)b;
    int c = compare_views(&x->view, &y->view);
    if (c != 0) return c;
    return x < y ? -1 : x > y; /* the same array: input order */
}

svo_result svoi_pack_merge_assets(svoi_packer *p, svo_error *err)
{
    svo_packed_scene *o = p->out;
    uint32_t count = p->in->asset_count, used = 0;
    const svoi_pack_source **sorted = svo_alloc(p->allocator, count, sizeof *sorted);
    if (sorted == NULL && count != 0) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to compare %u assets", count);
    for (uint32_t a = 0; a < count; a++)
        if (o->report.assets[a].fate == SVO_PACK_KEPT) sorted[used++] = &o->sources[a];
    if (used > 1) qsort(sorted, used, sizeof *sorted, compare_sources);
    for (uint32_t i = 1, first = 0; i < used; i++) {
        if (compare_views(&sorted[first]->view, &sorted[i]->view) != 0) first = i;
        else {
            svo_pack_asset *asset = &o->report.assets[sorted[i] - o->sources];
            asset->fate = SVO_PACK_EQUAL;
            asset->packed = (uint32_t)(sorted[first] - o->sources); /* for the moment: its number in the input */
        }
    }
    svo_free(p->allocator, sorted, count, sizeof *sorted);
    for (uint32_t a = 0; a < count; a++)
        if (o->report.assets[a].fate == SVO_PACK_KEPT) {
            o->report.assets[a].packed = o->scene.asset_count;
            o->views[o->scene.asset_count] = &o->sources[a].view;
            o->asset_names[o->scene.asset_count++] = p->in->asset_names[a];
        }
    for (uint32_t a = 0; a < count; a++)
        if (o->report.assets[a].fate == SVO_PACK_EQUAL)
            o->report.assets[a].packed = o->report.assets[o->report.assets[a].packed].packed;
    return SVO_OK;
}
