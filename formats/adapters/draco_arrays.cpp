/* Plain arrays to Draco bytes. */
#include "fmti_draco.h"

#include "draco_headers.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <vector>

#include "cxx_guard.hpp"

namespace
{

size_t type_size(fmt_draco_type t) { return t == FMT_DRACO_F32 ? 4 : t == FMT_DRACO_U16 ? 2 : 1; }

int add_attribute(draco::Mesh *mesh, draco::GeometryAttribute::Type kind, draco::DataType type, size_t components, size_t size, const void *values, uint64_t count)
{
    draco::GeometryAttribute a;
    a.Init(kind, nullptr, static_cast<int8_t>(components), type, false, static_cast<int64_t>(components * size), 0);
    int id = mesh->AddAttribute(a, true, static_cast<uint32_t>(count));
    if (id < 0) svo_throw(SVO_RUNTIME, "Draco takes no attribute of %zu components", components);
    draco::PointAttribute *to = mesh->attribute(id);
    const uint8_t *from = static_cast<const uint8_t *>(values);
    for (uint32_t v = 0; v < count; v++) to->SetAttributeValue(draco::AttributeValueIndex(v), from + v * components * size);
    return id;
}

/* number: with a last attribute that tells which vertex it was, for the measurement alone. */
void fill(const fmt_draco_arrays &m, bool number, draco::Mesh *mesh)
{
    static const draco::GeometryAttribute::Type kinds[] = {draco::GeometryAttribute::POSITION, draco::GeometryAttribute::NORMAL, draco::GeometryAttribute::COLOR,
                                                           draco::GeometryAttribute::TEX_COORD, draco::GeometryAttribute::GENERIC};
    static const draco::DataType types[] = {draco::DT_FLOAT32, draco::DT_UINT8, draco::DT_UINT16};
    mesh->set_num_points(static_cast<uint32_t>(m.vertices));
    mesh->SetNumFaces(static_cast<size_t>(m.triangles));
    for (uint32_t t = 0; t < m.triangles; t++) {
        draco::Mesh::Face f;
        for (uint32_t k = 0; k < 3; k++) f[k] = draco::PointIndex(m.corner[3 * static_cast<size_t>(t) + k]);
        mesh->SetFace(draco::FaceIndex(t), f);
    }
    for (uint32_t i = 0; i < m.attribute_count; i++) {
        const fmt_draco_attribute &a = m.attribute[i];
        int id = add_attribute(mesh, kinds[a.kind], types[a.type], a.components, type_size(a.type), a.values, m.vertices);
        mesh->attribute(id)->set_unique_id(i);
    }
    if (!number) return;
    std::vector<uint32_t> numbers(static_cast<size_t>(m.vertices));
    for (uint32_t v = 0; v < m.vertices; v++) numbers[v] = v;
    int id = add_attribute(mesh, draco::GeometryAttribute::GENERIC, draco::DT_UINT32, 1, 4, numbers.data(), m.vertices);
    mesh->attribute(id)->set_unique_id(m.attribute_count);
}

bool encode_by(const fmt_draco_arrays &m, bool number, int method, draco::EncoderBuffer *out, std::string *why)
{
    draco::Mesh mesh;
    fill(m, number, &mesh);
    draco::ExpertEncoder encoder(mesh);
    encoder.SetEncodingMethod(method);
    encoder.SetSpeedOptions(3, 3);
    for (uint32_t i = 0; i < m.attribute_count; i++)
        if (m.attribute[i].type == FMT_DRACO_F32 && m.attribute[i].bits > 0) encoder.SetAttributeQuantization(static_cast<int32_t>(i), static_cast<int>(m.attribute[i].bits));
    out->Clear();
    draco::Status s = encoder.EncodeToBuffer(out);
    if (!s.ok()) *why = s.error_msg();
    return s.ok();
}

std::unique_ptr<draco::Mesh> decode(const draco::EncoderBuffer &bytes)
{
    draco::DecoderBuffer b;
    b.Init(bytes.data(), bytes.size());
    draco::Decoder decoder;
    auto r = decoder.DecodeMeshFromBuffer(&b);
    if (!r.ok()) svo_throw(SVO_RUNTIME, "Draco cannot decode what it encoded: %.120s", r.status().error_msg());
    return std::move(r).value();
}

const draco::PointAttribute &attribute_of(const draco::Mesh &mesh, uint32_t id)
{
    const draco::PointAttribute *a = mesh.GetAttributeByUniqueId(id);
    if (a == nullptr) svo_throw(SVO_RUNTIME, "Draco lost an attribute");
    return *a;
}

void value_of(const draco::PointAttribute &a, uint32_t point, uint32_t components, double *out)
{
    if (!a.ConvertValue<double>(a.mapped_index(draco::PointIndex(point)), static_cast<int8_t>(components), out)) svo_throw(SVO_RUNTIME, "Draco gives a value that is none");
}

double given(const fmt_draco_attribute &a, uint32_t vertex, uint32_t k)
{
    size_t i = static_cast<size_t>(vertex) * a.components + k;
    if (a.type == FMT_DRACO_F32) return static_cast<double>(static_cast<const float *>(a.values)[i]);
    return a.type == FMT_DRACO_U16 ? static_cast<const uint16_t *>(a.values)[i] : static_cast<const uint8_t *>(a.values)[i];
}

double difference(const fmt_draco_attribute &a, const double *x, const double *y)
{
    double most = 0, sum = 0, xx = 0, yy = 0, xy = 0;
    for (uint32_t k = 0; k < a.components; k++) {
        most = std::max(most, std::fabs(x[k] - y[k]));
        sum += (x[k] - y[k]) * (x[k] - y[k]);
        xx += x[k] * x[k];
        yy += y[k] * y[k];
        xy += x[k] * y[k];
    }
    if (a.kind == FMT_DRACO_POSITION) return std::sqrt(sum);
    if (a.kind == FMT_DRACO_NORMAL) return xx > 0 && yy > 0 ? std::acos(std::min(1.0, std::max(-1.0, xy / std::sqrt(xx * yy)))) * 57.29577951308232 : 0;
    return most;
}

/* The vertex that each decoded point was: from the second encoding, where its decoding is the same as the first but for the numbers. */
bool find_sources(const fmt_draco_arrays &m, const draco::Mesh &mesh, const draco::Mesh &numbered, std::vector<uint32_t> *source)
{
    if (mesh.num_points() != numbered.num_points() || mesh.num_faces() != numbered.num_faces()) return false;
    for (uint32_t f = 0; f < mesh.num_faces(); f++)
        if (mesh.face(draco::FaceIndex(f)) != numbered.face(draco::FaceIndex(f))) return false;
    for (uint32_t i = 0; i < m.attribute_count; i++) {
        const draco::PointAttribute &a = attribute_of(mesh, i), &b = attribute_of(numbered, i);
        for (uint32_t p = 0; p < mesh.num_points(); p++) {
            double x[4], y[4];
            value_of(a, p, m.attribute[i].components, x);
            value_of(b, p, m.attribute[i].components, y);
            if (!std::equal(x, x + m.attribute[i].components, y)) return false;
        }
    }
    const draco::PointAttribute &n = attribute_of(numbered, m.attribute_count);
    source->resize(mesh.num_points());
    for (uint32_t p = 0; p < mesh.num_points(); p++) {
        double v;
        value_of(n, p, 1, &v);
        if (!(v >= 0 && v < static_cast<double>(m.vertices))) return false;
        (*source)[p] = static_cast<uint32_t>(v);
    }
    return true;
}

void measure(fmt_draco_arrays *m, const draco::Mesh &mesh, const std::vector<uint32_t> &source)
{
    m->decoded_vertices = mesh.num_points();
    m->decoded_triangles = mesh.num_faces();
    for (uint32_t i = 0; i < m->attribute_count; i++) {
        fmt_draco_attribute &a = m->attribute[i];
        const draco::PointAttribute &d = attribute_of(mesh, i);
        a.error = 0;
        for (uint32_t k = 0; k < a.components; k++) {
            a.low[k] = INFINITY;
            a.high[k] = -INFINITY;
        }
        for (uint32_t p = 0; p < mesh.num_points(); p++) {
            double x[4], y[4];
            value_of(d, p, a.components, x);
            for (uint32_t k = 0; k < a.components; k++) {
                a.low[k] = std::min(a.low[k], x[k]);
                a.high[k] = std::max(a.high[k], x[k]);
                if (m->measured) y[k] = given(a, source[p], k);
            }
            if (m->measured) a.error = std::max(a.error, difference(a, x, y));
        }
        if (m->measured || a.type != FMT_DRACO_F32 || a.bits == 0) continue;
        double range = 0; /* half a step in every direction */
        for (uint32_t k = 0; k < a.components; k++) range = std::max(range, a.high[k] - a.low[k]);
        double step = range / (std::pow(2.0, a.bits) - 1);
        a.error = a.kind == FMT_DRACO_NORMAL ? 360 / std::pow(2.0, a.bits) : a.kind == FMT_DRACO_POSITION ? step * std::sqrt(3.0) / 2 : step / 2;
    }
}

} // namespace

svo_result fmt_draco_pack(fmt_draco_arrays *m, svo_buffer *to, svo_error *err)
{
    return svo_guard(err, [&]() -> svo_result {
        if (m->vertices >= INT32_MAX || m->triangles >= INT32_MAX) svo_throw(SVO_LIMIT, "Draco takes fewer than 2^31 vertices and triangles");
        draco::EncoderBuffer bytes, numbered;
        std::string why;
        int method = draco::MESH_EDGEBREAKER_ENCODING;
        if (!encode_by(*m, false, method, &bytes, &why)) {
            method = draco::MESH_SEQUENTIAL_ENCODING; /* takes any triangles */
            if (!encode_by(*m, false, method, &bytes, &why)) svo_throw(SVO_RUNTIME, "Draco cannot encode the mesh: %.120s", why.c_str());
        }
        std::unique_ptr<draco::Mesh> mesh = decode(bytes);
        std::vector<uint32_t> source;
        m->measured = encode_by(*m, true, method, &numbered, &why) && find_sources(*m, *mesh, *decode(numbered), &source);
        measure(m, *mesh, source);
        if (svo_buffer_append(to, bytes.data(), bytes.size()) == nullptr) throw std::bad_alloc();
        return SVO_OK;
    });
}
