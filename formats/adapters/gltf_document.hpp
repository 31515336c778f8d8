/* One glTF asset while it is imported: what the adapters gltf_*.cpp share. Bytes are checked in this order: the GLB frame
 * and the JSON's depth (gltf_load), the JSON's types and references (gltf_check), then tinygltf fills its model from
 * JSON that is known to be sane and has no buffers, images and skins left (those are ours: no file is opened by tinygltf,
 * no byte copied), then every accessor against its buffer (gltf_accessor). */
#ifndef GLTF_DOCUMENT_HPP
#define GLTF_DOCUMENT_HPP

#include "cxx_guard.hpp"
#include "import_common.h"
#include "svo_soup.h"

#include <memory>
#include <string>
#include <vector>

#define TINYGLTF_NO_STB_IMAGE
#define TINYGLTF_NO_STB_IMAGE_WRITE
#define TINYGLTF_NO_EXTERNAL_IMAGE
#define TINYGLTF_NO_FS
#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wshadow"
#endif
#include <tiny_gltf.h>
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif

/* Bytes of a buffer: mapped, decoded from a data URI, or part of the GLB. data is NULL for a buffer without any (allowed,
 * as a placeholder for data that an extension brings). */
struct gltf_bytes {
    const uint8_t *data = nullptr;
    uint64_t size = 0;
    std::vector<uint8_t> owned;
    fmt_bytes mapped{};
    svo_paged *paged = nullptr; /* not NULL: only what was touched of `data` is in memory; see gltf_bytes_touch */
    gltf_bytes() = default;
    gltf_bytes(const gltf_bytes &) = delete;
    gltf_bytes &operator=(const gltf_bytes &) = delete;
    ~gltf_bytes()
    {
        svo_paged_free(paged);
        if (mapped.data != nullptr) fmt_bytes_close(&mapped);
    }
};

/* Memory that is taken elsewhere (by libraries, by pages of files) is accounted for in the allocator as long as this lives.
 * What is reserved is never written to, so that it costs nothing but its place in the account. */
class gltf_reserve
{
  public:
    gltf_reserve() = default;
    gltf_reserve(const gltf_reserve &) = delete;
    gltf_reserve &operator=(const gltf_reserve &) = delete;
    ~gltf_reserve() { release(); }
    /* Only where memory is limited. Throws, naming `what`. */
    void take(const import_context *c, uint64_t bytes, const char *what);
    void release();

  private:
    const svo_allocator *allocator_ = nullptr;
    void *charge_ = nullptr;
    uint64_t size_ = 0;
};

struct gltf_image {
    std::string name, uri, mime;
    int buffer_view = -1;
};

struct gltf_skin {
    std::vector<int> joints;
    int inverse_bind_matrices = -1;
};

/* A part of a node that an animation moves; numbers of accessors. */
struct gltf_track { int node, part, interpolation, input, output; };
struct gltf_animation {
    std::string name;
    std::vector<gltf_track> tracks;
};

struct gltf_document {
    const import_context *context = nullptr;
    tinygltf::Model model;
    std::vector<std::unique_ptr<gltf_bytes>> buffers;
    std::vector<gltf_image> images;
    std::vector<gltf_skin> skins;
    std::vector<gltf_animation> animations; /* only with a rig */
    std::vector<std::vector<int>> indices; /* accessor of each primitive of each mesh, -1: none */
    std::vector<int> parent; /* of each node, -1 for roots */
    int scene = -1;          /* default scene of the file, -1: none stated */
    uint64_t total_bytes = 0;
    uint64_t elements = 0; /* vertices and indices made so far, see gltf_charge */
    gltf_reserve text, files;     /* JSON in its forms; buffers */
    bool spilling = false;        /* triangles go to the spill, and buffers are read through the pager */
    svo_soup_file *soup = nullptr;

    gltf_document() = default;
    gltf_document(const gltf_document &) = delete;
    gltf_document &operator=(const gltf_document &) = delete;
    ~gltf_document() { svo_soup_file_release(soup); }

    const char *path() const { return context->path; }
    svo_warnings *warnings() const { return context->warnings; }
};

/* gltf_load.cpp */
void gltf_load(gltf_document &d, const uint8_t *bytes, uint64_t size);
/* A reference of the asset (percent-encoded relative path, or data URI) as bytes. */
std::unique_ptr<gltf_bytes> gltf_fetch(const gltf_document &d, const std::string &uri);
bool gltf_is_data_uri(const std::string &uri);

