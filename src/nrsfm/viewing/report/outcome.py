"""The sections of a report on what came out: fit, shapes from several sides, errors, uncertainty.

Source: ours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from nrsfm.viewing.report.charts import Line, line_chart
from nrsfm.viewing.report.folder import Run
from nrsfm.viewing.report.markup import Child, Html, el, number, percent, plural, prose, relative, table
from nrsfm.viewing.report.measures import Deformation, Errors, Fit
from nrsfm.viewing.report.pictures import SideView
from nrsfm.viewing.report.sections import section

_ALIGN = {
    "none": ("none", "shapes as they are; says little where cameras were estimated"),
    "global": ("one turn", "one rotation or reflection for the whole sequence"),
    "per-frame": ("each frame turned", "a rotation or reflection for each frame: the shape alone"),
    "similarity": ("each frame turned and scaled", "a scale for each frame too: where units differ"),
}
_VARIES = 0.03  # change over frames, relative, that is worth a chart
_OUTSTANDING = 3.0  # a frame that fits worse than the median by this factor is named


def cards(rows: Sequence[tuple[str, str, str]]) -> Html:
    """Return the key figures: name, value, what it is."""
    items = [
        el("div", el("dt", name), el("dd", el("span", value, class_="figure"), el("span", words, class_="words")))
        for name, value, words in rows
    ]
    return el("dl", items, class_="cards")


def key_figures(
    run: Run, fit: Fit | None, errors: Errors | None, deviation: np.ndarray | None, deformed: Deformation, unit: str
) -> Html:
    """Return what a reader wants to know first."""
    rows = []
    if fit is not None:
        rows.append(
            (
                "Reprojection",
                f"{number(fit.overall)}{_unit(unit)}",
                "distance of the tracks from what the cameras see (root mean square)",
            )
        )
    found = (run.metrics or {}).get("shape_error")
    if errors is not None:
        mean = float(np.nanmean(errors.values))
        rows.append(("Error e3D", relative(mean), f"against the truth, {_ALIGN[errors.align][0]}"))
    elif isinstance(found, dict) and isinstance(found.get("per-frame"), int | float):
        rows.append(("Error e3D", relative(float(found["per-frame"])), "against the truth, each frame turned"))
    if deviation is not None:
        middle = float(np.median(deviation[1]))
        rows.append(
            (
                "Depth",
                f"± {number(middle, 2)}{_unit(unit)}",
                f"typical uncertainty, {percent(middle / deformed.size)} of the object's size",
            )
        )
    turn = run.result.diagnostics.get("cameras")
    turn = turn.get("turn") if isinstance(turn, dict) else None
    if isinstance(turn, int | float):
        rows.append(("Camera turn", f"{number(float(turn))}°", "how far around the object was seen"))
    rows.append(("Deformation", percent(deformed.relative), "of the object's size (root mean square)"))
    seconds = run.result.diagnostics.get("seconds")
    if isinstance(seconds, dict) and seconds and len(rows) < 5:
        rows.append(("Time", f"{number(sum(map(float, seconds.values())))} s", "from tracks to shapes"))
    return cards(rows)


def how_it_fits(run: Run, fit: Fit | None, missing: str, unit: str) -> Html:
    """Return the section on the reprojection error."""
    if fit is None:
        return section("fit", "Reprojection error", el("p", prose(missing), class_="note"))
    if not fit.entries:
        return section("fit", "Reprojection error", el("p", "No measurement was believed.", class_="note"))
    known = np.isfinite(fit.rms)
    typical, worst = float(np.median(fit.rms[known])), int(np.nanargmax(fit.rms))
    words = [
        f"Over {fit.entries:,} measurements the root mean square distance between the tracks and the shapes, seen by "
        f"their cameras, is {number(fit.overall)}{_unit(unit)}."
    ]
    noise = run.result.diagnostics.get("noise")
    if isinstance(noise, int | float) and noise > 0:
        words.append(
            f" The noise that was estimated in the tracks makes {number(math.sqrt(2.0) * float(noise))}{_unit(unit)} "
            "of it by itself, in the two coordinates together."
        )
    if fit.perspective:
        words.append(" The full perspective camera is used.")
    if fit.left_out:
        words.append(f" {plural(fit.left_out, 'measurement')} that were not believed do not count.")
    if float(fit.rms[worst]) > _OUTSTANDING * typical > 0:
        words.append(
            f" Frame {worst} fits worst, with {number(float(fit.rms[worst]))}{_unit(unit)}: look at its tracks."
        )
    words.append(
        " A small error says that the tracks are explained, not that depths are right: those are under Uncertainty."
    )
    label = f"Reprojection error of each frame, typically {number(typical)}{_unit(unit)}"
    lines = [Line(fit.rms, "root mean square")]
    if fit.median is not None and fit.most is not None:
        lines += [Line(fit.median, "median"), Line(fit.most, "95 % are below")]
    chart = line_chart(lines, label=label, x_name="frame", over_frames=True)
    name = "error of each frame" + (f", {unit}" if unit else ", in the tracks' unit")
    return section(
        "fit",
        "Reprojection error",
        el("div", el("p", words), el("figure", el("figcaption", name), chart, class_="panel"), class_="pair"),
    )


def from_several_sides(views: Sequence[SideView]) -> Html:
    """Return the section with the pictures."""
    frames = list(dict.fromkeys(view.frame for view in views))
    rows = [
        el(
            "figure",
            el("figcaption", f"frame {frame}", class_="frame"),
            el("div", [_side(view) for view in views if view.frame == frame], class_="sides"),
        )
        for frame in frames
    ]
    return section(
        "sides",
        "From several sides",
        el(
            "p",
            f"The {plural(len(frames), 'frame')} in which the shape differs most; the front is where the cameras are "
            "on average.",
        ),
        el("div", rows, class_="gallery"),
    )


def _side(view: SideView) -> Html:
    return el("figure", view.picture, el("figcaption", view.side))


def with_scale(picture: Html, high: float, words: str, unit: str) -> Html:
    """Return a coloured picture with what its colours mean."""
    ends = [el("span", "0"), el("span", f"≥ {number(high)}{_unit(unit)}")]
    ramp = el("div", el("span", class_="ramp"), el("div", ends, class_="ends"), class_="scale")
    return el("figure", el("figcaption", words), picture, ramp, class_="panel")


def against_the_truth(run: Run, errors: Errors | None, missing: str, picture: Html | None) -> Html | None:
    """Return the section on errors, or ``None`` where there is no truth."""
    metrics = run.metrics
    if metrics is None and errors is None:
        return None
    metrics = metrics or {}
    content: list[Child] = []
    found = metrics.get("shape_error")
    if isinstance(found, dict):
        rows = [
            [_ALIGN.get(name, (name, ""))[0], relative(float(value)), _ALIGN.get(name, ("", ""))[1]]
            for name, value in found.items()
            if isinstance(value, int | float)
        ]
        made = el(
            "table",
            el("caption", "Relative error e3D, mean over frames"),
            el(
                "thead",
                el(
                    "tr",
                    el("th", "aligned by", scope="col"),
                    el("th", "error", scope="col", class_="number"),
                    el("th", "meaning", scope="col"),
                ),
            ),
            el(
                "tbody",
                [el("tr", el("th", a, scope="row"), el("td", b, class_="number"), el("td", c)) for a, b, c in rows],
            ),
        )
        content.append(el("div", made, class_="wide", tabindex="0", role="region", aria_label="Errors"))
    facts = []
    if isinstance(metrics.get("rotation_error_degrees"), int | float):
        facts.append(f"The cameras are off by {number(float(metrics['rotation_error_degrees']))}° on average.")
    total = int(metrics.get("frames") or 0) * int(metrics.get("points") or 0)
    if total and int(metrics.get("scored_entries") or total) < total:
        facts.append(
            f"Scored are {metrics['scored_entries']:,} of {total:,} points in frames: of the others the truth, or the "
            "shape, is not known."
        )
    if facts:
        content.append(el("p", " ".join(facts)))
    if errors is None and missing:
        content.append(el("p", prose(missing), class_="note"))
    if errors is None:
        return section("truth", "Against the truth", content)
    worst = int(np.nanargmax(errors.values))
    label = f"Error of each frame, largest in frame {worst}"
    chart = line_chart([Line(100.0 * errors.values)], label=label, x_name="frame", over_frames=True)
    words = f"error e3D of each frame in %, {_ALIGN[errors.align][0]}; largest in frame {worst}"
    content.append(el("figure", el("figcaption", words), chart, class_="panel"))
    return section("truth", "Against the truth", el("div", el("div", content), picture, class_="pair"))


def how_certain(run: Run, deviation: np.ndarray | None, deformed: Deformation, unit: str, picture: Html | None) -> Html:
    """Return the section on the depths' standard deviation."""
    if deviation is None:
        text = "The uncertainty of the depths was not estimated: it was switched off, or the result was made elsewhere."
        return section("uncertainty", "Uncertainty of the depths", el("p", text, class_="note"))
    middle = float(np.median(deviation[1]))
    words: list[str] = [
        f"Tracks fix two coordinates of a point; its depth is left to the model. Its standard deviation is typically "
        f"{number(middle)}{_unit(unit)}, {percent(middle / deformed.size)} of the object's size."
    ]
    found = run.result.diagnostics.get("uncertainty")
    parts = _parts(found if isinstance(found, dict) else {}, unit)
    if parts:
        words.append(f" It is made of {parts}.")
    words.append(" Colour the player by depth deviation to see where it is large.")
    calibration = (run.metrics or {}).get("depth_calibration")
    content: list[Child] = [el("p", words)]
    if isinstance(calibration, dict) and isinstance(calibration.get("within_1"), float):
        one, two = float(calibration["within_1"]), float(calibration["within_2"])
        rows = [["within one deviation", percent(one), "68.3 %"], ["within two", percent(two), "95.4 %"]]
        content.append(table(["true depths", "here", "normal errors"], rows, "Checked against the truth"))
        if two < 0.85:
            content.append(
                el("p", "Errors are larger here than the deviations say: they are too small.", class_="note")
            )
        elif one > 0.9:
            content.append(
                el("p", "Errors are smaller here than the deviations say: they err on the safe side.", class_="note")
            )
    if float(np.ptp(deviation[1])) > _VARIES * middle:
        label = f"Standard deviation of the depths in each frame, typically {number(middle)}"
        line = Line(deviation[1], "median", band=deviation[[0, 2]])
        chart = line_chart([line], label=label, x_name="frame", over_frames=True)
        name = "median over the points of each frame; 5 to 95 % of them shaded" + (f"; {unit}" if unit else "")
        content.append(el("figure", el("figcaption", prose(name)), chart, class_="panel"))
    else:
        content.append(el("p", "It is the same in every frame, as far as can be told."))
    return section("uncertainty", "Uncertainty of the depths", el("div", el("div", content), picture, class_="pair"))


def _parts(found: dict[str, Any], unit: str) -> str:
    names = {
        "exchange": "what the tracks leave open",
        "missing": "deformation that is likely missing in depth",
        "noise": "noise of the tracks",
        "mean": "the mean shape, where the camera hardly turns",
    }
    parts = [
        f"{name} ({number(float(found[key]), 2)}{_unit(unit)})"
        for key, name in names.items()
        if isinstance(found.get(key), int | float) and found[key] > 0
    ]
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _unit(unit: str) -> str:
    return f" {unit}" if unit else ""
