/* Poses of a packed scene, each once. */
#ifndef SVOI_PACK_H
#define SVOI_PACK_H

#include "svo_alloc.h"
#include "svo_deform.h"

typedef struct svoi_pose_table {
    const svo_allocator *allocator;
    svo_buffer poses, matrices; /* svo_pose; 12 floats each */
    /* open addressing, numbers + 1: of poses, and of runs of matrices by their first one (with its length in run_length) */
    uint32_t *pose_slot, *run_slot;
    uint64_t pose_slots, run_slots, runs;
    svo_buffer run_length; /* u32 for each matrix: length of the run that begins there, 0 for others */
    uint64_t rest, shared, bones_rest, matrices_shared;
} svoi_pose_table;

void svoi_pose_table_init(svoi_pose_table *t, const svo_allocator *a);
void svoi_pose_table_free(svoi_pose_table *t);
svo_poses svoi_pose_table_get(const svoi_pose_table *t);

/* Resolve pose `number` of `from` for a shape with these bounds, move it to coordinates that are smaller by `shift`, and add it unless it is there; *out is
 * SVO_NO_POSE where it moves nothing. SVO_INVALID_DATA for a pose with a fault. */
svo_result svoi_pose_table_add(svoi_pose_table *t, const svo_poses *from, uint32_t number, const double low[3], const double high[3], const double shift[3],
                               uint32_t *out, svo_error *err);

#endif
