/* Scene descriptions in JSON: what they mean, and every way to get them wrong. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmt_scene_json.h"
#include "test.h"

static svo_error err;

static svo_result parse(const char *text, fmt_scene_json *out)
{
    return fmt_scene_json_parse((const uint8_t *)text, strlen(text), NULL, NULL, out, &err);
}

#define ASSETS "{\"assets\":[{\"name\":\"a\",\"file\":\"a.svdag\"},{\"name\":\"b\",\"file\":\"sub/b.obj\"}]"

static bool near(double a, double b) { return fabs(a - b) <= 1e-12 * (1 + fabs(b)); }

TEST(instances_mean_what_gltf_means)
{
    fmt_scene_json s;
    CHECK_OK(parse(ASSETS ",\"instances\":["
                   "{\"asset\":\"b\"},"
                   "{\"asset\":\"a\",\"translation\":[1,2,3],\"rotation\":[0,0,0.70710678118654757,0.70710678118654757],\"scale\":[2,3,4],"
                   "\"id\":77,\"name\":\"z\\u00fcrich\",\"pose\":null},"
                   "{\"asset\":\"a\",\"matrix\":[1,2,3,0, 4,5,6,0, 7,8,9.5,0, 10,11,12,1]}]}", &s));
    CHECK(s.asset_count == 2 && s.place_count == 3 && !s.has_camera);
    CHECK(strcmp(s.assets[0].name, "a") == 0 && strcmp(s.assets[0].file, "a.svdag") == 0 && strcmp(s.assets[1].file, "sub/b.obj") == 0);
    static const double identity[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
    CHECK(s.places[0].asset == 1 && s.places[0].id == 0 && s.places[0].name == 0 && memcmp(s.places[0].transform, identity, sizeof identity) == 0);
    /* a quarter turn about z after scaling: x -> 2y, y -> -3x */
    static const double turned[12] = {0, -3, 0, 1, 2, 0, 0, 2, 0, 0, 4, 3};
    for (int i = 0; i < 12; i++) CHECK(near(s.places[1].transform[i], turned[i]));
    CHECK(s.places[1].id == 77 && strcmp(s.names + s.places[1].name, "z\xc3\xbcrich") == 0);
    static const double rows[12] = {1, 4, 7, 10, 2, 5, 8, 11, 3, 6, 9.5, 12};
    CHECK(memcmp(s.places[2].transform, rows, sizeof rows) == 0 && s.places[2].id == 2);
    fmt_scene_json_free(&s);
}

TEST(order_of_keys_is_free)
{
    fmt_scene_json s;
    CHECK_OK(parse("\xef\xbb\xbf { \"instances\" : [ {\"asset\":\"y\"} , {\"asset\":\"x\"} ] ,\n \"camera\":{\"fov\":90},"
                   "\"assets\":[{\"file\":\"x.svo\",\"name\":\"x\"},{\"file\":\"y.svo\",\"name\":\"y\"}]}\n", &s));
    CHECK(s.place_count == 2 && strcmp(s.assets[s.places[0].asset].file, "y.svo") == 0 && strcmp(s.assets[s.places[1].asset].file, "x.svo") == 0);
    CHECK(s.has_camera && near(s.camera_yfov, acos(0)));
    fmt_scene_json_free(&s);
    CHECK_OK(parse("{\"assets\":[],\"instances\":[]}", &s));
    CHECK(s.asset_count == 0 && s.place_count == 0);
    fmt_scene_json_free(&s);
}

