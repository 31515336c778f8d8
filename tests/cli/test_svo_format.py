"""A second reader of .svo, written from docs/format/container.md and svo.md alone, against svo-dump --voxels."""

import ctypes
import ctypes.util
import math
import os
import struct
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from support import check, run


def library(name):
    path = ctypes.util.find_library(name)
    if path is None:
        support.skip("lib%s is not there" % name)
    return ctypes.CDLL(path)


def xxh3_64(data):
    lib = library("xxhash")
    lib.XXH3_64bits.restype = ctypes.c_uint64
    lib.XXH3_64bits.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
    return lib.XXH3_64bits(data, len(data))


def xxh3_128(data):
    class Hash(ctypes.Structure):
        _fields_ = [("low", ctypes.c_uint64), ("high", ctypes.c_uint64)]

    lib = library("xxhash")
    lib.XXH3_128bits.restype = Hash
    lib.XXH3_128bits.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
    h = lib.XXH3_128bits(data, len(data))
    return struct.pack(">QQ", h.high, h.low)


def unzstd(data, size):
    lib = library("zstd")
    lib.ZSTD_decompress.restype = ctypes.c_size_t
    lib.ZSTD_decompress.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_char_p, ctypes.c_size_t]
    out = ctypes.create_string_buffer(size + 1)
    check(lib.ZSTD_decompress(out, size, data, len(data)) == size, "zstd")
    return out.raw[:size]


def container(b):
    """[(type, flags, element count, stride, id, decoded payload)] with every hash checked."""
    check(b[:8] == b"\x89SVX\r\n\x1a\n" and struct.unpack_from("<HHI4s", b, 8) == (1, 0, 64, b"SVO "), "header")
    check(struct.unpack_from("<Q", b, 56)[0] == xxh3_64(b[:56]) and not any(b[20:56]), "header")
    footer = b[-64:]
    table_at, count, size = struct.unpack_from("<3Q", footer)
    check(footer[56:] == b"\x89SVXEND\n" and size == len(b) and not any(footer[40:48]), "footer")
    check(struct.unpack_from("<Q", footer, 48)[0] == xxh3_64(footer[:48]), "footer hash")
    chunks, hashes, at, headers = [], b"", 64, b""
    while True:
        header = b[at:at + 64]
        kind, flags, codec, stored, decoded, elements, stride, zero, number, digest, own = struct.unpack("<4sHHQQQIIQQQ", header)
        payload = b[at + 64:at + 64 + stored]
        check(own == xxh3_64(header[:56]) and digest == xxh3_64(payload) and zero == 0, kind)
        check(stride == 0 or elements * stride == decoded, kind)
        if kind == b"TABL":
            break
        if kind != b"META":
            hashes += header[48:56]
        headers += struct.pack("<Q", at) + header[:56]
        end = at + 64 + stored
        at = (end + 63) // 64 * 64
        check(not any(b[end:at]), "padding")
        chunks.append((kind.decode(), flags, elements, stride, number, unzstd(payload, decoded) if codec == 1 else payload))
    check(at == table_at and len(chunks) == count and payload == headers and at + 64 + stored + 64 == len(b), "table")
    check(footer[24:40] == xxh3_128(hashes), "content hash")
    return chunks


SIZES = {1: 3, 2: 4, 3: 1, 4: 2, 5: 4}


def head(p):
    depth, level, surface, fill, channels, zero = struct.unpack_from("<IIBBHI", p)
    check(level == max(0, depth - 7) and zero == 0 and len(p) == 144 + 32 * channels, "HEAD")
    matrix = struct.unpack_from("<16d", p, 16)
    records = []
    for i in range(channels):
        name, kind, flags, value = struct.unpack_from("<16sII8s", p, 144 + 32 * i)
        records.append((name.rstrip(b"\0").decode(), kind, flags & 1, value[:SIZES[kind]]))
    return depth, level, matrix, records


def normal(value):
    u, v = (c / 32767 for c in struct.unpack("<hh", value))
    z = 1 - abs(u) - abs(v)
    if z < 0:
        u, v = (1 - abs(v)) * math.copysign(1, u), (1 - abs(u)) * math.copysign(1, v)
    length = math.sqrt(u * u + v * v + z * z)
    return u / length, v / length, z / length


