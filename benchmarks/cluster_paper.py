"""10⁹ points × 10³ frames on paper: bytes, operations, messages and time on a stated machine."""

from __future__ import annotations

import math
from dataclasses import dataclass

from benchmarks.cluster_messages import DIRECTIONS, Problem, formula
from benchmarks.tables import amount, table
from nrsfm.streaming.stream import SAMPLE

FRAMES, POINTS, CELLS = 1_000, 10**9, 50
VIRTUAL = 2_000  # virtual points; 786 were measured of 1,180,232 points in 346 frames
GIGA = 1e9


@dataclass(frozen=True)
class Machine:
    """Hosts, the tasks of each, and what a host reads, writes, sends and computes a second."""

    hosts: int
    tasks: int
    disk: float = 1e9
    network: float = 1.25e9
    core: float = 20e9  # float64 operations of one core in a matrix product


MACHINES = Machine(8, 32), Machine(64, 8), Machine(64, 32), Machine(512, 32)


def operations() -> dict[str, float]:
    """Floating-point operations of each pass: a multiplication and an addition are two."""
    rows = 2 * FRAMES
    rank = VIRTUAL / CELLS
    return {
        "first": 2.0 * rows**2 * POINTS,
        "second": 2.0 * rows**2 * POINTS + 2.0 * rows * DIRECTIONS * POINTS + 2.0 * CELLS * DIRECTIONS * POINTS,
        "third": 2.0 * rank * (2 * FRAMES + 3 * FRAMES) * POINTS,
    }


def moved() -> dict[str, tuple[float, float]]:
    """Bytes that each pass reads and writes, float32; deviations of depth are written too."""
    tracks, shapes, depths = 8.0 * FRAMES * POINTS, 12.0 * FRAMES * POINTS, 4.0 * FRAMES * POINTS
    return {"first": (tracks, 0.0), "second": (tracks, 0.0), "third": (tracks, shapes + depths)}


def sums() -> dict[str, float]:
    """Bytes of a sum that goes up the tree, and of the work that goes to each host in the third pass."""
    found = formula(Problem(FRAMES, POINTS, CELLS, 64), VIRTUAL, SAMPLE)
    return {
        "first": found["first"]["sum"][1],
        "second": found["second"]["sum"][1],
        "third": found["third"]["job"][1],
    }


def levels(machine: Machine) -> tuple[int, int]:
    """Additions one after the other, and how many of these are moves from host to host."""
    between = math.ceil(math.log2(machine.hosts))
    return 3 + math.ceil(math.log2(machine.tasks)) + between, between


def seconds(machine: Machine) -> dict[str, dict[str, float]]:
    """Of each pass: disk, arithmetic, and messages one after the other where they must be."""
    size = sums()
    _, between = levels(machine)
    everyone = machine.hosts * machine.tasks * machine.core
    caller = {"first": 8.0 * FRAMES * SAMPLE, "second": float(POINTS), "third": float(POINTS)}
    found = {}
    for name, (read, written) in moved().items():
        chain = size[name] * (machine.hosts if name == "third" else between + 1) + caller[name]
        found[name] = {
            "disk": (read + written) / (machine.hosts * machine.disk),
            "arithmetic": operations()[name] / everyone,
            "messages": chain / machine.network,
        }
    return found


def memory(machine: Machine) -> float:
    """Bytes of a host while sums are taken: each task's own, and two that wait or are made; blocks of half a GB."""
    return 3 * machine.tasks * sums()["second"] + 2**29


def paper() -> list[str]:
    """The tables."""
    size, work, data = sums(), operations(), moved()
    what = {"first": "Gram matrix", "second": "cells", "third": "expansion"}
    carries = {"first": "sum, worker to worker", "second": "sum, worker to worker", "third": "maps, to each host"}
    lines = table(
        ["pass", "read, TB", "written, TB", "operations", "largest message", "its size"],
        (
            [
                what[name],
                f"{data[name][0] / 1e12:g}",
                f"{data[name][1] / 1e12:g}",
                f"{work[name]:.1e}",
                carries[name],
                f"{size[name] / 1e9:.2g} GB",
            ]
            for name in what
        ),
    )
    rows = []
    for machine in MACHINES:
        depth, between = levels(machine)
        times = seconds(machine)
        row = [str(machine.hosts), str(machine.tasks), str(depth), str(between)]
        row += [f"{machine.hosts - 1} × {size['second'] / GIGA:.2g} GB", f"{memory(machine) / GIGA:.0f} GB"]
        for name in what:
            row.append(" + ".join(amount(times[name][part]) for part in ("disk", "arithmetic", "messages")))
        total = sum(max(t["disk"], t["arithmetic"]) + t["messages"] for t in times.values())
        whole = sum(sum(t.values()) for t in times.values())
        rows.append([*row, f"{total / 60:.0f} to {whole / 60:.0f}"])
    head = ["hosts", "tasks a host", "additions in a row", "of these moves", "sums sent in the second pass"]
    head += ["memory of a host", *(f"{what[name]}, s" for name in what), "minutes"]
    return lines + table(head, rows)
