/* The JSON of a file as text for people. */
#include "dump.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void print_value(const json_t *v)
{
    size_t i;
    const json_t *e;
    const char *key;
    switch (json_typeof(v)) {
    case JSON_INTEGER: printf("%" JSON_INTEGER_FORMAT, json_integer_value(v)); break;
    case JSON_REAL: printf("%.9g", json_real_value(v)); break;
    case JSON_STRING: cli_write_plain(stdout, json_string_value(v)); break;
    case JSON_TRUE: fputs("yes", stdout); break;
    case JSON_FALSE: fputs("no", stdout); break;
    case JSON_NULL: fputs("none", stdout); break;
    case JSON_ARRAY:
        json_array_foreach(v, i, e) {
            if (i != 0) putchar(' ');
            print_value(e);
        }
        break;
    case JSON_OBJECT: {
        bool first = true;
        void *at = json_object_iter((json_t *)(uintptr_t)v);
        for (; at != NULL; at = json_object_iter_next((json_t *)(uintptr_t)v, at)) {
            key = json_object_iter_key(at);
            fputs(first ? "" : ", ", stdout);
            cli_write_plain(stdout, key);
            putchar(' ');
            print_value(json_object_iter_value(at));
            first = false;
        }
    }
    }
}

static void print_label(const char *key)
{
    char label[40];
    size_t n = 0;
    for (; key[n] != 0 && n < sizeof label - 1; n++) label[n] = key[n] == '_' ? ' ' : key[n];
    label[n] = 0;
    printf("  %-18s ", label);
}

static uint64_t count_of(const json_t *o, const char *key)
{
    const json_t *v = json_object_get(o, key);
    return json_is_integer(v) ? (uint64_t)json_integer_value(v) : json_is_real(v) ? (uint64_t)json_real_value(v) : 0;
}

static void print_sections(const json_t *list, double total)
{
    size_t i;
    const json_t *s;
    print_label("sections");
    printf("%-18s %8s %14s %14s %6s\n", "type", "chunks", "bytes", "decoded", "share");
    json_array_foreach(list, i, s) {
        uint64_t bytes = count_of(s, "bytes"), decoded = count_of(s, "decoded_bytes"), chunks = count_of(s, "chunks");
        printf("%21s%-18s ", "", json_string_value(json_object_get(s, "type")));
        if (chunks != 0) printf("%8" PRIu64, chunks);
        else printf("%8s", "");
        printf(" %14" PRIu64, bytes);
        if (chunks != 0) printf(" %14" PRIu64, decoded);
        else printf(" %14s", "");
        printf(" %5.1f%%\n", total > 0 ? 100 * (double)bytes / total : 0.0);
    }
}

enum { LINES = 24 }; /* of a list; the rest is counted */

/* A list of objects, one a line. */
static void print_list(const char *key, const json_t *list)
{
    size_t i;
    const json_t *e;
    print_label(key);
    if (json_array_size(list) == 0) fputs("none\n", stdout);
    json_array_foreach(list, i, e) {
        if (i != 0) printf("%21s", "");
        if (i == LINES) {
            printf("... and %zu more (--json lists them)\n", json_array_size(list) - LINES);
            break;
        }
        print_value(e);
        putchar('\n');
    }
}

/* Assets of a scene: what tells them apart, one a line. */
static void print_assets(const json_t *list)
{
    size_t i, k;
    const json_t *e, *a;
    print_label("assets");
    printf("%-24s %10s %5s %14s %12s  attributes\n", "name", "instances", "depth", "voxels", "bytes");
    json_array_foreach(list, i, e) {
        if (i == LINES) {
            printf("%21s... and %zu more (--json lists them)\n", "", json_array_size(list) - LINES);
            break;
        }
        printf("%21s", "");
        print_value(json_object_get(e, "name"));
        const size_t length = json_string_length(json_object_get(e, "name"));
        printf("%*s %10" PRIu64 " %5" PRIu64 " %14" PRIu64 " %12" PRIu64 " ", length < 24 ? 24 - (int)length : 0, "", count_of(e, "instances"), count_of(e, "depth"), count_of(e, "voxels"), count_of(e, "bytes"));
        json_array_foreach(json_object_get(e, "attributes"), k, a) printf("%s%s", k == 0 ? " " : ",", json_string_value(json_object_get(a, "name")));
        putchar('\n');
    }
}

