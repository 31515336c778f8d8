/* The test harness: checks that print expression, place and values; a name filter; a small seeded generator. */
#ifndef TEST_H
#define TEST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "svo_base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* TEST(name) { ... } defines and registers a test. Run all, or those whose names contain an argument given. */
typedef void (*test_fn)(void);
void test_register(const char *name, test_fn fn);
#define TEST(name)                                                                                \
    static void test_##name(void);                                                                \
    __attribute__((constructor)) static void test_register_##name(void) { test_register(#name, test_##name); } \
    static void test_##name(void)

/* A failed check fails the test and returns from the enclosing void function. */
void test_fail(const char *file, int line, const char *format, ...) SVO_PRINTF(3, 4);
#define CHECK(cond)                                          \
    do {                                                     \
        if (!(cond)) {                                       \
            test_fail(__FILE__, __LINE__, "%s", #cond);      \
            return;                                          \
        }                                                    \
    } while (0)
#define CHECK_MSG(cond, ...)                                 \
    do {                                                     \
        if (!(cond)) {                                       \
            test_fail(__FILE__, __LINE__, __VA_ARGS__);      \
            return;                                          \
        }                                                    \
    } while (0)
#define CHECK_U64(a, b)                                                                                   \
    do {                                                                                                  \
        uint64_t check_a_ = (uint64_t)(a), check_b_ = (uint64_t)(b);                                      \
        if (check_a_ != check_b_) {                                                                       \
            test_fail(__FILE__, __LINE__, "%s == %s: %llu != %llu", #a, #b, (unsigned long long)check_a_, \
                      (unsigned long long)check_b_);                                                      \
            return;                                                                                       \
        }                                                                                                 \
    } while (0)
/* An svo_result expression that uses the svo_error `err`. */
#define CHECK_OK(expr)                                                                                        \
    do {                                                                                                      \
        svo_result check_r_ = (expr);                                                                         \
        if (check_r_ != SVO_OK) {                                                                             \
            test_fail(__FILE__, __LINE__, "%s: %s: %s", #expr, svo_result_name(check_r_), err.message);       \
            return;                                                                                           \
        }                                                                                                     \
    } while (0)
#define CHECK_RESULT(expr, expected)                                                                          \
    do {                                                                                                      \
        svo_result check_r_ = (expr);                                                                         \
        if (check_r_ != (expected)) {                                                                         \
            test_fail(__FILE__, __LINE__, "%s: %s, expected %s (%s)", #expr, svo_result_name(check_r_),       \
                      svo_result_name(expected), err.message);                                                \
            return;                                                                                           \
        }                                                                                                     \
    } while (0)

/* True once a check of the running test has failed (for loops in helpers). */
bool test_failed(void);
/* Mark the running test as skipped and say why; return after it. */
void test_skip(const char *format, ...) SVO_PRINTF(1, 2);

/* Folder of real models, or NULL (SVOKIT_MODELS, else SVOKIT_MODELS_DEFAULT if it exists). */
const char *test_models(void);
/* Path of a model in it, in static storage that the next call reuses; NULL when it is missing. */
const char *test_model(const char *relative);

/* splitmix64: the same numbers everywhere. */
uint64_t test_random(uint64_t *state);
double test_random_unit(uint64_t *state); /* [0, 1) */

/* A fresh temporary folder for this process, removed at exit. */
const char *test_folder(void);

#ifdef __cplusplus
}
#endif
#endif
