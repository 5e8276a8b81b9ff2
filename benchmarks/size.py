"""Any size: tracks from a file and shapes into a file, what grows with the number of points, and with what else."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks import quiet, size_long, store, targets
from benchmarks.children import KEEPS_MEMORY, TIMED_THREADS, TaskError
from benchmarks.size_data import Size
from benchmarks.size_kept import NOT_MEASURED, KeptPart, kept_parts
from benchmarks.size_parts import (
    ACTOR,
    CELLS,
    FEW,
    GIGA,
    MANY,
    METHOD,
    MILLIONS,
    PARTS,
    ROUNDS,
    SPEED,
    SVD_ROUNDS,
    VERTICES,
    scratch,
)
from benchmarks.tables import Check, Fact, amount, error, table

TITLE = "Any size"
_GROWS = 1.25, 0.005  # a stage grows with the points where it takes so many times as long, and so many seconds more


def measure(context: store.Context) -> dict[str, Any]:
    """Every part, one after the other; what is kept and holds is not measured again."""
    store.data_folder()
    digest = store.code_digest()
    before = store.read("size")
    records: dict[str, Any] = before["values"]["records"] if before else {}
    for name, part in PARTS.items():
        kept = records.get(name, {})
        if not context.wanted(name) or (kept.get("code") == digest and "error" not in kept and not context.fresh):
            continue
        watch = quiet.Watch.start()
        with scratch() as folder:
            try:
                found = part(Path(folder))
            except TaskError as failure:
                found = {"error": str(failure)}
        records[name] = found | {"code": digest, "date": store.today(), "others": watch.others()}
        store.write("size", _values(records))  # what is done stays done if the rest is interrupted
    return _values(records)


def _values(records: dict[str, Any]) -> dict[str, Any]:
    known = [r["others"] for r in records.values() if r["others"] is not None]
    return {"records": records, "others": max(known) if known else None, "threads": TIMED_THREADS}


def _part(values: dict[str, Any], name: str) -> dict[str, Any] | None:
    record: dict[str, Any] | None = values["records"].get(name)
    return None if record is None or "error" in record else record


def _whole(row: dict[str, Any]) -> float:
    """Seconds until the shapes are on the disk."""
    return float(row["seconds"][0] + row["flush"])


def _words(size: Size) -> str:
    return f"{size.points:,} × {size.frames}"


def _actor_checks(part: dict[str, Any] | None) -> list[Check]:
    seconds = peak = gap = None
    if part:
        large, small = part["large"], part["small"]
        seconds, peak = _whole(large), large["peak_bytes"] / GIGA
        gap = 100 * abs(large["errors"]["per-frame"] / small["errors"]["per-frame"] - 1)
    what = _words(ACTOR)
    return [
        Check(f"{what}, from file to file", seconds, targets.SIZE_SECONDS, " s"),
        Check(f"{what}: peak memory", peak, targets.SIZE_MEMORY, " GB"),
        Check(f"{what}: difference of the error from that of {VERTICES.points:,} points", gap, targets.SIZE_ERROR, "%"),
    ]


def _stage_medians(row: dict[str, Any]) -> dict[str, float]:
    """Median seconds of every stage, and of what is in none."""
    rounds = [s | {"the rest": w - sum(s.values())} for s, w in zip(row["stages"], row["seconds"], strict=True)]
    return {name: median(one.get(name, 0.0) for one in rounds) for name in rounds[0]}


def _growing(part: dict[str, Any]) -> dict[str, float]:
    """Median seconds of each stage that grows with the points, at the larger size; the method's own apart."""
    few, many = _stage_medians(part["few"]), _stage_medians(part["many"])
    times, more = _GROWS
    return {
        name: seconds
        for name, seconds in many.items()
        if name != METHOD and seconds > max(times * few.get(name, 0.0), few.get(name, 0.0) + more)
    }


def _iteration(row: dict[str, Any]) -> float:
    return float(median(stages[METHOD] for stages in row["stages"]) / row["iterations"])


def _growth_checks(part: dict[str, Any] | None) -> list[Check]:
    passes = iteration = None
    if part:
        passes = sum(_growing(part).values()) / median(part["many"]["gram"])
        iteration = _iteration(part["many"]) / _iteration(part["few"])
    grows = f"{FEW.points:,} → {MANY.points:,} points, {MANY.frames} frames: time of an iteration"
    return [
        Check(f"{_words(MANY)}: what grows with the points / one W·Wᵀ", passes, targets.SIZE_PASS, "×"),
        Check(grows, iteration, targets.SCALING_ITERATION, "×"),
    ]


