/* Runs files through a target without libFuzzer:  replay_TARGET FILE|FOLDER...
 * A file whose name begins with a verdict (ok-, invalid-, unsupported-, limit-, io-) must get it, and the message must
 * name the rule that comes next in the name (invalid-dag-04...: DAG-04). */
#include <ctype.h>
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "fuzz.h"

static unsigned files, wrong;

/* Does the message name the rule that the text begins with, if it does begin with one? */
static bool names_rule(const char *text, const char *message)
{
    char rule[7] = {0};
    for (int i = 0; i < 6; i++) {
        bool fits = i < 3 ? islower((unsigned char)text[i]) : i == 3 ? text[i] == '-' : isdigit((unsigned char)text[i]);
        if (!fits) return true;
        rule[i] = (char)toupper((unsigned char)text[i]);
    }
    return strstr(message, rule) != NULL;
}

static void check_name(const char *path)
{
    static const struct { const char *prefix; svo_result result; } names[] = {
        {"ok-", SVO_OK}, {"invalid-", SVO_INVALID_DATA}, {"unsupported-", SVO_UNSUPPORTED}, {"limit-", SVO_LIMIT}, {"io-", SVO_IO}};
    const char *slash = strrchr(path, '/'), *name = slash != NULL ? slash + 1 : path;
    svo_error err;
    svo_result r = fuzz_verdict(&err);
    printf("%s: %s%s%s\n", path, svo_result_name(r), err.message[0] != '\0' ? ": " : "", err.message);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        size_t n = strlen(names[i].prefix);
        if (strncmp(name, names[i].prefix, n) != 0 || (names[i].result == r && names_rule(name + n, err.message))) continue;
        printf("%s: expected %s and the rule in its name\n", path, svo_result_name(names[i].result));
        wrong++;
    }
}

static bool replay(const char *path)
{
    FILE *f = fopen(path, "rb");
    if (f == NULL) return false;
    uint8_t *bytes = malloc(FUZZ_MAX_BYTES);
    if (bytes == NULL) abort();
    size_t size = fread(bytes, 1, FUZZ_MAX_BYTES, f);
    bool whole = fgetc(f) == EOF && !ferror(f);
    fclose(f);
    fflush(stdout);
    if (whole) {
        LLVMFuzzerTestOneInput(bytes, size);
        check_name(path);
        files++;
    } else {
        fprintf(stderr, "%s: longer than %u bytes\n", path, FUZZ_MAX_BYTES);
    }
    free(bytes);
    return whole;
}

static bool folder(const char *path)
{
    struct dirent **list;
    int n = scandir(path, &list, NULL, alphasort);
    if (n < 0) return false;
    bool ok = true;
    for (int i = 0; i < n; i++) {
        char name[4096];
        int length = snprintf(name, sizeof name, "%s/%s", path, list[i]->d_name);
        if (list[i]->d_name[0] != '.' && (length >= (int)sizeof name || !replay(name))) ok = false;
        free(list[i]);
    }
    free(list);
    return ok;
}

int main(int argc, char **argv)
{
    bool ok = true;
    for (int i = 1; i < argc; i++) {
        struct stat s;
        bool is_folder = stat(argv[i], &s) == 0 && S_ISDIR(s.st_mode);
        if (!(is_folder ? folder(argv[i]) : replay(argv[i]))) {
            fprintf(stderr, "%s: cannot be replayed\n", argv[i]);
            ok = false;
        }
    }
    printf("%u files, %u with a wrong verdict\n", files, wrong);
    return ok && files != 0 && wrong == 0 ? 0 : 1;
}
