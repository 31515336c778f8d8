/* A mesh format: read from memory, every array looked at. The includer defines READER, FOLDER and READS_FILES. */
#include "../fuzz.h"
#include "import_check.h"
#include "import_common.h"

static svo_result read_mesh(const uint8_t *bytes, uint64_t size, const svo_allocator *a, const char *folder, svo_error *err)
{
    import_context c = {.path = "fuzz", .allocator = a, .max_file_bytes = 1 << 20, .max_image_pixels = 1 << 16};
    snprintf(c.folder, sizeof c.folder, "%s", folder);
    svo_mesh mesh = {.allocator = a};
    svo_result r = READER(&c, bytes, size, &mesh, err);
    const char *fault = r == SVO_OK ? import_mesh_fault(&mesh) : NULL;
    if (fault != NULL) fuzz_fail("accepted, but not sound: %s", fault);
    svo_mesh_free(&mesh);
    return r;
}