def _millions_checks(part: dict[str, Any] | None) -> list[Check]:
    peak = part["large"]["peak_bytes"] / GIGA if part else None
    return [Check(f"{_words(MILLIONS)}: peak memory", peak, targets.SIZE_BUDGET, " GB")]


def _speed_checks(part: dict[str, Any] | None) -> list[Check]:
    ratio = None
    if part:
        (run,) = part["runs"].values()
        ratio = median(run["seconds"]) / median(part["svd"])
    return [Check(f"29,299 × 99, 3% noise, `{METHOD}`: time / one dense SVD", ratio, targets.SIZE_SVD, "×")]


def checks(values: dict[str, Any]) -> list[Check | Fact]:
    """Time, memory and error of the largest sequence, ten million points, growth, the SVD, and a long sequence.

    What the page says of a part that was not measured here still counts.
    """
    before = kept_parts(TITLE)
    found: list[Check | Fact] = []
    for name, one in PAGE_PARTS.items():
        numbers = one.checks(_part(values, name))
        known = before.get(one.title) if name not in values["records"] else None
        found += known.checks(numbers) if known else numbers
    return found


def render(values: dict[str, Any]) -> list[str]:
    """The targets, then every measurement."""
    lines = [
        "A blendshape face whose quads are subdivided, or sampled anywhere, moving as in a real take; clean float32 "
        f"tracks, cameras estimated, `{METHOD}` with {CELLS['spatial_cells']} cells, all other options at their "
        f"defaults unless said otherwise, {values['threads']} threads, each measurement in a process of its own. "
        "'From file to file': the tracks are a memory-mapped `.npy` that is not in the system's cache, the shapes go "
        "to a `.npy`, and the clock stops when the disk has them. Peak memory is the peak resident size of the whole "
        "process, touched pages of mapped files included; 1 GB is 10⁹ bytes. e3D is per frame, all points.",
        "",
        *table(["", "target"], [[check.what, check.cell()] for check in checks(values)]),
    ]
    before = kept_parts(TITLE)
    for name, one in PAGE_PARTS.items():
        lines += [f"### {one.title}", "", *_part_lines(values, name, before.get(one.title)), ""]
    return lines


def _part_lines(values: dict[str, Any], name: str, before: KeptPart | None) -> list[str]:
    """One part: its own numbers; else those of the page, unless it was tried here and failed."""
    part = _part(values, name)
    if part:
        return [f"Measured {part['date']}. {quiet.sentence(part['others'])}", "", *PAGE_PARTS[name].render(part)[:-1]]
    if before and name not in values["records"]:
        return before.noted()
    return [NOT_MEASURED]


def _render_whole(part: dict[str, Any]) -> list[str]:
    rows = [part[name] for name in ("large", "small") if name in part]
    head = ["points × frames", "from file to file, s", "of these flushing", "s per 10⁹ numbers of tracks", "peak, GB"]
    head += ["e3D", "one alignment", "stages, s"]
    return table(head, (_whole_cells(row) for row in rows)) + _references(rows[:1])


def _whole_cells(row: dict[str, Any]) -> list[str]:
    size, seconds = Size(**row["size"]), _whole(row)
    return [
        f"{_words(size)}{_memory_words(row)}",
        amount(seconds),
        amount(row["flush"]),
        amount(seconds / (2e-9 * size.points * size.frames)),
        f"{row['peak_bytes'] / GIGA:.2f}",
        error(row["errors"]["per-frame"]),
        error(row["errors"]["global"]),
        _stages(row),
    ]


def _memory_words(row: dict[str, Any]) -> str:
    memory = row["options"].get("memory")
    return f", `memory='{memory}'`" if memory else ""


def _stages(row: dict[str, Any]) -> str:
    return ", ".join(f"{name} {amount(seconds)}" for name, seconds in _stage_medians(row).items() if seconds >= 0.005)


def _references(rows: Iterable[dict[str, Any]]) -> list[str]:
    lines = []
    for row in rows:
        size = Size(**row["size"])
        lines.append(
            f"References in the process of {_words(size)}: reading the file {amount(row['read'])} s, one float64 "
            f"`W @ W.T` {amount(median(row['gram']))} s, one SVD of 297 × 29,299 {amount(median(row['svd']))} s."
        )
    return [*lines, ""]


