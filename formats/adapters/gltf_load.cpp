/* The only file that compiles tinygltf. From bytes to a gltf_document: GLB frame, JSON, checks, tinygltf, buffers. */
#include <fstream> /* tinygltf's writers need it even with TINYGLTF_NO_FS */
#define TINYGLTF_IMPLEMENTATION
#include "gltf_check.hpp"

#include "fmt_container.h"

#include <algorithm>
#include <cstring>

namespace
{

struct frame {
    const char *text = nullptr;
    uint64_t text_size = 0;
    const uint8_t *bin = nullptr;
    uint64_t bin_size = 0;
};

frame split_glb(const gltf_document &d, const uint8_t *bytes, uint64_t size)
{
    const char *path = d.path();
    if (size < 12) svo_throw(SVO_INVALID_DATA, "%s: the GLB header is cut off", path);
    uint32_t version = fmt_load32(bytes + 4), length = fmt_load32(bytes + 8);
    if (version != 2) svo_throw(SVO_UNSUPPORTED, "%s: GLB version %u is not supported, only 2", path, version);
    if (length > size)
        svo_throw(SVO_INVALID_DATA, "%s: the GLB header says %u bytes, the file has %llu", path, length, (unsigned long long)size);
    if (length < size) svo_warn(d.warnings(), "%s: bytes after the end of the GLB are ignored", path);
    frame f;
    for (uint64_t at = 12, n = 0; at < length; n++) {
        if (length - at < 8) svo_throw(SVO_INVALID_DATA, "%s: a GLB chunk header is cut off", path);
        uint32_t chunk = fmt_load32(bytes + at), type = fmt_load32(bytes + at + 4);
        at += 8;
        if (chunk > length - at) svo_throw(SVO_INVALID_DATA, "%s: a GLB chunk goes beyond the end of the file", path);
        if (n == 0) {
            if (type != 0x4e4f534a) svo_throw(SVO_INVALID_DATA, "%s: the first GLB chunk is not JSON", path);
            f.text = reinterpret_cast<const char *>(bytes + at);
            f.text_size = chunk;
        } else if (type == 0x4e4f534a) {
            svo_throw(SVO_INVALID_DATA, "%s: a second JSON chunk in the GLB", path);
        } else if (type == 0x004e4942) {
            if (n != 1) svo_throw(SVO_INVALID_DATA, "%s: a BIN chunk of the GLB in a wrong place", path);
            f.bin = bytes + at;
            f.bin_size = chunk;
        } else {
            svo_warn(d.warnings(), "%s: a GLB chunk of unknown type is ignored", path);
        }
        if (chunk % 4 != 0) svo_warn(d.warnings(), "%s: a GLB chunk is not padded to 4 bytes", path);
        at += chunk;
    }
    if (f.text == nullptr) svo_throw(SVO_INVALID_DATA, "%s: the GLB has no JSON chunk", path);
    return f;
}

int hex(char c) { return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1; }

std::vector<uint8_t> percent_decode_bytes(const std::string &s, size_t i)
{
    std::vector<uint8_t> out;
    out.reserve(s.size() - i);
    for (; i < s.size(); i++) {
        int h = s[i] == '%' && i + 2 < s.size() ? hex(s[i + 1]) : -1, l = h >= 0 ? hex(s[i + 2]) : -1;
        if (l < 0) { /* a stray '%' stays: many writers do not encode */
            out.push_back(static_cast<uint8_t>(s[i]));
            continue;
        }
        out.push_back(static_cast<uint8_t>(h * 16 + l));
        i += 2;
    }
    return out;
}

std::string decode_path(const gltf_document &d, const std::string &s)
{
    std::vector<uint8_t> bytes = percent_decode_bytes(s, 0);
    std::string out(bytes.begin(), bytes.end());
    if (out.find('\0') != std::string::npos) svo_throw(SVO_INVALID_DATA, "%s: a file reference holds a NUL", d.path());
    return out;
}

std::vector<uint8_t> decode_base64(const gltf_document &d, const char *p, size_t n)
{
    auto value = [](char c) -> int {
        if (c >= 'A' && c <= 'Z') return c - 'A';
        if (c >= 'a' && c <= 'z') return c - 'a' + 26;
        if (c >= '0' && c <= '9') return c - '0' + 52;
        return c == '+' ? 62 : c == '/' ? 63 : -1;
    };
    while (n > 0 && p[n - 1] == '=') n--;
    std::vector<uint8_t> out;
    out.reserve(n / 4 * 3 + 3);
    uint32_t bits = 0;
    int have = 0;
    for (size_t i = 0; i < n; i++) {
        int v = value(p[i]);
        if (v < 0) svo_throw(SVO_INVALID_DATA, "%s: a data URI is not base64", d.path());
        bits = bits << 6 | static_cast<uint32_t>(v);
        have += 6;
        if (have >= 8) {
            have -= 8;
            out.push_back(static_cast<uint8_t>(bits >> have));
            bits &= (1u << have) - 1;
        }
    }
    if (have == 6) svo_throw(SVO_INVALID_DATA, "%s: a base64 data URI is cut off", d.path());
    return out;
}

void load_buffers(gltf_document &d, const nlohmann::json &root, const frame &f)
{
    auto it = root.find("buffers");
    if (it == root.end()) return;
    for (size_t i = 0; i < it->size(); i++) {
        const nlohmann::json &o = (*it)[i];
        uint64_t need = o["byteLength"].get<uint64_t>();
        auto uri = o.find("uri");
        std::unique_ptr<gltf_bytes> b;
        if (uri != o.end()) {
            b = gltf_fetch(d, uri->get_ref<const std::string &>());
        } else if (i == 0 && f.bin != nullptr) {
            b = std::make_unique<gltf_bytes>();
            b->data = f.bin;
            b->size = f.bin_size;
        } else {
            d.buffers.push_back(std::make_unique<gltf_bytes>());
            continue;
        }
        if (b->size < need)
            svo_throw(SVO_INVALID_DATA, "%s: buffer %zu has %llu bytes, %llu are stated", d.path(), i, (unsigned long long)b->size,
                      (unsigned long long)need);
        b->size = need;
        d.total_bytes += need;
        d.buffers.push_back(std::move(b));
    }
}

/* What the buffers take while they are read: as pages of files, or as what was decoded. */
void account_buffers(gltf_document &d, const frame &f)
{
    const import_context *c = d.context;
    if (c->spill == nullptr || c->pager == nullptr) return;
    uint64_t owned = 0, mapped = 0;
    for (const auto &b : d.buffers) {
        bool file = b->mapped.mapped || (b->data == f.bin && b->data != nullptr && c->mapped);
        *(file ? &mapped : &owned) += b->size;
    }
    /* Arrays of the mesh take two to three times what they do in the file. */
    d.spilling = c->spilling || owned + mapped > c->memory / 4;
    d.files.take(c, d.spilling ? owned : owned + mapped, "buffers");
    if (!d.spilling) return;
    for (auto &b : d.buffers) {
        if (!(b->mapped.mapped || (b->data == f.bin && b->data != nullptr && c->mapped)) || b->size == 0) continue;
        svo_error err{};
        svo_check(svo_paged_borrow(c->pager, b->data, b->size, &b->paged, &err), err);
        fmt_bytes_forget(b->data, b->size); /* a small file may still be there from the hash */
    }
}

void take_images(gltf_document &d, const nlohmann::json &root)
{
    auto it = root.find("images");
    if (it == root.end()) return;
    for (const nlohmann::json &o : *it) {
        gltf_image image;
        image.uri = o.value("uri", std::string());
        image.mime = o.value("mimeType", std::string());
        image.name = o.value("name", std::string());
        if (o.contains("bufferView")) image.buffer_view = static_cast<int>(o["bufferView"].get<uint64_t>());
        if (image.name.empty() && !gltf_is_data_uri(image.uri)) image.name = image.uri;
        d.images.push_back(std::move(image));
    }
}

/* tinygltf demands inverse bind matrices, which are optional. */
void take_skins(gltf_document &d, const nlohmann::json &root)
{
    auto it = root.find("skins");
    if (it == root.end()) return;
    for (const nlohmann::json &o : *it) {
        gltf_skin skin;
        for (const nlohmann::json &j : o["joints"]) skin.joints.push_back(static_cast<int>(j.get<uint64_t>()));
        if (o.contains("inverseBindMatrices")) skin.inverse_bind_matrices = static_cast<int>(o["inverseBindMatrices"].get<uint64_t>());
        d.skins.push_back(std::move(skin));
    }
}

/* tinygltf refuses index accessors without a buffer view, which Draco and sparse data have by right. */
void take_indices(gltf_document &d, nlohmann::json &root)
{
    auto it = root.find("meshes");
    if (it == root.end()) return;
    for (nlohmann::json &mesh : *it) {
        d.indices.emplace_back();
        for (nlohmann::json &primitive : mesh["primitives"]) {
            auto i = primitive.find("indices");
            d.indices.back().push_back(i != primitive.end() ? static_cast<int>(i->get<uint64_t>()) : -1);
            primitive.erase("indices");
        }
    }
}

/* What JSON takes in all of its forms: the text, its tree, the text again, tinygltf's tree and its model. Long strings, which are data,
 * are copied a few times; everything else becomes small objects. */
uint64_t json_cost(const frame &f)
{
    constexpr uint64_t COST = 16, STRING_COST = 4, OBJECT_COST = 1024;
    constexpr ptrdiff_t LONG = 256;
    uint64_t strings = 0;
    const uint64_t objects = static_cast<uint64_t>(std::count(f.text, f.text + f.text_size, '{'));
    const char *p = f.text, *end = f.text + f.text_size;
    while ((p = static_cast<const char *>(std::memchr(p, '"', static_cast<size_t>(end - p)))) != nullptr) {
        const char *close = static_cast<const char *>(std::memchr(p + 1, '"', static_cast<size_t>(end - p - 1)));
        if (close == nullptr) break;
        if (close - p > LONG) strings += static_cast<uint64_t>(close - p);
        p = close + 1;
    }
    return COST * (f.text_size - strings) + STRING_COST * strings + OBJECT_COST * objects;
}

} // namespace

