"""The closing lines of a run."""

from __future__ import annotations

from collections.abc import Sequence
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
    before: Sequence[tuple[str, str]] = (),
) -> str:
    """Return size, choices, scores, times and warnings of a run, after the lines ``before``.

    What the diagnostics lack is left out.
    """
    lines = [
        *before,
        ("size", f"{result.n_frames} frames, {result.n_points} points"),
        ("method", _method(result)),
        ("resumed", ", ".join(result.diagnostics.get("taken_from_checkpoint", []))),
        ("tracks", repair_text(result)),
        ("cameras", _cameras(result.diagnostics.get("cameras", {}))),
        ("mirror", mirror_text(result.diagnostics)),
        ("rank", str(result.diagnostics.get("chosen", {}).get("rank", ""))),
        ("groups", "" if result.groups is None else str(len(set(result.groups[result.reconstructed].tolist())))),
    ]
    if found is not None:
        known = result.diagnostics.get("cameras", {}).get("known", True)
        # Estimated cameras leave the object's frame free: without an alignment the number would say nothing.
        lines += score_lines(found, skip=() if known else ("none",))
    lines.append(("seconds", ", ".join(f"{stage} {value:.2f}" for stage, value in seconds.items())))
    lines += [("warning", text) for text in warnings]
    lines.append(("output", str(out)))
    return columns((name, text) for name, text in lines if text)


def repair_text(result: Reconstruction) -> str:
    """Say what real tracks lacked: missing entries, outliers, points without a shape; nothing of clean ones."""
    repair = result.diagnostics.get("repair")
    repair = repair if isinstance(repair, dict) else {}
    total = result.n_frames * result.n_points
    missing, outliers = repair.get("missing"), repair.get("outliers")
    if missing is None and result.confidence is not None:
        missing = result.confidence.size - int((result.confidence > 0).sum())
    parts = []
    if missing:
        parts.append(f"{missing} of {total} entries missing ({_percent(missing / total)})")
    if outliers:
        parts.append(f"{outliers} outlier{'s' if outliers != 1 else ''} ({_percent(outliers / total)})")
    if result.n_missing:
        parts.append(f"{result.n_missing} of {result.n_points} points not reconstructed")
    return ", ".join(parts)


def mirror_text(diagnostics: dict[str, Any]) -> str:
    """Say by which rule one of the two mirror images was chosen, as far as the diagnostics tell."""
    cameras = diagnostics.get("cameras")
    found = diagnostics.get("mirror") or (cameras.get("mirror") if isinstance(cameras, dict) else None)
    if isinstance(found, str):
        return found
    if not isinstance(found, dict) or not found.get("rule"):
        return ""
    return f"{found['rule']}{'' if found.get('decided', True) else ', which does not decide here'}"


def _percent(share: float) -> str:
    """One digit after the point, and never 0.0 % or 100.0 % of what is some but not all."""
    if 0 < share < 0.0005:
        return "< 0.1 %"
    if 0.9995 <= share < 1:
        return "> 99.9 %"
    return f"{100 * share:.1f} %"


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
