"""The sequences of the experiments: data sets, the benchmark's original files where a user has them, built-in ones."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from nrsfm.datasets import Sequence, load_benchmark_mat, synthetic
from nrsfm.datasets import load as load_data_set
from nrsfm.datasets import names as data_set_names
from nrsfm.datasets.sequence import project
from nrsfm.datasets.table import find
from nrsfm.errors import FileError, InputError, suggest
from nrsfm.experiments.base import Data
from nrsfm.tracks import Tracks

DATA_SETS = (
    *(f"face-seq{i}" for i in range(1, 5)),
    "ict-rom99",
    "ict-rom346",
    "pickup",
    "yoga",
    "stretch",
    "drink",
    "dance",
    "face1",
    "walking",
    "shark",
    "back_real126",
    "mat1500_persp",
    "flag250_persp",
    "hulk_persp",
    "mesh_horse_gallop",
)
"""The data sets that the experiments use, in the order of the tables."""

ORIGINALS: dict[str, tuple[str, ...]] = {
    **{f"original-face{i}": (f"face{i}", f"faceseq{i}", f"facesequence{i}", f"seq{i}", f"f{i}") for i in range(1, 5)},
    **{f"original-actor{i}": (f"actor{i}", f"actorseq{i}", f"actorsequence{i}") for i in (1, 2)},
    "original-paper": ("paper", "kinectpaper"),
    "original-tshirt": ("tshirt", "kinecttshirt"),
}
"""The eight of the paper's table, and the names that their files may have before the suffix ``.mat``: in small letters,
without what is neither letter nor digit. They lie in the folder ``originals`` of the data, or in that of the data."""

BUILT_IN: dict[str, dict[str, Any]] = {
    "built-in-face1": {"camera": "pan30", "frames": 10},
    "built-in-face2": {"camera": "pan90", "frames": 10},
    "built-in-face3": {"camera": "fast", "frames": 99},
    "built-in-face4": {"camera": "slow", "frames": 99},
    "built-in-sheet": {"camera": "slow", "frames": 99},
}
"""Generated sequences, with 28,880 points unless told otherwise (sheet: 10,000); nothing has to be downloaded."""

_WINDOWS = {"original-paper": "kinect-paper", "original-tshirt": "kinect-tshirt"}
_PLAIN = re.compile(r"[^a-z0-9]")


def sequence_names() -> list[str]:
    """Every name that ``Data.sequence`` may have."""
    return [*ORIGINALS, *DATA_SETS, *BUILT_IN]


def available(root: Path | None) -> tuple[str, ...]:
    """The sequences that can be had: those whose files are under ``root``, and built-in ones for missing faces.

    Without a folder: the built-in ones.
    """
    if root is None:
        return tuple(BUILT_IN)
    found = [name for name in (*ORIGINALS, *DATA_SETS) if files(name, root)]
    faces = [name for name in BUILT_IN if name[-1].isdigit()]
    found += [n for n in faces if f"face-seq{n[-1]}" not in found and f"original-face{n[-1]}" not in found]
    return tuple(found)


def files(name: str, root: Path | None) -> list[Path]:
    """The files of a sequence, or an empty list where they are not all there."""
    if root is None or name in BUILT_IN:
        return []
    if name in ORIGINALS:
        for folder in (root / "originals", root):
            listed = sorted(folder.glob("*.[mM][aA][tT]")) if folder.is_dir() else []
            named = {_PLAIN.sub("", path.stem.lower()): path for path in listed}
            for known in ORIGINALS[name]:
                if known in named:
                    return [named[known]]
        return []
    paths = [root / file for file in find(name).files] if name in data_set_names() else []
    return paths if all(path.is_file() for path in paths) else []


def load(data: Data, root: Path | None) -> Sequence:
    """The sequence, cut to what is asked for, seen through the asked path, with its noise.

    Raises ``InputError`` for an unknown name or settings that do not fit, ``FileError`` where a file is missing or
    damaged.
    """
    sequence = _clean(dataclasses.replace(data, noise=0.0, seed=0), root)
    return sequence.with_noise(data.noise, data.seed) if data.noise else sequence


@functools.lru_cache(maxsize=1)  # many cells differ in nothing but their noise
def _clean(data: Data, root: Path | None) -> Sequence:
    sequence = _cut(_whole(data, root), data)
    return sequence if data.camera_path is None else _through_path(sequence, data.camera_path)


def _whole(data: Data, root: Path | None) -> Sequence:
    name = data.sequence
    if name in BUILT_IN:
        sizes = {key: value for key in ("frames", "points") if (value := getattr(data, key)) is not None}
        make = synthetic.sheet_sequence if name == "built-in-sheet" else synthetic.face_sequence
        return dataclasses.replace(make(**{**BUILT_IN[name], **sizes}), name=name)
    found = files(name, root)
    if name in ORIGINALS:
        if not found:
            raise FileError(f"sequence '{name}': no file for it (names such as {ORIGINALS[name][0]}.mat) in '{root}'")
        return _original(name, found[0])
    if name not in data_set_names():
        known = sequence_names()
        raise InputError(f"'{name}' is not a sequence{suggest(name, known) or '; known: ' + ', '.join(known)}")
    return load_data_set(name, root)


def _original(name: str, path: Path) -> Sequence:
    sequence = load_benchmark_mat(path)
    window = _WINDOWS.get(name)
    if window is not None:
        try:
            sequence = load_benchmark_mat(path, window=window)
        except InputError:
            # No point inside: the file has been cut, and its coordinates moved, before.
            sequence.note["window"] = "none: the file holds no point inside the paper's"
    return dataclasses.replace(sequence, name=name)


def _cut(sequence: Sequence, data: Data) -> Sequence:
    """The first frames, and evenly spread points; triangles and lines go where points do."""
    tracks = sequence.tracks
    frames = slice(data.frames)
    if data.frames is not None and data.frames < 1:
        raise InputError(f"frames must be at least 1, received {data.frames}")
    chosen: np.ndarray | slice = slice(None)
    if data.points is not None and data.points < tracks.n_points:
        if data.points < 1:
            raise InputError(f"points must be at least 1, received {data.points}")
        place = sequence.shapes[0] if sequence.shapes is not None else tracks.points[0]
        chosen = spread_points(place, data.points)
    elif data.frames is None or data.frames >= tracks.n_frames:
        return sequence

    def cut(array: np.ndarray | None) -> np.ndarray | None:
        return None if array is None else array[frames][:, chosen]

    fewer = not isinstance(chosen, slice)
    points = tracks.points[frames][:, chosen]
    return dataclasses.replace(
        sequence,
        tracks=Tracks(points, cut(tracks.visible)),
        shapes=cut(sequence.shapes),
        rotations=None if sequence.rotations is None else sequence.rotations[frames],
        valid=cut(sequence.valid),
        faces=None if fewer else sequence.faces,
        edges=None if fewer else sequence.edges,
    )


def spread_points(place: np.ndarray, count: int) -> np.ndarray:
    """Numbers (count,), ascending, of points (P, d) that are far from each other: each the farthest from those before.

    The first is the farthest from the centre. Points without a place (NaN) come last.
    """
    place = np.nan_to_num(np.asarray(place, dtype=np.float64), nan=np.inf)
    known = np.isfinite(place).all(axis=1)
    centre = place[known].mean(axis=0) if known.any() else np.zeros(place.shape[1])
    place[~known] = centre
    distance = np.where(known, np.sum((place - centre) ** 2, axis=1), 0.0)
    chosen = [int(np.argmax(distance))]
    distance = np.full(len(place), np.inf)
    for _ in range(count - 1):
        gap = place - place[chosen[-1]]
        np.minimum(distance, np.einsum("ij,ij->i", gap, gap), out=distance)
        distance[chosen[-1]] = -1.0  # also where points coincide, none is taken twice
        chosen.append(int(np.argmax(distance)))
    return np.sort(np.array(chosen))


def _through_path(sequence: Sequence, path: str) -> Sequence:
    """The true shapes seen by other cameras, in the unit of the shapes."""
    from nrsfm.experiments.paths import camera_path

    if sequence.shapes is None or sequence.note.get("frame") == "camera":
        raise InputError(f"camera_path '{path}': the true shapes are needed, in one frame; '{sequence.name}' has none")
    rotations = camera_path(path, len(sequence.shapes))
    tracks = Tracks(project(sequence.shapes, rotations))
    note = {**sequence.note, "camera": f"orthographic; path {path}"}
    return Sequence(
        sequence.name, tracks, sequence.shapes, rotations, sequence.valid, sequence.faces, sequence.edges, note
    )


def size(data: Data, root: Path | None) -> tuple[int, int]:
    """About how many frames and points: only the order of the work depends on it."""
    if data.sequence in BUILT_IN:
        frames, points = BUILT_IN[data.sequence]["frames"], 10_000 if data.sequence == "built-in-sheet" else 28_880
        return data.frames or frames, data.points or points
    if data.sequence in data_set_names():
        info = find(data.sequence)
        frames, points = info.frames, info.points
    else:
        frames, points = 100, 30_000
    return min(frames, data.frames or frames), min(points, data.points or points)


def digest(name: str, root: Path | None) -> str:
    """Digest of the files of a sequence; of nothing for a built-in one, which the code makes."""
    found = hashlib.sha256()
    for path in files(name, root):
        found.update(_file_digest(str(path), path.stat().st_mtime_ns, path.stat().st_size))
    return found.hexdigest()[:16]


@functools.cache
def _file_digest(path: str, changed: int, length: int) -> bytes:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()


def has_cameras(name: str) -> bool:
    """Whether the true cameras of a sequence are known (of an original file: whether its owners give them)."""
    if name in ORIGINALS:
        return name not in _WINDOWS
    if name in data_set_names():
        info = find(name)
        return "rotations" in info.truth or "chosen by the loader" in info.camera
    return True
