/* .svdag: opened and validated, then walked, looked up, traced. */
#include "view_use.h"
#include "fmt_svdag.h"

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_svdag f;
    SVO_TRY(fmt_svdag_open(bytes, size, a, &f, err));
    view_check(&f.view);
    fmt_svdag_close(&f);
    return SVO_OK;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20};