/* gltf_accessor.cpp: a checked window on an accessor. Every element below count can be read. */
class gltf_accessor
{
  public:
    /* what: for messages ("mesh 3, POSITION"). components: how many the use needs; max for types that may have more. */
    gltf_accessor(const gltf_document &d, int index, const char *what, int min_components, int max_components);
    uint64_t count() const { return count_; }
    int components() const { return components_; }
    int component_type() const { return type_; }
    /* Do floats hold every value of it? */
    bool fits_floats() const { return !normalized_ && (type_ == TINYGLTF_COMPONENT_TYPE_FLOAT || width_ < 4); }
    bool normalized() const { return normalized_; }
    /* components() values of element i, ints normalised where the accessor says so. */
    void get(uint64_t i, double *out) const;
    uint32_t get_index(uint64_t i) const; /* component 0 of an unsigned type */

  private:
    double component(const uint8_t *p) const;
    const uint8_t *at(uint64_t i) const;
    const uint8_t *data_ = nullptr; /* NULL: zeros */
    svo_paged *paged_ = nullptr, *sparse_paged_ = nullptr;
    uint64_t count_ = 0, stride_ = 0;
    int components_ = 0, type_ = 0, width_ = 0;
    bool normalized_ = false;
    std::vector<uint64_t> sparse_index_; /* ascending */
    gltf_reserve sparse_reserve_;
    const uint8_t *sparse_data_ = nullptr;
    uint64_t sparse_stride_ = 0;
};
/* Bytes of a buffer view, checked. paged may be NULL; else it receives the buffer's array, or NULL. */
const uint8_t *gltf_view_bytes(const gltf_document &d, int view, uint64_t *size, svo_paged **paged);
/* value of a normalised or plain integer component, as the accessor says */
double gltf_component_value(double raw, int component_type, bool normalized);

/* gltf_mesh.cpp: parts of one mesh, its morph targets added by their weights. With a skinning: positions skinned to world space by `joints`; where `keep` is given they stay as they
 * are, and what they are bound to goes there. */
struct fmt_rig_shape;
struct gltf_skinning {
    std::vector<svo_mat4> joints;
    size_t joint_count = 0;
    fmt_rig_shape *keep = nullptr; /* its array of parts is made */
};
void gltf_build_parts(gltf_document &d, int mesh, const std::vector<double> &morph, const gltf_skinning *skinning, svo_shape *shape);
/* The same checks for a mesh that is not drawn, so that a broken file is refused wherever it is broken. */
void gltf_check_mesh(gltf_document &d, int mesh);
/* A small file can name the same data many times. Refuses what goes far beyond the file's own size. */
void gltf_charge(gltf_document &d, uint64_t elements);

/* gltf_material.cpp */
void gltf_build_materials(gltf_document &d, const std::vector<bool> &used, svo_mesh *mesh);

/* draco_decode.cpp */
/* Bytes of memory for each byte of Draco data while it is unpacked. */
constexpr uint64_t GLTF_DRACO_COST = 64;
struct draco_attribute {
    uint32_t id;              /* unique id in the stream */
    int components;           /* filled */
    bool integral;            /* filled: values are raw integers */
    std::vector<float> values; /* filled: components per point */
};
/* Memory that decoding takes, at most, by the counts that the stream states; throws SVO_LIMIT for counts that no mesh has in so few bytes. To be asked
 * before draco_decode_mesh, which believes them. */
uint64_t draco_cost(const char *path, const uint8_t *bytes, uint64_t size);
void draco_decode_mesh(const char *path, const uint8_t *bytes, uint64_t size, std::vector<uint32_t> *indices, uint64_t *points,
                       std::vector<draco_attribute> *attributes);

/* Owned name copy or throw. */
inline char *gltf_copy(const gltf_document &d, const std::string &text)
{
    char *copy = svo_string_copy(d.context->allocator, text.c_str());
    if (copy == nullptr) throw std::bad_alloc();
    return copy;
}
template <class T> T *gltf_array(const gltf_document &d, uint64_t count, size_t per = 1)
{
    T *p = static_cast<T *>(svo_alloc(d.context->allocator, count, per * sizeof(T)));
    if (p == nullptr && count != 0) throw std::bad_alloc();
    return p;
}

#endif
