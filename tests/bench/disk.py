#!/usr/bin/env python3
"""Bytes on disk of octrees alone: .svo files of both forms beside the masks of all nodes without pointers under xz -9e, and rates of decoding.

    disk.py TOOLS BENCH_MASKS DEPTHS MESH...      DEPTHS such as 10,11

The rival is one byte a node, level by level, in one stream; xz_deep is the same depth first, which xz packs better. The few nodes above the chunks are
left out of both, which favours them. Ours are
whole files (header, directory, checksums): --disk small, and the larger and faster ones under zstd (--level 19) and as they are (--level 0).
Bits are of a finest voxel; rates are of one thread by its own CPU time, decoding the coded masks.
"""
import lzma
import os
import subprocess
import sys
import tempfile


def main():
    tools, bench, depths, meshes = sys.argv[1], sys.argv[2], sys.argv[3].split(","), sys.argv[4:]
    ratios = []
    print("model,depth,mvoxels,xz_bits,xz_deep_bits,small_bits,zstd_bits,plain_bits,small_of_xz,small_of_xz_deep,decode_mvoxels_s")
    with tempfile.TemporaryDirectory() as folder:
        masks = os.path.join(folder, "masks")
        for depth in depths:
            for mesh in meshes:
                size = []
                for options in (["--disk", "small"], ["--level", "19"], ["--level", "0"]):
                    svo = os.path.join(folder, "a.svo")
                    subprocess.run([tools + "/svo-voxelize", mesh, "-o", svo, "--depth", depth, "--attributes", "none", "-q", "-f"] + options, check=True)
                    size.append(os.path.getsize(svo))
                words = subprocess.run([bench, "-o", masks, svo], check=True, capture_output=True, text=True).stdout.split()
                voxels = float(words[1]) * 1e6
                rate = float(words[words.index("decode") + 1])
                rivals = []
                for path in (masks, masks + ".deep"):
                    with open(path, "rb") as f:
                        rivals.append(len(lzma.compress(f.read(), preset=9 | lzma.PRESET_EXTREME)))
                ratios.append([size[0] / r for r in rivals])
                bits = [8 * b / voxels for b in rivals + size]
                print("%s,%s,%.3f,%.4f,%.4f,%.4f,%.4f,%.4f,%.3f,%.3f,%.2f" % (os.path.basename(mesh), depth, voxels * 1e-6, *bits, *ratios[-1], rate), flush=True)
    for name, r in zip(("level by level", "depth first"), zip(*ratios)):
        print("%s: mean %.3f, largest %.3f" % (name, sum(r) / len(r), max(r)))


if __name__ == "__main__":
    main()
