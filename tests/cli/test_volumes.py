"""svo-voxelize of dense volumes: raw samples of every type, NRRD in all its encodings, in the file and beside it; against the samples themselves."""

import bz2
import gzip
import os
import random
import shutil
import struct
import subprocess
import sys
import zlib

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from support import check, run, tool

TYPES = {"i8": ("b", "int8"), "u8": ("B", "uchar"), "i16": ("h", "short"), "u16": ("H", "uint16"), "i32": ("i", "int"), "u32": ("I", "unsigned int"),
         "i64": ("q", "long long"), "u64": ("Q", "uint64_t"), "f32": ("f", "float"), "f64": ("d", "double")}
SIZE = (5, 4, 3)
VALUES = [((7 * i) % 60) - 20 for i in range(60)]


def cells(folder, file, *more):
    run("svo-voxelize", file, "-o", folder / "v.svo", "-f", *more)
    check(run("svo-dump", "--validate", folder / "v.svo").code == 0)
    run("svo-dump", folder / "v.svo", "--voxels", folder / "v.ply", "-f", "-q")
    c = support.read_ply(folder / "v.ply")
    return {at: i for i, at in enumerate(zip(c["vx"], c["vy"], c["vz"]))}, c


def wanted(values, size=SIZE, least=None):
    return {(i % size[0], i // size[0] % size[1], i // (size[0] * size[1])) for i, v in enumerate(values) if (v >= least if least is not None else v > 0)}


def nrrd(kind, encoding, data, size=SIZE, more=""):
    return ("NRRD0005\ntype: %s\ndimension: 3\nsizes: %d %d %d\nencoding: %s\n%s\n" % (kind, *size, encoding, more)).encode() + data


def test_raw(folder):
    for name, (letter, _) in TYPES.items():
        values = [abs(v) for v in VALUES] if name[0] == "u" else VALUES
        for mark, order in (("<", ":little" if name == "u16" else ""), (">", ":big")):
            data = struct.pack(mark + "60" + letter, *values)
            (folder / "a.raw").write_bytes(data)
            check(set(cells(folder, folder / "a.raw", "--raw", "5x4x3:%s%s" % (name, order))[0]) == wanted(values), (name, order))
            (folder / "a.raw").write_bytes(b"head" + data + b"tail")
            check(set(cells(folder, folder / "a.raw", "--raw", "5x4x3:%s%s:4" % (name, order), "--threshold", 7)[0]) == wanted(values, least=7), (name, order))
    _, c = cells(folder, folder / "a.raw", "--raw", "5x4x3:f64:big:4", "--voxel-size", "0.25", "--attributes", "intensity")
    check(min(c["x"]) == 0.125 and abs(c["intensity"][0] - 255 * (VALUES[next(i for i, v in enumerate(VALUES) if v > 0)] + 20) / 59) < 99)
    at, c = cells(folder, folder / "a.raw", "--raw", "5x4x3:f64:big:4", "--attributes", "intensity", "--threshold=-20")
    check(len(at) == 60 and all(abs(c["intensity"][k] - (VALUES[x + 5 * y + 20 * z] + 20) * 255 / 59) <= 0.51 for (x, y, z), k in at.items()))
    (folder / "a.raw").write_bytes(bytes(range(32)))
    at, c = cells(folder, folder / "a.raw", "--raw", "2x2x2:rgba", "--threshold", 8)
    check(len(at) == 6 and all((c["red"][k], c["green"][k], c["blue"][k]) == tuple(4 * (x + 2 * y + 4 * z) + i for i in range(3)) for (x, y, z), k in at.items()))
    for code, spec in ((1, "2x2:u8"), (1, "2x2x2"), (1, "2x2x2:u7"), (1, "0x2x2:u8"), (1, "2x2x2:u8:middle"), (1, "2x2x2:u8:"), (1, "-2x2x2:u8"), (1, "9999999x2x2:u8"), (3, "2x2x3:u8"), (3, "4x4x4:u8"),
                       (3, "2x2x2:u8"), (3, "2x2x2:u8:30"), (3, "2x2x2:u8:99999999999"), (3, "2000000x2000000x2000000:u8"), (3, "2000000x2000000x2000000:f64:3")):
        r = tool("svo-voxelize", folder / "a.raw", "-o", folder / "x.svo", "--raw", spec)
        check(r.code == code and not (folder / "x.svo").exists(), (spec, r))


def test_encodings(folder):
    for name, (letter, kind) in TYPES.items():
        values = [abs(v) for v in VALUES] if name[0] == "u" else VALUES
        for mark, order in (("<", "little"), (">", "big")):
            data = struct.pack(mark + "60" + letter, *values)
            text = "\n".join(" ".join("%g" % v for v in values[i:i + 5]) for i in range(0, 60, 5)).encode()
            files = [nrrd(kind, "raw", data, more="endian: %s\n" % order), nrrd(kind, "gzip", gzip.compress(data), more="endian: %s\n" % order),
                     nrrd(kind, "gz", gzip.compress(data[:50]) + gzip.compress(data[50:]), more="endian: %s\n" % order), nrrd(kind, "ascii", text + b"\n"),
                     nrrd(kind, "gzip", zlib.compress(data), more="endian: %s\n" % order), nrrd(kind, "bzip2", bz2.compress(data), more="endian: %s\n" % order),
                     nrrd(kind, "bz2", bz2.compress(data[:50]) + bz2.compress(data[50:]), more="endian: %s\n" % order),
                     nrrd(kind, "hex", data.hex(" ", 7).upper().encode() + b"\n", more="endian: %s\n" % order), nrrd(kind, "hex", data.hex().encode(), more="endian: %s\n" % order)]
            for i, f in enumerate(files if name in ("i16", "f64") else files[:2] if order == "big" else files[3:4]):
                (folder / "a.nrrd").write_bytes(f)
                check(set(cells(folder, folder / "a.nrrd", "--threshold", 3)[0]) == wanted(values, least=3), (name, order, i))


def test_beside(folder):
    """Detached headers, skipped lines and bytes; files elsewhere are refused."""
    data = struct.pack("<60h", *VALUES)
    (folder / "below").mkdir()
    (folder / "below" / "x.raw").write_bytes(b"one\ntwo\n###" + data)
    (folder / "x.raw.gz").write_bytes(b"one\n" + gzip.compress(b"##" + data + b"more"))
    (folder / "x.raw.bz2").write_bytes(b"one\n" + bz2.compress(b"##" + data + b"more"))
    for more, encoding in (("line skip: 2\nbyte skip: 3\ndata file: below/x.raw\n", "raw"), ("byteskip: -1\ndatafile: below/x.raw\n", "raw"),
                           ("line skip: 1\nbyte skip: 2\ndata file: ./x.raw.bz2\n", "bzip2"), ("line skip: 1\nbyte skip: 2\ndata file: ./x.raw.gz\n", "gzip")):
        for end in ("", "\n"):
            (folder / "a.nhdr").write_bytes(nrrd("short", encoding, b"", more="endian: little\n" + more)[:-1] + end.encode())
            check(set(cells(folder, folder / "a.nhdr", "-MD")[0]) == wanted(VALUES), more)
    check("x.raw.gz" in (folder / "v.svo.d").read_text() and len(run("svo-dump", "--json", folder / "v.svo").json["provenance"]["inputs"]) == 2)
    key = run("svo-voxelize", "--key", folder / "a.nhdr").text
    (folder / "x.raw.gz").write_bytes(b"one\n" + gzip.compress(b"##" + data[:-1] + b"\x01"))
    check(run("svo-voxelize", "--key", folder / "a.nhdr").text != key, "the key does not see the data")
    (folder / "below" / "b.nhdr").write_bytes(nrrd("short", "raw", b"", more="data file: ../x.raw\n"))
    for name in ("../x.raw", "/etc/passwd", "below/../../x", "C:\\x", "http://x/y", "~/x"):
        (folder / "b.nhdr").write_bytes(nrrd("short", "raw", b"", more="data file: %s\n" % name))
        check(tool("svo-voxelize", folder / "b.nhdr", "-o", folder / "x.svo").code == 3, name)
    for code, more in ((2, "data file: none.raw\n"), (5, "data file: LIST\n"), (5, "data file: x%03d.raw 1 3 1\n"), (3, "line skip: 9\ndata file: below/x.raw\n"), (3, "byte skip: 9999\ndata file: below/x.raw\n"),
                       (3, "byte skip: -2\ndata file: below/x.raw\n"), (2, "data file: below\n")):
        (folder / "b.nhdr").write_bytes(nrrd("short", "raw", b"", more=more))
        r = tool("svo-voxelize", folder / "b.nhdr", "-o", folder / "x.svo")
        check(r.code == code, (more, r))


def test_files_of_teem(folder):
    """What teem's own tool (package teem-apps) writes, in each encoding and detached; and it reads what svo-dump writes."""
    if shutil.which("teem-unu") is None:
        support.skip("NO WRITER: teem-unu (package teem-apps) is missing")
    data = struct.pack("<60h", *VALUES)
    (folder / "a.nrrd").write_bytes(nrrd("short", "raw", data, more="endian: little\nspacings: 2 3 4\n"))
    unu = lambda *words: subprocess.run(["teem-unu"] + [str(w) for w in words], check=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=60).stdout
    places = set()
    for i, (encoding, name) in enumerate((("raw", "b.nrrd"), ("gzip", "b.nrrd"), ("ascii", "b.nrrd"), ("raw", "b.nhdr"), ("gzip", "c.nhdr"), ("bzip2", "b.nrrd"), ("hex", "b.nrrd"), ("bzip2", "c.nhdr"))):
        unu("save", "-f", "nrrd", "-e", encoding, "-i", folder / "a.nrrd", "-o", folder / name)
        at, c = cells(folder, folder / name, "--threshold", 3)
        check(set(at) == wanted(VALUES, least=3), (encoding, name))
        places.add((min(c["x"]), min(c["y"]), max(c["z"])))
    unu("convert", "-t", "float", "-i", folder / "a.nrrd", "-o", folder / "d.nrrd")
    at, c = cells(folder, folder / "d.nrrd", "--threshold", 3)
    check(set(at) == wanted(VALUES, least=3) and len(places) == 1, places)
    run("svo-dump", folder / "v.svo", "--export", folder / "e.nrrd", "-q")
    check(unu("minmax", folder / "e.nrrd").split() == [b"min:", b"0", b"max:", b"255"])


def test_large(folder):
    """Over the borders of chunks, threads and memory alike; colours, values and places of each."""
    size, r = (140, 30, 133), random.Random(3)
    values = bytearray(size[0] * size[1] * size[2])
    for _ in range(9):
        x, y, z, v = r.randrange(100), r.randrange(20), r.randrange(100), r.randrange(90, 256)
        for k in range(z, z + 33):
            for j in range(y, y + 10):
                at = x + size[0] * (j + size[1] * k)
                values[at:at + 40] = bytes((v + i) % 256 for i in range(40))
    (folder / "a.raw").write_bytes(values)
    spec = ["--raw", "140x30x133:u8", "--threshold", 80, "--attributes", "intensity"]
    at, c = cells(folder, folder / "a.raw", "--threads", 1, *spec)
    check(set(at) == wanted(values, size, 80))
    low, high = min(values), max(values)
    check(all(abs(c["intensity"][k] - 255 * (values[p[0] + size[0] * (p[1] + size[1] * p[2])] - low) / (high - low)) <= 0.51 for p, k in at.items()))
    first = (folder / "v.svo").read_bytes()
    (folder / "b.nrrd").write_bytes(nrrd("uint8", "gzip", gzip.compress(bytes(values)), size))
    for more in (["--threads", 3], ["--memory", "64M"]):
        cells(folder, folder / "a.raw", *spec, *more)
        check((folder / "v.svo").read_bytes() == first, more)
    again, _ = cells(folder, folder / "b.nrrd", "--threshold", 80)
    check(set(again) == set(at))
    # out as a volume and in again
    run("svo-dump", folder / "v.svo", "--export", folder / "c.raw", "--low", "0,0,0", "--high", "139,29,132", "-q")
    check(set(cells(folder, folder / "c.raw", "--raw", "140x30x133:u8")[0]) == set(at))


def test_thin_and_empty(folder):
    for size in ((1, 1, 1), (1, 1, 3000), (2000, 1, 1), (1, 129, 1)):
        values = [(i * 7) % 5 for i in range(size[0] * size[1] * size[2])]
        (folder / "a.raw").write_bytes(bytes(values))
        check(set(cells(folder, folder / "a.raw", "--raw", "%dx%dx%d:u8" % size)[0]) == wanted(values, size))
    (folder / "a.raw").write_bytes(bytes(64))
    check(run("svo-voxelize", folder / "a.raw", "--raw", "4x4x4:u8", "-o", folder / "e.svo").code == 0 and run("svo-dump", "--json", folder / "e.svo").json["voxels"] == 0)
    (folder / "a.raw").write_bytes(struct.pack("<4f", float("nan"), float("inf"), -1, 1))
    check(set(cells(folder, folder / "a.raw", "--raw", "4x1x1:f32", "--attributes", "intensity")[0]) == {(1, 0, 0), (3, 0, 0)})


def test_hostile(folder):
    data = struct.pack("<60h", *VALUES)
    packed = gzip.compress(data)
    for bad in (nrrd("short", "gzip", packed[:-20]), nrrd("short", "gzip", packed[:30] + b"\xff" * 20 + packed[50:]), nrrd("short", "gzip", b"nothing"), nrrd("short", "gzip", b""),
                nrrd("short", "gzip", packed, (200000, 2000, 200)), nrrd("short", "ascii", b"1 2 3"), nrrd("short", "ascii", b"1 x " * 60), nrrd("short", "ascii", b"1e300 " * 60),
                nrrd("short", "bzip2", bz2.compress(data)[:-20]), nrrd("short", "bzip2", bz2.compress(data)[:40]), nrrd("short", "bzip2", bz2.compress(data)[:30] + b"\xff" * 9 + bz2.compress(data)[39:]),
                nrrd("short", "bzip2", b"nothing"), nrrd("short", "bzip2", b""), nrrd("short", "bzip2", bz2.compress(data[:60]) + b"BZh9"), nrrd("short", "hex", data.hex()[:-1].encode()),
                nrrd("short", "hex", b"0g" * 120), nrrd("short", "hex", b" " * 500), nrrd("short", "hex", b""), nrrd("short", "raw", data, (2097152, 2097152, 2097152)), nrrd("short", "raw", data, (5, 4, -3)), nrrd("short", "raw", data)[:40], nrrd("short", "raw", data, more="spacings: nan nan nan\n")):
        (folder / "b.nrrd").write_bytes(bad)
        r = tool("svo-voxelize", folder / "b.nrrd", "-o", folder / "x.svo", timeout=60)
        check(r.code == 3 and not (folder / "x.svo").exists(), (bad[:120], r))
    for encoding, body in (("gzip", gzip.compress(bytes(1 << 20))), ("bzip2", bz2.compress(bytes(1 << 20))), ("hex", b"00" * (1 << 20)), ("ascii", b"1 " * (1 << 20))): # what is unpacked counts as temporary files
        (folder / "b.nrrd").write_bytes(nrrd("uint8", encoding, body, (1024, 1024, 1)))
        r = tool("svo-voxelize", folder / "b.nrrd", "-o", folder / "t.svo", "--temp-size", "1023K")
        check(r.code == 6 and "--temp-size" in r.err and not (folder / "t.svo").exists(), r)
        check(run("svo-voxelize", folder / "b.nrrd", "-o", folder / "t.svo", "--temp-size", "1M", "-f", "--attributes", "none").code == 0)
        (folder / "t.svo").unlink()
    bomb = gzip.compress(bytes(1 << 24)) # declares less than it holds: what is declared is taken
    (folder / "b.nrrd").write_bytes(nrrd("uint8", "gzip", bomb, (10, 10, 10)))
    check(run("svo-voxelize", folder / "b.nrrd", "-o", folder / "x.svo").code == 0)
    r = random.Random(2)
    for seed in (nrrd("short", "raw", data), nrrd("short", "gzip", packed), nrrd("short", "ascii", b"1 2 3 4 5 6 " * 10)):
        for _ in range(60):
            bad = bytearray(seed)
            for _ in range(r.choice((1, 2, 8))):
                bad[r.randrange(8, len(bad))] = r.choice((0, 10, 32, 45, 57, 255, r.randrange(256)))
            (folder / "f.nrrd").write_bytes(bad[:r.choice((len(bad), r.randrange(8, len(bad))))])
            result = tool("svo-voxelize", folder / "f.nrrd", "-o", folder / "y.svo", "-f", "--depth", 21, "--memory", "256M", timeout=60)
            check(result.code in (0, 1, 2, 3, 5, 6), result)
            if result.code == 0:
                check(run("svo-dump", "--validate", folder / "y.svo").code == 0)


support.main(globals())
