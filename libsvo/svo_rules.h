/* Where a check puts its violations. Without one it ends at the first; with one it goes on behind a violation as far as what follows does not hang
 * on it, so that every independent violation is named once. */
#ifndef SVO_RULES_H
#define SVO_RULES_H

#include "svo_base.h"

typedef struct svo_rules {
    /* False: enough; the check ends. e lives for the call. Called from one thread, in the order of the file. */
    bool (*found)(void *user, const svo_error *e);
    void *user;
    uint64_t count; /* of violations; counted by the check */
} svo_rules;

/* What a check does with the result of one of its steps: a violation (SVO_INVALID_DATA, with *err filled) that is taken by `rules` becomes SVO_OK. rules NULL: r. */
static inline svo_result svo_go_on(svo_rules *rules, svo_result r, const svo_error *err)
{
    if (rules == NULL || r != SVO_INVALID_DATA) return r;
    rules->count++;
    return rules->found(rules->user, err) ? SVO_OK : r;
}

#endif
