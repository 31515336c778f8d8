/* Attribute values that wait outside of memory: the packed file is the same, every failure of the files is told. */
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_svdag.h"
#include "svo_dag.h"
#include "svo_quantize.h"
#include "svo_unpack.h"
#include "test.h"
#include "trees.h"

static svo_error err;

/* Files in memory that fail at the n-th call. */
typedef struct store {
    svo_spill spill;
    pthread_mutex_t lock;
    int64_t left; /* calls until one fails; < 0: none does */
    uint64_t writes, reads, open;
} store;
typedef struct file { uint8_t *bytes; uint64_t size; } file;

static svo_result call(store *s, svo_error *e)
{
    if (s->left >= 0 && s->left-- == 0) return svo_fail(e, SVO_IO, "the disk is full");
    return SVO_OK;
}

static svo_result create(void *user, void **out, svo_error *e)
{
    store *s = user;
    pthread_mutex_lock(&s->lock);
    svo_result r = call(s, e);
    if (r == SVO_OK) {
        *out = calloc(1, sizeof(file));
        s->open++;
    }
    pthread_mutex_unlock(&s->lock);
    return r;
}

static svo_result write_bytes(void *user, void *f, uint64_t offset, const void *bytes, uint64_t size, svo_error *e)
{
    store *s = user;
    file *to = f;
    pthread_mutex_lock(&s->lock);
    svo_result r = call(s, e);
    if (r == SVO_OK) {
        if (offset + size > to->size) {
            to->bytes = realloc(to->bytes, offset + size);
            to->size = offset + size;
        }
        memcpy(to->bytes + offset, bytes, size);
        s->writes++;
    }
    pthread_mutex_unlock(&s->lock);
    return r;
}

static svo_result read_bytes(void *user, void *f, uint64_t offset, void *bytes, uint64_t size, svo_error *e)
{
    store *s = user;
    const file *from = f;
    pthread_mutex_lock(&s->lock);
    svo_result r = call(s, e);
    if (r == SVO_OK && offset + size > from->size) r = svo_fail(e, SVO_RUNTIME, "a range that was not written");
    if (r == SVO_OK) memcpy(bytes, from->bytes + offset, size);
    s->reads++;
    pthread_mutex_unlock(&s->lock);
    return r;
}

static void close_file(void *user, void *f)
{
    store *s = user;
    pthread_mutex_lock(&s->lock);
    s->open--;
    pthread_mutex_unlock(&s->lock);
    free(((file *)f)->bytes);
    free(f);
}

static void store_init(store *s)
{
    *s = (store){.left = -1, .lock = PTHREAD_MUTEX_INITIALIZER};
    s->spill = (svo_spill){.user = s, .create = create, .write = write_bytes, .read = read_bytes, .close = close_file};
}

static svo_result pack(const tree *t, const svo_dag_options *o, svo_packed **out)
{
    svo_dag_builder *b;
    SVO_TRY(svo_dag_builder_create(&t->info, o, &b, &err));
    svo_result r = tree_feed(t, o->threads, svo_dag_builder_sink(b), &err);
    if (r != SVO_OK) {
        svo_dag_builder_free(b);
        return r;
    }
    return svo_dag_builder_finish(b, out, NULL, &err);
}

