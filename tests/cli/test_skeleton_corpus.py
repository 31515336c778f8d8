"""Everything in the folders of damaged models and of broken files gives a skeleton, or an error that says what is wrong; what fat and large models need."""

import os
import tarfile

import skeleton_corpus
import support
from support import check, run


def sweep(folder, name):
    models = skeleton_corpus.models(support.model(name))
    check(models, "no models in " + name)
    return {path.name: skeleton_corpus.try_model(path, folder) for path in models}


def test_damaged(folder):
    found = sweep(folder, "B_damaged")
    check(all(code == 0 for code, _ in found.values()), found) # none is rejected


def test_broken_files(folder):
    sweep(folder, "E_formats/invalid")


def test_memory_of_a_large_mesh(folder):
    """Less than 600 bytes a vertex of the tessellated mesh, everything counted, for any number of threads."""
    model = support.model("A_organic/armadillo/armadillo.obj")
    for threads in (1, 2):
        run("svo-skeleton", model, "-o", folder / "a.skel", "-f", "--omega", 0.004, "--max-iterations", 5, "--threads", threads, "--report", folder / "r.json")
        report = support.report(folder / "r.json")
        vertices = report["input"]["vertices_tessellated"]
        check(vertices > 200000, vertices)
        if not support.SANITIZED:
            check(report["peak_rss_bytes"] < 600 * vertices, (threads, report["peak_rss_bytes"] / vertices))


def test_fat_shapes_converge(folder):
    """Fat shapes of CGAL's demo data: the mushroom needs more than 6000 sweeps, and those beyond are made, as few vertices are left."""
    data = "/usr/share/doc/libcgal-demo/data.tar.gz"
    if not os.path.exists(data):
        support.skip("no CGAL demo data (Debian's libcgal-demo)")
    for model, least in (("handle", 0), ("mushroom", 6000)):
        with tarfile.open(data) as archive:
            (folder / "fat.off").write_bytes(archive.extractfile("data/meshes/" + model + ".off").read())
        r = run("svo-skeleton", folder / "fat.off", "-o", folder / "f.skel", "-f", "--report", folder / "r.json")
        out = support.report(folder / "r.json")["output"]
        check(out["converged"] is True and least < out["iterations"] <= 20000 and "did not converge" not in r.err, (model, out))


support.main(globals())
