"""A player of moving shapes for web pages that open without a network: markup, style, script and data, all inline.

:func:`pack` makes the data of a reconstruction, small enough to be part of a page; :func:`markup`, :func:`style` and
:func:`script` give the rest. The script is ours and needs nothing but a browser with WebGL 2; without that, and on
paper, a picture stands in.
"""

from __future__ import annotations

from nrsfm.viewing.player.pack import Packed, pack
from nrsfm.viewing.player.parts import markup, script, style

__all__ = ["Packed", "markup", "pack", "script", "style"]