TEST(cameras_look_where_they_should)
{
    fmt_scene_json s;
    CHECK_OK(parse("{\"assets\":[],\"instances\":[],\"camera\":{\"eye\":[1,2,13],\"target\":[1,2,3],\"yfov\":0.5}}", &s));
    static const double straight[16] = {1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 13, 0, 0, 0, 1};
    for (int i = 0; i < 16; i++) CHECK(near(s.camera_transform.m[i], straight[i]));
    CHECK(s.camera_yfov == 0.5);
    fmt_scene_json_free(&s);
    CHECK_OK(parse("{\"assets\":[],\"instances\":[],\"camera\":{\"eye\":[4,5,6],\"target\":[-3,0,9],\"up\":[0.1,0.2,5]}}", &s));
    svo_vec3 z = svo_mat4_vector(&s.camera_transform, svo_v3(0, 0, -1)), to = svo_normalize(svo_v3(-7, -5, 3));
    CHECK(near(z.x, to.x) && near(z.y, to.y) && near(z.z, to.z) && near(svo_mat4_det3(&s.camera_transform), 1));
    svo_vec3 y = svo_mat4_vector(&s.camera_transform, svo_v3(0, 1, 0));
    CHECK(svo_dot(y, svo_v3(0.1, 0.2, 5)) > 0);
    fmt_scene_json_free(&s);
    CHECK_OK(parse("{\"assets\":[],\"instances\":[],\"camera\":{\"translation\":[4,5,6],\"rotation\":[0,1,0,0]}}", &s));
    CHECK(near(s.camera_transform.m[0], -1) && near(s.camera_transform.m[10], -1) && s.camera_transform.m[3] == 4);
    fmt_scene_json_free(&s);
}

typedef struct wrong_case { const char *text, *message; svo_result result; } wrong_case;

TEST(mistakes_are_named)
{
    static const wrong_case cases[] = {
        {"", "line 1", SVO_INVALID_DATA},
        {"[]", "'{'", SVO_INVALID_DATA},
        {"{", "key", SVO_INVALID_DATA},
        {"{}", "assets", SVO_INVALID_DATA},
        {"{\"assets\":[]}", "instances", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[]", "'}'", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[]}}", "after the end", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],}", "key", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"assets\":[]}", "assets: twice", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"lights\":[]}", "lights: unknown key", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{},\"camera\":{}}", "camera: twice", SVO_INVALID_DATA},
        {"{\"assets\":{},\"instances\":[]}", "assets: an array", SVO_INVALID_DATA},
        {"{\"assets\":[1],\"instances\":[]}", "assets[0]: an object", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\"}],\"instances\":[]}", "assets[0].file: missing", SVO_INVALID_DATA},
        {"{\"assets\":[{\"file\":\"a\"}],\"instances\":[]}", "assets[0].name", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"\",\"file\":\"a\"}],\"instances\":[]}", "assets[0].name", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":1,\"file\":\"a\"}],\"instances\":[]}", "assets[0].name: a string", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"a\",\"lod\":1}],\"instances\":[]}", "assets[0].lod: unknown key", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"/etc/passwd\"}],\"instances\":[]}", "relative", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"c:/a.obj\"}],\"instances\":[]}", "relative", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"..\\\\a.obj\"}],\"instances\":[]}", "relative", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"../a.obj\"}],\"instances\":[]}", "leaves", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"b/../../a.obj\"}],\"instances\":[]}", "leaves", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"b/..\"}],\"instances\":[]}", "leaves", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"\"}],\"instances\":[]}", "empty", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\",\"file\":\"a\"},{\"name\":\"a\",\"file\":\"b\"}],\"instances\":[]}", "assets[1].name: another", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"a\\u0000b\",\"file\":\"b\"}],\"instances\":[]}", "line 1: assets[0]", SVO_INVALID_DATA},
        {"{\"assets\":[{\"name\":\"\xff\",\"file\":\"b\"}],\"instances\":[]}", "line 1: assets[0]", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\"},\n{\"asset\":\"c\"}]}", "instances[1].asset: there is no asset named 'c'", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\"},\n\n{\"asset\":\"a\",}]}", "line 3: instances[1]", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"asset\":\"a\"}]}", "duplicate", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\"} {\"asset\":\"a\"}]}", "','", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{}]}", "instances[0].asset: missing", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"colour\":1}]}", "instances[0].colour: unknown key", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":[1]}]}", "instances[0].pose: an object", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":\"p\"}]}", "instances[0].pose: there is no pose", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"twirl\":1}}]}", "instances[0].pose.twirl: unknown key", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"twist\":{}}}]}", "instances[0].pose.twist.degrees: missing", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"twist\":{\"degrees\":1,\"from\":2}}}]}", "twist.from", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"twist\":{\"axis\":\"w\",\"degrees\":1}}}]}", "twist.axis", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"bend\":{\"axis\":\"y\",\"degrees\":1}}}]}", "bend.towards", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"shear\":{\"xx\":1}}}]}", "shear.xx", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"shear\":{\"xy\":1e39}}}]}", "shear.xy", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"bones\":[{\"bone\":65536}]}}]}", "bones.bone", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"pose\":{\"bones\":[{\"bone\":1,\"pivot\":[0,0,0],\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}]}}]}", "excludes", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[],\"poses\":[{\"name\":\"p\"}]}", "poses come before", SVO_INVALID_DATA},
        {ASSETS ",\"poses\":[{\"twist\":{\"degrees\":1}}],\"instances\":[]}", "poses[0].name: missing", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"id\":-1}]}", "instances[0].id", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"id\":1.5}]}", "instances[0].id", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"id\":9223372036854775808}]}", "instances[0]", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"translation\":[1,2]}]}", "instances[0].translation: an array of 3", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"translation\":[1,2,\"3\"]}]}", "instances[0].translation", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"translation\":[1,2,1e999]}]}", "instances[0]", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"translation\":[1,2,NaN]}]}", "instances[0]", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"rotation\":[0,0,0,0]}]}", "instances[0].rotation", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0]}]}", "instances[0].matrix: an array of 16", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"matrix\":[1,0,0,5,0,1,0,0,0,0,1,0,0,0,0,1]}]}", "instances[0].matrix: is not affine", SVO_INVALID_DATA},
        {ASSETS ",\"instances\":[{\"asset\":\"a\",\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],\"scale\":[1,1,1]}]}", "excludes", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"yfov\":4}}", "camera.yfov", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"fov\":0}}", "camera.fov", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"fov\":10,\"yfov\":1}}", "excludes", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"eye\":[0,0,0]}}", "camera.target: missing", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"eye\":[0,0,0],\"target\":[0,0,0]}}", "camera.target", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"eye\":[0,0,0],\"target\":[0,9,0]}}", "camera.up", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"eye\":[0,0,0],\"target\":[0,0,1],\"translation\":[0,0,0]}}", "excludes", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"scale\":[1,1,1]}}", "camera.scale", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"matrix\":[0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,1]}}", "singular", SVO_INVALID_DATA},
        {"{\"assets\":[],\"instances\":[],\"camera\":{\"near\":1}}", "camera.near: unknown key", SVO_INVALID_DATA},
        {"{\"asset\":{\"version\":\"2.0\"}}", "asset: unknown key", SVO_INVALID_DATA},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        fmt_scene_json s;
        memset(&err, 0, sizeof err);
        svo_result result = parse(cases[i].text, &s);
        CHECK_MSG(result == cases[i].result && err.code == result, "%s: %s (%s)", cases[i].text, svo_result_name(result), err.message);
        CHECK_MSG(strstr(err.message, cases[i].message) != NULL, "%s: '%s' does not say '%s'", cases[i].text, err.message, cases[i].message);
    }
}

