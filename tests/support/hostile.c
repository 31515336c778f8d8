#define _GNU_SOURCE
#include "hostile.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <sys/mman.h>
#include <unistd.h>

#include "test.h"

/* Of the processor, not of the clock on the wall: how busy the machine is says nothing about the code. */
static double cpu_seconds(void) { return (double)clock() / CLOCKS_PER_SEC; }

#if defined(__SANITIZE_ADDRESS__)
#define SLOW 20
#else
#define SLOW 4
#endif

/* Memory that ends at an unmapped page. */
typedef struct guarded { uint8_t *base, *end; size_t length; } guarded;

static guarded guard_make(uint64_t capacity)
{
    size_t page = (size_t)sysconf(_SC_PAGESIZE);
    guarded g;
    g.length = (capacity + page - 1) / page * page + page;
    g.base = mmap(NULL, g.length, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (g.base == MAP_FAILED) abort();
    g.end = g.base + g.length - page;
    if (mprotect(g.end, page, PROT_NONE) != 0) abort();
    return g;
}

static void guard_free(guarded *g) { munmap(g->base, g->length); }

/* 64-byte aligned, so up to 63 bytes away from the guard. */
static uint8_t *guard_place(guarded *g, uint64_t size) { return g->end - (size + 63) / 64 * 64; }

typedef enum verdict { MUST_REFUSE, MAY_ACCEPT } verdict;

/* One damaged input: no crash (or we are not here), no leak, a message, in time, not at the memory limit. */
static void feed(const hostile_case *c, const uint8_t *bytes, uint64_t size, verdict v, const char *what, uint64_t where)
{
    svo_limit_allocator a;
    svo_limit_allocator_init(&a, c->memory != 0 ? c->memory : (uint64_t)256 << 20, NULL);
    svo_error err = {0};
    double start = cpu_seconds();
    svo_result r = c->read(c->user, bytes, size, &a.base, &err);
    double seconds = cpu_seconds() - start;
    unsigned long long at = (unsigned long long)where;
    if (test_failed()) {
        test_fail(__FILE__, __LINE__, "... in %s %llu (seed %llu)", what, at, (unsigned long long)c->seed);
        return;
    }
    CHECK_MSG(svo_limit_in_use(&a) == 0, "%s %llu: %llu bytes leaked", what, at, (unsigned long long)svo_limit_in_use(&a));
    CHECK_MSG(seconds < SLOW, "%s %llu: took %g s", what, at, seconds);
    if (r == SVO_OK) {
        CHECK_MSG(v == MAY_ACCEPT, "%s %llu: accepted", what, at);
        return;
    }
    CHECK_MSG(r == SVO_INVALID_DATA || r == SVO_UNSUPPORTED || r == SVO_LIMIT, "%s %llu: %s (%s)", what, at, svo_result_name(r), err.message);
    CHECK_MSG(err.code == r && err.message[0] != 0, "%s %llu: %s without a message", what, at, svo_result_name(r));
}

static uint32_t rounds(const hostile_case *c) { return c->rounds != 0 ? c->rounds : 1500; }

void hostile_truncations(const hostile_case *c)
{
    guarded g = guard_make(c->size + 64);
    uint64_t seed = c->seed, n = c->size <= 4096 ? c->size : rounds(c);
    for (uint64_t i = 0; i < n && !test_failed(); i++) {
        uint64_t size = c->size <= 4096 ? i : i % 2 == 0 ? test_random(&seed) % c->size : test_random(&seed) % (c->size / 64) * 64;
        uint8_t *b = guard_place(&g, size);
        memcpy(b, c->bytes, size);
        feed(c, b, size, MUST_REFUSE, "truncated to", size);
    }
    /* and a little longer than it should be */
    for (uint64_t more = 1; more <= 64 && !test_failed(); more += 63) {
        uint8_t *b = guard_place(&g, c->size + more);
        memcpy(b, c->bytes, c->size);
        memset(b + c->size, 0, more);
        feed(c, b, c->size + more, MUST_REFUSE, "lengthened by", more);
    }
    guard_free(&g);
}

/* Change some bytes, in ways that counts, sizes and indices care about. False when nothing changed. */
static bool damage(uint8_t *b, uint64_t size, uint64_t *seed)
{
    uint64_t at = test_random(seed) % size, kind = test_random(seed) % 6, run, v;
    uint8_t before[16];
    uint64_t n = size - at < 16 ? size - at : 16;
    memcpy(before, b + at, n);
    switch (kind) {
    case 0:
    case 1: b[at] ^= (uint8_t)(1u << test_random(seed) % 8); break;
    case 2: b[at] = (uint8_t)test_random(seed); break;
    case 3: /* a run of noise */
        run = 1 + test_random(seed) % n;
        for (uint64_t i = 0; i < run; i++) b[at + i] = (uint8_t)test_random(seed);
        break;
    case 4: /* an extreme number */
        run = n < 8 ? n : (uint64_t)4 << test_random(seed) % 2;
        memset(b + at, test_random(seed) % 2 == 0 ? 0xff : 0, run);
        break;
    default: /* a number a little off, aligned as numbers are */
        at &= ~(uint64_t)3;
        n = size - at < 16 ? size - at : 16;
        memcpy(before, b + at, n);
        if (n < 4) return false;
        v = fmt_load32(b + at) + (test_random(seed) % 2 == 0 ? 1u : UINT32_MAX);
        fmt_store32(b + at, (uint32_t)v);
    }
    return memcmp(before, b + at, n) != 0;
}

static void flips(const hostile_case *c, bool repair)
{
    guarded g = guard_make(c->size);
    uint8_t *b = guard_place(&g, c->size);
    uint64_t state = c->seed + (repair ? 1 : 0);
    for (uint32_t i = 0; i < rounds(c) && !test_failed(); i++) {
        memcpy(b, c->bytes, c->size);
        uint32_t times = 1 + (uint32_t)(test_random(&state) % 8 == 0) * 3;
        bool changed = false;
        for (uint32_t k = 0; k < times; k++) changed |= damage(b, c->size, &state);
        if (memcmp(b, c->bytes, c->size) == 0) changed = false; /* one change may undo another */
        if (!changed) continue;
        if (repair) hostile_repair(b, c->size, c->bytes);
        feed(c, b, c->size, repair ? MAY_ACCEPT : MUST_REFUSE, repair ? "repaired flip" : "flip", i);
    }
    guard_free(&g);
}

void hostile_flips(const hostile_case *c) { flips(c, false); }
void hostile_repaired_flips(const hostile_case *c) { flips(c, true); }

/* Change a payload or a header field of one chunk. */
static void change_chunk(hostile_chunk *k, uint64_t *seed)
{
    uint64_t what = test_random(seed) % 10;
    svo_buffer *p = &k->payload;
    hostile_touch(k);
    if (what < 6 && p->size != 0) {
        damage(p->data, p->size, seed);
    } else if (what == 6 && p->size != 0) { /* shorter */
        p->size -= 1 + test_random(seed) % p->size;
    } else if (what == 7) { /* longer */
        uint8_t *more = svo_buffer_append(p, NULL, 1 + test_random(seed) % 40);
        if (more == NULL) abort();
        *more = (uint8_t)test_random(seed);
    } else if (what == 8) {
        k->chunk.element_count += test_random(seed) % 5 - 2;
    } else {
        k->chunk.id ^= (uint64_t)1 << test_random(seed) % 64;
    }
}

static void rebuilt(const hostile_case *c, bool order)
{
    uint64_t state = c->seed + (order ? 3 : 2);
    svo_buffer built;
    svo_buffer_init(&built, NULL);
    hostile_file *f = malloc(sizeof *f);
    if (f == NULL) abort();
    for (uint32_t i = 0; i < rounds(c) / (order ? 4 : 1) && !test_failed(); i++) {
        hostile_parse(c->bytes, c->size, f);
        uint32_t k = (uint32_t)(test_random(&state) % f->count), other = (uint32_t)(test_random(&state) % f->count);
        if (!order) {
            change_chunk(&f->chunks[k], &state);
        } else {
            switch (test_random(&state) % 6) {
            case 0: hostile_drop(f, k); break;
            case 1: hostile_double(f, k); break;
            case 2: hostile_swap(f, k, other); break;
            case 3: f->chunks[k].chunk.type = f->chunks[other].chunk.type; break;
            case 4: f->chunks[k].chunk.type ^= 0x20; break;
            default: f->chunks[k].chunk.flags ^= FMT_CHUNK_CRITICAL; break;
            }
        }
        hostile_build(f, &built);
        hostile_free(f);
        guarded g = guard_make(built.size);
        uint8_t *b = guard_place(&g, built.size);
        memcpy(b, built.data, built.size);
        feed(c, b, built.size, MAY_ACCEPT, order ? "changed order" : "changed payload", i);
        guard_free(&g);
    }
    free(f);
    svo_buffer_free(&built);
}

void hostile_payloads(const hostile_case *c) { rebuilt(c, false); }
void hostile_orders(const hostile_case *c) { rebuilt(c, true); }

void hostile_allocations(const hostile_case *c)
{
    svo_limit_allocator a;
    for (uint64_t n = 1; n < 100000; n += n < 400 ? 1 : n / 50) {
        svo_limit_allocator_init(&a, UINT64_MAX, NULL);
        a.fail_at = n;
        svo_error err = {0};
        svo_result r = c->read(c->user, c->bytes, c->size, &a.base, &err);
        if (test_failed()) return;
        CHECK_MSG(svo_limit_in_use(&a) == 0, "allocation %llu fails: %llu bytes leaked", (unsigned long long)n, (unsigned long long)svo_limit_in_use(&a));
        CHECK_MSG(r == SVO_OK || r == SVO_OUT_OF_MEMORY, "allocation %llu fails: %s (%s)", (unsigned long long)n, svo_result_name(r), err.message);
        if (a.count < n) return; /* it never came to the n-th: all have been tried */
    }
}

void hostile_run(const hostile_case *c)
{
    svo_limit_allocator a;
    svo_limit_allocator_init(&a, c->memory != 0 ? c->memory : (uint64_t)256 << 20, NULL);
    svo_error err = {0};
    CHECK_OK(c->read(c->user, c->bytes, c->size, &a.base, &err));
    CHECK_MSG(svo_limit_in_use(&a) == 0, "the good file leaks %llu bytes", (unsigned long long)svo_limit_in_use(&a));
    static void (*const parts[])(const hostile_case *) = {hostile_truncations, hostile_flips,  hostile_repaired_flips,
                                                          hostile_payloads,    hostile_orders, hostile_allocations};
    for (size_t i = 0; i < sizeof parts / sizeof parts[0] && !test_failed(); i++) parts[i](c);
}
