/* What is inside takes values of the nearest triangle of the mesh, which may belong to another bin than the one that is worked on. Such a triangle is read
 * alone, and stands in a mesh of its own that has the materials and images of the whole: the same code, so the same values. */
#include <string.h>

#include "svo_soup.h"
#include "svoi_shade.h"
#include "svoi_voxelize.h"

struct svoi_far {
    const svo_allocator *allocator;
    const svo_placement *whole;
    const svo_soup_layout *layouts; /* by group */
    uint64_t *starts;      /* for all groups' soups: number of the first triangle of each piece, in the part */
    uint64_t start_count;
    uint64_t *group_start; /* by group: where in starts those of its soup are */
};

/* A mesh of one triangle, and a shader that means it. */
typedef struct svoi_single {
    svo_mesh mesh;
    svo_shape shape;
    svo_part part;
    svo_instance instance;
    svo_group group;
    svo_placement placement;
    svo_shader shader;
    bool mirrored;
    double positions[9];
    float normals[9], uvs[SVO_MAX_UV_SETS][6], colors[12];
    uint32_t indices[3];
    uint8_t record[SVO_SOUP_MAX_STRIDE];
} svoi_single;

static uint64_t piece_count(const svo_part *part) { return part->soup != NULL ? part->soup->pieces.size / sizeof(svo_soup_piece) : 0; }

svo_result svoi_far_create(const svo_placement *whole, const svo_soup_layout *layouts, const svo_allocator *a, struct svoi_far **out, svo_error *err)
{
    struct svoi_far *f = svo_calloc(a, 1, sizeof *f);
    if (f == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    f->allocator = a;
    f->whole = whole;
    f->layouts = layouts;
    const uint64_t groups = whole->group_count;
    f->group_start = svo_alloc(a, groups, sizeof *f->group_start);
    for (int pass = 0; pass < 2; pass++) {
        uint64_t n = 0;
        for (uint64_t g = 0; g < groups && f->group_start != NULL; g++) {
            const svo_part *part = whole->groups[g].part;
            if (g > 0 && whole->groups[g - 1].part == part) { /* instances of one shape of one part */
                f->group_start[g] = f->group_start[g - 1];
                continue;
            }
            f->group_start[g] = n;
            uint64_t first = 0;
            for (uint64_t i = 0; i < piece_count(part); i++, n++) {
                if (pass == 1) f->starts[n] = first;
                first += ((const svo_soup_piece *)(const void *)part->soup->pieces.data)[i].count;
            }
        }
        if (pass == 0 && n != 0) f->starts = svo_alloc(a, n, sizeof *f->starts);
        f->start_count = n;
        if (n != 0 && f->starts == NULL) break;
    }
    if ((groups != 0 && f->group_start == NULL) || (f->start_count != 0 && f->starts == NULL)) {
        svoi_far_free(f);
        return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory");
    }
    *out = f;
    return SVO_OK;
}

void svoi_far_free(struct svoi_far *f)
{
    if (f == NULL) return;
    svo_free(f->allocator, f->starts, f->start_count, sizeof *f->starts);
    svo_free(f->allocator, f->group_start, f->whole->group_count, sizeof *f->group_start);
    svo_free(f->allocator, f, 1, sizeof *f);
}

static svo_result read_record(const struct svoi_far *f, uint32_t group, uint64_t local, uint8_t *record, svo_error *err)
{
    const svo_part *part = f->whole->groups[group].part;
    if (part->soup == NULL) {
        svo_soup_pack(&f->layouts[group], part, local, record);
        return SVO_OK;
    }
    const uint64_t *starts = f->starts + f->group_start[group];
    uint64_t low = 0, high = piece_count(part); /* last piece whose first <= local */
    while (high - low > 1) {
        const uint64_t mid = low + (high - low) / 2;
        if (starts[mid] <= local) low = mid;
        else high = mid;
    }
    return svo_soup_read(part->soup, (const svo_soup_piece *)(const void *)part->soup->pieces.data + low, local - starts[low], 1, record, err);
}

svo_result svoi_far_facet(svoi_run *r, svoi_worker *w, uint32_t triangle, svo_error *err)
{
    const struct svoi_far *f = r->far;
    if (w->single == NULL) w->single = svo_calloc(r->allocator, 1, sizeof *w->single);
    svoi_single *s = w->single;
    if (s == NULL) return svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory while voxelizing");
    const uint32_t group = svo_placement_group(f->whole, triangle);
    const svo_group *g = &f->whole->groups[group];
    const svo_soup_layout *l = &f->layouts[group];
    SVO_TRY(read_record(f, group, triangle - g->first, s->record, err));
    s->part = (svo_part){.material = g->part->material, .vertex_count = 3, .triangle_count = 1, .positions = s->positions, .indices = s->indices};
    if (l->normals) s->part.normals = s->normals;
    if (l->colors) s->part.colors = s->colors;
    for (uint32_t u = 0; u < SVO_MAX_UV_SETS; u++)
        if (l->uvs[u]) s->part.uvs[u] = s->uvs[u];
    for (uint32_t k = 0; k < 3; k++) s->indices[k] = k;
    svo_soup_unpack(l, s->record, &s->part, 0);
    s->shape = (svo_shape){.part_count = 1, .parts = &s->part};
    s->instance.transform = f->whole->mesh->instances[g->instance].transform;
    s->mesh = (svo_mesh){.allocator = r->allocator, .material_count = f->whole->mesh->material_count, .materials = f->whole->mesh->materials, .image_count = f->whole->mesh->image_count,
                         .images = f->whole->mesh->images, .shape_count = 1, .shapes = &s->shape, .instance_count = 1, .instances = &s->instance};
    s->group = (svo_group){0, &s->part, 0, g->identity};
    s->placement = (svo_placement){&s->mesh, r->allocator, &s->group, 1, 1};
    s->shader = *r->shader;
    s->mirrored = svo_mat4_det3(&s->instance.transform) < 0;
    s->shader.mirrored = &s->mirrored;
    s->shader.instance_count = 1;
    s->shader.placement = &s->placement;
    svo_facet_make_points(&s->shader, 0, &w->nearest);
    return SVO_OK;
}

void svoi_far_free_single(const svoi_run *r, svoi_worker *w) { svo_free(r->allocator, w->single, 1, sizeof *w->single); }
