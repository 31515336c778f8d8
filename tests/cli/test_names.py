"""Names of files, and names inside files, reach the terminal as text: nothing in them is obeyed, and a message stays one line."""

import json
import os

import support
from support import check, run, tool

HOSTILE = [b"esc\x1b]0;title\x07\x1b[31m", b"new\nline", b"tab\tstop", b"\xff\xfe", "c1\u009b31m".encode(), b"del\x7f", "turned\u202egpj\u2066\u200f\u061c".encode(), "line\u2028paragraph\u2029".encode()]
TURNING = {0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A)}  # ends of lines and marks of direction


def plain(r, name):
    """All that was printed is lines of UTF-8 without control characters, those of stderr with the tool's name before them."""
    for text in (r.out.decode(), r.err):
        bad = [c for c in text if c != "\n" and (ord(c) < 32 or 127 <= ord(c) < 160 or ord(c) in TURNING)]
        check(bad == [], (name, bad, r))
    check("\ufffd" not in r.err, (name, r))  # support.tool puts it where bytes are not UTF-8
    for line in r.err.split("\n"):
        check(line == "" or line.startswith(name + ": "), (name, line))
    return r


def test_names_of_files(folder):
    cube = support.cube_obj(folder / "c.obj")
    for hostile in HOSTILE:
        at = os.fsencode(folder) + b"/" + hostile
        with open(at + b".obj", "wb") as f:
            f.write(cube.read_bytes() + b"usemtl absent\nf 1 2 3\n")
        path = os.fsdecode(at)
        check(plain(tool("svo-voxelize", path + ".obj", "-o", path + ".svo", "-d", 3), "svo-voxelize").code == 0)
        check(plain(tool("svo-compress", path + ".svo", "-o", path + ".svdag"), "svo-compress").code == 0)
        check(plain(tool("svo-compress", path + ".svo", "-o", path + ".svdag"), "svo-compress").code == 2)
        check(plain(tool("svo-dump", path + ".svdag", path + ".svo"), "svo-dump").code == 0)
        check(plain(tool("svo-dump", "--table", path + ".svdag"), "svo-dump").code == 0)
        check(plain(tool("svo-dump", "--validate", path + ".svdag"), "svo-dump").code == 0)
        check(plain(tool("svo-dump", "--validate", path + ".obj", path + ".obj"), "svo-dump").code == 3)
        check(plain(tool("svo-dump", path + ".absent", path + ".absent"), "svo-dump").code == 2)
        check(plain(tool("svo-compare", path + ".svo", path + ".svdag"), "svo-compare").code == 0)
        check(plain(tool("svo-render", path + ".svdag", "-o", path + ".png", "--size", "8x8"), "svo-render").code == 0)
        # JSON has the name as it is, but what it cannot say
        if hostile != b"\xff\xfe":
            text = run("svo-dump", path + ".svo").text
            check("\\x" in text.split("\n")[0], text)
            check(json.loads(run("svo-dump", "--json", path + ".svo").text)["file"] == path + ".svo")


def test_names_inside_models(folder):
    name = "a\x1b]0;title\x07\nb\u009b"
    (folder / "h.obj").write_text("mtllib \x1b[31m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl \x1b[5mred\nf 1 2 3\n")
    r = plain(tool("svo-voxelize", folder / "h.obj", "-o", folder / "h.svo", "-d", 2), "svo-voxelize")
    check(r.code == 0 and "\\x1b[5mred" in r.err, r)
    triangle = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"
    model = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": name}],
             "meshes": [{"name": name, "primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
             "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}], "textures": [{"source": 0}], "images": [{"uri": name + ".png"}],
             "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
             "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," + triangle}]}
    (folder / "h.gltf").write_text(json.dumps(model))
    check(plain(tool("svo-pack", folder / "h.gltf", "-o", folder / "h.svscene", "-d", 2), "svo-pack").code == 0)
    shown = plain(tool("svo-dump", folder / "h.svscene"), "svo-dump")
    check(shown.code == 0 and "\\x1b]0;title" in shown.text, shown)
    (folder / "needs.gltf").write_text(json.dumps({**model, "extensionsRequired": [name]}))
    check(plain(tool("svo-voxelize", folder / "needs.gltf", "-o", folder / "n.svo", "-d", 2), "svo-voxelize").code == 5)


support.main(globals())
