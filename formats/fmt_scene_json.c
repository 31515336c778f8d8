/* The outer object and its two arrays are walked here; each element goes through jansson by itself and is freed before
 * the next one, so that a million instances cost what is kept of them and not a tree of JSON nodes. */
#include "fmt_scene_json.h"

#include <jansson.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "fmt_memory.h"
#include "fmt_utf8.h"
#include "fmti_pose_json.h"
#include "svo_mesh.h"
#include "svo_text.h"

#define MAX_ASSETS (1u << 20)
#define DEFAULT_FOV_DEGREES 45.0
#define PI 3.14159265358979323846

typedef struct parser {
    const char *text; /* whole input; not NUL-terminated */
    uint64_t size, at;
    const svo_allocator *allocator;
    svo_warnings *warnings;
    svo_error *err;
    svo_buffer assets, places, names;
    uint64_t *first_use; /* instance that first named an asset, +1; 0 = none; `slots` / 2 entries */
    uint32_t *slot;      /* open addressing: asset number + 1 */
    uint32_t slots;      /* power of two, more than twice the assets */
    bool seen_assets, seen_instances, seen_poses;
    svo_buffer poses, matrices, clips;
    svo_buffer pose_names;   /* uint32_t each: offset into `names` of the name of shared pose i */
    fmt_scene_json *out;
    char where[96]; /* path of the element in work, e.g. instances[3] */
} parser;

static fmt_scene_json_asset *asset_at(const parser *p, uint32_t i) { return (fmt_scene_json_asset *)(void *)p->assets.data + i; }
static uint32_t asset_count(const parser *p) { return (uint32_t)(p->assets.size / sizeof(fmt_scene_json_asset)); }

/* ---- errors ---- */

static uint64_t line_at(const parser *p, uint64_t at)
{
    uint64_t line = 1;
    for (uint64_t i = 0; i < at && i < p->size; i++) line += p->text[i] == '\n';
    return line;
}

/* Messages quote bytes of the file, which may be anything, and may cut a character in two. */
static svo_result refuse(parser *p, svo_result result, uint64_t at)
{
    if (p->err != NULL) {
        fmt_utf8_repair(p->err->message);
        p->err->offset = at;
    }
    return result;
}

static svo_result syntax(parser *p, const char *expected)
{
    svo_fail(p->err, SVO_INVALID_DATA, "line %llu: %s", (unsigned long long)line_at(p, p->at), expected);
    return refuse(p, SVO_INVALID_DATA, p->at);
}

static svo_result wrong(parser *p, const char *key, const char *what)
{
    svo_fail(p->err, SVO_INVALID_DATA, "%s%s%.64s: %s", p->where, p->where[0] != 0 && key[0] != 0 ? "." : "", key, what);
    return refuse(p, SVO_INVALID_DATA, p->at);
}

static svo_result no_memory(parser *p) { return svo_fail(p->err, SVO_OUT_OF_MEMORY, "no memory for the scene description"); }

/* ---- tokens of the outer object ---- */

static void skip_space(parser *p)
{
    while (p->at < p->size && (p->text[p->at] == ' ' || p->text[p->at] == '\t' || p->text[p->at] == '\n' || p->text[p->at] == '\r')) p->at++;
}

static bool accept(parser *p, char c)
{
    skip_space(p);
    if (p->at >= p->size || p->text[p->at] != c) return false;
    p->at++;
    return true;
}

