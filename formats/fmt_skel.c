/* .skel files; docs/format/skel.md. */
#include "fmt_skel.h"

#include <math.h>
#include <string.h>

enum { HEAD_SIZE = 256, JOINT_SIZE = 40, BONE_SIZE = 8, MAJOR = 1, MINOR = 0 };
#define TYPE_HEAD FMT_FOURCC('H', 'E', 'A', 'D')
#define TYPE_JOINT FMT_FOURCC('J', 'O', 'I', 'N')
#define TYPE_BONE FMT_FOURCC('B', 'O', 'N', 'E')
#define TYPE_MAP FMT_FOURCC('V', 'M', 'A', 'P')
static const uint32_t known[] = {TYPE_HEAD, TYPE_JOINT, TYPE_BONE, TYPE_MAP, FMT_TYPE_META};

static void store_f64(uint8_t *p, double v)
{
    uint64_t bits;
    if (v == 0) v = 0; /* no -0 in files */
    memcpy(&bits, &v, 8);
    fmt_store64(p, bits);
}

static double load_f64(const uint8_t *p)
{
    double v;
    uint64_t bits = fmt_load64(p);
    memcpy(&v, &bits, 8);
    return v;
}

/* --- HEAD: one table for both directions -------------------------------------------------------------------------- */

typedef struct head_f64 { size_t at, member; } head_f64;
#define F64(at, name) {at, offsetof(skel_report, name)}
static const head_f64 head_doubles[] = {
    F64(8, omega), F64(16, delta), F64(24, centre[0]), F64(32, centre[1]), F64(40, centre[2]), F64(48, unit), F64(64, final_movement_sum),
    F64(72, final_movement_max), F64(80, thinness_error), F64(88, surface_distance_mean), F64(96, surface_distance_max),
    F64(104, reconstruction_mean), F64(112, reconstruction_max),
};
static const head_f64 head_u64s[] = {F64(56, iterations), F64(120, tessellated_vertices), F64(128, tessellated_triangles), F64(136, mapped_count)};
static const head_f64 head_u32s[] = {
    F64(144, components), F64(148, ends), F64(152, branches), F64(156, loops), F64(160, isolated), F64(164, leftover_triangles),
    F64(168, voxel_level), F64(172, voxel_depth),
};
#undef F64
enum { HEAD_ZERO_FROM = 176 };
#define COUNT_OF(a) (sizeof(a) / sizeof *(a))

static void head_store(const skel_report *r, uint8_t b[HEAD_SIZE])
{
    memset(b, 0, HEAD_SIZE);
    b[0] = (uint8_t)r->source;
    b[1] = (uint8_t)r->method;
    b[2] = (uint8_t)r->normalize;
    b[3] = (uint8_t)r->place;
    fmt_store32(b + 4, r->converged ? 1 : 0);
    const char *base = (const char *)r;
    for (size_t i = 0; i < COUNT_OF(head_doubles); i++) {
        double v;
        memcpy(&v, base + head_doubles[i].member, 8);
        store_f64(b + head_doubles[i].at, v);
    }
    for (size_t i = 0; i < COUNT_OF(head_u64s); i++) {
        uint64_t v;
        memcpy(&v, base + head_u64s[i].member, 8);
        fmt_store64(b + head_u64s[i].at, v);
    }
    for (size_t i = 0; i < COUNT_OF(head_u32s); i++) {
        uint32_t v;
        memcpy(&v, base + head_u32s[i].member, 4);
        fmt_store32(b + head_u32s[i].at, v);
    }
}

