"""``nrsfm datasets``: the benchmark sequences that can be read and which are here; rendered videos with their truth."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from nrsfm.cli.arguments import Parser
from nrsfm.cli.text import columns, to_json
from nrsfm.errors import OptionError

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from nrsfm.datasets import DatasetInfo

_OF_RENDERING = {"--out": "out", "--variant": "variant", "--size": "size", "--frames": "frames", "--seed": "seed"}


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm datasets",
        usage="nrsfm datasets [--data ROOT] [--json]\n       nrsfm datasets --render SCENE --out DIR [options]",
        description="List the sequences that nrsfm.datasets.load reads from a folder; or render a video of a moving\n"
        "surface, with masks and its true tracks and shapes. Nothing is downloaded.",
    )
    parser.add_argument("--data", metavar="ROOT", help="the folder [default: the variable NRSFM_DATA]")
    parser.add_argument("--json", action="store_true", help="JSON in place of text")
    group = parser.add_argument_group("rendering")
    group.add_argument("--render", metavar="SCENE", help="face, face-slow, sheet, flag, or one of the data folder")
    group.add_argument("--out", metavar="DIR", help="folder to make: video.mp4, masks, truth.npz")
    group.add_argument(
        "--variant", metavar="V", help="plain, realistic, discs, gaussian, salt-and-pepper [default: realistic]"
    )
    group.add_argument("--size", type=int, metavar="N", help="width and height in pixels [default: 480]")
    group.add_argument("--frames", type=int, metavar="N", help="[default: all that the scene has]")
    group.add_argument("--seed", type=int, metavar="N", help="[default: 0]")
    group.add_argument("--truth-step", type=int, default=2, metavar="N", help="pixels between true points [default: 2]")
    group.add_argument("--lossless", action="store_true", help="PNG images in place of a video")
    group.add_argument("--overwrite", action="store_true", help="replace a rendering of that name")
    group.add_argument("--quiet", action="store_true", help="no progress and no summary")
    given = parser.parse_strictly(words)
    if given.render is not None:
        return _render(given)
    for flag, name in _OF_RENDERING.items():
        if getattr(given, name) is not None:
            raise OptionError(f"option '{flag}' needs '--render SCENE' beside it; see {parser.prog} --help")

    from nrsfm.datasets import data_folder, table

    given_somewhere = given.data is not None or os.environ.get("NRSFM_DATA")
    folder = data_folder(given.data) if given_somewhere else None
    rows = [_row(info, folder) for info in table()]
    if given.json:
        print(to_json({"folder": None if folder is None else str(folder), "datasets": rows}))
        return 0
    print(columns((row["name"], _text(row)) for row in rows))
    print(f"\nfolder: {folder}" if folder else "\nno folder was given (--data, or the variable NRSFM_DATA)")
    return 0


def _render(given: argparse.Namespace) -> int:
    from nrsfm.datasets.render_files import FRAMES, MASKS, TRUTH, VIDEO, save_rendered
    from nrsfm.datasets.rendering import rendered
    from nrsfm.files.atomic import check_output_folder
    from nrsfm.progress import TerminalProgress, silent

    if given.out is None:
        raise OptionError("option '--render' needs '--out DIR' beside it")
    if given.seed is not None and given.seed < 0:
        raise OptionError(f"option '--seed' must be at least 0, received {given.seed}")
    check_output_folder(given.out, overwrite=given.overwrite, replaceable=(VIDEO, FRAMES, MASKS, TRUTH))
    with TerminalProgress() as line:
        report = silent if given.quiet else line
        report("rendering", None)
        asked = {name: getattr(given, name) for name in ("variant", "size", "seed", "frames")}
        made = rendered(given.render, given.data, **{n: value for n, value in asked.items() if value is not None})
        video = save_rendered(
            made,
            given.out,
            step=given.truth_step,
            lossless=given.lossless,
            overwrite=given.overwrite,
            report=report,
        )
    if not given.quiet:
        frames, height, width = made.masks.shape
        facts = {
            "video": str(video),
            "masks": str(video.parent / MASKS),
            "truth": str(video.parent / TRUTH),
            "frames": frames,
            "size": f"{width} x {height}",
            "reference": made.reference,
        }
        print(to_json(facts) if given.json else columns((name, str(value)) for name, value in facts.items()))
    return 0


def _row(info: DatasetInfo, folder: Path | None) -> dict[str, Any]:
    here = None if folder is None else all((folder / name).is_file() for name in info.files)
    return {**dataclasses.asdict(info), "here": here}


def _text(row: dict[str, Any]) -> str:
    here = {None: "", True: "here: ", False: "not here: "}[row["here"]]
    return f"{here}{row['frames']} x {row['points']}, {row['title']} ({row['licence']})"
