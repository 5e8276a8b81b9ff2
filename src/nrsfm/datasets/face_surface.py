"""A generated face: a smooth surface over the front of a head, and local expressions that move it.

A point of the skin has two surface coordinates, ``(u, v)`` in millimetres: u runs around the head to the
viewer's right, v up. The skull is a bent sheet ``base(u, v)`` with bony relief that stays where it is. The
skin slides over it and carries its own relief (lips, eyelids) along; the jaw turns about an axis near the
ears. Sliding over a curved and bumpy skull, turning about an axis and travelling wrinkles are all non-linear
in the activations, so the shapes of a sequence have no finite rank by construction.

Coordinates here are x right, y up, z towards the viewer, in millimetres; the origin lies in front, at the
height of the nose bridge. ``synthetic.py`` turns them into the package's convention.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

EXPRESSIONS = (
    "jaw",
    "jaw_side",
    "smile_left",
    "smile_right",
    "pucker",
    "brow_left",
    "brow_right",
    "frown",
    "puff_left",
    "puff_right",
    "sneer",
    "blink",
)

_WRAP = 80.0  # mm of surface per radian around the head
_EYE = (32.0, 17.0)  # |u|, v of an eye's centre
_MOUTH = -50.0  # v of the line between the lips

# Half width, depth and midline of the skull at a few heights, each as a polynomial in v / 100.
_HEIGHTS = np.array([100.0, 80.0, 50.0, 20.0, -10.0, -40.0, -70.0, -95.0, -108.0]) / 100.0
_WIDTH = np.polynomial.Polynomial.fit(_HEIGHTS, [58, 66, 72, 73.5, 72, 69, 63, 55, 50], 5).convert().coef
_DEPTH = np.polynomial.Polynomial.fit(_HEIGHTS, [70, 82, 92, 93, 89, 82, 72, 60, 52], 4).convert().coef
_MIDLINE = np.polynomial.Polynomial.fit(_HEIGHTS, [-17, -7, 1, 2, 1, 1, -1, -7, -13], 4).convert().coef


def _polynomial(coefficients: np.ndarray, v: np.ndarray) -> np.ndarray:
    x = v * 0.01
    value = np.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        value *= x
        value += c
    return value


def _bump(u: np.ndarray, v: np.ndarray, at: tuple[float, float], width: tuple[float, float]) -> np.ndarray:
    a, b = (u - at[0]) / width[0], (v - at[1]) / width[1]
    return np.exp(-0.5 * (a * a + b * b))


def _step(x: np.ndarray, width: np.ndarray | float) -> np.ndarray:
    """Smooth step from 0 (x ≪ 0) to 1 (x ≫ 0) over a few ``width``."""
    return 0.5 + 0.5 * np.tanh(x / width)


def outline(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Size of the egg-shaped outline that passes through (u, v): 1 at the edge of the face, less inside."""
    half_width = 102.0 - 14.0 * _step(-v - 52.0, 34.0)
    return ((np.abs(u) / half_width) ** 2.3 + (np.abs(v + 6.0) / 101.0) ** 2.3) ** (1.0 / 2.3)


