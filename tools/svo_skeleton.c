/* svo-skeleton: the curve skeleton of a mesh or of voxels. */
#include <malloc.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "skeleton.h"

static const char *const methods[] = {"fast", "literal", NULL};
static const char *const normalizations[] = {"ball", "box", NULL};
static const char *const searches[] = {"flann", "grid", NULL};
static const char *const places[] = {"centroid", "contracted", "inside", NULL};

static const char *const repairs[] = {"own", "cgal", NULL};
static const char *const tessellations[] = {"own", "openmesh", NULL};

static bool progress(void *user, double fraction)
{
    cli_progress(user, "contracting", fraction);
    return true;
}

static skel_options library_options(cli *c, const skeleton_options *o, const svo_allocator *a)
{
    skel_options s = skel_default_options();
    s.allocator = a;
    s.omega = o->omega;
    s.delta = o->delta;
    s.max_iterations = o->max_iterations;
    s.max_vertices = o->max_vertices;
    s.method = (skel_method)o->method;
    s.normalize = (skel_normalize)o->normalize;
    s.search = (skel_search)o->search;
    s.place = (skel_place)o->place;
    s.threads = (uint32_t)c->threads;
    s.keep_samples = o->bind != NULL;
    s.solid_divide = o->solid != NULL || o->reconstruct != NULL ? (uint32_t)o->solid_divide : 0;
    s.warnings = &c->warnings;
    s.progress = progress;
    s.user = c;
    return s;
}

/* How the file came about, for its META. NULL when out of memory. */
static char *provenance_of(const cli *c, const skeleton_options *o, json_t *inputs)
{
    json_t *how = json_object();
    cli_put_f64(how, "omega", o->omega);
    cli_put_f64(how, "delta", o->delta);
    if (o->max_iterations != 0) cli_put_u64(how, "max_iterations", o->max_iterations);
    cli_put_text(how, "method", methods[o->method]);
    cli_put_text(how, "normalize", normalizations[o->normalize]);
    cli_put_text(how, "place", places[o->place]);
    if (o->repair != REPAIR_OWN) cli_put_text(how, "repair", repairs[o->repair]);
    if (o->tessellate != TESSELLATE_OWN) cli_put_text(how, "tessellate", tessellations[o->tessellate]);
    if (o->refine != NULL) cli_put_text(how, "refine", o->refine);
    cli_put_axes(how, &o->axes);
    return cli_provenance(c, how, json_incref(inputs));
}

static svo_result run(cli *c, const skeleton_options *o, svo_error *err)
{
    svo_limit_allocator limit;
    mallopt(M_MMAP_THRESHOLD, 1 << 20); /* large arrays go back to the system when they are freed: a tenth less at the peak of large meshes, no slower on small ones */
    svo_limit_allocator_init(&limit, c->memory != 0 ? c->memory : UINT64_MAX, NULL);
    skeleton_outputs out = {0};
    skeleton_input in = {.provenance = json_array()};
    skel_skeleton s = {0};
    skel_options options = library_options(c, o, &limit.base);
    svo_result r = o->refine != NULL ? skel_refine_parse(o->refine, &limit.base, &options.refine, &options.refine_count, err) : SVO_OK;
    if (r == SVO_OK) r = skeleton_open_outputs(c, o, &out, err);
    if (r == SVO_OK) {
        cli_phase(c, "import");
        r = cli_about(c->inputs[0], skeleton_build(c, o, &options, c->memory != 0 ? &limit : NULL, &in, &s, err), err);
    }
    if (r == SVO_OK) {
        char *provenance = provenance_of(c, o, in.provenance);
        uint64_t bytes = 0;
        cli_phase(c, "write");
        r = provenance == NULL ? svo_fail(err, SVO_OUT_OF_MEMORY, "out of memory") : skeleton_write(c, o, &out, &in, &s, provenance, &bytes, err);
        cli_phase(c, NULL);
        free(provenance);
        if (r == SVO_OK) skeleton_report(c, &s, bytes);
        if (r == SVO_OK && options.refine_count > 0) skeleton_report_refined(c, &options);
    }
    skel_skeleton_free(&s);
    skel_refine_free(&limit.base, options.refine, options.refine_count);
    skeleton_input_free(&in);
    skeleton_discard_outputs(&out);
    if (r == SVO_OUT_OF_MEMORY && c->memory != 0) r = svo_fail(err, SVO_LIMIT, "--memory is too small for this model and omega");
    return r;
}

