/* Draco bytes to plain arrays, for glTF's KHR_draco_mesh_compression and for .drc files. */
#include "gltf_document.hpp"

#include "draco_headers.hpp"

#include <algorithm>
#include <cstring>

namespace
{

/* Attribute values, one per point. Integers come raw, so that the caller decides about normalisation. */
void read_attribute(const char *path, const draco::Mesh &mesh, const draco::PointAttribute &a, draco_attribute *out)
{
    int n = a.num_components();
    if (n < 1 || n > 4) svo_throw(SVO_INVALID_DATA, "%s: a Draco attribute has %d components", path, n);
    /* No attribute of a mesh means truth values, and Draco loads whatever byte is there as a bool, which C++ leaves undefined. */
    if (a.data_type() == draco::DT_BOOL) svo_throw(SVO_INVALID_DATA, "%s: a Draco attribute holds truth values", path);
    out->components = n;
    out->integral = a.data_type() != draco::DT_FLOAT32 && a.data_type() != draco::DT_FLOAT64;
    out->values.resize(static_cast<size_t>(mesh.num_points()) * static_cast<size_t>(n));
    for (uint32_t i = 0; i < mesh.num_points(); i++) {
        draco::AttributeValueIndex v = a.mapped_index(draco::PointIndex(i));
        if (v.value() >= a.size()) svo_throw(SVO_INVALID_DATA, "%s: a Draco attribute is inconsistent", path);
        float *to = &out->values[static_cast<size_t>(i) * static_cast<size_t>(n)];
        bool ok;
        if (out->integral) {
            int64_t raw[4];
            ok = a.ConvertValue<int64_t>(v, static_cast<int8_t>(n), raw);
            for (int k = 0; ok && k < n; k++) to[k] = static_cast<float>(raw[k]);
        } else {
            ok = a.ConvertValue<float>(v, static_cast<int8_t>(n), to);
        }
        if (!ok) svo_throw(SVO_INVALID_DATA, "%s: a Draco attribute cannot be converted", path);
    }
}

/* Faces that a byte may stand for, beside some that a file of any size may have. Draco's coder can write any number of equal symbols into no
 * bytes at all, so a count is never wrong for it, and it takes room for all faces before it reads the first. What its encoder makes of a
 * plane with a regular grid, its best case, has 28 faces a byte (qp 11, cl 10); scans have less than 3. */
constexpr uint64_t FACES_A_BYTE = 64, FACES_AT_LEAST = 65536;
/* Bytes that Draco takes for a face, with the arrays made of its mesh (a grid of a million faces with positions alone: 95 to 110). */
constexpr uint64_t FACE_COST = 160;

bool read_count(draco::DecoderBuffer *b, bool fixed, uint32_t *out) { return fixed ? b->Decode(out) : draco::DecodeVarint<uint32_t>(out, b); }

/* The largest of the counts of faces and points that stand at the head of a mesh's connectivity; 0 where the stream is no mesh, or ends
 * before (Draco says what is wrong with it then). */
uint64_t stated_count(const uint8_t *bytes, uint64_t size)
{
    draco::DecoderBuffer b;
    draco::DracoHeader h;
    b.Init(reinterpret_cast<const char *>(bytes), static_cast<size_t>(size));
    if (!draco::PointCloudDecoder::DecodeHeader(&b, &h).ok() || h.encoder_type != draco::TRIANGULAR_MESH) return 0;
    uint16_t version = DRACO_BITSTREAM_VERSION(h.version_major, h.version_minor);
    b.set_bitstream_version(version);
    if (version >= DRACO_BITSTREAM_VERSION(1, 3) && (h.flags & METADATA_FLAG_MASK) != 0) {
        draco::GeometryMetadata metadata;
        draco::MetadataDecoder decoder;
        if (!decoder.DecodeGeometryMetadata(&b, &metadata)) return 0;
    }
    bool edgebreaker = h.encoder_method == draco::MESH_EDGEBREAKER_ENCODING;
    bool old = version < DRACO_BITSTREAM_VERSION(2, 2);
    bool fixed = edgebreaker ? version < DRACO_BITSTREAM_VERSION(2, 0) : old;
    uint32_t first = 0, second = 0, added = 0;
    uint8_t traversal;
    if (edgebreaker && !b.Decode(&traversal)) return 0;
    if (edgebreaker && old && !read_count(&b, fixed, &added)) return 0;
    if (!read_count(&b, fixed, &first) || !read_count(&b, fixed, &second)) return 0;
    return std::max({first, second, added});
}

std::unique_ptr<draco::Mesh> decode(const char *path, const uint8_t *bytes, uint64_t size)
{
    draco::DecoderBuffer buffer;
    buffer.Init(reinterpret_cast<const char *>(bytes), static_cast<size_t>(size));
    draco::Decoder decoder;
    draco::StatusOr<std::unique_ptr<draco::Mesh>> result = decoder.DecodeMeshFromBuffer(&buffer);
    if (!result.ok()) svo_throw(SVO_INVALID_DATA, "%s: Draco data is broken: %.120s", path, result.status().error_msg());
    std::unique_ptr<draco::Mesh> mesh = std::move(result).value();
    if (mesh == nullptr) svo_throw(SVO_INVALID_DATA, "%s: Draco data is broken", path);
    return mesh;
}

void read_faces(const char *path, const draco::Mesh &mesh, std::vector<uint32_t> *indices)
{
    indices->resize(3 * static_cast<size_t>(mesh.num_faces()));
    for (uint32_t f = 0; f < mesh.num_faces(); f++) {
        const draco::Mesh::Face &face = mesh.face(draco::FaceIndex(f));
        for (size_t k = 0; k < 3; k++) {
            uint32_t i = face[k].value();
            if (i >= mesh.num_points()) svo_throw(SVO_INVALID_DATA, "%s: a Draco face refers to a point that does not exist", path);
            (*indices)[3 * static_cast<size_t>(f) + k] = i;
        }
    }
}

/* The one part of a .drc. */
void fill_drc(const import_context *c, const draco::Mesh &mesh, svo_part *part)
{
    gltf_document d; /* for its array helpers only */
    d.context = c;
    std::vector<uint32_t> indices;
    read_faces(c->path, mesh, &indices);
    uint64_t n = mesh.num_points();
    part->material = SVO_NONE;
    part->vertex_count = n;
    part->triangle_count = indices.size() / 3;
    const draco::PointAttribute *position = mesh.GetNamedAttribute(draco::GeometryAttribute::POSITION);
    if (position == nullptr || position->num_components() != 3) svo_throw(SVO_INVALID_DATA, "%s: Draco data has no 3-D positions", c->path);
    draco_attribute a{};
    read_attribute(c->path, mesh, *position, &a);
    part->positions = gltf_array<double>(d, n, 3);
    for (uint64_t i = 0; i < 3 * n; i++) part->positions[i] = static_cast<double>(a.values[i]);
    part->indices = gltf_array<uint32_t>(d, part->triangle_count, 3);
    if (!indices.empty()) std::memcpy(part->indices, indices.data(), indices.size() * sizeof(uint32_t));
    const draco::PointAttribute *normal = mesh.GetNamedAttribute(draco::GeometryAttribute::NORMAL);
    if (normal != nullptr && normal->num_components() == 3) {
        read_attribute(c->path, mesh, *normal, &a);
        part->normals = gltf_array<float>(d, n, 3);
        std::memcpy(part->normals, a.values.data(), 3 * n * sizeof(float));
    }
    const draco::PointAttribute *uv = mesh.GetNamedAttribute(draco::GeometryAttribute::TEX_COORD);
    if (uv != nullptr && uv->num_components() == 2) {
        read_attribute(c->path, mesh, *uv, &a);
        part->uvs[0] = gltf_array<float>(d, n, 2);
        for (uint64_t i = 0; i < n; i++) {
            part->uvs[0][2 * i] = a.values[2 * i];
            part->uvs[0][2 * i + 1] = 1 - a.values[2 * i + 1]; /* encoders keep OBJ's and PLY's bottom-left origin */
        }
    }
    const draco::PointAttribute *color = mesh.GetNamedAttribute(draco::GeometryAttribute::COLOR);
    if (color != nullptr && color->num_components() >= 3) {
        read_attribute(c->path, mesh, *color, &a);
        double scale = !a.integral ? 1 : color->data_type() == draco::DT_UINT16 ? 65535 : 255;
        part->colors = gltf_array<float>(d, n, 4);
        for (uint64_t i = 0; i < n; i++) {
            const float *from = &a.values[i * static_cast<uint64_t>(a.components)];
            for (uint64_t k = 0; k < 3; k++) part->colors[4 * i + k] = import_srgb_to_linear(static_cast<double>(from[k]) / scale);
            double alpha = a.components > 3 ? static_cast<double>(from[3]) / scale : 1;
            part->colors[4 * i + 3] = alpha >= 0 && alpha <= 1 ? static_cast<float>(alpha) : 1;
        }
    }
}

svo_result read_drc(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *out, svo_error *err)
{
    draco::DecoderBuffer probe;
    probe.Init(reinterpret_cast<const char *>(bytes), static_cast<size_t>(size));
    draco::StatusOr<draco::EncodedGeometryType> type = draco::Decoder::GetEncodedGeometryType(&probe);
    if (!type.ok()) svo_throw(SVO_INVALID_DATA, "%s: not Draco data: %.120s", c->path, type.status().error_msg());
    if (type.value() == draco::POINT_CLOUD) {
        svo_warn(c->warnings, "%s: a Draco point cloud has no faces", c->path);
        return import_single_shape(c, nullptr, 0, out, err);
    }
    gltf_reserve reserve;
    reserve.take(c, draco_cost(c->path, bytes, size), "Draco data");
    std::unique_ptr<draco::Mesh> mesh = decode(c->path, bytes, size);
    if (mesh->num_faces() == 0) return import_single_shape(c, nullptr, 0, out, err);
    svo_part *part = static_cast<svo_part *>(svo_calloc(c->allocator, 1, sizeof *part));
    if (part == nullptr) throw std::bad_alloc();
    try {
        fill_drc(c, *mesh, part);
    } catch (...) {
        import_part_free(c->allocator, part);
        svo_free(c->allocator, part, 1, sizeof *part);
        throw;
    }
    return import_single_shape(c, part, 1, out, err);
}

} // namespace

