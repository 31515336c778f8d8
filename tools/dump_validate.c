/* Everything that is wrong with a file, and what can still be read of it. */
#include <stdio.h>
#include <string.h>

#include "dump.h"
#include "fmt_scene.h"
#include "fmt_skel.h"
#include "fmt_svdag.h"
#include "fmt_survey.h"
#include "fmt_svo.h"

enum { MESSAGES = 1000, CHUNKS = 1000, TYPES = 32 };

/* The rule that a message names: "SVO-05" of "... (SVO-05)", "DAG-05" of "asset 3 (SCN-08): DAG-05: ...", the first of "(DAG-01, DAG-08)". Empty: none. */
static void rule_of(const char *message, char out[16])
{
    out[0] = 0;
    for (const char *m = message; *m != 0; m++) {
        if (m != message && m[-1] != '(' && !(m[-1] == ' ' && m - message > 1 && m[-2] == ':')) continue;
        if (strspn(m, "ABCDEFGHIJKLMNOPQRSTUVWXYZ") != 3 || m[3] != '-' || strspn(m + 4, "0123456789") != 2) continue;
        memcpy(out, m, 6);
        out[6] = 0;
    }
}

typedef struct findings {
    dump_job *job;
    json_t *messages;
    uint64_t suppressed;
    const char *about; /* put before the message, or NULL */
    json_t *chunks;    /* NULL: not wanted */
    uint64_t chunk_count;
    struct { uint32_t type; uint64_t chunks, intact, bytes; } types[TYPES];
    uint32_t type_count;
} findings;

static void add(findings *f, const svo_error *e, uint64_t bytes)
{
    char rule[16], chunk[5], text[320];
    const json_t *m;
    size_t i;
    snprintf(text, sizeof text, "%s%s%s", f->about != NULL ? f->about : "", f->about != NULL ? ": " : "", e->message);
    json_array_foreach(f->messages, i, m)
        if (strcmp(json_string_value(json_object_get(m, "message")), text) == 0) return; /* known from another pass */
    if (json_array_size(f->messages) == MESSAGES) {
        f->suppressed++;
        return;
    }
    json_t *o = json_object();
    rule_of(e->message, rule);
    cli_put_text(o, "id", rule[0] != 0 ? rule : svo_result_name(e->code));
    cli_put_text(o, "type", "error");
    cli_put_text(o, "message", text);
    fmt_fourcc_text(e->chunk, chunk);
    if (e->chunk != 0) cli_put_text(o, "chunk", chunk);
    cli_put_u64(o, "offset", e->offset);
    if (bytes != 0) cli_put_u64(o, "bytes", bytes);
    json_array_append_new(f->messages, o);
}

static void on_damage(void *user, const svo_error *e, uint64_t bytes) { add(user, e, bytes); }

static void on_chunk(void *user, const fmt_chunk *c, bool intact)
{
    findings *f = user;
    uint32_t t = 0;
    while (t < f->type_count && f->types[t].type != c->type) t++;
    if (t == f->type_count && t < TYPES) f->types[f->type_count++].type = c->type;
    if (t < TYPES) f->types[t].chunks++, f->types[t].intact += intact, f->types[t].bytes += c->stored_size;
    if (f->chunks == NULL || f->chunk_count++ >= CHUNKS) return;
    char name[5];
    json_t *o = json_object();
    fmt_fourcc_text(c->type, name);
    cli_put_text(o, "type", name);
    cli_put_u64(o, "id", c->id);
    cli_put_u64(o, "offset", c->offset - 64);
    cli_put_u64(o, "payload_bytes", c->stored_size);
    json_object_set_new(o, "intact", json_boolean(intact));
    json_array_append_new(f->chunks, o);
}

static bool on_violation(void *user, const svo_error *e)
{
    findings *f = user;
    add(f, e, 0);
    return f->suppressed == 0;
}

