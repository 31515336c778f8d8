// Cells as OpenVDB and NanoVDB grids. Where the libraries are not found, SVO_HAVE_OPENVDB is not defined and both exports say so.
#include "cells_vdb.h"

#include "cxx_guard.hpp"

#ifdef SVO_HAVE_OPENVDB
#include "svo_channel.h"

#include <openvdb/openvdb.h>
#include <openvdb/io/Stream.h>

#include <cstdint>
#include <cstring>
#include <sstream>
#include <string>

#ifdef SVO_HAVE_NANOVDB
#include <nanovdb/util/IO.h>
#include <nanovdb/util/OpenToNanoVDB.h>
#endif

namespace {

// Index coordinates of OpenVDB name cell centres; to_world maps corners.
openvdb::math::Transform::Ptr make_transform(const fmt_cells &c)
{
    const double *m = c.to_world;
    openvdb::math::Mat4d t(m[0], m[4], m[8], 0.0, m[1], m[5], m[9], 0.0, m[2], m[6], m[10], 0.0, 0.0, 0.0, 0.0, 1.0); // acts on rows
    for (int r = 0; r < 3; r++) t(3, r) = m[4 * r + 3] + 0.5 * (m[4 * r] + m[4 * r + 1] + m[4 * r + 2]);
    return openvdb::math::Transform::createLinearTransform(t);
}

openvdb::Coord coord(const fmt_cell &cell)
{
    return {static_cast<int>(cell.at[0]), static_cast<int>(cell.at[1]), static_cast<int>(cell.at[2])};
}

openvdb::FloatGrid::Ptr density_of(const fmt_cells &c)
{
    auto grid = openvdb::FloatGrid::create(0.0F);
    auto access = grid->getAccessor();
    for (std::uint64_t i = 0; i < c.count; i++) access.setValue(coord(c.cell[i]), 1.0F);
    grid->setTransform(make_transform(c));
    grid->setName("density");
    grid->setGridClass(openvdb::GRID_FOG_VOLUME);
    grid->pruneGrid();
    return grid;
}

openvdb::Vec3SGrid::Ptr color_of(const fmt_cells &c)
{
    auto grid = openvdb::Vec3SGrid::create(openvdb::Vec3s(0.0F));
    auto access = grid->getAccessor();
    for (std::uint64_t i = 0; i < c.count; i++) {
        const std::uint8_t *v = c.cell[i].rgb;
        access.setValue(coord(c.cell[i]), openvdb::Vec3s(svo_srgb_to_linear(v[0]), svo_srgb_to_linear(v[1]), svo_srgb_to_linear(v[2])));
    }
    grid->setTransform(make_transform(c));
    grid->setName("color");
    grid->setVectorType(openvdb::VEC_INVARIANT);
    return grid;
}

void check_count(const fmt_cells &c)
{
    if (c.count > (std::uint64_t{1} << 31)) svo_throw(SVO_LIMIT, "more than 2^31 cells; export a coarser level");
}

// The file's identifier is random: 36 characters behind the header of 8 + 4 + 4 + 4 + 1 bytes. Put there what follows from the rest.
void settle_identifier(std::string &bytes)
{
    const std::size_t at = 21, length = 36;
    if (bytes.size() < at + length) svo_throw(SVO_RUNTIME, "OpenVDB wrote a header of another form than expected");
    for (const std::size_t dash : {8U, 13U, 18U, 23U})
        if (bytes[at + dash] != '-') svo_throw(SVO_RUNTIME, "OpenVDB wrote a header of another form than expected");
    std::memset(&bytes[at], '0', length);
    char hex[33];
    fmt_hash_hex(bytes.data(), bytes.size(), hex);
    const std::string h(hex);
    bytes.replace(at, length, h.substr(0, 8) + "-" + h.substr(8, 4) + "-" + h.substr(12, 4) + "-" + h.substr(16, 4) + "-" + h.substr(20, 12));
}

void put(fmt_output *out, const std::string &bytes)
{
    svo_error inner{};
    svo_check(fmt_output_write(out, bytes.data(), bytes.size(), &inner), inner);
}

} // namespace

extern "C" bool fmt_have_vdb(void) { return true; }

extern "C" svo_result fmt_cells_vdb(const fmt_cells *c, fmt_output *out, svo_error *err)
{
    return svo_guard(err, [&]() -> svo_result {
        check_count(*c);
        openvdb::initialize();
        openvdb::GridPtrVec grids{density_of(*c)};
        if (c->colored) grids.push_back(color_of(*c));
        std::ostringstream stream(std::ios_base::binary);
        openvdb::io::Stream(stream).write(grids);
        std::string bytes = stream.str();
        settle_identifier(bytes);
        put(out, bytes);
        return SVO_OK;
    });
}

#else

extern "C" bool fmt_have_vdb(void) { return false; }
extern "C" svo_result fmt_cells_vdb(const fmt_cells *, fmt_output *, svo_error *err)
{
    return svo_fail(err, SVO_NOT_BUILT, "this build cannot write .vdb: libopenvdb-dev was not there when it was made");
}

#endif

#if defined(SVO_HAVE_OPENVDB) && defined(SVO_HAVE_NANOVDB)

extern "C" bool fmt_have_nvdb(void) { return true; }

extern "C" svo_result fmt_cells_nvdb(const fmt_cells *c, fmt_output *out, svo_error *err)
{
    return svo_guard(err, [&]() -> svo_result {
        check_count(*c);
        openvdb::initialize();
        auto handle = nanovdb::openToNanoVDB(density_of(*c), nanovdb::StatsMode::All, nanovdb::ChecksumMode::Full);
        std::ostringstream stream(std::ios_base::binary);
        nanovdb::io::Segment header(nanovdb::io::Codec::NONE); // writeGrid seeks over it, which an empty stream refuses
        header.add(handle);
        stream << std::string(header.memUsage(), '\0');
        stream.seekp(0);
        nanovdb::io::writeGrid(stream, handle, nanovdb::io::Codec::NONE);
        put(out, stream.str());
        return SVO_OK;
    });
}

#else

extern "C" bool fmt_have_nvdb(void) { return false; }
extern "C" svo_result fmt_cells_nvdb(const fmt_cells *, fmt_output *, svo_error *err)
{
    return svo_fail(err, SVO_NOT_BUILT, "this build cannot write .nvdb: libopenvdb-dev and libnanovdb-dev were not there when it was made");
}

#endif
