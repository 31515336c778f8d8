/* The JSON of a glTF asset against the rules that the importer relies on. */
#ifndef GLTF_CHECK_HPP
#define GLTF_CHECK_HPP

#include "gltf_document.hpp"

#include <nlohmann/json.hpp>

/* Parse with a bound on depth. */
nlohmann::json gltf_parse_json(const char *path, const char *text, uint64_t size);
/* Version, required extensions, types and ranges of every field that is used, references, the node forest
 * (d.parent). Integers written as 3.0 become 3. Throws svo_failure. */
void gltf_check(gltf_document &d, nlohmann::json &root);
/* Animations (of checked JSON), checked: d.animations. */
void gltf_take_animations(gltf_document &d, const nlohmann::json &root);

#endif
