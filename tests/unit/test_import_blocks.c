/* Text and rows are read in blocks, in parallel. The mesh, the warnings and the errors must not depend on how a file is
 * cut, or on threads: many odd files, each read whole and in blocks of a few bytes. */
#include <stdlib.h>

#include "import_check.h"

static uint64_t seed = 20;
static uint64_t below(uint64_t n) { return test_random(&seed) % n; }

typedef struct text { char *at; size_t size, capacity; } text;

static void add(text *t, const char *what)
{
    size_t n = strlen(what);
    if (t->size + n + 1 > t->capacity) return;
    memcpy(t->at + t->size, what, n + 1);
    t->size += n;
}

static void add_number(text *t, double v)
{
    char b[64];
    snprintf(b, sizeof b, below(8) == 0 ? "%.17g" : below(4) == 0 ? "%.3e" : "%g", v);
    add(t, b);
}

static void add_break(text *t) { add(t, below(10) == 0 ? "\r\n" : below(20) == 0 ? "  \n" : "\n"); }

static double coordinate(void) { return (double)below(2001) / 100 - 10; }

/* A blank between words, sometimes a line that continues. */
static void gap(text *t) { add(t, below(60) == 0 ? " \\\n" : below(30) == 0 ? "\\ \n  " : below(10) == 0 ? " \t " : " "); }

static void obj_vertex(text *t)
{
    add(t, below(20) == 0 ? "  v" : "v");
    uint32_t n = below(6) == 0 ? 6 : below(12) == 0 ? 4 : below(30) == 0 ? 7 : 3;
    for (uint32_t i = 0; i < n; i++) {
        gap(t);
        if (i < 3) add_number(t, coordinate());
        else add_number(t, below(50) == 0 ? 200 : (double)below(100) / 100);
    }
    if (below(20) == 0) add(t, " # comment");
    add_break(t);
}

static void obj_face(text *t, uint32_t vertices, uint32_t uvs, uint32_t normals, bool relative)
{
    add(t, below(40) == 0 ? "fo" : "f");
    uint32_t n = below(8) == 0 ? 2 + (uint32_t)below(6) : 3;
    int style = (int)below(4);
    for (uint32_t i = 0; i < n; i++) {
        char b[64];
        int64_t v = (int64_t)below(vertices), vt = uvs != 0 ? (int64_t)below(uvs) : 0, vn = normals != 0 ? (int64_t)below(normals) : 0;
        if (relative) v -= vertices, vt -= uvs, vn -= normals;
        else v++, vt++, vn++;
        gap(t);
        if (style == 0 || (uvs == 0 && normals == 0)) snprintf(b, sizeof b, "%lld", (long long)v);
        else if (style == 1 && uvs != 0) snprintf(b, sizeof b, "%lld/%lld", (long long)v, (long long)vt);
        else if (style == 2 && normals != 0) snprintf(b, sizeof b, "%lld//%lld", (long long)v, (long long)vn);
        else snprintf(b, sizeof b, "%lld/%lld/%lld", (long long)v, (long long)(uvs != 0 ? vt : v), (long long)(normals != 0 ? vn : v));
        add(t, b);
    }
    add_break(t);
}