TEST(elements_have_a_size)
{
    size_t size = FMT_SCENE_JSON_ELEMENT_BYTES + 400;
    char *text = malloc(size);
    int n = snprintf(text, size, ASSETS ",\"instances\":[{\"asset\":\"a\",\"name\":\"");
    memset(text + n, 'x', FMT_SCENE_JSON_ELEMENT_BYTES);
    strcpy(text + n + FMT_SCENE_JSON_ELEMENT_BYTES, "\"}]}");
    fmt_scene_json s;
    CHECK_RESULT(parse(text, &s), SVO_INVALID_DATA);
    CHECK(strstr(err.message, "instances[0]: is longer than 64 KiB") != NULL);
    free(text);
}

/* Deep nesting must neither crash nor be read. */
TEST(nesting_is_limited)
{
    char *text = calloc(1, 70000);
    strcpy(text, ASSETS ",\"instances\":[{\"asset\":");
    memset(text + strlen(text), '[', 60000);
    fmt_scene_json s;
    CHECK_RESULT(parse(text, &s), SVO_INVALID_DATA);
    free(text);
}

TEST(a_hundred_thousand_instances_take_memory_by_the_instance)
{
    uint64_t n = 100000, size = 0, capacity = n * 120 + 200;
    char *text = malloc(capacity);
    size += (uint64_t)snprintf(text, capacity, "{\"instances\":[");
    for (uint64_t i = 0; i < n; i++)
        size += (uint64_t)snprintf(text + size, capacity - size, "%s{\"asset\":\"a%u\",\"translation\":[%u,0.25,-%u],\"scale\":[1,2,3],\"name\":\"n%u\"}",
                                   i != 0 ? "," : "", (unsigned)(i % 100), (unsigned)i, (unsigned)i, (unsigned)i);
    size += (uint64_t)snprintf(text + size, capacity - size, "],\"assets\":[");
    for (unsigned a = 0; a < 100; a++) size += (uint64_t)snprintf(text + size, capacity - size, "%s{\"name\":\"a%u\",\"file\":\"%u.svo\"}", a ? "," : "", a, a);
    strcpy(text + size, "]}");
    svo_limit_allocator a;
    svo_limit_allocator_init(&a, (uint64_t)1 << 40, NULL);
    fmt_scene_json s;
    CHECK_OK(fmt_scene_json_parse((const uint8_t *)text, strlen(text), &a.base, NULL, &s, &err));
    CHECK_U64(s.place_count, n);
    for (uint64_t i = 0; i < n; i++) {
        char name[16];
        snprintf(name, sizeof name, "n%u", (unsigned)i);
        CHECK(s.places[i].transform[3] == (double)i && s.places[i].asset == i % 100 && strcmp(s.names + s.places[i].name, name) == 0);
    }
    CHECK(svo_limit_peak(&a) < n * 112 * 3); /* (the array grows by half, old and new together) */
    fmt_scene_json_free(&s);
    CHECK_U64(svo_limit_in_use(&a), 0);
    free(text);
}

