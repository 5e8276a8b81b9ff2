"""The sections of a report on what went in, what was chosen and how it ran.

Source: ours.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np

from nrsfm.viewing.measurements import measurements_of
from nrsfm.viewing.report.advice import Warned
from nrsfm.viewing.report.charts import Line, line_chart
from nrsfm.viewing.report.choices import Choice
from nrsfm.viewing.report.folder import Run
from nrsfm.viewing.report.markup import Child, Html, el, number, percent, plural, prose, table
from nrsfm.viewing.report.pictures import measurement_map, tracks_picture

_HISTORY = {
    "energy": "what the method minimises",
    "gap": "largest violation of the constraints",
    "rank": "singular values kept",
    "beta": "weight of the constraints",
    "noise": "noise allowed for, which is lowered step by step",
    "change": "relative change of the shapes in each step",
    "residual": "what the model leaves of the tracks",
    "cost": "what the method minimises",
}
_STOPPED = {
    "gap": "the constraints were met",
    "largest penalty": "the penalty reached its limit",
    "iteration limit": "the limit of iterations was reached",
    "exact": "the tracks were met exactly",
    "energy": "the energy fell no further",
    "shapes settled": "the shapes settled",
    "outliers settled": "the outliers settled",
    "not finite": "numbers became infinite; the result is that of the step before",
}


def section(name: str, title: str, *content: Child) -> Html:
    """Return a section with a heading that can be linked to."""
    return el("section", el("h2", title, id=name), *content, aria_labelledby=name)


def warned(found: Sequence[Warned]) -> Html:
    """Return the warnings, or that there are none."""
    if not found:
        return el("p", "No warnings.", class_="calm")
    title = "Warning" if len(found) == 1 else f"{len(found)} warnings"
    items = [
        el("li", el("p", prose(item.text)), el("p", prose(item.advice), class_="advice") if item.advice else None)
        for item in found
    ]
    return el("section", el("h2", title, id="warnings"), el("ul", items), class_="warnings", aria_labelledby="warnings")


def facts(rows: Sequence[tuple[str, Child]]) -> Html:
    """Return names and values."""
    return el("dl", [el("div", el("dt", name), el("dd", value)) for name, value in rows if value], class_="facts")


def more(title: str, *content: Child) -> Html:
    """Return something that opens when it is asked for."""
    return el("details", el("summary", title), *content)


def what_went_in(run: Run, tracks: Any, missing_tracks: str) -> Html:
    """Return the section on the input."""
    given = run.config.get("tracks")
    given = given if isinstance(given, dict) else {}
    result = run.result
    rows: list[tuple[str, Child]] = []
    if "path" in given:
        rows.append(("Tracks", el("code", given["path"])))
    elif "sequence" in given:
        words = f"generated: {given['sequence']}, camera path “{given.get('camera', '')}”"
        if given.get("noise"):
            words += f", noise {number(float(given['noise']))} of the largest coordinate"
        rows.append(("Tracks", words))
    rows.append(("Size", f"{plural(result.n_frames, 'frame')}, {plural(result.n_points, 'point')}"))
    if "missing" in given:
        total = result.n_frames * result.n_points
        lost = int(given["missing"])
        text = f"{lost:,} of {total:,} measurements ({percent(lost / total)})" if lost else "nothing"
        rows.append(("Not seen", text))
    for name, key in (("Cameras", "cameras"), ("Truth", "truth")):
        value = run.config.get(key)
        if isinstance(value, dict) and "path" in value:
            rows.append((name, el("code", value["path"])))
        elif isinstance(value, str):
            rows.append((name, value))
        elif key == "truth":
            rows.append((name, "none: errors cannot be told"))
    if run.config.get("faces"):
        rows.append(("Faces", str(run.config["faces"])))
    words = facts(rows)
    if tracks is None:
        return section(
            "input", "What went in", words, el("p", prose(missing_tracks), class_="note") if missing_tracks else None
        )
    frame, found = result.n_frames // 2, measurements_of(result, tracks)
    doubted = found.outlier[frame]
    words_of = f"Some of the tracks in frame {frame}, with their way over the frames before"
    words_of += "; red ones were not believed." if doubted.any() else "."
    picture = el("figure", tracks_picture(tracks, frame, doubted), el("figcaption", words_of), class_="panel")
    seen_map = None
    if found.remarkable:
        used = found.seen & ~found.outlier & ~found.lost
        kinds = [("used", percent(float(used.mean())), "seen")]
        if not found.seen.all():
            kinds.append(("not seen", percent(float((~found.seen).mean())), "unseen"))
        if found.outlier.any():
            kinds.append(("not believed", percent(float(found.outlier.mean())), "outlier"))
        if found.lost.any():
            kinds.append(("without a shape", plural(int(found.lost.sum()), "point"), "lost"))
        legend = el(
            "ul",
            [el("li", el("span", class_=f"key {kind}"), f"{name} {share}") for name, share, kind in kinds],
            class_="legend",
        )
        seen_map = el(
            "figure",
            measurement_map(found),
            legend,
            el(
                "figcaption",
                "Each measurement: frames to the right, points downwards, those hidden together next to each other.",
            ),
            class_="panel",
        )
    return section("input", "What went in", el("div", el("div", words, seen_map), picture, class_="pair"))


def what_was_chosen(found: Sequence[Choice]) -> Html:
    """Return the section on the choices."""
    rows = [
        el(
            "div",
            el("dt", choice.name),
            el(
                "dd",
                el("p", choice.value[:1].upper() + choice.value[1:], class_="value"),
                el("p", prose(choice.why), class_="why") if choice.why else None,
                more(choice.compared_name, choice.compared) if choice.compared else None,
            ),
        )
        for choice in found
    ]
    return section("choices", "What was chosen, and why", el("dl", rows, class_="choices"))


def convergence(run: Run) -> Html | None:
    """Return the section on the iterations, or ``None`` where none are recorded."""
    found = run.result.diagnostics
    history = found.get("history")
    series: dict[str, np.ndarray] = {}
    for name, values in (history if isinstance(history, dict) else {}).items():
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            continue
        if array.ndim == 1 and np.isfinite(array).any():
            series[str(name)] = array
    count = found.get("iterations")
    if not series and not isinstance(count, int):
        return None
    reason = str(found.get("stop_reason", ""))
    words = f"{plural(count, 'iteration')}" if isinstance(count, int) else ""
    if reason:
        words += f"; it stopped because {_STOPPED.get(reason, reason)}" if words else f"Stopped: {reason}"
    charts = []
    for name, array in series.items():
        known = array[np.isfinite(array)]
        label = (
            f"{name} over the iterations, {number(float(known[0]))} at first and {number(float(known[-1]))} in the end"
        )
        picture = line_chart(
            [Line(array)],
            label=label,
            x_name="iteration",
            first=1,
            steps=name == "rank",
            from_zero=name != "energy" or float(known.min()) >= 0,
            small=True,
        )
        text = el(
            "figcaption",
            el("span", el("strong", name), el("span", number(float(known[-1])), class_="last"), class_="line"),
            el("span", _HISTORY.get(name, ""), class_="line"),
        )
        charts.append(el("figure", text, picture, class_="panel"))
    return section(
        "convergence", "Convergence", el("p", f"{words}.") if words else None, el("div", charts, class_="charts")
    )


def how_it_ran(run: Run) -> Html:
    """Return the section with the command, times, options, versions and the log."""
    config = run.config
    content: list[Child] = []
    command = config.get("command")
    if command:
        content += [
            el("p", "The command, to be run in the folder in which it was run:"),
            el(
                "div",
                el(
                    "pre",
                    el("code", folded(str(command)), id="command"),
                    tabindex="0",
                    role="region",
                    aria_label="Command",
                ),
                el("button", "Copy", type="button", data_copy="command", hidden=True),
                class_="command",
            ),
        ]
        words = ["It gives the same result with the same input, versions and number of threads"]
        if config.get("threads"):
            words.append(f" ({config['threads']}; --threads sets it)")
        content.append(el("p", prose("".join(words)), ".", class_="note"))
    else:
        content.append(
            el(
                "p",
                "This folder has no config.json, which would hold the command: the result was made from Python.",
                class_="note",
            )
        )
    inputs = [
        (name, config[key]) for name, key in (("tracks", "tracks"), ("cameras", "cameras"), ("truth", "truth"))
        if isinstance(config.get(key), dict)
    ]  # fmt: skip
    if inputs:
        rows = [
            [
                name,
                el("code", str(value.get("path", value.get("sequence", "")))),
                f"{value['bytes']:,}" if isinstance(value.get("bytes"), int) else "",
                el("code", str(value.get("sha256", ""))),
            ]
            for name, value in inputs
        ]
        content.append(
            more("Input files and their digests", table(["input", "file", "bytes", "SHA-256"], rows, text=4))
        )
    seconds = run.result.diagnostics.get("seconds")
    if isinstance(seconds, dict) and seconds:
        content.append(more(f"Time: {number(sum(map(float, seconds.values())))} seconds", _bars(seconds)))
    options = config.get("options") or run.result.options
    if isinstance(options, dict) and options:
        rows = [
            [el("code", str(name)), "chosen from the data" if value is None else str(value)]
            for name, value in sorted(options.items())
        ]
        seed = config.get("seed", run.result.options.get("seed"))
        if seed is not None and "seed" not in options:
            rows.append([el("code", "seed"), str(seed)])
        content.append(more(f"All {len(rows)} options", table(["option", "value"], rows, text=2)))
    versions = config.get("versions")
    if isinstance(versions, dict) and versions:
        content.append(
            more("Versions", table(["program", "version"], [[str(k), str(v)] for k, v in versions.items()], text=2))
        )
    if run.log:
        content.append(more("Log", el("pre", run.log, tabindex="0", role="region", aria_label="Log")))
    return section("repeat", "Repeat it", content)


def folded(command: str) -> str:
    """The command with a line for each option, as a shell takes it."""
    try:
        words = shlex.split(command)
    except ValueError:
        return command
    lines: list[list[str]] = [[]]
    for word in words:
        if word.startswith("--") and len(lines[0]) > 1:
            lines.append([])
        lines[-1].append(shlex.quote(word))
    if len(command) <= 72 or len(lines) < 2:
        return " ".join(shlex.quote(word) for word in words)
    return " \\\n  ".join(" ".join(line) for line in lines)


def _bars(seconds: dict[str, Any]) -> Html:
    total = max(sum(float(value) for value in seconds.values()), 1e-12)
    rows = []
    for name, value in sorted(seconds.items(), key=lambda pair: -float(pair[1])):
        share = float(value) / total
        bar = el(
            "svg",
            el("rect", x=0, y=0, width=f"{100 * share:.2f}", height=8, rx=2),
            viewBox="0 0 100 8",
            preserveAspectRatio="none",
            class_="bar",
            aria_hidden="true",
        )
        rows.append([name, bar, f"{float(value):.2f} s", percent(share)])
    return table(["stage", "", "time", "share"], rows, text=2)