static void obj_text(text *t)
{
    static const char *const others[] = {"", "   ", "# a comment", "# one that goes on \\", "g part", "o thing", "s 1", "p 1 2", "l 1 2 3", "usemtl red", "usemtl blue light",
                                         "usemtl", "mtllib none.mtl", "vp 1 2", "curv 0 1 1 2", "surf 1 2", "cstype bezier", "\\", "v", "vt", "fx", "nonsense \\"};
    uint32_t vertices = 0, uvs = 0, normals = 0;
    bool broken = below(5) == 0;
    t->size = 0;
    if (below(8) == 0) add(t, "\xef\xbb\xbf");
    for (uint32_t lines = (uint32_t)below(120); lines > 0; lines--) {
        uint64_t kind = below(10);
        if (kind < 4 || vertices == 0) {
            obj_vertex(t);
            vertices++;
        } else if (kind < 7) {
            obj_face(t, vertices, uvs, normals, below(3) == 0);
        } else if (kind == 7) {
            char b[64];
            bool uv = below(2) == 0;
            if (uv) snprintf(b, sizeof b, "vt 0.%u 0.%u", (unsigned)below(100), (unsigned)below(100)), uvs++;
            else snprintf(b, sizeof b, "vn 0.%u 1 -0.%u", (unsigned)below(100), (unsigned)below(100)), normals++;
            add(t, b);
            add_break(t);
        } else {
            add(t, others[below(sizeof others / sizeof *others)]);
            add_break(t);
        }
        if (broken && below(60) == 0) add(t, below(2) == 0 ? "v 1 two 3\n" : below(2) == 0 ? "f 1 -9999 2\n" : "f 1 2 99999\n");
    }
    if (below(3) == 0 && t->size > 0) t->at[--t->size] = 0; /* no line break at the end */
}

static void ply_ascii(text *t)
{
    uint32_t vertices = 3 + (uint32_t)below(60), faces = (uint32_t)below(60), extra = (uint32_t)below(3);
    bool colors = below(2) == 0, other = below(6) == 0, odd = below(3) == 0;
    char b[512];
    t->size = 0;
    snprintf(b, sizeof b, "ply\nformat ascii 1.0\ncomment x\n%selement vertex %u\nproperty float x\nproperty float y\nproperty float z\n%s",
             other ? "element camera 1\nproperty float a\n" : "", vertices, colors ? "property uchar red\nproperty uchar green\nproperty uchar blue\n" : "");
    add(t, b);
    snprintf(b, sizeof b, "element face %u\nproperty list uchar int vertex_indices\n%send_header\n", faces, extra == 0 ? "property int flags\n" : "");
    add(t, b);
    if (other) add(t, "17\n");
    for (uint32_t i = 0; i < vertices; i++) {
        for (int k = 0; k < 3; k++) {
            add_number(t, coordinate());
            add(t, odd && below(60) == 0 ? "\n" : " "); /* a row over two lines */
        }
        for (int k = 0; colors && k < 3; k++) {
            snprintf(b, sizeof b, " %u", (unsigned)below(256));
            add(t, b);
        }
        if (odd && below(30) == 0) add(t, " 7 8");
        add_break(t);
        if (odd && below(30) == 0) add(t, " \n\n");
    }
    for (uint32_t i = 0; i < faces; i++) {
        uint32_t n = odd && below(5) == 0 ? (uint32_t)below(7) : 3;
        snprintf(b, sizeof b, "%u", n);
        add(t, b);
        for (uint32_t k = 0; k < n; k++) {
            snprintf(b, sizeof b, "%s%u", odd && below(80) == 0 ? "\n" : " ", (unsigned)below(vertices + (odd && below(300) == 0 ? 5 : 0)));
            add(t, b);
        }
        if (extra == 0) add(t, " 5");
        add_break(t);
    }
    if (odd && below(4) == 0) t->size -= below(20);
    if (odd && below(4) == 0) add(t, "\n9 9 9\n");
}

static void put_number(text *t, const void *bytes, size_t n, bool big)
{
    const uint8_t *p = bytes;
    for (size_t i = 0; i < n && t->size < t->capacity; i++) t->at[t->size++] = (char)p[big ? n - 1 - i : i];
}

