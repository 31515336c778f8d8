/* .svdag: a packed octree that is mapped and traversed in place; docs/format/svdag.md is normative. */
#ifndef FMT_SVDAG_H
#define FMT_SVDAG_H

#include "fmt_container.h"
#include "svo_view.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Write a view (built in memory or mapped from elsewhere). Same view and provenance, same bytes. */
svo_result fmt_svdag_write(fmt_output *out, const svo_view *view, const char *provenance, svo_error *err);

/* An opened file. The view's pointers go into `bytes`, which must outlive it. All payload hashes are checked and the
 * view is validated (svo_view_validate) before this returns SVO_OK. */
typedef struct fmt_svdag {
    svo_view view;
    fmt_container container;
    char *provenance; /* JSON text or "" */
    const svo_allocator *allocator;
} fmt_svdag;
svo_result fmt_svdag_open(const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_svdag *out, svo_error *err);
void fmt_svdag_close(fmt_svdag *f);
/* Everything that is wrong with the file goes to `rules`: each violation that does not hang on another. An error is returned only for what is no violation
 * (out of memory, a newer version), or when `rules` had enough. */
svo_result fmt_svdag_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err);

#ifdef __cplusplus
}
#endif
#endif
