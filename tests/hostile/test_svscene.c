/* Damaged .svscene files are refused with a message, or what is read from them is sound. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fmt_scene.h"
#include "hostile.h"
#include "rules_agree.h"
#include "packer.h"
#include "svo_pack.h"
#include "test.h"

static bool count_voxel(void *user, uint32_t x, uint32_t y, uint32_t z, uint64_t index)
{
    (void)x, (void)y, (void)z, (void)index;
    return --*(uint64_t *)user != 0;
}

/* Everything a renderer relies on. */
static bool sound(const svo_scene *s)
{
    uint64_t next = 0;
    for (uint32_t p = 0; p < s->page_count; p++) {
        const svo_scene_page *page = &s->pages[p];
        if (page->first != next || page->count == 0) return false;
        next += page->count;
        if (next > s->instance_count) return false;
        for (uint64_t i = page->first; i < next; i++) {
            svo_mat4 m = svo_scene_instance_transform(s, p, i), inverse;
            if (s->instance_asset[i] >= s->asset_count || !svo_mat4_affine_inverse(&m, &inverse)) return false;
            const char *name = svo_scene_instance_name(s, i);
            if (s->instance_name != NULL && (name < s->names || name + strlen(name) >= s->names + s->names_size)) return false;
            volatile uint64_t id = s->instance_id[i];
            (void)id;
        }
        for (int k = 0; k < 3; k++)
            if (!isfinite(page->low[k]) || !isfinite(page->high[k])) return false;
    }
    for (uint32_t a = 0; a < s->asset_count; a++) {
        uint64_t left = 5000;
        svo_view_voxels(s->assets[a], count_voxel, &left);
        if (left == 5000 || strlen(s->asset_names[a]) >= s->names_size) return false;
    }
    return next == s->instance_count;
}

static svo_result read_scene(void *user, const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    (void)user;
    fmt_scene f;
    svo_result r = fmt_scene_open(bytes, size, a, &f, err);
    const char *differ = rules_agree(fmt_scene_violations, bytes, size, a, r, err, false);
    if (differ != NULL) test_fail(__FILE__, __LINE__, "%s", differ);
    if (r != SVO_OK) return r;
    if (!sound(&f.scene)) test_fail(__FILE__, __LINE__, "a scene was accepted that is not sound");
    fmt_scene_close(&f);
    return SVO_OK;
}

static void value_of(void *user, uint32_t channel, uint32_t x, uint32_t y, uint32_t z, uint8_t *out)
{
    (void)user, (void)channel;
    out[0] = (uint8_t)(40 * x), out[1] = (uint8_t)(40 * y), out[2] = (uint8_t)(40 * z);
}

