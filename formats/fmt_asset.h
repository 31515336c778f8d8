/* Anything that can be drawn or packed, as a packed octree: .svdag mapped in place, .svo built in memory, a mesh
 * voxelized and built in memory. */
#ifndef FMT_ASSET_H
#define FMT_ASSET_H

#include "fmt_file.h"
#include "fmt_svdag.h"
#include "svo_dag.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct fmt_asset fmt_asset;

/* kind by content; "-" is stdin. depth is for meshes. */
svo_result fmt_asset_open(const char *path, uint32_t depth, const svo_dag_options *options, fmt_asset **out, svo_error *err);
const svo_view *fmt_asset_view(const fmt_asset *a);
void fmt_asset_close(fmt_asset *a);

#ifdef __cplusplus
}
#endif
#endif
