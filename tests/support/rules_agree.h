/* The list of all violations says of a file what its reader says: nothing is wrong with what the reader takes, and of what it refuses at least something. */
#ifndef RULES_AGREE_H
#define RULES_AGREE_H

#include <stdio.h>
#include <string.h>

#include "svo_alloc.h"
#include "svo_rules.h"

typedef svo_result (*rules_fn)(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err);

typedef struct rules_list { uint64_t count; bool first_is_there, nameless; const svo_error *first; char last[240]; } rules_list;

static inline bool rules_add(void *user, const svo_error *e)
{
    rules_list *l = user;
    l->count++;
    l->nameless |= e->message[0] == 0 || e->code != SVO_INVALID_DATA;
    l->first_is_there |= strcmp(e->message, l->first->message) == 0;
    snprintf(l->last, sizeof l->last, "%s", e->message);
    return l->count < 5000;
}

/* `r` and *first are what the reader said. exact: its violation must be among the others, word by word. NULL: they agree; else what is wrong. */
static inline const char *rules_agree(rules_fn all, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_result r, const svo_error *first, bool exact)
{
    static char why[600];
    rules_list l = {.first = first};
    svo_rules rules = {rules_add, &l, 0};
    svo_error err = {0};
    if (r != SVO_OK && r != SVO_INVALID_DATA) return NULL; /* no memory, a newer version: no verdict on the bytes */
    svo_result s = all(bytes, size, a, &rules, &err);
    if (s != SVO_OK && s != SVO_INVALID_DATA) return s == SVO_UNSUPPORTED && r == SVO_OK ? "what the reader takes is unsupported" : NULL;
    why[0] = 0;
    if (r == SVO_OK && (l.count != 0 || s != SVO_OK)) snprintf(why, sizeof why, "the reader takes it, the list has \"%s\"", s != SVO_OK ? err.message : l.last);
    else if (r != SVO_OK && l.count == 0) snprintf(why, sizeof why, "the reader says \"%s\", the list nothing", first->message);
    else if (l.nameless) snprintf(why, sizeof why, "a violation without a message, or of another kind");
    else if (exact && r != SVO_OK && !l.first_is_there && l.count < 5000) snprintf(why, sizeof why, "\"%s\" is not among the violations, the last of which is \"%s\"", first->message, l.last);
    return why[0] != 0 ? why : NULL;
}

typedef struct rules_text { char all[20000]; size_t used; uint64_t count; } rules_text;

static inline bool rules_append(void *user, const svo_error *e)
{
    rules_text *t = user;
    int n = snprintf(t->all + t->used, sizeof t->all - t->used, "%s\n", e->message);
    if (n > 0 && (size_t)n < sizeof t->all - t->used) t->used += (size_t)n;
    t->count++;
    return true;
}

/* All violations, a line each. */
static inline const rules_text *rules_all(rules_fn all, const uint8_t *bytes, uint64_t size)
{
    static rules_text t;
    svo_rules rules = {rules_append, &t, 0};
    svo_error err = {0};
    t.all[0] = 0, t.used = 0, t.count = 0;
    if (all(bytes, size, NULL, &rules, &err) != SVO_OK) snprintf(t.all, sizeof t.all, "%s", err.message);
    return &t;
}

#endif
