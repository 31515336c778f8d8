#include "voxelize_shard.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "svo_shard.h"

/* Decimal digits up to `end`; false when there are none, others, or too many. */
static bool number(const char *p, const char *end, uint64_t *out)
{
    if (p == end || end - p > 10) return false;
    uint64_t v = 0;
    for (; p < end; p++) {
        if (*p < '0' || *p > '9') return false;
        v = v * 10 + (uint64_t)(*p - '0');
    }
    *out = v;
    return true;
}

static bool variable(const char *name, uint64_t *out, char *why, size_t why_size)
{
    const char *text = getenv(name);
    if (text != NULL && number(text, text + strlen(text), out)) return true;
    snprintf(why, why_size, "auto needs a Slurm job array, and %s is %s", name, text == NULL ? "not set" : "no number");
    return false;
}

static bool from_slurm(uint64_t *index, uint64_t *count, char *why, size_t why_size)
{
    uint64_t id, low, high, step = 1;
    if (!variable("SLURM_ARRAY_TASK_ID", &id, why, why_size) || !variable("SLURM_ARRAY_TASK_MIN", &low, why, why_size) ||
        !variable("SLURM_ARRAY_TASK_MAX", &high, why, why_size) || !variable("SLURM_ARRAY_TASK_COUNT", count, why, why_size))
        return false;
    if (getenv("SLURM_ARRAY_TASK_STEP") != NULL && !variable("SLURM_ARRAY_TASK_STEP", &step, why, why_size)) return false;
    if (step == 0 || id < low || id > high || (id - low) % step != 0 || (high - low) / step + 1 != *count) {
        snprintf(why, why_size, "auto needs an array without holes; give the shard as i/N, for instance \"$SLURM_ARRAY_TASK_ID/100\"");
        return false;
    }
    *index = (id - low) / step + 1;
    return true;
}

bool parse_shard(const char *text, uint32_t *index, uint32_t *count, char *why, size_t why_size)
{
    uint64_t i = 0, n = 0;
    const char *slash = strchr(text, '/');
    if (strcmp(text, "auto") == 0) {
        if (!from_slurm(&i, &n, why, why_size)) return false;
    } else if (slash == NULL || !number(text, slash, &i) || !number(slash + 1, slash + strlen(slash), &n)) {
        snprintf(why, why_size, "'%.40s' is neither i/N nor auto", text);
        return false;
    }
    if (n == 0 || n > SVO_MAX_SHARDS || i == 0 || i > n) {
        snprintf(why, why_size, "there is no shard %llu of %llu; i is 1..N, N at most %u", (unsigned long long)i, (unsigned long long)n, SVO_MAX_SHARDS);
        return false;
    }
    *index = (uint32_t)i;
    *count = (uint32_t)n;
    return true;
}
