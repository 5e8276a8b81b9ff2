"""Warnings in plain words, each with what it means for the result and what can be done.

Source: ours.
"""

from __future__ import annotations

import dataclasses

from nrsfm.reconstruction import Reconstruction
from nrsfm.viewing.viewer.notes import notes_of

# The beginning or a part of a warning, and what to do about it.
_ADVICE = (
    (
        "mirror image",
        "If what is near looks far in the player, run the command again with --mirror added.",
    ),
    (
        "hardly turn",
        "Depth comes from seeing the object from different sides. Trust the front view; a video that goes further "
        "around the object, or known cameras (--cameras), would help.",
    ),
    (
        "taken for outliers",
        "Such measurements are usually lost or swapped tracks. If true ones were doubted, --no-outliers keeps all.",
    ),
    (
        "entries are missing",
        "Shapes in frames and parts that were rarely seen rest on the others. Colour the player by confidence "
        "to see which.",
    ),
    ("are not reconstructed", "They are left out of everything below. Tracks that last longer would bring them back."),
    ("not reconstructed, and not shown", "They are left out of everything below."),
    ("all points lie on one line", "Leave those frames out, or expect their depth to be wrong."),
    ("is ignored", "The option had no effect; it can be left out."),
    ("has no solution", "The result is flat. Look at the tracks first: do they move at all?"),
    ("few for a completion", "Leave that frame out, or expect its shape to be that of its neighbours."),
)


@dataclasses.dataclass(frozen=True)
class Warned:
    """A warning and advice, which may be empty."""

    text: str
    advice: str


def warnings_of(result: Reconstruction, more: tuple[str, ...] = ()) -> list[Warned]:
    """Return the warnings of a reconstruction, and ``more`` of the caller's."""
    found = [note["text"] for note in notes_of(result, "", more) if note["kind"] == "warning"]
    return [Warned(text, next((advice for part, advice in _ADVICE if part in text), "")) for text in found]
