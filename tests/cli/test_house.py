"""The tree's own rules: who may include whom, where C++ and third parties live, no file I/O in libsvo, pages that name every option, links that lead somewhere."""

import pathlib
import re
import sys

import support
from support import check, tool

ROOT = pathlib.Path(sys.argv[2]).resolve()
ROOMS = {"libsvo": 0, "libskel": 1, "formats": 2, "tools": 3}
STANDARD = {"assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits", "locale", "math", "setjmp", "signal", "stdalign", "stdarg", "stdatomic",
            "stdbool", "stddef", "stdint", "stdio", "stdlib", "stdnoreturn", "string", "tgmath", "threads", "time", "uchar", "wchar", "wctype"}
THREADS = {"pthread", "sched", "unistd"}  # what libsvo may use of POSIX: threads, and the number of processors
CPU = {"immintrin", "x86intrin", "cpuid"}


def sources(room, kinds=("*.c", "*.h")):
    return sorted(p for kind in kinds for p in (ROOT / room).glob(kind))


def includes(path):
    for line in path.read_text().split("\n"):
        if m := re.match(r'\s*#\s*include\s*([<"])([^>"]+)[>"]', line):
            yield m.group(1) == '"', m.group(2)


def test_rooms_know_only_what_is_below(folder):
    checked = 0
    own = {p.name: room for room in ROOMS for p in (ROOT / room).rglob("*") if p.suffix in (".h", ".hpp", ".inc")}
    for room, height in ROOMS.items():
        for path in sources(room) + sources(room + "/adapters", ("*.cpp", "*.hpp", "*.h")):
            for quoted, name in includes(path):
                if not quoted:
                    continue
                target = own.get(pathlib.PurePath(name).name)
                check(target is not None, "%s includes %s, which is nowhere" % (path, name))
                check(ROOMS[target] <= height, "%s includes %s of %s, above it" % (path.relative_to(ROOT), name, target))
                checked += 1
    check(checked > 300, checked)


def test_internal_headers_stay_in_their_room(folder):
    for room in ROOMS:
        for path in sources(room):
            for quoted, name in includes(path):
                inner = re.match(r"(svoi|skeli|fmti)_", name)
                if quoted and inner:
                    check({"svoi": "libsvo", "skeli": "libskel", "fmti": "formats"}[inner.group(1)] == room, "%s includes %s" % (path.relative_to(ROOT), name))


def test_cpp_lives_in_adapters(folder):
    for room in ROOMS:
        for path in (ROOT / room).rglob("*"):
            if path.suffix in (".cpp", ".cc", ".cxx", ".hpp"):
                check(path.parent.name == "adapters", path.relative_to(ROOT))


def test_libsvo_is_c_and_threads_alone(folder):
    banned = re.compile(r"\b(fopen|fread|fwrite|open|openat|mmap|unlink|rename|remove|tmpfile|mkstemp|printf|fprintf|puts|fputs|system|popen|exit|abort)\s*\(")
    for path in sources("libsvo"):
        for quoted, name in includes(path):
            stem = name[:-2]
            check(quoted or stem in STANDARD | THREADS | CPU or name.startswith("sys/"), "%s includes <%s>" % (path.name, name))
        code = re.sub(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"', " ", path.read_text(), flags=re.S)
        found = [m.group(1) for m in banned.finditer(code)]
        if path.name == "svo_base.c":  # where assertions end
            found = [f for f in found if f not in ("fprintf", "abort")]
        check(not found, "%s calls %s" % (path.name, found))


def test_sources_can_be_read_in_one_sitting(folder):
    for room in list(ROOMS) + ["tests"]:
        for path in (ROOT / room).rglob("*"):
            if path.suffix in (".c", ".h", ".cpp", ".hpp", ".py") and path.is_file():
                lines = path.read_text().count("\n")
                check(lines <= (900 if room == "tests" else 700), "%s has %d lines" % (path.relative_to(ROOT), lines))


def test_every_public_header_says_what_it_is_for(folder):
    for room in ("libsvo", "libskel", "formats"):
        for path in sources(room, ("*.h",)):
            check(path.read_text().startswith("/*"), "%s begins without a comment" % path.name)


def test_pages_name_every_option(folder):
    names = sorted(p.stem.replace("_", "-") for p in (ROOT / "tools").glob("svo_*.c"))
    check(len(names) >= 8, names)
    common = (ROOT / "docs/tools/common.md").read_text()
    for name in names:
        page = ROOT / "docs/tools" / (name + ".md")
        check(page.exists(), "no page for %s" % name)
        text = page.read_text() + common
        r = tool(name, "--help")
        check(r.code == 0, r)
        for option in sorted(set(re.findall(r"(?<![\w-])--?[a-zA-Z][a-zA-Z-]*", r.out.decode()))):
            if option.startswith("--"):
                check(option in text, "%s: %s is not on its page" % (name, option))


def test_links_lead_somewhere(folder):
    count = 0
    for page in [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
            if re.match(r"[a-z]+:", target):
                continue
            check((page.parent / target).exists(), "%s links to %s" % (page.relative_to(ROOT), target))
            count += 1
    check(count > 30, count)


def test_rules_of_formats_are_numbered_once_and_tested(folder):
    """Each rule has one row; what the code names is in the text."""
    rules = {}
    for page in sorted((ROOT / "docs/format").glob("*.md")):
        for rule in re.findall(r"^\| ([A-Z]{3}-\d\d[a-z]?) \|", page.read_text(), flags=re.M):
            check(rule not in rules, "%s is in %s and %s" % (rule, rules.get(rule), page.name))
            rules[rule] = page.name
    check(len(rules) > 35, rules)
    named = set()
    for room in ("libsvo", "libskel", "formats"):
        for path in sources(room):
            for rule in re.findall(r"\b(?:CON|SVO|DAG|SCN|SKL)-\d\d\b", path.read_text()):
                check(rule in rules, "%s names %s, which no page has" % (path.name, rule))
                named.add(rule)
    check(len(named) > 25, sorted(set(rules) - named))


def test_no_absolute_paths(folder):
    for room in [*ROOMS, "docs"]:
        for path in (ROOT / room).rglob("*"):
            if path.is_file() and path.suffix in (".c", ".h", ".cpp", ".hpp", ".py", ".md", ".sh", ".txt", ".cmake"):
                found = re.search(r"(?<![\w.])/(?:home|root|work|Users)/\w+", path.read_text(errors="replace"))
                check(found is None, "%s: %s" % (path.relative_to(ROOT), found and found.group(0)))


support.main(globals())
