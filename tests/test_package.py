import subprocess
import sys

import pytest

import nrsfm

HEAVY = ("numpy", "scipy", "sklearn", "h5py", "matplotlib", "rich", "cvxpy", "importlib.metadata")


def modules_after(code):
    """Names of the modules that a fresh interpreter has loaded after running ``code``."""
    shown = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\nprint(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(shown.stdout.split())


def test_import_loads_nothing_heavy():
    assert not modules_after("import nrsfm").intersection(HEAVY)


@pytest.mark.parametrize("name", ["Tracks", "Reconstruction", "load_tracks", "reconstruct", "shape_error"])
def test_public_name_loads_only_numpy_of_the_heavy_ones(name):
    allowed = {"numpy", "importlib.metadata"}
    assert not modules_after(f"import nrsfm; nrsfm.{name}").intersection(set(HEAVY) - allowed)


def test_public_names_are_those_of_the_contract_and_nothing_else():
    assert dir(nrsfm) == sorted(nrsfm.__all__)
    assert set(nrsfm.__all__) == {
        "Reconstruction",
        "Tracks",
        "__version__",
        "datasets",
        "errors",
        "load_reconstruction",
        "load_tracks",
        "method_names",
        "reconstruct",
        "shape_error",
    }


@pytest.mark.parametrize("name", nrsfm.__all__)
def test_every_public_name_is_there(name):
    assert getattr(nrsfm, name) is getattr(nrsfm, name)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'tracksx'"):
        _ = nrsfm.tracksx


def test_version_is_that_of_the_installed_package():
    from importlib.metadata import version

    assert nrsfm.__version__ == version("nrsfm")


def test_star_import_brings_the_public_names():
    space = {}
    exec("from nrsfm import *", space)
    assert set(nrsfm.__all__) - {"__version__"} <= set(space)
