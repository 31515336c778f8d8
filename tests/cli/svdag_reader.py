"""A reader of .svdag written from docs/format/container.md, svo.md and svdag.md alone; it shares nothing with the C code.

    Svdag(path)           checks what it reads and raises ValueError where a rule is broken (hashes are not computed)
    .nodes()              every node in order: (level, x, y, z, attribute index or None; 0 where nothing is numbered; all nodes
                          inside a full leaf have its one)
    .voxel(x, y, z)       attribute index of a finest voxel, or None
    .value(channel, i)    value of attribute i as bytes; i may be (first, voxels): an average
"""

import math
import struct
import sys

import svdag_best
import svdag_fast

STRIDE = {1: 3, 2: 4, 3: 1, 4: 2, 5: 4}


def need(condition, rule):
    if not condition:
        raise ValueError(rule)


def bits(data, at, width):
    """`width` bits from bit `at` of a byte string, lowest first."""
    first, last = at // 8, (at + width + 7) // 8
    return int.from_bytes(data[first:last], "little") >> at % 8 & (1 << width) - 1


def ones(x):
    return bin(x).count("1")


class Channel:
    def __init__(self, record):
        self.name = record[:16].rstrip(b"\0").decode("ascii")
        self.kind, flags, self.constant, self.encoding, self.corrections, self.table_count = struct.unpack("<II8sIIQ", record[16:])
        need(self.kind in STRIDE and self.encoding <= 4 and flags == (self.encoding == 0), "DAG-02")
        self.stride = STRIDE[self.kind]


