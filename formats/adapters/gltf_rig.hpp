/* gltf_rig.cpp: nodes, skins and animations for fmt_import_options.rig. */
#ifndef GLTF_RIG_HPP
#define GLTF_RIG_HPP

#include "gltf_document.hpp"

#include "fmt_rig.h"

/* Inverse bind matrices of a skin, one a joint (identities where it has none). */
void gltf_inverse_bind(gltf_document &d, int skin, svo_mat4 *out);
/* Morph targets of a node's mesh (all its primitives have as many). */
size_t gltf_target_count(const gltf_document &d, int node);
/* Everything but shapes and instances. order: all nodes, parents first. */
void gltf_build_rig(gltf_document &d, const std::vector<int> &order, fmt_rig *rig);

#endif
