"""Complete tracks of any size, read in blocks: what an affine reconstruction needs of the points, and the way back.

A file is read three times: for the Gram matrix, for the cells (one cell needs no second time), for the shapes. The
centres of the cells are learnt from a random sample that the first pass brings along; cells of a sample of 20,000 are
as good as those of all points (docs/decisions.md has the numbers). Of tracks in memory the sample is taken first, so
that the cells' Gram matrices come from the first pass, and that of all points is their sum.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nrsfm.clustering import kmeans_centres
from nrsfm.compression import (
    CompressedTracks,
    Measurements,
    compress_grams,
    in_range,
    out_of_range,
    spectrum,
    track_coordinates,
)
from nrsfm.errors import InputError
from nrsfm.numerics.finite import all_finite
from nrsfm.streaming.passes import (
    Deviations,
    Expansion,
    Frame,
    cells_of_shard,
    expand_shard,
    gram_of_shard,
    picked,
)
from nrsfm.streaming.plan import Plan, plan
from nrsfm.streaming.readers import ArrayReader, Reader, reader_of
from nrsfm.streaming.runners import Runner, Threads
from nrsfm.streaming.stored import StoredPoints
from nrsfm.streaming.targets import Target

SAMPLE = 50_000
"""Points that teach the centres of cells, the noise, and what is asked about outliers and perspective."""

_DIRECTIONS = 10  # leading directions of the sample in which its cells are found
_LEARNT = 20_000  # points of the sample that teach directions and centres
_EXPANDED = 8192  # points whose shapes are made at once: more leave the cache
_OFFSET = 4096  # points whose mean is the provisional offset
_SHARE = 8  # the sample takes at most this part of the memory for blocks


class Stream:
    """Tracks (F, P, 2) without missing entries, the memory for their blocks, and where the shapes go.

    Parameters
    ----------
    points
        Array, memory map or :class:`StoredPoints`.
    target
        Where shapes go.
    room
        Bytes for blocks, Gram matrices of cells and the sample; ``None`` for a default of half a gigabyte.
    runner
        Who works on the shards; the threads of this process by default.
    cells
        Cells of points that are wanted.
    reader
        That of the points; by default the one that suits them.
    """

    @property
    def at_hand(self) -> bool:
        """Whether points are in memory, so that some of them can be had without reading all."""
        return isinstance(self.reader, ArrayReader)

    def __init__(
        self,
        points: np.ndarray | StoredPoints,
        target: Target | None = None,
        room: int | None = None,
        runner: Runner | None = None,
        cells: int = 1,
        reader: Reader | None = None,
    ) -> None:
        self.points = points
        self.reader = reader_of(points) if reader is None else reader
        self.target = Target() if target is None else target
        self.room = room
        self.runner = Threads() if runner is None else runner
        self.cells = cells
        self.frames, self.count, _ = self.reader.shape
        self._seed = 0
        self._measured: Measurements | None = None
        self._joined: Cells | None = None  # of all points, where they came with the first pass

    def measure(
        self, seed: int, told: Callable[[float], None] | None = None, kept: Callable[..., Any] | None = None
    ) -> Measurements:
        """First pass: :func:`nrsfm.compression.measure` for what does not fit into memory.

        The points of the measurements are those of the sample; ``total`` is P. ``kept``: that of a checkpoint
        (:class:`nrsfm.checkpoints.Checkpoint`), for what is read from a file.

        Raises
        ------
        InputError
            A coordinate is not finite, or the points do not spread.
        """
        if self._measured is None or self._seed != seed:  # asked for twice, read once
            self._seed, self._joined = seed, None
            work = functools.partial(self._measure, seed, told)
            self._measured = work() if kept is None or self.at_hand else kept("reading tracks", work)
        return self._measured

    def _wanted(self, seed: int) -> np.ndarray:
        """Indices of the points of the sample, sorted."""
        size = min(self.count, SAMPLE)
        if self.room is not None:
            size = min(size, max(4096, self.room // (_SHARE * 2 * self.frames * self.reader.dtype.itemsize)))
        rng = np.random.default_rng([seed, 4])
        if size == self.count:
            return np.arange(self.count)
        return np.sort(rng.choice(self.count, size=size, replace=False))

    def _sample(self, wanted: np.ndarray) -> np.ndarray:
        """These points (F, n, 2) of tracks at hand."""
        points = self.reader.read(0, self.count)  # a view
        return points if len(wanted) == self.count else picked(points, wanted)

    def _measure(self, seed: int, told: Callable[[float], None] | None) -> Measurements:
        wanted = self._wanted(seed)
        if self.at_hand and self.cells > 1 and len(wanted) >= self.cells:
            return self._measure_with_cells(wanted, told)
        walk = self._plan(1)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused below
            offset = self.reader.read(0, min(self.count, _OFFSET)).astype(np.float64).mean(axis=1)
            work = functools.partial(gram_of_shard, self.reader, walk, offset, wanted)
            shards, tell = walk.shards(self.count), self._telling(told)
            samples, (total, gram) = self.runner.sums(work, shards, "sample", ("total", "gram"), tell)
        sample = np.concatenate(samples, axis=1)
        return self._measurements(sample, wanted, offset, total, gram)

    def _measure_with_cells(self, wanted: np.ndarray, told: Callable[[float], None] | None) -> Measurements:
        """The first pass and the second at once, about the mean and along the directions of a sample."""
        sample = self._sample(wanted)
        if not all_finite(sample):
            self._require_finite(self._plan(1))
        frame, directions, centres = self._learnt(sample)
        with np.errstate(over="ignore", invalid="ignore"):
            cells = self._assigned(frame, directions, centres, told)
            total, gram = cells.totals.sum(axis=0), cells.grams.sum(axis=0)
        measured = self._measurements(sample, wanted, frame.translations, total, gram)
        self._joined = cells.about(total / self.count, measured.unit)
        return measured

    def _learnt(self, sample: np.ndarray) -> tuple[Frame, np.ndarray, np.ndarray]:
        """What a sample (F, n, 2) says: frame, leading directions (2F, q), and the cells' centres (K, q) along them."""
        some = np.linspace(0, sample.shape[1] - 1, min(_LEARNT, sample.shape[1])).astype(np.int64)
        seen = Stream(sample if len(some) == sample.shape[1] else picked(sample, some), room=self.room).measure(0)
        frame = Frame(seen.translations, seen.unit)
        directions = spectrum(seen)[1][:, :_DIRECTIONS]
        rng = np.random.default_rng([self._seed, 5])
        centres = kmeans_centres(track_coordinates(seen, directions), self.cells, rng)
        return frame.rounded(frame.working_type(self.reader.dtype)), directions, centres

    def _measurements(
        self, sample: np.ndarray, wanted: np.ndarray, offset: np.ndarray, total: np.ndarray, gram: np.ndarray
    ) -> Measurements:
        """What the sums (2F,) and (2F, 2F) of all tracks about an offset (F, 2) say."""
        if not np.isfinite(total).all():
            self._require_finite(self._plan(1))
        mean = total / self.count
        gram = gram - self.count * np.outer(mean, mean)
        unit = float(np.sqrt(max(np.trace(gram), 0.0) / (2 * self.frames * self.count)))
        if not in_range(unit):
            raise out_of_range(unit)
        translations = offset + mean.reshape(self.frames, 2)
        return Measurements(sample, translations, unit, gram / unit**2, self.count, wanted)

    def compress(
        self,
        measured: Measurements,
        *,
        noise: float,
        tolerance: float,
        told: Callable[[float], None] | None = None,
    ) -> CompressedTracks:
        """Second pass: every point to its cell, if cells did not come with the first; and the factors of the cells.

        As :func:`nrsfm.compression.compress`, with cells that are learnt on the sample.
        """
        apply = functools.partial(_map, self.runner.here)
        if self.cells == 1:
            labels = np.zeros(self.count, dtype=np.uint8)
            return compress_grams(measured, labels, measured.gram[None], noise=noise, tolerance=tolerance)
        cells = self._joined
        if cells is None:
            cells = self._assigned(*self._learnt(measured.points), told)
            cells = cells.about(cells.totals.sum(axis=0) / self.count, measured.unit)
        return compress_grams(measured, cells.labels, cells.grams, noise=noise, tolerance=tolerance, apply=apply)

    def _assigned(
        self, frame: Frame, directions: np.ndarray, centres: np.ndarray, told: Callable[[float], None] | None
    ) -> Cells:
        """The cells of all points."""
        walk = self._plan(len(centres))
        work = functools.partial(cells_of_shard, self.reader, walk, frame, directions, centres)
        shards, tell = walk.shards(self.count), self._telling(told)
        parts, (sizes, totals, grams) = self.runner.sums(work, shards, "labels", ("sizes", "totals", "grams"), tell)
        return Cells.used(np.concatenate(parts), sizes, totals, grams)

    def expand(
        self,
        compressed: CompressedTracks,
        shapes: np.ndarray,
        dtype: np.dtype,
        deviations: Deviations | None,
        told: Callable[[float], None] | None = None,
    ) -> dict[str, np.ndarray]:
        """Third pass: ``shapes`` (F, P, 3), and ``depth_deviation`` (F, P) where there is a model of it.

        Raises ``InputError`` where the method found shapes that are not finite.
        """
        if not np.isfinite(shapes).all():
            raise InputError("shapes: every coordinate must be finite, received NaN or infinity from the method")
        measured = compressed.measurements
        flat = shapes.reshape(3 * self.frames, -1) * measured.unit
        edges = zip(compressed.offsets[:-1], compressed.offsets[1:], strict=True)
        way = Expansion(tuple(flat[:, a:b] for a, b in edges), compressed.maps)
        return self._expanded(compressed, way, np.dtype(dtype), deviations, told)

    def _expanded(
        self,
        compressed: CompressedTracks,
        way: Expansion,
        dtype: np.dtype,
        deviations: Deviations | None,
        told: Callable[[float], None] | None,
    ) -> dict[str, np.ndarray]:
        measured = compressed.measurements
        wanted: dict[str, Any] = {"shapes": ((self.frames, self.count, 3), dtype)}
        if deviations is not None:
            wanted["depth_deviation"] = ((self.frames, self.count), np.dtype(np.float32))
        granule = self.target.granule(self.frames)
        walk = self._plan(len(compressed.maps), granule)
        if granule == 1:
            walk = replace(walk, part=min(walk.part, _EXPANDED))
        with self.target as target:
            writers = target.make(wanted)
            work = functools.partial(
                expand_shard,
                self.reader,
                walk,
                Frame(measured.translations, measured.unit),
                expansion=way,
                deviations=deviations,
                dtype=dtype,
            )
            self.runner.write(work, walk.shards(self.count), compressed.labels, writers, self._telling(told))
            return target.finish()

    def _plan(self, cells: int, granule: int = 1) -> Plan:
        walk = self.runner.planned(plan(self.frames, self.count, cells, self.runner.workers, self.room), self.count)
        if granule == 1:
            return walk
        block = max(granule, walk.block // granule * granule)
        return replace(walk, block=block, part=granule)

    def _telling(self, told: Callable[[float], None] | None) -> Callable[[int], None] | None:
        if told is None:
            return None
        done = 0

        def add(points: int) -> None:
            nonlocal done
            done += points
            told(done / self.count)

        return add

    def _require_finite(self, walk: Plan) -> None:
        """Say which coordinates are not finite."""
        numbers = entries = 0
        first: tuple[int, int] | None = None
        value = np.zeros(2)
        for start, stop in walk.blocks(0, self.count):
            block = self.reader.read(start, stop)
            wrong = ~np.isfinite(block)
            where = np.argwhere(wrong.any(axis=2))
            numbers, entries = numbers + int(np.count_nonzero(wrong)), entries + len(where)
            if len(where):
                here = (int(where[0, 0]), int(where[0, 1]) + start)
                if first is None or here < first:
                    first, value = here, block[here[0], here[1] - start]
        if first is not None:
            raise InputError(
                f"points: every visible coordinate must be finite, received {numbers} that are NaN or infinite, in "
                f"{entries} of {self.frames * self.count} entries, the first at frame {first[0]}, point {first[1]}: "
                f"({value[0]:g}, {value[1]:g})"
            )


@dataclass(frozen=True)
class Cells:
    """Of all points: ``labels`` (P,); of each cell ``sizes`` (K,), ``totals`` (K, 2F) and ``grams`` (K, 2F, 2F)."""

    labels: np.ndarray
    sizes: np.ndarray
    totals: np.ndarray
    grams: np.ndarray

    @classmethod
    def used(cls, labels: np.ndarray, sizes: np.ndarray, totals: np.ndarray, grams: np.ndarray) -> Cells:
        """The cells that hold points; a centre that is nearest to none has no cell."""
        used = sizes > 0
        if used.all():
            return cls(labels, sizes, totals, grams)
        return cls((np.cumsum(used) - 1).astype(labels.dtype)[labels], sizes[used], totals[used], grams[used])

    def about(self, mean: np.ndarray, unit: float) -> Cells:
        """The same of tracks less a mean (2F,), in a unit; the Gram matrices change in place."""
        for size, total, gram in zip(self.sizes, self.totals, self.grams, strict=True):
            cross = np.outer(total, mean)
            gram += size * np.outer(mean, mean) - cross - cross.T
            gram /= unit**2
        return Cells(self.labels, self.sizes, (self.totals - self.sizes[:, None] * mean) / unit, self.grams)


def _map(threads: Threads, function: Callable[..., Any], items: Any) -> list[Any]:
    return list(threads.map(function, items))
