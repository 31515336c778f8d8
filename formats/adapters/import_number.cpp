/* Correctly rounded decimal to double for the numbers that the inline fast path cannot do exactly.
 * std::from_chars, unlike strtod, does not look at the process's locale and needs no terminator. */
#include "import_text.h"

#include <charconv>
#include <limits>

extern "C" bool import_number_slow(const char *begin, const char *end, bool huge, double *out)
{
    double value = 0;
    std::from_chars_result r = std::from_chars(begin, end, value, std::chars_format::general);
    if (r.ec == std::errc::result_out_of_range) value = huge ? std::numeric_limits<double>::infinity() : 0.0;
    else if (r.ec != std::errc() || r.ptr != end) return false;
    *out = value;
    return true;
}
