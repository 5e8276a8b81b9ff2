"""The process in which one video is rendered or read, tracked by every method asked for, and reconstructed."""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


def main() -> None:
    """Read the settings of ``tracking._render_settings`` or ``_cloth_settings`` on stdin; print records by method."""
    settings: dict[str, Any] = json.load(sys.stdin)
    import logging

    logging.getLogger("nrsfm").setLevel(logging.ERROR)
    found = _cloth(settings) if "folder" in settings else _rendered(settings)
    json.dump(_plain(found), sys.stdout, allow_nan=False)


def _rendered(settings: dict[str, Any]) -> dict[str, Any]:
    from nrsfm.datasets.rendering import rendered
    from nrsfm.tracking import track
    from nrsfm.video import score_tracks

    made = rendered(
        settings["scene"],
        settings["data"],
        settings["variant"],
        settings["size"],
        settings["seed"],
        frames=settings["frames"],
    )
    frames, height, width = made.masks.shape
    mask = made.masks[made.reference]
    place = np.full((height, width), -1)
    place[made.queries[:, 1], made.queries[:, 0]] = np.arange(len(made.queries))
    records: dict[str, Any] = {}
    for method in settings["methods"]:
        start = time.perf_counter()
        found = track(made.images, mask, made.reference, method)
        seconds = time.perf_counter() - start
        x, y = found.layout.pixels.T
        query = place[y, x]
        kept = query >= 0
        points, visible = found.tracks.points[:, kept], found.tracks.visible
        assert visible is not None
        query, visible = query[kept], visible[:, kept]
        told = score_tracks(points, visible, made.tracks[:, query], made.visible[:, query], reference=made.reference)
        names = ("mean", "median", "under_1", "under_3", "precision", "recall", "entries")
        record = {name: getattr(told, name) for name in names} | {"seconds": seconds, "frames": frames}
        record["stages"] = found.diagnostics.seconds
        if method in settings["reconstructed"]:
            record["shapes"] = _end_to_end(made, query, points, visible, settings["entries"])
        records[method] = record
    return records


def _end_to_end(made: Any, query: np.ndarray, points: np.ndarray, visible: np.ndarray, entries: int) -> dict[str, Any]:
    """Error of shapes from estimated and from perfect tracks of the same points, on those that both reconstruct."""
    from nrsfm import Tracks, reconstruct
    from nrsfm.cli.work import chosen_step
    from nrsfm.metrics import shape_error

    step = chosen_step(len(query), len(points), entries)
    thin = (made.queries[query] % step == 0).all(axis=1)
    query, points, visible = query[thin], points[:, thin], visible[:, thin]
    true = made.query_shapes(query) * np.float32(made.scene.scales[made.reference])
    results, seconds = {}, {}
    for name, tracks in (("estimated", Tracks(points, visible)), ("perfect", made.perfect_tracks(query))):
        start = time.perf_counter()
        results[name] = reconstruct(tracks, "auto")
        seconds[name] = time.perf_counter() - start
    both = results["estimated"].reconstructed & results["perfect"].reconstructed
    valid = np.broadcast_to(both, true.shape[:2]).copy()
    return {
        "points": len(query),
        "step": step,
        "compared": int(both.sum()),
        **{name: shape_error(result, true, "per-frame", valid=valid) for name, result in results.items()},
        "reconstructed": {name: int(result.reconstructed.sum()) for name, result in results.items()},
        "seconds": seconds,
    }


def _cloth(settings: dict[str, Any]) -> dict[str, Any]:
    """A real video with a mask for every frame: the mask of the reference alone is told, the others judge."""
    from nrsfm.tracking import track
    from nrsfm.video import open_frames, read_mask, reference_frame

    records: dict[str, Any] = {}
    folder = Path(settings["folder"])
    with open_frames(folder / "rgb_*.jpg", resize=settings["size"]) as frames:
        masks = read_mask(folder / "mask_*.png", frames)
        reference = reference_frame(frames, masks)
        for method in settings["methods"]:
            start = time.perf_counter()
            found = track(frames, masks[reference], reference, method)
            seconds = time.perf_counter() - start
            told, visible = found.diagnostics, found.tracks.visible
            assert visible is not None
            share, near = _inside(found.tracks.points, visible, masks)
            grey = [
                _difference(frames, reference, f, found.layout.pixels, found.tracks.points[f], visible[f])
                for f in range(len(frames))
                if f != reference
            ]
            others = np.arange(len(frames)) != reference
            records[method] = {
                "photometric": float(np.nanmean(told.photometric_error[others])),
                "grey_levels": float(np.nanmean(grey)),
                "likeness": float(np.nanmean(told.likeness[others])),
                "visible": float(told.visible[others].mean()),
                "inside": share,
                "near": near,
                "points": found.tracks.n_points,
                "frames": len(frames),
                "seconds": seconds,
            }
            if settings.get("picture"):
                _picture(frames, found, Path(settings["picture"]) / f"tracking-cloth-{method}.png")
    return records


def _inside(points: np.ndarray, visible: np.ndarray, masks: np.ndarray) -> tuple[float, float]:
    """Share of the entries called visible that lie inside the frame's mask, and within 3 pixels of it."""
    import cv2

    inside = near = count = 0
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
    for f, mask in enumerate(masks):
        x, y = np.round(points[f][visible[f]]).astype(int).T
        good = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
        wide = cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)
        inside += int(mask[y[good], x[good]].sum())
        near += int(wide[y[good], x[good]].sum())
        count += len(x)
    return inside / max(count, 1), near / max(count, 1)


def _difference(
    frames: Any, reference: int, f: int, pixels: np.ndarray, points: np.ndarray, visible: np.ndarray
) -> float:
    """Mean absolute difference of grey levels (of 255) to the reference, over visible points."""
    from scipy.ndimage import map_coordinates

    if not visible.any():
        return float("nan")
    first, image = frames.grey(reference), frames.grey(f)
    x, y = points[visible].T
    there = map_coordinates(image, [y, x], order=1, mode="nearest")
    here = first[pixels[visible, 1], pixels[visible, 0]]
    return float(255 * np.abs(there - here).mean())


def _picture(frames: Any, found: Any, path: Path) -> None:
    """Six frames with every so-manieth visible point in the colour of its place in the reference."""
    import cv2

    count, pixels = len(frames), found.layout.pixels
    grid = np.flatnonzero((pixels % 12 == 0).all(axis=1))
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    place = (pixels[grid] - low) / np.maximum(high - low, 1)
    hues = np.stack([179 * place[:, 0], np.full(len(grid), 230), 120 + 135 * place[:, 1]], axis=1)
    colours = cv2.cvtColor(hues[None].astype(np.uint8), cv2.COLOR_HSV2BGR)[0]
    shown = []
    for f in np.linspace(0, count - 1, 6).round().astype(int):
        image = np.ascontiguousarray(frames.colour(int(f))[..., ::-1])
        for (x, y), seen, colour in zip(
            found.tracks.points[f][grid], found.tracks.visible[f][grid], colours, strict=True
        ):
            if seen:
                cv2.circle(image, (round(float(x)), round(float(y))), 3, colour.tolist(), -1, cv2.LINE_AA)
        cv2.putText(image, f"frame {f}", (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2, cv2.LINE_AA)
        shown.append(image)
    sheet = np.concatenate([np.concatenate(shown[:3], axis=1), np.concatenate(shown[3:], axis=1)])
    good, data = cv2.imencode(".png", sheet)
    if good:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data.tobytes())


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


if __name__ == "__main__":
    main()