void gltf_reserve::take(const import_context *c, uint64_t bytes, const char *what)
{
    release();
    if (c->memory == 0 || bytes == 0) return;
    charge_ = svo_alloc(c->allocator, bytes, 1);
    if (charge_ == nullptr)
        svo_throw(SVO_OUT_OF_MEMORY, "%s: %s would take %.1f MB more, which are not left", c->path, what, static_cast<double>(bytes) / 1e6);
    allocator_ = c->allocator;
    size_ = bytes;
}

void gltf_reserve::release()
{
    svo_free(allocator_, charge_, size_, 1);
    charge_ = nullptr;
}

bool gltf_is_data_uri(const std::string &uri) { return uri.compare(0, 5, "data:") == 0; }

std::unique_ptr<gltf_bytes> gltf_fetch(const gltf_document &d, const std::string &uri)
{
    auto b = std::make_unique<gltf_bytes>();
    if (gltf_is_data_uri(uri)) {
        size_t comma = uri.find(',');
        if (comma == std::string::npos) svo_throw(SVO_INVALID_DATA, "%s: a data URI has no data", d.path());
        if (comma >= 7 && uri.compare(comma - 7, 7, ";base64") == 0) b->owned = decode_base64(d, uri.data() + comma + 1, uri.size() - comma - 1);
        else b->owned = percent_decode_bytes(uri, comma + 1);
        b->data = b->owned.data();
        b->size = b->owned.size();
        return b;
    }
    char path[IMPORT_PATH_MAX];
    svo_error err{};
    svo_check(import_resolve(d.context, decode_path(d, uri).c_str(), path, &err), err);
    svo_check(import_open(d.context, path, &b->mapped, &err), err);
    b->data = b->mapped.data;
    b->size = b->mapped.size;
    return b;
}

