"""A strict reader of SWC files, from the description of the format alone (Cannon et al. 1998; neuroinformatics.nl's SWC specification):
lines of seven numbers `n T x y z R P`, comments begin with #; n are positive integers that ascend by one, T is an integer, R > 0 or 0,
P is the n of a point that came before, or -1 for a root."""

import math


class SwcError(Exception):
    pass


class Swc:
    """points: (x, y, z, radius) by number; parent: number by number (None for roots); children; roots."""

    def __init__(self, path):
        self.points, self.parent, self.children, self.roots, self.comments = {}, {}, {}, [], []
        for at, line in enumerate(path.read_text(encoding="ascii").split("\n"), 1):
            if not line.strip():
                continue
            if line.startswith("#"):
                self.comments.append(line[1:].strip())
                continue
            w = line.split()
            if len(w) != 7:
                raise SwcError("line %d has %d columns" % (at, len(w)))
            if not (w[0].isdigit() and w[1].isdigit() and (w[6] == "-1" or w[6].isdigit())):
                raise SwcError("line %d: number, type or parent is no integer" % at)
            n, parent = int(w[0]), int(w[6])
            values = tuple(float(x) for x in w[2:6])
            if n != len(self.points) + 1:
                raise SwcError("line %d is point %d" % (at, n))
            if not all(math.isfinite(x) for x in values) or values[3] < 0:
                raise SwcError("line %d: a number is not finite, or the radius is negative" % at)
            if parent != -1 and parent not in self.points:
                raise SwcError("line %d: parent %d does not come before" % (at, parent))
            self.points[n], self.parent[n] = values, None if parent == -1 else parent
            self.children[n] = []
            if parent == -1:
                self.roots.append(n)
            else:
                self.children[parent].append(n)
        if not self.points:
            raise SwcError("no point")

    def bones(self):
        return {frozenset((n, p)) for n, p in self.parent.items() if p is not None}


class Curve:
    """An OBJ with points and lines alone: v, l of two different points, p of points that no line has; nothing else, no bone twice."""

    def __init__(self, path):
        self.points, self.bones, self.loose = [], [], []
        for at, line in enumerate(path.read_text(encoding="ascii").split("\n"), 1):
            w = line.split()
            if not w or w[0].startswith("#"):
                continue
            if w[0] == "v" and len(w) == 4 and all(math.isfinite(float(x)) for x in w[1:]):
                self.points.append(tuple(float(x) for x in w[1:]))
            elif w[0] == "l" and len(w) == 3 and w[1] != w[2]:
                self.bones.append((int(w[1]) - 1, int(w[2]) - 1))
            elif w[0] == "p" and len(w) == 2:
                self.loose.append(int(w[1]) - 1)
            else:
                raise SwcError("line %d of the OBJ: %s" % (at, line))
        used = {j for b in self.bones for j in b}
        if any(not 0 <= j < len(self.points) for j in used | set(self.loose)):
            raise SwcError("a point that is not there")
        if len({frozenset(b) for b in self.bones}) != len(self.bones):
            raise SwcError("a bone is there twice")
        if set(self.loose) != set(range(len(self.points))) - used:
            raise SwcError("points without bones are not those with p")


def check_pair(swc, curve, components):
    """The trees of the SWC span the curve of the OBJ: same points, bones of the curve, one root for each component, what is left out closes loops."""
    at = {}
    for j, p in enumerate(curve.points):
        at.setdefault(p, []).append(j)
    numbers = {}
    for n, p in swc.points.items():
        if not at.get(p[:3]):
            raise SwcError("point %d is none of the curve" % n)
        numbers[n] = at[p[:3]].pop()
    if any(at.values()):
        raise SwcError("a joint is missing")
    bones = {frozenset(b) for b in curve.bones}
    tree = {frozenset(numbers[n] for n in b) for b in swc.bones()}
    if not tree <= bones:
        raise SwcError("a branch that is no bone")
    parent = list(range(len(curve.points)))

    def root(i):
        while parent[i] != i:
            i = parent[i]
        return i

    for b in bones:
        x, y = b
        parent[root(x)] = root(y)
    found = {root(i) for i in range(len(parent))}
    if len(swc.roots) != len(found) or {root(numbers[n]) for n in swc.roots} != found or len(found) != components:
        raise SwcError("%d roots, %d components" % (len(swc.roots), len(found)))
    left = len(bones) - len(tree)
    if left != len(bones) - len(parent) + len(found):
        raise SwcError("%d bones left out" % left)
    if left and not any(c.startswith("%d bones" % left) for c in swc.comments):
        raise SwcError("no comment tells that %d bones are left out" % left)
