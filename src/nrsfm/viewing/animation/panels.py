"""The two panels of an animation: what went in, and the shape that came out.

Pictures are drawn finer than they are shown, and averaged, which smooths their edges.

Source: ours.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.render import render
from nrsfm.viewing.scene import turned
from nrsfm.viewing.style import ESTIMATE, OUTLIER, PAPER, rgb
from nrsfm.viewing.tracks import place_colours, reference_positions, spread_points
from nrsfm.viewing.viewer.geometry import upright

_FINER = 2
_SWING, _TILT = 42.0, -8.0  # degrees
_TRACKS, _OVER_VIDEO, _TRAIL = 240, 120, 7
_BELIEVED = 0.5
_SPARSE = 400


class InputPanel:
    """The panel of what went in: the video, if there is one, and tracks with their way over the last frames."""

    def __init__(self, result: Reconstruction, tracks: Any, pictures: Any) -> None:
        self._result, self._tracks, self._pictures = result, tracks, pictures
        self.label = "video and tracks" if pictures is not None else "tracks" if tracks is not None else "points"
        sample = np.unique(np.linspace(0, result.n_frames - 1, 24).round().astype(int))
        points = np.stack([self._at(int(f))[0] for f in sample])
        odd = np.stack([self._at(int(f))[1] for f in sample])
        places = reference_positions(points, odd)
        self._shown = spread_points(places, _TRACKS if pictures is None else _OVER_VIDEO)
        self._colours = np.rint(255 * place_colours(places[self._shown])).astype(int)
        if pictures is not None:
            self._low, self._size = np.array([-0.5, -0.5]), np.array([pictures.width, pictures.height], dtype=float)
        else:
            known = points[np.isfinite(points).all(axis=2) & ~odd]
            low, high = np.percentile(known, [0.3, 99.7], axis=0) if len(known) else (np.zeros(2), np.ones(2))
            room = 0.05 * float((high - low).max() or 1.0)
            low, span = low - room, high - low + 2 * room
            wanted = np.maximum(span, span[::-1] * 0.62)  # neither panel becomes a strip
            self._low, self._size = low - 0.5 * (wanted - span), wanted
        self.aspect = float(self._size[0] / self._size[1])

    def _at(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Points (P, 2) of a frame, NaN where not seen, and which (P,) were not believed."""
        result = self._result
        odd = np.zeros(result.n_points, dtype=bool)
        if self._tracks is None:
            shape = np.asarray(result.shapes[frame], dtype=np.float64)
            return result.scales[frame] * (shape @ result.rotations[frame, :2].T) + result.translations[frame], odd
        points = np.array(self._tracks.points[frame], dtype=np.float64)
        if self._tracks.visible is not None:
            points[~np.asarray(self._tracks.visible[frame])] = np.nan
        if result.confidence is not None:
            odd = (result.confidence[frame] < _BELIEVED) & np.isfinite(points[:, 0])
        return points, odd

    def draw(self, frame: int, width: int, height: int) -> Any:
        """Return the picture of a frame, of so many pixels."""
        from PIL import Image, ImageDraw

        fine = 2 * _FINER
        scale = fine * height / self._size[1]
        if self._pictures is not None:
            shot = Image.fromarray(self._pictures.array(frame)).convert("RGB")
            image = shot.resize((fine * width, fine * height), Image.Resampling.BICUBIC)
        else:
            image = Image.new("RGB", (fine * width, fine * height), PAPER)
        over = Image.new("RGBA", image.size)
        pen = ImageDraw.Draw(over)
        way = []
        for f in range(max(0, frame - _TRAIL), frame + 1):
            points, odd = self._at(f)
            points[odd] = np.nan
            way.append((points[self._shown] - self._low) * scale)
        for k in range(len(way) - 1):
            age = (k + 1) / len(way)
            shade = round(255 * 0.7 * age)
            ends = np.concatenate([way[k], way[k + 1]], axis=1)
            for i in np.flatnonzero(np.isfinite(ends).all(axis=1)).tolist():
                pen.line(ends[i].tolist(), fill=(*self._colours[i].tolist(), shade), width=round(1.1 * fine))
        radius = fine * (2.2 if len(self._shown) > 120 else 2.8)
        for i in np.flatnonzero(np.isfinite(way[-1][:, 0])).tolist():
            x, y = way[-1][i].tolist()
            if self._pictures is not None:  # a rim, that tells them from whatever is behind them
                rim = radius + 0.8 * fine
                pen.ellipse((x - rim, y - rim, x + rim, y + rim), fill="#ffffff")
            pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=tuple(self._colours[i].tolist()))
        points, odd = self._at(frame)
        for x, y in ((points[self._shown][odd[self._shown]] - self._low) * scale).tolist():
            for dy in (-radius, radius):
                pen.line((x - radius, y - dy, x + radius, y + dy), fill=OUTLIER, width=round(0.9 * fine))
        image.paste(over, mask=over)
        return image.resize((width, height), Image.Resampling.LANCZOS)