static const char *head_load(const uint8_t *b, skel_report *r)
{
    memset(r, 0, sizeof *r);
    if (b[0] > SKEL_SOURCE_VOXELS || b[1] > SKEL_METHOD_LITERAL || b[2] > SKEL_NORMALIZE_BOX || b[3] > SKEL_PLACE_INSIDE)
        return "an enumeration has an unknown value (SKL-02)";
    if (fmt_load32(b + 4) > 1) return "unknown flags (SKL-02)";
    for (int i = HEAD_ZERO_FROM; i < HEAD_SIZE; i++)
        if (b[i] != 0) return "reserved bytes are not 0 (SKL-02)";
    r->source = (skel_source)b[0];
    r->method = (skel_method)b[1];
    r->normalize = (skel_normalize)b[2];
    r->place = (skel_place)b[3];
    r->converged = fmt_load32(b + 4) == 1;
    char *base = (char *)r;
    for (size_t i = 0; i < COUNT_OF(head_doubles); i++) {
        double v = load_f64(b + head_doubles[i].at);
        memcpy(base + head_doubles[i].member, &v, 8);
    }
    for (size_t i = 0; i < COUNT_OF(head_u64s); i++) {
        uint64_t v = fmt_load64(b + head_u64s[i].at);
        memcpy(base + head_u64s[i].member, &v, 8);
    }
    for (size_t i = 0; i < COUNT_OF(head_u32s); i++) {
        uint32_t v = fmt_load32(b + head_u32s[i].at);
        memcpy(base + head_u32s[i].member, &v, 4);
    }
    if (r->source == SKEL_SOURCE_MESH && (r->voxel_level != 0 || r->voxel_depth != 0)) return "levels of voxels for a mesh (SKL-02)";
    if (r->voxel_level > r->voxel_depth || r->voxel_depth > SVO_MAX_DEPTH) return "levels of voxels out of range (SKL-02)";
    return NULL;
}

/* --- writing ------------------------------------------------------------------------------------------------------ */

static svo_result write_array(fmt_writer *w, uint32_t type, const svo_buffer *b, uint64_t count, uint32_t stride, svo_error *err)
{
    fmt_chunk c = {.type = type, .flags = FMT_CHUNK_CRITICAL, .stored_size = b->size, .decoded_size = b->size, .element_count = count, .element_stride = stride};
    return fmt_writer_chunk(w, &c, b->data, err);
}