uint64_t draco_cost(const char *path, const uint8_t *bytes, uint64_t size)
{
    uint64_t n = stated_count(bytes, size), most = FACES_AT_LEAST + FACES_A_BYTE * size;
    if (n > most)
        svo_throw(SVO_LIMIT, "%s: Draco data of %llu bytes states %llu faces or points; more than %llu of that size are not decoded (should this be no damage, store the mesh without Draco)", path,
                  static_cast<unsigned long long>(size), static_cast<unsigned long long>(n), static_cast<unsigned long long>(most));
    return n == 0 ? GLTF_DRACO_COST * size : 4 * size + FACE_COST * n;
}

void draco_decode_mesh(const char *path, const uint8_t *bytes, uint64_t size, std::vector<uint32_t> *indices, uint64_t *points,
                       std::vector<draco_attribute> *attributes)
{
    std::unique_ptr<draco::Mesh> mesh = decode(path, bytes, size);
    read_faces(path, *mesh, indices);
    *points = mesh->num_points();
    for (draco_attribute &a : *attributes) {
        const draco::PointAttribute *from = mesh->GetAttributeByUniqueId(a.id);
        if (from == nullptr) svo_throw(SVO_INVALID_DATA, "%s: Draco data lacks attribute %u", path, a.id);
        read_attribute(path, *mesh, *from, &a);
    }
}

extern "C" svo_result import_drc(const import_context *c, const uint8_t *bytes, uint64_t size, svo_mesh *mesh, svo_error *err)
{
    return svo_guard(err, [&] { return read_drc(c, bytes, size, mesh, err); });
}
