/* What writing a scene, its rules, reading a whole one and reading a damaged one share. */
#ifndef FMTI_SCENE_H
#define FMTI_SCENE_H

#include "fmt_scene.h"

#define HEAD FMT_FOURCC('H', 'E', 'A', 'D')
#define NAME FMT_FOURCC('N', 'A', 'M', 'E')
#define PAGE FMT_FOURCC('P', 'A', 'G', 'E')
#define PHSH FMT_FOURCC('P', 'H', 'S', 'H')
#define IAST FMT_FOURCC('I', 'A', 'S', 'T')
#define IXFM FMT_FOURCC('I', 'X', 'F', 'M')
#define IIDS FMT_FOURCC('I', 'I', 'D', 'S')
#define INAM FMT_FOURCC('I', 'N', 'A', 'M')
#define IPOS FMT_FOURCC('I', 'P', 'O', 'S')
#define POSE FMT_FOURCC('P', 'O', 'S', 'E')
#define PMAT FMT_FOURCC('P', 'M', 'A', 'T')
#define CAMR FMT_FOURCC('C', 'A', 'M', 'R')
#define ASET FMT_FOURCC('A', 'S', 'E', 'T')
#define META FMT_TYPE_META

#define MAJOR 1
#define HEAD_BYTES 80u
#define CAMERA_BYTES 136u
#define HAS_CAMERA 1u
#define HAS_POSES 2u

/* "IXFM 5: what (SCN-07)": element 5 of the array in chunk IXFM. Returns code. */
svo_result fmti_scene_bad(svo_error *err, svo_result code, uint32_t chunk, uint64_t index, const char *rule, const char *what);
/* Does a name begin at this offset of the table? */
bool fmti_scene_name_start(const svo_scene *s, uint64_t offset);

/* What was found damaged. */
typedef struct fmti_scene_damage {
    const svo_allocator *allocator;
    bool arrays;   /* a hash of a whole array is wrong */
    uint8_t *page; /* 1 for damaged pages; page_count entries, or NULL */
    uint32_t page_count;
    uint64_t pages, assets, instances;
} fmti_scene_damage;
svo_result fmti_scene_damage_page(fmti_scene_damage *d, uint32_t page_count, uint32_t page, svo_error *err);
void fmti_scene_damage_free(fmti_scene_damage *d);

/* Replace the arrays of f->scene by copies without the damaged pages and the instances of empty (damaged) assets. Asset numbers out of range are left for
 * the check that follows. */
svo_result fmti_scene_drop_damaged(fmt_scene *f, fmti_scene_damage *d, svo_error *err);

uint64_t fmti_scene_page_hash(const svo_scene *s, uint32_t page);

/* Rules SCN-03 to SCN-12. partial: assets may be empty and unused. rules NULL: the first violation is enough. */
svo_result fmti_scene_check(const svo_scene *s, bool partial, svo_result code, const svo_allocator *a, svo_rules *rules, svo_error *err);

#endif
