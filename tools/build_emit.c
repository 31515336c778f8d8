/* The steps as a script for others: Ninja, a shell, a Slurm job array. */
#include <stdlib.h>
#include <string.h>

#include "build.h"
#include "fmt_file.h"

typedef struct emitter {
    fmt_output *out;
    bool ninja; /* $ is written as $$ */
    svo_result result;
    svo_error *err;
} emitter;

static void put(emitter *e, const char *text)
{
    while (*text != 0 && e->result == SVO_OK) {
        size_t n = e->ninja ? strcspn(text, "$") : strlen(text);
        e->result = fmt_output_write(e->out, text, n, e->err);
        text += n;
        if (*text != '$' || e->result != SVO_OK) continue;
        e->result = fmt_output_write(e->out, "$$", 2, e->err);
        text++;
    }
}

/* A word for a POSIX shell. */
static void quote(emitter *e, const char *word)
{
    static const char plain[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_@%+=:,./-";
    if (word[0] != 0 && word[strspn(word, plain)] == 0) {
        put(e, word);
        return;
    }
    put(e, "'");
    for (const char *p = word; *p != 0; p++) {
        char one[2] = {*p, 0};
        put(e, *p == '\'' ? "'\\''" : one);
    }
    put(e, "'");
}

/* A word of Ninja's own syntax, of a path in a build line. */
static void ninja_path(emitter *e, const char *word)
{
    for (const char *p = word; *p != 0; p++) {
        char one[2] = {*p, 0};
        if (*p == '$' || *p == ' ' || *p == ':') put(e, "$");
        put(e, one);
    }
}

static void command(emitter *e, const build_step *s, const build_options *o)
{
    char tool[4200];
    snprintf(tool, sizeof tool, "%s/%s", o->tools, build_tools[s->kind]);
    char **a = build_arguments(s, tool, o->threads, s->memory, false);
    if (a == NULL) {
        if (e->result == SVO_OK) e->result = svo_fail(e->err, SVO_OUT_OF_MEMORY, "out of memory");
        return;
    }
    for (uint32_t i = 0; a[i] != NULL; i++) {
        if (i != 0) put(e, " ");
        quote(e, a[i]);
    }
    build_arguments_free(a);
}

static int by_text(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

/* Files that no step makes, as phony targets: a missing one then fails its asset alone; otherwise Ninja would build nothing at all. */
static void ninja_sources(emitter *e, const build_plan *p)
{
    size_t count = 0, made = 0;
    for (uint32_t i = 0; i < p->count; i++) count += p->steps[i].input_count;
    char **inputs = malloc((count + 1) * sizeof *inputs), **outputs = malloc(((size_t)p->count + 1) * sizeof *outputs);
    if (inputs == NULL || outputs == NULL) {
        if (e->result == SVO_OK) e->result = svo_fail(e->err, SVO_OUT_OF_MEMORY, "out of memory");
        count = 0;
    }
    for (uint32_t i = 0, n = 0; i < p->count && count != 0; i++) {
        outputs[made++] = p->steps[i].output;
        for (uint32_t k = 0; k < p->steps[i].input_count; k++) inputs[n++] = p->steps[i].inputs[k];
    }
    if (count != 0) {
        qsort(inputs, count, sizeof *inputs, by_text);
        qsort(outputs, made, sizeof *outputs, by_text);
    }
    for (size_t i = 0; i < count; i++) {
        if ((i != 0 && strcmp(inputs[i], inputs[i - 1]) == 0) || bsearch(&inputs[i], outputs, made, sizeof *outputs, by_text) != NULL) continue;
        put(e, "build ");
        ninja_path(e, inputs[i]);
        put(e, ": phony\n");
    }
    free(inputs);
    free(outputs);
}

static void emit_ninja(emitter *e, const build_plan *p, const build_options *o)
{
    put(e, "# Made by svo-build --emit ninja. Run in the folder where that ran.\nninja_required_version = 1.7\nrule run\n  command = $cmd\n  description = $what\n"
           "rule run_with_depfile\n  command = $cmd\n  description = $what\n  depfile = $dep\n  deps = gcc\n");
    ninja_sources(e, p);
    for (uint32_t i = 0; i < p->count; i++) {
        const build_step *s = &p->steps[i];
        put(e, "build ");
        ninja_path(e, s->output);
        put(e, s->kind != BUILD_COMPRESS ? ": run_with_depfile" : ": run");
        for (uint32_t k = 0; k < s->input_count; k++) put(e, " "), ninja_path(e, s->inputs[k]);
        if (s->kind == BUILD_PACK) {
            put(e, " |");
            for (int64_t n = s->first_need; n < s->first_need + s->need_count; n++) put(e, " "), ninja_path(e, p->steps[n].output);
        }
        put(e, "\n  cmd = mkdir -p ");
        e->ninja = true;
        quote(e, p->work);
        put(e, " && ");
        command(e, s, o);
        e->ninja = false;
        put(e, "\n  what = ");
        put(e, build_words[s->kind]);
        put(e, " ");
        ninja_path(e, s->asset);
        if (s->kind != BUILD_COMPRESS) put(e, "\n  dep = "), ninja_path(e, s->depfile);
        put(e, "\n");
    }
}

static void emit_sh(emitter *e, const build_plan *p, const build_options *o)
{
    put(e, "#!/bin/sh\n# Made by svo-build --emit sh: a line an asset, then the scenes. Goes on after failures; ends with the number of lines that failed, at most 100.\nfailed=0\nmkdir -p ");
    quote(e, p->work);
    put(e, "\n");
    for (uint32_t i = 0; i < p->count; i++) {
        command(e, &p->steps[i], o);
        if (p->steps[i].kind == BUILD_VOXELIZE && i + 1 < p->count && p->steps[i + 1].kind == BUILD_COMPRESS) {
            put(e, " && ");
            command(e, &p->steps[++i], o);
        }
        put(e, " || failed=$((failed + 1))\n");
    }
    put(e, "[ \"$failed\" -le 100 ] || failed=100\nexit \"$failed\"\n");
}

/* A task of the array is an asset with all its steps. Scenes need all of them, so they are the last lines, for a job of its own. */
static void emit_slurm(emitter *e, const build_plan *p, const build_options *o)
{
    char text[400];
    uint32_t tasks = 0;
    for (uint32_t i = 0; i < p->count; i++) tasks += p->steps[i].kind == BUILD_VOXELIZE;
    snprintf(text, sizeof text, "#!/bin/sh\n#SBATCH --job-name=svo-build\n#SBATCH --array=0-%u\n#SBATCH --output=svo-build-%%A-%%a.log\n"
             "# Made by svo-build --emit slurm: a task of the array is an asset. Without Slurm: SLURM_ARRAY_TASK_ID=N sh FILE; \"scenes\" as the\n# argument packs the scenes, "
             "when all assets are there (sbatch --array=0 --dependency=afterok:JOB FILE scenes).\n", tasks != 0 ? tasks - 1 : 0);
    put(e, text);
    put(e, "mkdir -p ");
    quote(e, p->work);
    put(e, "\nif [ \"${1-}\" = scenes ]; then\n    set -e\n");
    for (uint32_t i = 0; i < p->count; i++) {
        if (p->steps[i].kind != BUILD_PACK) continue;
        put(e, "    ");
        command(e, &p->steps[i], o);
        put(e, "\n");
    }
    put(e, "    exit 0\nfi\ncase \"$SLURM_ARRAY_TASK_ID\" in\n");
    uint32_t task = 0;
    for (uint32_t i = 0; i < p->count; i++) {
        const build_step *s = &p->steps[i];
        if (s->kind != BUILD_VOXELIZE) continue;
        snprintf(text, sizeof text, "%u)\n    ", task++);
        put(e, text);
        command(e, s, o);
        if (i + 1 < p->count && p->steps[i + 1].kind == BUILD_COMPRESS) {
            put(e, " &&\n    ");
            command(e, &p->steps[i + 1], o);
        }
        put(e, "\n    ;;\n");
    }
    put(e, "*)\n    echo \"no such task\" >&2\n    exit 1\n    ;;\nesac\n");
}

svo_result build_emit(cli *c, const build_plan *p, const build_options *o, build_engine engine, svo_error *err)
{
    emitter e = {NULL, false, SVO_OK, err};
    SVO_TRY(fmt_output_open(c->output != NULL ? c->output : "-", c->force, &e.out, err));
    if (engine == BUILD_NINJA) emit_ninja(&e, p, o);
    else if (engine == BUILD_SH) emit_sh(&e, p, o);
    else emit_slurm(&e, p, o);
    if (e.result == SVO_OK) return fmt_output_commit(e.out, err);
    fmt_output_discard(e.out);
    return e.result;
}
