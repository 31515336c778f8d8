"""Manual pages and completions: made from the option table, so every option of --help is in them, and both are well-formed."""

import os
import re
import shutil
import subprocess
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import support
from support import check, run, tool


def names():
    return sorted(p.stem.replace("_", "-") for p in (support.source / "tools").glob("svo_*.c") if support.have(p.stem.replace("_", "-")))


def options(name):
    """Long names, and choices by long name, as --help shows them."""
    text = run(name, "--help").text
    return re.findall(r"^  (?:-\w, |    )--([A-Za-z0-9-]+)", text, re.M), text


def test_manual_pages(folder):
    check(len(names()) >= 8)
    for name in names():
        page = run(name, "--help=man").text
        plain = page.replace("\\-", "-")
        check(page.startswith(".TH " + name.upper() + " 1 "), page[:60])
        for section in ("NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXIT STATUS", "SEE ALSO"):
            check("\n.SH %s\n" % section in page, "%s has no %s" % (name, section))
        for option in options(name)[0]:
            check("\\fB--%s\\fR" % option in plain, "%s: --%s is not on its manual page" % (name, option))
        check(not re.search(r"(?<!\\)-", re.sub(r"^\.\\?.*$", "", page, flags=re.M)), "%s: a hyphen that is typeset as a dash" % name)
        check(not any(re.match(r"[.'](?!TH|SH|SS|TP|PP|B|nf|fi)", line) for line in page.split("\n")), "%s: text taken as a request" % name)
        if shutil.which("groff"):
            r = subprocess.run(["groff", "-man", "-Tutf8", "-ww"], input=page.encode(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=60)
            check(r.returncode == 0 and r.stderr == b"", "%s: %s" % (name, r.stderr.decode()[:400]))


def complete(script, name, *words):
    """What bash offers for the last word."""
    code = '. "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _%s; printf "%%s\\n" "${COMPREPLY[@]}"' % name.replace("-", "_")
    r = subprocess.run(["bash", "-c", code, "bash", str(script), name] + list(words), stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=60, cwd=script.parent)
    check(r.returncode == 0 and r.stderr == b"", r.stderr)
    return set(r.stdout.decode().split())


def test_completion(folder):
    if shutil.which("bash") is None:
        support.skip("no bash")
    for name in names():
        script = folder / name
        script.write_bytes(run(name, "--help=bash").out)
        known, text = options(name)
        check(complete(script, name, "--") == {"--" + o for o in known}, "%s: the options differ from those of --help" % name)
        check("--help" in complete(script, name, "--he"))
    script = folder / "svo-voxelize"
    check(complete(script, "svo-voxelize", "--fill", "") == {"surface", "solid"})
    check(complete(script, "svo-voxelize", "--fill", "=", "so") == {"solid"}) # as bash splits --fill=so
    check(complete(script, "svo-voxelize", "--depth", "") == set())
    (folder / "mesh one.obj").write_text("")
    check(" ".join(sorted(complete(script, "svo-voxelize", "me"))) in ("mesh one.obj", "mesh one.obj".replace(" ", " ")) or "mesh" in complete(script, "svo-voxelize", "me"))


def test_unknown_forms(folder):
    check(tool("svo-dump", "--help=html").code == 1)


support.main(globals())
