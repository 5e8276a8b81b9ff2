"""What the stages of ``nrsfm run`` do, each filling a folder of its own from the outputs of those before."""

from __future__ import annotations

import dataclasses
import logging
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nrsfm.cli.inputs import Inputs
from nrsfm.cli.outputs import versions
from nrsfm.cli.scores import Truth, scores
from nrsfm.cli.text import to_json
from nrsfm.numerics.threads import single_thread
from nrsfm.progress import Report
from nrsfm.stages.run_folder import LOG, METRICS, RECONSTRUCTION

if TYPE_CHECKING:
    from nrsfm.reconstruction import Reconstruction
    from nrsfm.tracks import Tracks

TRACKS = "tracks.h5"
TRACKING = "tracking.json"
ENTRIES = 800_000
"""Entries of tracks, frames times points, that the default method reconstructs in about a minute."""
TRUTH = "truth.npz"
FEWEST = 1_000
"""Points that a long video gets all the same."""

logger = logging.getLogger("nrsfm.run")


def chosen_step(area: int, frames: int, entries: int = ENTRIES) -> int:
    """The smallest distance of points, in pixels, at which an object of that area has few enough of them."""
    return max(1, int(np.ceil(np.sqrt(area / max(entries / frames, FEWEST)))))


@dataclasses.dataclass(frozen=True)
class Wishes:
    """What the command line asked for; the stages' settings are made from it."""

    video: str
    mask: str | None
    start: int
    stop: int | None
    stride: int
    resize: str | None
    reference: int | str
    step: int | None
    track_method: str
    tracking: dict[str, Any]
    method: str
    options: dict[str, Any]
    seed: int
    truth: str | None
    truth_frame: str
    formats: tuple[str, ...]
    title: str


