/* .obj, and what follows a line "#mtl" in the input as the material library m.mtl beside it (in memory where /dev/shm is
 * there). */
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#define READER import_obj
#include "mesh.h"

static char folder[64], library[80];

static void remove_folder(void)
{
    unlink(library);
    rmdir(folder);
}

static void make_folder(void)
{
    struct stat s;
    snprintf(folder, sizeof folder, "%s/svo-fuzz-XXXXXX", stat("/dev/shm", &s) == 0 ? "/dev/shm" : "/tmp");
    if (mkdtemp(folder) == NULL) fuzz_fail("no folder for the material library");
    snprintf(library, sizeof library, "%s/m.mtl", folder);
    atexit(remove_folder);
    strcat(folder, "/");
}

static svo_result read_obj(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err)
{
    static const char mark[] = "\n#mtl\n";
    if (folder[0] == '\0') make_folder();
    const uint8_t *cut = memmem(bytes, size, mark, sizeof mark - 1);
    uint64_t length = cut != NULL ? (uint64_t)(cut - bytes) : size;
    FILE *f = fopen(library, "wb");
    if (f == NULL) fuzz_fail("the material library cannot be written");
    if (cut != NULL) fwrite(cut + sizeof mark - 1, 1, size - length - (sizeof mark - 1), f);
    fclose(f);
    return read_mesh(bytes, length, a, folder, err);
}

const fuzz_target fuzz_this = {.read = read_obj, .memory = 64 << 20, .opens_files = true};