/* Two assets, `count` instances in pages of 4, names, a camera; every third instance is twisted, some of them sheared. */
static void make(uint64_t count, svo_buffer *file)
{
    static svo_error err;
    static svo_place places[64];
    uint64_t codes[20], seed = 8;
    svo_view *views[2];
    for (int a = 0; a < 2; a++) {
        for (int i = 0; i < 20; i++) codes[i] = test_random(&seed) % 4096;
        packer_options o = {.lod = true, .share = true, .channel_count = 1, .value = value_of};
        strcpy(o.channels[0].name, "color");
        o.channels[0].kind = SVO_KIND_COLOR_SRGB8;
        views[a] = packer_make(4, codes, 20, &o);
    }
    static const char names[] = "\0one\0two\0three";
    for (uint64_t i = 0; i < count; i++) {
        svo_mat4 m = svo_mat4_trs((double[3]){(double)i * 7, (double)(i % 5), 0.1}, (double[4]){0, (double)i, 1, 2}, (double[3]){1, 2, 1});
        memcpy(places[i].transform, m.m, sizeof places[i].transform);
        places[i].pose = i % 3 == 0 ? (uint32_t)(1 + i % 5) : 0;
        places[i].asset = i % 2, places[i].id = i, places[i].name = (uint32_t[4]){0, 1, 5, 9}[i % 4];
    }
    static const float matrices[24] = {1, 0.5f, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 2, 0, 0, 1, 0};
    svo_pose poses[5];
    for (int i = 0; i < 5; i++) {
        poses[i] = svo_pose_stated();
        poses[i].flags = SVO_POSE_TWIST | (i == 3 ? SVO_POSE_MATRIX : 0) | (i == 4 ? SVO_POSE_BONES : 0);
        poses[i].twist_axis = 1, poses[i].twist_angle = (float)i;
        if (i == 4) poses[i].bone_count = 2;
    }
    svo_pack_input in = {.asset_count = 2, .assets = (const svo_view *const[]){views[0], views[1]}, .asset_names = (const char *const[]){"first", "second"},
                         .place_count = count, .places = places, .names = names, .names_size = sizeof names,
                         .poses = {.count = 5, .pose = poses, .matrix_count = 2, .matrix = matrices},
                         .has_camera = true, .camera_transform = svo_mat4_identity(), .camera_yfov = 1};
    svo_pack_options o = {.page_instances = 4};
    svo_packed_scene *packed;
    fmt_output *out;
    CHECK_OK(svo_pack(&in, &o, &packed, &err));
    CHECK_OK(fmt_output_open_memory(file, &out, &err));
    CHECK_OK(fmt_scene_write(out, svo_packed_scene_get(packed), "{\"tool\":\"test\"}", NULL, NULL, NULL, &err));
    CHECK_OK(fmt_output_commit(out, &err));
    svo_packed_scene_free(packed);
    for (int a = 0; a < 2; a++) packer_free(views[a]);
}

static void run(uint64_t count, uint32_t rounds)
{
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    make(count, &file);
    if (test_failed()) return;
    hostile_case c = {.read = read_scene, .bytes = file.data, .size = file.size, .rounds = rounds, .seed = count};
    hostile_run(&c);
    svo_buffer_free(&file);
}

TEST(a_scene) { run(20, 4000); }
TEST(a_scene_without_instances) { run(0, 2000); }

/* Each rule broken by itself, with right hashes: the message names it. */
typedef struct breakage { const char *rule; uint32_t type; uint64_t offset; uint32_t size; uint8_t bytes[8]; } breakage;

