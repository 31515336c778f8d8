/* Decimal numbers of text formats against the C library's strtod, which is correctly rounded. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "import_text.h"
#include "test.h"

static void check(const char *text, size_t length)
{
    double got = 0, want = strtod(text, NULL);
    char *exact = malloc(length);
    memcpy(exact, text, length); /* no terminator: a sanitizer sees reads beyond */
    const char *end = import_double(exact, exact + length, &got);
    bool ok = end == exact + length && (memcmp(&got, &want, sizeof got) == 0 || (isnan(got) && isnan(want)));
    free(exact);
    CHECK_MSG(ok, "'%s': %.17g, expected %.17g", text, got, want);
}

TEST(same_as_strtod)
{
    static const char *const odd[] = {"0", "-0", "+1", "1.", ".5", "-.5e1", "1e22", "1e23", "9007199254740993", "123456789012345678901234567890",
        "0.1", "4.9e-324", "2e-324", "1e-400", "1e400", "-1e400", "1.7976931348623157e308", "1.7976931348623159e308", "nan", "-inf", "inf",
        "0.000000000000000000000000000000000000000000000000000000000000000000000000001e75", "1E+5", "1e-05", "2.2250738585072011e-308",
        "0e999999999999", "1000000000000000000000000000000000000000000000e-400"};
    for (size_t i = 0; i < sizeof odd / sizeof *odd && !test_failed(); i++) check(odd[i], strlen(odd[i]));
    uint64_t seed = 1;
    for (int i = 0; i < 200000 && !test_failed(); i++) {
        char text[64];
        uint64_t bits = test_random(&seed);
        double v;
        memcpy(&v, &bits, sizeof v);
        if (i % 2 == 0) v = ldexp(test_random_unit(&seed) - 0.5, (int)(test_random(&seed) % 40) - 20);
        int digits = 1 + (int)(test_random(&seed) % 18);
        int n = isfinite(v) ? snprintf(text, sizeof text, i % 4 == 0 ? "%.*f" : "%.*g", i % 4 == 0 ? digits % 12 : digits, v) : 0;
        if (n > 0 && n < (int)sizeof text) check(text, (size_t)n);
    }
}

TEST(not_numbers)
{
    static const char *const bad[] = {"", "-", "+", ".", "e5", "1e", "1e+", "1.2.3", "0x10", "1,5", "--1", "1f", "nanx", "3.1+e2", "XXX1"};
    double v;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) CHECK_MSG(import_double(bad[i], bad[i] + strlen(bad[i]), &v) == NULL, "'%s'", bad[i]);
}
