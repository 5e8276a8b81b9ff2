"""What a viewer of a shape must know before believing it, in plain words.

Source: ours.
"""

from __future__ import annotations

from typing import Any

from nrsfm.reconstruction import Reconstruction

CONVEX = "convex towards the camera"
_BY = {
    "intrinsics": "the perspective in the tracks, with the known intrinsics",
    "perspective": "the perspective in the tracks",
}
_MISSING = "not reconstructed"
_MIRROR_WARNING = "which of the two mirror images"


def notes_of(result: Reconstruction, surface: str, warnings: tuple[str, ...] = ()) -> list[dict[str, str]]:
    """Return notes, each with ``kind`` ("warning" or "fact") and ``text``; warnings come first."""
    found = [str(text) for text in result.diagnostics.get("warnings") or []]
    notes = [{"kind": "warning", "text": sentence(text)} for text in (*found, *warnings)]
    if result.n_missing and not any(_MISSING in text for text in found):
        count = f"{result.n_missing:,} point{'s were' if result.n_missing > 1 else ' was'}"
        notes.insert(0, {"kind": "warning", "text": f"{count} not reconstructed, and not shown."})
    mirror = _mirror(result.diagnostics)
    if mirror and not (mirror["kind"] == "warning" and any(text.startswith(_MIRROR_WARNING) for text in found)):
        notes.append(mirror)
    if result.confidence is not None:
        doubted = float((result.confidence[:, result.reconstructed] < 0.5).mean())
        if doubted > 0:
            share = "less than 0.1" if doubted < 1e-3 else f"{100 * doubted:.1f}"
            notes.append({"kind": "fact", "text": f"{share}\u00a0% of the measurements were missing or not believed."})
    if surface:
        notes.append({"kind": "fact", "text": f"Surface: {surface}."})
    return notes


def _mirror(diagnostics: dict[str, Any]) -> dict[str, str] | None:
    """Which of the two mirror images is shown, and why; ``None`` where nothing is recorded."""
    if diagnostics.get("mirrored"):
        return {"kind": "fact", "text": "This is the other one of the two mirror images, as was asked for."}
    cameras = diagnostics.get("cameras")
    found = diagnostics.get("mirror") or (cameras.get("mirror") if isinstance(cameras, dict) else None)
    if not isinstance(found, dict) or "rule" not in found:
        return None
    rule = str(found["rule"])
    if not found.get("decided"):
        return {
            "kind": "warning",
            "text": "Which of the two mirror images in depth is shown is arbitrary: the tracks cannot tell them apart.",
        }
    if rule == CONVEX:
        return {
            "kind": "fact",
            "text": "The shape and its mirror image in depth explain the tracks equally well; shown is the one that "
            "bulges towards the camera.",
        }
    by = _BY.get(rule, rule)
    return {"kind": "fact", "text": f"Which of the two mirror images in depth is shown was decided by {by}."}


def sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    text = " ".join(text.split())
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else text + "."