static void print_levels(const json_t *list)
{
    size_t i;
    const json_t *e;
    print_label("levels");
    json_array_foreach(list, i, e) {
        if (i != 0) printf("%21s", "");
        const json_t *stored = json_object_get(e, "stored");
        printf("%2" PRIu64 " %14" PRIu64 " nodes", count_of(e, "level"), count_of(e, "nodes"));
        if (stored != NULL) printf(" %14" PRIu64 " stored", count_of(e, "stored"));
        if (json_object_get(e, "sharing") != NULL) printf(" %10.4gx", json_real_value(json_object_get(e, "sharing")));
        if (json_object_get(e, "bytes") != NULL) printf(" %14" PRIu64 " bytes", count_of(e, "bytes"));
        putchar('\n');
    }
}

static void print_matrix(const json_t *m)
{
    print_label("voxel_to_world");
    for (size_t i = 0; i < 12; i++) {
        if (i != 0 && i % 4 == 0) printf("\n%21s", "");
        printf("%-17.12g%s", json_real_value(json_array_get(m, i)), i % 4 == 3 ? "" : " ");
    }
    putchar('\n');
}

static void print_tree(const json_t *list, bool full)
{
    size_t i;
    const json_t *e;
    print_label("tree");
    puts("level, cell, octants of children, kind, attribute, where it is stored");
    json_array_foreach(list, i, e) {
        const uint64_t level = count_of(e, "level"), mask = count_of(e, "mask");
        const json_t *cell = json_object_get(e, "cell"), *slot = json_object_get(e, "slot");
        printf("  %*s%" PRIu64 " (", (int)(2 * level), "", level);
        print_value(cell);
        printf(") ");
        for (int o = 0; o < 8; o++) putchar(mask >> o & 1 ? '0' + o : '.');
        printf(" %s #%" PRIu64, json_string_value(json_object_get(e, "kind")), count_of(e, "attribute"));
        if (slot != NULL) printf(" @%" JSON_INTEGER_FORMAT, json_integer_value(slot));
        if (json_object_get(e, "asset") != NULL) printf(" asset %" PRIu64, count_of(e, "asset"));
        putchar('\n');
    }
    if (!full) puts("  ... and more; ask for a lower level");
}

static void print_bar(uint64_t n, uint64_t most)
{
    const int length = most != 0 ? (int)(40 * (double)n / (double)most + 0.5) : 0;
    printf(" %14" PRIu64 " %.*s\n", n, length, "########################################");
}

static void print_histograms(const json_t *o)
{
    size_t i, k;
    const json_t *level, *channel, *bin;
    print_label("children");
    printf("%5s %12s %12s   nodes with 1 .. 8 children\n", "level", "inner", "full leaves");
    json_array_foreach(json_object_get(o, "levels"), i, level) {
        printf("%21s%5" PRIu64 " %12" PRIu64 " %12" PRIu64 "  ", "", count_of(level, "level"), count_of(level, "inner"), count_of(level, "full_leaves"));
        json_array_foreach(json_object_get(level, "nodes_with_1_to_8_children"), k, bin) printf(" %" JSON_INTEGER_FORMAT, json_integer_value(bin));
        putchar('\n');
    }
    json_array_foreach(json_object_get(o, "channels"), i, channel) {
        const json_t *bins = json_object_get(channel, "bins");
        uint64_t most = 0;
        printf("  voxels by %s\n", json_string_value(json_object_get(channel, "name")));
        json_array_foreach(bins, k, bin) if (count_of(bin, "voxels") > most) most = count_of(bin, "voxels");
        json_array_foreach(bins, k, bin) {
            const json_t *value = json_object_get(bin, "value");
            char label[24];
            if (json_is_integer(value)) snprintf(label, sizeof label, "%" JSON_INTEGER_FORMAT, json_integer_value(value));
            else snprintf(label, sizeof label, "%s", json_string_value(value));
            printf("    %-16s", label);
            print_bar(count_of(bin, "voxels"), most);
        }
    }
}