def base(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Skull at (u, v) without relief: x (N,), z (N,) and the angle around the head (N,)."""
    angle = u / _WRAP
    x = _polynomial(_WIDTH, v) * np.sin(angle)
    z = _polynomial(_MIDLINE, v) - _polynomial(_DEPTH, v) * (1.0 - np.cos(angle))
    return x, z, angle


def bone(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Relief that belongs to the skull, mm outwards; the skin slides over it."""
    s = np.sqrt(u * u + 64.0)  # |u|, rounded off so that the two sides meet without a crease
    ridge = v - (34.0 - 0.006 * (s - 24.0) ** 2)
    relief = 4.6 * np.exp(-0.5 * (ridge / 7.5) ** 2) * _step(s - 4.0, 9.0) * _step(50.0 - s, 7.0)
    relief -= 12.0 * _bump(s, v, (_EYE[0] - 1.0, _EYE[1] - 1.0), (14.5, 10.0))
    relief += 10.5 * _bump(s, v, (_EYE[0], _EYE[1] + 0.5), (10.0, 8.0))
    relief += 8.5 * _bump(s, v, (48.0, -6.0), (17.0, 13.0))
    relief -= 5.0 * _bump(s, v, (74.0, 46.0), (12.0, 20.0))
    relief += 3.0 * _bump(s, v, (24.0, 66.0), (18.0, 16.0))
    relief -= 2.5 * _bump(s, v, (50.0, -44.0), (15.0, 18.0))
    relief += 4.5 * _bump(s, v, (66.0, -68.0), (12.0, 14.0))
    return relief


def _nose(s: np.ndarray, v: np.ndarray) -> np.ndarray:
    rise = 0.5 * (27.0 - v + np.sqrt((27.0 - v) ** 2 + 40.0)) / 44.0
    height = 18.5 * rise**1.05 / (1.0 + np.exp(-(v + 24.5) / 2.3))
    width = 6.6 + 2.2 * np.clip(rise, 0.0, 1.2) ** 2
    relief = height * np.exp(-0.5 * (s / width) ** 2)
    relief += 6.0 * _bump(s, v, (0.0, -16.5), (8.0, 6.5))
    relief += 7.4 * _bump(s, v, (13.2, -20.5), (4.3, 5.0))
    relief -= 1.6 * _bump(s, v, (18.8, -19.0), (2.4, 5.5))
    relief -= 4.5 * _bump(s, v, (6.6, -26.5), (2.9, 1.8))
    return relief


def _lids(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the upper and lower lid, mm above the eye's centre."""
    a = (s - _EYE[0]) / 15.0
    arch = np.clip(1.0 - a * a, 0.0, None)
    return 5.0 * arch**0.8 + 0.3 * a, -3.6 * arch + 0.3 * a


def _eyes(s: np.ndarray, v: np.ndarray) -> np.ndarray:
    a = (s - _EYE[0]) / 15.0
    lift = v - _EYE[1]
    upper, lower = _lids(s)
    opening = _step(upper - lift, 0.55) * _step(lift - lower, 0.55) * _step(1.0 - np.abs(a), 0.05)
    relief = -1.4 * opening
    relief += 0.7 * np.exp(-0.5 * ((lift - upper - 0.9) / 1.2) ** 2) * _step(1.15 - np.abs(a), 0.1)
    relief += 0.3 * np.exp(-0.5 * ((lift - lower + 0.9) / 1.2) ** 2) * _step(1.05 - np.abs(a), 0.1)
    relief -= 1.9 * np.exp(-0.5 * ((lift - upper - 4.6 + 1.5 * a) / 1.2) ** 2) * _step(1.15 - np.abs(a), 0.15)
    iris = np.hypot(s - _EYE[0] + 0.6, lift - 0.4)
    relief += opening * (0.55 * np.exp(-0.5 * ((iris - 5.0) / 0.6) ** 2) - 1.7 * _step(2.3 - iris, 0.5))
    # Eyebrow: a soft band of hair over the ridge.
    arc = 32.5 + 6.0 * np.sin(np.clip((s - 10.0) / 44.0, 0.0, 1.0) * 2.4)
    relief += 1.7 * np.exp(-0.5 * ((v - arc) / 2.3) ** 2) * _step(s - 12.0, 2.5) * _step(50.0 - s, 4.0)
    return relief


def _mouth(s: np.ndarray, v: np.ndarray) -> np.ndarray:
    line = lip_line(s)
    taper = np.clip(1.0 - (s / 25.5) ** 2, 0.0, None)
    bow = 1.5 * np.exp(-0.5 * ((s - 5.0) / 3.0) ** 2) - 0.6 * np.exp(-0.5 * (s / 2.2) ** 2)
    upper, lower = line + 3.9 * taper**0.6 + bow * taper, line - 4.9 * taper**0.7
    relief = 7.0 * _bump(s, v, (0.0, -46.0), (24.0, 17.0))
    relief += 3.9 * np.exp(-0.5 * ((v - upper) / (1.6 + 1.9 * taper)) ** 2) * taper**0.5
    relief += 5.2 * np.exp(-0.5 * ((v - lower) / (1.6 + 2.6 * taper)) ** 2) * taper**0.6
    relief -= 4.6 * np.exp(-0.5 * ((v - line) / 1.1) ** 2) * _step(25.5 - s, 1.5)
    relief -= 2.4 * _bump(s, v, (26.5, _MOUTH - 0.5), (3.0, 3.5))
    # Philtrum, the fold beside the mouth, the hollow above the chin, the chin.
    gap = np.exp(-0.5 * ((v + 35.5) / 4.6) ** 2)
    relief += gap * (0.7 * np.exp(-0.5 * ((s - 5.2) / 2.0) ** 2) - 0.8 * np.exp(-0.5 * (s / 2.6) ** 2))
    fold = s - (20.0 + 0.34 * (-22.0 - v) + 0.004 * (v + 22.0) ** 2)
    relief -= 1.5 * np.exp(-0.5 * (fold / 3.4) ** 2) * _step(-19.0 - v, 5.0) * _step(v + 56.0, 6.0)
    relief -= 5.2 * _bump(s, v, (0.0, -67.5), (16.0, 4.6))
    relief += 8.5 * _bump(s, v, (0.0, -86.0), (20.0, 12.0))
    return relief


def lip_line(s: np.ndarray) -> np.ndarray:
    """Height v of the line between the lips at distance s from the middle."""
    return _MOUTH + 0.9 * np.exp(-0.5 * (s / 4.0) ** 2) - 1.2 * (s / 25.0) ** 2 + 1.4 * (s / 25.0) ** 4


class Skin(NamedTuple):
    """Everything about the skin points that does not change over time; all arrays (P,)."""

    u: np.ndarray
    v: np.ndarray
    relief: np.ndarray
    fields: dict[str, np.ndarray]


def _sided(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    right = _step(u, 5.0)
    return 1.0 - right, right


def make_skin(u: np.ndarray, v: np.ndarray) -> Skin:
    """Measure relief and the expressions' fields of influence at the skin points (u, v)."""
    s = np.abs(u)
    left, right = _sided(u)
    corner = _bump(s, v, (27.0, -48.0), (14.5, 12.0))
    cheek = _bump(s, v, (40.0, -22.0), (19.0, 18.0))
    lift = v - lip_line(s)
    # The lips part sharply; beside the mouth the jaw's pull fades over the cheek.
    softness = 0.7 + 26.0 * _step(s - 30.0, 9.0)
    jaw = _step(-lift - 0.2, softness) * _step(96.0 - s, 14.0) * _step(-v - 8.0, 16.0)
    brow = _bump(s, v, (30.0, 36.0), (24.0, 13.0))
    upper, lower = _lids(s)
    lift_eye = v - _EYE[1]
    shut = np.clip((lift_eye - lower) / np.maximum(upper - lower, 0.3), 0.0, 1.0)
    shut *= np.exp(-0.5 * (np.clip(lift_eye - upper, 0.0, None) / 6.0) ** 2)
    fields = {
        "jaw": jaw,
        "slit": np.exp(-0.5 * ((lift + 0.2) / 1.3) ** 2) * _step(23.0 - s, 2.5),
        "corner": corner,
        "cheek": cheek,
        "left": left,
        "right": right,
        "side": np.tanh(u / 6.0),
        "lips": _bump(s, v, (0.0, -50.0), (21.0, 12.0)),
        "brow": brow,
        "forehead": _bump(s, v, (22.0, 60.0), (30.0, 15.0)) * _step(v - 42.0, 5.0),
        "glabella": _bump(s, v, (11.0, 31.0), (8.0, 10.0)),
        "puff": _bump(s, v, (44.0, -40.0), (17.0, 17.0)),
        "nose": _bump(s, v, (16.0, -18.0), (7.0, 9.0)),
        "bridge": _bump(s, v, (8.0, 8.0), (7.0, 7.0)),
        # How far (mm) each part of the upper lid travels when the eye closes.
        "lid": shut * (upper - lower),
    }
    return Skin(u, v, _nose(s, v) + _eyes(s, v) + _mouth(s, v), fields)


def pose(skin: Skin, activation: dict[str, float]) -> np.ndarray:
    """Shape of the skin (3, P) under activations (0: rest, 1: full): x right, y up, z towards the viewer."""
    k, a = skin.fields, activation
    smile = a["smile_left"] * k["left"] + a["smile_right"] * k["right"]
    raised = a["brow_left"] * k["left"] + a["brow_right"] * k["right"]
    puff = (a["puff_left"] * k["left"] + a["puff_right"] * k["right"]) * k["puff"]

    # Slide along the surface. tanh limits how far tissue can be pulled, so pulls do not simply add.
    pull = smile * k["corner"]
    du = k["side"] * 11.0 * pull - 0.5 * a["pucker"] * k["lips"] * skin.u
    du -= k["side"] * 5.0 * a["frown"] * k["glabella"]
    dv = 11.5 * pull + 10.0 * smile * k["cheek"] + 9.0 * raised * k["brow"] - 5.5 * a["frown"] * k["glabella"]
    dv += 6.0 * a["sneer"] * k["nose"] + 4.0 * a["pucker"] * k["lips"] * np.tanh((_MOUTH - skin.v) / 6.0)
    dv -= 0.88 * min(a["blink"], 1.0) * k["lid"]  # an eye cannot close further than shut
    du, dv = 14.0 * np.tanh(du / 14.0), 14.0 * np.tanh(dv / 14.0)
    u, v = skin.u + du, skin.v + dv

    # Swell and wrinkle outwards.
    out = 9.0 * np.tanh(1.4 * smile * k["cheek"]) + 17.0 * np.tanh(1.3 * puff) + 10.0 * a["pucker"] * k["lips"]
    wave = np.sin(0.62 * (skin.v - 60.0) - 6.0 * raised + 0.02 * skin.u * raised)
    out += 1.0 * raised * k["forehead"] * wave
    out -= 1.2 * a["frown"] * k["glabella"] * np.cos(0.6 * (np.abs(skin.u) - 6.0) + 1.5 * a["frown"])
    out += a["sneer"] * (3.0 * k["nose"] + 0.8 * k["bridge"] * np.sin(1.0 * skin.v + 2.0 * a["sneer"]))
    out -= 7.0 * np.tanh(2.0 * a["jaw"]) * k["slit"]

    x, z, angle = base(u, v)
    height = skin.relief + bone(u, v) + out
    x = x + height * np.sin(angle)
    z = z + height * np.cos(angle)
    y = v.copy()

    # The jaw turns about the line through its joints, 18 mm below the eyes and 88 mm behind the nose bridge.
    turn = 0.33 * a["jaw"] * k["jaw"]
    cos, sin = np.cos(turn), np.sin(turn)
    ry, rz = y + 1.0, z + 88.0
    y, z = cos * ry - sin * rz - 1.0, sin * ry + cos * rz - 88.0
    swing = 0.12 * a["jaw_side"] * k["jaw"]
    cos, sin = np.cos(swing), np.sin(swing)
    rz = z + 88.0
    return np.stack([cos * x + sin * rz, y, cos * rz - sin * x - 88.0])