void gltf_load(gltf_document &d, const uint8_t *bytes, uint64_t size)
{
    frame f;
    if (size >= 4 && std::memcmp(bytes, "glTF", 4) == 0) {
        f = split_glb(d, bytes, size);
    } else {
        f.text = reinterpret_cast<const char *>(bytes);
        f.text_size = size;
        /* a byte order mark is not allowed but harmless */
        if (size >= 3 && std::memcmp(bytes, "\xef\xbb\xbf", 3) == 0) f.text += 3, f.text_size -= 3;
    }
    d.text.take(d.context, json_cost(f), "the JSON text");
    std::string slim;
    {
        nlohmann::json root = gltf_parse_json(d.path(), f.text, f.text_size);
        gltf_check(d, root);
        load_buffers(d, root, f);
        account_buffers(d, f);
        take_images(d, root);
        take_skins(d, root);
        if (d.context->rig != nullptr) gltf_take_animations(d, root);
        take_indices(d, root);
        for (const char *key : {"buffers", "images", "skins", "animations", "extras"}) root.erase(key);
        slim = root.dump();
    }
    if (slim.size() > UINT32_MAX / 2) svo_throw(SVO_LIMIT, "%s: more than 2 GiB of JSON", d.path());
    tinygltf::TinyGLTF loader;
    std::string error, warning;
    bool ok = loader.LoadASCIIFromString(&d.model, &error, &warning, slim.data(), static_cast<unsigned>(slim.size()), "");
    while (!error.empty() && error.back() == '\n') error.pop_back();
    if (!ok && error.find("bad_alloc") != std::string::npos) throw std::bad_alloc(); /* it turns exceptions into text */
    /* tinygltf leaves out what it cannot read and only says so: an error text is as bad as a refusal. */
    if (!ok || !error.empty()) svo_throw(SVO_INVALID_DATA, "%s: %.180s", d.path(), error.empty() ? "not a glTF asset" : error.c_str());
}
