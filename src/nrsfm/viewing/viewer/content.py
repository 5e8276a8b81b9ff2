"""What the page is given: one description, and for each frame the points and the numbers that colour them.

The points of frame f go out as 16-bit whole numbers q with

    X = c + h q / 32767,   c the middle of all frames' points, h half the longest side of their box,

so that a coordinate is off by at most h / 65534: for an object of 1000 pixels, 0.01 pixel. Points that were not
reconstructed are left out, and the page says how many. A frame's answer is N × 4 numbers (the fourth is 0: graphics
cards want steps of 4 bytes), then a row of N steps for each scale, padded to 4 bytes.

Source: ours.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.style import ESTIMATE, group_colours
from nrsfm.viewing.viewer.colours import (
    UNKNOWN,
    Scale,
    colour_maps,
    confidence_scale,
    deviation_scale,
    error_scale,
)
from nrsfm.viewing.viewer.geometry import cameras, depth_range, extent, spacing, upright
from nrsfm.viewing.viewer.notes import notes_of
from nrsfm.viewing.viewer.pictures import Pictures, sample_colours

LARGEST = 32767
TRACKS = 240  # points whose tracks are drawn over the input: more would hide it
_TEXTURE_FRAMES = 7
_BELIEVED = 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Content:
    """Everything that one page shows.

    Attributes
    ----------
    about
        What the page reads first, as plain values.
    """

    about: dict[str, Any]
    _result: Reconstruction
    _kept: np.ndarray
    _centre: np.ndarray
    _half: float
    _scales: dict[str, Scale]
    _fixed: dict[str, np.ndarray]
    _faces: np.ndarray | None
    _edges: np.ndarray | None
    _tracks: np.ndarray | None
    pictures: Pictures | None

    @property
    def n_frames(self) -> int:
        """F."""
        return self._result.n_frames

    def frame_bytes(self, frame: int) -> bytes:
        """Points and steps of one frame."""
        count = len(self._kept)
        points = np.zeros((count, 4), dtype="<i2")
        shape = np.asarray(self._result.shapes[frame], dtype=np.float64)[self._kept]
        points[:, :3] = np.rint((shape - self._centre) * (LARGEST / self._half))
        padding = bytes(-count % 4)
        rows = (scale.steps[frame].tobytes() + padding for scale in self._scales.values())
        return points.tobytes() + b"".join(rows)

    def colours_bytes(self, name: str) -> bytes | None:
        """Fixed colours (N, 4) uint8, or ``None`` where there are none of that name."""
        colours = self._fixed.get(name)
        return None if colours is None else np.pad(colours, ((0, 0), (0, 1)), constant_values=255).tobytes()

    def faces_bytes(self) -> bytes | None:
        """Triangles (T, 3) uint32."""
        return None if self._faces is None else self._faces.astype("<u4").tobytes()

    def edges_bytes(self) -> bytes | None:
        """Lines (E, 2) uint32."""
        return None if self._edges is None else self._edges.astype("<u4").tobytes()

    def tracks_bytes(self) -> bytes | None:
        """(F, n, 3) float32: x, y in pixels, NaN where not seen, and 1 for a measurement that was not believed."""
        return None if self._tracks is None else self._tracks.astype("<f4").tobytes()


def make_content(
    result: Reconstruction,
    *,
    title: str = "",
    fps: float = 30.0,
    tracks: Any = None,
    truth: Any = None,
    valid: Any = None,
    pictures: Pictures | None = None,
    faces: Any = None,
    edges: Any = None,
    colours: Any = None,
    surface: str = "",
    unit: str = "",
    warnings: tuple[str, ...] = (),
) -> Content:
    """Work out what is shown of a reconstruction of P points in F frames.

    Parameters
    ----------
    title, fps, unit, surface
        Name, frames a second, unit of the shapes, and in words where the faces come from.
    tracks
        ``Tracks`` that it was made from, or ``None``: then the reconstruction's own projections are drawn.
    truth, valid
        True shapes (F, P, 3) and which of them count (F, P), or ``None``.
    pictures
        The input's frames.
    faces, edges
        (T, 3) triangles and (E, 2) lines of points, or ``None``.
    colours
        (P, 3) of the points, uint8 or floats from 0 to 1; without, they are taken from the pictures.
    warnings
        What else the user should know.

    Raises
    ------
    InputError
        Sizes that do not fit together.
    """
    kept = np.flatnonzero(result.reconstructed)
    centre, half, middle, radius = extent(result, kept)
    if tracks is not None and (tracks.n_frames, tracks.n_points) != (result.n_frames, result.n_points):
        raise InputError(
            f"tracks: {result.n_frames} frames of {result.n_points} points are needed, as the reconstruction has, "
            f"received {tracks.n_frames} frames of {tracks.n_points}"
        )
    scales = {
        "error": None if truth is None else error_scale(result, truth, valid, kept),
        "confidence": confidence_scale(result, kept),
        "deviation": deviation_scale(result, kept),
    }
    there = {name: scale for name, scale in scales.items() if scale is not None}
    fixed, texture = fixed_colours(result, kept, tracks, pictures, colours)
    drawn, measured = _drawn_tracks(result, kept, tracks)
    about = {
        "title": title,
        "frames": result.n_frames,
        "points": len(kept),
        "of": result.n_points,
        "fps": float(fps),
        "method": result.method,
        "unit": unit,
        "half": half,
        "middle": (middle / half).tolist(),
        "radius": radius,
        "spacing": spacing(result, kept),
        "upright": upright(result.rotations).ravel().tolist(),
        "rotations": np.round(result.rotations, 7).ravel().tolist(),
        "cameras": cameras(result, kept, centre, half, middle, radius, pictures),
        "depth": depth_range(result, kept, centre),
        "surface": surface,
        "triangles": 0 if faces is None else len(faces),
        "lines": 0 if edges is None else len(edges),
        "plain": ESTIMATE,
        "unknown": UNKNOWN,
        "maps": colour_maps(),
        "colours": _legends(result, there, fixed, texture, truth is not None, pictures is not None),
        "rows": list(there),
        "errors": _plain_list(scales["error"].per_frame if scales["error"] is not None else None),
        "pictures": None if pictures is None else {"width": pictures.width, "height": pictures.height},
        "tracks": {"count": drawn.shape[1], "measured": measured, "box": _box(drawn)},
        "notes": notes_of(result, surface, warnings),
    }
    number = np.full(result.n_points, -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    joined = [None if part is None else number[np.asarray(part)] for part in (faces, edges)]
    joined = [None if part is None else part[(part >= 0).all(axis=1)] for part in joined]
    return Content(about, result, kept, centre, half, there, fixed, joined[0], joined[1], drawn, pictures)


def fixed_colours(
    result: Reconstruction, kept: np.ndarray, tracks: Any, pictures: Pictures | None, colours: Any
) -> tuple[dict[str, np.ndarray], str]:
    """Colours (N, 3) uint8 by name, and in words where those of the texture come from."""
    fixed: dict[str, np.ndarray] = {}
    words = ""
    if colours is not None:
        from nrsfm.export.colours import point_colours

        given = point_colours(np.asarray(colours), result, 0, None)
        if given is not None:
            fixed["texture"], words = given[kept], "colours that came with the points"
    elif pictures is not None:
        frames = np.unique(np.linspace(0, result.n_frames - 1, _TEXTURE_FRAMES).astype(int))
        seen = np.stack([_projected(result, int(f))[kept] for f in frames])
        trusted = _trusted(result, tracks, frames)
        fixed["texture"] = sample_colours(pictures, seen, None if trusted is None else trusted[:, kept], frames)
        words = f"the median of the input in {len(frames)} frames"
    if result.groups is not None:
        labels, palette = group_colours(result.groups[kept], result.shapes[result.n_frames // 2][kept])
        index = np.searchsorted(labels, result.groups[kept])
        fixed["groups"] = np.rint(255 * palette[index]).astype(np.uint8)
    return fixed, words


def _trusted(result: Reconstruction, tracks: Any, frames: np.ndarray) -> np.ndarray | None:
    trusted = None
    if tracks is not None and tracks.visible is not None:
        trusted = np.asarray(tracks.visible)[frames]
    if result.confidence is not None:
        sure = result.confidence[frames] >= _BELIEVED
        trusted = sure if trusted is None else trusted & sure
    return trusted


def _projected(result: Reconstruction, frame: int) -> np.ndarray:
    """(P, 2) where the camera of a frame sees the points."""
    shape = np.asarray(result.shapes[frame], dtype=np.float64)
    return np.asarray(result.scales[frame] * (shape @ result.rotations[frame, :2].T) + result.translations[frame])


def _drawn_tracks(result: Reconstruction, kept: np.ndarray, tracks: Any) -> tuple[np.ndarray, bool]:
    """(F, n, 3) of some points spread over the object, and whether they were measured, or are only projected."""
    from nrsfm.viewing.tracks import spread_points

    middle = result.n_frames // 2
    shown = kept[spread_points(_projected(result, middle)[kept], TRACKS)]
    out = np.zeros((result.n_frames, len(shown), 3), dtype=np.float32)
    for f in range(result.n_frames):
        if tracks is None:
            out[f, :, :2] = _projected(result, f)[shown]
            continue
        out[f, :, :2] = np.asarray(tracks.points[f])[shown]
        if tracks.visible is not None:
            out[f, ~np.asarray(tracks.visible[f])[shown], :2] = np.nan
        if result.confidence is not None:
            out[f, :, 2] = result.confidence[f, shown] < _BELIEVED
    return out, tracks is not None


def _box(drawn: np.ndarray) -> list[float]:
    """Left, top, width and height that hold nearly all of the tracks, with room around."""
    known = drawn[..., :2][np.isfinite(drawn[..., 0]) & (drawn[..., 2] == 0)]
    if not len(known):
        return [0.0, 0.0, 1.0, 1.0]
    low, high = np.percentile(known, [0.5, 99.5], axis=0)
    room = 0.08 * float(max((high - low).max(), 1e-6))
    return [float(v) for v in (*(low - room), *(high - low + 2 * room))]


def _legends(
    result: Reconstruction,
    scales: dict[str, Scale],
    fixed: dict[str, np.ndarray],
    texture: str,
    truth: bool,
    seen: bool,
) -> list[dict[str, Any]]:
    """All ways to colour, in the order of the page; those that are not there say what they would need."""

    def fixed_one(name: str, label: str, note: str, why: str) -> dict[str, Any]:
        return {"name": name, "label": label, "kind": "fixed", "note": note, "missing": "" if name in fixed else why}

    def scale_one(name: str, label: str, colours: str, why: str, unit: bool = True) -> dict[str, Any]:
        found = scales.get(name)
        entry: dict[str, Any] = {"name": name, "label": label, "kind": "scale", "map": colours, "has_unit": unit}
        if found is None:
            return {**entry, "missing": why}
        return {
            **entry,
            "missing": "",
            "low": found.low,
            "high": found.high,
            "note": found.summary,
            "unknown": found.unknown,
        }

    groups = "" if result.groups is None else f"{len(np.unique(result.groups))} groups of points that move alike"
    return [
        {"name": "plain", "label": "One colour", "kind": "plain", "note": "", "missing": ""},
        fixed_one("texture", "Texture", texture, "needs --images, or colours in the file of tracks"),
        {"name": "depth", "label": "Depth", "kind": "depth", "map": "depth", "has_unit": True, "missing": "",
         "note": "along the camera's axis, from the object's middle"},
        fixed_one("groups", "Groups", groups, "this method has no groups"),
        scale_one("confidence", "Confidence", "trust", "all measurements were used fully", unit=False),
        scale_one("deviation", "Depth deviation", "error", "not known for this method"),
        scale_one("error", "Error", "error", "needs --truth"),
    ]  # fmt: skip


def _plain_list(values: np.ndarray | None) -> list[float | None] | None:
    return None if values is None else [float(v) if np.isfinite(v) else None for v in values]