TEST(every_rule_is_checked)
{
#define T(a, b, c, d) FMT_FOURCC(a, b, c, d)
    static const breakage cases[] = {
        {"SCN-02", T('H', 'E', 'A', 'D'), 0, 4, {3, 0, 0, 0}},
        {"SCN-02", T('H', 'E', 'A', 'D'), 4, 4, {6, 0, 0, 0}},
        {"SCN-02", T('H', 'E', 'A', 'D'), 8, 8, {19, 0, 0, 0}},
        {"SCN-02", T('H', 'E', 'A', 'D'), 8, 8, {20, 0, 0, 0, 0, 0, 0, 0x10}},
        {"SCN-02", T('H', 'E', 'A', 'D'), 16, 8, {1}},
        {"SCN-02", T('H', 'E', 'A', 'D'), 24, 1, {2}},
        {"SCN-02", T('H', 'E', 'A', 'D'), 24, 1, {0}}, /* there is a CAMR, so it must be missing */
        {"SCN-02", T('H', 'E', 'A', 'D'), 28, 1, {1}},
        {"SCN-05", T('H', 'E', 'A', 'D'), 32, 8, {0}},
        {"SCN-03", T('H', 'E', 'A', 'D'), 80, 4, {2, 0, 0, 0}},
        {"SCN-03", T('H', 'E', 'A', 'D'), 80, 4, {0xff, 0xff, 0xff, 0xff}},
        {"SCN-03", T('N', 'A', 'M', 'E'), 0, 1, {'x'}},
        {"SCN-03", T('N', 'A', 'M', 'E'), 1, 1, {0xc0}},
        {"SCN-04", T('P', 'A', 'G', 'E'), 72, 1, {1}},
        {"SCN-04", T('P', 'A', 'G', 'E'), 80, 1, {0}},
        {"SCN-04", T('P', 'A', 'G', 'E'), 88 + 80, 8, {0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff}},
        {"SCN-05", T('P', 'A', 'G', 'E'), 0, 8, {0, 0, 0, 0, 0, 0, 0xf0, 0x7f}},
        {"SCN-10", T('P', 'A', 'G', 'E'), 0, 8, {0, 0, 0, 0, 0, 0, 0xf8, 0x3f}},
        {"SCN-06", T('I', 'A', 'S', 'T'), 0, 4, {2, 0, 0, 0}},
        {"SCN-07", T('I', 'X', 'F', 'M'), 0, 4, {0, 0, 0x80, 0x7f}},
        {"SCN-07", T('I', 'X', 'F', 'M'), 4, 4, {0, 0, 0xc0, 0x7f}},
        {"SCN-03", T('I', 'N', 'A', 'M'), 0, 4, {2, 0, 0, 0}},
        {"SCN-11", T('I', 'P', 'O', 'S'), 0, 4, {99, 0, 0, 0}},
        {"SCN-12", T('P', 'O', 'S', 'E'), 0, 1, {0x10}},
        {"SCN-12", T('P', 'O', 'S', 'E'), 4, 1, {3}},
        {"SCN-12", T('P', 'O', 'S', 'E'), 20, 4, {0, 0, 0xc0, 0x7f}},
        {"SCN-12", T('P', 'O', 'S', 'E'), 56, 1, {1}},
        {"SCN-12", T('P', 'M', 'A', 'T'), 4, 4, {0, 0, 0x80, 0x7f}},
        {"SCN-13", T('P', 'H', 'S', 'H'), 8, 1, {0x5a}},
        {"SCN-13", T('I', 'I', 'D', 'S'), 0, 8, {0x77, 0x66}},
        {"SCN-09", T('C', 'A', 'M', 'R'), 0, 8, {0, 0, 0, 0, 0, 0, 0, 0}},
        {"SCN-09", T('C', 'A', 'M', 'R'), 128, 8, {0, 0, 0, 0, 0, 0, 0x10, 0x40}},
    };
    svo_buffer file;
    svo_buffer_init(&file, NULL);
    make(20, &file);
    if (test_failed()) return;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        hostile_file f;
        svo_buffer changed;
        svo_buffer_init(&changed, NULL);
        hostile_parse(file.data, file.size, &f);
        hostile_chunk *c = hostile_find(&f, cases[i].type);
        CHECK(c != NULL && cases[i].offset + cases[i].size <= c->payload.size);
        memcpy(c->payload.data + cases[i].offset, cases[i].bytes, cases[i].size);
        hostile_touch(c);
        hostile_build(&f, &changed);
        svo_error err = {0};
        fmt_scene s;
        svo_result result = fmt_scene_open(changed.data, changed.size, NULL, &s, &err);
        CHECK_MSG(result == SVO_INVALID_DATA && strstr(err.message, cases[i].rule) != NULL, "case %u (%s): %s, %s", (unsigned)i, cases[i].rule,
                  svo_result_name(result), result == SVO_OK ? "" : err.message);
        hostile_free(&f);
        svo_buffer_free(&changed);
    }
    svo_buffer_free(&file);
}

