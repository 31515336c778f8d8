"""A decoder of coded masks, written from docs/format/masks.md alone. Rows of a grid are integers, bit x + 8 is the child at x."""

PAD = 8
T = None


def squash(d):
    i, f = (d + 2048) >> 7, (d + 2048) % 128
    return T[i] + (((T[i + 1] - T[i]) * f + 64) >> 7)


def set_tables(knots):
    global T, SQUASH, STRETCH, RATE
    T = knots
    SQUASH = [squash(d) for d in range(-2047, 2048)]
    STRETCH, d = [], -2047
    for a in range(4096):
        while d < 2047 and SQUASH[d + 2047] < 16 * a + 8:
            d += 1
        STRETCH.append(d)
    RATE = [655360 // (10 * n + 11) for n in range(64)]


class Grid:
    def __init__(self, level):
        self.size = 1 << level
        self.rows = {}

    def row(self, y, z):
        return self.rows.get((y, z), 0)

    def set(self, x, y, z):
        self.rows[y, z] = self.rows.get((y, z), 0) | 1 << (x + PAD)

    def has(self, x, y, z):
        return self.row(y, z) >> (x + PAD) & 1


class Model:
    def __init__(self):
        self.slots = [[(131072, 0, 0)] * 65536 for _ in range(4)]
        self.weights = [[26214] * 4 for _ in range(512)]

    def copy(self):
        other = Model.__new__(Model)
        other.slots = [list(s) for s in self.slots]
        other.weights = [list(w) for w in self.weights]
        return other

    def decide(self, contexts, weights, code):
        """code(p) gives the bit."""
        places, inputs, total = [], [], 0
        for k in range(4):
            if k == 0:
                place, tag = contexts[0], 0
            else:
                h = (contexts[k] + 1) * (0x9e3779b97f4a7c15 + 2 * k) & 0xffffffffffffffff
                place, tag = h >> 48, h >> 40 & 255
            slot = self.slots[k][place]
            if slot[2] != tag:
                slot = (131072, 0, tag)
            value = STRETCH[slot[0] >> 6] if slot[1] else 0
            places.append((place, slot))
            inputs.append(value)
            total += value * weights[k]
        p = min(max(SQUASH[min(max(total >> 16, -2047), 2047) + 2047], 32), 65504)
        bit = code(p)
        e = 65536 * bit - p
        for k in range(4):
            weights[k] = min(max(weights[k] + ((inputs[k] * e + 16384) >> 15), -1 << 20), 1 << 20)
            place, (q, n, tag) = places[k]
            self.slots[k][place] = (q + ((262143 * bit - q) * RATE[n] >> 16), min(n + 1, 63), tag)
        return bit


def subtree(model, levels, coder, nodes, full_leaves):
    """Go through all decisions. coder(p, child) gives a bit; nodes[0] is set, the other levels are filled where they are empty. full_leaves: False, or a
    coder for them; returns the grids of full leaves."""
    full = [Grid(l) for l in range(levels + 1)]
    full_p = [32768] * 64
    for level in range(levels):
        coarse, fine, far = nodes[level], nodes[level + 1], min(3, levels - 1 - level)
        known = {}
        row = lambda y, z: known.get((y, z), 0)
        for z in range(2 * coarse.size):
            for y in range(2 * coarse.size):
                parents, Y, Z = coarse.row(y >> 1, z >> 1) >> PAD, y >> 1, z >> 1
                if parents == 0:
                    continue
                r1, r2 = row(y - 1, z), row(y - 2, z)
                s = [row(y + i, z - 1) for i in range(-2, 3)]
                t = [row(y + i, z - 2) for i in range(-1, 2)]
                P = [coarse.row(Y - 1, Z + 1), coarse.row(Y, Z + 1), coarse.row(Y + 1, Z + 1), coarse.row(Y + 1, Z)]
                own, mine = 0, coarse.row(Y, Z)
                X = -1
                while parents >> (X + 1):
                    X += 1
                    if not parents >> X & 1:
                        continue
                    if full[level].has(X, Y, Z):
                        own |= 3 << (2 * X + PAD)
                        for x in (2 * X, 2 * X + 1):
                            full[level + 1].set(x, y, z)
                        continue
                    a = X + PAD - 1
                    ahead = P[0] >> a & 7 | (P[1] >> a & 7) << 3 | (P[2] >> a & 7) << 6 | (P[3] >> a & 7) << 9 | (mine >> (a + 2) & 1) << 12
                    for x in (2 * X, 2 * X + 1):
                        b = x + PAD
                        octant = (x & 1) + 2 * (y & 1) + 4 * (z & 1)
                        near = own >> (b - 1) & 1 | (r1 >> (b - 1) & 7) << 1 | (s[1] >> (b - 1) & 7) << 4 | (s[2] >> (b - 1) & 7) << 7 | (s[3] >> (b - 1) & 7) << 10
                        pair = b - 1  # x is odd for octant 7: its siblings begin at x - 1
                        if octant == 7 and not (own >> pair & 1 or r1 >> pair & 3 or s[1] >> pair & 3 or s[2] >> pair & 3):
                            bit = 1
                        else:
                            c = b - 2
                            wide = (own >> c & 1 | (r2 >> (b - 1) & 7) << 1 | (r1 >> c & 1) << 4 | (r1 >> (b + 2) & 1) << 5 | (s[0] >> (b - 1) & 7) << 6 |
                                    (s[4] >> (b - 1) & 7) << 9 | (s[1] >> c & 1) << 12 | (s[1] >> (b + 2) & 1) << 13 | (s[2] >> c & 1) << 14 |
                                    (s[2] >> (b + 2) & 1) << 15 | (s[3] >> c & 1) << 16 | (s[3] >> (b + 2) & 1) << 17)
                            deep = t[0] >> (b - 1) & 7 | (t[1] >> (b - 1) & 7) << 3 | (t[2] >> (b - 1) & 7) << 6
                            before = own >> (b - 8) & 255  # x-8 is the lowest bit here
                            row8 = sum((before >> (7 - i) & 1) << i for i in range(8)) if before else 0
                            row1, row2 = r1 >> (b - 6) & 0x1fff, s[2] >> (b - 4) & 0x1ff
                            faces = ahead >> 12 | (ahead >> 10 & 1) << 1 | (ahead >> 4 & 1) << 2
                            contexts = (near | octant << 13, near | wide << 13 | deep << 31 | octant << 40, near | ahead << 13 | octant << 26,
                                        row8 | row1 << 8 | row2 << 21 | faces << 30 | octant << 33)
                            weights = model.weights[(8 * far + octant) * 16 + bin(near).count("1")]
                            bit = model.decide(contexts, weights, lambda p: coder(p, (level + 1, x, y, z)))
                        own |= bit << b
                        if bit and full_leaves and level + 1 < levels:
                            i = (full[level + 1].has(x - 1, y, z) + 2 * full[level + 1].has(x, y - 1, z) + 4 * full[level + 1].has(x, y, z - 1) +
                                 8 * (near == 8191) + 16 * far)
                            leaf = full_leaves(full_p[i])
                            full_p[i] = min(max(full_p[i] + (((65536 if leaf else 0) - full_p[i]) >> 4), 32), 65504)
                            if leaf:
                                full[level + 1].set(x, y, z)
                known[y, z] = own
        fine.rows = known
    return full


def draw_lessons():
    s = 1

    def draw(n):
        nonlocal s
        s ^= s << 13 & 0xffffffff
        s ^= s >> 17
        s ^= s << 5 & 0xffffffff
        return s * n >> 32

    def vector(m):
        while True:
            v = [draw(2 * m + 1) - m for _ in range(3)]
            if any(v):
                return v

    for _ in range(96):
        voxels = set()
        for _ in range(1 + draw(4)):
            kind, normal = draw(8), None
            if kind == 0:
                axis = draw(3)
                normal = [int(i == axis) for i in range(3)]
            elif kind < 6:
                normal = vector((1, 1, 4, 4, 40)[kind - 1])
            cut = vector(4)
            point = [draw(64) for _ in range(3)]
            center = [draw(192) - 64 if kind == 7 else draw(64) for _ in range(3)]
            radius = 32 + draw(96) if kind == 7 else 3 + draw(64)
            half = draw(2)
            cut_at = sum(c * p for c, p in zip(cut, point))
            for z in range(32):
                for y in range(32):
                    v, w = 2 * y + 1, 2 * z + 1
                    if normal:
                        base, most = normal[1] * v + normal[2] * w - sum(n * p for n, p in zip(normal, point)), sum(map(abs, normal))
                        found = [x for x in range(32) if -most <= normal[0] * (2 * x + 1) + base <= most]
                    else:
                        low = high = 0
                        for a in (abs(v - center[1]), abs(w - center[2])):
                            low += max(a - 1, 0) ** 2
                            high += (a + 1) ** 2
                        square = radius * radius
                        found = []
                        if low <= square:
                            for x in range(32):
                                a = abs(2 * x + 1 - center[0])
                                if low + max(a - 1, 0) ** 2 <= square <= high + (a + 1) ** 2:
                                    found.append(x)
                    for x in found:
                        if half == 0 or cut[0] * (2 * x + 1) + cut[1] * v + cut[2] * w >= cut_at:
                            voxels.add((x, y, z))
        yield voxels


def make_prior():
    model = Model()
    for voxels in draw_lessons():
        if not voxels:
            continue
        nodes = [Grid(l) for l in range(6)]
        for x, y, z in voxels:
            for l in range(6):
                nodes[l].set(x >> (5 - l), y >> (5 - l), z >> (5 - l))
        truth = [dict(g.rows) for g in nodes]

        def known(p, child):
            l, x, y, z = child
            return truth[l].get((y, z), 0) >> (x + PAD) & 1

        subtree(model, 5, known, nodes, False)
    model.slots = [[(q, min(n, 2), tag) for q, n, tag in s] for s in model.slots]
    return model


def decode(prior, levels, stream, count):
    """The masks in depth-first order."""
    at, code, size = 4, int.from_bytes((stream + bytes(4))[:4], "big"), 0xffffffff

    def bit(p):
        nonlocal at, code, size
        bound = (size >> 16) * p
        result = int(code < bound)
        if result:
            size = bound
        else:
            code -= bound
            size -= bound
        while size < 1 << 24:
            code = code << 8 & 0xffffffff | (stream[at] if at < len(stream) else 0)
            at += 1
            size = size << 8 & 0xffffffff
        return result

    has_full = bit(1024)
    nodes = [Grid(l) for l in range(levels + 1)]
    nodes[0].set(0, 0, 0)
    full = subtree(prior.copy(), levels, lambda p, child: bit(p), nodes, bit if has_full else False)
    assert len(stream) <= at <= len(stream) + 4, (at, len(stream))
    masks, stack = [], [(0, 0, 0, 0)]
    while stack:
        l, x, y, z = stack.pop()
        if full[l].has(x, y, z):
            masks.append(0)
            continue
        children = [(2 * x + (i & 1), 2 * y + (i >> 1 & 1), 2 * z + (i >> 2)) for i in range(8)]
        mask = sum(nodes[l + 1].has(*c) << i for i, c in enumerate(children))
        masks.append(mask)
        if l + 1 < levels:
            stack.extend((l + 1, *children[i]) for i in range(7, -1, -1) if mask >> i & 1)
    assert len(masks) == count, (len(masks), count)
    return bytes(masks)


def knots_of(text):
    """T as it stands in the specification."""
    line = next(l for l in text.splitlines() if l.startswith("22, 36,"))
    numbers = [int(n) for n in line.split(",")]
    assert len(numbers) == 33
    return numbers
