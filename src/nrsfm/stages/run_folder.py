"""The output folder of a run: the names of what it holds."""

from __future__ import annotations

RECONSTRUCTION, CONFIG, METRICS, LOG = "reconstruction.npz", "config.json", "metrics.json", "log.txt"
PICTURES = ("overview", "shapes", "error", "uncertainty", "groups", "convergence", "tracks")
OUTPUT_NAMES = (RECONSTRUCTION, CONFIG, METRICS, LOG, *(f"{name}.png" for name in PICTURES))
"""All that a reconstruction writes, and so all that overwriting an output may delete."""
REPORT = "report.html"
"""What ``nrsfm report`` adds: of the old run, so overwriting deletes it as well."""
