/* .svdag: opened and validated, then walked, looked up, traced. */
#include "view_use.h"
#include "fmt_svdag.h"
#include "rules_agree.h"

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_svdag f;
    svo_result r = fmt_svdag_open(bytes, size, a, &f, err);
    const char *differ = rules_agree(fmt_svdag_violations, bytes, size, a, r, err, true);
    if (differ != NULL) fuzz_fail("%s", differ);
    if (r != SVO_OK) return r;
    view_check(&f.view);
    fmt_svdag_close(&f);
    return SVO_OK;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20};