/* One JSON object that begins at p->at. */
static svo_result load_object(parser *p, json_t **out)
{
    skip_space(p);
    if (p->at >= p->size || p->text[p->at] != '{') return wrong(p, "", "an object is expected");
    uint64_t room = p->size - p->at;
    bool cut = room > FMT_SCENE_JSON_ELEMENT_BYTES;
    json_error_t e;
    *out = json_loadb(p->text + p->at, (size_t)(cut ? FMT_SCENE_JSON_ELEMENT_BYTES : room), JSON_DISABLE_EOF_CHECK | JSON_REJECT_DUPLICATES, &e);
    if (*out != NULL) {
        p->at += (uint64_t)e.position;
        return SVO_OK;
    }
    if (json_error_code(&e) == json_error_out_of_memory) return no_memory(p);
    if (cut && json_error_code(&e) == json_error_premature_end_of_input) return wrong(p, "", "is longer than 64 KiB");
    unsigned long long line = (unsigned long long)(line_at(p, p->at) + (e.line > 0 ? (uint64_t)e.line - 1 : 0));
    svo_fail(p->err, SVO_INVALID_DATA, "line %llu: %s: %s", line, p->where, e.text);
    return refuse(p, SVO_INVALID_DATA, p->at + (e.position > 0 ? (uint64_t)e.position : 0));
}

/* A key of the outer object. They are plain words, so escapes need no decoding: a key with one is unknown. */
static svo_result load_key(parser *p, char key[40])
{
    if (!accept(p, '"')) return syntax(p, "a key in quotes is expected");
    uint64_t begin = p->at;
    while (p->at < p->size && p->text[p->at] != '"' && (unsigned char)p->text[p->at] >= 0x20 && p->text[p->at] != '\\' && p->at - begin < 32) p->at++;
    if (p->at >= p->size) return syntax(p, "the file ends within a key");
    snprintf(key, 40, "%.*s", (int)(p->at - begin), p->text + begin);
    if (p->text[p->at] != '"') return wrong(p, "", "a key of the outer object is none of assets, poses, instances, camera");
    p->at++;
    if (!accept(p, ':')) return syntax(p, "':' is expected after a key");
    return SVO_OK;
}

/* ---- values ---- */

static svo_result numbers(parser *p, const char *key, const json_t *value, size_t count, double *out)
{
    char what[64];
    snprintf(what, sizeof what, "an array of %u numbers is expected", (unsigned)count);
    if (!json_is_array(value) || json_array_size(value) != count) return wrong(p, key, what);
    for (size_t i = 0; i < count; i++) {
        const json_t *v = json_array_get(value, i);
        if (!json_is_number(v) || !isfinite(json_number_value(v))) return wrong(p, key, what);
        out[i] = json_number_value(v);
    }
    return SVO_OK;
}

static svo_result text(parser *p, const char *key, const json_t *value, const char **out)
{
    if (!json_is_string(value)) return wrong(p, key, "a string is expected");
    *out = json_string_value(value);
    return SVO_OK;
}

/* glTF's node transform: matrix (16, column-major), or translation, rotation, scale. */
typedef struct pose_keys {
    bool has_matrix, has_trs;
    double matrix[16], t[3], q[4], s[3];
} pose_keys;

static const pose_keys identity_keys = {.q = {0, 0, 0, 1}, .s = {1, 1, 1}};

/* *taken tells whether the key was one of a transform. */
static svo_result transform_key(parser *p, const char *key, const json_t *value, pose_keys *k, bool *taken)
{
    *taken = true;
    if (strcmp(key, "matrix") == 0) {
        k->has_matrix = true;
        SVO_TRY(numbers(p, key, value, 16, k->matrix));
        if (k->matrix[3] != 0 || k->matrix[7] != 0 || k->matrix[11] != 0 || k->matrix[15] != 1)
            return wrong(p, key, "is not affine: elements 3, 7, 11 and 15 (column-major) must be 0, 0, 0 and 1");
        return SVO_OK;
    }
    k->has_trs = true;
    if (strcmp(key, "translation") == 0) return numbers(p, key, value, 3, k->t);
    if (strcmp(key, "rotation") == 0) {
        SVO_TRY(numbers(p, key, value, 4, k->q));
        double big = fmax(fmax(fabs(k->q[0]), fabs(k->q[1])), fmax(fabs(k->q[2]), fabs(k->q[3])));
        if (!(big > 1e-100) || big > 1e100) return wrong(p, key, "a unit quaternion x, y, z, w is expected");
        double n = sqrt(k->q[0] * k->q[0] + k->q[1] * k->q[1] + k->q[2] * k->q[2] + k->q[3] * k->q[3]);
        if (fabs(n - 1) > 1e-3) svo_warn(p->warnings, "a rotation is not a unit quaternion and was normalised");
        return SVO_OK;
    }
    if (strcmp(key, "scale") == 0) return numbers(p, key, value, 3, k->s);
    *taken = k->has_trs = false;
    return SVO_OK;
}

