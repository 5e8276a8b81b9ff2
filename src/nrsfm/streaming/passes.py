"""The passes over the points of tracks of any size: W W-transposed, the cells, the way back.

Each pass cuts the points into shards, works on every shard on its own, and joins what comes out: a sum of Gram
matrices, labels side by side, or shapes written to their place. A shard walks through its points in blocks. What a
shard returns does not grow with its points, but for labels and a sample; so shards may be anywhere.

1. :func:`gram_of_shard`: sums, Gram matrix and a sample of the tracks.
2. :func:`cells_of_shard`: label of each point, sums and the Gram matrix of each cell.
3. :func:`expand_shard`: shapes, and the deviation of depth, from the virtual points.

Tracks in memory, whose sample can be had first, go without the first: their Gram matrix is the sum of the cells'.

Within a pass a point is a row, x and y of a frame side by side: points are then sorted by moving whole rows, and a
block is turned by moving whole pairs of coordinates.
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
_TURNED = 512  # points whose shapes are turned at once: they stay in cache

Shard = tuple[int, int]
"""First point, and the one after the last."""


@dataclass(frozen=True)
class Frame:
    """How tracks are centred and scaled: ``translations`` (F, 2) and ``unit``.

    float64 is centred in float64. In float32, whose rounding is that of float32 tracks, digits are lost only where
    tracks are much farther from zero than from each other, and then the difference is taken in float64 first.
    """

    translations: np.ndarray
    unit: float

    def working_type(self, dtype: np.dtype) -> np.dtype:
        """In which tracks of a type are summed up: float32 tracks stay float32."""
        return np.dtype(np.float32 if dtype == np.float32 and self._near else np.float64)

    @property
    def _near(self) -> bool:
        return float(np.abs(self.translations).max()) <= _NEAR * self.unit

    def rounded(self, dtype: np.dtype) -> Frame:
        """Its translations as numbers of a type: what is centred in that type is then centred exactly about them."""
        return Frame(self.translations.astype(dtype).astype(np.float64), self.unit)

    def rows(self, block: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Centred tracks of a block (F, n, 2), one row a point, into the first n rows of ``out`` (m, 2F); no unit."""
        kind = np.result_type(out.dtype, np.complex64)
        pairs = _pairs(block).T
        near = out.dtype == np.float32 and block.dtype == out.dtype and self._near
        offset = np.ascontiguousarray(self.translations, dtype=np.float64).view(np.complex128)[:, 0]
        rows = out[: block.shape[1]]
        np.subtract(pairs, offset.astype(kind) if near else offset, out=rows.view(kind), casting="same_kind")
        return rows