static void ply_binary(text *t)
{
    uint32_t vertices = 3 + (uint32_t)below(60), faces = (uint32_t)below(60), corners = 3 + (uint32_t)below(2);
    bool big = below(2) == 0, odd = below(3) == 0, wide = below(2) == 0;
    char b[512];
    t->size = 0;
    snprintf(b, sizeof b, "ply\nformat binary_%s_endian 1.0\nelement vertex %u\nproperty %s x\nproperty float y\nproperty float z\nproperty short q\n"
             "element face %u\nproperty list uchar %s vertex_indices\nend_header\n", big ? "big" : "little", vertices, wide ? "double" : "float", faces, wide ? "ushort" : "int");
    add(t, b);
    for (uint32_t i = 0; i < vertices; i++) {
        double d = coordinate();
        float f[3] = {(float)d, (float)coordinate(), (float)coordinate()};
        if (wide) put_number(t, &d, 8, big);
        else put_number(t, f, 4, big);
        put_number(t, f + 1, 4, big);
        put_number(t, f + 2, 4, big);
        put_number(t, "ab", 2, big);
    }
    for (uint32_t i = 0; i < faces; i++) {
        uint8_t n = (uint8_t)(odd && below(9) == 0 ? below(7) : corners);
        put_number(t, &n, 1, big);
        for (uint32_t k = 0; k < n; k++) {
            uint32_t v = (uint32_t)below(vertices + (odd && below(200) == 0 ? 5 : 0));
            uint16_t s = (uint16_t)v;
            if (wide) put_number(t, &s, 2, big);
            else put_number(t, &v, 4, big);
        }
    }
    if (odd && below(3) == 0) t->size -= below(20);
}

static void stl_ascii(text *t)
{
    bool odd = below(3) == 0;
    t->size = 0;
    add(t, "solid name of it\n");
    for (uint32_t i = (uint32_t)below(40); i > 0; i--) {
        add(t, "  facet normal 0 0 1\n    outer loop\n");
        for (uint32_t k = odd && below(10) == 0 ? 2 + (uint32_t)below(4) : 3; k > 0; k--) {
            add(t, odd && below(20) == 0 ? "vertex\n " : "      vertex ");
            for (int c = 0; c < 3; c++) {
                add_number(t, coordinate());
                add(t, " ");
            }
            add_break(t);
        }
        add(t, odd && below(40) == 0 ? "endloop endfacet\n" : odd && below(60) == 0 ? "endlop\n" : "    endloop\n  endfacet\n");
        if (odd && below(20) == 0) add(t, "endsolid x\nsolid y\n");
    }
    if (!odd || below(6) != 0) add(t, "endsolid name of it\n");
}

static bool same_array(const void *a, const void *b, size_t size)
{
    if ((a == NULL) != (b == NULL)) return false;
    return a == NULL || memcmp(a, b, size) == 0;
}

static const char *difference(const svo_mesh *a, const svo_mesh *b)
{
    if (a->shape_count != 1 || b->shape_count != 1 || a->shapes[0].part_count != b->shapes[0].part_count) return "the number of parts";
    if (a->material_count != b->material_count) return "the number of materials";
    for (uint32_t i = 0; i < a->shapes[0].part_count; i++) {
        const svo_part *p = &a->shapes[0].parts[i], *q = &b->shapes[0].parts[i];
        if (p->material != q->material) return "a material";
        if (p->vertex_count != q->vertex_count) return "the number of vertices";
        if (p->triangle_count != q->triangle_count) return "the number of triangles";
        size_t n = (size_t)p->vertex_count;
        if (!same_array(p->indices, q->indices, 12 * (size_t)p->triangle_count)) return "indices";
        if (!same_array(p->positions, q->positions, 24 * n)) return "positions";
        if (!same_array(p->normals, q->normals, 12 * n)) return "normals";
        if (!same_array(p->uvs[0], q->uvs[0], 8 * n)) return "texture coordinates";
        if (!same_array(p->colors, q->colors, 16 * n)) return "colours";
    }
    return NULL;
}

static const char *warnings_differ(const svo_warnings *a, const svo_warnings *b)
{
    if (a->count != b->count) return "the number of warnings";
    for (uint32_t i = 0; i < a->count; i++)
        if (strcmp(a->line[i].text, b->line[i].text) != 0) return "a warning";
    return NULL;
}

typedef struct outcome {
    svo_result result;
    svo_error err;
    svo_warnings warnings;
    svo_mesh mesh;
} outcome;

static void import(const char *path, uint64_t block, uint32_t threads, outcome *o)
{
    memset(o, 0, sizeof *o);
    fmt_import_options options = {.block_bytes = block, .threads = threads, .warnings = &o->warnings};
    o->result = fmt_import_mesh(path, &options, &o->mesh, &o->err);
}