/* Violations that do not hang on each other are all found in one go, each once. */
TEST(all_violations_are_listed)
{
    static const breakage cases[] = {
        {"NAME 0: ", T('N', 'A', 'M', 'E'), 1, 1, {0xc0}},
        {"PAGE 1: ", T('P', 'A', 'G', 'E'), 88, 8, {0, 0, 0, 0, 0, 0, 0xf0, 0x7f}},
        {"IAST 0: ", T('I', 'A', 'S', 'T'), 0, 4, {2, 0, 0, 0}},
        {"IAST 19: ", T('I', 'A', 'S', 'T'), 76, 4, {9, 0, 0, 0}},
        {"IXFM 1: ", T('I', 'X', 'F', 'M'), 48, 4, {0, 0, 0x80, 0x7f}},
        {"IPOS 3: ", T('I', 'P', 'O', 'S'), 12, 4, {99, 0, 0, 0}},
        {"POSE 0: ", T('P', 'O', 'S', 'E'), 4, 1, {3}},
        {"PMAT 0: ", T('P', 'M', 'A', 'T'), 4, 4, {0, 0, 0x80, 0x7f}},
        {"CAMR 0: ", T('C', 'A', 'M', 'R'), 0, 8, {0, 0, 0, 0, 0, 0, 0, 0}},
        {"PHSH 4: ", T('P', 'H', 'S', 'H'), 32, 1, {0x5a}},
        {"asset 0 (SCN-08)", T('A', 'S', 'E', 'T'), 0, 1, {0}},
    };
    svo_buffer file, changed;
    svo_buffer_init(&file, NULL);
    svo_buffer_init(&changed, NULL);
    make(20, &file);
    if (test_failed()) return;
    hostile_file f;
    hostile_parse(file.data, file.size, &f);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        hostile_chunk *c = hostile_find(&f, cases[i].type);
        CHECK(c != NULL && cases[i].offset + cases[i].size <= c->payload.size);
        memcpy(c->payload.data + cases[i].offset, cases[i].bytes, cases[i].size);
        hostile_touch(c);
    }
    hostile_build(&f, &changed);
    const rules_text *t = rules_all(fmt_scene_violations, changed.data, changed.size);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const char *at = strstr(t->all, cases[i].rule);
        CHECK_MSG(at != NULL && strstr(at + 1, cases[i].rule) == NULL, "\"%s\" is not there once:\n%s", cases[i].rule, t->all);
    }
    hostile_free(&f);
    svo_buffer_free(&changed);
    svo_buffer_free(&file);
}

/* Bytes of one page, or of one asset, changed in place without a right hash: the rest opens, and is what it was. */
TEST(a_damaged_page_or_asset_leaves_the_rest)
{
    svo_buffer file;
    svo_error err = {0};
    svo_buffer_init(&file, NULL);
    make(20, &file);
    if (test_failed()) return;
    static const uint32_t arrays[] = {T('I', 'A', 'S', 'T'), T('I', 'X', 'F', 'M'), T('I', 'I', 'D', 'S'), T('I', 'N', 'A', 'M'), T('I', 'P', 'O', 'S'), T('A', 'S', 'E', 'T')};
    for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++) {
        fmt_container c;
        fmt_scene whole, part;
        fmt_scene_loss loss;
        CHECK_OK(fmt_scene_open(file.data, file.size, NULL, &whole, &err));
        svo_buffer bytes;
        svo_buffer_init(&bytes, NULL);
        CHECK(svo_buffer_append(&bytes, file.data, file.size) != NULL);
        CHECK_OK(fmt_container_open(bytes.data, bytes.size, NULL, &c, &err));
        const fmt_chunk *k = fmt_container_find(&c, arrays[i], true, 0);
        CHECK(k != NULL);
        bool asset = arrays[i] == T('A', 'S', 'E', 'T');
        memset(bytes.data + k->offset + (asset ? 200 : 6 * k->element_stride), 0xaa, 3); /* instance 6 is in page 1 */
        fmt_container_close(&c);
        CHECK_RESULT(fmt_scene_open(bytes.data, bytes.size, NULL, &part, &err), SVO_INVALID_DATA);
        CHECK_OK(fmt_scene_open_partly(bytes.data, bytes.size, NULL, &part, &loss, &err));
        if (asset) {
            CHECK_U64(loss.assets, 1);
            CHECK_U64(loss.pages, 0);
            CHECK_U64(loss.instances, 10);
        } else {
            CHECK_U64(loss.pages, 1);
            CHECK_U64(loss.assets, 0);
            CHECK_U64(loss.instances, 4);
            for (uint64_t n = 0; n < 16; n++) {
                uint64_t from = n < 4 ? n : n + 4;
                CHECK_U64(part.scene.instance_id[n], whole.scene.instance_id[from]);
                CHECK(memcmp(part.scene.instance_transform + 12 * n, whole.scene.instance_transform + 12 * from, 48) == 0);
            }
        }
        CHECK_U64(part.scene.instance_count, 20 - loss.instances);
        fmt_scene_close(&part);
        fmt_scene_close(&whole);
        svo_buffer_free(&bytes);
    }
    svo_buffer_free(&file);
}
