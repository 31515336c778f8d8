/* The dictionary of bricks of layout 3, and the codes of their numbers. */
#include <stdlib.h>

#include "svoi_best_encoder.h"
#include "svoi_compare.h"

/* The dictionary: class after class, most used first. */
bool svoi_best_make_dictionary(svoi_best_encoder *e)
{
    const svoi_symlevel *bricks = &e->d->level[e->d->brick_level];
    uint64_t *key = svo_alloc(e->a, bricks->count + 1, sizeof *key), n = 0;
    if (key == NULL) return false;
    memset(e->class_count, 0, sizeof e->class_count);
    for (uint32_t i = 0; i < bricks->count; i++) {
        if (e->class_of[i] == e->classes - 1) continue;
        key[n++] = (uint64_t)(UINT32_MAX - bricks->uses[i]) << 32 | i;
        e->class_count[e->class_of[i]]++;
    }
    qsort(key, (size_t)n, sizeof *key, svoi_compare_u64);
    uint32_t next[SVOI_CLASSES] = {0}, first = 0;
    for (uint32_t c = 0; c < e->classes; c++) {
        e->class_first[c] = first;
        if (c + 1 < e->classes) first += e->class_count[c];
    }
    for (uint64_t i = 0; i < n; i++) {
        uint32_t brick = (uint32_t)key[i], c = e->class_of[brick];
        e->id[brick] = next[c]++;
        e->dictionary[e->class_first[c] + e->id[brick]] = brick;
    }
    e->dictionary_count = n;
    svo_free(e->a, key, bricks->count + 1, sizeof *key);
    return true;
}

static int compare_u8(const void *a, const void *b) { return *(const uint8_t *)a - *(const uint8_t *)b; }

/* Lengths ascend with the number, so that the file holds only how many there are of each. */
bool svoi_best_make_id_codes(svoi_best_encoder *e)
{
    const svoi_symlevel *bricks = &e->d->level[e->d->brick_level];
    uint64_t *weight = svo_alloc(e->a, e->dictionary_count + 1, sizeof *weight);
    bool ok = weight != NULL;
    for (uint64_t i = 0; i < e->dictionary_count && ok; i++) weight[i] = bricks->uses[e->dictionary[i]];
    for (uint32_t c = 1; c + 1 < e->classes && ok; c++) {
        uint32_t first = e->class_first[c], n = e->class_count[c];
        if (n == 0) continue;
        ok = svoi_huffman_lengths(e->a, weight + first, n, SVOI_ID_LONGEST, e->id_length + first);
        if (!ok) break;
        qsort(e->id_length + first, n, 1, compare_u8);
        svoi_huffman_codes(e->id_length + first, n, e->id_code + first);
    }
    svo_free(e->a, weight, e->dictionary_count + 1, sizeof *weight);
    return ok;
}
