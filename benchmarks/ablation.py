"""What each part is worth: parts switched off one by one, and sweeps of the sizes that a user may set."""

from __future__ import annotations

from typing import Any

from benchmarks import targets
from benchmarks.runs import Case, Data, run_cases
from benchmarks.store import Context
from benchmarks.tables import error, table

TITLE = "What each part is worth"
_MEASURES = ("per_frame",)
Options = tuple[tuple[str, Any], ...]

# A method, what is changed in it, and how.
_PARTS: tuple[tuple[str, str, Options], ...] = (
    ("geometry-aware", "defaults", ()),
    ("geometry-aware", "no spatial subspaces", (("spatial", False),)),
    ("geometry-aware", "no grouping", (("grouping", False),)),
    ("geometry-aware", "no projection", (("projection", False),)),
    ("geometry-aware", "no denoising", (("denoise", False),)),
    ("geometry-aware", "plain nuclear norm", (("reweight", 0.0),)),
    ("geometry-aware", "plain norm, no denoising", (("reweight", 0.0), ("denoise", False))),
    ("grassmann", "defaults", ()),
    ("grassmann", "no spatial subspaces", (("spatial", False),)),
    ("grassmann", "no temporal subspaces", (("temporal", False),)),
    ("grassmann", "neither", (("spatial", False), ("temporal", False))),
    ("grassmann", "no grouping", (("grouping", False),)),
    ("grassmann", "no denoising", (("denoise", False),)),
    ("grassmann", "plain nuclear norm", (("reweight", 0.0),)),
    ("grassmann", "plain norm, no denoising", (("reweight", 0.0), ("denoise", False))),
    ("bmm", "defaults", ()),
    ("bmm", "no denoising", (("denoise", False),)),
)
_SWEPT_METHOD = "geometry-aware"
_SWEPT_SEQUENCES = ("face-seq1", "face-seq3", "ict-rom99")
_SWEEPS: tuple[tuple[str, str, tuple[Any, ...]], ...] = (
    ("spatial_dimension", "p, dimension of the spatial subspaces", (None, 2, 4, 6, 9, 12, 15, 20)),
    ("spatial_cells", "K_s, cells of points", (None, 2, 5, 10, 20, 30, 50, 100)),
    ("spatial_groups", "groups of cells", (None, 2, 5, 10, 20, 30)),
)
_NOISES = (0.0, targets.NOISE)


def _options(name: str, value: Any) -> Options:
    return () if value is None else ((name, value),)


def _case(sequence: str, noise: float, method: str, options: Options) -> Case:
    return Case(Data(sequence, noise), method, "known", options)


def measure(context: Context) -> dict[str, Any]:
    """Parts on all sequences, sweeps on three; known cameras, clean and 3% noise with seed 0."""
    cases = [
        _case(sequence, noise, method, options)
        for sequence in sorted(targets.SEQUENCES, key=lambda name: name[-1] in "12")
        for noise in _NOISES
        for method, _, options in _PARTS
    ]
    cases += [
        _case(sequence, noise, _SWEPT_METHOD, _options(name, value))
        for sequence in _SWEPT_SEQUENCES
        for noise in _NOISES
        for name, _, values in _SWEEPS
        for value in values
    ]
    return run_cases("ablation", dict.fromkeys(cases), _MEASURES, context)


def checks(values: dict[str, Any]) -> list[Any]:
    """None: these numbers have no targets."""
    return []


def render(values: dict[str, Any]) -> list[str]:
    """One table of parts, one for each sweep."""
    records = values["records"]

    def cell(sequence: str, noise: float, method: str, options: Options) -> str:
        record = records.get(_case(sequence, noise, method, options).key, {})
        return "failed" if "error" in record else error(record.get("per_frame"))

    lines = [
        "e3D with each frame aligned on its own, known cameras; noise 3%, seed 0. 'Plain nuclear norm' is "
        "`reweight=0`, 'no denoising' is `denoise=False`.",
        "",
    ]
    head = [f"{s}{', noise' if n else ''}" for n in _NOISES for s in targets.SEQUENCES]
    rows = [
        [f"`{method}`", what, *(cell(s, n, method, options) for n in _NOISES for s in targets.SEQUENCES)]
        for method, what, options in _PARTS
    ]
    lines += table(["method", "", *head], rows)
    head = [f"{s}{', noise' if n else ''}" for n in _NOISES for s in _SWEPT_SEQUENCES]
    for name, title, swept in _SWEEPS:
        lines += [f"**`{name}`** ({title}), `{_SWEPT_METHOD}`", ""]
        rows = []
        for value in swept:
            numbers = (cell(s, n, _SWEPT_METHOD, _options(name, value)) for n in _NOISES for s in _SWEPT_SEQUENCES)
            rows.append(["default" if value is None else str(value), *numbers])
        lines += table([f"`{name}`", *head], rows)
    return lines
