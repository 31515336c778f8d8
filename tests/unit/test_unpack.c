/* A packed octree read as a stream gives the voxels and values that it was built from. */
#include <string.h>

#include "svo_dag.h"
#include "svo_unpack.h"
#include "test.h"
#include "trees.h"

static void check_round_trip(const tree *t, bool lod)
{
    svo_error err = {0};
    svo_dag_options options = svo_default_dag_options();
    options.lod = lod;
    svo_dag_builder *builder;
    svo_packed *packed;
    CHECK_OK(svo_dag_builder_create(&t->info, &options, &builder, &err));
    CHECK_OK(tree_feed(t, 1, svo_dag_builder_sink(builder), &err));
    CHECK_OK(svo_dag_builder_finish(builder, &packed, NULL, &err));
    svo_unpack u;
    svo_unpack_begin(&u, svo_packed_view(packed));
    svo_tree_info info = svo_unpack_info(svo_packed_view(packed));
    /* The builder stores a channel once that has turned out constant: make the tree say so too. */
    tree same = *t;
    for (uint32_t c = 0; c < info.channel_count; c++) {
        uint32_t stride = svo_channel_stride(info.channels[c].kind);
        if (!info.channels[c].constant || t->info.channels[c].constant) continue;
        for (uint64_t i = 0; i < t->count; i++) CHECK(memcmp(t->values[c] + i * stride, info.channels[c].value, stride) == 0);
        same.info.channels[c] = info.channels[c];
    }
    tree_check(&same, &info, svo_unpack_source(&u));
    svo_packed_free(packed);
}

TEST(packed_octrees_as_streams)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 6, 7, 8, 9, 12, 21};
    uint64_t seed = 4;
    for (size_t d = 0; d < sizeof depths / sizeof *depths; d++) {
        for (uint32_t style = 0; style < TREE_STYLES; style++) {
            for (int lod = 0; lod < 2; lod++) {
                tree t;
                tree_random(&t, depths[d], style, &seed);
                check_round_trip(&t, lod);
                tree_free(&t);
                CHECK_MSG(!test_failed(), "depth %u, style %u, lod %d", depths[d], style, lod);
            }
        }
    }
}

TEST(full_and_empty_octrees_as_streams)
{
    uint64_t seed = 6;
    for (uint32_t depth = 0; depth <= 5; depth++) {
        tree t;
        tree_full(&t, depth, &seed);
        check_round_trip(&t, depth % 2);
        t.count = 0;
        check_round_trip(&t, depth % 2);
        tree_free(&t);
        CHECK_MSG(!test_failed(), "depth %u", depth);
    }
}
