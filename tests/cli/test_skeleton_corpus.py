"""Everything in the folders of damaged models and of broken files gives a skeleton, or an error that says what is wrong."""

import skeleton_corpus
import support
from support import check


def sweep(folder, name):
    models = skeleton_corpus.models(support.model(name))
    check(models, "no models in " + name)
    return {path.name: skeleton_corpus.try_model(path, folder) for path in models}


def test_damaged(folder):
    found = sweep(folder, "B_damaged")
    check(all(code == 0 for code, _ in found.values()), found) # none is rejected


def test_broken_files(folder):
    sweep(folder, "E_formats/invalid")


support.main(globals())
