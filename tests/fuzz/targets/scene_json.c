/* Scene descriptions. */
#include <math.h>
#include <string.h>

#include "../fuzz.h"
#include "fmt_scene_json.h"

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    fmt_scene_json s;
    SVO_TRY(fmt_scene_json_parse(bytes, size, a, NULL, &s, err));
    for (uint32_t i = 0; i < s.asset_count; i++) {
        const char *file = s.assets[i].file;
        if (s.assets[i].name[0] == '\0' || file[0] == '\0' || file[0] == '/') fuzz_fail("asset %u", i);
        for (const char *p = file, *slash; p != NULL; p = slash != NULL ? slash + 1 : NULL) {
            slash = strchr(p, '/');
            if (strncmp(p, "..", 2) == 0 && (p[2] == '/' || p[2] == '\0')) fuzz_fail("asset %u leaves the folder", i);
        }
    }
    for (uint64_t i = 0; i < s.place_count; i++) {
        if (s.places[i].asset >= s.asset_count || s.places[i].name >= s.names_size) fuzz_fail("instance %llu", (unsigned long long)i);
        for (size_t k = 0; k < sizeof s.places[i].transform / sizeof s.places[i].transform[0]; k++)
            if (!isfinite(s.places[i].transform[k])) fuzz_fail("a transform is not finite");
    }
    if (s.names_size != 0 && s.names[s.names_size - 1] != '\0') fuzz_fail("names do not end");
    fmt_scene_json_free(&s);
    return SVO_OK;
}

const fuzz_target fuzz_this = {.read = read, .memory = 16 << 20};
