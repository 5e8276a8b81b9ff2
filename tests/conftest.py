"""What every test shares: few threads, a fixed order of generated examples, and the folder of real data."""

import os
from pathlib import Path

# Before NumPy is imported, or its libraries start a thread per core.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
    os.environ.setdefault(_name, "2")

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402

# "ci" runs the same examples each time; HYPOTHESIS_PROFILE=explore looks for new ones.
settings.register_profile("ci", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("explore", deadline=None, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder of real sequences; what needs it is skipped, with this reason, where there is none."""
    given = os.environ.get("NRSFM_DATA")
    folder = Path(given) if given else Path(__file__).resolve().parents[1] / ".." / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"REAL DATA ABSENT: no folder '{folder}' (set NRSFM_DATA to test on real sequences)")
    return folder.resolve()


def strict(array):
    return pytest.importorskip("array_api_strict").asarray(array)


def strict_elsewhere(array):
    """On a device that refuses to mix with others, as a graphics card does."""
    library = pytest.importorskip("array_api_strict")
    return library.asarray(array, device=library.Device("device1"))


def torch(array):
    return pytest.importorskip("torch").asarray(np.array(array))


def torch_cuda(array):
    library = pytest.importorskip("torch")
    if not library.cuda.is_available():
        pytest.skip("no graphics card")
    return library.asarray(np.array(array), device="cuda")


def cupy(array):
    library = pytest.importorskip("cupy")
    try:
        return library.asarray(array)
    except library.cuda.runtime.CUDARuntimeError:
        pytest.skip("no graphics card")


@pytest.fixture(params=[strict, strict_elsewhere, torch, torch_cuda, cupy])
def library(request):
    """The function that makes an array of a library out of one of NumPy."""
    return request.param
