"""Complete tracks of any size, read in blocks: what an affine reconstruction needs of the points, and the way back.

The file is read three times: for the Gram matrix, for the cells (one cell needs no second time), for the shapes. The
centres of the cells are learnt from a random sample that the first pass brings along; cells of a sample of 20,000 are
as good as those of all points (docs/decisions.md has the numbers).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from nrsfm.compression import CompressedTracks, Measurements, compress_grams, in_range, out_of_range
from nrsfm.errors import InputError
from nrsfm.streaming.passes import (
    Deviations,
    Expansion,
    Frame,
    cells_of_shard,
    expand_shard,
    gram_of_shard,
    label_type,
)
from nrsfm.streaming.plan import Plan, plan
from nrsfm.streaming.readers import reader_of
from nrsfm.streaming.runners import Runner, Threads
from nrsfm.streaming.stored import StoredPoints
from nrsfm.streaming.targets import Target

SAMPLE = 50_000
"""Points that teach the centres of cells, the noise, and what is asked about outliers and perspective."""

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
    """

    def __init__(
        self,
        points: np.ndarray | StoredPoints,
        target: Target | None = None,
        room: int | None = None,
        runner: Runner | None = None,
    ) -> None:
        self.points = points
        self.reader = reader_of(points)
        self.target = Target() if target is None else target
        self.room = room
        self.runner = Threads() if runner is None else runner
        self.frames, self.count, _ = self.reader.shape
        self._measured: tuple[int, Measurements] | None = None

    def measure(self, seed: int, told: Callable[[float], None] | None = None) -> Measurements:
        """First pass: :func:`nrsfm.compression.measure` for what does not fit into memory.

        The points of the measurements are those of the sample; ``total`` is P.

        Raises
        ------
        InputError
            A coordinate is not finite, or the points do not spread.
        """
        if self._measured is None or self._measured[0] != seed:  # asked for twice, read once
            self._measured = seed, self._measure(seed, told)
        return self._measured[1]

    def _measure(self, seed: int, told: Callable[[float], None] | None) -> Measurements:
        size = min(self.count, SAMPLE)
        if self.room is not None:
            size = min(size, max(4096, self.room // (_SHARE * 2 * self.frames * self.reader.dtype.itemsize)))
        rng = np.random.default_rng([seed, 4])
        wanted = np.arange(self.count)
        if size < self.count:
            wanted = np.sort(rng.choice(self.count, size=size, replace=False))
        walk = self._plan(1)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused below
            offset = self.reader.read(0, min(self.count, _OFFSET)).astype(np.float64).mean(axis=1)
            work = functools.partial(gram_of_shard, self.reader, walk, offset, wanted, self._telling(told))
            parts = list(self.runner.map(work, walk.shards(self.count)))
            total = np.sum([part.total for part in parts], axis=0)
            gram = functools.reduce(np.add, (part.gram for part in parts))
            mean = total / self.count
            gram -= self.count * np.outer(mean, mean)
            unit = float(np.sqrt(max(np.trace(gram), 0.0) / (2 * self.frames * self.count)))
        if not np.isfinite(total).all():
            self._require_finite(walk)
        if not in_range(unit):
            raise out_of_range(unit)
        sample = np.concatenate([part.sample for part in parts], axis=1)
        translations = offset + mean.reshape(self.frames, 2)
        return Measurements(sample, translations, unit, gram / unit**2, self.count, wanted)

    def compress(
        self,
        measured: Measurements,
        directions: np.ndarray,
        centres: np.ndarray,
        *,
        noise: float,
        tolerance: float,
        told: Callable[[float], None] | None = None,
    ) -> CompressedTracks:
        """Second pass: every point to the nearest of the centres (K, q), and :func:`nrsfm.compression.compress`.

        ``directions`` (2F, q) are those of the coordinates in which the centres were learnt.
        """
        if len(centres) == 1:
            labels = np.zeros(self.count, dtype=np.uint8)
            return compress_grams(measured, labels, measured.gram[None], noise=noise, tolerance=tolerance)
        walk = self._plan(len(centres))
        frame = Frame(measured.translations, measured.unit)
        work = functools.partial(cells_of_shard, self.reader, walk, frame, directions, centres, self._telling(told))
        grams = np.zeros((len(centres), 2 * self.frames, 2 * self.frames))
        joined = np.empty(self.count, dtype=label_type(len(centres)))
        shards = walk.shards(self.count)
        for (start, stop), part in zip(shards, self.runner.map(work, shards), strict=True):
            joined[start:stop] = part.labels
            grams += part.grams
        sizes = np.bincount(joined, minlength=len(centres))
        if not sizes.all():  # a centre that is nearest to no point
            joined = (np.cumsum(sizes > 0) - 1).astype(joined.dtype)[joined]
            grams = grams[sizes > 0]
        return compress_grams(
            measured, joined, grams, noise=noise, tolerance=tolerance, apply=functools.partial(_map, self.runner)
        )

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
        wanted: dict[str, Any] = {"shapes": ((self.frames, self.count, 3), np.dtype(dtype))}
        if deviations is not None:
            wanted["depth_deviation"] = ((self.frames, self.count), np.dtype(np.float32))
        walk = self._plan(len(compressed.maps), self.target.granule(self.frames))
        with self.target as target:
            writers = target.make(wanted)
            work = functools.partial(
                expand_shard,
                self.reader,
                walk,
                Frame(measured.translations, measured.unit),
                compressed.labels,
                way,
                deviations,
                writers,
                np.dtype(dtype),
                self._telling(told),
            )
            for _ in self.runner.map(work, walk.shards(self.count)):
                pass
            return target.finish()

    def _plan(self, cells: int, granule: int = 1) -> Plan:
        walk = plan(self.frames, self.count, cells, self.runner.workers, self.room)
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


def _map(runner: Runner, function: Callable[..., Any], items: Any) -> list[Any]:
    return list(runner.map(function, items))
