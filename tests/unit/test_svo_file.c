/* .svo files: what goes in comes out, through files and pipes, with the same bytes for any number of threads. */
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmt_svo.h"
#include "svo_morton.h"
#include "svo_task.h"
#include "test.h"
#include "trees.h"

static svo_error err;

/* One tree through a file in memory, chunk for chunk. */
static void round_trip(const tree *t, uint32_t threads)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    svo_tree_counts written = {0};
    tree_write(t, threads, &file, &written);
    if (test_failed()) return;
    fmt_input *in;
    fmt_svo_reader *r;
    CHECK_OK(fmt_input_open_memory(file.data, file.size, &in, &err));
    CHECK_OK(fmt_svo_reader_open(in, NULL, &r, &err));
    tree_check(t, fmt_svo_reader_info(r), fmt_svo_reader_source(r));
    if (test_failed()) return;
    const svo_tree_counts *read = fmt_svo_reader_counts(r);
    CHECK(memcmp(read, &written, sizeof written) == 0);
    CHECK_U64(read->nodes[t->info.depth], t->count);
    CHECK(strcmp(fmt_svo_reader_provenance(r), "{\"tool\":\"test\"}") == 0);
    fmt_svo_reader_close(r);
    fmt_input_close(in);
    svo_buffer_free(&file);
}

TEST(random_trees_come_back)
{
    static const uint32_t depths[] = {0, 1, 2, 3, 6, 7, 8, 9, 12, 20, 21};
    uint64_t seed = 11;
    for (size_t d = 0; d < sizeof depths / sizeof depths[0]; d++)
        for (uint32_t style = 0; style < TREE_STYLES; style++) {
            tree t;
            tree_random(&t, depths[d], style, &seed);
            round_trip(&t, 2);
            tree_free(&t);
            if (test_failed()) return;
        }
}

TEST(an_empty_tree_comes_back)
{
    uint64_t seed = 1;
    for (uint32_t depth = 0; depth <= 21; depth += 7) {
        tree t;
        tree_random(&t, depth, 0, &seed);
        t.count = 0;
        round_trip(&t, 1);
        tree_free(&t);
        if (test_failed()) return;
    }
}

TEST(a_full_block_comes_back)
{
    tree t;
    uint64_t seed = 3;
    tree_full(&t, 7, &seed);
    round_trip(&t, 2);
    tree_free(&t);
}

TEST(the_bytes_do_not_depend_on_threads)
{
    uint64_t seed = 5;
    tree t;
    tree_random(&t, 10, 1, &seed);
    svo_buffer one, other;
    svo_buffer_init(&one, NULL);
    svo_buffer_init(&other, NULL);
    tree_write(&t, 1, &one, NULL);
    for (uint32_t threads = 2; threads <= 7; threads += 5) {
        tree_write(&t, threads, &other, NULL);
        CHECK_U64(one.size, other.size);
        CHECK(memcmp(one.data, other.data, one.size) == 0);
    }
    svo_buffer_free(&one);
    svo_buffer_free(&other);
    tree_free(&t);
}