def columns(name, kind, value):
    """The values as svo-dump names them."""
    if kind == 1:
        prefix = "" if name == "color" else name + "_"
        return dict(zip((prefix + "red", prefix + "green", prefix + "blue"), value))
    if kind == 2:
        prefix = "" if name == "normal" else name + "_"
        return dict(zip((prefix + "nx", prefix + "ny", prefix + "nz"), normal(value)))
    return {name: int.from_bytes(value, "little")}


def tree(code, levels, masks):
    """Morton codes of the finest voxels below a chunk's root, and how many nodes each level has."""
    codes, counts, stack, at = [], [0] * (levels + 1), [(code, 0)], 0
    while stack:
        c, l = stack.pop()
        counts[l] += 1
        if l == levels:
            codes.append(c)
            continue
        mask = masks[at]
        at += 1
        check(mask != 0, "empty mask")
        stack.extend((8 * c + i, l + 1) for i in range(7, -1, -1) if mask >> i & 1)
    check(at == len(masks), "masks left over")
    return codes, counts


def coordinates(code, depth):
    return tuple(sum((code >> (3 * j + axis) & 1) << j for j in range(depth)) for axis in range(3))


def read_svo(b):
    chunks = container(b)
    check(chunks[0][0] == "HEAD" and [c[0] for c in chunks if c[0] not in ("TREE", "META")] == ["HEAD", "STAT"], "order")
    depth, level, matrix, records = head(chunks[0][5])
    voxels, nodes, last, roots = {}, [0] * (depth + 1), -1, set()
    for kind, flags, elements, stride, code, p in chunks:
        if kind != "TREE":
            continue
        check(flags == 1 and last < code < 8 ** level, "TREE")
        last = code
        roots.add(code)
        m, n = struct.unpack_from("<QQ", p)
        codes, counts = tree(code, depth - level, p[16:16 + m])
        check(len(codes) == n == elements, "voxels")
        for l, count in enumerate(counts):
            nodes[level + l] += count
        at, values = 16 + m, [{} for _ in codes]
        for name, kind_number, constant, value in records:
            size = SIZES[kind_number]
            for i in range(n):
                v = value if constant else bytes(p[at + plane * n + i] for plane in range(size))
                values[i].update(columns(name, kind_number, v))
            at += 0 if constant else size * n
        check(at == len(p), "bytes left over")
        voxels.update((coordinates(c, depth), v) for c, v in zip(codes, values))
    for l in range(level):
        nodes[l] = len({r >> 3 * (level - l) for r in roots})
    stat = next(c[5] for c in chunks if c[0] == "STAT")
    check(struct.unpack("<%dQ" % (depth + 2), stat) == (len(roots), *nodes), "STAT")
    return depth, matrix, voxels


def compare(folder, svo):
    depth, matrix, voxels = read_svo(svo.read_bytes())
    d = run("svo-dump", svo, "--json").json
    check(d["depth"] == depth and tuple(d["voxel_to_world"]) == matrix and d["voxels"] == len(voxels), d)
    run("svo-dump", svo, "--voxels", folder / "v.ply", "--force")
    cloud = support.ply_voxels(folder / "v.ply")
    check(cloud.keys() == voxels.keys(), "the voxel sets differ")
    for at, mine in voxels.items():
        for name, value in mine.items():
            check(abs(cloud[at][name] - value) < 1e-6, (at, name, value, cloud[at]))


def test_small_octrees(folder):
    if not support.have("svo-voxelize"):
        support.skip("svo-voxelize is not built")
    support.sphere_obj(folder / "s.obj", rings=12)
    support.cube_obj(folder / "c.obj", color=(0.2, 0.5, 1))
    support.quad_obj(folder / "q.obj")
    for mesh, depth in (("s", 0), ("s", 1), ("s", 2), ("c", 5), ("s", 6), ("q", 8)):
        out = folder / ("%s%d.svo" % (mesh, depth))
        run("svo-voxelize", folder / (mesh + ".obj"), "-o", out, "--depth", depth)
        compare(folder, out)


support.main(globals())
