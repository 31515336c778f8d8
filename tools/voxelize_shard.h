/* --shard i/N and --shard auto. */
#ifndef VOXELIZE_SHARD_H
#define VOXELIZE_SHARD_H

#include <stdint.h>
#include <stddef.h>
#include <stdbool.h>

/* False with a reason in why. "auto" reads SLURM_ARRAY_TASK_ID, _MIN, _MAX, _STEP and _COUNT. */
bool parse_shard(const char *text, uint32_t *index, uint32_t *count, char *why, size_t why_size);

#endif
