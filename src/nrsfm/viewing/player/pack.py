"""A reconstruction as data for the player: few numbers, and what they leave out.

Positions are low-rank, x_f = b + Σ_k w_fk T_k (:mod:`nrsfm.export.lowrank`), with as many T_k as an error of
``TOLERANCE`` of the object's root mean square radius needs and the budget allows. b goes out as 16-bit numbers over the
box of all points, each T_k as 16- or 8-bit numbers over its own range: 8 where rounding them adds little, which is the
case for all but the leading ones. What colours the points in every frame is cut to ``LEVELS`` steps, of which an eye
tells no more apart. Points are put into an order in which neighbours in space follow each other (Morton's), which makes
the differences small that :mod:`nrsfm.viewing.player.codec` stores.

The whole error, rounding included, is measured on what the script will compute, and said on the page.

Sources: Eckart and Young, Psychometrika 1, 1936; Morton, "A computer oriented geodetic data base", IBM 1966; the rest
ours.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from nrsfm.errors import InputError
from nrsfm.export.lowrank import blendshapes
from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.player.codec import Writer
from nrsfm.viewing.style import ESTIMATE, group_colours
from nrsfm.viewing.viewer.colours import STEPS, UNKNOWN, Scale, colour_maps
from nrsfm.viewing.viewer.geometry import cameras, depth_range, extent, spacing, upright

TOLERANCE = 5e-4
"""Root mean square error of a point, of the object's root mean square radius: a fifth of a pixel on a screen."""
LEVELS = 32
MOST_POINTS = 65_535  # so many can be numbered with 16 bits; more are thinned out
_BYTES = 12_000_000  # of the T_k, before deflating
_ENTRIES = 6_000_000  # of what colours points in every frame; more frames than this allows are left out


@dataclasses.dataclass(frozen=True, eq=False)
class Packed:
    """Data of one player.

    Attributes
    ----------
    about
        What the script reads first, as plain values.
    data
        The arrays, deflated.
    points
        (N,) numbers of the points shown, in the order of the data.
    modes
        K, the number of shapes that are mixed.
    rms, largest
        Root mean square and largest distance of a point shown from where the reconstruction has it, in its unit.
    size
        Root mean square radius of the object, in the same unit.
    """

    about: dict[str, Any]
    data: bytes
    points: np.ndarray
    modes: int
    rms: float
    largest: float
    size: float