static svo_result transform_of(parser *p, const pose_keys *k, svo_mat4 *out)
{
    if (k->has_matrix && k->has_trs) return wrong(p, "matrix", "excludes translation, rotation and scale");
    if (!k->has_matrix) *out = svo_mat4_trs(k->t, k->q, k->s);
    else
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) out->m[4 * i + j] = k->matrix[4 * j + i];
    return SVO_OK;
}

/* ---- assets ---- */

static svo_result grow_slots(parser *p)
{
    uint32_t slots = p->slots == 0 ? 64 : p->slots * 2;
    uint32_t *slot = svo_calloc(p->allocator, slots, sizeof *slot);
    uint64_t *first_use = svo_calloc(p->allocator, slots / 2, sizeof *first_use);
    if (slot == NULL || first_use == NULL) {
        svo_free(p->allocator, slot, slots, sizeof *slot);
        svo_free(p->allocator, first_use, slots / 2, sizeof *first_use);
        return no_memory(p);
    }
    for (uint32_t i = 0; i < asset_count(p); i++) {
        uint64_t size, s = svo_text_hash(asset_at(p, i)->name, &size) & (slots - 1);
        while (slot[s] != 0) s = (s + 1) & (slots - 1);
        slot[s] = i + 1;
        first_use[i] = p->first_use[i];
    }
    svo_free(p->allocator, p->slot, p->slots, sizeof *p->slot);
    svo_free(p->allocator, p->first_use, p->slots / 2, sizeof *p->first_use);
    p->slot = slot, p->first_use = first_use, p->slots = slots;
    return SVO_OK;
}

/* Number of the asset with a name; it is added, without a file, when it is new: instances may come before assets. */
static svo_result find_asset(parser *p, const char *name, uint32_t *out)
{
    if (asset_count(p) + 1 >= p->slots / 2) SVO_TRY(grow_slots(p));
    uint64_t size, s = svo_text_hash(name, &size) & (p->slots - 1);
    while (p->slot[s] != 0 && strcmp(asset_at(p, p->slot[s] - 1)->name, name) != 0) s = (s + 1) & (p->slots - 1);
    if (p->slot[s] == 0) {
        if (asset_count(p) == MAX_ASSETS) return svo_fail(p->err, SVO_LIMIT, "more than %u assets", MAX_ASSETS);
        fmt_scene_json_asset asset = {svo_string_copy(p->allocator, name), NULL};
        if (asset.name == NULL || svo_buffer_append(&p->assets, &asset, sizeof asset) == NULL) {
            svo_string_free(p->allocator, asset.name);
            return no_memory(p);
        }
        p->slot[s] = asset_count(p);
    }
    *out = p->slot[s] - 1;
    return SVO_OK;
}

/* What is wrong with a path in a scene, or NULL. */
static const char *path_fault(const char *path)
{
    if (path[0] == 0) return "the path is empty";
    if (path[0] == '/' || strchr(path, '\\') != NULL || (path[1] == ':' && ((path[0] | 32) >= 'a' && (path[0] | 32) <= 'z')))
        return "the path must be relative to the scene's folder, with '/' between names";
    for (const char *s = path; s != NULL; s = strchr(s, '/'), s = s != NULL ? s + 1 : NULL)
        if (s[0] == '.' && s[1] == '.' && (s[2] == 0 || s[2] == '/')) return "the path leaves the scene's folder";
    return NULL;
}

