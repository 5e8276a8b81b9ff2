"""Which tracks: a data set, thinned or not, with noise, and with what trackers do to it."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from benchmarks import store

_WHOLE = re.compile(r"(\d+)% (.+)")


@dataclasses.dataclass(frozen=True)
class Data:
    """A data set, noise as a ratio of max|W|, its seed, the most points, and a name of :data:`DAMAGES`."""

    sequence: str
    noise: float = 0.0
    seed: int = 0
    points: int | None = None
    damage: str = ""

    @property
    def words(self) -> str:
        """The tracks in words, their name in the kept results."""
        noise = f"noise {self.noise:g} seed {self.seed}" if self.noise else "clean"
        if self.damage and self.seed and not self.noise:
            noise += f" seed {self.seed}"
        thinned = f"at most {self.points} points" if self.points is not None else ""
        return " | ".join(word for word in (self.sequence, thinned, noise, self.damage) if word)


def sequence_of(data: Data) -> Any:
    """The sequence with its noise and damage; ``note["wrong"]`` is the mask of its wrong entries, or None.

    ``note["data"]`` is the ``Data`` itself.
    """
    from nrsfm import datasets

    whole = datasets.load(data.sequence, store.data_folder())
    chosen = _evenly(whole.tracks.n_points, data.points)
    sequence = whole if chosen is None else _thinned(whole, chosen)
    if data.noise:
        sequence = sequence.with_noise(data.noise, data.seed)
    tracks, wrong = sequence.tracks, None
    if data.damage:
        tracks, wrong = damaged(whole, sequence, chosen, data)
    note = {**sequence.note, "data": data, "wrong": wrong}
    return dataclasses.replace(sequence, tracks=tracks, note=note)


def _evenly(count: int, wanted: int | None) -> Any:
    """``wanted`` point numbers, evenly spread; None for all."""
    import numpy as np

    return None if wanted is None or wanted >= count else np.arange(wanted, dtype=np.int64) * count // wanted


def _thinned(sequence: Any, chosen: Any) -> Any:
    from nrsfm.tracks import Tracks

    def cut(array: Any) -> Any:
        return None if array is None else array[:, chosen]

    return dataclasses.replace(
        sequence,
        tracks=Tracks(cut(sequence.tracks.points), cut(sequence.tracks.visible)),
        shapes=cut(sequence.shapes),
        valid=cut(sequence.valid),
        faces=None,
        edges=None,
    )


OCCLUDED, BACK, RANDOM = "missing in blocks", "missing, facing away", "missing at random"
OUTLIERS, DRIFT, WITHOUT_TRUTH = "gross outliers", "drift", "missing where the truth is"
DAMAGES = (OCCLUDED, BACK, RANDOM, OUTLIERS, DRIFT)
"""Words after a whole percentage of the entries: "30% missing in blocks"."""


def damaged(whole: Any, sequence: Any, chosen: Any, data: Data) -> tuple[Any, Any]:
    """Damaged tracks, and the mask (F, P) of entries that are wrong, or None."""
    import numpy as np

    from nrsfm.datasets import corruption
    from nrsfm.tracks import Tracks

    points = sequence.tracks.points
    rng = np.random.default_rng([data.seed, 7])
    if data.damage == WITHOUT_TRUTH:
        return Tracks(points, sequence.valid), None
    found = _WHOLE.fullmatch(data.damage)
    if found is None or found[2] not in DAMAGES:
        raise ValueError(f"damage must be a percentage and one of {', '.join(DAMAGES)}, received '{data.damage}'")
    share, kind = int(found[1]) / 100, found[2]
    if kind == OUTLIERS:
        moved, wrong = corruption.gross_outliers(points, share, rng)
        return Tracks(moved), wrong
    if kind == DRIFT:
        moved, wrong = corruption.drifting(points, share, rng)
        return Tracks(moved), wrong
    if kind == BACK:  # of the whole surface: thinned points have no faces
        seen = np.einsum("fij,fpj->fpi", whole.rotations, whole.shapes)
        visible = corruption.back_facing(seen, whole.faces, share)
        return Tracks(points, visible if chosen is None else np.ascontiguousarray(visible[:, chosen])), None
    return Tracks(points, corruption.occlude(points, share, rng, "random" if kind == RANDOM else "blocks")), None
