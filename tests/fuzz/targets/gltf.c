/* .gltf and .glb with everything inside, skins and animations too; files beside it are never there. */
#include <math.h>

#include "fmt_rig.h"

#define READER import_gltf
#include "mesh.h"

/* The counts and indices that fmt_rig.h promises, and every pose that it computes from them. */
static void check_rig(const fmt_rig *r, const svo_mesh *mesh)
{
    if (r->shape_count != mesh->shape_count || r->instance_count != mesh->instance_count) fuzz_fail("a rig of another mesh");
    for (uint32_t i = 0; i < r->node_count; i++)
        if (r->order[i] >= r->node_count || (r->nodes[i].parent != SVO_NONE && r->nodes[i].parent >= r->node_count)) fuzz_fail("node %u", i);
    for (uint32_t i = 0; i < r->instance_count; i++)
        if (r->instance_node[i] >= r->node_count) fuzz_fail("the node of instance %u", i);
    for (uint32_t s = 0; s < r->shape_count; s++) {
        const fmt_rig_shape *shape = &r->shapes[s];
        if (shape->skin != SVO_NONE && (shape->skin >= r->skin_count || shape->part_count != mesh->shapes[s].part_count)) fuzz_fail("the skin of shape %u", s);
        for (uint32_t p = 0; p < shape->part_count; p++) {
            const fmt_rig_part *part = &shape->parts[p];
            if (part->influences != NULL && part->vertex_count != mesh->shapes[s].parts[p].vertex_count) fuzz_fail("part %u of shape %u", p, s);
            for (uint64_t v = 0; part->influences != NULL && v < part->vertex_count; v++)
                for (uint32_t k = 0; k < SVO_SKIN_BONES; k++) {
                    const svo_influence *f = &part->influences[v];
                    if (!(f->weight[k] >= 0 && f->weight[k] < INFINITY)) fuzz_fail("a weight of %g", (double)f->weight[k]);
                    if (f->weight[k] > 0 && f->bone[k] != SVO_SKIN_REST && f->bone[k] >= r->skins[shape->skin].joint_count) fuzz_fail("bone %u", f->bone[k]);
                }
        }
    }
}

static void pose(const fmt_rig *r, const svo_allocator *a)
{
    svo_mat4 *world = svo_calloc(a, r->node_count, sizeof *world);
    if (world == NULL) return;
    volatile double sum = 0;
    for (uint32_t n = 0; n <= r->animation_count; n++) {
        const fmt_rig_animation *moves = n < r->animation_count ? &r->animations[n] : NULL;
        for (int k = 0; k < 3; k++) {
            fmt_rig_world(r, moves != NULL ? n : SVO_NONE, moves != NULL ? moves->begin + (moves->end - moves->begin) * 0.5 * k : 0, world);
            for (uint32_t s = 0; s < r->skin_count; s++)
                for (uint32_t j = 0; j < r->skins[s].joint_count; j++) sum += fmt_rig_joint(r, s, j, world).m[3];
            if (moves == NULL) break;
        }
        if (moves != NULL && fmt_rig_find(r, moves->name) > n) fuzz_fail("animation %u is not found by its name", n);
    }
    for (uint32_t s = 0; s < r->skin_count; s++) sum += fmt_rig_place(r, s).m[3];
    (void)sum;
    svo_free(a, world, r->node_count, sizeof *world);
}

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    svo_result plain = read_mesh(bytes, size, a, "/nowhere/", err);
    if (plain == SVO_LIMIT) return plain;
    svo_error second = {0};
    fmt_rig rig = {0};
    import_context c = {.path = "fuzz", .folder = "/nowhere/", .allocator = a, .max_file_bytes = 1 << 20, .max_image_pixels = 1 << 16, .rig = &rig};
    svo_mesh mesh = {.allocator = a};
    svo_result r = import_gltf(&c, bytes, size, &mesh, &second);
    if (r == SVO_OK) {
        const char *fault = import_mesh_fault(&mesh);
        if (fault != NULL) fuzz_fail("accepted with its rig, but not sound: %s", fault);
        check_rig(&rig, &mesh);
        pose(&rig, a);
    }
    svo_mesh_free(&mesh);
    fmt_rig_free(&rig);
    if (plain == SVO_OK && r != SVO_OK) *err = second; /* a broken animation is an error only where it is asked for */
    return plain != SVO_OK ? plain : r;
}

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20, .opens_files = true};