/* 188880 as "188,880", beyond a billion in words. */
static void put_count(uint64_t n)
{
    char digits[24];
    const int length = snprintf(digits, sizeof digits, "%" PRIu64, n);
    for (int i = 0; i < length; i++) {
        if (i != 0 && (length - i) % 3 == 0) putchar(',');
        putchar(digits[i]);
    }
}

static void put_bytes(uint64_t n)
{
    if (n < 10000) printf("%" PRIu64 " bytes", n);
    else if (n < 10000000) printf("%.0f kB", (double)n / 1e3);
    else if (n < 10000000000u) printf("%.1f MB", (double)n / 1e6);
    else printf("%.1f GB", (double)n / 1e9);
}

/* The file in three lines, before all else. */
static void print_gist(const json_t *o)
{
    const char *format = json_string_value(json_object_get(o, "format"));
    const json_t *levels = json_object_get(o, "levels"), *size = json_object_get(o, "voxel_size"), *attributes = json_object_get(o, "attributes"), *a;
    const json_t *made = json_object_get(o, "provenance"), *input = json_array_get(json_object_get(made, "inputs"), 0);
    size_t i;
    printf("  = ");
    if (json_object_get(o, "joint_count") != NULL) {
        printf("skeleton of %" PRIu64 " joints and %" PRIu64 " bones, omega %.4g", count_of(o, "joint_count"), count_of(o, "bone_count"), json_number_value(json_object_get(o, "omega")));
    } else if (json_object_get(o, "instance_count") != NULL) {
        printf("scene of ");
        put_count(count_of(o, "instance_count"));
        printf(" instances of %" PRIu64 " assets: ", count_of(o, "asset_count"));
        put_count(count_of(o, "voxels"));
        printf(" voxels stored, ");
        put_count(count_of(o, "instanced_voxels"));
        printf(" placed");
    } else {
        printf("octree of depth %" PRIu64 ", ", count_of(o, "depth"));
        put_count(count_of(o, "voxels"));
        printf(" voxels");
        if (json_is_array(size)) printf(" of %.4g", json_number_value(json_array_get(size, 0)));
        if (strcmp(format, "svdag") == 0 && json_object_get(o, "stored_nodes") != NULL) {
            printf(", ");
            put_count(count_of(o, "nodes"));
            printf(" nodes in ");
            put_count(count_of(o, "stored_nodes") + count_of(o, "stored_bricks"));
            printf(" stored");
        }
    }
    printf("; ");
    put_bytes(count_of(o, "bytes"));
    if (json_is_real(json_object_get(o, "bytes_per_voxel"))) printf(", %.3g a voxel", json_real_value(json_object_get(o, "bytes_per_voxel")));
    putchar('\n');
    if (json_array_size(levels) != 0) {
        printf("  = ");
        if (json_array_size(attributes) == 0) printf("no attributes");
        json_array_foreach(attributes, i, a)
            printf("%s%s%s", i != 0 ? ", " : "attributes ", json_string_value(json_object_get(a, "name")), json_is_true(json_object_get(a, "constant")) ? " (one value)" : "");
        putchar('\n');
    }
    while (json_is_object(json_object_get(input, "provenance")) && json_array_size(json_object_get(json_object_get(input, "provenance"), "inputs")) != 0)
        input = json_array_get(json_object_get(json_object_get(input, "provenance"), "inputs"), 0);
    if (json_is_string(json_object_get(made, "tool"))) {
        fputs("  = made by ", stdout);
        print_value(json_object_get(made, "tool"));
        if (json_is_string(json_object_get(input, "name"))) fputs(", from ", stdout), print_value(json_object_get(input, "name"));
        putchar('\n');
    }
}

