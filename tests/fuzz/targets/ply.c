/* .ply files. */
#define READER import_ply
#include "mesh.h"

static svo_result read(const uint8_t *bytes, uint64_t size, const svo_allocator *a, svo_error *err) { return read_mesh(bytes, size, a, "/nowhere/", err); }

const fuzz_target fuzz_this = {.read = read, .memory = 64 << 20};