static svo_result read_asset(parser *p, const json_t *o)
{
    const char *name = NULL, *file = NULL, *key;
    json_t *value;
    json_object_foreach((json_t *)o, key, value)
    {
        if (strcmp(key, "name") == 0) SVO_TRY(text(p, key, value, &name));
        else if (strcmp(key, "file") == 0) SVO_TRY(text(p, key, value, &file));
        else return wrong(p, key, "unknown key");
    }
    if (name == NULL || name[0] == 0) return wrong(p, "name", "missing or empty");
    if (file == NULL) return wrong(p, "file", "missing");
    const char *fault = path_fault(file);
    if (fault != NULL) return wrong(p, "file", fault);
    uint32_t number;
    SVO_TRY(find_asset(p, name, &number));
    fmt_scene_json_asset *asset = asset_at(p, number);
    if (asset->file != NULL) return wrong(p, "name", "another asset has this name already");
    asset->file = svo_string_copy(p->allocator, file);
    return asset->file != NULL ? SVO_OK : no_memory(p);
}

/* ---- poses ---- */

static svo_result read_pose(parser *p, const char *key, const json_t *o, const char **name, svo_pose *pose, fmti_pose_clip *clip)
{
    fmti_pose_fault fault = {{0}, NULL};
    svo_result result = fmti_pose_parse(o, &p->matrices, pose, clip, name, &fault);
    if (result == SVO_OUT_OF_MEMORY) return no_memory(p);
    if (p->matrices.size / 64 > p->size + (1u << 20)) return svo_fail(p->err, SVO_LIMIT, "the bones of all poses take too much memory: give their numbers without large gaps");
    if (result == SVO_OK) return SVO_OK;
    char path[80];
    snprintf(path, sizeof path, "%s%s%.64s", key, key[0] != 0 && fault.key[0] != 0 ? "." : "", fault.key);
    return wrong(p, path, fault.what);
}

static svo_result add_pose(parser *p, const svo_pose *pose, const fmti_pose_clip *clip, uint32_t *number)
{
    uint64_t n = p->poses.size / sizeof *pose;
    if (n >= UINT32_MAX - 1) return svo_fail(p->err, SVO_LIMIT, "more than 2^32 - 2 poses");
    *number = (uint32_t)n;
    if (svo_buffer_append(&p->poses, pose, sizeof *pose) == NULL) return no_memory(p);
    if (!clip->given) return SVO_OK;
    fmt_scene_json_clip stored = {*number, 0, clip->time};
    if (clip->animation[0] != 0) {
        stored.animation = (uint32_t)p->names.size;
        if (p->names.size + sizeof clip->animation > UINT32_MAX) return svo_fail(p->err, SVO_LIMIT, "the names take more than 4 GiB");
        if (svo_buffer_append(&p->names, clip->animation, strlen(clip->animation) + 1) == NULL) return no_memory(p);
    }
    return svo_buffer_append(&p->clips, &stored, sizeof stored) != NULL ? SVO_OK : no_memory(p);
}

/* An element of "poses": a pose with a name, for instances to share. */
static svo_result read_shared_pose(parser *p, const json_t *o)
{
    const char *name = NULL;
    svo_pose pose;
    fmti_pose_clip clip;
    uint32_t number, offset;
    SVO_TRY(read_pose(p, "", o, &name, &pose, &clip));
    if (name == NULL || name[0] == 0) return wrong(p, "name", "missing or empty");
    if (p->seen_instances) return wrong(p, "name", "poses come before the instances that share them");
    if (p->names.size + strlen(name) + 1 > UINT32_MAX) return svo_fail(p->err, SVO_LIMIT, "the names take more than 4 GiB");
    SVO_TRY(add_pose(p, &pose, &clip, &number));
    offset = (uint32_t)p->names.size;
    bool stored = svo_buffer_append(&p->names, name, strlen(name) + 1) != NULL && svo_buffer_append(&p->pose_names, &offset, sizeof offset) != NULL;
    return stored ? SVO_OK : no_memory(p);
}

