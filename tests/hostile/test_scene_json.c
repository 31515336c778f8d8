/* Damaged scene descriptions: never a crash, never a leak, a message whenever they are refused. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_scene_json.h"
#include "fmt_utf8.h"
#include "test.h"

static const char good[] =
    "{\"assets\":[{\"name\":\"a\",\"file\":\"a.svdag\"},{\"name\":\"b\",\"file\":\"sub/b.obj\"}],\n"
    "\"instances\":[{\"asset\":\"a\",\"translation\":[1,2.5e3,-3],\"rotation\":[0,0,0,1],\"scale\":[1,1,1],\"id\":5,\"name\":\"x\\u00e4\"},\n"
    "{\"asset\":\"b\",\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],\"pose\":null}],\n"
    "\"camera\":{\"eye\":[1,2,3],\"target\":[0,0,0],\"up\":[0,1,0],\"fov\":45}}";

/* Parse from a block that ends where the text ends, so that a sanitizer sees every read beyond it. */
static svo_result parse(const char *text, size_t size, uint64_t fail_at)
{
    uint8_t *copy = malloc(size != 0 ? size : 1);
    memcpy(copy, text, size);
    svo_limit_allocator a;
    svo_limit_allocator_init(&a, (uint64_t)1 << 24, NULL);
    a.fail_at = fail_at;
    svo_error err = {0};
    fmt_scene_json s;
    svo_result result = fmt_scene_json_parse(copy, size, &a.base, NULL, &s, &err);
    if (result == SVO_OK) {
        for (uint64_t i = 0; i < s.place_count; i++) {
            if (s.places[i].asset >= s.asset_count || s.places[i].name >= s.names_size) test_fail(__FILE__, __LINE__, "an index outside its table");
            for (int k = 0; k < 12; k++)
                if (!isfinite(s.places[i].transform[k])) test_fail(__FILE__, __LINE__, "a transform that is not finite");
        }
        for (uint32_t i = 0; i < s.asset_count; i++)
            if (strstr(s.assets[i].file, "..") == s.assets[i].file && (s.assets[i].file[2] == '/' || s.assets[i].file[2] == 0))
                test_fail(__FILE__, __LINE__, "a path that leaves its folder");
        fmt_scene_json_free(&s);
    } else if (err.message[0] == 0 || err.code != result || !fmt_utf8_valid(err.message, strlen(err.message)))
        test_fail(__FILE__, __LINE__, "no message, or one that is not UTF-8: %s", err.message);
    if (svo_limit_in_use(&a) != 0) test_fail(__FILE__, __LINE__, "memory is left behind");
    free(copy);
    return result;
}

TEST(truncations)
{
    CHECK(parse(good, sizeof good - 1, 0) == SVO_OK);
    for (size_t n = 0; n < sizeof good - 1; n++) CHECK_MSG(parse(good, n, 0) == SVO_INVALID_DATA, "cut at %u", (unsigned)n);
}

TEST(changed_bytes)
{
    uint64_t seed = 3;
    char text[sizeof good];
    for (int round = 0; round < 30000 && !test_failed(); round++) {
        memcpy(text, good, sizeof good);
        for (uint64_t k = 1 + test_random(&seed) % 3; k > 0; k--) {
            static const char liked[] = "{}[]\",:0.e-\\ \n\xff\x80/";
            text[test_random(&seed) % (sizeof good - 1)] =
                test_random(&seed) % 2 ? liked[test_random(&seed) % (sizeof liked - 1)] : (char)(test_random(&seed) & 0xff);
        }
        parse(text, sizeof good - 1, 0);
    }
}

TEST(moved_pieces)
{
    uint64_t seed = 4;
    char text[2 * sizeof good];
    for (int round = 0; round < 20000 && !test_failed(); round++) {
        size_t size = 0;
        while (size < sizeof good) {
            size_t from = test_random(&seed) % (sizeof good - 1), n = 1 + test_random(&seed) % 200;
            if (n > sizeof good - 1 - from) n = sizeof good - 1 - from;
            if (size == 0) from = 0;
            memcpy(text + size, good + from, n < sizeof text - size ? n : sizeof text - size);
            size += n;
        }
        parse(text, size < sizeof text ? size : sizeof text, 0);
    }
}

TEST(failing_allocations)
{
    for (uint64_t n = 1;; n++) {
        svo_result result = parse(good, sizeof good - 1, n);
        if (test_failed()) return;
        if (result == SVO_OK) break;
        CHECK(result == SVO_OUT_OF_MEMORY && n < 1000);
    }
}
