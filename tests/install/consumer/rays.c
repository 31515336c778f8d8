/* libsvo alone: a packed octree of one voxel, made in memory, and a ray against it. Prints the distance. */
#include <stdio.h>

#include <svo_dag.h>
#include <svo_raycast.h>

int main(void)
{
    svo_tree_info info = {.depth = 2, .voxel_to_world = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
    const uint8_t masks[2] = {1 << 0, 1 << 1}; /* octant 0 of the root, and in it octant 1: the voxel (1, 0, 0) */
    svo_chunk chunk = {.depth = 2, .node_count = 2, .value_count = 1, .masks = masks};
    svo_dag_builder *builder;
    svo_packed *packed;
    svo_error err;
    svo_result r = svo_dag_builder_create(&info, NULL, &builder, &err);
    if (r == SVO_OK) {
        svo_chunk_sink sink = svo_dag_builder_sink(builder);
        void *blob;
        r = sink.encode(sink.user, &chunk, 0, &blob, &err);
        if (r == SVO_OK) r = sink.commit(sink.user, blob, &err);
        if (r != SVO_OK) svo_dag_builder_free(builder);
        else r = svo_dag_builder_finish(builder, &packed, NULL, &err);
    }
    if (r != SVO_OK) {
        fprintf(stderr, "%s\n", err.message);
        return svo_result_exit_code(r);
    }
    svo_ray ray = {.origin = {-1, 0.5, 0.5}, .direction = {1, 0, 0}, .t_max = 1e9};
    svo_hit hit;
    svo_raycast(svo_packed_view(packed), &ray, 1, &hit);
    printf("%g\n", hit.hit ? hit.t : -1.0);
    svo_packed_free(packed);
    return 0;
}