def picked(points: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Some of the points (F, P, 2) in memory, (F, n, 2): pairs of coordinates are moved as one."""
    if points.dtype not in (np.float32, np.float64) or points.strides[2] != points.itemsize:
        return points[:, which]
    return np.take(_pairs(points), which, axis=1).view(points.dtype).reshape(len(points), -1, 2)


def _pairs(block: np.ndarray) -> np.ndarray:
    """Coordinates (F, n, 2) as (F, n) complex numbers: what is moved together."""
    if block.dtype not in (np.float32, np.float64) or block.strides[2] != block.itemsize:
        block = np.ascontiguousarray(block, dtype=np.result_type(block.dtype, np.float32))
    return block.view(np.result_type(block.dtype, np.complex64))[:, :, 0]


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
    frame = Frame(offset, 1.0)
    room = np.empty((min(plan.part, shard[1] - shard[0]), 2 * frames))
    sample = []
    for start, stop in plan.blocks(*shard):
        block = reader.read(start, stop)
        inside = wanted[np.searchsorted(wanted, start) : np.searchsorted(wanted, stop)]
        if len(inside):
            sample.append(np.array(block[:, inside - start]))
        for first in range(0, stop - start, plan.part):
            rows = frame.rows(block[:, first : first + plan.part], room)
            total += rows.sum(axis=0)
            gram += rows.T @ rows
        _tell(told, stop - start)
    whole = np.concatenate(sample, axis=1) if sample else np.empty((frames, 0, 2), dtype=reader.dtype)
    return GramOfShard(total, gram, whole)


@dataclass(frozen=True)
class CellsOfShard:
    """``labels`` (n,) of the shard's points; ``sizes`` (K,), ``totals`` (K, 2F), ``grams`` (K, 2F, 2F) of its cells.

    Sums are about the frame's translations, in the tracks' unit.
    """

    labels: np.ndarray
    sizes: np.ndarray
    totals: np.ndarray
    grams: np.ndarray


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
    count, cells = 2 * reader.shape[0], len(centres)
    labels = np.empty(shard[1] - shard[0], dtype=label_type(cells))
    grams, totals = np.zeros((cells, count, count)), np.zeros((cells, count))
    gram = np.empty((count, count))
    room = np.empty((2, min(plan.part, len(labels)), count), dtype=frame.working_type(reader.dtype))
    nearest = _Nearest(directions / frame.unit, centres)
    for start, stop in plan.blocks(*shard):
        block = reader.read(start, stop)
        for first in range(0, stop - start, plan.part):
            rows = frame.rows(block[:, first : first + plan.part], room[0])
            own = nearest(rows)
            place = start - shard[0] + first
            labels[place : place + len(own)] = own
            order, edges = order_of(labels[place : place + len(own)], cells)
            ordered = np.take(rows, order, axis=0, out=room[1, : len(own)], mode="clip")
            for k in np.flatnonzero(np.diff(edges)):
                part = ordered[edges[k] : edges[k + 1]].astype(np.float64)
                np.matmul(part.T, part, out=gram)
                grams[k] += gram
                totals[k] += np.ones(len(part)) @ part  # four times as fast as sum()
        _tell(told, stop - start)
    return CellsOfShard(labels, np.bincount(labels, minlength=cells), totals, grams)


class _Nearest:
    """The nearest of the centres (K, q) to rows (n, 2F) along directions (2F, q).

    In the precision of the sample, from which the centres were learnt.
    """

    def __init__(self, directions: np.ndarray, centres: np.ndarray) -> None:
        self._directions = directions
        centres = centres.astype(np.float32)
        sizes = np.einsum("ij,ij->i", centres, centres)
        self._scores = np.concatenate([-2.0 * centres, sizes[:, None]], axis=1).T

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        coordinates = np.ones((len(rows), len(self._scores)), dtype=np.float32)
        coordinates[:, :-1] = rows @ self._directions.astype(rows.dtype)
        return np.asarray(np.argmin(coordinates @ self._scores, axis=1))


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
    maps, backs = short(expansion, frame.unit, dtype)
    size = min(plan.part, shard[1] - shard[0])
    room = np.empty((2, size, 2 * frames), dtype=dtype)
    made = np.empty((size, 3 * frames), dtype=dtype)
    for start, stop in plan.blocks(*shard):
        block = reader.read(start, stop)
        for first in range(0, stop - start, plan.part):
            some = block[:, first : first + plan.part]
            rows = frame.rows(some, room[0])
            place = start + first
            order, edges = order_of(labels[place : place + len(rows)], len(maps))
            rows = np.take(rows, order, axis=0, out=room[1, : len(rows)], mode="clip")
            for k in np.flatnonzero(np.diff(edges)):
                part = slice(edges[k], edges[k + 1])
                back = backs[k]
                np.matmul(rows[part] if back is None else rows[part] @ back, maps[k], out=made[part])
            shapes = writers["shapes"].room(place, len(rows))
            _to_frames(made, order, shapes)
            writers["shapes"].write(place, shapes)
            if deviations is not None:
                writers["depth_deviation"].write(place, _deviation(deviations, rows, frame.unit, order, edges))
        _tell(told, stop - start)


def _deviation(model: Deviations, rows: np.ndarray, unit: float, order: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Deviations (F, n) of points whose tracks ``rows`` (n, 2F) are sorted by cell and not yet divided by the unit."""
    forms = np.zeros((2, len(order)))
    for i, fields in enumerate((model.first, model.deform)):
        if fields is None:
            continue
        for k in np.flatnonzero(np.diff(edges)):
            part = slice(edges[k], edges[k + 1])
            forms[i, part] = np.sum((rows[part] @ (fields[k].T / unit).astype(rows.dtype)) ** 2, axis=1)
    own = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    found, _ = model.of(forms[0], forms[1], own)
    out = np.empty_like(found)
    out[:, order] = found
    return out


def _to_frames(made: np.ndarray, order: np.ndarray, out: np.ndarray) -> None:
    """Shapes (m, 3F), a row a point, sorted by cell, to ``out`` (F, n, 3) in the order of the points."""
    count = len(order)
    back = np.empty_like(order)
    back[order] = np.arange(count)
    coordinates = np.dtype((np.void, 3 * made.itemsize))  # the three of a point and frame are moved as one
    turned, rows = out.view(coordinates)[:, :, 0], made.view(coordinates)
    for start in range(0, count, _TURNED):
        part = slice(start, start + _TURNED)
        turned[:, part] = rows[back[part]].T


def short(expansion: Expansion, unit: float, dtype: np.dtype) -> tuple[list[np.ndarray], list[np.ndarray | None]]:
    """For each cell the maps (r, 3F) and (2F, r) of rows, or their product where that is the fewer operations.

    In the precision of the result; the rows are still to be divided by the unit.
    """
    maps: list[np.ndarray] = []
    backs: list[np.ndarray | None] = []
    for left, back in zip(expansion.maps, expansion.backs, strict=True):
        rank, rows = back.shape
        back = back / unit
        joined = rank * (rows + len(left)) > rows * len(left)
        maps.append(np.ascontiguousarray((left @ back if joined else left).T, dtype=dtype))
        backs.append(None if joined else np.ascontiguousarray(back.T, dtype=dtype))
    return maps, backs


def label_type(cells: int) -> np.dtype:
    """The smallest type that numbers so many cells."""
    return np.dtype(np.uint8 if cells <= 256 else np.int32)


def order_of(labels: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Points sorted by cell, and where each cell begins."""
    order = np.argsort(labels, kind="stable")
    edges = np.concatenate([[0], np.cumsum(np.bincount(labels, minlength=cells))])
    return order, edges


def _tell(told: Callable[[int], None] | None, points: int) -> None:
    if told is not None:
        told(points)
