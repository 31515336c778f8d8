/* Faces of voxels to Draco bytes. */
#include "draco_faces.h"

#include "cxx_guard.hpp"
#include "draco_headers.hpp"
#include "svo_channel.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <vector>

namespace
{

struct ids {
    int position, normal, color;
};

/* Adds an attribute of `count` values, none of them equal, which the points name by an explicit map. */
int add(draco::Mesh *mesh, draco::GeometryAttribute::Type type, int8_t components, draco::DataType kind, size_t size, bool normalized, size_t count)
{
    draco::GeometryAttribute a;
    a.Init(type, nullptr, components, kind, normalized, static_cast<int64_t>(size) * components, 0);
    return mesh->AddAttribute(a, false, static_cast<uint32_t>(count));
}

uint64_t position_key(const fmt_cell_face &f, uint32_t corner)
{
    uint32_t at[3];
    fmt_cell_corner(&f, corner, at);
    return static_cast<uint64_t>(at[0]) << 44 | static_cast<uint64_t>(at[1]) << 22 | at[2]; /* at most 2^21 + 1 a side */
}

uint64_t color_key(const fmt_cell_face &f)
{
    return static_cast<uint64_t>(f.rgb[0]) << 16 | static_cast<uint64_t>(f.rgb[1]) << 8 | f.rgb[2];
}

void unite(std::vector<uint64_t> *keys)
{
    std::sort(keys->begin(), keys->end());
    keys->erase(std::unique(keys->begin(), keys->end()), keys->end());
}

uint32_t number_of(const std::vector<uint64_t> &keys, uint64_t key)
{
    return static_cast<uint32_t>(std::lower_bound(keys.begin(), keys.end(), key) - keys.begin());
}

/* Equal values and corners are found by sorting: Draco's own DeduplicateAttributeValues hashes whole floats so badly that a million faces
   take minutes. */
ids fill(draco::Mesh *mesh, const fmt_cell_face *faces, uint64_t count, bool colored)
{
    std::vector<uint64_t> positions, colors, corners(4 * count);
    positions.reserve(4 * count);
    for (uint64_t i = 0; i < count; i++) {
        for (uint32_t k = 0; k < 4; k++) positions.push_back(position_key(faces[i], k));
        if (colored && (i == 0 || color_key(faces[i]) != color_key(faces[i - 1]))) colors.push_back(color_key(faces[i]));
    }
    unite(&positions);
    unite(&colors);
    for (uint64_t i = 0; i < count; i++) { /* position 32 bits, colour 24, side 3 */
        const fmt_cell_face &f = faces[i];
        const uint64_t rest = (colored ? number_of(colors, color_key(f)) : 0u) * 8ull + static_cast<uint64_t>(f.axis) * 2 + (f.up ? 1 : 0);
        for (uint32_t k = 0; k < 4; k++) corners[4 * i + k] = static_cast<uint64_t>(number_of(positions, position_key(f, k))) << 27 | rest;
    }
    std::vector<uint64_t> points(corners);
    unite(&points);

    mesh->set_num_points(static_cast<uint32_t>(points.size()));
    mesh->SetNumFaces(2 * count);
    ids id{};
    id.position = add(mesh, draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32, 4, false, positions.size());
    id.normal = add(mesh, draco::GeometryAttribute::NORMAL, 3, draco::DT_FLOAT32, 4, false, 6);
    id.color = colored ? add(mesh, draco::GeometryAttribute::COLOR, 4, draco::DT_UINT16, 2, true, colors.size()) : -1;
    for (size_t i = 0; i < positions.size(); i++) {
        const uint64_t p = positions[i], mask = (1u << 22) - 1;
        const float at[3] = {static_cast<float>(p >> 44), static_cast<float>(p >> 22 & mask), static_cast<float>(p & mask)};
        mesh->attribute(id.position)->SetAttributeValue(draco::AttributeValueIndex(static_cast<uint32_t>(i)), at);
    }
    for (uint32_t i = 0; i < 6; i++) {
        float normal[3] = {0, 0, 0};
        normal[i / 2] = i % 2 != 0 ? 1.0f : -1.0f;
        mesh->attribute(id.normal)->SetAttributeValue(draco::AttributeValueIndex(i), normal);
    }
    for (size_t i = 0; i < colors.size(); i++) {
        uint16_t color[4] = {0, 0, 0, 65535};
        for (int k = 0; k < 3; k++) color[k] = static_cast<uint16_t>(svo_srgb_to_linear(static_cast<uint8_t>(colors[i] >> (16 - 8 * k))) * 65535.0f + 0.5f);
        mesh->attribute(id.color)->SetAttributeValue(draco::AttributeValueIndex(static_cast<uint32_t>(i)), color);
    }
    for (size_t i = 0; i < points.size(); i++) {
        const draco::PointIndex point(static_cast<uint32_t>(i));
        mesh->attribute(id.position)->SetPointMapEntry(point, draco::AttributeValueIndex(static_cast<uint32_t>(points[i] >> 27)));
        mesh->attribute(id.normal)->SetPointMapEntry(point, draco::AttributeValueIndex(static_cast<uint32_t>(points[i] & 7)));
        if (colored) mesh->attribute(id.color)->SetPointMapEntry(point, draco::AttributeValueIndex(static_cast<uint32_t>(points[i] >> 3 & 0xFFFFFF)));
    }
    for (uint64_t i = 0; i < count; i++) {
        draco::PointIndex p[4];
        for (uint32_t k = 0; k < 4; k++) p[k] = draco::PointIndex(number_of(points, corners[4 * i + k]));
        mesh->SetFace(draco::FaceIndex(static_cast<uint32_t>(2 * i)), {p[0], p[1], p[2]});
        mesh->SetFace(draco::FaceIndex(static_cast<uint32_t>(2 * i + 1)), {p[0], p[2], p[3]});
    }
    return id;
}

/* A triangle by its corners in cells and its colour, begun with the smallest corner, so that the winding stays. */
using triangle = std::array<uint32_t, 13>;

triangle canonical(const std::array<std::array<uint32_t, 3>, 3> &corner, const uint16_t *color)
{
    const size_t first = static_cast<size_t>(std::min_element(corner.begin(), corner.end()) - corner.begin());
    triangle t{};
    for (size_t k = 0; k < 3; k++)
        for (size_t i = 0; i < 3; i++) t[3 * k + i] = corner[(first + k) % 3][i];
    for (size_t i = 0; i < 4; i++) t[9 + i] = color != nullptr ? color[i] : 0u;
    return t;
}

std::vector<triangle> triangles_of(const draco::Mesh &mesh, const ids &id, fmt_draco_mesh *told)
{
    const draco::PointAttribute *position = mesh.attribute(id.position), *color = id.color >= 0 ? mesh.attribute(id.color) : nullptr;
    std::vector<triangle> list(mesh.num_faces());
    for (uint32_t i = 0; i < mesh.num_faces(); i++) {
        const draco::Mesh::Face &face = mesh.face(draco::FaceIndex(i));
        std::array<std::array<uint32_t, 3>, 3> corner{};
        uint16_t rgba[4] = {0, 0, 0, 0};
        for (size_t k = 0; k < 3; k++) {
            float at[3];
            position->GetMappedValue(face[k], at);
            for (size_t a = 0; a < 3; a++) {
                const double whole = std::floor(static_cast<double>(at[a]) + 0.5);
                corner[k][a] = static_cast<uint32_t>(whole);
                if (told != nullptr) told->position_error = std::max(told->position_error, std::fabs(static_cast<double>(at[a]) - whole));
            }
        }
        if (color != nullptr) color->GetMappedValue(face[0], rgba);
        list[i] = canonical(corner, color != nullptr ? rgba : nullptr);
    }
    std::sort(list.begin(), list.end());
    return list;
}

double normal_error(const draco::Mesh &mesh, const draco::PointAttribute &a)
{
    double worst = 0;
    for (uint32_t i = 0; i < mesh.num_points(); i++) {
        float f[3];
        a.GetMappedValue(draco::PointIndex(i), f);
        double n[3] = {std::fabs(static_cast<double>(f[0])), std::fabs(static_cast<double>(f[1])), std::fabs(static_cast<double>(f[2]))};
        std::sort(n, n + 3);
        worst = std::max(worst, std::atan2(std::hypot(n[0], n[1]), n[2]));
    }
    return worst * 57.295779513082320877;
}

uint32_t position_bits(const fmt_cell_face *faces, uint64_t count, uint32_t asked)
{
    uint32_t low = UINT32_MAX, high = 0; /* over all axes: no less than the longest side */
    for (uint64_t i = 0; i < count; i++)
        for (uint32_t k = 0; k < 4; k++) {
            uint32_t at[3];
            fmt_cell_corner(&faces[i], k, at);
            for (const uint32_t c : at) low = std::min(low, c), high = std::max(high, c);
        }
    const double cells = high - low;
    uint32_t fewest = 2;
    while (fewest < 30 && cells / (std::ldexp(1, static_cast<int>(fewest)) - 1) / 2 > 0.125) fewest++;
    if (asked == 0) return fewest;
    if (cells / (std::ldexp(1, static_cast<int>(asked)) - 1) / 2 >= 0.49)
        svo_throw(SVO_INVALID_ARGUMENT, "--draco %u: so few bits cannot tell corners in %.0f cells apart; %u do with an error below an eighth of a cell", asked, cells, fewest);
    return asked;
}

void encode(const fmt_cell_face *faces, uint64_t count, bool colored, uint32_t asked, svo_buffer *out, fmt_draco_mesh *told)
{
    *told = fmt_draco_mesh{};
    told->bits = position_bits(faces, count, asked);
    draco::Mesh mesh;
    const ids id = fill(&mesh, faces, count, colored);
    const std::vector<triangle> wanted = triangles_of(mesh, id, nullptr);
    told->position = mesh.attribute(id.position)->unique_id();
    told->normal = mesh.attribute(id.normal)->unique_id();
    told->color = colored ? mesh.attribute(id.color)->unique_id() : 0;

    draco::ExpertEncoder encoder(mesh);
    encoder.SetSpeedOptions(3, 3);
    encoder.SetAttributeQuantization(id.position, static_cast<int>(told->bits));
    encoder.SetAttributeQuantization(id.normal, 8);
    draco::EncoderBuffer packed;
    const draco::Status status = encoder.EncodeToBuffer(&packed);
    if (!status.ok()) svo_throw(SVO_RUNTIME, "Draco cannot encode the faces: %s", status.error_msg());

    draco::DecoderBuffer bytes;
    bytes.Init(packed.data(), packed.size());
    draco::Decoder decoder;
    auto result = decoder.DecodeMeshFromBuffer(&bytes);
    if (!result.ok()) svo_throw(SVO_RUNTIME, "Draco cannot read what it wrote: %s", result.status().error_msg());
    const std::unique_ptr<draco::Mesh> again = std::move(result).value();
    ids read{};
    read.position = again->GetAttributeIdByUniqueId(told->position);
    read.normal = again->GetAttributeIdByUniqueId(told->normal);
    read.color = colored ? again->GetAttributeIdByUniqueId(told->color) : -1;
    if (read.position < 0 || read.normal < 0 || (colored && read.color < 0) || triangles_of(*again, read, told) != wanted)
        svo_throw(SVO_RUNTIME, "Draco gives back other faces than it got");
    told->points = again->num_points();
    told->triangles = again->num_faces();
    told->normal_error = normal_error(*again, *again->attribute(read.normal));
    for (uint32_t i = 0; i < again->num_points(); i++) {
        float at[3];
        again->attribute(read.position)->GetMappedValue(draco::PointIndex(i), at);
        for (int k = 0; k < 3; k++) {
            if (i == 0 || at[k] < told->low[k]) told->low[k] = at[k];
            if (i == 0 || at[k] > told->high[k]) told->high[k] = at[k];
        }
    }
    if (svo_buffer_append(out, packed.data(), packed.size()) == nullptr) throw std::bad_alloc();
}

} // namespace

svo_result fmt_draco_faces(const fmt_cell_face *faces, uint64_t count, bool colored, uint32_t bits, svo_buffer *out, fmt_draco_mesh *told, svo_error *err)
{
    return svo_guard(err, [&]() -> svo_result {
        encode(faces, count, colored, bits, out, told);
        return SVO_OK;
    });
}
