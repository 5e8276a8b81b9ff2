"""Numbers as text and Markdown."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

YES, NO = "✓", "✗"


@dataclasses.dataclass(frozen=True)
class Check:
    """One number beside its target; ``value`` is None where it could not be measured."""

    what: str
    value: float | None
    limit: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        """Whether the number is there and at most its target."""
        return self.value is not None and self.value <= self.limit

    @property
    def mark(self) -> str:
        """✓ or ✗."""
        return YES if self.passed else NO

    def cell(self) -> str:
        """The number, its target and the mark: ".0623 ≤ .064 ✓" or ".0702 > .064 ✗"."""
        if self.value is None:
            return f"no number {NO}"
        sign = "≤" if self.passed else ">"
        number, limit = (error, error_limit) if not self.unit else (_fine, amount)
        return f"{number(self.value)}{self.unit} {sign} {limit(self.limit)}{self.unit} {self.mark}"


@dataclasses.dataclass(frozen=True)
class Fact:
    """A yes-or-no target; ``text`` says what was found."""

    what: str
    passed: bool
    text: str

    @property
    def mark(self) -> str:
        """✓ or ✗."""
        return YES if self.passed else NO

    def cell(self) -> str:
        """What was found, and the mark."""
        return f"{self.text} {self.mark}"


def error(value: float | None) -> str:
    """A relative error as the field writes it: .0623."""
    return "–" if value is None else f"{value:.4f}".removeprefix("0")


def error_limit(value: float) -> str:
    """A target for a relative error: .064."""
    return f"{value:.3f}".removeprefix("0")


def _fine(value: float) -> str:
    """Four significant digits: one more than a target has, so that a narrow miss can be seen."""
    return f"{float(f'{value:.4g}'):g}"


def amount(value: float | None) -> str:
    """Three significant digits, never an exponent."""
    if value is None:
        return "–"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{float(f'{value:.3g}'):g}"


def noise_words(ratio: float) -> str:
    """How noisy tracks are: "3% noise", or "clean"."""
    return f"{100 * ratio:g}% noise" if ratio else "clean"


def degrees(value: float | None) -> str:
    """An angle: 2.31°."""
    return "–" if value is None else f"{value:.2f}°"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return a Markdown table as lines, with an empty line after it."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return [*lines, ""]
