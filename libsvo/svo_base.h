/* Result codes, error detail, version and checking macros: the one header that everything else includes.
 *
 * Rules that hold for every function of libsvo, libskel and formats unless its comment says otherwise:
 *  - A fallible function returns svo_result and takes `svo_error *err` last; err may be NULL. On failure its
 *    outputs are untouched (or zeroed, where its comment says so) and nothing it allocated is left behind.
 *  - Input pointers are borrowed for the call. Outputs are owned by the caller and freed by the matching *_free,
 *    which accepts NULL and zeroed objects.
 *  - Objects are not safe to share between threads while one of them writes; different objects are. There is no
 *    global mutable state.
 *  - Wrong arguments by the calling program are asserts (SVO_ASSERT); bytes of a file never are. */
#ifndef SVO_BASE_H
#define SVO_BASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SVO_VERSION_MAJOR 0
#define SVO_VERSION_MINOR 1
#define SVO_VERSION_PATCH 0
#define SVO_VERSION_STRING "0.1.0"

/* name, number, exit code of a tool that fails with it, text. Numbers are never reused. */
#define SVO_RESULT_MAP(X)                                                    \
    X(OK, 0, 0, "ok")                                                        \
    X(INVALID_ARGUMENT, 1, 1, "invalid argument")                            \
    X(IO, 2, 2, "input/output error")                                        \
    X(INVALID_DATA, 3, 3, "invalid input")                                   \
    X(RUNTIME, 4, 4, "runtime error")                                        \
    X(OUT_OF_MEMORY, 5, 4, "out of memory")                                  \
    X(UNSUPPORTED, 6, 5, "unsupported")                                      \
    X(NOT_BUILT, 7, 5, "not built in")                                       \
    X(LIMIT, 8, 6, "over a stated limit")                                    \
    X(CANCELLED, 9, 4, "cancelled")

typedef enum svo_result {
#define SVO_RESULT_ENUM(name, number, exit_code, text) SVO_##name = number,
    SVO_RESULT_MAP(SVO_RESULT_ENUM)
#undef SVO_RESULT_ENUM
} svo_result;

/* Where and why something failed. Plain, caller-owned, needs no freeing. Fields that do not apply are 0. */
typedef struct svo_error {
    svo_result code;
    uint32_t chunk;    /* four-character type of the chunk concerned */
    uint64_t offset;   /* byte offset in the input */
    uint64_t index;    /* element index */
    char message[240]; /* one line, no trailing newline, UTF-8 */
} svo_error;

/* Static English text of a code, "unknown result" for a number that is none. */
const char *svo_result_text(svo_result result);
/* Enumerator name without prefix, e.g. "INVALID_DATA". */
const char *svo_result_name(svo_result result);
/* Exit code (0..7) of a tool that ends with this result. */
int svo_result_exit_code(svo_result result);

#if defined(__GNUC__)
#define SVO_PRINTF(fmt_index, first) __attribute__((format(printf, fmt_index, first)))
#else
#define SVO_PRINTF(fmt_index, first)
#endif

/* Fill *err (if not NULL) with code and a formatted message, other fields 0. Returns code, so that
 * `return svo_fail(err, SVO_IO, ...)` reads well. */
svo_result svo_fail(svo_error *err, svo_result code, const char *format, ...) SVO_PRINTF(3, 4);

/* Evaluate an expression of type svo_result; return it from the enclosing function unless SVO_OK. */
#define SVO_TRY(expr)                          \
    do {                                       \
        svo_result svo_try_ = (expr);          \
        if (svo_try_ != SVO_OK) return svo_try_; \
    } while (0)

/* Called when an SVO_ASSERT fails: prints to stderr and aborts. */
void svo_assert_failed(const char *expression, const char *file, int line);

#if !defined(NDEBUG) || defined(SVO_ENABLE_ASSERTS)
#define SVO_ASSERT(cond) ((cond) ? (void)0 : svo_assert_failed(#cond, __FILE__, __LINE__))
#else
#define SVO_ASSERT(cond) ((void)0)
#endif

/* Levels run from 0 (root) to at most SVO_MAX_DEPTH (finest); 3 * 21 = 63 Morton bits. */
#define SVO_MAX_DEPTH 21u

/* A warning is a line of text for the user; a list of them travels with long operations. Duplicates are counted,
 * not repeated; after SVO_MAX_WARNINGS different lines further ones are only counted. */
#define SVO_MAX_WARNINGS 64u
typedef struct svo_warnings {
    uint32_t count;      /* lines stored */
    uint64_t suppressed; /* different lines that were dropped because the list was full */
    struct { uint64_t times; char text[240]; } line[SVO_MAX_WARNINGS];
} svo_warnings;

/* Append a formatted line; w may be NULL. Not thread-safe on one list. */
void svo_warn(svo_warnings *w, const char *format, ...) SVO_PRINTF(2, 3);

/* Monotonic seconds, for reports only; never influences results. */
double svo_seconds(void);

#ifdef __cplusplus
}
#endif
#endif