int main(int argc, char **argv)
{
    skeleton_options o = {.omega = skel_default_options().omega, .max_vertices = 8000000, .influences = 4, .smoothing = 8, .solid_divide = 2, .place = SKEL_PLACE_INSIDE};
    cli_option options[] = {
        {.name = "omega", .letter = 'w', .kind = CLI_DOUBLE, .value = &o.omega, .argument = "W", .min = SKEL_MIN_OMEGA, .max = SKEL_MAX_OMEGA, .group = "Curve",
         .help = "Feature size, as a part of the model's size: what is thinner is merged. 0.0125 keeps fingers, 0.025 is enough for limbs and several times as fast."},
        {.name = "place", .kind = CLI_CHOICE, .value = &o.place, .choices = places, .argument = "P", .group = "Curve",
         .help = "inside: joints in the middle of the solid, ends out to the tips, bones kept inside; centroid: of the surface that belongs to them; contracted: where they were contracted to."},
        {.name = "refine", .kind = CLI_TEXT, .value = &o.refine, .argument = "BONES@W", .no_default = true, .group = "Curve",
         .help = "Make these bones again with omega W: 3,7-12 (numbers without refinement), ends, thin:R, ball:X,Y,Z,R or box:X0,Y0,Z0,X1,Y1,Z1; several with ; between."},
        {.name = "up", .kind = CLI_CHOICE, .value = &o.axes.up, .choices = cli_axes_ups, .argument = "AXIS", .group = "Input", .help = "The axis of the mesh that points up; it becomes +Y, by quarter turns."},
        {.name = "unit", .kind = CLI_TEXT, .value = &o.axes.unit, .argument = "U", .no_default = true, .group = "Input",
         .help = "The mesh's unit of length, m km cm mm in ft or a number of metres: lengths become metres. Without it they stay as they are."},
        {.name = "repair", .kind = CLI_CHOICE, .value = &o.repair, .choices = repairs, .argument = "BY", .group = "Input",
         .help = "own: points at one place are one, triangles at one place are one, nothing else is needed; cgal: CGAL's repair of polygon soups before (turns triangles, cuts apart what is no manifold), with its counts in the report."},
        {.name = "tessellate", .kind = CLI_CHOICE, .value = &o.tessellate, .choices = tessellations, .argument = "BY", .group = "Input",
         .help = "How edges of omega and longer are cut: own, in rounds; openmesh: by OpenMesh, the longest first, slower and with about as many vertices."},
        {.name = "normalize", .kind = CLI_CHOICE, .value = &o.normalize, .choices = normalizations, .argument = "N", .group = "Input",
         .help = "The model's size: diameter of its enclosing ball / 1.15, which no rotation changes, or longest side of its box."},
        {.name = "max-vertices", .kind = CLI_U64, .value = &o.max_vertices, .argument = "N", .min = 1, .max = 2e9, .group = "Input",
         .help = "Most vertices that the mesh may have when its edges have been cut to omega (about 600 bytes each)."},
        {.name = "method", .kind = CLI_CHOICE, .value = &o.method, .choices = methods, .argument = "M", .group = "Contraction",
         .help = "fast: vertices that have met are welded on the way, and long runs go on with momentum; literal: the thesis' iteration on every vertex."},
        {.name = "search", .kind = CLI_CHOICE, .value = &o.search, .choices = searches, .argument = "S", .group = "Contraction",
         .help = "Neighbour search; both give the same result."},
        {.name = "delta", .kind = CLI_DOUBLE, .value = &o.delta, .argument = "D", .min = 0, .max = 1e9, .group = "Contraction",
         .help = "Stop when the movements of all vertices in a sweep sum up to less (0.05 in the thesis); 0: when no vertex moves by omega/1000 for 8 sweeps."},
        {.name = "max-iterations", .kind = CLI_U64, .value = &o.max_iterations, .argument = "N", .min = 1, .max = 1e9, .no_default = true, .group = "Contraction",
         .help = "Sweeps after which to stop, converged or not; a warning and the report say so. Without it 6000, and up to 20000 while at most 2000 vertices are left, which take little time."},
        {.name = "obj", .kind = CLI_TEXT, .value = &o.obj, .argument = "OUT.obj", .no_default = true, .group = "Output", .help = "Write the curve as OBJ lines too."},
        {.name = "swc", .kind = CLI_TEXT, .value = &o.swc, .argument = "OUT.swc", .no_default = true, .group = "Output",
         .help = "Write the curve as trees with radii (SWC) too."},
        {.name = "segments", .kind = CLI_TEXT, .value = &o.segments, .argument = "OUT.ply", .no_default = true, .group = "Output",
         .help = "Write the mesh as PLY with a colour for each branch of the curve."},
        {.name = "glb", .kind = CLI_TEXT, .value = &o.glb, .argument = "OUT.glb", .no_default = true, .group = "Skinned model",
         .help = "Write the mesh with joints and weights as skinned glTF too (of voxels: the curve as lines)."},
        {.name = "influences", .kind = CLI_U64, .value = &o.influences, .argument = "N", .min = 1, .max = SKEL_MAX_INFLUENCES, .group = "Skinned model",
         .help = "Joints that may move a vertex; 1: each follows one alone."},
        {.name = "smoothing", .kind = CLI_U64, .value = &o.smoothing, .argument = "N", .max = 1000, .group = "Skinned model",
         .help = "Rounds in which a vertex's weights are averaged with its neighbours'."},
        {.name = "draco", .kind = CLI_U64, .value = &o.draco, .max = 24, .argument = "BITS", .group = "Skinned model",
         .help = "Compress the mesh by Draco, positions to 8 to 24 bits; the report has the errors. 0: not."},
        {.name = "bind", .kind = CLI_TEXT, .value = &o.bind, .argument = "IN.svo", .no_default = true, .group = "Voxels and closed surfaces",
         .help = "Give the voxels of this octree, which lies where the model lies, a channel with their bone."},
        {.name = "bound", .kind = CLI_TEXT, .value = &o.bound, .argument = "OUT.svo", .no_default = true, .group = "Voxels and closed surfaces",
         .help = "Where --bind writes the octree."},
        {.name = "solid", .kind = CLI_TEXT, .value = &o.solid, .argument = "OUT.svo", .no_default = true, .group = "Voxels and closed surfaces",
         .help = "Write an octree of what the surface encloses, holes or not: every voxel that it passes while it is contracted."},
        {.name = "reconstruct", .kind = CLI_TEXT, .value = &o.reconstruct, .argument = "OUT.ply", .no_default = true, .group = "Voxels and closed surfaces",
         .help = "Write a closed surface of the mesh, its holes filled, as PLY."},
        {.name = "solid-divide", .kind = CLI_U64, .value = &o.solid_divide, .min = 1, .max = 64, .argument = "N", .group = "Voxels and closed surfaces",
         .help = "Voxels of --solid and --reconstruct along an edge of omega."},
    };
    cli_tool tool = {
        .name = "svo-skeleton",
        .summary = "Contract a mesh or voxels to a curve skeleton with a map from every vertex or voxel to its joint.",
        .synopsis = "IN -o OUT.skel [--omega W] [options]",
        .options = options,
        .option_count = sizeof options / sizeof *options,
        .details = "IN is a .gltf .glb .obj .ply .stl .off .drc mesh of any quality (open, unshared, non-manifold, in parts), or a .svo (- is stdin).",
        .example = "svo-skeleton horse.ply -o horse.skel --omega 0.025 --glb horse_skinned.glb --report horse.json\n"
                   "svo-skeleton scan.ply -o scan.skel --omega 0.02 --reconstruct scan_closed.ply --solid scan.svo\n"
                   "svo-skeleton horse.ply -o horse.skel --omega 0.025 --bind horse.svo --bound horse_bones.svo",
        .min_inputs = 1,
        .max_inputs = 1,
        .has_output = true,
    };
    cli c;
    int code = cli_begin(&c, &tool, argc, argv);
    if (code >= 0) return code;
    if (c.output == NULL) return cli_usage(&c, "-o OUT.skel is needed");
    if ((code = cli_take_axes(&c, &o.axes)) >= 0) return code;
    if (o.draco != 0 && (o.draco < 8 || o.glb == NULL)) return cli_usage(&c, o.glb == NULL ? "--draco compresses the mesh of --glb, which is not given" : "--draco takes 8 to 24 bits, or 0");
    if ((o.bind == NULL) != (o.bound == NULL)) return cli_usage(&c, "--bind IN.svo and --bound OUT.svo need each other");
    const char *const files[] = {c.output, o.glb, o.obj, o.swc, o.bound, o.solid, o.reconstruct, o.segments};
    for (int i = 0; i < (int)(sizeof files / sizeof *files); i++)
        for (int k = 0; k < i; k++)
            if (files[i] != NULL && files[k] != NULL && strcmp(files[i], files[k]) == 0) return cli_usage(&c, "two outputs name the same file, %s", files[i]);
    svo_error err = {0};
    svo_result r = run(&c, &o, &err);
    return cli_end(&c, r, &err);
}
