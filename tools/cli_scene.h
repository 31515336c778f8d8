/* Any octree or scene file as a scene: what draws or exports need not ask which it was. */
#ifndef CLI_SCENE_H
#define CLI_SCENE_H

#include "cli.h"
#include "fmt_scene.h"
#include "svo_dag.h"

/* An opened file. A .svdag or .svscene is used where it lies in `data`, a .svo is packed in memory without loss. A single octree is a scene of
 * one instance with the identity transform. */
typedef struct cli_scene {
    const svo_scene *scene; /* use this */
    const char *kind;       /* "svo", "svdag" or "svscene" */
    fmt_scene file;
    fmt_svdag dag;
    svo_packed *packed;
    svo_scene_one single;
} cli_scene;

/* `data` (64-byte aligned, borrowed) is the file's bytes and `name` what messages call it. Of a damaged .svscene what is left is opened where `loss` is given, which
 * says what is missing (fmt_scene_open_partly); NULL: the file must be whole. Do not move *out while it is open. */
svo_result cli_scene_open(cli *c, const char *name, const uint8_t *data, uint64_t size, const svo_allocator *a, fmt_scene_loss *loss, cli_scene *out, svo_error *err);
/* A zeroed one is fine. */
void cli_scene_close(cli_scene *s);

#endif
