"""What every test shares: few threads, a fixed order of generated examples, and the folder of real data."""

import os
from pathlib import Path

# Before NumPy is imported, or its libraries start a thread per core.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
    os.environ.setdefault(_name, "2")

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
