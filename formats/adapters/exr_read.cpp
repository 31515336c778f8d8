// OpenEXR pictures in. Where the library is not found, SVO_HAVE_OPENEXR is not defined and reading says so.
#include "exr_read.h"

#include "cxx_guard.hpp"

#include <cstring>

#ifdef SVO_HAVE_OPENEXR
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfIO.h>
#include <OpenEXR/ImfInputFile.h>

#include <cstdint>
#include <vector>

namespace {

constexpr int most_side = 65536;
constexpr std::uint32_t deep_flag = 0x800, parts_flag = 0x1000;
constexpr std::uint64_t default_pixels = std::uint64_t{1} << 28;

// Bytes in memory as the library reads them.
class memory_stream : public Imf::IStream {
public:
    memory_stream(const std::uint8_t *bytes, std::uint64_t size) : Imf::IStream("picture"), bytes_(bytes), size_(size) {}
    bool read(char c[], int n) override
    {
        take(n);
        std::memcpy(c, bytes_ + at_ - static_cast<std::uint64_t>(n), static_cast<std::size_t>(n));
        return at_ < size_;
    }
    std::uint64_t tellg() override { return at_; }
    void seekg(std::uint64_t to) override { at_ = to; }

private:
    void take(int n)
    {
        if (n < 0 || at_ > size_ || static_cast<std::uint64_t>(n) > size_ - at_) svo_throw(SVO_INVALID_DATA, "the OpenEXR picture is cut off");
        at_ += static_cast<std::uint64_t>(n);
    }
    const std::uint8_t *bytes_;
    std::uint64_t size_, at_ = 0;
};

// The library takes the memory that attributes and windows ask for before it looks whether the file can hold so much, and goes by what attributes of the types it knows say of themselves,
// not by the sizes that the file states. So headers are read here first, and both must say the same.
class header_check {
public:
    header_check(const std::uint8_t *bytes, std::uint64_t size, std::uint64_t max_pixels) : bytes_(bytes), size_(size), max_pixels_(max_pixels) {}
    void run()
    {
        at_ = 4;
        const std::uint32_t version = number();
        if ((version & 0xff) != 2) svo_throw(SVO_UNSUPPORTED, "OpenEXR file version %u is not known", version & 0xff);
        if ((version & deep_flag) != 0) svo_throw(SVO_UNSUPPORTED, "deep OpenEXR pictures are not read");
        do header();
        while ((version & parts_flag) != 0 && peek() != 0); // of several parts an empty header is the last
    }

