/* 16 voxels at a time, for processors with AVX-512; which kernel runs is chosen when the program runs, and does not show in the results. */
#define LANES 16
#include "svoi_clip_kernel.h"

#if defined(__x86_64__) && defined(__AVX512F__) && defined(__AVX512VL__) && defined(__AVX512DQ__) && defined(__AVX512BW__)
static bool held_back = false;
void svoi_clip_hold_back(bool held) { held_back = held; }
bool svoi_clip_has_wide(void)
{
    return !held_back && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") &&
           __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512vpopcntdq") && __builtin_cpu_supports("bmi2") && __builtin_cpu_supports("fma");
}
#else
void svoi_clip_hold_back(bool held) { (void)held; }
bool svoi_clip_has_wide(void) { return false; }
#endif

void svoi_clip_wide(const svoi_clipper *c, svoi_clip_batch *b, uint32_t count, svoi_clip_parts want) { clip_all(c, b, count, want); }