class Work:
    """The work of every stage; what several of them read is read once."""

    def __init__(self, folder: Path, wishes: Wishes) -> None:
        self._folder, self._wishes = folder, wishes
        self.facts: dict[str, dict[str, Any]] = {}

    def track(self, aside: Path, report: Report) -> dict[str, Any]:
        """Video to ``tracks.h5``, and ``tracking.json``, which says how it went."""
        from nrsfm.tracking import save_tracking, track
        from nrsfm.video import check_frames, open_frames, read_mask

        asked = self._wishes
        report("reading the video", None)
        with open_frames(asked.video, asked.start, asked.stop, asked.stride, asked.resize) as frames:
            check_frames(frames)
            mask = None if asked.mask is None else read_mask(asked.mask, frames)
            count, height, width = frames.shape
            area = height * width if mask is None else int(mask.reshape(-1, height * width).sum(axis=1).max())
            step = chosen_step(area, count) if asked.step is None else asked.step
            found = track(frames, mask, asked.reference, asked.track_method, step, report, **asked.tracking)
            save_tracking(found, aside / TRACKS)
            told = found.diagnostics
            facts = {
                "name": frames.name,
                "frames": count,
                "numbers": [int(n) for n in frames.numbers],
                "fps": float(frames.fps),
                "size": [width, height],
                "step": step,
                "points": found.tracks.n_points,
                "reference": int(told.reference),
                "visible": float(told.visible.mean()),
                "method": told.method,
            }
        more = {
            "options": dataclasses.asdict(told.options),
            "seconds": told.seconds,
            "visible_of_frames": told.visible.tolist(),
            "likeness_of_frames": told.likeness.tolist(),
            "photometric_error_of_frames": told.photometric_error.tolist(),
            "rank": told.rank,
            "residual": None if np.isnan(told.residual) else told.residual,
        }
        (aside / TRACKING).write_text(to_json({**facts, **more}) + "\n", encoding="utf-8")
        return facts

    def reconstruct(self, aside: Path, report: Report) -> dict[str, Any]:
        """Tracks to ``reconstruction.npz``."""
        import nrsfm
        from nrsfm.methods import get_method

        asked = self._wishes
        names = {field.name for field in dataclasses.fields(get_method(asked.method).Options)}
        mesh = {"faces": self.faces} if "faces" in names and not {"faces", "grid"} & asked.options.keys() else {}
        tracks, options, told = self.tracks, dict(asked.options), {}
        if "deviation" in self._arrays:
            from nrsfm.tracking import usable

            tracks, noise = usable(tracks, self._arrays["deviation"])
            told = {"left_out": (tracks.n_missing - self.tracks.n_missing) / tracks.points[..., 0].size}
            if noise > 0:
                options.setdefault("noise_level", noise)
        result = nrsfm.reconstruct(tracks, method=asked.method, seed=asked.seed, progress=report, **options, **mesh)
        report("writing", None)
        result.save(aside / RECONSTRUCTION)
        used = {name: value for name, value in result.options.items() if name != "seed"}
        warnings = [str(text) for text in result.diagnostics.get("warnings", [])]
        return {"options": used, "faces": "came with the tracks" if mesh else None, "warnings": warnings, **told}

    def score(self, aside: Path, report: Report) -> dict[str, Any]:
        """Tracks and shapes against the truth, to ``metrics.json``; the truth of the tracked points beside it."""
        from nrsfm.video import score_tracks
        from nrsfm.video.truth import load_video_truth, match_truth

        report("reading the truth", None)
        about = self.facts["track"]
        size = (float(about["size"][0]), float(about["size"][1]))
        matched = match_truth(
            load_video_truth(str(self._wishes.truth)),
            self._arrays["pixels"],
            about["reference"],
            np.array(about["numbers"]),
            size,
        )
        report("scoring", None)
        found: dict[str, Any] = {}
        if matched.shapes is not None:
            truth = Truth(matched.shapes, matched.valid, matched.rotations, self._wishes.truth_frame)
            with single_thread():
                found |= scores(self.result, truth)
            arrays: dict[str, Any] = {"shapes": matched.shapes, "valid": matched.valid}
            if matched.rotations is not None:
                arrays["rotations"] = matched.rotations
            np.savez(aside / TRUTH, **arrays)
        if matched.tracks is not None and matched.visible is not None:
            kept, tracks = matched.known, self.tracks
            told = score_tracks(
                tracks.points[:, kept],
                None if tracks.visible is None else tracks.visible[:, kept],
                matched.tracks[:, kept].astype(tracks.points.dtype, copy=False),
                matched.visible[:, kept],
                reference=about["reference"],
            )
            values = {name: value for name, value in dataclasses.asdict(told).items() if name != "per_frame"}
            per_frame = [None if np.isnan(value) else float(value) for value in told.per_frame]
            found["tracks"] = values | {"points": int(kept.sum()), "per_frame": per_frame}
        (aside / METRICS).write_text(to_json(found) + "\n", encoding="utf-8")
        return {"known": int(matched.known.sum()), "shapes": matched.shapes is not None, "metrics": found}

    def draw(self, aside: Path, report: Report) -> dict[str, Any]:
        """The pictures; one that fails does not stop the run."""
        from nrsfm.cli.pictures import draw

        truth, found = self.truth, self.facts.get("score", {}).get("metrics")
        inputs = Inputs(
            tracks=self.tracks, rotations=None, truth=truth, record={}, faces=self.faces, mesh=self.faces, unit="px"
        )
        try:
            with single_thread():
                draw(aside, inputs, self.result, found if truth is not None else None, report)
        except Exception as error:  # whatever a picture fails for, the result is worth keeping
            logger.exception("a picture could not be drawn")
            return {"warnings": [f"not every picture could be drawn: {error} ({LOG} says more)"]}
        return {"warnings": []}

    def export(self, aside: Path, report: Report) -> dict[str, Any]:
        """``model.glb`` and what else was asked for."""
        from nrsfm.export import write

        about = self.facts["track"]
        written, warnings = [], []
        for form in self._wishes.formats:
            with single_thread():
                done = write(
                    self.result,
                    aside / model_name(form),
                    format=form,
                    faces=self.faces,
                    colours=self.colours,
                    fps=about["fps"],
                    reference=about["reference"],
                    image_size=(float(about["size"][0]), float(about["size"][1])),
                    progress=report,
                )
            written.append({"name": model_name(form), "bytes": done.size, "surface": done.surface})
            warnings += [text for text in done.warnings if text not in warnings]
        return {"written": written, "warnings": warnings}

    def report(self, aside: Path, report: Report) -> dict[str, Any]:
        """``report.html``."""
        from nrsfm.viewing.report import REPORT, Sources, make_report, read_run, write_report

        truth = self.truth
        sources = Sources(
            tracks=self.tracks,
            truth=None if truth is None else truth.shapes,
            valid=None if truth is None else truth.valid,
            faces=self.faces,
            surface="neighbouring pixels of the reference frame",
            colours=self.colours,
            unit="px",
        )
        fps = min(max(self.facts["track"]["fps"], 0.1), 1000.0)
        with single_thread():
            text = make_report(read_run(self._folder), sources, title=self._wishes.title, fps=fps, report=report)
        return {"bytes": write_report(text, aside / REPORT)}

    @cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        from nrsfm.files.container import open_arrays

        entries = open_arrays(self._folder / TRACKS)
        names = ("pixels", "colours", "faces", "deviation")
        return {name: entries[name].read() for name in names if name in entries}  # old tracks have no deviations

    @cached_property
    def tracks(self) -> Tracks:
        """Of the first stage."""
        from nrsfm.files import load_tracks

        return load_tracks(self._folder / TRACKS)

    @property
    def faces(self) -> np.ndarray:
        """Triangles between neighbouring pixels."""
        return self._arrays["faces"]

    @property
    def colours(self) -> np.ndarray:
        """(P, 3) uint8 of the reference frame."""
        return self._arrays["colours"]

    @cached_property
    def result(self) -> Reconstruction:
        """Of the second stage."""
        from nrsfm.reconstruction import load_reconstruction

        return load_reconstruction(self._folder / RECONSTRUCTION)

    @cached_property
    def truth(self) -> Truth | None:
        """True shapes of the points, where there were some to score against."""
        from nrsfm.cli.reconstruct import load_truth

        if not self.facts.get("score", {}).get("shapes"):
            return None
        return load_truth(str(self._folder / TRUTH), self._wishes.truth_frame)

    def config(self, command: str, threads: int, files: dict[str, dict[str, Any]]) -> dict[str, Any]:
        """What ``config.json`` says, from what the stages told; ``files`` are identities by name."""
        asked, about = self._wishes, self.facts["track"]
        told = self.facts.get("reconstruct", {})
        named = {name: {k: known[k] for k in ("path", "bytes", "sha256")} for name, known in files.items()}
        return {
            "command": command,
            "video": named["video"] | {name: about[name] for name in ("frames", "size", "fps")},
            "mask": named.get("mask", asked.mask),
            "tracking": {name: about[name] for name in ("method", "step", "points", "reference")} | asked.tracking,
            "tracks": named[TRACKS] | {"frames": about["frames"], "points": about["points"]},
            "cameras": "estimated",
            "truth": named.get(TRUTH),
            "truth_of_the_video": named.get("truth"),
            "method": asked.method,
            "seed": asked.seed,
            "threads": threads,
            **({"faces": told["faces"]} if told.get("faces") else {}),
            "options": told.get("options", {}),
            "versions": versions(),
        }


def model_name(form: str) -> str:
    """The file, or folder, that an export is written to."""
    from nrsfm.export.options import FORMATS

    extensions = FORMATS[form].extensions
    return f"model{extensions[0]}" if extensions else f"model-{form}"