static void compare_cuts(const char *name, const text *t, uint32_t round)
{
    const char *path = import_put(name, t->at, t->size);
    CHECK(path != NULL);
    static outcome whole, cut;
    import(path, 1 << 30, 1, &whole);
    const uint64_t blocks[] = {1, 1 + below(40), 1 + below(400)};
    for (size_t i = 0; i < sizeof blocks / sizeof *blocks; i++) {
        import(path, blocks[i], 1 + (uint32_t)below(3), &cut);
        const char *what = whole.result != cut.result ? "the result" : strcmp(whole.err.message, cut.err.message) != 0 ? "the error" : NULL;
        if (what == NULL && whole.result == SVO_OK) what = difference(&whole.mesh, &cut.mesh);
        if (what == NULL && whole.result == SVO_OK) what = warnings_differ(&whole.warnings, &cut.warnings);
        const char *fault = cut.result == SVO_OK ? import_mesh_fault(&cut.mesh) : NULL;
        if (cut.result == SVO_OK) svo_mesh_free(&cut.mesh);
        CHECK_MSG(what == NULL, "%s %u in blocks of %llu: %s differs (%s | %s)", name, round, (unsigned long long)blocks[i], what, whole.err.message, cut.err.message);
        CHECK_MSG(fault == NULL, "%s %u: %s", name, round, fault);
    }
    if (whole.result == SVO_OK) svo_mesh_free(&whole.mesh);
}

static void many(const char *name, void (*make)(text *), uint32_t rounds)
{
    static char bytes[1 << 16];
    text t = {.at = bytes, .capacity = sizeof bytes};
    for (uint32_t i = 0; i < rounds && !test_failed(); i++) {
        make(&t);
        compare_cuts(name, &t, i);
    }
}

TEST(obj) { many("blocks.obj", obj_text, 2000); }
TEST(ply_of_text) { many("text.ply", ply_ascii, 1000); }
TEST(ply_of_bytes) { many("bytes.ply", ply_binary, 1000); }
TEST(stl_of_text) { many("text.stl", stl_ascii, 1000); }

/* So many corners that positions are numbered in parallel: the order of first use, as without threads. */
TEST(order_of_first_use)
{
    enum { VERTICES = 30000, FACES = 70000 };
    size_t capacity = VERTICES * 32 + FACES * 32, n = 0;
    char *bytes = malloc(capacity);
    uint32_t *corner = malloc(3 * FACES * sizeof *corner), *number = malloc(VERTICES * sizeof *number);
    CHECK(bytes != NULL && corner != NULL && number != NULL);
    for (uint32_t i = 0; i < VERTICES; i++) n += (size_t)snprintf(bytes + n, capacity - n, "v %u 0 0\n", i);
    for (uint32_t i = 0; i < FACES; i++) {
        for (int k = 0; k < 3; k++) corner[3 * i + (uint32_t)k] = (uint32_t)below(VERTICES);
        n += (size_t)snprintf(bytes + n, capacity - n, "f %u %u %u\n", corner[3 * i] + 1, corner[3 * i + 1] + 1, corner[3 * i + 2] + 1);
    }
    const char *path = import_put("order.obj", bytes, n);
    static outcome o;
    import(path, 10000, 4, &o);
    bool right = o.result == SVO_OK && o.mesh.shapes[0].parts[0].triangle_count == FACES;
    uint32_t used = 0;
    memset(number, 0xff, VERTICES * sizeof *number);
    for (uint32_t i = 0; i < 3 * FACES && right; i++) {
        const svo_part *p = &o.mesh.shapes[0].parts[0];
        if (number[corner[i]] == UINT32_MAX) number[corner[i]] = used++;
        right = p->indices[i] == number[corner[i]] && p->positions[3 * (size_t)p->indices[i]] == (double)corner[i];
    }
    right = right && o.mesh.shapes[0].parts[0].vertex_count == used;
    if (o.result == SVO_OK) svo_mesh_free(&o.mesh);
    free(bytes);
    free(corner);
    free(number);
    CHECK(right);
}