static svo_result write_joints(fmt_writer *w, const skel_skeleton *s, svo_buffer *b, svo_error *err)
{
    b->size = 0;
    for (uint32_t j = 0; j < s->joint_count; j++) {
        uint8_t *p = svo_buffer_append(b, NULL, JOINT_SIZE);
        if (p == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the skeleton");
        for (int k = 0; k < 3; k++) store_f64(p + 8 * k, s->joints[j].position[k]);
        store_f64(p + 24, s->joints[j].radius);
        fmt_store32(p + 32, s->joints[j].component);
    }
    return write_array(w, TYPE_JOINT, b, s->joint_count, JOINT_SIZE, err);
}

static svo_result write_bones(fmt_writer *w, const skel_skeleton *s, svo_buffer *b, svo_error *err)
{
    b->size = 0;
    for (uint32_t i = 0; i < s->bone_count; i++) {
        uint8_t *p = svo_buffer_append(b, NULL, BONE_SIZE);
        if (p == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the skeleton");
        fmt_store32(p, s->bones[i].a);
        fmt_store32(p + 4, s->bones[i].b);
    }
    return write_array(w, TYPE_BONE, b, s->bone_count, BONE_SIZE, err);
}

static svo_result write_map(fmt_writer *w, const skel_skeleton *s, svo_buffer *b, svo_buffer *packed, svo_error *err)
{
    b->size = 0;
    if (s->map_count > SIZE_MAX / 4 || !svo_buffer_reserve(b, (size_t)s->map_count * 4)) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the map");
    for (uint64_t i = 0; i < s->map_count; i++) {
        uint8_t *p = svo_buffer_append(b, NULL, 4);
        if (p == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory to write the map");
        fmt_store32(p, s->map[i]);
    }
    if (b->size == 0) return write_array(w, TYPE_MAP, b, 0, 4, err);
    SVO_TRY(fmt_zstd_encode(NULL, b->data, b->size, 3, packed, err));
    fmt_chunk c = {.type = TYPE_MAP, .flags = FMT_CHUNK_CRITICAL, .codec = FMT_CODEC_ZSTD, .stored_size = packed->size, .decoded_size = b->size,
                   .element_count = s->map_count, .element_stride = 4};
    return fmt_writer_chunk(w, &c, packed->data, err);
}

svo_result fmt_skel_write(fmt_output *out, const skel_skeleton *s, const char *provenance, svo_error *err)
{
    svo_error why = {0};
    svo_result result = skel_check(s, &why);
    if (result == SVO_INVALID_DATA) return svo_fail(err, SVO_INVALID_ARGUMENT, "a skeleton that breaks a rule is not written: %s", why.message);
    if (result != SVO_OK) {
        if (err != NULL) *err = why;
        return result;
    }
    fmt_writer *w;
    SVO_TRY(fmt_writer_begin(out, FMT_KIND_SKEL, MAJOR, MINOR, &w, err));
    svo_buffer b, packed;
    svo_buffer_init(&b, s->allocator);
    svo_buffer_init(&packed, s->allocator);
    uint8_t head[HEAD_SIZE];
    head_store(&s->report, head);
    fmt_chunk c = {.type = TYPE_HEAD, .flags = FMT_CHUNK_CRITICAL, .stored_size = HEAD_SIZE, .decoded_size = HEAD_SIZE};
    result = fmt_writer_chunk(w, &c, head, err);
    if (result == SVO_OK) result = write_joints(w, s, &b, err);
    if (result == SVO_OK) result = write_bones(w, s, &b, err);
    if (result == SVO_OK) result = write_map(w, s, &b, &packed, err);
    if (result == SVO_OK) result = fmt_writer_meta(w, provenance, err);
    svo_buffer_free(&b);
    svo_buffer_free(&packed);
    if (result != SVO_OK) {
        fmt_writer_discard(w);
        return result;
    }
    return fmt_writer_end(w, err);
}

/* --- reading ------------------------------------------------------------------------------------------------------ */

static svo_result bad(const fmt_chunk *c, const char *what, svo_error *err) { return fmt_chunk_fail(err, SVO_INVALID_DATA, c->type, c->offset - 64, "%s", what); }

/* The four chunks in their order, with the right flags, ids and strides. */
static svo_result find_chunks(const fmt_container *f, const fmt_chunk *out[4], svo_error *err)
{
    static const uint32_t stride[4] = {0, JOINT_SIZE, BONE_SIZE, 4};
    uint32_t next = 0;
    for (uint32_t i = 0; i < f->chunk_count; i++) {
        const fmt_chunk *c = &f->chunks[i];
        SVO_TRY(fmt_chunk_known(c, known, COUNT_OF(known), err));
        if (c->type == FMT_TYPE_META || fmt_chunk_skip(c, known, COUNT_OF(known))) continue;
        if (next == 4 || c->type != known[next]) return bad(c, "HEAD, JOIN, BONE, VMAP must come in this order, once each (SKL-01)", err);
        if ((c->flags & FMT_CHUNK_CRITICAL) == 0 || c->id != 0 || c->element_stride != stride[next] || (next < 3 && c->codec != FMT_CODEC_NONE))
            return bad(c, "wrong flags, codec, id or stride (SKL-01)", err);
        if (next == 0 && (c->stored_size != HEAD_SIZE || c->element_count != 0)) return bad(c, "HEAD is not 256 bytes (SKL-01)", err);
        if (next > 0 && (c->decoded_size % stride[next] != 0 || c->element_count != c->decoded_size / stride[next]))
            return bad(c, "element count and size do not agree (SKL-01)", err);
        out[next++] = c;
    }
    if (next < 4) return svo_fail(err, SVO_INVALID_DATA, "the file lacks one of HEAD, JOIN, BONE, VMAP (SKL-01)");
    if (out[1]->element_count == 0 || out[1]->element_count >= SVO_NONE || out[2]->element_count >= SVO_NONE)
        return bad(out[1], "number of joints or bones out of range (SKL-04)", err);
    return SVO_OK;
}

static svo_result read_graph(const fmt_container *f, const fmt_chunk *const chunk[4], skel_skeleton *s, svo_rules *rules, svo_error *err)
{
    const uint8_t *p;
    SVO_TRY(fmt_container_payload(f, chunk[0], &p, err));
    const char *why = head_load(p, &s->report);
    if (why != NULL) SVO_TRY(svo_go_on(rules, bad(chunk[0], why, err), err));
    SVO_TRY(fmt_container_payload(f, chunk[1], &p, err));
    s->joints = svo_alloc(s->allocator, chunk[1]->element_count, sizeof *s->joints);
    if (s->joints == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the joints");
    s->joint_count = (uint32_t)chunk[1]->element_count;
    for (uint32_t j = 0; j < s->joint_count; j++, p += JOINT_SIZE) {
        for (int k = 0; k < 3; k++) s->joints[j].position[k] = load_f64(p + 8 * k);
        s->joints[j].radius = load_f64(p + 24);
        s->joints[j].component = fmt_load32(p + 32);
        if (fmt_load32(p + 36) != 0) SVO_TRY(svo_go_on(rules, bad(chunk[1], "reserved bytes are not 0 (SKL-02)", err), err));
    }
    if (chunk[2]->element_count == 0) return SVO_OK;
    SVO_TRY(fmt_container_payload(f, chunk[2], &p, err));
    s->bones = svo_alloc(s->allocator, chunk[2]->element_count, sizeof *s->bones);
    if (s->bones == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the bones");
    s->bone_count = (uint32_t)chunk[2]->element_count;
    for (uint32_t b = 0; b < s->bone_count; b++, p += BONE_SIZE) s->bones[b] = (skel_bone){fmt_load32(p), fmt_load32(p + 4)};
    return SVO_OK;
}

static svo_result read_map(const fmt_container *f, const fmt_chunk *c, skel_skeleton *s, svo_error *err)
{
    s->report.input_count = c->element_count;
    const uint8_t *p;
    SVO_TRY(fmt_container_stored(f, c, &p, err)); /* checks the hash of an empty one too */
    if (c->element_count == 0 && c->codec == FMT_CODEC_NONE) return SVO_OK;
    svo_buffer b;
    svo_buffer_init(&b, s->allocator);
    svo_result result = SVO_OK;
    if (c->codec == FMT_CODEC_ZSTD) {
        result = fmt_zstd_decode(NULL, p, (size_t)c->stored_size, c->decoded_size, &b, err);
        p = b.data;
    }
    if (result == SVO_OK && c->element_count > 0) {
        s->map = svo_alloc(s->allocator, c->element_count, sizeof *s->map);
        if (s->map == NULL) {
            result = svo_fail(err, SVO_OUT_OF_MEMORY, "no memory for the map");
        } else {
            s->map_count = c->element_count;
            for (uint64_t i = 0; i < s->map_count; i++) s->map[i] = fmt_load32(p + 4 * i);
        }
    }
    svo_buffer_free(&b);
    return result;
}

static svo_result check_kind(const fmt_container *f, svo_error *err)
{
    if (f->kind != FMT_KIND_SKEL) return svo_fail(err, SVO_INVALID_DATA, "this is not a .skel file");
    if (f->major != MAJOR) return svo_fail(err, SVO_UNSUPPORTED, "version %u.%u of .skel; this program reads version %d", f->major, f->minor, MAJOR);
    return SVO_OK;
}

/* Rules that the reader checks while it reads end there; those of the graph and the map are looked at one by one. */
svo_result fmt_skel_violations(const uint8_t *data, uint64_t size, const svo_allocator *a, svo_rules *rules, svo_error *err)
{
    fmt_container f;
    svo_error here = {0};
    if (err == NULL) err = &here;
    svo_result result = fmt_container_open(data, size, a, &f, err);
    if (result != SVO_OK) return svo_go_on(rules, result, err);
    skel_skeleton s = {.allocator = a};
    const fmt_chunk *chunk[4];
    char *text = NULL;
    result = check_kind(&f, err);
    if (result == SVO_OK) result = find_chunks(&f, chunk, err);
    if (result == SVO_OK) result = read_graph(&f, chunk, &s, rules, err);
    if (result == SVO_OK) result = read_map(&f, chunk[3], &s, err);
    if (result == SVO_OK) result = skel_check_all(&s, rules, err);
    if (result == SVO_OK) result = fmt_container_meta(&f, a, &text, err);
    fmt_meta_free(a, text);
    skel_skeleton_free(&s);
    fmt_container_close(&f);
    return svo_go_on(rules, result, err);
}

svo_result fmt_skel_read(const uint8_t *data, uint64_t size, const svo_allocator *a, skel_skeleton *out, char **provenance, svo_error *err)
{
    fmt_container f;
    SVO_TRY(fmt_container_open(data, size, a, &f, err));
    skel_skeleton s = {.allocator = a};
    char *text = NULL;
    const fmt_chunk *chunk[4];
    svo_result result = check_kind(&f, err);
    if (result == SVO_OK) result = find_chunks(&f, chunk, err);
    if (result == SVO_OK) result = read_graph(&f, chunk, &s, NULL, err);
    if (result == SVO_OK) result = read_map(&f, chunk[3], &s, err);
    if (result == SVO_OK) result = skel_check(&s, err);
    if (result == SVO_OK) result = fmt_container_meta(&f, a, &text, err);
    fmt_container_close(&f);
    if (result != SVO_OK) {
        skel_skeleton_free(&s);
        return result;
    }
    *out = s;
    if (provenance != NULL) *provenance = text;
    else fmt_meta_free(a, text);
    return SVO_OK;
}
