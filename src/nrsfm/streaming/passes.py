"""The passes over the points of tracks of any size: W W-transposed, the cells, the way back.

Each pass cuts the points into shards, works on every shard on its own, and joins what comes out: a sum of Gram
matrices, labels side by side, or shapes written to their place. A shard walks through its points in blocks. What a
shard returns does not grow with its points, but for labels and a sample; so shards may be anywhere.

1. :func:`gram_of_shard`: sums, Gram matrix and a sample of the tracks.
2. :func:`cells_of_shard`: label of each point, and the Gram matrix of each cell.
3. :func:`expand_shard`: shapes, and the deviation of depth, from the virtual points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nrsfm.streaming.plan import Plan
from nrsfm.streaming.readers import Reader
from nrsfm.streaming.targets import Writer

_NEAR = 30.0  # spreads that tracks may be away from zero to be centred in float32

Shard = tuple[int, int]
"""First point, and the one after the last."""


@dataclass(frozen=True)
class GramOfShard:
    """``total`` (2F,) and ``gram`` (2F, 2F) about an offset; ``sample`` (F, n, 2) of the points asked for."""

    total: np.ndarray
    gram: np.ndarray
    sample: np.ndarray


def gram_of_shard(
    reader: Reader,
    plan: Plan,
    offset: np.ndarray,
    wanted: np.ndarray,
    told: Callable[[int], None] | None,
    shard: Shard,
) -> GramOfShard:
    """First pass: tracks about ``offset`` (F, 2); ``wanted`` are sorted indices of the points of the sample."""
    frames = reader.shape[0]
    total, gram = np.zeros(2 * frames), np.zeros((2 * frames, 2 * frames))
    sample = []
    for start, stop in plan.blocks(*shard):
        block = reader.read(start, stop)
        inside = wanted[np.searchsorted(wanted, start) : np.searchsorted(wanted, stop)]
        if len(inside):
            sample.append(np.array(block[:, inside - start]))
        for first in range(0, stop - start, plan.part):
            rows = _rows(block[:, first : first + plan.part], offset, 1.0, np.dtype(np.float64))
            total += rows.sum(axis=1)
            gram += rows @ rows.T
        _tell(told, stop - start)
    whole = np.concatenate(sample, axis=1) if sample else np.empty((frames, 0, 2), dtype=reader.dtype)
    return GramOfShard(total, gram, whole)


@dataclass(frozen=True)
class CellsOfShard:
    """``labels`` (n,) of the shard's points, ``sizes`` (K,) and ``grams`` (K, 2F, 2F) of its part of the cells."""

    labels: np.ndarray
    sizes: np.ndarray
    grams: np.ndarray


@dataclass(frozen=True)
class Frame:
    """How tracks are centred and scaled: ``translations`` (F, 2) and ``unit``."""

    translations: np.ndarray
    unit: float

    def rows(self, block: np.ndarray, dtype: np.dtype) -> np.ndarray:
        """Columns of the normalised W (2F, n) of a block (F, n, 2)."""
        return _rows(block, self.translations, self.unit, dtype)


def cells_of_shard(
    reader: Reader,
    plan: Plan,
    frame: Frame,
    directions: np.ndarray,
    centres: np.ndarray,
    told: Callable[[int], None] | None,
    shard: Shard,
) -> CellsOfShard:
    """Second pass: each point to its nearest centre (K, q) in the coordinates along ``directions`` (2F, q)."""
    rows_count, cells = 2 * reader.shape[0], len(centres)
    labels = np.empty(shard[1] - shard[0], dtype=label_type(cells))
    grams = np.zeros((cells, rows_count, rows_count))
    sizes = np.einsum("ij,ij->i", centres, centres)
    for start, stop in plan.blocks(*shard):
        block = reader.read(start, stop)
        for first in range(0, stop - start, plan.part):
            rows = frame.rows(block[:, first : first + plan.part], np.dtype(np.float64))
            # In the precision of the sample, from which the centres were learnt.
            coordinates = (directions.T @ rows).astype(np.float32)
            own = np.argmin(sizes - 2.0 * (coordinates.T @ centres.T), axis=1)
            place = start - shard[0] + first
            labels[place : place + len(own)] = own
            for k, part in _by_cell(rows, own, cells):
                grams[k] += part @ part.T
        _tell(told, stop - start)
    return CellsOfShard(labels, np.bincount(labels, minlength=cells), grams)


@dataclass(frozen=True)
class Expansion:
    """The way back, cell by cell: shapes (3F, n) = ``maps[k]`` (3F, r) @ ``backs[k]`` (r, 2F) @ tracks (2F, n)."""

    maps: tuple[np.ndarray, ...]
    backs: tuple[np.ndarray, ...]


class Deviations(Protocol):
    """What :class:`nrsfm.uncertainty.DeviationModel` is."""

    @property
    def first(self) -> tuple[np.ndarray, ...]:
        """Fields of each cell whose squares sum to the first form."""
        ...

    @property
    def deform(self) -> tuple[np.ndarray, ...] | None:
        """The same of the second form, where it counts."""
        ...

    def of(self, first: np.ndarray, deform: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, float]:
        """Deviations (F, n) of points with these forms and labels."""
        ...


