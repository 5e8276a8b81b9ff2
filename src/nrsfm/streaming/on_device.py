"""The passes over the points where these are on a device: tracks stay there, and shapes are made there.

The same steps as :mod:`nrsfm.streaming.passes`, in the words of the array-API standard. What does not grow with the
points, the sample, cameras, cells' centres and eigenproblems, and the iterations on virtual points, is on the host.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from nrsfm.compression import CompressedTracks, Measurements
from nrsfm.devices import namespace, to_device, to_host, type_of
from nrsfm.errors import InputError
from nrsfm.streaming.passes import Deviations, Expansion, Frame, label_type, order_of, short
from nrsfm.streaming.stream import Cells, Stream

_BYTES = 256 * 2**20  # of a block in float64: several such are on the device at once

Tell = Callable[[float], None] | None


@dataclass(frozen=True)
class DeviceReader:
    """Points (F, P, 2) on a device; a block is copied to the host. For what is asked of few points only."""

    points: Any

    @property
    def shape(self) -> tuple[int, ...]:
        """(F, P, 2)."""
        return tuple(self.points.shape)

    @property
    def dtype(self) -> np.dtype:
        """Of the coordinates."""
        return type_of(self.points)

    def read(self, start: int, stop: int) -> np.ndarray:
        """See :class:`nrsfm.streaming.readers.Reader`."""
        return to_host(self.points[:, start:stop, :])


class OnDevice(Stream):
    """Complete tracks (F, P, 2) of PyTorch or CuPy; see :class:`nrsfm.streaming.stream.Stream`.

    Raises ``InputError`` where the device has no float64, in which Gram matrices must be summed up.
    """

    at_hand = True

    def __init__(self, points: Any, cells: int = 1) -> None:
        points = points.detach() if hasattr(points, "detach") else points  # PyTorch would note every step for gradients
        super().__init__(points, reader=DeviceReader(points), cells=cells)
        self._xp = namespace(points)
        try:
            to_device(np.zeros(1), points)
        except (TypeError, RuntimeError) as error:
            raise InputError(f"points: a device with float64 is needed, received one without ({error})") from error

    def _measure(self, seed: int, told: Tell) -> Measurements:
        return self._measure_with_cells(self._wanted(seed), told)

    def _sample(self, wanted: np.ndarray) -> np.ndarray:
        return to_host(self._xp.take(self.points, to_device(wanted, self.points), axis=1))

    def _assigned(self, frame: Frame, directions: np.ndarray, centres: np.ndarray, told: Tell) -> Cells:
        """Each point to the nearest of the centres (K, q) along directions (2F, q), and the sums of the cells."""
        xp, cells, rows = self._xp, len(centres), 2 * self.frames
        kind = frame.working_type(self.reader.dtype)
        along = self._there(directions / frame.unit, kind)
        targets = self._there(centres, kind)
        sizes = xp.sum(targets * targets, axis=1)
        labels = np.empty(self.count, dtype=label_type(cells))
        totals, grams = self._there(np.zeros((cells, rows))), self._there(np.zeros((cells, rows, rows)))
        for start, stop in self._blocks():
            block = self._rows(frame, start, stop, kind)
            own = to_host(xp.argmin(sizes - 2.0 * ((block @ along) @ targets.T), axis=1))
            labels[start:stop] = own
            order, edges = order_of(own, cells)
            block = xp.take(block, to_device(order, self.points), axis=0)
            for k in np.flatnonzero(np.diff(edges)).tolist():
                part = xp.astype(block[int(edges[k]) : int(edges[k + 1]), :], xp.float64)
                totals[k, :] += xp.sum(part, axis=0)
                grams[k, :, :] += part.T @ part
            self._tell(told, stop)
        counts = np.bincount(labels, minlength=cells)
        return Cells.used(labels, counts, to_host(totals), to_host(grams))

    def _expanded(
        self, compressed: CompressedTracks, way: Expansion, dtype: np.dtype, deviations: Deviations | None, told: Tell
    ) -> dict[str, Any]:
        """Shapes (F, P, 3), and deviations (F, P) float32, on the device."""
        xp, measured = self._xp, compressed.measurements
        frame = Frame(measured.translations, measured.unit)
        maps, backs = short(way, frame.unit, dtype)
        there = [(self._there(m), None if b is None else self._there(b)) for m, b in zip(maps, backs, strict=True)]
        model = None if deviations is None else _Deviations(deviations, frame.unit, dtype, self)
        shapes = self._empty((self.frames, self.count, 3), dtype)
        depths: Any = None if model is None else self._empty((self.frames, self.count), np.dtype(np.float32))
        for start, stop in self._blocks():
            labels = compressed.labels[start:stop]
            order, edges = order_of(labels, len(maps))
            back = np.empty_like(order)
            back[order] = np.arange(len(order))
            rows = xp.take(self._rows(frame, start, stop, dtype), to_device(order, self.points), axis=0)
            inverse = to_device(back, self.points)
            made = []
            for k in np.flatnonzero(np.diff(edges)).tolist():
                part = rows[int(edges[k]) : int(edges[k + 1]), :]
                left, right = there[k]
                made.append((part if right is None else part @ right) @ left)
            flat = xp.take(xp.concat(made, axis=0), inverse, axis=0)
            shapes[:, start:stop, :] = xp.permute_dims(xp.reshape(flat, (stop - start, self.frames, 3)), (1, 0, 2))
            if model is not None:
                depths[:, start:stop] = model.of(rows, edges, inverse, labels)
            self._tell(told, stop)
        return {"shapes": shapes} | ({} if depths is None else {"depth_deviation": depths})

    def _rows(self, frame: Frame, start: int, stop: int, kind: np.dtype) -> Any:
        """Centred tracks of some points, one row a point, (n, 2F), not divided by the unit."""
        xp = self._xp
        part = self.points[:, start:stop, :]
        if frame.working_type(self.reader.dtype) == np.float64:
            part = xp.astype(part, xp.float64)
        offset = self._there(frame.translations, type_of(part))
        part = xp.astype(part - offset[:, None, :], getattr(xp, kind.name))
        return xp.reshape(xp.permute_dims(part, (1, 0, 2)), (stop - start, 2 * self.frames))

    def _there(self, array: np.ndarray, kind: np.dtype | None = None) -> Any:
        return to_device(array if kind is None else np.asarray(array, dtype=kind), self.points)

    def _empty(self, shape: tuple[int, ...], kind: np.dtype) -> Any:
        like = self._there(np.zeros(1, dtype=kind))
        return self._xp.empty(shape, dtype=like.dtype, device=like.device)

    def _blocks(self) -> Iterator[tuple[int, int]]:
        step = max(1, _BYTES // (16 * self.frames))
        for start in range(0, self.count, step):
            yield start, min(start + step, self.count)

    def _tell(self, told: Tell, done: int) -> None:
        if told is not None:
            told(done / self.count)


class _Deviations:
    """:class:`nrsfm.uncertainty.DeviationModel` on a device."""

    def __init__(self, model: Any, unit: float, dtype: np.dtype, stream: OnDevice) -> None:
        self._xp, self._model, self._stream = namespace(stream.points), model, stream
        self._first = self._fields(model.first, unit, dtype)
        self._deform = None if model.deform is None else self._fields(model.deform, unit, dtype)
        self._weights, self._poor = (stream._there(values[:, None], dtype) for values in (model.weights, model.poor))
        self._ripple = stream._there(model.ripple, dtype)

    def _fields(self, fields: Any, unit: float, dtype: np.dtype) -> list[Any]:
        return [self._stream._there(field.T / unit, dtype) for field in fields]

    def of(self, rows: Any, edges: np.ndarray, inverse: Any, labels: np.ndarray) -> Any:
        """Deviations (F, n) float32 of points whose tracks ``rows`` (n, 2F) are sorted by cell; see ``of`` there."""
        xp, model = self._xp, self._model
        first = self._form(self._first, rows, edges, inverse)
        deform = 0.0 if self._deform is None else self._form(self._deform, rows, edges, inverse)[None, :]
        mean = xp.clip(self._poor * (deform + model.noise**2), *map(float, model.bounds))
        ripple = xp.take(self._ripple, to_device(labels.astype(np.int64), rows), axis=1)
        return xp.astype(model.scale * xp.sqrt(self._weights * first[None, :] + mean + ripple), xp.float32)

    def _form(self, fields: list[Any], rows: Any, edges: np.ndarray, inverse: Any) -> Any:
        xp = self._xp
        parts = [
            xp.sum((rows[int(edges[k]) : int(edges[k + 1]), :] @ fields[k]) ** 2, axis=1)
            for k in np.flatnonzero(np.diff(edges)).tolist()
        ]
        return xp.take(xp.concat(parts, axis=0), inverse, axis=0)