    std::int64_t first_width = 0, first_height = 0; // of the first part

private:
    std::uint8_t peek() const
    {
        if (at_ >= size_) cut_off();
        return bytes_[at_];
    }
    [[noreturn]] static void cut_off() { svo_throw(SVO_INVALID_DATA, "the OpenEXR picture is cut off"); }
    std::uint32_t number()
    {
        if (size_ - at_ < 4) cut_off();
        const std::uint8_t *b = bytes_ + at_;
        at_ += 4;
        return b[0] | static_cast<std::uint32_t>(b[1]) << 8 | static_cast<std::uint32_t>(b[2]) << 16 | static_cast<std::uint32_t>(b[3]) << 24;
    }
    const char *word()
    {
        if (at_ > size_) cut_off();
        const void *end = std::memchr(bytes_ + at_, 0, static_cast<std::size_t>(size_ - at_));
        if (end == nullptr) cut_off();
        const char *text = reinterpret_cast<const char *>(bytes_) + at_;
        at_ = static_cast<std::uint64_t>(static_cast<const std::uint8_t *>(end) - bytes_) + 1;
        return text;
    }
    void header()
    {
        std::int64_t width = 1, height = 1;
        std::int64_t tile_width = 0, tile_height = 0;
        bool tiled = false;
        while (peek() != 0) {
            const char *name = word(), *type = word();
            const std::uint32_t length = number();
            if (length > size_ - at_) svo_throw(SVO_INVALID_DATA, "attribute %.60s of the OpenEXR picture is longer than the file", name);
            const std::uint64_t next = at_ + length, begin = at_;
            if (!sound(type, length)) svo_throw(SVO_INVALID_DATA, "attribute %.60s of the OpenEXR picture has a wrong size", name);
            at_ = begin;
            if (std::strcmp(name, "dataWindow") == 0 && length == 16) {
                std::int64_t box[4];
                for (std::int64_t &v : box) v = static_cast<std::int32_t>(number());
                width = box[2] - box[0] + 1, height = box[3] - box[1] + 1;
            } else if (std::strcmp(name, "tiles") == 0 && length >= 8) {
                tile_width = number(), tile_height = number();
                tiled = true;
            }
            at_ = next;
        }
        at_++;
        check(width, height, tiled ? tile_width : width, tiled ? tile_height : height < 256 ? height : 256); // (no compression takes more than 256 rows together)
        if (first_width == 0) first_width = width, first_height = height;
    }
    // Has an attribute of this type (from at_ on) this length? Of unknown types any will do: they are kept as bytes.
    bool sound(const char *type, std::uint32_t length)
    {
        static const struct { const char *type; std::uint32_t length; } fixed[] = {
            {"box2i", 16}, {"box2f", 16}, {"chromaticities", 32}, {"compression", 1}, {"deepImageState", 1}, {"double", 8}, {"envmap", 1}, {"float", 4}, {"int", 4}, {"keycode", 28}, {"lineOrder", 1},
            {"m33d", 72}, {"m33f", 36}, {"m44d", 128}, {"m44f", 64}, {"rational", 8}, {"tiledesc", 9}, {"timecode", 8}, {"v2d", 16}, {"v2f", 8}, {"v2i", 8}, {"v3d", 24}, {"v3f", 12}, {"v3i", 12}};
        for (const auto &f : fixed)
            if (std::strcmp(type, f.type) == 0) return length == f.length;
        const std::uint64_t end = at_ + length;
        if (std::strcmp(type, "idmanifest") == 0) svo_throw(SVO_UNSUPPORTED, "OpenEXR pictures with a manifest of identifiers are not read");
        if (std::strcmp(type, "floatvector") == 0) return length % 4 == 0;
        if (std::strcmp(type, "preview") == 0) {
            if (length < 8) return false;
            const std::uint64_t width = number(), height = number();
            return width * height <= length && 8 + 4 * width * height == length; // (both have 32 bits)
        }
        if (std::strcmp(type, "stringvector") == 0) {
            while (at_ < end) {
                if (end - at_ < 4) return false;
                const std::uint32_t text = number();
                if (text > end - at_) return false;
                at_ += text;
            }
        }
        if (std::strcmp(type, "chlist") == 0) {
            while (at_ < end && bytes_[at_] != 0) {
                word();
                at_ += 16; // type, whether linear, sampling
            }
            return at_ + 1 == end;
        }
        return true;
    }
    // Every block has a place of 8 bytes in a table.
    void check(std::int64_t width, std::int64_t height, std::int64_t block_width, std::int64_t block_height) const
    {
        if (width < 1 || height < 1) svo_throw(SVO_INVALID_DATA, "the OpenEXR picture has no pixels");
        if (width > most_side || height > most_side || static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(height) > max_pixels_)
            svo_throw(SVO_LIMIT, "%lld x %lld pixels are too many", static_cast<long long>(width), static_cast<long long>(height));
        if (block_width < 1 || block_height < 1) svo_throw(SVO_INVALID_DATA, "the OpenEXR picture has tiles without pixels");
        if (block_width > most_side || block_height > most_side || static_cast<std::uint64_t>(block_width) * static_cast<std::uint64_t>(block_height) > max_pixels_ + 256 * 256)
            svo_throw(SVO_LIMIT, "tiles of %lld x %lld pixels are too large", static_cast<long long>(block_width), static_cast<long long>(block_height));
        const std::uint64_t blocks = static_cast<std::uint64_t>((width + block_width - 1) / block_width) * static_cast<std::uint64_t>((height + block_height - 1) / block_height);
        if (blocks > size_ / 8) cut_off();
    }
    const std::uint8_t *bytes_;
    std::uint64_t size_, max_pixels_, at_ = 0;
};

// Samples of a channel, of which there is one for every xs * ys pixels whose coordinates are multiples of these, to a plane.
void spread(const Imf::Channel &c, const IMATH_NAMESPACE::Box2i &w, const std::vector<std::uint32_t> &samples, fmt_exr_plane &to)
{
    const std::int64_t width = std::int64_t{w.max.x} - w.min.x + 1, height = std::int64_t{w.max.y} - w.min.y + 1, wide = (width + c.xSampling - 1) / c.xSampling;
    for (std::int64_t y = 0; y < height; y++)
        for (std::int64_t x = 0; x < width; x++) {
            const std::uint32_t bits = samples[static_cast<std::size_t>(y / c.ySampling * wide + x / c.xSampling)];
            float f;
            std::memcpy(&f, &bits, sizeof f);
            to.values[y * width + x] = to.integer ? static_cast<double>(bits) : static_cast<double>(f);
        }
}

void read_planes(Imf::InputFile &file, const IMATH_NAMESPACE::Box2i &w, fmt_exr_picture &p)
{
    const Imf::ChannelList &channels = file.header().channels();
    const std::int64_t width = p.width, height = p.height;
    std::uint32_t at = 0;
    for (auto c = channels.begin(); c != channels.end(); ++c, at++) {
        const Imf::Channel &channel = c.channel();
        fmt_exr_plane &to = p.planes[at];
        if (channel.xSampling < 1 || channel.ySampling < 1 || w.min.x % channel.xSampling != 0 || w.min.y % channel.ySampling != 0)
            svo_throw(SVO_INVALID_DATA, "channel %.60s of the OpenEXR picture has samples between pixels", c.name());
        std::snprintf(to.name, sizeof to.name, "%s", c.name());
        to.integer = channel.type == Imf::UINT;
        const std::int64_t wide = (width + channel.xSampling - 1) / channel.xSampling, high = (height + channel.ySampling - 1) / channel.ySampling;
        std::vector<std::uint32_t> samples(static_cast<std::size_t>(wide * high));
        to.values = static_cast<double *>(svo_alloc(p.allocator, static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(height), sizeof *to.values));
        if (to.values == nullptr) svo_throw(SVO_OUT_OF_MEMORY, "no memory for an OpenEXR picture");
        // (one channel at a time, so that the samples need not all be there at once)
        Imf::FrameBuffer frame;
        auto *base = reinterpret_cast<char *>(samples.data()) - 4 * (std::int64_t{w.min.x} / channel.xSampling + wide * (std::int64_t{w.min.y} / channel.ySampling));
        frame.insert(c.name(), Imf::Slice(to.integer ? Imf::UINT : Imf::FLOAT, base, 4, static_cast<std::size_t>(4 * wide), channel.xSampling, channel.ySampling));
        file.setFrameBuffer(frame);
        file.readPixels(w.min.y, w.max.y);
        spread(channel, w, samples, to);
    }
}

svo_result read(const std::uint8_t *bytes, std::uint64_t size, std::uint64_t max_pixels, fmt_exr_picture &p)
{
    if (!fmt_exr_is(bytes, size) || size < 8) svo_throw(SVO_INVALID_DATA, "not an OpenEXR picture");
    header_check checked(bytes, size, max_pixels);
    checked.run();
    Imf::Header::setMaxImageSize(most_side, most_side);
    Imf::Header::setMaxTileSize(most_side, most_side);
    memory_stream stream(bytes, size);
    Imf::InputFile file(stream, 0);
    const auto w = file.header().dataWindow();
    const std::int64_t width = std::int64_t{w.max.x} - w.min.x + 1, height = std::int64_t{w.max.y} - w.min.y + 1;
    if (width != checked.first_width || height != checked.first_height) svo_throw(SVO_INVALID_DATA, "the OpenEXR picture has two windows");
    if (!file.isComplete()) svo_throw(SVO_INVALID_DATA, "the OpenEXR picture is not complete");
    for (auto c = file.header().channels().begin(); c != file.header().channels().end(); ++c) p.plane_count++;
    p.width = static_cast<std::uint32_t>(width), p.height = static_cast<std::uint32_t>(height);
    p.planes = static_cast<fmt_exr_plane *>(svo_calloc(p.allocator, p.plane_count, sizeof *p.planes));
    if (p.planes == nullptr && p.plane_count != 0) svo_throw(SVO_OUT_OF_MEMORY, "no memory for an OpenEXR picture");
    read_planes(file, w, p);
    return SVO_OK;
}

} // namespace

