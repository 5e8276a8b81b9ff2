"""An interactive viewer of a reconstruction, in the browser: a small WebGL page and the server that it comes from.

The browser gets every frame once, as 16-bit numbers, and keeps it on the graphics card: playing is then a matter of
choosing a buffer, whatever the server does meanwhile. The page is a few files without dependencies; the server answers
this machine only, and only with these files and the numbers that :class:`Content` makes.

Source: ours.
"""

from __future__ import annotations

from nrsfm.viewing.viewer.content import Content, make_content
from nrsfm.viewing.viewer.pictures import Pictures, open_pictures
from nrsfm.viewing.viewer.server import HOST, ViewServer

__all__ = ["HOST", "Content", "Pictures", "ViewServer", "make_content", "open_pictures"]
