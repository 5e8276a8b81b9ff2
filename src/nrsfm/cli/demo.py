"""``nrsfm demo``: the main job on a built-in sequence: generate, reconstruct, score, draw."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

from nrsfm.cli import running
from nrsfm.cli.arguments import Parser
from nrsfm.cli.inputs import Inputs
from nrsfm.cli.scores import Truth
from nrsfm.progress import Report


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    from nrsfm.datasets.synthetic import CAMERAS, face_sequence

    parser = Parser(
        prog="nrsfm demo",
        usage="nrsfm demo [--out DIR] [--method M] [options]",
        description="Reconstruct a generated face from its 2D tracks alone, score it and draw the result.",
    )
    parser.add_argument("--out", default="demo-output", metavar="DIR", help="[default: demo-output]")
    parser.add_argument("--frames", type=int, default=99, metavar="N", help="[default: 99]")
    parser.add_argument("--points", type=int, default=28_880, metavar="N", help="[default: 28880]")
    parser.add_argument("--camera", choices=tuple(CAMERAS), default="fast", help="camera path [default: fast]")
    parser.add_argument("--noise", type=float, default=0.0, metavar="X", help="noise / max |W| [default: 0]")
    parser.add_argument("--known-cameras", action="store_true", help="give the true cameras to the method")
    given, job = running.parse(parser, words)

    def load(report: Report) -> Inputs:
        report("generating", None)
        settings: dict[str, Any] = {
            "frames": given.frames,
            "points": given.points,
            "camera": given.camera,
            "noise": given.noise,
            "seed": job.seed,
        }
        sequence = face_sequence(**settings)
        tracks = sequence.tracks
        record = {
            "tracks": {
                "sequence": "face",
                **settings,
                "sha256": hashlib.sha256(tracks.points.tobytes()).hexdigest(),
            },
            "cameras": "true" if given.known_cameras else "estimated",
            "truth": "generated",
        }
        return Inputs(
            tracks=tracks,
            rotations=sequence.rotations if given.known_cameras else None,
            truth=None if sequence.shapes is None else Truth(sequence.shapes, sequence.valid, sequence.rotations),
            record=record,
            faces=sequence.faces,
            edges=sequence.edges,
            mesh=sequence.faces,
            unit="px",
        )

    return running.run("demo", job, load)
