"""The parts of a page that the player is made of, as text: markup, style sheet and script."""

from __future__ import annotations

import base64
import html
import json
from functools import cache
from importlib import resources

from nrsfm.viewing.player.bundle import bundle
from nrsfm.viewing.player.pack import Packed

_KEYS = (
    (("space",), "play, pause"),
    (("←", "→"), "one frame; with shift ten"),
    (("Home", "End"), "first, last frame"),
    (("↑", "↓"), "faster, slower"),
    (("1", "…", "9"), "colour"),
    (("S", "P", "L"), "surface, points, lines"),
    (("F",), "object or camera stands still"),
    (("C",), "cameras"),
    (("A", "D", "W", "X"), "turn"),
    (("Z",), "nearer; with shift farther"),
    (("O",), "parallel or central rays"),
    (("U",), "upside down"),
    (("+", "−"), "larger, smaller points"),
    (("R",), "view as at the beginning"),
)
_ICON = '<svg viewBox="0 0 24 24" aria-hidden="true">{}</svg>'


@cache
def style() -> str:
    """Return the style sheet; it uses the page's variables for colours."""
    return (resources.files(__package__) / "page" / "player.css").read_text(encoding="utf-8")


@cache
def script() -> str:
    """Return the script for the end of the page: the player and those modules of the viewer that it needs."""
    return bundle("player", _module)


def _module(name: str) -> str:
    own = resources.files(__package__) / "page" / f"{name}.js"
    shared = resources.files("nrsfm.viewing.viewer") / "page" / f"{name}.js"
    return (own if own.is_file() else shared).read_text(encoding="utf-8")


def markup(packed: Packed, poster: str, alternative: str) -> str:
    """Return the player as HTML, data included.

    ``poster`` is the address of the picture that stands in for the player, a ``data:`` address for a page without
    others; ``alternative`` says in words what it shows.
    """
    # "<" would end the data block early if it stood before "/script": in JSON it can be written otherwise.
    about = json.dumps(packed.about, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    numbers = base64.b64encode(packed.data).decode("ascii")
    keys = "".join(
        f"<div><dt>{' '.join(f'<kbd>{html.escape(key)}</kbd>' for key in names)}</dt><dd>{html.escape(text)}</dd></div>"
        for names, text in _KEYS
    )
    icons = {
        "back": _ICON.format('<path d="M7 5v14M19 5l-9 7 9 7z"/>'),
        "next": _ICON.format('<path d="M17 5v14M5 5l9 7-9 7z"/>'),
        "play": _ICON.format(
            '<path class="when-paused" d="M7 4l13 8-13 8z"/><path class="when-playing" d="M6 4h4v16H6zM14 4h4v16h-4z"/>'
        ),
    }
    return f"""<div class="player" id="player" role="group" aria-label="Player of the moving shape">
<div class="player-stage" data-part="stage">
<img src="{html.escape(poster)}" alt="{html.escape(alternative)}">
<canvas data-part="canvas" tabindex="0" role="application" \
aria-label="The moving shape in 3D: drag to turn it, arrow keys change the frame"></canvas>
<div class="player-legend" data-part="legend" hidden><span data-part="legend-name"></span>
<span class="player-ramp" data-part="legend-bar"></span><span data-part="legend-low"></span>
<span data-part="legend-high"></span></div>
<p class="player-message" data-part="message" role="status" hidden></p>
</div>
<div class="player-bar">
<button type="button" class="player-round" data-part="back" aria-label="One frame back">{icons["back"]}</button>
<button type="button" class="player-round player-main" data-part="play" aria-label="Play">{icons["play"]}</button>
<button type="button" class="player-round" data-part="next" aria-label="One frame on">{icons["next"]}</button>
<input type="range" data-part="scrub" min="0" max="{packed.about["frames"] - 1}" value="0" step="1" aria-label="Frame">
<output data-part="where"></output>
<select data-part="speed" aria-label="Speed"></select>
</div>
<div class="player-tools">
<div class="player-segments" data-part="shape" role="group" aria-label="Shape"></div>
<label>Colour <select data-part="colour"></select></label>
<div class="player-segments" data-part="reference" role="group" aria-label="What stands still"></div>
<button type="button" class="player-plain" data-part="cameras" aria-pressed="false">Cameras</button>
<button type="button" class="player-plain" data-part="reset">Reset view</button>
<details><summary>Keys</summary><dl>{keys}</dl></details>
</div>
<script type="application/json" id="player-about">{about}</script>
<script type="text/plain" id="player-data">{numbers}</script>
</div>"""