static void serialize(const svo_packed *p, svo_buffer *bytes)
{
    fmt_output *out;
    svo_buffer_init(bytes, NULL);
    CHECK_OK(fmt_output_open_memory(bytes, &out, &err));
    CHECK_OK(fmt_svdag_write(out, svo_packed_view(p), NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
}

/* With and without files, threads, the failing call. */
static void same_bytes(const tree *t, svo_dag_options o, uint64_t failures)
{
    svo_packed *p = NULL;
    svo_buffer plain, spilled;
    o.threads = 1;
    CHECK_OK(pack(t, &o, &p));
    serialize(p, &plain);
    svo_packed_free(p);
    uint64_t calls = 0;
    for (uint32_t threads = 1; threads <= 3; threads += 2) {
        store s;
        store_init(&s);
        o.threads = threads;
        o.spill = &s.spill;
        o.value_memory = 1;
        CHECK_OK(pack(t, &o, &p));
        serialize(p, &spilled);
        svo_packed_free(p);
        CHECK(plain.size == spilled.size && memcmp(plain.data, spilled.data, plain.size) == 0);
        CHECK_U64(s.open, 0);
        calls = s.writes + s.reads;
        svo_buffer_free(&spilled);
    }
    svo_buffer_free(&plain);
    for (uint64_t n = 0; failures != 0 && n < calls; n += 1 + calls / failures) {
        store s;
        store_init(&s);
        s.left = (int64_t)n;
        o.spill = &s.spill;
        memset(&err, 0, sizeof err);
        CHECK(pack(t, &o, &p) == SVO_IO);
        CHECK(strcmp(err.message, "the disk is full") == 0);
        CHECK_U64(s.open, 0);
    }
}

TEST(random_trees_with_all_kinds_of_channels)
{
    static const uint32_t depths[] = {0, 2, 7, 9, 12};
    uint64_t seed = 3;
    for (size_t d = 0; d < sizeof depths / sizeof depths[0]; d++)
        for (uint32_t style = 0; style < TREE_STYLES; style++) {
            tree t;
            tree_random(&t, depths[d], style, &seed);
            svo_dag_options o = svo_default_dag_options();
            same_bytes(&t, o, 8);
            o.lod = false;
            o.color_bits = 4;
            o.normal_bits = 10;
            same_bytes(&t, o, 8);
            tree_free(&t);
            if (test_failed()) return;
        }
}

/* More values than a page, so that some go to files; more different ones than are listed. */
static void many_normals(tree *t, uint64_t *seed)
{
    tree_full(t, 6, seed);
    svo_channel *c = &t->info.channels[0];
    memset(c, 0, sizeof *c);
    strcpy(c->name, "normal");
    c->kind = SVO_KIND_NORMAL_OCT32;
    t->values[0] = realloc(t->values[0], t->count * 4);
    for (uint64_t i = 0; i < t->count; i++) {
        int16_t v[2];
        for (int k = 0; k < 2; k++) v[k] = (int16_t)((int32_t)(test_random(seed) % 65535) - 32767);
        memcpy(t->values[0] + 4 * i, v, 4);
    }
}

static void check_unpacked(const tree *t, const svo_packed *p)
{
    svo_unpack u;
    svo_unpack_begin(&u, svo_packed_view(p));
    svo_tree_info info = svo_unpack_info(svo_packed_view(p));
    tree_check(t, &info, svo_unpack_source(&u));
}

TEST(more_different_values_than_are_listed)
{
    tree t;
    uint64_t seed = 8;
    many_normals(&t, &seed);
    svo_dag_options o = svo_default_dag_options();
    svo_packed *p;
    same_bytes(&t, o, 0);
    CHECK_OK(pack(&t, &o, &p)); /* lossless */
    check_unpacked(&t, p);
    svo_packed_free(p);
    o.normal_degrees = 3;
    same_bytes(&t, o, 0);
    o.normal_degrees = 0;
    o.normal_bits = 14;
    same_bytes(&t, o, 1);
    CHECK_OK(pack(&t, &o, &p));
    for (uint64_t i = 0; i < t.count; i++) {
        uint32_t v;
        memcpy(&v, t.values[0] + 4 * i, 4);
        v = svo_quantize_normal(v, 14);
        memcpy(t.values[0] + 4 * i, &v, 4);
    }
    check_unpacked(&t, p);
    svo_packed_free(p);
    tree_free(&t);
}

TEST(values_move_out_when_the_limit_is_met)
{
    tree t;
    uint64_t seed = 8;
    many_normals(&t, &seed);
    svo_dag_options o = svo_default_dag_options();
    o.normal_bits = 8;
    o.threads = 1;
    svo_packed *p;
    CHECK_OK(pack(&t, &o, &p));
    svo_buffer plain, small;
    serialize(p, &plain);
    svo_packed_free(p);
    store s;
    store_init(&s);
    o.spill = &s.spill;
    bool fitted = false, refused = false;
    for (o.memory = (uint64_t)64 << 20; o.memory > 1 << 18; o.memory = o.memory * 3 / 4) {
        svo_result r = pack(&t, &o, &p);
        CHECK(r == SVO_OK || r == SVO_LIMIT);
        CHECK_U64(s.open, 0);
        refused = refused || r == SVO_LIMIT;
        if (r != SVO_OK) continue;
        CHECK(!refused);
        fitted = true;
        serialize(p, &small);
        CHECK(plain.size == small.size && memcmp(plain.data, small.data, plain.size) == 0);
        svo_buffer_free(&small);
        svo_packed_free(p);
    }
    CHECK(fitted && refused && s.writes > 0);
    svo_buffer_free(&plain);
    tree_free(&t);
}
