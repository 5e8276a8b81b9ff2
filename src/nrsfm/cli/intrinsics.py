"""The option ``intrinsics``: the matrix K of a pinhole camera, typed as four numbers or read from a file."""

from __future__ import annotations

import argparse

import numpy as np

METAVAR = "FX,FY,CX,CY or FILE"
_NAMES = ("intrinsics", "K")  # of the array, where a file holds several


def read_intrinsics(text: str) -> np.ndarray | None:
    """Return K (3, 3) = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] of ``"fx,fy,cx,cy"`` in pixels, or of a file.

    A file holds K, or the four numbers, alone or under the name ``intrinsics`` or ``K``. ``"auto"`` gives ``None``.

    Raises
    ------
    argparse.ArgumentTypeError
        It is neither, in one line: argparse would replace the text of any other error.
    """
    if text == "auto":
        return None
    numbers = _numbers(text)
    if numbers is not None:
        return _matrix(np.array(numbers), repr(text))
    from nrsfm.errors import FileError
    from nrsfm.files.container import listing, open_arrays

    try:
        entries = open_arrays(text)
        named = [name for name in _NAMES if name in entries]
        if not named and len(entries) != 1:
            raise FileError(
                f"'{text}' must hold an array 'K' or 'intrinsics', or one array only; it holds {listing(entries)}"
            )
        array = entries[named[0] if named else next(iter(entries))].read()
    except FileError as error:
        also = " (or type fx,fy,cx,cy: four numbers)" if "," in text else ""
        raise argparse.ArgumentTypeError(f"{error}{also}") from None
    return _matrix(array, f"'{text}' with {array.dtype} {array.shape}")


def _numbers(text: str) -> list[float] | None:
    """The numbers between the commas, or ``None`` where some word is no number: then it is the name of a file."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        return None


def _matrix(array: np.ndarray, received: str) -> np.ndarray:
    if array.dtype.kind in "fiu" and np.isfinite(array).all():
        if array.shape in ((4,), (1, 4), (4, 1)):
            fx, fy, cx, cy = array.ravel()
            array = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        if array.shape == (3, 3) and array[0, 0] > 0 and array[1, 1] > 0 and not np.any(array[2] != (0, 0, 1)):
            return array.astype(np.float64)
    raise argparse.ArgumentTypeError(
        "finite fx,fy,cx,cy with positive fx and fy, or a matrix 3x3 of them with the last row 0 0 1, are needed, "
        f"received {received}"
    )
