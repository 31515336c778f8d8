/* What is left of a damaged file, and where the damage is: a container read without trust in its table. */
#ifndef FMT_SURVEY_H
#define FMT_SURVEY_H

#include "fmt_container.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct fmt_survey {
    void *user;
    /* A chunk whose header is sound; intact: its payload is the one that was written. The table too. */
    void (*chunk)(void *user, const fmt_chunk *chunk, bool intact);
    /* Something that breaks a rule of docs/format/container.md, named in the message; `bytes` of the file are lost by it. */
    void (*damage)(void *user, const svo_error *what, uint64_t bytes);
} fmt_survey;

/* Go through the file from front to back. Behind a damaged chunk header it goes on at the next place where one is sound. Either function may be NULL. Returns the
 * number of places that are damaged. Linear in the file; no memory. `data` is 64-byte aligned. What only the table and all chunks together tell is
 * fmt_container_open's. */
uint64_t fmt_survey_file(const uint8_t *data, uint64_t size, const fmt_survey *s);

#ifdef __cplusplus
}
#endif
#endif