class Svdag:
    def __init__(self, path):
        with open(path, "rb") as f:
            self.data = f.read()
        self.chunks = self._container()
        self._head(self._take(b"HEAD", 0))
        self.levels = []
        if not self.empty:
            if self.layout == 3:
                levels, code, tree = self._take(b"LVLS", 0), self._take(b"CODE", 0), self._take(b"TREE", 0)
            if self.layout == 2:
                code, tree = self._take(b"CODE", 0), self._take(b"TREE", 0)
            for level in range(self.T - 2 if self.layout == 1 else 0):
                body = self._take(b"NODE", level)
                ow, zero, count = struct.unpack("<IIQ", body[:16])
                need(ow in ((0,) if self.unnumbered else (1, 2)) and zero == 0, "DAG-03")
                self.levels.append((ow, count, struct.unpack("<%dI" % (len(body) // 4 - 4), body[16:])))
            body = self._take(b"BRCK", 0)
            self.bricks = struct.unpack("<%dQ" % (len(body) // 8), body)
            if self.layout == 3:
                self.coded = svdag_best.Best(levels, code, tree, self.bricks, self)
            if self.layout == 2:
                self.coded = svdag_fast.Fast(code, tree, self.bricks, self)
        for number, c in enumerate(self.channels):
            if c.encoding == 1:
                c.raw = self._take(b"ARAW", number)
                need(len(c.raw) == self.A * c.stride, "DAG-08")
            elif c.encoding in (2, 4):
                c.table = self._take(b"ATBL", number)
                need(len(c.table) == c.table_count * c.stride, "DAG-08")
                c.directory = self._take(b"ADIR", number)
                superblocks, c.entry = (self.A + 1023) // 1024, None
                if c.encoding == 4:
                    c.entry, before = [], 0
                    for s in range(superblocks):
                        word, rank = struct.unpack_from("<QI", c.directory, 12 * (s // 64))
                        need(s % 64 or rank == before, "DAG-09")
                        before += word >> s % 64 & 1
                        c.entry.append((before - 1, word >> s % 64 & 1))
                    need(before and c.entry[0][1], "DAG-09")
                    c.directory = c.directory[12 * ((superblocks + 63) // 64):]
                    superblocks = before
                need(len(c.directory) == 12 * superblocks, "DAG-08")
                c.payload = self._take(b"APAY", number)
                c.bits = (c.table_count - 1).bit_length()
            elif c.encoding == 3:
                c.table = self._take(b"ATBL", number)
                need(len(c.table) == c.table_count * c.stride, "DAG-08")
                body = self._take(b"ADIR", number)
                c.entries = struct.unpack("<%dQ" % (len(body) // 8), body)
                c.payload = self._take(b"APAY", number)
                c.bits = (c.table_count - 1).bit_length()
            if c.corrections:
                self._corrections(c, self._take(b"ACOR", number))
        need(all(c[0] == b"META" for c in self.chunks), "DAG-01")

    def _corrections(self, c, body):
        need(self.averaged and c.encoding and len(body) == 12 * c.corrections, "DAG-08, DAG-22")
        c.corrected, last = {}, -1
        for i in range(c.corrections):
            key, value = struct.unpack_from("<Q4s", body, 12 * i)
            first, voxels = key >> 6, (key & 63) + 1
            need(last < key and voxels > 1 and first + voxels <= self.A and not any(value[c.stride:]), "DAG-22")
            c.corrected[first, voxels], last = value[:c.stride], key

    def _container(self):
        d = self.data
        need(d[:8] == b"\x89SVX\r\n\x1a\n" and d[16:20] == b"SVDG", "CON-01")
        need(struct.unpack("<H", d[8:10])[0] == 1 and d[-8:] == b"\x89SVXEND\n", "CON-02, CON-04")
        table, count, size = struct.unpack("<QQQ", d[-64:-40])
        need(size == len(d), "CON-04")
        chunks, at = [], 64
        for i in range(count):
            element = d[table + 64 + 64 * i:table + 128 + 64 * i]
            need(struct.unpack("<Q", element[:8])[0] == at and element[8:] == d[at:at + 56], "CON-06")
            kind, flags, codec, stored, decoded, elements, stride, zero, ident = struct.unpack("<4sHHQQQIIQ", d[at:at + 48])
            need(codec == 0 and stored == decoded and zero == 0 and (stride == 0 or stride * elements == stored), "CON-08")
            if flags == 1 or kind == b"META":
                chunks.append((kind, ident, d[at + 64:at + 64 + stored]))
            at = at + 64 + (stored + 63) // 64 * 64
        need(at == table and d[at:at + 4] == b"TABL", "CON-06")
        return chunks

    def _take(self, kind, ident):
        need(self.chunks and self.chunks[0][:2] == (kind, ident), "DAG-01 %s %d" % (kind, ident))
        return self.chunks.pop(0)[2]

    def _head(self, h):
        self.depth, self.layout, surface, fill, channels, flags = struct.unpack("<IIBBHI", h[:16])
        need(self.layout in (1, 2, 3) and flags in (0, 1, 2, 3, 5, 7) and surface <= 1 and fill <= 1, "DAG-01, DAG-02")
        self.T, self.lod, self.unnumbered = max(self.depth, 2), flags & 1 == 1, flags & 2 == 2
        self.averaged = flags & 4 == 4
        self.brick_lod = self.lod and not self.averaged
        self.voxel_to_world = struct.unpack("<16d", h[16:144])
        self.A, self.root, zero = struct.unpack("<QII", h[144:160])
        self.level_nodes = struct.unpack("<22Q", h[160:336])
        need(zero == 0 and len(h) == 336 + 48 * channels, "DAG-02")
        self.empty = self.level_nodes[0] == 0
        self.channels = [Channel(h[336 + 48 * i:384 + 48 * i]) for i in range(channels)]
        need(not self.unnumbered or all(c.encoding == 0 for c in self.channels), "DAG-06")

    # --- geometry ---

    def _root(self):
        return self.coded.root if self.layout != 1 else self.root

    def _brick(self, ref):
        return ref if self.layout != 1 else self.bricks[ref]

    def _children(self, level, ref, index):
        """(octant, reference, attribute index) of a node above the bricks."""
        if self.layout != 1:
            yield from self.coded.children(level, ref, index)
            return
        ow, _, words = self.levels[level]
        mask, full = words[ref] & 255, words[ref] >> 8
        need(mask != 0 and full & ~mask == 0, "DAG-04")
        k, slot, r = ones(mask), 0, ones(mask & ~full)
        for octant in range(8):
            if not mask >> octant & 1:
                continue
            offset = 1 if self.lod else 0
            if self.unnumbered:
                offset = 0
            elif slot:
                at = ref + 1 + r + ow * (slot - 1)
                offset = words[at] | (words[at + 1] << 32 if ow == 2 else 0)
            stored = mask & ~full & (1 << octant) - 1
            yield octant, None if full >> octant & 1 else words[ref + 1 + ones(stored)], index + offset
            slot += 1

    def _octant(self, brick, index, a):
        if self.unnumbered:
            return 0
        below = (1 << 8 * a) - 1
        index += ones(brick & below)
        if self.brick_lod:
            index += 1 + sum(1 for o in range(a) if brick >> 8 * o & 255)
        return index if self.brick_lod else self._average(index, brick >> 8 * a & 255)

    def _average(self, index, voxels):
        """(first, voxels) of two voxels or more, else the index of the one."""
        return (index, ones(voxels)) if self.averaged and not self.unnumbered and ones(voxels) > 1 else index

    def _voxel(self, brick, index, b):
        if self.unnumbered:
            return 0
        index += ones(brick & (1 << b) - 1)
        if self.brick_lod:
            index += 1 + sum(1 for o in range(b // 8 + 1) if brick >> 8 * o & 255)
        return index

    def nodes(self):
        """Every node of the tree of depth T. The index is None where a node has no attribute (inner ones without lod)."""
        if self.empty:
            return
        stack = [(0, self._root(), 0, 0, 0, 0)]
        while stack:
            level, ref, index, x, y, z = stack.pop()
            if ref is None:  # inside a full leaf: all is there, with one attribute
                yield level, x, y, z, index if self.lod or level == self.T else None
                for o in reversed(range(8 if level < self.T else 0)):
                    stack.append((level + 1, None, index, 2 * x + (o & 1), 2 * y + (o >> 1 & 1), 2 * z + (o >> 2)))
                continue
            if level == self.T - 2:
                brick = self._brick(ref)
                need(brick != 0, "DAG-04")
            yield level, x, y, z, None if not self.lod else index if level < self.T - 2 else self._average(index, brick)
            if level < self.T - 2:
                for o, child, i in reversed(list(self._children(level, ref, index))):
                    stack.append((level + 1, child, i, 2 * x + (o & 1), 2 * y + (o >> 1 & 1), 2 * z + (o >> 2)))
                continue
            for a in range(8):
                if not brick >> 8 * a & 255:
                    continue
                ax, ay, az = 2 * x + (a & 1), 2 * y + (a >> 1 & 1), 2 * z + (a >> 2)
                yield level + 1, ax, ay, az, self._octant(brick, index, a) if self.lod else None
                for b in range(8):
                    if brick >> 8 * a + b & 1:
                        yield (level + 2, 2 * ax + (b & 1), 2 * ay + (b >> 1 & 1), 2 * az + (b >> 2),
                               self._voxel(brick, index, 8 * a + b))

    def voxel(self, x, y, z):
        if self.empty:
            return None
        ref, index = self._root(), 0
        octant = lambda level: (x >> self.T - 1 - level & 1) + 2 * (y >> self.T - 1 - level & 1) + 4 * (z >> self.T - 1 - level & 1)
        for level in range(self.T - 2):
            found = [(r, i) for o, r, i in self._children(level, ref, index) if o == octant(level)]
            if not found:
                return None
            ref, index = found[0]
            if ref is None:
                return index
        b = 8 * octant(self.T - 2) + octant(self.T - 1)
        brick = self._brick(ref)
        return self._voxel(brick, index, b) if brick >> b & 1 else None

    # --- attributes ---

    def _superblock(self, c, s):
        """(map, bytes from its begin on) of superblock s."""
        if getattr(c, "cached", None) != s:
            blocks, offset = struct.unpack_from("<QI", c.directory, 12 * s)
            base, = struct.unpack_from("<Q", c.payload, 8 * (s // 65536))
            c.cached, c.cache = s, (blocks, c.payload[base + offset:base + offset + 128 + 2048 + 5000])
        return c.cache

    def block_value(self, c, i):
        if c.entry is not None:  # a superblock without an entry repeats the last value of the one before
            entry, own = c.entry[i // 1024]
            i = 1024 * entry + (i % 1024 if own else 1023)
        blocks, data = self._superblock(c, i // 1024)
        g = i // 16 % 64
        need(blocks & 1, "DAG-09")
        begin = (blocks & (2 << g) - 1).bit_length() - 1
        header, = struct.unpack_from("<H", data, 2 * ones(blocks & (1 << begin) - 1))
        mode, field, j = header & 31, header >> 5, i % 1024 - 16 * begin
        after = blocks >> g + 1
        length = 16 * ((g + 1 + (after & -after).bit_length() - 1 if after else 64) - begin)
        if mode < 2:
            return self._entry(c, 2048 * mode + field)
        need(mode < 27, "DAG-09")
        data = data[field:]
        index = lambda at: bits(data, at, c.bits)

        def number(at, w, runs):
            if not runs:
                return bits(data, at + j * w, w)
            need(bits(data, at, 1), "DAG-09")
            return bits(data, at + length + (ones(bits(data, at, j + 1)) - 1) * w, w)

        if mode == 2:
            return self._entry(c, index(0))
        if mode == 3:
            return self._entry(c, index(j * c.bits))
        if mode < 6:
            low, n, step, at = lattice(c.kind, data)
            w = (n[0] * n[1] * n[2] - 1).bit_length()
            x = number(at, w, mode == 5)
            need(w <= 32 and x < n[0] * n[1] * n[2], "DAG-09")
            q = (x % n[0], x // n[0] % n[1], x // (n[0] * n[1]))
            return lattice_value(c.kind, [low[k] + q[k] * step[k] for k in range(3)])
        if mode < 12:
            w = mode - (4 if mode < 9 else 7)
            p, q, m = self._entry(c, index(0)), self._entry(c, index(c.bits)), (1 << w) - 1
            n = number(2 * c.bits, w, mode >= 9)
            need(c.kind <= 2, "DAG-09")
            if c.kind == 2:
                p, q = [[x + 32768 for x in struct.unpack("<hh", v)] for v in (p, q)]
            out = [(a * (m - n) + b * n + m // 2) // m for a, b in zip(p, q)]
            return struct.pack("<hh", *(x - 32768 for x in out)) if c.kind == 2 else bytes(out)
        if mode < 20:
            w = mode - 11
            return self._entry(c, index(length * w + number(0, w, False) * c.bits))
        entries, n = data[0] + 1, number(8 + (data[0] + 1) * c.bits, mode - 18, True)
        need(n < entries, "DAG-09")
        return self._entry(c, index(8 + n * c.bits))

    def long_block_value(self, c, i):
        g, j, groups = i >> 18, i & (1 << 18) - 1, (self.A + (1 << 18) - 1) >> 18
        first, numbers, palettes = struct.unpack_from("<QQQ", c.payload, 24 * g)
        end = struct.unpack_from("<Q", c.payload, 24 * (g + 1))[0] if g + 1 < groups else len(c.entries)
        begin = lambda k: c.entries[k] & (1 << 18) - 1
        need(first < end <= len(c.entries) and begin(first) == 0, "DAG-21")
        while end - first > 1:
            middle = (first + end) // 2
            first, end = (middle, end) if begin(middle) <= j else (first, middle)
        e = c.entries[first]
        w = e >> 18 & 15
        need(w <= 8 and e >> 61 == 0, "DAG-21")
        n = bits(c.payload, 8 * numbers + (e >> 22 & (1 << 21) - 1) + (j - begin(first)) * w, w)
        return self._entry(c, bits(c.payload, 8 * palettes + ((e >> 43) + n) * c.bits, c.bits))

    def _entry(self, c, t):
        need(t < c.table_count, "DAG-09")
        return c.table[t * c.stride:(t + 1) * c.stride]

    def value(self, number, i):
        c = self.channels[number]
        if isinstance(i, tuple):
            if c.encoding == 0:
                return c.constant[:c.stride]
            if c.corrections and i in c.corrected:
                return c.corrected[i]
            return average(c.kind, [self.value(number, k) for k in range(i[0], i[0] + i[1])])
        need(0 <= i < self.A, "index out of range")
        if c.encoding == 0:
            return c.constant[:c.stride]
        if c.encoding == 1:
            return c.raw[i * c.stride:(i + 1) * c.stride]
        return self.block_value(c, i) if c.encoding != 3 else self.long_block_value(c, i)


def linear(v):
    v /= 255
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def srgb(v):
    return round(255 * (12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055))


def average(kind, values):
    """Of the values of finest voxels, as the text says; rounding may differ by one step."""
    n = len(values)
    if len(set(values)) == 1:
        return values[0]
    if kind == 1:
        return bytes(srgb(sum(linear(v[k]) for v in values) / n) for k in range(3))
    if kind == 3:
        return bytes([(2 * sum(v[0] for v in values) + n) // (2 * n)])
    if kind >= 4:
        ids = [int.from_bytes(v, "little") for v in values]
        return min(ids, key=lambda i: (-ids.count(i), i)).to_bytes(STRIDE[kind], "little")
    mean = [sum(c) / n for c in zip(*map(decode_normal, values))]
    length = math.sqrt(sum(c * c for c in mean))
    return encode_normal([c / length for c in mean]) if length > 1e-6 else values[0]


# bits of low, n - 1 and step, and what is taken from low, for each component of each kind
LATTICE = {1: [(8, 8, 5, 0), (9, 9, 5, 256), (9, 9, 5, 256)], 2: [(16, 16, 7, 32768)] * 2, 3: [(8, 8, 5, 0)], 4: [(16, 16, 0, 0)], 5: [(32, 32, 0, 0)]}


def lattice(kind, data):
    """low, n, step of three components, and the bit behind them."""
    low, n, step, at = [0] * 3, [1] * 3, [1] * 3, 0
    for k, (a, b, c, minus) in enumerate(LATTICE[kind]):
        low[k] = bits(data, at, a) - minus
        n[k] = bits(data, at + a, b) + 1
        code = bits(data, at + a + b, c)
        step[k] = (8 + code % 8) * 2 ** (code // 8) // 8 if kind == 2 else code + 1
        at += a + b + c
    return low, n, step, at


def lattice_value(kind, c):
    clamp = lambda x, low, high: max(low, min(high, x))
    if kind == 1:
        t = c[0] - (c[2] >> 1)
        b = t - (c[1] >> 1)
        return bytes(clamp(x, 0, 255) for x in (b + c[1], c[2] + t, b))
    if kind == 2:
        return struct.pack("<hh", clamp(c[0], -32767, 32767), clamp(c[1], -32767, 32767))
    if kind == 3:
        return bytes([clamp(c[0], 0, 255)])
    return (c[0] & (1 << 8 * STRIDE[kind]) - 1).to_bytes(STRIDE[kind], "little")


def decode_normal(v):
    x, y = struct.unpack("<hh", v)
    u, w = x / 32767, y / 32767
    z = 1 - abs(u) - abs(w)
    if z < 0:
        u, w = (1 - abs(w)) * (-1 if u < 0 else 1), (1 - abs(u)) * (-1 if w < 0 else 1)
    n = (u * u + w * w + z * z) ** 0.5
    return u / n, w / n, z / n


def encode_normal(n):
    """The code next to a unit vector; which of two that are as near may differ."""
    x, y, z = (c / sum(map(abs, n)) for c in n)
    if z < 0:
        x, y = (1 - abs(y)) * (-1 if x < 0 else 1), (1 - abs(x)) * (-1 if y < 0 else 1)
    around = [(math.floor(32767 * x) + i, math.floor(32767 * y) + j) for i in (0, 1) for j in (0, 1)]
    codes = [struct.pack("<hh", *c) for c in around if max(map(abs, c)) <= 32767]
    return max(codes, key=lambda c: sum(p * q for p, q in zip(decode_normal(c), n)))


if __name__ == "__main__":
    f = Svdag(sys.argv[1])
    print("depth %d, attributes %d, channels %s" % (f.depth, f.A, ", ".join(c.name for c in f.channels) or "none"))
    print("nodes a level: %s" % " ".join(str(n) for n in f.level_nodes[:f.depth + 1]))
