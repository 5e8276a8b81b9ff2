"""The closing lines of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.cli.scores import score_lines
from nrsfm.cli.text import columns

if TYPE_CHECKING:
    from nrsfm.reconstruction import Reconstruction


def summary(
    result: Reconstruction,
    found: dict[str, Any] | None,
    seconds: dict[str, float],
    warnings: list[str],
    out: Path,
) -> str:
    """Return size, choices, scores, times and warnings of a run; what the diagnostics lack is left out."""
    lines = [
        ("size", f"{result.n_frames} frames, {result.n_points} points"),
        ("method", _method(result)),
        ("cameras", _cameras(result.diagnostics.get("cameras", {}))),
        ("rank", str(result.diagnostics.get("chosen", {}).get("rank", ""))),
        ("groups", "" if result.groups is None else str(len(set(result.groups.tolist())))),
    ]
    if found is not None:
        known = result.diagnostics.get("cameras", {}).get("known", True)
        # Estimated cameras leave the object's frame free: without an alignment the number would say nothing.
        lines += score_lines(found, skip=() if known else ("none",))
    lines.append(("seconds", ", ".join(f"{stage} {value:.2f}" for stage, value in seconds.items())))
    lines += [("warning", text) for text in warnings]
    lines.append(("output", str(out)))
    return columns((name, text) for name, text in lines if text)


def _method(result: Reconstruction) -> str:
    if "iterations" not in result.diagnostics:
        return result.method
    reason = result.diagnostics.get("stop_reason", "")
    return f"{result.method}, {result.diagnostics['iterations']} iterations, stopped by: {reason}"


def _cameras(found: dict[str, Any]) -> str:
    if not found:
        return ""
    if found.get("known"):
        return "given"
    parts = ["estimated"]
    if "rank" in found:
        parts.append(f"K = {found['rank']}")
    if "turn" in found:
        parts.append(f"turning by {found['turn']:.0f} degrees")
    return ", ".join(parts)
