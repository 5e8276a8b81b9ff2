"""What a run chose and why, in plain words: from the diagnostics of a reconstruction alone.

Each entry is left out where the diagnostics do not hold what it is about, so that reconstructions of other versions,
or made by hand, have reports too.

Source: ours; the rules themselves are in the modules that choose.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.report.markup import Child, number, percent, plural, table
from nrsfm.viewing.report.measures import Deformation
from nrsfm.viewing.viewer.notes import sentence


@dataclasses.dataclass(frozen=True, eq=False)
class Choice:
    """One choice: what it is about, what was chosen, why; and a table of what was compared, or ``None``."""

    name: str
    value: str
    why: str
    compared: Child = None
    compared_name: str = ""


_START = {
    "low rank": "shapes of low rank",
    "trajectories": "Gaussian trajectories",
    "closed form": "the closed form",
    "smooth motion": "smooth motion",
}
_GAUGE = {
    "cameras": ("the cameras' own", "The estimated cameras move steadily enough: they say how the object is turned."),
    "mean": ("the mean shape's", "Every shape is turned onto the mean shape, which leaves the steadier camera path."),
    "even": (
        "an even turn",
        "The cameras are so near to an even turn about one axis that this is the simpler account.",
    ),
    "steady": (
        "a steadier camera",
        "The cameras jerked whenever the object deformed, so part of the deformation was in them; it was given back.",
    ),
    "method": ("the method's", "The method estimates cameras together with shapes, and its own are kept."),
}


def choices(result: Reconstruction, deformed: Deformation, unit: str = "") -> list[Choice]:
    """Return all choices that the diagnostics tell of, in the order of the pipeline."""
    found = result.diagnostics
    made = [
        _method(result),
        _repair(result, _dict(found, "repair")),
        _noise(found, unit),
        _cameras(result, _dict(found, "cameras"), result.options),
        _rank(result, deformed),
        _groups(result),
        _mirror(found),
        _gauge(_dict(found, "gauge")),
        _perspective(_dict(found, "perspective")),
        _compression(_dict(found, "compression")),
    ]
    return [choice for choice in made if choice is not None]


def _dict(found: dict[str, Any], name: str) -> dict[str, Any]:
    value = found.get(name)
    return value if isinstance(value, dict) else {}


def _method(result: Reconstruction) -> Choice | None:
    if not result.method:
        return None
    from nrsfm.methods import get_method, method_names

    if result.method not in method_names():
        return Choice("Method", result.method, "")
    method = get_method(result.method)
    why = f"{sentence(method.summary)} It assumes: {method.assumes}."
    judged = _dict(_dict(result.diagnostics, "chosen"), "judged")
    start = _dict(result.diagnostics, "chosen").get("start")
    compared = None
    if start in _START:
        why += f" The shapes began from {_START[start]}"
        why += ", the most likely beginning of those compared." if len(judged) > 1 else "."
    if len(judged) > 1:
        rows = [
            [_START.get(name, name), number(value, 7)] for name, value in sorted(judged.items(), key=lambda p: -p[1])
        ]
        compared = table(["beginning", "log-likelihood"], rows)
    return Choice("Method", f"{method.title} – {result.method}", " ".join(why.split()), compared, "Beginnings compared")


def _repair(result: Reconstruction, found: dict[str, Any]) -> Choice | None:
    if not found:
        return None
    missing, outliers = int(found.get("missing") or 0), int(found.get("outliers") or 0)
    total = result.n_frames * result.n_points
    if not missing and not outliers and not result.n_missing:
        return Choice(
            "Repair", "nothing to repair", "Every point was seen in every frame, and no measurement was doubted."
        )
    parts, why = [], []
    if missing:
        parts.append(f"{percent(missing / total)} missing")
        why.append("What was not seen was completed from the points and frames that move alike.")
    if outliers:
        parts.append(f"{percent(outliers / total)} outliers")
        number_of = found.get("outlier_points")
        where = f" in {plural(int(number_of), 'point')}" if number_of else ""
        where += f" ({percent(outliers / max(total - missing, 1))} of those seen)"
        why.append(
            f"{plural(outliers, 'measurement')}{where} disagree with all others and were not believed; they were "
            "replaced by what the others predict."
        )
    if result.n_missing:
        parts.append(f"{plural(result.n_missing, 'point')} left out")
        why.append(
            f"Points seen in fewer than {found.get('least_frames', 'enough')} frames have no shape: it would be "
            "invented."
        )
    if found.get("rank") and found.get("held_out_error") is not None:
        why.append(
            f"The completion has rank {found['rank']}: of the ranks tried it predicts measurements best that were held "
            f"out, to {number(found['held_out_error'])}."
        )
    ladder = found.get("ladder")
    compared = None
    if isinstance(ladder, list) and len(ladder) > 1 and all(isinstance(row, list) and len(row) == 3 for row in ladder):
        rows = [[str(row[0]), number(row[1]), number(row[2])] for row in ladder]
        compared = table(["rank", "held-out error", "noise of the model"], rows)
    return Choice("Repair", ", ".join(parts), " ".join(why), compared, "Ranks tried")


def _noise(found: dict[str, Any], unit: str) -> Choice | None:
    level = found.get("noise")
    if not isinstance(level, int | float):
        return None
    if level <= 0:
        return Choice("Noise", "none found", "The tracks are as exact as the compression tells apart.")
    why = "Standard deviation of a coordinate, estimated from the tracks" + ("." if unit else ", in their unit.")
    return Choice("Noise", f"{number(level)} {unit}".rstrip(), why)


def _cameras(result: Reconstruction, found: dict[str, Any], options: dict[str, Any]) -> Choice | None:
    if not found:
        return None
    if found.get("known"):
        return Choice("Cameras", "given", "The rotations were given, and were not changed.")
    rows = [row for row in found.get("candidates") or [] if isinstance(row, dict)]
    rank, path = found.get("rank"), found.get("path")
    value = f"estimated, with {plural(int(rank), 'basis shape')}" if rank else "estimated"
    if isinstance(found.get("turn"), int | float):
        value += f"; turning by {number(found['turn'])}°"
    why = []
    if options.get("camera_rank") is not None:
        why.append(f"The number of basis shapes, {options['camera_rank']}, was given.")
    elif len(rows) > 1:
        why.append(
            f"{len(rows)} candidates were compared by the shapes they imply. Those that need much more deformation "
            "than the best were rejected; of the others the one whose deformation falls off most sharply was kept, and "
            "among equals the one with the most basis shapes."
        )
    if path == "orbit":
        why.append("The camera goes around evenly, so that an even turn replaces the path frame by frame.")
    scales = result.scales
    spread = float(scales.max() / scales.min()) - 1.0
    if spread > 1e-3:
        why.append(
            f"The object's size in the image changes by up to {percent(spread)}: each frame has a scale of its own."
        )
    else:
        why.append("One scale holds for all frames.")
    compared = None
    if len(rows) > 1:
        cells = [
            [str(row.get("K", "")), str(row.get("start", "")), number(row.get("cost")), number(row.get("norm"), 4),
             number(row.get("log"), 5), "✓" if row.get("chosen") else ""]
            for row in rows
        ]  # fmt: skip
        compared = table(
            ["K", "start", "metric cost", "deformation", "fall (log)", "chosen"], cells, "Candidates for the cameras"
        )
    return Choice("Cameras", value, " ".join(why), compared, "Candidates compared")


def _rank(result: Reconstruction, deformed: Deformation) -> Choice:
    own = _dict(result.diagnostics, "chosen").get("rank")
    modes = deformed.modes
    if deformed.relative == 0.0:
        return Choice("Rank", "rigid", "The shape is the same in every frame.")
    why = (
        f"The deformation is {percent(deformed.relative)} of the object's size. {modes[0]} of its directions hold 90 % "
        f"of it (in mean squares), {modes[1]} hold 99 %, {modes[2]} hold 99.9 %."
    )
    if own is not None:
        return Choice("Rank", str(own), f"Shape directions that the method kept in the end. {why}")
    setting = result.options.get("rank")
    if setting is not None:
        return Choice("Rank", str(setting), f"Given. {why}")
    return Choice("Rank", "not limited", f"This method cuts no rank: likely shapes are preferred, not forced. {why}")


def _groups(result: Reconstruction) -> Choice:
    if result.groups is None:
        return Choice("Groups", "none", "This method treats all points alike.")
    labels, sizes = np.unique(result.groups[result.reconstructed], return_counts=True)
    chosen = _dict(result.diagnostics, "chosen")
    number_of = chosen.get("spatial_cells")
    cells = f" {plural(number_of, 'cell')} of neighbours were" if isinstance(number_of, int) else " They were"
    why = (
        f"Parts of the surface that each move in a subspace of their own.{cells} grouped by how alike their subspaces "
        f"are; the groups have {sizes.min():,} to {sizes.max():,} points."
    )
    return Choice("Groups", plural(len(labels), "group"), why)


def _mirror(found: dict[str, Any]) -> Choice | None:
    rule = _dict(found, "mirror") or _dict(_dict(found, "cameras"), "mirror")
    if found.get("mirrored"):
        return Choice(
            "Mirror",
            "the other image, as asked",
            "Depth and its mirror image explain orthographic tracks equally well.",
        )
    if not rule.get("rule"):
        return None
    if not rule.get("decided"):
        return Choice(
            "Mirror",
            "arbitrary",
            "Orthographic tracks cannot tell a shape from its mirror image in depth, and this shape bulges neither way "
            "clearly. If what is near looks far, run it again with --mirror.",
        )
    if rule["rule"] == "convex towards the camera":
        agreement = rule.get("agreement")
        share = f" in {percent(agreement)} of the frames" if isinstance(agreement, float) else ""
        return Choice(
            "Mirror",
            "bulging towards the camera",
            "Orthographic tracks cannot tell a shape from its mirror image in depth. Outsides are nearer in the "
            f"middle than at the rim, and this image is so{share}. It is a convention: for a hollow, give --mirror.",
        )
    by = "with the known intrinsics" if rule["rule"] == "intrinsics" else "in the tracks"
    return Choice(
        "Mirror", "decided by perspective", f"Near things look larger: the perspective {by} tells the two images apart."
    )


def _gauge(found: dict[str, Any]) -> Choice | None:
    chosen = found.get("chosen")
    if not chosen:
        return None
    value, why = _GAUGE.get(str(chosen), (str(chosen), ""))
    moved = found.get("moved")
    if isinstance(moved, float) and moved > 0.05:
        why += f" The frames were turned by {number(moved, 2)}° (root mean square)."
    return Choice(
        "Object frame",
        value,
        f"{why} This splits the motion between object and camera; depths stay as they are.".strip(),
    )


def _perspective(found: dict[str, Any]) -> Choice | None:
    if not found:
        return None
    gains = found.get("gains") if isinstance(found.get("gains"), dict) else {}
    compared = None
    if gains and len(gains) > 1:
        rows = sorted(((float(k), float(v)) for k, v in gains.items() if v is not None), key=lambda pair: pair[0])
        compared = table(["strength", "gain in log-likelihood"], [[number(k), number(v)] for k, v in rows])
    if not found.get("undone"):
        reason = str(found.get("reason", ""))
        if reason == "off":
            return Choice(
                "Perspective", "not looked for", "It was switched off, or cameras were given without intrinsics."
            )
        return Choice(
            "Perspective",
            "none undone",
            f"{sentence(reason)} Each frame is seen in parallel." if reason else "",
            compared,
            "Strengths compared",
        )
    focal = found.get("focal")
    value = f"undone, focal length {number(focal, 4)} pixels" if focal else "undone"
    why = "A model with perspective explains the tracks better, so its effect was taken out of them."
    if isinstance(found.get("strength"), float):
        why += f" The object's size (root mean square) is {percent(abs(found['strength']))} of its distance."
    if found.get("affine_rms") is not None and found.get("perspective_rms") is not None:
        why += (
            f" Through the full camera {number(found['perspective_rms'])} pixels are left, of parallel rays "
            f"{number(found['affine_rms'])}, which bend the perspective into the shapes."
        )
    return Choice("Perspective", value, why, compared, "Strengths compared")


def _compression(found: dict[str, Any]) -> Choice | None:
    if not found.get("virtual_points"):
        return None
    points, virtual, cells = (int(found.get(key) or 0) for key in ("points", "virtual_points", "cells"))
    if virtual >= points:
        return Choice("Compression", "none", "The method works on every point.")
    why = f"{points:,} points in {plural(cells, 'cell')} became {virtual:,} virtual ones that hold the same motion"
    cut = found.get("discarded")
    why += f"; what was cut is {number(float(cut), 2)} of the tracks' size." if isinstance(cut, float) else "."
    return Choice(
        "Compression", f"{points / virtual:.0f} times fewer points" if points / virtual >= 1.5 else "slight", why
    )