/* null, the name of a shared pose, or a pose of its own. *out is its number + 1. */
static svo_result instance_pose(parser *p, const json_t *value, uint32_t *out)
{
    if (json_is_null(value)) return SVO_OK;
    uint32_t number = 0;
    const char *name = json_string_value(value);
    if (name == NULL) {
        svo_pose pose;
        fmti_pose_clip clip;
        SVO_TRY(read_pose(p, "pose", value, NULL, &pose, &clip));
        SVO_TRY(add_pose(p, &pose, &clip, &number));
    } else {
        const uint32_t *offset = (const uint32_t *)(const void *)p->pose_names.data;
        uint32_t count = (uint32_t)(p->pose_names.size / sizeof *offset);
        while (number < count && strcmp((const char *)p->names.data + offset[number], name) != 0) number++;
        if (number == count) return wrong(p, "pose", "there is no pose of that name (poses come before instances)");
    }
    *out = number + 1;
    return SVO_OK;
}

/* ---- instances ---- */

static svo_result read_instance(parser *p, const json_t *o)
{
    uint64_t index = p->places.size / sizeof(svo_place);
    svo_place place = {.id = index};
    pose_keys keys = identity_keys;
    const char *asset = NULL, *name = NULL, *key;
    json_t *value;
    json_object_foreach((json_t *)o, key, value)
    {
        bool taken;
        if (strcmp(key, "asset") == 0) SVO_TRY(text(p, key, value, &asset));
        else if (strcmp(key, "name") == 0) SVO_TRY(text(p, key, value, &name));
        else if (strcmp(key, "id") == 0) {
            if (!json_is_integer(value) || json_integer_value(value) < 0) return wrong(p, key, "an integer from 0 to 2^63 - 1 is expected");
            place.id = (uint64_t)json_integer_value(value);
        } else if (strcmp(key, "pose") == 0) {
            SVO_TRY(instance_pose(p, value, &place.pose));
        } else {
            SVO_TRY(transform_key(p, key, value, &keys, &taken));
            if (!taken) return wrong(p, key, "unknown key");
        }
    }
    if (asset == NULL) return wrong(p, "asset", "missing");
    if (index >= UINT32_MAX) return svo_fail(p->err, SVO_LIMIT, "more than 2^32 - 1 instances");
    SVO_TRY(find_asset(p, asset, &place.asset));
    if (p->first_use[place.asset] == 0) p->first_use[place.asset] = index + 1;
    svo_mat4 m;
    SVO_TRY(transform_of(p, &keys, &m));
    memcpy(place.transform, m.m, sizeof place.transform);
    if (name != NULL && name[0] != 0) {
        size_t size = strlen(name) + 1;
        if (p->names.size + size > UINT32_MAX) return svo_fail(p->err, SVO_LIMIT, "the names of instances take more than 4 GiB");
        place.name = (uint32_t)p->names.size;
        if (svo_buffer_append(&p->names, name, size) == NULL) return no_memory(p);
    }
    return svo_buffer_append(&p->places, &place, sizeof place) != NULL ? SVO_OK : no_memory(p);
}

/* ---- camera ---- */

static svo_result look_at(parser *p, const double eye[3], const double target[3], const double up[3], svo_mat4 *out)
{
    svo_vec3 from = svo_v3(eye[0], eye[1], eye[2]);
    svo_vec3 back = svo_normalize(svo_sub(from, svo_v3(target[0], target[1], target[2])));
    svo_vec3 right = svo_cross(svo_normalize(svo_v3(up[0], up[1], up[2])), back);
    if (svo_length(back) == 0) return wrong(p, "target", "is where the eye is");
    if (svo_length(right) < 1e-6) return wrong(p, "up", "is zero or parallel to the view");
    right = svo_normalize(right);
    svo_vec3 high = svo_cross(back, right);
    svo_mat4 m = {{right.x, high.x, back.x, from.x, right.y, high.y, back.y, from.y, right.z, high.z, back.z, from.z, 0, 0, 0, 1}};
    *out = m;
    return SVO_OK;
}

