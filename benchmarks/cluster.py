"""Many machines: what the passes over the points send, counted, beside the formula; and 10⁹ points on paper."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from benchmarks import store
from benchmarks.cluster_messages import Problem, formula, simulate
from benchmarks.cluster_paper import paper
from benchmarks.tables import Check, Fact, table
from nrsfm.streaming.stream import SAMPLE

TITLE = "Many machines"
PROBLEMS = (
    Problem(frames=40, points=20_000, cells=5, workers=2),
    Problem(frames=40, points=20_000, cells=5, workers=8),
    Problem(frames=80, points=40_000, cells=10, workers=8),
    Problem(frames=80, points=40_000, cells=2, workers=32),
    Problem(frames=20, points=80_000, cells=50, workers=64),
)
_APART = 5.0  # percent between the bytes that were counted and the formula's: small messages have an envelope


def measure(context: store.Context) -> dict[str, Any]:
    """Count the messages of every problem: nothing is timed."""
    return {"rows": [_row(problem) for problem in PROBLEMS]}


def _row(problem: Problem) -> dict[str, Any]:
    counts, virtual = simulate(problem)
    expected = formula(problem, virtual, min(SAMPLE, problem.points))
    found = {
        name: {kind: [len(sizes), sum(sizes)] for kind, sizes in count.messages.items()}
        for name, count in counts.items()
    }
    wanted = {
        name: {kind: [number, number * each] for kind, (number, each) in kinds.items()}
        for name, kinds in expected.items()
    }
    depth = max(counts["first"].depth, counts["second"].depth)
    return {"problem": asdict(problem), "virtual": virtual, "found": found, "formula": wanted, "depth": depth}


def _total(kinds: dict[str, dict[str, list[float]]]) -> float:
    return sum(size for messages in kinds.values() for _, size in messages.values())


def _apart(row: dict[str, Any]) -> float:
    """Percent between all bytes counted and the formula's, and between those of each kind of sum: the largest."""
    pairs = [(_total(row["found"]), _total(row["formula"]))]
    for name in ("first", "second"):
        pairs += [(row["found"][name][kind][1], row["formula"][name][kind][1]) for kind in ("sum", "whole")]
    return max(100 * abs(found / wanted - 1) for found, wanted in pairs)


def _same_numbers(row: dict[str, Any]) -> bool:
    """Whether there were as many messages of each kind, and as many moves one after the other, as there should be."""
    found, wanted = (
        {name: {kind: round(number) for kind, (number, _) in kinds.items()} for name, kinds in row[side].items()}
        for side in ("found", "formula")
    )
    return found == wanted and row["depth"] == math.ceil(math.log2(row["problem"]["workers"]))


def checks(values: dict[str, Any]) -> list[Check | Fact]:
    """Bytes, and numbers of messages."""
    rows = values["rows"]
    agreed = sum(_same_numbers(row) for row in rows)
    return [
        Check("cluster: bytes sent, counted, against the formula", max(map(_apart, rows)), _APART, "%"),
        Fact(
            "cluster: numbers of messages, and the tree's depth",
            agreed == len(rows),
            f"as the formula says in {agreed} of {len(rows)}",
        ),
    ]


def render(values: dict[str, Any]) -> list[str]:
    """The counts, then the design on paper that they bear out."""
    return [
        "The real passes on workers that are only names: every message is serialised as dask sends it, and counted "
        "(`benchmarks/cluster_messages.py`). One thread a worker; tracks and shapes in files. 'Sums' go from worker to "
        "worker up the tree, 'to the caller' are the whole sums, the sample and the labels; 'to the workers' is what "
        "each is told, and the labels. Beside the formula, which is in [cluster](cluster.md), each message has an "
        "envelope of about half a kB.",
        "",
        *table(["", "target"], [[check.what, check.cell()] for check in checks(values)]),
        *table(
            _HEAD,
            map(_cells, values["rows"]),
        ),
        "**10⁹ points × 10³ frames by the same formula**",
        "",
        *paper(),
    ]


_HEAD = ["frames", "points", "cells", "workers", "sums, MB", "formula", "to the caller, MB", "formula"]
_HEAD += ["to the workers, MB", "formula", "moves in a row"]
_GROUPS = ("sum",), ("own", "whole"), ("job", "labels")


def _cells(row: dict[str, Any]) -> list[str]:
    problem = Problem(**row["problem"])
    cells = [str(problem.frames), f"{problem.points:,}", str(problem.cells), str(problem.workers)]
    for kinds in _GROUPS:
        for side in ("found", "formula"):
            size = sum(messages[kind][1] for messages in row[side].values() for kind in kinds if kind in messages)
            cells.append(f"{size / 1e6:.3f}")
    return [*cells, str(row["depth"])]