def _render_growth(part: dict[str, Any]) -> list[str]:
    few, many, growing = _stage_medians(part["few"]), _stage_medians(part["many"]), _growing(part)
    names = sorted(many, key=lambda name: -many[name])
    rows = [
        [
            "method: its iterations" if name == METHOD else name,
            f"{few.get(name, 0.0):.3f}",
            f"{many[name]:.3f}",
            "yes" if name in growing else "",
        ]
        for name in names
    ]
    virtual = " → ".join(f"{part[name]['virtual_points']:,}" for name in ("few", "many"))
    lines = [
        f"In memory, `deviation=False`, medians of {ROUNDS} rounds; a stage grows where it takes more than "
        f"{_GROWS[0]:g} times as long. What grows takes {sum(growing.values()):.2f} s at "
        f"{_words(MANY)}, beside {median(part['many']['gram']):.2f} s for one float64 `W @ W.T` of the same tracks. An "
        f"iteration takes {1e3 * _iteration(part['few']):.2f} → {1e3 * _iteration(part['many']):.2f} ms ({virtual} "
        f"virtual points).{_fresh(part)}",
        "",
        *table(["stage, seconds", _words(FEW), _words(MANY), "grows"], rows),
        "The same tracks from file to file:",
        "",
    ]
    return lines + _render_whole({"large": part["file"]})


def _fresh(part: dict[str, Any]) -> str:
    """Which memory the process works in, and what the same stages take otherwise; earlier records do not tell."""
    if "fresh" not in part:
        return ""
    medians = _stage_medians(part["fresh"])
    settings = ", ".join(f"`{name}={value}`" for name, value in KEEPS_MEMORY.items())
    return (
        f" The process keeps the memory that it has freed ({settings}); otherwise the same stages take "
        f"{sum(medians.get(name, 0.0) for name in _growing(part)):.2f} s: the system gives "
        f"{12e-9 * MANY.points * MANY.frames:.1f} GB of new memory for the shapes."
    )


def _render_speed(part: dict[str, Any]) -> list[str]:
    (run,) = part["runs"].values()
    seconds, svd = run["seconds"], part["svd"]
    return [
        f"`{SPEED}`, 29,299 × 99, 3% noise, all options at their defaults ({run['cells']} cells): median "
        f"{median(seconds):.2f} s ({min(seconds):.2f} to {max(seconds):.2f}), beside {median(svd):.2f} s "
        f"({min(svd):.2f} to {max(svd):.2f}) for one SVD of 297 × 29,299; {SVD_ROUNDS} rounds in one process.",
        "",
    ]


def _render_grid(part: dict[str, Any]) -> list[str]:
    head = ["points", "frames", "K", "method", "seconds", "peak, GB", "above libraries, GB", "virtual points"]
    head += ["iterations", "e3D", "reading the file, s", "one `W @ W.T`, s", "one SVD, s"]
    rows = [_grid_cells(row) for row in part["rows"]]
    lines = [
        "Seconds and memory with one thing changed at a time, from file to file, `deviation=False`; methods without "
        "cells have K 1.",
        "",
    ]
    return lines + table(head, rows)


def _grid_cells(row: dict[str, Any]) -> list[str]:
    size = Size(**row["size"])
    return [
        f"{size.points:,}",
        str(size.frames),
        str(row["cells"]),
        f"`{row['method']}`",
        f"{_whole(row):.2f}",
        f"{row['peak_bytes'] / GIGA:.2f}",
        f"{(row['peak_bytes'] - row['baseline_bytes']) / GIGA:.2f}",
        f"{row['virtual_points']:,}",
        str(row["iterations"]),
        error(row["errors"]["per-frame"]),
        f"{row['read']:.2f}",
        f"{median(row['gram']):.3f}",
        f"{median(row['svd']):.2f}",
    ]


@dataclasses.dataclass(frozen=True)
class PagePart:
    """A part on the page: its heading, its targets (without a number where it has no record), its tables."""

    title: str
    checks: Callable[[dict[str, Any] | None], list[Check]]
    render: Callable[[dict[str, Any]], list[str]]


PAGE_PARTS = {
    "actor": PagePart("As large as the largest capture", _actor_checks, _render_whole),
    "ten-million": PagePart("Ten million points", _millions_checks, _render_whole),
    "growth": PagePart("What grows with the number of points", _growth_checks, _render_growth),
    "speed": PagePart("Beside one dense SVD", _speed_checks, _render_speed),
    "long": PagePart("Thousands of frames", size_long.checks, size_long.render),
    "grid": PagePart("Points, frames, cells and methods", lambda _: [], _render_grid),
}
