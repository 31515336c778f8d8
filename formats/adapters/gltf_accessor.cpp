#include "gltf_document.hpp"

#include "fmt_container.h"

#include <algorithm>
#include <cstring>

namespace
{

int width_of(int component_type)
{
    switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE: return 1;
    case TINYGLTF_COMPONENT_TYPE_SHORT:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT: return 2;
    default: return 4;
    }
}

/* Do count elements of size `element`, `stride` apart, from offset on, fit into size bytes? */
bool fits(uint64_t size, uint64_t offset, uint64_t count, uint64_t stride, uint64_t element)
{
    if (count == 0) return true;
    if (offset > size || element > size - offset) return false;
    uint64_t room = size - offset - element;
    return (count - 1) <= room / stride;
}

uint32_t load_unsigned(const uint8_t *p, int width) { return width == 1 ? *p : width == 2 ? fmt_load16(p) : fmt_load32(p); }

} // namespace

const uint8_t *gltf_view_bytes(const gltf_document &d, int view, uint64_t *size, svo_paged **paged)
{
    const tinygltf::BufferView &v = d.model.bufferViews.at(static_cast<size_t>(view));
    const gltf_bytes &b = *d.buffers.at(static_cast<size_t>(v.buffer));
    if (b.data == nullptr) {
        for (const char *e : {"EXT_meshopt_compression", "KHR_meshopt_compression"})
            if (v.extensions.count(e) != 0)
                svo_throw(SVO_UNSUPPORTED, "%s: the geometry is only there as %s, which is not supported", d.path(), e);
        svo_throw(SVO_INVALID_DATA, "%s: buffer %d has no data", d.path(), v.buffer);
    }
    if (v.byteOffset > b.size || v.byteLength > b.size - v.byteOffset)
        svo_throw(SVO_INVALID_DATA, "%s: buffer view %d goes beyond its buffer", d.path(), view);
    *size = v.byteLength;
    if (paged != nullptr) *paged = b.paged;
    return b.data + v.byteOffset;
}

double gltf_component_value(double raw, int component_type, bool normalized)
{
    if (!normalized) return raw;
    switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE: return std::max(raw / 127.0, -1.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE: return raw / 255.0;
    case TINYGLTF_COMPONENT_TYPE_SHORT: return std::max(raw / 32767.0, -1.0);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT: return raw / 65535.0;
    default: return raw;
    }
}

gltf_accessor::gltf_accessor(const gltf_document &d, int index, const char *what, int min_components, int max_components)
{
    const tinygltf::Accessor &a = d.model.accessors.at(static_cast<size_t>(index));
    auto bad = [&](const char *why) { svo_throw(SVO_INVALID_DATA, "%s: accessor %d (%.60s): %s", d.path(), index, what, why); };
    components_ = tinygltf::GetNumComponentsInType(static_cast<uint32_t>(a.type));
    if (components_ < min_components || components_ > max_components) bad("wrong type for its use");
    type_ = a.componentType;
    width_ = width_of(type_);
    normalized_ = a.normalized;
    count_ = a.count;
    uint64_t element = static_cast<uint64_t>(components_) * static_cast<uint64_t>(width_);
    if (a.bufferView >= 0) {
        uint64_t size = 0;
        const uint8_t *view = gltf_view_bytes(d, a.bufferView, &size, &paged_);
        const tinygltf::BufferView &v = d.model.bufferViews[static_cast<size_t>(a.bufferView)];
        stride_ = v.byteStride != 0 ? v.byteStride : element;
        if (stride_ < element) bad("byteStride is smaller than an element");
        if (!fits(size, a.byteOffset, count_, stride_, element)) bad("goes beyond its buffer view");
        data_ = view + a.byteOffset;
    } else {
        stride_ = element;
        if (count_ > (uint64_t{1} << 24) && count_ > d.total_bytes)
            svo_throw(SVO_LIMIT, "%s: accessor %d has %llu elements without data", d.path(), index, (unsigned long long)count_);
    }
    if (!a.sparse.isSparse) return;
    uint64_t n = static_cast<uint64_t>(a.sparse.count), size = 0;
    if (n > count_) bad("has more sparse elements than elements");
    int index_width = width_of(a.sparse.indices.componentType);
    const uint8_t *indices = gltf_view_bytes(d, a.sparse.indices.bufferView, &size, &sparse_paged_);
    uint64_t offset = static_cast<uint64_t>(a.sparse.indices.byteOffset);
    if (!fits(size, offset, n, static_cast<uint64_t>(index_width), static_cast<uint64_t>(index_width)))
        bad("sparse indices go beyond their buffer view");
    sparse_reserve_.take(d.context, n * sizeof(uint64_t), "sparse accessors");
    sparse_index_.resize(n);
    for (uint64_t i = 0; i < n; i++) {
        if (sparse_paged_ != nullptr)
            svo_paged_touch(sparse_paged_, indices + offset + i * static_cast<uint64_t>(index_width), static_cast<uint64_t>(index_width));
        sparse_index_[i] = load_unsigned(indices + offset + i * static_cast<uint64_t>(index_width), index_width);
        if (sparse_index_[i] >= count_) bad("a sparse index is out of range");
        if (i > 0 && sparse_index_[i] <= sparse_index_[i - 1]) bad("sparse indices do not increase");
    }
    const uint8_t *values = gltf_view_bytes(d, a.sparse.values.bufferView, &size, &sparse_paged_);
    offset = static_cast<uint64_t>(a.sparse.values.byteOffset);
    if (!fits(size, offset, n, element, element)) bad("sparse values go beyond their buffer view");
    sparse_data_ = values + offset;
    sparse_stride_ = element;
}

const uint8_t *gltf_accessor::at(uint64_t i) const
{
    if (!sparse_index_.empty()) {
        auto it = std::lower_bound(sparse_index_.begin(), sparse_index_.end(), i);
        if (it != sparse_index_.end() && *it == i) {
            const uint8_t *p = sparse_data_ + static_cast<uint64_t>(it - sparse_index_.begin()) * sparse_stride_;
            if (sparse_paged_ != nullptr) svo_paged_touch(sparse_paged_, p, sparse_stride_);
            return p;
        }
    }
    if (data_ == nullptr) return nullptr;
    const uint8_t *p = data_ + i * stride_;
    if (paged_ != nullptr) svo_paged_touch(paged_, p, static_cast<uint64_t>(components_) * static_cast<uint64_t>(width_));
    return p;
}

double gltf_accessor::component(const uint8_t *p) const
{
    switch (type_) {
    case TINYGLTF_COMPONENT_TYPE_BYTE: return static_cast<int8_t>(*p);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE: return *p;
    case TINYGLTF_COMPONENT_TYPE_SHORT: return static_cast<int16_t>(fmt_load16(p));
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT: return fmt_load16(p);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT: return fmt_load32(p);
    default: {
        float f;
        std::memcpy(&f, p, sizeof f);
        return static_cast<double>(f);
    }
    }
}

void gltf_accessor::get(uint64_t i, double *out) const
{
    const uint8_t *p = at(i);
    for (int k = 0; k < components_; k++)
        out[k] = p != nullptr ? gltf_component_value(component(p + k * width_), type_, normalized_) : 0;
}

uint32_t gltf_accessor::get_index(uint64_t i) const
{
    const uint8_t *p = at(i);
    return p != nullptr ? load_unsigned(p, width_) : 0;
}
