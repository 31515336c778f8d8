/* The result as text. */
#include <stdio.h>
#include <string.h>

#include "compare.h"

static double number(const json_t *o, const char *key) { return json_number_value(json_object_get(o, key)); }
static const char *text(const json_t *o, const char *key)
{
    const char *s = json_string_value(json_object_get(o, key));
    return s != NULL ? s : "";
}

static unsigned long long count(const json_t *o, const char *key) { return (unsigned long long)json_integer_value(json_object_get(o, key)); }

static void print_place(const json_t *place)
{
    printf("(%lld, %lld, %lld)", (long long)json_integer_value(json_array_get(place, 0)),
           (long long)json_integer_value(json_array_get(place, 1)), (long long)json_integer_value(json_array_get(place, 2)));
}

static void print_side(const json_t *o, const char *name)
{
    const json_t *side = json_object_get(o, name);
    printf("%c  ", name[0] - 'a' + 'A');
    cli_write_plain(stdout, text(side, "file"));
    if (json_object_get(side, "width") != NULL) printf("  %llu x %llu pixels", count(side, "width"), count(side, "height"));
    if (json_object_get(side, "depth") != NULL)
        printf("  %s, depth %llu, %llu voxels", text(side, "format"), count(side, "depth"), count(side, "voxels"));
    if (json_object_get(side, "joints") != NULL)
        printf("  %llu joints, %llu bones, %llu ends, %llu branches, %llu loops, %llu components, %llu mapped; reconstruction error %.3g %%", count(side, "joints"), count(side, "bones"),
               count(side, "ends"), count(side, "branches"), count(side, "loops"), count(side, "components"), count(side, "mapped"), number(side, "reconstruction_mean"));
    putchar('\n');
}

static void print_decibels(const char *name, const json_t *value)
{
    if (json_is_null(value)) printf("%s inf", name);
    else printf("%s %.3f", name, json_number_value(value));
}

static void print_image(const json_t *o)
{
    const json_t *psnr = json_object_get(o, "psnr_db");
    if (psnr == NULL) return;
    print_decibels("PSNR", json_object_get(psnr, "all"));
    printf(" dB (");
    static const char *const names[4] = {"r", "g", "b", "a"};
    for (int k = 0; k < 4 && json_object_get(psnr, names[k]) != NULL; k++) {
        if (k > 0) printf(", ");
        print_decibels(names[k], json_object_get(psnr, names[k]));
    }
    printf(")\n");
    if (json_is_null(json_object_get(o, "ssim"))) printf("SSIM not defined below 11 x 11 pixels\n");
    else printf("SSIM %.6f\n", number(o, "ssim"));
    printf("%llu of %llu pixels differ (%.4g %%), by up to %llu of 255\n", count(o, "different_pixels"), count(o, "pixels"),
           100 * number(o, "different_share"), count(o, "max_difference"));
}

static void print_planes(const json_t *o)
{
    const json_t *p;
    size_t i;
    json_array_foreach(json_object_get(o, "planes"), i, p) {
        if (json_object_get(p, "type") == NULL) continue; /* told among the reasons */
        printf("%-10s %llu differ", text(p, "name"), count(p, "different"));
        if (strcmp(text(p, "type"), "float") == 0) printf("; by up to %.6g, root of mean squares %.6g", number(p, "max"), number(p, "rmse"));
        if (count(p, "unmatched") != 0) printf("; %llu are a number in one alone", count(p, "unmatched"));
        const json_t *at = json_object_get(p, "worst");
        if (at != NULL) printf(", most at pixel %lld, %lld", (long long)json_integer_value(json_array_get(at, 0)), (long long)json_integer_value(json_array_get(at, 1)));
        putchar('\n');
    }
}

static void print_octree(const json_t *o)
{
    const json_t *g = json_object_get(o, "geometry");
    if (json_object_get(g, "both") == NULL) return;
    printf("voxels  %llu in both, %llu only in A, %llu only in B", count(g, "both"), count(g, "only_a"), count(g, "only_b"));
    if (json_object_get(g, "first") != NULL) {
        printf("; the first, only in %s: ", strcmp(text(g, "first_in"), "a") == 0 ? "A" : "B");
        print_place(json_object_get(g, "first"));
    }
    putchar('\n');
    const json_t *channels = json_object_get(o, "channels"), *ch;
    size_t i;
    json_array_foreach(channels, i, ch) {
        if (json_object_get(ch, "unit") == NULL) continue; /* told among the reasons */
        printf("%-10s %llu differ; %s mean %.6g, max %.6g", text(ch, "name"), count(ch, "different"), text(ch, "unit"), number(ch, "mean"),
               number(ch, "max"));
        if (json_object_get(ch, "worst") != NULL) {
            printf(" at ");
            print_place(json_object_get(ch, "worst"));
        }
        putchar('\n');
    }
}

static void print_chunks(const json_t *o)
{
    const json_t *chunk;
    size_t i;
    json_array_foreach(json_object_get(o, "chunks"), i, chunk)
        printf("chunk %s, id %llu: %s\n", text(chunk, "type"), count(chunk, "id"), text(chunk, "state"));
}

static void print_skeleton(const json_t *o)
{
    const json_t *s = json_object_get(o, "skeleton");
    printf("curves are %.6g apart in the mean, %.6g at most (Hausdorff; %.3g %% of the model's size)\n", number(s, "curve_distance_mean"), number(s, "hausdorff"),
           number(s, "hausdorff_percent_of_unit"));
    if (json_object_get(s, "joint_distance_max") != NULL)
        printf("joints of the same number are %.6g apart in the mean, %.6g at most\n", number(s, "joint_distance_mean"), number(s, "joint_distance_max"));
    printf("bones are %s\n", json_is_true(json_object_get(s, "same_bones")) ? "the same" : "different");
    if (json_object_get(s, "map_different") != NULL) printf("%llu vertices or voxels are mapped to another joint\n", count(s, "map_different"));
}

void compare_print(const compare_job *j)
{
    const json_t *o = j->json, *reason;
    size_t i;
    print_side(o, "a");
    print_side(o, "b");
    print_image(o);
    print_planes(o);
    if (json_object_get(o, "geometry") != NULL) print_octree(o);
    if (json_object_get(o, "chunks") != NULL) print_chunks(o);
    if (json_object_get(o, "skeleton") != NULL) print_skeleton(o);
    if (json_is_true(json_object_get(o, "identical"))) printf("identical\n");
    else if (json_array_size(j->reasons) == 0) printf("equal within tolerance\n");
    json_array_foreach(j->reasons, i, reason) fputs("differs: ", stdout), cli_write_plain(stdout, json_string_value(reason)), putchar('\n');
}
