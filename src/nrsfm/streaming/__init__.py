"""Tracks and shapes that are larger than memory: read, worked on and written in blocks of points."""
