"""`cmake --install` into a folder, and projects outside that use what is there: through find_package, through pkg-config,
and the public headers one by one. The C and C++ compilers come from CC and CXX."""

import os
import pathlib
import re
import subprocess
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "cli"))
import support
from support import check

build = support.tools.parent
consumer = support.source / "tests/install/consumer"
cc, cxx = os.environ.get("CC", "cc"), os.environ.get("CXX", "c++")


def do(*command, env=None):
    p = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=300, env=env)
    check(p.returncode == 0, "%s\n%s" % (" ".join(map(str, command)), p.stdout.decode("utf-8", "replace")))
    return p.stdout.decode()


def install(folder):
    do("cmake", "--install", build, "--prefix", folder / "first")
    (folder / "first").rename(folder / "usr")  # an installation can be moved
    return folder / "usr"


def ball(folder):
    """A solid ball in 2^5 cubed; the ray along x enters it at the first voxel."""
    support.run("svo-voxelize", support.sphere_obj(folder / "s.obj"), "-o", folder / "s.svo", "--depth", 5)
    support.run("svo-compress", folder / "s.svo", "-o", folder / "s.svdag")
    return folder / "s.svdag"


def test_find_package(folder):
    prefix, asset = install(folder), ball(folder)
    for parts, program, args, answer in (("svo", "rays", [], "2"), ("all", "shoot", [asset], None)):
        do("cmake", "-S", consumer, "-B", folder / parts, "-G", "Ninja", "-DCMAKE_PREFIX_PATH=%s" % prefix, "-DCONSUMER_PARTS=%s" % parts,
           "-DCMAKE_C_COMPILER=%s" % cc, "-DCMAKE_CXX_COMPILER=%s" % cxx)
        do("cmake", "--build", folder / parts)
        out = do(folder / parts / program, *args).strip()
        check(out == answer if answer else 0 <= float(out) <= 2, "%s: %s" % (program, out))


def test_pkg_config(folder):
    prefix, asset = install(folder), ball(folder)
    pc = [p.parent for p in prefix.rglob("svo.pc")]
    env = dict(os.environ, PKG_CONFIG_PATH=str(pc[0]))
    for package, program, args, answer in (("svo", "rays", [], "2"), ("svoformats", "shoot", [asset], None)):
        flags = do("pkg-config", "--cflags", "--libs", package, env=env).split()
        do(cc, "-std=c17", consumer / (program + ".c"), "-o", folder / program, *flags)
        out = do(folder / program, *args).strip()
        check(out == answer if answer else 0 <= float(out) <= 2, "%s: %s" % (program, out))


def test_public_headers_stand_alone(folder):
    """Each compiles by itself as C17 and as C++17, and includes only the standard library and its neighbours."""
    headers = sorted((install(folder) / "include/svokit").iterdir())
    check(len(headers) > 20, headers)
    for h in headers:
        check(re.match(r"(svo|skel|fmt)_[a-z0-9_]+\.h$", h.name), "%s is not a public header" % h.name)
        for name in re.findall(r'#\s*include\s*[<"]([^>"]+)', h.read_text()):
            known = (h.parent / name).exists() or name in ("stdint.h", "stddef.h", "stdbool.h", "stdarg.h", "stdio.h", "string.h", "math.h")
            check(known, "%s includes %s" % (h.name, name))
        check('extern "C"' in h.read_text() or "static inline" in h.read_text(), "%s has no extern \"C\"" % h.name)
        twice = '#include "%s"\n#include "%s"\nint main(void) { return 0; }\n' % (h, h)
        for name, command in (("t.c", [cc, "-std=c17"]), ("t.cpp", [cxx, "-std=c++17"])):
            (folder / name).write_text(twice)
            do(*command, "-pedantic", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-fsyntax-only", folder / name)


def test_tools_run_from_there(folder):
    bin_folder = install(folder) / "bin"
    names = sorted(p.name for p in bin_folder.iterdir())
    check(names == sorted(p.stem.replace("_", "-") for p in (support.source / "tools").glob("svo_*.c")), names)
    for name in names:
        check(name in do(bin_folder / name, "--version"), name)


support.main(globals())