/* All rules of the kind; false for a kind whose rules are looked at elsewhere. */
static bool check_rules(findings *f, uint32_t kind, svo_error *err)
{
    const dump_job *j = f->job;
    svo_rules rules = {on_violation, f, 0};
    if (kind == FMT_KIND_SVDAG) fmt_svdag_violations(j->data, j->size, j->allocator, &rules, err);
    else if (kind == FMT_KIND_SCENE) fmt_scene_violations(j->data, j->size, j->allocator, &rules, err);
    else if (kind == FMT_KIND_SVO) fmt_svo_violations(j->data, j->size, j->allocator, &rules, err);
    else if (kind == FMT_KIND_SKEL) fmt_skel_violations(j->data, j->size, j->allocator, &rules, err);
    else return false;
    return true;
}

static void survey(findings *f, bool chunks)
{
    fmt_survey s = {f, on_chunk, on_damage};
    f->messages = json_array();
    f->chunks = chunks ? json_array() : NULL;
    fmt_survey_file(f->job->data, f->job->size, &s);
}

json_t *dump_violations(dump_job *j, svo_result first, const svo_error *err, uint64_t *suppressed)
{
    findings f = {.job = j};
    if (first == SVO_OK) return json_array();
    survey(&f, false);
    bool sound = json_array_size(f.messages) == 0;
    uint32_t kind = fmt_container_kind(j->data, j->size);
    svo_error inner = {0};
    bool all = first == SVO_INVALID_DATA && check_rules(&f, kind, &inner);
    if ((sound && !all) || json_array_size(f.messages) == 0) add(&f, err, 0);
    *suppressed = f.suppressed;
    return f.messages;
}

/* HEAD of a .svo, if it is intact. */
static void put_head(dump_job *j, json_t *o)
{
    fmt_input *in = NULL;
    fmt_svo_reader *r = NULL;
    if (fmt_container_kind(j->data, j->size) != FMT_KIND_SVO || fmt_input_open_memory(j->data, j->size, &in, NULL) != SVO_OK) return;
    if (fmt_svo_reader_open(in, j->allocator, &r, NULL) == SVO_OK) {
        const svo_tree_info *info = fmt_svo_reader_info(r);
        json_t *list = json_array();
        dump_grid(o, info->depth, info->voxel_to_world, info->surface, info->fill);
        for (uint32_t i = 0; i < info->channel_count; i++) json_array_append_new(list, dump_channel(&info->channels[i]));
        json_object_set_new(o, "attributes", list);
    }
    fmt_svo_reader_close(r);
    fmt_input_close(in);
}

json_t *dump_partial(dump_job *j, svo_result first, const svo_error *err)
{
    findings f = {.job = j};
    json_t *o = json_object(), *sections = json_array();
    survey(&f, true);
    if (json_array_size(f.messages) == 0) {
        json_decref(f.messages);
        f.messages = dump_violations(j, first, err, &f.suppressed);
    }
    cli_put_text(o, "file", strcmp(j->path, "-") == 0 ? "stdin" : j->path);
    cli_put_text(o, "format", dump_kind_text(fmt_container_kind(j->data, j->size)));
    cli_put_u64(o, "bytes", j->size);
    json_object_set_new(o, "damaged", json_true());
    json_object_set_new(o, "damage", f.messages);
    cli_put_u64(o, "damage_suppressed", f.suppressed);
    for (uint32_t t = 0; t < f.type_count; t++) {
        char name[5];
        json_t *s = json_object();
        fmt_fourcc_text(f.types[t].type, name);
        cli_put_text(s, "type", name);
        cli_put_u64(s, "chunks", f.types[t].chunks);
        cli_put_u64(s, "intact", f.types[t].intact);
        cli_put_u64(s, "payload_bytes", f.types[t].bytes);
        json_array_append_new(sections, s);
    }
    json_object_set_new(o, "found", sections);
    json_object_set_new(o, "chunks", f.chunks);
    json_object_set_new(o, "listed_in_full", json_boolean(f.chunk_count <= CHUNKS));
    put_head(j, o);
    return o;
}
