"""Layout 3 of .svdag for svdag_reader.py, written from docs/format/svdag.md alone."""

import struct

P = ["012", "021", "102", "120", "201", "210"]
TURN = [[sum((o >> k & 1) << int(P[g // 8][k]) for k in range(3)) ^ g % 8 for o in range(8)] for g in range(48)]
NUMBER = {tuple(t): g for g, t in enumerate(TURN)}
KINDS = ("CLASS", "CLASS_FIRST", "TURN", "TURN_FIRST", "MASK", "OCTANTS", "OCTANT")


def need(condition, rule):
    if not condition:
        raise ValueError(rule)


def ones(x):
    return bin(x).count("1")


def octants(mask):
    return [o for o in range(8) if mask >> o & 1]


def after(a, b):
    return NUMBER[tuple(TURN[a][o] for o in TURN[b])]


def inverse(g):
    return NUMBER[tuple(TURN[g].index(o) for o in range(8))]


def turn_mask(g, mask):
    return sum(1 << TURN[g][o] for o in octants(mask))


def turn_brick(g, brick):
    return sum(turn_mask(g, brick >> 8 * a & 255) << 8 * TURN[g][a] for a in range(8))


def _corners():
    best = {}
    for mask in range(1, 256):
        for o in octants(mask):
            turns = [g for g in range(48) if TURN[g][o] == 0]
            g = min(turns, key=lambda g: (turn_mask(g, mask), g))
            best[mask, o] = g, turn_mask(g, mask)
    order = sorted({m for _, m in best.values()})
    need(len(order) == 40, "corners")
    return {key: (g, order.index(m)) for key, (g, m) in best.items()}


CORNER = _corners()


class Bits:
    """Highest bit of a byte first."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def get(self, n):
        first, last = self.at // 8, (self.at + n + 7) // 8
        need(last <= len(self.data), "DAG-12")
        v = int.from_bytes(self.data[first:last], "big") >> 8 * last - self.at - n & (1 << n) - 1
        self.at += n
        return v

    def symbol(self, code):
        need(code, "DAG-14")
        value, n = 0, 0
        while (n, value) not in code:
            need(n < 25, "DAG-13")
            value, n = value << 1 | self.get(1), n + 1
        return code[n, value]


def canonical(lengths):
    """{symbol: length} to {(length, code): symbol}."""
    codes, code, last = {}, 0, None
    for length, symbol in sorted((l, s) for s, l in lengths.items()):
        if last is not None:
            code = code + 1 << length - last
        last = length
        codes[length, code] = symbol
    need(not lengths or code == (1 << last) - 1, "DAG-13")
    return codes


class Best:
    def __init__(self, levels, code, tree, bricks, svdag):
        self.tree, self.bricks, self.numbered, self.lod = tree, bricks, not svdag.unnumbered, svdag.lod
        self.brick_lod = svdag.brick_lod
        need(len(levels) == 32 * (svdag.T - 2) and tree[-16:] == bytes(16) and code[-16:] == bytes(16), "DAG-12")
        self.levels = [struct.unpack("<QQQ4BI", levels[i:i + 32]) for i in range(0, len(levels), 32)]
        self.block_level = svdag.T - 3
        self._codes(Bits(code))
        mask = tree[0]
        self.root = (8, mask, svdag.root, svdag.A)

    def _codes(self, b):
        self.K, flags = b.get(8), b.get(8)
        need(3 <= self.K <= 32 and flags <= 1, "DAG-13")
        self.solid = flags == 1
        count = dict(zip(KINDS, (self.K, 40, 48, 40, 40, 1, 40)))
        symbols = dict(zip(KINDS, (self.K, self.K, 48, 48, 256, 256, 256)))
        self.code = {}
        for kind in KINDS:
            for context in range(count[kind]):
                n, lengths = symbols[kind], {}
                s = (n - 1).bit_length()
                if b.get(1):
                    if b.get(1):
                        for _ in range(b.get(s) + 1):
                            symbol = b.get(s)
                            lengths[symbol] = b.get(4)
                    else:
                        lengths = {i: l for i, l in ((i, b.get(4)) for i in range(n)) if l}
                self.code[kind, context] = canonical(lengths)
        self.first, self.id = {}, {}
        bricks = 0
        for c in range(1, self.K - 1):
            longest = b.get(5)
            lengths = [l for l in range(longest + 1) for _ in range(b.get(b.get(5)))]
            self.first[c], self.id[c] = bricks, canonical(dict(enumerate(lengths)))
            bricks += len(lengths)
        need(bricks == len(self.bricks) and (b.at + 7) // 8 + 16 == len(b.data), "DAG-13")

    def _block(self, b, mask):
        """{octant: brick in the entry's frame, or None for a full leaf}"""
        full = b.get(ones(mask)) if self.solid and b.get(1) else 0
        out, last_class, last_turn = {}, None, None
        for i, o in enumerate(octants(mask)):
            if full >> ones(mask) - 1 - i & 1:
                out[o] = None
                continue
            turn, corner = CORNER[mask, o]
            last_class = b.symbol(self.code["CLASS_FIRST", corner] if last_class is None else self.code["CLASS", last_class])
            if last_class == self.K - 1:
                there, out[o] = b.symbol(self.code["OCTANTS", 0]), 0
                for a in octants(there):
                    t, c = CORNER[there, a]
                    out[o] |= turn_mask(inverse(t), b.symbol(self.code["OCTANT", c])) << 8 * a
                continue
            number = b.symbol(self.id[last_class])
            if last_turn is None:
                last_turn = after(inverse(turn), b.symbol(self.code["TURN_FIRST", corner]))
            else:
                last_turn = b.symbol(self.code["TURN", last_turn])
            out[o] = turn_brick(last_turn, self.bricks[self.first[last_class] + number])
        return out

    def _size(self, brick):
        if brick is None:
            return 1
        return ones(brick) + (1 + sum(1 for a in range(8) if brick >> 8 * a & 255) if self.brick_lod else 0)

    def children(self, level, node, index):
        """(octant, node, attribute index) in the order of the grid; below the blocks the node is the brick, None if full."""
        at, mask, world, size = node
        b = Bits(self.tree)
        b.at = at
        if level == self.block_level:
            found = {o: (turn_brick(world, brick) if brick is not None else None, self._size(brick)) for o, brick in self._block(b, mask).items()}
        else:
            found = self._inner(b, level, mask, world, size)
        if self.numbered and self.lod:
            index += 1
        for o in sorted(found, key=lambda o: TURN[world][o]):
            yield TURN[world][o], found[o][0], index
            index += found[o][1] if self.numbered else 0

    def _inner(self, b, level, mask, world, size):
        k, field = ones(mask), 4 if level == self.block_level - 1 else 6
        full = b.get(k) if self.solid and b.get(1) else 0
        full = {o for i, o in enumerate(octants(mask)) if full >> k - 1 - i & 1}
        refs = [o for o in octants(mask) if o not in full]
        shared = [o for o in refs if b.get(1)]
        inside = [o for o in refs if o not in shared]
        skips, sizes = [0], [0] * k
        if len(inside) > 1:
            w = b.get(field)
            skips += [b.get(w) for _ in inside[1:]]
        if self.numbered and k > 1:
            w = b.get(field)
            sizes = [b.get(w) for _ in range(k - 1)]
            sizes.append(size - (1 if self.lod else 0) - sum(sizes))
        elif self.numbered:
            sizes = [size - (1 if self.lod else 0)]
        size_of = dict(zip(octants(mask), sizes))
        tags = [b.get(2) for _ in shared]
        found = {o: (None, 1) for o in full}
        begin, _, _, *tiers, _ = self.levels[level + 1] if shared else (0, 0, 0, 0)
        for o, tag in zip(shared, tags):
            byte, turn = begin + b.get(tiers[tag]), b.get(6)
            found[o] = (8 * byte + 8, self.tree[byte], after(world, turn), size_of[o]), size_of[o]
        start = b.at
        for o, skip in zip(inside, skips):
            b.at = start + skip
            if level + 1 == self.block_level:
                turn, corner = CORNER[mask, o]
                child = turn_mask(inverse(turn), b.symbol(self.code["MASK", corner]))
            else:
                child = b.get(8)
            found[o] = (b.at, child, world, size_of[o]), size_of[o]
        return found
