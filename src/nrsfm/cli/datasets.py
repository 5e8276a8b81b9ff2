"""``nrsfm datasets``: the benchmark sequences that can be read, and which of them are on this machine."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from nrsfm.cli.arguments import Parser
from nrsfm.cli.text import columns, to_json

if TYPE_CHECKING:
    from pathlib import Path

    from nrsfm.datasets import DatasetInfo


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm datasets",
        usage="nrsfm datasets [--data ROOT] [--json]",
        description="List the sequences that nrsfm.datasets.load reads from a folder. Nothing is downloaded.",
    )
    parser.add_argument("--data", metavar="ROOT", help="the folder [default: the variable NRSFM_DATA]")
    parser.add_argument("--json", action="store_true", help="JSON in place of text")
    given = parser.parse_strictly(words)

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


def _row(info: DatasetInfo, folder: Path | None) -> dict[str, Any]:
    here = None if folder is None else all((folder / name).is_file() for name in info.files)
    return {**dataclasses.asdict(info), "here": here}


def _text(row: dict[str, Any]) -> str:
    here = {None: "", True: "here: ", False: "not here: "}[row["here"]]
    return f"{here}{row['frames']} x {row['points']}, {row['title']} ({row['licence']})"
