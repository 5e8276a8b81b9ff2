"""Tracks, true shapes and known cameras from files, and tracks to files: the formats of docs/formats.md."""

from __future__ import annotations

from nrsfm.files.container import known_extensions
from nrsfm.files.describing import describe
from nrsfm.files.loading import ORDERS, Truth, load_rotations, load_shapes, load_tracks
from nrsfm.files.saving import save_tracks

__all__ = [
    "ORDERS",
    "Truth",
    "describe",
    "known_extensions",
    "load_rotations",
    "load_shapes",
    "load_tracks",
    "save_tracks",
]
