/* Between the reader of NRRD headers and what is done with samples. Internal to formats/. */
#ifndef IMPORT_VOLUME_H
#define IMPORT_VOLUME_H

#include "fmt_volume.h"

typedef enum volume_type { VOLUME_I8, VOLUME_U8, VOLUME_I16, VOLUME_U16, VOLUME_I32, VOLUME_U32, VOLUME_I64, VOLUME_U64, VOLUME_F32, VOLUME_F64, VOLUME_RGBA } volume_type;
uint32_t volume_type_size(volume_type t);
/* 1 to 2^21 each. */
bool volume_sizes(const double *v, uint64_t out[3]);

typedef struct volume_samples {
    volume_type type;
    bool big;
    uint64_t size[3];
    double to_world[16];
    const uint8_t *data; /* all samples, x fastest */
    fmt_bytes file;      /* where they are not in the bytes that were given */
    void *mapped;        /* decoded */
    uint64_t mapped_size;
} volume_samples;

svo_result import_nrrd(const char *path, const uint8_t *bytes, uint64_t size, const fmt_volume_options *o, volume_samples *out, svo_error *err);
void volume_samples_free(volume_samples *s);

#endif
