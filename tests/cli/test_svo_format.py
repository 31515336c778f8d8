"""A second reader of .svo, written from docs/format/container.md and svo.md alone, against svo-dump --voxels."""

import ctypes
import ctypes.util
import math
import os
import struct
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import masks_reader
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
        check(codec <= 2 and (codec != 2 or kind in (b"TREE", b"GRUP")), "codec")
        chunks.append((kind.decode(), flags, elements, stride, number, unzstd(payload, decoded) if codec == 1 else payload, codec, decoded))
    check(at == table_at and len(chunks) == count and payload == headers and at + 64 + stored + 64 == len(b), "table")
    check(footer[24:40] == xxh3_128(hashes), "content hash")
    return chunks


SIZES = {1: 3, 2: 4, 3: 1, 4: 2, 5: 4}


def packed_values(p, at, kind, n):
    """The n values of a channel whose packed form begins at p[at], as byte planes; and where it ends."""
    def zeros(condition):
        check(condition, "what has to be 0")

    mode, present, at = p[at], p[at + 1:at + 1 + (n + 63) // 64], at + 1 + (n + 63) // 64
    check(mode <= 1, "mode")
    flags = []
    for k in range((n + 7) // 8):
        if present[k // 8] >> k % 8 & 1:
            flags.append(p[at])
            zeros(p[at] != 0)
            at += 1
        else:
            flags.append(0)
    zeros(all(present[k // 8] >> k % 8 & 1 == 0 for k in range(len(flags), 8 * len(present))))
    changes = [bool(flags[i // 8] >> i % 8 & 1) for i in range(n)]
    zeros(sum(bin(f).count("1") for f in flags) == sum(changes))
    codes = [15] * sum(changes)
    if mode == 1:
        halves = [h for b in p[at:at + (len(codes) + 1) // 2] for h in (b & 15, b >> 4)]
        at += (len(codes) + 1) // 2
        zeros(not any(halves[len(codes):]))
        codes = halves[:len(codes)]
    count = codes.count(15)
    groups, bits = (count + 7) // 8, 8 if kind in (1, 3) else 16
    components = []
    for _ in range({1: 3, 2: 2, 3: 1, 4: 1, 5: 2}[kind]):
        widths = [h for b in p[at:at + (groups + 1) // 2] for h in (b & 15, b >> 4)]
        at += (groups + 1) // 2
        zeros(not any(widths[groups:]))
        numbers = []
        for w in widths[:groups]:
            w = 16 if w == 15 else w
            check(w <= bits, "width")
            group = int.from_bytes(p[at:at + w], "little")
            numbers += [group >> w * i & (1 << w) - 1 for i in range(8)]
            at += w
        zeros(not any(numbers[count:]))
        components.append([x // 2 if x % 2 == 0 else -(x + 1) // 2 for x in numbers[:count]])
    recent, head, v, values = [0] * 15, 0, 0, []
    code, difference = iter(codes), zip(*components)
    for changed in changes:
        if changed:
            c = next(code)
            if c < 15:
                v = recent[c]
            else:
                d = next(difference)
                if kind == 1:
                    r, g, b = v & 255, v >> 8 & 255, v >> 16
                    v = (r + d[0] + d[1]) % 256 | (g + d[0]) % 256 << 8 | (b + d[0] + d[2]) % 256 << 16
                else:
                    v = sum((((v >> bits * i) + e) % (1 << bits)) << bits * i for i, e in enumerate(d))
                recent[head] = v
                head = (head + 1) % 15
        values.append(v)
    return b"".join(bytes(x >> 8 * plane & 255 for x in values) for plane in range(SIZES[kind])), at


def unpacked(p, at, records, n):
    """The planes of all channels that are not constant; and where they end."""
    planes = b""
    for _, kind, constant, _ in records:
        if not constant:
            more, at = packed_values(p, at, kind, n)
            planes += more
    return planes, at


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


def full(code, levels):
    """Morton codes of all finest voxels of a full leaf, and how many nodes each level below it has."""
    n = 8 ** levels
    return range(code * n, (code + 1) * n), [8 ** l for l in range(levels + 1)]


def tree(code, levels, masks):
    """For each value below a chunk's root its finest voxels' Morton codes; how many nodes each level has; how many full leaves."""
    values, counts, stack, at, leaves = [], [0] * (levels + 1), [(code, 0)], 0, 0
    while stack:
        c, l = stack.pop()
        if l == levels:
            counts[l] += 1
            values.append([c])
            continue
        mask = masks[at]
        at += 1
        if mask == 0:
            check(l > 0, "empty root")
            codes, below = full(c, levels - l)
            values.append(codes)
            leaves += 1
            for i, n in enumerate(below):
                counts[l + i] += n
        else:
            counts[l] += 1
            stack.extend((8 * c + i, l + 1) for i in range(7, -1, -1) if mask >> i & 1)
    check(at == len(masks), "masks left over")
    return values, counts, leaves


def coordinates(code, depth):
    return tuple(sum((code >> (3 * j + axis) & 1) << j for j in range(depth)) for axis in range(3))


PRIOR = None


def varint(p, at):
    v = shift = 0
    while True:
        v |= (p[at] & 127) << shift
        shift += 7
        at += 1
        if p[at - 1] < 128:
            return v, at


def ungroup(chunks):
    """GRUP chunks as the TREE chunks that they stand for, and packed values as planes."""
    global PRIOR
    depth, level, _, records = head(chunks[0][5])
    size = sum(SIZES[r[1]] for r in records if not r[2])
    for kind, flags, elements, stride, code, p, codec, decoded in chunks:
        check(codec != 2 or size != 0, "codec without channels")
        if kind == "TREE" and codec == 2:
            zipped, m = struct.unpack_from("<I", p)[0], decoded - 16 - elements * size
            planes, at = unpacked(p, 4 + zipped, records, elements)
            check(at == len(p) and (zipped != 0) == (m != 0), "packed TREE")
            p = struct.pack("<QQ", m, elements) + (unzstd(p[4:4 + zipped], m) if m else b"") + planes
        if kind != "GRUP":
            yield kind, flags, elements, stride, code, p
            continue
        if PRIOR is None:
            masks_reader.set_tables(masks_reader.knots_of((support.source / "docs/format/masks.md").read_text(encoding="utf-8")))
            PRIOR = masks_reader.make_prior()
        check(1 <= p[0] <= 64 and flags == 1 and stride == 0, "GRUP")
        subtrees, at = [], 1
        for _ in range(p[0]):
            low, zipped = p[at], 0
            m, at = varint(p, at + 1)
            n, at = varint(p, at)
            coded, at = varint(p, at)
            if size:
                zipped, at = varint(p, at)
            subtrees.append((low, m, n, coded, zipped))
        check(code & 63 == subtrees[0][0] and elements == sum(t[2] for t in subtrees), "GRUP")
        for low, m, n, coded, zipped in subtrees:
            masks = masks_reader.decode(PRIOR, depth - level, p[at:at + coded], m) if m else b""
            at += coded
            if codec == 2:
                values, end = unpacked(p, at, records, n)
                check(end == at + zipped, "packed values")
            else:
                values = unzstd(p[at:at + zipped], n * size) if size else b""
            at += zipped
            yield "TREE", 1, n, 0, code >> 6 << 6 | low, struct.pack("<QQ", m, n) + masks + values
        check(at == len(p), "bytes left over")


def read_svo(b):
    chunks = container(b)
    chunks = list(ungroup(chunks))
    check(chunks[0][0] == "HEAD" and [c[0] for c in chunks if c[0] not in ("TREE", "GRUP", "FULL", "META")] == ["HEAD", "STAT"], "order")
    depth, level, matrix, records = head(chunks[0][5])
    varying = [r for r in records if not r[2]]
    voxels, nodes, end, roots, trees, leaves, all_values = {}, [0] * (depth + 1), 0, [], 0, 0, 0

    def put(codes, value_bytes):
        value = {}
        for name, kind_number, constant, fixed in records:
            value.update(columns(name, kind_number, fixed if constant else value_bytes[name]))
        voxels.update((coordinates(c, depth), value) for c in codes)

    for kind, flags, elements, stride, code, p in chunks:
        if kind == "TREE":
            check(flags == 1 and end <= code < 8 ** level, "TREE")
            end = code + 1
            roots.append((code, level))
            trees += 1
            m, n = struct.unpack_from("<QQ", p)
            values, counts, full_leaves = tree(code, depth - level, p[16:16 + m])
            check(len(values) == n == elements and (m > 0 or depth == 0), "values")
            leaves += full_leaves
            all_values += n
            for l, count in enumerate(counts):
                nodes[level + l] += count
            at, columns_at = 16 + m, {}
            for name, kind_number, _, _ in varying:
                columns_at[name] = at
                at += SIZES[kind_number] * n
            check(at == len(p), "bytes left over")
            for i, codes in enumerate(values):
                put(codes, {name: bytes(p[columns_at[name] + plane * n + i] for plane in range(SIZES[kind_number])) for name, kind_number, _, _ in varying})
        elif kind == "FULL":
            check(flags == 1 and stride == 8 + sum(SIZES[r[1]] for r in varying) and 1 <= elements <= 4096, "FULL")
            for i in range(elements):
                at = i * stride
                place = struct.unpack_from("<Q", p, at)[0]
                top = place.bit_length() - 1
                check(top % 3 == 0 and 1 <= top // 3 <= level, "place")
                l, c = top // 3, place - (1 << top)
                first = c * 8 ** (level - l)
                check(first >= end and (i > 0 or first == code), "order of full leaves")
                end = (c + 1) * 8 ** (level - l)
                roots.append((first, l))
                codes, counts = full(c, depth - l)
                for k, count in enumerate(counts):
                    nodes[l + k] += count
                leaves += 1
                all_values += 1
                at += 8
                value = {}
                for name, kind_number, _, _ in varying:
                    value[name] = p[at:at + SIZES[kind_number]]
                    at += SIZES[kind_number]
                put(codes, value)
    for l in range(level):
        nodes[l] += len({r >> 3 * (level - l) for r, own in roots if own > l})
    stat = next(c[5] for c in chunks if c[0] == "STAT")
    check(struct.unpack("<%dQ" % (depth + 4), stat) == (trees, leaves, all_values, *nodes), "STAT")
    return depth, matrix, voxels


def compare(folder, svo):
    depth, matrix, voxels = read_svo(svo.read_bytes())
    d = run("svo-dump", svo, "--json").json
    check(d["depth"] == depth and tuple(d["voxel_to_world"]) == matrix and d["voxels"] == len(voxels) == d["levels"][depth]["nodes"], d)
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
        for level in (0, 1):
            out = folder / ("%s%d-%d.svo" % (mesh, depth, level))
            run("svo-voxelize", folder / (mesh + ".obj"), "-o", out, "--depth", depth, "--level", level)
            compare(folder, out)


def test_small_form(folder):
    if not support.have("svo-voxelize"):
        support.skip("svo-voxelize is not built")
    support.sphere_obj(folder / "s.obj", rings=12)
    support.cube_obj(folder / "c.obj", color=(0.2, 0.5, 1))
    support.quad_obj(folder / "q.obj")
    for mesh, depth, more in (("s", 0, ()), ("s", 1, ()), ("c", 5, ()), ("s", 6, ("--attributes", "none")), ("s", 5, ("--level", 1)), ("q", 8, ())):
        out = folder / ("%s%d.svo" % (mesh, depth))
        run("svo-voxelize", folder / (mesh + ".obj"), "-o", out, "--depth", depth, "--disk", "small", *more)
        compare(folder, out)


support.main(globals())
