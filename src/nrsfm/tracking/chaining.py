"""Pairwise flow put end to end from the reference outwards; naively, or corrected in every frame.

Ours. A chain drifts: every step adds its error, and what is hidden once follows what hides it. The corrected chain
(:func:`corrected`) matches every frame against the reference itself, started where the chain has come to; carries a
trust for every point (full where the match to the reference is good, falling with every step that forward and
backward flow disagree on); and replaces what has lost its trust by what the trusted surroundings do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from nrsfm.tracking.filling import fill
from nrsfm.tracking.matching import Template

_DECAY = 0.95  # of trust with every step that nothing confirms
_LEAST = 1e-5


def walk(frames: int, reference: int) -> Iterator[tuple[int, int]]:
    """Pairs (frame, next frame) from the reference to the end, then from the reference to the beginning."""
    for f in range(reference, frames - 1):
        yield f, f + 1
    for f in range(reference, 0, -1):
        yield f, f - 1


def _empty(template: Template) -> tuple[np.ndarray, np.ndarray]:
    flows = np.zeros((len(template.frames), *template.shape, 2), dtype=np.float32)
    trusts = np.zeros(flows.shape[:3], dtype=np.float32)
    trusts[template.reference] = template.weight
    return flows, trusts


def naive(template: Template, advance: Callable[[], None]) -> tuple[np.ndarray, np.ndarray]:
    """Return flows (F, h, w, 2) and trust (F, h, w) of the chain alone."""
    flows, trusts = _empty(template)
    for f, after in walk(len(flows), template.reference):
        move, sure = template.step(f, after, flows[f])
        flows[after] = flows[f] + move
        trusts[after] = trusts[f] * sure
        advance()
    return flows, trusts


def corrected(template: Template, advance: Callable[[], None]) -> tuple[np.ndarray, np.ndarray]:
    """Return flows (F, h, w, 2) and trust (F, h, w) of the chain that is corrected against the reference."""
    flows, trusts = _empty(template)
    for f, after in walk(len(flows), template.reference):
        move, sure = template.step(f, after, flows[f])
        trust = trusts[f] * sure
        flow = flows[f] + fill(move, np.clip(2 * trust, _LEAST, 1).astype(np.float32) * template.weight)
        trust *= _DECAY
        flow, matched = template.correct(after, flow)
        strength = np.clip(2 * np.maximum(matched, trust), _LEAST, 1).astype(np.float32) * template.weight
        flow = fill(flow, strength)
        flows[after] = flow
        trusts[after] = np.maximum(template.seen(after, flow), trust * (template.trust(np.ones(template.shape), flow)))
        advance()
    return flows, trusts