static svo_result read_camera(parser *p, const json_t *o)
{
    pose_keys keys = identity_keys;
    double eye[3], target[3], up[3] = {0, 1, 0};
    bool has_eye = false, has_target = false, has_up = false, has_fov = false;
    double yfov = DEFAULT_FOV_DEGREES * PI / 180;
    const char *key;
    json_t *value;
    json_object_foreach((json_t *)o, key, value)
    {
        bool taken;
        if (strcmp(key, "eye") == 0) has_eye = true, taken = numbers(p, key, value, 3, eye) == SVO_OK;
        else if (strcmp(key, "target") == 0) has_target = true, taken = numbers(p, key, value, 3, target) == SVO_OK;
        else if (strcmp(key, "up") == 0) has_up = true, taken = numbers(p, key, value, 3, up) == SVO_OK;
        else if (strcmp(key, "yfov") == 0 || strcmp(key, "fov") == 0) {
            bool radians = key[0] == 'y';
            if (has_fov) return wrong(p, "yfov", "excludes fov: yfov is in radians, fov in degrees");
            if (!json_is_number(value)) return wrong(p, key, "a number is expected");
            has_fov = taken = true;
            yfov = json_number_value(value) * (radians ? 1 : PI / 180);
            if (!(yfov > 0) || !(yfov < PI)) return wrong(p, key, radians ? "must be above 0 and below pi" : "must be above 0 and below 180");
        } else {
            if (strcmp(key, "scale") == 0) return wrong(p, key, "a camera has no scale");
            SVO_TRY(transform_key(p, key, value, &keys, &taken));
            if (!taken) return wrong(p, key, "unknown key");
        }
        if (!taken) return SVO_INVALID_DATA; /* (numbers has said why) */
    }
    svo_mat4 inverse;
    if (has_eye || has_target || has_up) {
        if (!has_eye || !has_target) return wrong(p, has_eye ? "target" : "eye", "missing: eye and target come together");
        if (keys.has_matrix || keys.has_trs) return wrong(p, "eye", "excludes matrix, translation and rotation");
        SVO_TRY(look_at(p, eye, target, up, &p->out->camera_transform));
    } else SVO_TRY(transform_of(p, &keys, &p->out->camera_transform));
    if (!svo_mat4_affine_inverse(&p->out->camera_transform, &inverse)) return wrong(p, "matrix", "the camera's transform is singular");
    p->out->has_camera = true;
    p->out->camera_yfov = yfov;
    return SVO_OK;
}

/* ---- the outer object ---- */

static svo_result read_array(parser *p, const char *key, svo_result (*element)(parser *, const json_t *))
{
    if (!accept(p, '[')) return wrong(p, key, "an array is expected");
    if (accept(p, ']')) return SVO_OK;
    for (uint64_t i = 0;; i++) {
        snprintf(p->where, sizeof p->where, "%s[%llu]", key, (unsigned long long)i);
        json_t *o;
        SVO_TRY(load_object(p, &o));
        svo_result result = element(p, o);
        json_decref(o);
        SVO_TRY(result);
        p->where[0] = 0;
        if (accept(p, ']')) return SVO_OK;
        if (!accept(p, ',')) return syntax(p, "',' or ']' is expected after an element");
    }
}

static svo_result read_member(parser *p, const char *key)
{
    if (strcmp(key, "assets") == 0) {
        if (p->seen_assets) return wrong(p, key, "twice");
        p->seen_assets = true;
        return read_array(p, "assets", read_asset);
    }
    if (strcmp(key, "instances") == 0) {
        if (p->seen_instances) return wrong(p, key, "twice");
        p->seen_instances = true;
        return read_array(p, "instances", read_instance);
    }
    if (strcmp(key, "poses") == 0) {
        if (p->seen_poses) return wrong(p, key, "twice");
        p->seen_poses = true;
        return read_array(p, "poses", read_shared_pose);
    }
    if (strcmp(key, "camera") != 0) return wrong(p, key, "unknown key");
    if (p->out->has_camera) return wrong(p, key, "twice");
    snprintf(p->where, sizeof p->where, "camera");
    json_t *o;
    SVO_TRY(load_object(p, &o));
    svo_result result = read_camera(p, o);
    json_decref(o);
    p->where[0] = 0;
    return result;
}

