/* A packed octree (svo_view) read as a stream of chunks, as svo_stream.h defines them: for everything that takes .svo and
 * .svdag alike. Memory is that of one chunk. A small packed file can describe up to 8^21 voxels: look at
 * view->nodes[view->depth] before reading them all. */
#ifndef SVO_UNPACK_H
#define SVO_UNPACK_H

#include "svo_stream.h"
#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a stream of this view says before its first chunk. */
svo_tree_info svo_unpack_info(const svo_view *view);

/* State of one pass over a view; the view must outlive it and must have passed svo_view_validate. fetch moves on,
 * decode does not change it and may run in several threads. No memory of its own: nothing to close. */
typedef struct svo_unpack {
    const svo_view *view;
    uint32_t level;         /* of the node whose children come next */
    bool started;
    uint64_t code;          /* of that node */
    svo_view_node node[SVO_MAX_DEPTH + 1];
    uint8_t left[SVO_MAX_DEPTH + 1]; /* children not yet visited, a level */
} svo_unpack;
void svo_unpack_begin(svo_unpack *u, const svo_view *view);
/* u must outlive the source. */
svo_chunk_source svo_unpack_source(svo_unpack *u);

#ifdef __cplusplus
}
#endif
#endif
