"""How many points are worked on at a time, so that a pass keeps to its memory."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass

from nrsfm.errors import OptionError

_UNITS = {"": 1, "B": 1, "K": 1e3, "M": 1e6, "G": 1e9, "T": 1e12, "KI": 2**10, "MI": 2**20, "GI": 2**30, "TI": 2**40}
_DEFAULT = 512 * 2**20  # bytes that the blocks of a pass take where no budget is given
_LEAST, _MOST = 8 * 2**20, 2**30
_COPIES = 4  # of a block in float64: as read, turned, sorted by cells, the product
_PER_CELL = 400  # points of a block per cell: products with fewer columns are slow
_CACHE = 4 * 2**20  # bytes of the float64 copies of a part: they stay in cache


def bytes_of(text: str) -> int:
    """Bytes of an amount of memory such as ``"4GB"``, ``"800 MiB"`` or ``"2e9"``.

    Raises ``OptionError`` where it is none, or less than 64 MB.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?(?:e\d+)?)\s*([kmgt]i?)?b?\s*", text, re.IGNORECASE)
    if found is None:
        raise OptionError(f"option 'memory' must be an amount such as 4GB or 800MiB, received '{text}'")
    amount = float(found[1]) * _UNITS[(found[2] or "").upper()]
    if not 64e6 <= amount < 2**62:
        raise OptionError(f"option 'memory' must be at least 64MB, received '{text}'")
    return int(amount)


@dataclass(frozen=True)
class Plan:
    """``block``: points read at once by each of ``threads``; ``part``: points turned into float64 at once."""

    block: int
    part: int
    threads: int

    def blocks(self, start: int, stop: int) -> Iterator[tuple[int, int]]:
        """The blocks from one point to another."""
        for first in range(start, stop, self.block):
            yield first, min(first + self.block, stop)

    def shards(self, count: int) -> list[tuple[int, int]]:
        """All points in as many stretches as there are threads, each of them whole blocks."""
        blocks = -(-count // self.block)
        number = max(1, min(self.threads, blocks))
        edges = [min(count, (i * blocks // number) * self.block) for i in range(number)] + [count]
        return [(a, b) for a, b in itertools.pairwise(edges) if b > a]


def plan(frames: int, count: int, cells: int, threads: int, room: int | None = None) -> Plan:
    """A plan within ``room`` bytes for blocks and the cells' Gram matrices, all threads together.

    Parameters
    ----------
    frames, count
        F and P.
    cells
        Cells whose Gram matrices (2F, 2F) each thread holds; 1 where it holds one.
    threads
        Blocks that are worked on at the same time.
    room
        Bytes; a default of half a gigabyte where ``None``.
    """
    grams = cells * (2 * frames) ** 2 * 8
    if room is not None:
        while threads > 1 and (room - threads * grams) / threads < 2 * _LEAST:
            threads -= 1  # fewer at a time, rather than more memory
        share = min(max((room - threads * grams) // threads, _LEAST), _MOST)
    else:
        share = _DEFAULT // threads
    column = 2 * frames * 8  # bytes of a point in float64
    block = max(1, min(int(share / (_COPIES * column)), count))
    part = max(1, min(block, max(_CACHE // column, _PER_CELL * cells if cells > 1 else 1)))
    return Plan(block, part, threads)