class ShapePanel:
    """The panel of what came out: the shape, turned to and fro."""

    def __init__(
        self,
        result: Reconstruction,
        frames: np.ndarray,
        faces: np.ndarray | None,
        edges: np.ndarray | None,
        colours: np.ndarray | None,
    ) -> None:
        self._result, self._faces, self._edges = result, faces, edges
        self._view = np.diag([1.0, -1.0, -1.0]) @ upright(result.rotations)
        self._colours = None if colours is None else np.asarray(colours, dtype=np.float32) / 255.0
        places = np.linspace(0.0, 1.0, 8, endpoint=False)
        sample = np.unique(frames)[:: max(1, len(np.unique(frames)) // 12)]
        reach = [np.nanpercentile(np.abs(self._turned(int(f), p)[:, :2]), 99.7, axis=0) for f in sample for p in places]
        half = 1.06 * np.maximum(np.max(reach, axis=0), 1e-9)
        self._half = np.maximum(half, half[::-1] * 0.62)
        self._depth = float(np.nanpercentile(np.abs(self._turned(int(sample[0]), 0.125)[:, 2]), 98)) or 1.0
        self.aspect = float(self._half[0] / self._half[1])

    def _turned(self, frame: int, place: float) -> np.ndarray:
        shape = np.asarray(self._result.shapes[frame], dtype=np.float64)
        c, s = math.cos(math.radians(_TILT)), math.sin(math.radians(_TILT))
        tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        turn = tilt @ turned(self._view, _SWING * math.sin(2 * math.pi * place))
        return np.asarray((shape - np.nanmean(shape, axis=0)) @ turn.T)

    def draw(self, frame: int, place: float, width: int, height: int) -> Any:
        """Return the picture of a frame at a ``place`` in the loop, from 0 to 1, of so many pixels."""
        from PIL import Image

        points = self._turned(frame, place)
        few = int(np.count_nonzero(np.isfinite(points[:, 0]))) < _SPARSE
        if self._faces is None and (self._edges is not None or few):
            return self._sticks(points, width, height)
        image = render(
            points,
            rgb(ESTIMATE) if self._colours is None else self._colours,
            half_size=(float(self._half[0]), float(self._half[1])),
            pixels_per_unit=_FINER * height / (2 * float(self._half[1])),
            triangles=self._faces,
            strength=1.0 if self._colours is None else 0.6,
        )
        return Image.fromarray(image).resize((width, height), Image.Resampling.LANCZOS)

    def _sticks(self, points: np.ndarray, width: int, height: int) -> Any:
        """Points and the lines between them, far ones first, and paler."""
        from PIL import Image, ImageDraw

        fine = 2 * _FINER
        scale = fine * height / (2 * float(self._half[1]))
        image = Image.new("RGB", (fine * width, fine * height), PAPER)
        pen = ImageDraw.Draw(image)
        xy = points[:, :2] * scale + fine * np.array([width, height]) / 2
        near = np.clip(0.5 - 0.5 * points[:, 2] / self._depth, 0.0, 1.0)
        paper, ink = 255 * rgb(PAPER), 255 * rgb("#2f6ea8")
        parts: list[tuple[float, tuple[int, ...]]] = []
        known = np.isfinite(points).all(axis=1)
        if self._edges is not None:
            lines = np.asarray(self._edges)
            parts = [(float(near[[a, b]].mean()), (a, b)) for a, b in lines[known[lines].all(axis=1)].tolist()]
        parts += [(float(near[i]) + 1e-3, (i,)) for i in np.flatnonzero(known).tolist()]
        many = np.count_nonzero(known) > 150
        for level, which in sorted(parts):
            colour = tuple(np.rint(paper + (0.35 + 0.6 * min(level, 1.0)) * (ink - paper)).astype(int).tolist())
            if len(which) == 2:
                pen.line([*xy[which[0]].tolist(), *xy[which[1]].tolist()], fill=colour, width=round(1.6 * fine))
                continue
            x, y = xy[which[0]].tolist()
            r = fine * (2.2 if many else 3.0) * (0.75 + 0.35 * level)
            if self._colours is not None:
                colour = tuple(np.rint(255 * self._colours[which[0]]).astype(int).tolist())
            pen.ellipse((x - r, y - r, x + r, y + r), fill=colour)
        return image.resize((width, height), Image.Resampling.LANCZOS)