extern "C" svo_result fmt_exr_read(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const svo_allocator *a, fmt_exr_picture *out, svo_error *err)
{
    *out = fmt_exr_picture{};
    out->allocator = a;
    const svo_result r = svo_guard(err, [&]() -> svo_result {
        try {
            return read(bytes, size, max_pixels != 0 ? max_pixels : default_pixels, *out);
        } catch (const svo_failure &) {
            throw;
        } catch (const std::bad_alloc &) {
            throw;
        } catch (const std::exception &e) { // whatever the library does not like
            svo_throw(std::strstr(e.what(), "deep") != nullptr ? SVO_UNSUPPORTED : SVO_INVALID_DATA, "OpenEXR: %.200s", e.what());
        }
    });
    if (r != SVO_OK) fmt_exr_free(out);
    return r;
}
#else
extern "C" svo_result fmt_exr_read(const uint8_t *bytes, uint64_t size, uint64_t max_pixels, const svo_allocator *a, fmt_exr_picture *out, svo_error *err)
{
    (void)bytes, (void)size, (void)max_pixels, (void)a;
    *out = fmt_exr_picture{};
    return svo_fail(err, SVO_UNSUPPORTED, "OpenEXR pictures are not read: built without the OpenEXR library");
}
#endif

extern "C" bool fmt_exr_is(const uint8_t *head, uint64_t size) { return size >= 4 && std::memcmp(head, "v/1\x01", 4) == 0; }

extern "C" void fmt_exr_free(fmt_exr_picture *p)
{
    for (std::uint32_t i = 0; p->planes != nullptr && i < p->plane_count; i++)
        svo_free(p->allocator, p->planes[i].values, static_cast<std::uint64_t>(p->width) * p->height, sizeof *p->planes[i].values);
    svo_free(p->allocator, p->planes, p->plane_count, sizeof *p->planes);
    *p = fmt_exr_picture{};
}
