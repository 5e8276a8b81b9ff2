import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from nrsfm.errors import FileError, InputError
from nrsfm.files import load_rotations
from nrsfm.files.cameras import rotations_from_array


def rotation_stack(count, seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((count, 3, 3)))
    return q * np.linalg.det(q)[:, None, None]


LAYOUTS = {
    "F,3,3": lambda r: r,
    "F,2,3": lambda r: r[:, :2],
    "2F,3": lambda r: r[:, :2].reshape(-1, 3),
    "F,9": lambda r: r.reshape(-1, 9),
    "F,6": lambda r: r[:, :2].reshape(-1, 6),
    "block 3F,3F": lambda r: scipy.linalg.block_diag(*r),
    "block 2F,3F": lambda r: scipy.linalg.block_diag(*r[:, :2]),
}


@given(layout=st.sampled_from(sorted(LAYOUTS)), frames=st.integers(2, 12), seed=st.integers(0, 99))
def test_every_layout_gives_the_same_rotations(layout, frames, seed):
    rotations = rotation_stack(frames, seed)
    result = rotations_from_array(LAYOUTS[layout](rotations))
    np.testing.assert_allclose(result, rotations, atol=1e-12)


@pytest.mark.parametrize("frames", [2, 4, 5, 9])
def test_matlab_has_the_frames_last(frames):
    rotations = rotation_stack(frames)
    for rows in (2, 3):
        stacked = rotations[:, :rows].transpose(1, 2, 0)
        np.testing.assert_allclose(rotations_from_array(stacked), rotations, atol=1e-12)


@pytest.mark.parametrize("extension", ["csv", "txt", "npy", "json"])
def test_nameless_files_of_cameras(tmp_path, extension):
    rotations, path = rotation_stack(4), tmp_path / f"cameras.{extension}"
    if extension == "npy":
        np.save(path, rotations)
    elif extension == "json":
        path.write_text(str(rotations.tolist()))
    else:
        np.savetxt(path, rotations.reshape(4, 9), delimiter=",")
    np.testing.assert_allclose(load_rotations(path), rotations, atol=1e-12)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (np.zeros((4, 3, 3)), "orthonormal, received frame 0 that is off by 1"),
        (np.tile(np.diag([1.0, 1, -1]), (4, 1, 1)), "determinant must be 1, received -1 in frame 0"),
        (np.zeros((4, 4, 4)), r"received \(4, 4, 4\)"),
        (np.zeros((0, 3, 3)), r"received \(0, 3, 3\)"),
        (np.full((4, 3, 3), np.nan), "finite"),
        (np.zeros((4, 3, 3), complex), "dtype complex128"),
        (np.zeros(3), r"received \(3,\)"),
    ],
)
def test_what_is_not_rotations_is_refused(tmp_path, bad, words):
    with pytest.raises(InputError, match=words):
        rotations_from_array(bad)
    np.savez(tmp_path / "a.npz", rotations=bad)
    with pytest.raises(FileError, match=f"a.npz.*{words}"):
        load_rotations(tmp_path / "a.npz")
