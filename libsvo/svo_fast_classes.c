/* Widths of bricks' codes in layout 2. */
#include "svoi_fast.h"

enum { TURN_BITS = SVOI_CODE_TURNS - 1 };

/* Bricks whose number has at most so many bits, and the index of their change too: of one class, of two, of three. */
typedef uint64_t code_sums[33][SVOI_CODE_TURNS];
static uint64_t in_one(code_sums sum, svoi_code_class a) { return sum[a.ids][a.turns]; }
static uint64_t in_both(code_sums sum, svoi_code_class a, svoi_code_class b)
{
    return sum[a.ids < b.ids ? a.ids : b.ids][a.turns < b.turns ? a.turns : b.turns];
}
static svoi_code_class both(svoi_code_class a, svoi_code_class b) { return (svoi_code_class){a.ids < b.ids ? a.ids : b.ids, a.turns < b.turns ? a.turns : b.turns}; }

void svoi_fast_classes(uint64_t count[33][SVOI_CODE_TURNS], uint32_t widest, uint32_t free, svoi_code_class *out)
{
    svoi_code_class option[33 * SVOI_CODE_TURNS];
    uint32_t options = 0;
    code_sums sum;
    for (uint32_t n = 0; n <= widest; n++)
        for (uint32_t t = 0; t <= TURN_BITS; t++)
            sum[n][t] = count[n][t] + (n != 0 ? sum[n - 1][t] : 0) + (t != 0 ? sum[n][t - 1] : 0) - (n != 0 && t != 0 ? sum[n - 1][t - 1] : 0);
    for (uint32_t width = 0; width <= widest + TURN_BITS; width++)
        for (uint32_t t = 0; t <= TURN_BITS && t <= width; t++)
            if (width - t <= widest) option[options++] = (svoi_code_class){width - t, t};
    uint64_t all = sum[widest][TURN_BITS], least = UINT64_MAX;
    uint32_t most = widest + TURN_BITS;
    svoi_code_class none = {0, 0};
    for (uint32_t i = 0; i < options; i++)
        for (uint32_t j = i; j < options; j++) {
            svoi_code_class a = option[i], b = option[j];
            uint64_t one = in_one(sum, a), two = in_one(sum, b) - in_both(sum, a, b);
            uint64_t cost = one * (a.ids + a.turns) + two * (b.ids + b.turns), rest = all - one - two;
            if (free == 2) {
                if (cost + rest * most < least) least = cost + rest * most, out[0] = a, out[1] = b, out[2] = none;
                continue;
            }
            for (uint32_t k = j; k < options && cost < least; k++) {
                svoi_code_class c = option[k];
                uint64_t three = in_one(sum, c) - in_both(sum, a, c) - in_both(sum, b, c) + in_both(sum, both(a, b), c);
                uint64_t total = cost + three * (c.ids + c.turns) + (rest - three) * most;
                if (total < least) least = total, out[0] = a, out[1] = b, out[2] = c;
            }
        }
    out[free] = (svoi_code_class){widest, TURN_BITS};
}