TEST(poses_are_read)
{
    fmt_scene_json s;
    memset(&err, 0, sizeof err);
    CHECK_OK(parse(ASSETS ",\"poses\":[{\"name\":\"wave\",\"bend\":{\"axis\":\"y\",\"towards\":\"z\",\"degrees\":180,\"from\":0,\"to\":2},\"pivot\":[1,2,3]}],"
                          "\"instances\":[{\"asset\":\"a\",\"pose\":\"wave\"},{\"asset\":\"a\",\"pose\":{\"twist\":{\"radians\":1},\"scale\":[1,2,3],\"shear\":{\"xy\":5}}},"
                          "{\"asset\":\"b\",\"pose\":null},{\"asset\":\"b\",\"pose\":{\"bones\":[{\"bone\":2,\"rotation\":[0,0,1,0],\"pivot\":[1,0,0]}]}}]}",
                   &s));
    CHECK_U64(s.poses.count, 3);
    CHECK_U64(s.places[0].pose, 1);
    CHECK_U64(s.places[1].pose, 2);
    CHECK_U64(s.places[2].pose, 0);
    CHECK_U64(s.places[3].pose, 3);
    const svo_pose *p = s.poses.pose;
    CHECK(p[0].flags == SVO_POSE_BEND && p[0].bend_axis == 1 && p[0].bend_towards == 2 && fabsf(p[0].bend_angle - 3.14159265f) < 1e-6f);
    CHECK(p[0].bend_from == 0 && p[0].bend_to == 2 && p[0].pivot[2] == 3);
    CHECK(p[1].flags == (SVO_POSE_TWIST | SVO_POSE_MATRIX) && p[1].twist_angle == 1 && isnan(p[1].twist_from) && isnan(p[1].pivot[0]));
    const float *m = s.poses.matrix + 12 * p[1].matrix; /* scale first, then shear: x' = x + 5 * 2 y */
    CHECK(m[0] == 1 && m[1] == 10 && m[5] == 2 && m[10] == 3);
    CHECK(p[2].flags == SVO_POSE_BONES && p[2].bone_count == 3);
    m = s.poses.matrix + 12 * (p[2].bone_first + 2); /* half a turn about z through (1, 0, 0) */
    CHECK(fabsf(m[0] + 1) < 1e-6f && fabsf(m[3] - 2) < 1e-6f && fabsf(m[5] + 1) < 1e-6f);
    CHECK(svo_pose_matrix_is_identity(s.poses.matrix + 12 * p[2].bone_first));
    fmt_scene_json_free(&s);
}
