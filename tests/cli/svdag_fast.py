"""Layout 2 of .svdag ("fast") from docs/format/svdag.md alone; used by svdag_reader.py."""

import struct


def need(condition, rule):
    if not condition:
        raise ValueError(rule)


def bits(data, at, width):
    """`width` bits from bit `at` of a byte string, lowest first."""
    first, last = at // 8, (at + width + 7) // 8
    return int.from_bytes(data[first:last], "little") >> at % 8 & (1 << width) - 1


def ones(x):
    return bin(x).count("1")


def after(g, h):
    """The turn that does h and then g."""
    return PRODUCT[g][h]


def make_turns():
    order = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
    turns = [tuple((((o & 1) << p[0]) | ((o >> 1 & 1) << p[1]) | ((o >> 2) << p[2])) ^ f for o in range(8)) for p in order for f in range(8)]
    number = {t: i for i, t in enumerate(turns)}
    return turns, [[number[tuple(g[h[o]] for o in range(8))] for h in turns] for g in turns]


TURN, PRODUCT = make_turns()


class Fast:
    def __init__(self, c, tree, bricks, head):
        self.T, self.lod, self.unnumbered, self.bricks = head.T, head.lod, head.unnumbered, bricks
        self.brick_lod = head.brick_lod
        self._code(c, tree)
        need(self.T > 2 and head.root < 48, "DAG-17")
        self.root = self.pools[0][0], head.root

    def _code(self, c, tree):
        flags, = struct.unpack("<Q", c[64:72])
        need(len(c) == 72 + 32 * (self.T - 2) and flags <= 1, "DAG-17")
        self.flag_full = flags == 1
        self.ids, self.widths, self.changes = [list(c[0:4]), list(c[4:8])], [list(c[8:12]), list(c[12:16])], list(c[16:64])
        need(sorted(self.changes) == list(range(48)) and self.changes[0] == 0, "DAG-17")
        self.tree, self.pools, at = tree, [], 0
        self.blocks, self.turned = {}, {} # decoded before
        for level in range(self.T - 2):
            size, count, stored, r, s, n, zero = struct.unpack("<QQQ4sBBH", c[72 + 32 * level:104 + 32 * level])
            last, inner = level == self.T - 3, level < self.T - 4
            need(zero == 0 and (s != 0) == inner and (n != 0) == (inner and not self.unnumbered) and s <= 48 and n <= 64, "DAG-17")
            need(r[0] == 0 and all(x == 0 if last else 6 <= x <= 38 for x in r[1:]), "DAG-17")
            self.pools.append((8 * at, list(r), s, n))
            at += size
        need(at + 8 == len(tree) and tree[at:] == bytes(8), "DAG-17")

    def _size(self, brick):
        if brick is None: # a full leaf
            return 1
        return ones(brick) + (1 + sum(1 for a in range(8) if brick >> 8 * a & 255) if self.brick_lod else 0)

    def _block(self, at, turn):
        """{stored octant: brick as it lies in the grid} of a block, and the bit behind it."""
        if (at, turn) not in self.blocks:
            self.blocks[at, turn] = self._read_block(at, turn)
        return self.blocks[at, turn]

    def _turned(self, stored, h):
        if (stored, h) not in self.turned:
            self.turned[stored, h] = sum(1 << 8 * a + b for a in range(8) for b in range(8) if stored >> 8 * TURN[h][a] + TURN[h][b] & 1)
        return self.turned[stored, h]

    def _read_block(self, at, turn):
        full, octants, at = self._head(at)
        mode, common = bits(self.tree, at, 1), bits(self.tree, at + 1, 6)
        need(common < 48, "DAG-20")
        tags = [bits(self.tree, at + 7 + 2 * i, 2) for i in range(len(octants))]
        at += 7 + 2 * len(octants)
        result = {o: None for o in full}
        for o, tag in zip(octants, tags):
            i, w = self.ids[mode][tag], self.widths[mode][tag]
            code = bits(self.tree, at, w)
            at += w
            h = after(common, turn)
            if i == 64:
                stored = code
            else:
                need(code >> i < 48 and (code & (1 << i) - 1) < len(self.bricks), "DAG-20")
                stored = self.bricks[code & (1 << i) - 1]
                h = after(self.changes[code >> i], h)
            result[o] = self._turned(stored, h)
        return result, at

    def _head(self, at):
        """Octants of a node that are full leaves, the others, and the bit behind the masks."""
        mask, full = bits(self.tree, at, 8), bits(self.tree, at + 8, 8) if self.flag_full else 0
        need(mask != 0 and full & ~mask == 0, "DAG-04")
        return ([o for o in range(8) if full >> o & 1], [o for o in range(8) if mask & ~full & 1 << o], at + (16 if self.flag_full else 8))

    def _inside(self, level, at, turn):
        """{stored octant: (where, turn)} of a node, {stored octant: size} (None where bricks are counted), and the bit behind it."""
        if level == self.T - 3:
            bricks, end = self._block(at, turn)
            return dict(bricks), {o: self._size(b) for o, b in bricks.items()}, end
        _, r, s, n = self.pools[level]
        full, octants, at = self._head(at)
        tags = [bits(self.tree, at + 2 * i, 2) for i in range(len(octants))]
        at += 2 * len(octants)
        inner = [o for o, tag in zip(octants, tags) if tag == 0]
        skips = [0] + [bits(self.tree, at + s * i, s) for i in range(len(inner) - 1)]
        at += s * (len(skips) - 1)
        sizes = {o: bits(self.tree, at + n * i, n) for i, o in enumerate(sorted(full + octants))} if n else None
        at += n * len(full + octants)
        children = {o: None for o in full}
        for o, tag in zip(octants, tags):
            if tag:
                code = bits(self.tree, at, r[tag])
                need(code & 63 < 48, "DAG-20")
                children[o] = self.pools[level + 1][0] + 8 * (code >> 6), after(code & 63, turn)
                at += r[tag]
        begin = at
        for o, skip in zip(inner, skips):
            if s:
                children[o] = begin + skip, turn
            else: # blocks are walked over
                children[o] = at, turn
                at = self._block(at, turn)[1]
        return children, sizes, at

    def children(self, level, node, index):
        """(octant, node, attribute index) of a node above the bricks; below the blocks the node is the brick, None if full."""
        at, turn = node
        children, sizes, _ = self._inside(level, at, turn)
        if sizes is None and not self.unnumbered:
            sizes = {o: 1 if c is None else (1 if self.lod else 0) + sum(map(self._size, self._block(*c)[0].values())) for o, c in children.items()}
        index += 1 if self.lod else 0
        for octant in range(8):
            o = TURN[turn][octant]
            if o in children:
                yield octant, children[o], 0 if self.unnumbered else index
                index += 0 if self.unnumbered else sizes[o]