def expand_shard(
    reader: Reader,
    plan: Plan,
    frame: Frame,
    labels: np.ndarray,
    expansion: Expansion,
    deviations: Deviations | None,
    writers: Mapping[str, Writer],
    dtype: np.dtype,
    told: Callable[[int], None] | None,
    shard: Shard,
) -> None:
    """Third pass: the shapes of the shard's points, written to their place.

    In the precision of the result: a coordinate along a direction of singular value σ is off by rounding/σ, and counts
    for σ.
    """
    frames = reader.shape[0]
    maps, backs = _short(expansion, dtype)
    for start, stop in plan.blocks(*shard):
        block = reader.read(start, stop)
        for first in range(0, stop - start, plan.part):
            some = block[:, first : first + plan.part]
            rows = frame.rows(some, dtype)
            place = start + first
            own = labels[place : place + some.shape[1]]
            order, edges = _order(own, len(maps))
            rows = np.take(rows, order, axis=1)
            made = np.empty((3 * frames, some.shape[1]), dtype=dtype)
            for k in np.flatnonzero(np.diff(edges)):
                part = slice(edges[k], edges[k + 1])
                inner = rows[:, part] if backs[k] is None else backs[k] @ rows[:, part]
                np.matmul(maps[k], inner, out=made[:, part])
            writers["shapes"].write(place, _in_place(made, order))
            if deviations is not None:
                writers["depth_deviation"].write(place, _deviation(deviations, rows, order, edges))
        _tell(told, stop - start)


def _deviation(model: Deviations, rows: np.ndarray, order: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Deviations (F, n) of points whose tracks ``rows`` (2F, n) are sorted by cell."""
    forms = np.zeros((2, len(order)))
    for i, fields in enumerate((model.first, model.deform)):
        if fields is None:
            continue
        for k in np.flatnonzero(np.diff(edges)):
            part = slice(edges[k], edges[k + 1])
            forms[i, part] = np.sum((fields[k].astype(rows.dtype) @ rows[:, part]) ** 2, axis=0)
    own = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    found, _ = model.of(forms[0], forms[1], own)
    out = np.empty_like(found)
    out[:, order] = found
    return out


def _in_place(sorted_shapes: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Shapes (3F, n) sorted by cell as (F, n, 3) in the order of the points."""
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    made = np.take(sorted_shapes, back, axis=1).reshape(-1, 3, len(order))
    out = np.empty((len(made), len(order), 3), dtype=made.dtype)
    for axis in range(3):
        out[:, :, axis] = made[:, axis]
    return out


def _short(expansion: Expansion, dtype: np.dtype) -> tuple[list[np.ndarray], list[np.ndarray | None]]:
    """For each cell the product of both maps where that is the fewer operations, and the precision of the result."""
    maps: list[np.ndarray] = []
    backs: list[np.ndarray | None] = []
    for left, back in zip(expansion.maps, expansion.backs, strict=True):
        rank, rows = back.shape
        joined = rank * (rows + len(left)) > rows * len(left)
        maps.append((left @ back if joined else left).astype(dtype))
        backs.append(None if joined else back.astype(dtype))
    return maps, backs


def label_type(cells: int) -> np.dtype:
    """The smallest type that numbers so many cells."""
    return np.dtype(np.uint8 if cells <= 256 else np.int32)


def _rows(block: np.ndarray, offset: np.ndarray, unit: float, dtype: np.dtype) -> np.ndarray:
    """(F, n, 2) as a new array (2F, n), less an offset (F, 2), in a unit.

    float64 is subtracted in float64. In float32, whose rounding is that of float32 tracks, digits are lost only where
    tracks are much farther from zero than from each other, and then the difference is taken in float64 first.
    """
    frames, count, _ = block.shape
    rows = np.empty((2 * frames, count), dtype=dtype)
    turned = rows.reshape(frames, 2, count)
    near = dtype == np.float32 and block.dtype == dtype and float(np.abs(offset).max()) <= _NEAR * unit
    offset = offset.astype(dtype) if near else offset
    for axis in range(2):  # one coordinate at a time: three times as fast as both at once
        np.subtract(block[:, :, axis], offset[:, axis, None], out=turned[:, axis], casting="same_kind")
    if unit != 1.0:
        rows *= dtype.type(1.0 / unit)
    return rows


def _order(labels: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Points sorted by cell, and where each cell begins."""
    order = np.argsort(labels, kind="stable")
    edges = np.concatenate([[0], np.cumsum(np.bincount(labels, minlength=cells))])
    return order, edges


def _by_cell(rows: np.ndarray, labels: np.ndarray, cells: int) -> list[tuple[int, np.ndarray]]:
    """The columns of each cell that has some."""
    order, edges = _order(labels, cells)
    sorted_rows = np.take(rows, order, axis=1)
    return [(int(k), sorted_rows[:, edges[k] : edges[k + 1]]) for k in np.flatnonzero(np.diff(edges))]


def _tell(told: Callable[[int], None] | None, points: int) -> None:
    if told is not None:
        told(points)
