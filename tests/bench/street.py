#!/usr/bin/env python3
"""A street of a city as one glTF scene, from the glTF files of a folder of city tiles (KayKit's City Builder Bits, CC0).

    tests/bench/street.py FOLDER OUT.gltf [--tiles 64]

Every tile of 2 x 2 has a road, a building on each side, and street lights, bushes and cars here and there, in an order that depends on nothing but the number of the tile. The files
that the scene needs are copied beside it. It is long and thin, so even at 64K^3 it has about a thousand million voxels: a city that a small machine can make."""

import argparse
import json
import pathlib
import shutil

BUILDINGS = ["building_" + c for c in "ABCDEFGH"]


class Scene:
    def __init__(self, folder, out):
        self.folder, self.out = folder, out
        self.doc = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [], "materials": [], "textures": [], "images": [], "samplers": [],
                    "accessors": [], "bufferViews": [], "buffers": []}
        self.first = {}  # name -> nodes of its file's scene, as numbers of ours

    def load(self, name):
        """Append the file's arrays once; returns the roots of its scene."""
        if name in self.first:
            return self.first[name]
        j, d = json.loads((self.folder / (name + ".gltf")).read_text()), self.doc
        base = {k: len(d[k]) for k in d if isinstance(d[k], list) and k != "scenes"}
        for kind in ("buffers", "images"):
            for x in j.get(kind, []):
                shutil.copyfile(self.folder / x["uri"], self.out.parent / pathlib.PurePath(x["uri"]).name)
                d[kind].append({**x, "uri": pathlib.PurePath(x["uri"]).name})
        d["bufferViews"] += [{**v, "buffer": v["buffer"] + base["buffers"]} for v in j["bufferViews"]]
        d["accessors"] += [{**a, "bufferView": a["bufferView"] + base["bufferViews"]} for a in j["accessors"]]
        d["samplers"] += j.get("samplers", [])
        for t in j.get("textures", []):
            d["textures"].append({**t, "source": t["source"] + base["images"], **({"sampler": t["sampler"] + base["samplers"]} if "sampler" in t else {})})

        def moved(o):  # texture references of a material
            if isinstance(o, dict):
                return {k: (v + base["textures"] if k == "index" else moved(v)) for k, v in o.items()}
            return o

        d["materials"] += [moved(m) for m in j.get("materials", [])]
        for m in j["meshes"]:
            parts = []
            for p in m["primitives"]:
                q = {**p, "attributes": {k: v + base["accessors"] for k, v in p["attributes"].items()}}
                if "indices" in p:
                    q["indices"] += base["accessors"]
                if "material" in p:
                    q["material"] += base["materials"]
                parts.append(q)
            d["meshes"].append({**m, "primitives": parts})
        self.first[name] = (j, base)
        return self.first[name]

    def place(self, name, x, z, turn=0):
        """One copy, moved and turned by quarters about the vertical axis."""
        j, base = self.load(name)

        def copy(i):
            n = {**j["nodes"][i]}
            if "mesh" in n:
                n["mesh"] += base["meshes"]
            n["children"] = [copy(c) for c in n.get("children", [])]
            if not n["children"]:
                del n["children"]
            self.doc["nodes"].append(n)
            return len(self.doc["nodes"]) - 1

        roots = [copy(i) for i in j["scenes"][j.get("scene", 0)]["nodes"]]
        half = {0: (0, 1), 1: (0.5 ** 0.5, 0.5 ** 0.5), 2: (1, 0), 3: (0.5 ** 0.5, -(0.5 ** 0.5))}[turn % 4]
        self.doc["nodes"].append({"name": name, "translation": [x, 0, z], "rotation": [0, half[0], 0, half[1]], "children": roots})
        self.doc["scenes"][0]["nodes"].append(len(self.doc["nodes"]) - 1)


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("folder", type=pathlib.Path)
    p.add_argument("out", type=pathlib.Path)
    p.add_argument("--tiles", type=int, default=64)
    o = p.parse_args()
    s = Scene(o.folder, o.out)
    for i in range(o.tiles):
        s.place("road_straight", 2 * i, 0, 1)
        s.place(BUILDINGS[i * 5 % 8], 2 * i, 2, 0)
        s.place(BUILDINGS[(i * 3 + 1) % 8], 2 * i, -2, 2)
        if i % 3 == 0:
            s.place("streetlight", 2 * i, 0.9, 2)
        if i % 4 == 1:
            s.place(["car_taxi", "car_sedan", "car_police", "car_hatchback"][i // 4 % 4], 2 * i, 0.3, 1)
        if i % 5 == 2:
            s.place("bush", 2 * i + 0.5, -0.9)
    s.doc = {k: v for k, v in s.doc.items() if v != []}
    o.out.write_text(json.dumps(s.doc))


main()