static svo_result read_all(parser *p)
{
    if (svo_buffer_append(&p->names, "", 1) == NULL) return no_memory(p);
    if (p->size >= 3 && memcmp(p->text, "\xef\xbb\xbf", 3) == 0) p->at = 3;
    if (!accept(p, '{')) return syntax(p, "a scene is a JSON object: '{' is expected");
    bool more = !accept(p, '}');
    while (more) {
        char key[40];
        SVO_TRY(load_key(p, key));
        SVO_TRY(read_member(p, key));
        more = accept(p, ',');
        if (!more && !accept(p, '}')) return syntax(p, "',' or '}' is expected");
    }
    skip_space(p);
    if (p->at != p->size) return syntax(p, "text after the end of the scene");
    if (!p->seen_assets) return wrong(p, "assets", "missing");
    if (!p->seen_instances) return wrong(p, "instances", "missing");
    for (uint32_t i = 0; i < asset_count(p); i++)
        if (asset_at(p, i)->file == NULL) {
            snprintf(p->where, sizeof p->where, "instances[%llu]", (unsigned long long)(p->first_use[i] - 1));
            char what[96];
            snprintf(what, sizeof what, "there is no asset named '%.60s'", asset_at(p, i)->name);
            return wrong(p, "asset", what);
        }
    return SVO_OK;
}

svo_result fmt_scene_json_parse(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_warnings *warnings,
                                fmt_scene_json *out, svo_error *err)
{
    fmt_scene_json scene;
    memset(&scene, 0, sizeof scene);
    scene.allocator = a;
    parser p = {.text = (const char *)bytes, .size = size, .allocator = a, .warnings = warnings, .err = err, .out = &scene};
    svo_buffer_init(&p.assets, a);
    svo_buffer_init(&p.places, a);
    svo_buffer_init(&p.names, a);
    uint64_t failures = fmt_json_failures();
    svo_buffer_init(&p.poses, a);
    svo_buffer_init(&p.matrices, a);
    svo_buffer_init(&p.pose_names, a);
    svo_buffer_init(&p.clips, a);
    svo_result result = read_all(&p);
    if (fmt_json_failures() != failures) result = no_memory(&p); /* whatever it said */
    svo_free(a, p.slot, p.slots, sizeof *p.slot);
    svo_free(a, p.first_use, p.slots / 2, sizeof *p.first_use);
    scene.storage[0] = p.assets, scene.storage[1] = p.places, scene.storage[2] = p.names, scene.storage[3] = p.poses, scene.storage[4] = p.matrices, scene.storage[5] = p.clips;
    svo_buffer_free(&p.pose_names);
    scene.asset_count = asset_count(&p);
    scene.assets = (fmt_scene_json_asset *)(void *)p.assets.data;
    if (result != SVO_OK) {
        fmt_scene_json_free(&scene);
        return result;
    }
    scene.places = (const svo_place *)(const void *)p.places.data;
    scene.place_count = p.places.size / sizeof(svo_place);
    scene.names = (const char *)p.names.data;
    scene.names_size = p.names.size;
    scene.poses = (svo_poses){.count = (uint32_t)(p.poses.size / sizeof(svo_pose)), .pose = (const svo_pose *)(const void *)p.poses.data,
                              .matrix_count = p.matrices.size / (12 * sizeof(float)), .matrix = (const float *)(const void *)p.matrices.data};
    scene.clips = (const fmt_scene_json_clip *)(const void *)p.clips.data;
    scene.clip_count = p.clips.size / sizeof(fmt_scene_json_clip);
    *out = scene;
    return SVO_OK;
}

void fmt_scene_json_free(fmt_scene_json *s)
{
    if (s == NULL) return;
    for (uint32_t i = 0; i < s->asset_count; i++) {
        svo_string_free(s->allocator, s->assets[i].name);
        svo_string_free(s->allocator, s->assets[i].file);
    }
    for (int i = 0; i < 6; i++)
        if (s->storage[i].data != NULL) svo_buffer_free(&s->storage[i]);
    memset(s, 0, sizeof *s);
}