void dump_print(const dump_job *j)
{
    const char *key;
    json_t *v;
    print_value(json_object_get(j->json, "file"));
    putchar('\n');
    if (!json_is_true(json_object_get(j->json, "damaged"))) print_gist(j->json);
    bool skeleton = json_object_get(j->json, "joint_count") != NULL; /* has keys without meaning, for the sake of one form of JSON */
    json_object_foreach(j->json, key, v) {
        if (strcmp(key, "file") == 0 || (skeleton && (json_is_null(v) || (json_is_array(v) && json_array_size(v) == 0)))) continue;
        if (strcmp(key, "tree_listed_in_full") == 0) continue;
        if (strcmp(key, "assets") == 0) {
            print_assets(v);
        } else if (strcmp(key, "tree") == 0) {
            print_tree(v, json_is_true(json_object_get(j->json, "tree_listed_in_full")));
        } else if (strcmp(key, "histograms") == 0) {
            print_histograms(v);
        } else if (json_is_null(v)) {
            continue; /* a scene has no voxel_to_world of its own, say */
        } else if (strcmp(key, "sections") == 0) {
            print_sections(v, (double)j->size);
        } else if (strcmp(key, "levels") == 0) {
            print_levels(v);
        } else if (strcmp(key, "voxel_to_world") == 0) {
            print_matrix(v);
        } else if (json_is_array(v) && (json_array_size(v) == 0 || json_is_object(json_array_get(v, 0)))) {
            print_list(key, v);
        } else if (strcmp(key, "provenance") == 0 && json_is_object(v)) {
            char *text = json_dumps(v, JSON_COMPACT | JSON_SORT_KEYS);
            print_label(key);
            cli_write_plain(stdout, text != NULL ? text : "");
            putchar('\n');
            free(text);
        } else {
            print_label(key);
            print_value(v);
            putchar('\n');
        }
    }
}

void dump_print_row(const json_t *json)
{
    if (json == NULL) {
        printf("%-8s %5s %14s %14s %12s %9s  %-30s %s\n", "format", "depth", "voxels", "nodes", "bytes", "B/voxel", "attributes", "file");
        return;
    }
    const json_t *list = json_object_get(json, "attributes"), *a;
    char attributes[200] = "";
    size_t i, n = 0;
    json_array_foreach(list, i, a) {
        const char *name = json_string_value(json_object_get(a, "name"));
        if (name != NULL && n < sizeof attributes) n += (size_t)snprintf(attributes + n, sizeof attributes - n, "%s%s", i > 0 ? "," : "", name);
    }
    bool damaged = json_is_true(json_object_get(json, "damaged")), octree = json_is_integer(json_object_get(json, "depth"));
    printf("%-8s ", json_string_value(json_object_get(json, "format")));
    if (octree) printf("%5" PRIu64 " ", count_of(json, "depth"));
    else printf("%5s ", "");
    if (octree && !damaged) printf("%14" PRIu64 " %14" PRIu64 " ", count_of(json, "voxels"), count_of(json, "nodes"));
    else printf("%14s %14s ", damaged ? "damaged" : "", "");
    printf("%12" PRIu64 " ", count_of(json, "bytes"));
    if (json_is_number(json_object_get(json, "bytes_per_voxel"))) printf("%9.3f  ", json_number_value(json_object_get(json, "bytes_per_voxel")));
    else printf("%9s  ", "");
    printf("%-30s ", attributes);
    print_value(json_object_get(json, "file"));
    putchar('\n');
}