def pack(
    result: Reconstruction,
    *,
    faces: np.ndarray | None = None,
    edges: np.ndarray | None = None,
    scales: Mapping[str, Scale] | None = None,
    colours: np.ndarray | None = None,
    fps: float = 30.0,
    unit: str = "",
    tolerance: float = TOLERANCE,
    most_points: int = MOST_POINTS,
) -> Packed:
    """Pack P points in F frames.

    Parameters
    ----------
    faces, edges
        (T, 3) triangles and (E, 2) lines of points, or ``None``.
    scales
        Numbers per frame and *reconstructed* point to colour by: ``"error"``, ``"confidence"``, ``"deviation"``.
    colours
        (P, 3) uint8, or ``None``.
    fps, unit
        Frames a second, and the unit of the shapes in words.
    tolerance
        Root mean square error allowed, relative to the object's root mean square radius.
    most_points
        More points are thinned out evenly; then there is no surface.
    """
    kept = np.flatnonzero(result.reconstructed)
    centre, half, middle, radius = extent(result, kept)
    order = _morton(np.asarray(result.shapes[result.n_frames // 2], dtype=np.float64)[kept])
    thin = len(kept) > most_points
    if thin:
        order = order[np.unique(np.linspace(0, len(order) - 1, most_points).astype(np.int64))]
        faces = edges = None
    points, count = kept[order], len(order)
    size = _size(result, points)

    def coordinates(part: slice) -> np.ndarray:
        """The numbers (F, n), in units of ``half`` about the centre, of some of the 3N coordinates, point by point."""
        which = points[part.start // 3 : part.stop // 3]
        block = (np.asarray(result.shapes[:, which], dtype=np.float64) - centre) / half
        return block.reshape(len(block), -1)

    most = max(1, min(result.n_frames - 1, int(_BYTES / (1.3 * 3 * count))))
    blend = blendshapes(coordinates, result.n_frames, 3 * count, tolerance=tolerance * size / half)
    if len(blend.targets) > most:
        blend = blendshapes(coordinates, result.n_frames, 3 * count, tolerance=0.0, targets=most)
    writer = Writer()
    modes = _write_shapes(writer, blend.base, blend.targets, blend.weights, tolerance * size / half)
    rms, largest = _error(result, points, modes, centre, half)
    writer.add("rotations", result.rotations.reshape(len(result.rotations), 9).astype(np.float32))

    number = np.full(result.n_points, -1, dtype=np.int64)
    number[points] = np.arange(count)
    joined = {name: _joined(part, number, width) for name, part, width in (("faces", faces, 3), ("edges", edges, 2))}
    for name, part in joined.items():
        if part is not None:
            writer.add(name, part.T.astype(np.uint16 if count <= 65_536 else np.uint32), "columns")
    stand = cameras(result, kept, centre, half, middle, radius, None)
    writer.add("places", np.array(stand.pop("places"), dtype=np.float32).reshape(-1, 3))
    legends, every = _write_colours(writer, result, points, order, scales or {}, colours)
    about: dict[str, Any] = {
        "frames": result.n_frames,
        "points": count,
        "fps": float(fps),
        "unit": unit,
        "half": half,
        "middle": [float(v) for v in middle / half],
        "radius": radius,
        "spacing": spacing(result, points),
        "upright": [round(float(v), 6) for v in upright(result.rotations).ravel()],
        "depth": [float(v) for v in depth_range(result, points, centre)],
        "modes": len(modes.factors),
        "reach": modes.reach,
        "factors": modes.factors.tolist(),
        "every": every,
        "triangles": 0 if joined["faces"] is None else len(joined["faces"]),
        "lines": 0 if joined["edges"] is None else len(joined["edges"]),
        "levels": LEVELS,
        "rows": [entry["name"] for entry in legends if entry["kind"] == "scale"],
        "cameras": stand,
        "plain": ESTIMATE,
        "maps": {name: colour_maps()[name] for name in ("depth", "error", "trust")},
        "colours": legends,
        "parts": writer.parts,
    }
    return Packed(about, writer.finish(), points, len(modes.factors), rms, largest, size)


@dataclasses.dataclass(frozen=True, eq=False)
class _Modes:
    """What the script will compute with: x_f = reach (base · 2/65535 − 1) + Σ_k w_fk factors_k T_k, over ``half``."""

    base: np.ndarray
    reach: float
    targets: list[np.ndarray]
    factors: np.ndarray
    weights: np.ndarray


def _write_shapes(
    writer: Writer, base: np.ndarray, targets: np.ndarray, weights: np.ndarray, tolerance: float
) -> _Modes:
    """Round base (3N,) and targets (K, 3N), coordinates planar (3, N), and add them."""
    flat = base.reshape(-1, 3).T
    reach = max(1.0, float(np.abs(flat).max()))  # the base is no frame of the sequence, and may reach out of its box
    rounded = np.rint((flat / reach + 1.0) * 32767.5).astype(np.uint16)
    writer.add("base", rounded, "columns")
    factors, small = np.zeros(len(targets)), []
    for k, target in enumerate(targets):
        top = float(np.abs(target).max()) or 1.0
        # Rounding to steps of q costs q/√12 in each coordinate, times the weight.
        cost = top / 127 / np.sqrt(12.0) * np.sqrt(3.0 * float(np.mean(weights[:, k].astype(np.float64) ** 2)))
        steps, dtype = (127, np.int8) if cost < 0.3 * tolerance / np.sqrt(len(targets)) else (32767, np.int16)
        factors[k] = top / steps
        small.append(np.rint(target.reshape(-1, 3).T / factors[k]).astype(dtype))
        writer.add(f"mode {k}", small[k], "columns")
    writer.add("weights", weights.astype(np.float32))
    return _Modes(rounded, reach, small, factors, weights)


def _error(
    result: Reconstruction, points: np.ndarray, modes: _Modes, centre: np.ndarray, half: float
) -> tuple[float, float]:
    """Root mean square and largest distance of what is shown from the reconstruction, in its unit."""
    base = np.float32(modes.reach) * (modes.base.astype(np.float32) / np.float32(32767.5) - 1)
    total = largest = 0.0
    for f, shape in enumerate(result.shapes):
        shown = base.copy()
        for k, target in enumerate(modes.targets):
            shown += np.float32(modes.weights[f, k] * modes.factors[k]) * target
        gaps = shown.T.astype(np.float64) * half + centre - shape[points]
        squares = np.sum(gaps * gaps, axis=1)
        total += float(squares.sum())
        largest = max(largest, float(squares.max()))
    return float(np.sqrt(total / (result.n_frames * len(points)))), float(np.sqrt(largest))


def _write_colours(
    writer: Writer,
    result: Reconstruction,
    points: np.ndarray,
    order: np.ndarray,
    scales: Mapping[str, Scale],
    colours: np.ndarray | None,
) -> tuple[list[dict[str, Any]], int]:
    """Add what colours the points; return the ways to colour, and of how many frames one has numbers."""
    legends: list[dict[str, Any]] = [{"name": "plain", "label": "One colour", "kind": "plain"}]
    if colours is not None:
        given = np.asarray(colours)
        if given.shape != (result.n_points, 3) or given.dtype != np.uint8:
            raise InputError(
                f"colours: uint8 numbers of shape ({result.n_points}, 3) are needed, received {given.dtype} "
                f"{given.shape}"
            )
        writer.add("texture", given[points].T, "columns")
        legends.append({"name": "texture", "label": "Texture", "kind": "fixed"})
    legends.append({"name": "depth", "label": "Depth", "kind": "depth", "map": "depth", "has_unit": True})
    if result.groups is not None:
        labels, palette = group_colours(result.groups[points], result.shapes[result.n_frames // 2][points])
        index = np.searchsorted(labels, result.groups[points])
        writer.add("groups", np.rint(255 * palette[index]).astype(np.uint8).T, "columns")
        legends.append({"name": "groups", "label": "Groups", "kind": "fixed"})
    every = max(1, -(-result.n_frames * len(points) // _ENTRIES))
    for name, label, ramp, has_unit in (
        ("confidence", "Confidence", "trust", False),
        ("deviation", "Depth deviation", "error", True),
        ("error", "Error", "error", True),
    ):
        scale = scales.get(name)
        if scale is None:
            continue
        steps = scale.steps[::every][:, order]
        levels = np.minimum(steps.astype(np.uint16) * LEVELS // (STEPS + 1), LEVELS - 1).astype(np.uint8)
        levels[steps == UNKNOWN] = LEVELS
        writer.add(name, levels, "rows")
        legends.append(
            {"name": name, "label": label, "kind": "scale", "map": ramp, "has_unit": has_unit, "low": scale.low,
             "high": scale.high, "unknown": scale.unknown}
        )  # fmt: skip
    return legends, every


def _joined(part: np.ndarray | None, number: np.ndarray, width: int) -> np.ndarray | None:
    """Faces or edges in the numbers of the data, sorted; those of points that are not shown are left out."""
    if part is None:
        return None
    array = np.asarray(part)
    if array.ndim != 2 or array.shape[1] != width:
        raise InputError(f"faces or edges: shape (n, {width}) is needed, received {array.shape}")
    found = number[array]
    found = found[(found >= 0).all(axis=1)]
    if not len(found):
        return None
    # The smallest number first, without turning a triangle around; then in the order of the points.
    first = np.argmin(found, axis=1)
    found = np.take_along_axis(found, (first[:, None] + np.arange(width)) % width, axis=1)
    return np.asarray(found[np.lexsort(found.T[::-1])])


def _size(result: Reconstruction, points: np.ndarray) -> float:
    """Root mean square distance of the points from their centre, over all frames."""
    total = 0.0
    for shape in result.shapes:
        some = np.asarray(shape[points], dtype=np.float64)
        total += float(np.sum((some - some.mean(axis=0)) ** 2))
    return float(np.sqrt(total / (result.n_frames * len(points)))) or 1.0


def _morton(points: np.ndarray) -> np.ndarray:
    """Order (N,) of points (N, 3) along Morton's curve, on a grid of 1024³."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = ((points - low) / (float((high - low).max()) or 1.0) * 1023).astype(np.uint32)
    code = np.zeros(len(points), dtype=np.uint32)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint32(bit)) & np.uint32(1)) << np.uint32(3 * bit + axis)
    return np.argsort(code, kind="stable")
