"""Is this one shot of something that moves? Scene cuts found and named, and videos in which nothing moves.

Both look at the small grey copies of the frames (ours).

**Cuts.** Blocks of one frame are searched in the next by normalised correlation, and what is found is searched
back; a block counts that returns to where it started and moved about as one beside it. Where both frames show the
same scene most blocks do, however fast they moved (up to a fifth of the image), whatever the light does (correlation
knows no gain and offset) and whether noise or blur is added. After a cut they do by chance alone. A pair is a cut
where few blocks return *and* the pairs around it are much better: fast motion or heavy noise lowers the whole
neighbourhood, a cut one pair.

**Nothing moves.** After gain and offset the difference between two frames of a still scene is white noise, of which
a mean over 3 × 3 pixels takes most away; whatever moves leaves differences that hang together.
"""

from __future__ import annotations

import numpy as np

from nrsfm.errors import InputError
from nrsfm.video.frames import Frames
from nrsfm.video.libraries import import_cv2

_BLOCK = 16  # side of a block in small pixels
_REACH = 18  # how far it is searched
_ALIKE = 0.5  # correlation below which a block counts as not found
_CUT = 0.3  # share of returning blocks below which a pair may be a cut
_AROUND = 4  # pairs on each side that are compared with it


def returning(first: np.ndarray, second: np.ndarray) -> float:
    """Return the share of the textured blocks of ``first`` found in ``second``, found back, and moved as a neighbour.

    Small grey images (h, w) float32 of one size. NaN where ``first`` has nearly no texture.
    """
    cv2 = import_cv2()
    height, width = first.shape
    side = min(_BLOCK, height // 2, width // 2)
    if side < 4:
        return float("nan")
    rows = np.linspace(0, height - side, max(2, height // side)).round().astype(int)
    columns = np.linspace(0, width - side, max(2, width // side)).round().astype(int)
    texture = np.array([[first[y : y + side, x : x + side].std() for x in columns] for y in rows])
    # Flat blocks correlate with anything.
    tried = texture > max(0.012, 0.25 * float(texture.max()))
    moved = np.full((*tried.shape, 2), np.nan)
    for i, j in np.argwhere(tried):
        y, x = int(rows[i]), int(columns[j])
        there, score = _search(cv2, first[y : y + side, x : x + side], second, y, x)
        if score < _ALIKE:
            continue
        block = second[there[0] : there[0] + side, there[1] : there[1] + side]
        back, score = _search(cv2, block, first, *there)
        if score >= _ALIKE and abs(back[0] - y) <= 1 and abs(back[1] - x) <= 1:
            moved[i, j] = there[0] - y, there[1] - x
    count = int(tried.sum())
    return np.count_nonzero(_accompanied(moved)) / count if count >= 4 else float("nan")


def _accompanied(moved: np.ndarray) -> np.ndarray:
    """Which blocks of a grid (n, m, 2) moved about as one of the four beside them: chance does not."""
    agrees = np.zeros(moved.shape[:2], dtype=bool)
    for axis in (0, 1):
        first, second = (np.moveaxis(moved, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        length = np.linalg.norm(first, axis=2)
        with np.errstate(invalid="ignore"):
            alike = np.linalg.norm(first - second, axis=2) <= np.maximum(1.5, 0.3 * length)
        view = np.moveaxis(agrees, axis, 0)
        view[:-1] |= alike
        view[1:] |= alike
    return agrees


def _search(cv2: object, block: np.ndarray, image: np.ndarray, y: int, x: int) -> tuple[tuple[int, int], float]:
    side = len(block)
    top, left = max(y - _REACH, 0), max(x - _REACH, 0)
    area = image[top : y + side + _REACH, left : x + side + _REACH]
    scores = cv2.matchTemplate(area, block, cv2.TM_CCOEFF_NORMED)  # type: ignore[attr-defined]
    scores[~np.isfinite(scores)] = -1
    at = np.unravel_index(int(scores.argmax()), scores.shape)
    return (top + int(at[0]), left + int(at[1])), float(scores[at])


def scene_cuts(small: np.ndarray) -> list[int]:
    """Return the frames at which a new scene starts, of small grey copies (F, h, w).

    A frame is named f where f − 1 and f show different scenes.
    """
    return [int(f) + 1 for f in np.flatnonzero(_cuts(small))]


def _cuts(small: np.ndarray) -> np.ndarray:
    pairs = len(small) - 1
    forth = np.array([returning(small[f], small[f + 1]) for f in range(pairs)])
    # A frame without texture on either side of the pair: the other direction may know, else there is no evidence
    # of a common scene.
    unknown = np.isnan(forth)
    textured = np.array([frame.std() for frame in small]) > 0.012
    for f in np.flatnonzero(unknown):
        forth[f] = 1.0 if not textured[f] and not textured[f + 1] else 0.0
    cuts = np.zeros(pairs, dtype=bool)
    cv2 = import_cv2()
    for f in np.flatnonzero(forth < _CUT):
        # Where one frame alone is blurred or noisy, blur makes them alike again; two scenes it does not.
        pair = [cv2.GaussianBlur(small[f + k], (0, 0), 1.5) for k in (0, 1)]
        if textured[f] and textured[f + 1] and returning(*pair) >= 0.5:
            continue
        around = np.concatenate([forth[max(0, f - _AROUND) : f], forth[f + 1 : f + 1 + _AROUND]])
        usual = float(np.median(around)) if len(around) else 1.0
        # Under heavy noise few blocks return anywhere, and only a pair in which none does says anything.
        cuts[f] = forth[f] < (0.45 * usual if usual > 0.4 else 0.1 * usual if usual > 0.25 else 0)
    return cuts


def is_still(small: np.ndarray) -> bool:
    """Return whether all of the small grey copies (F, h, w) are alike up to light and noise."""
    cv2 = import_cv2()
    step = max(1, len(small) // 40)
    chosen = sorted({*range(0, len(small), step), len(small) - 1})
    first = small[0].astype(np.float64)
    for f in chosen[1:]:
        # What is nearly white may have been cut off there, and no gain explains it.
        bright = cv2.dilate(np.maximum(small[0], small[f]), np.ones((3, 3))) > 0.85
        kept = ~bright if np.count_nonzero(~bright) > 0.2 * bright.size else np.ones_like(bright)
        centred = first - first[kept].mean()
        frame = small[f] - float(small[f][kept].mean())
        power = float((centred[kept] ** 2).mean())
        gain = float((frame * centred)[kept].mean()) / power if power > 0 else 1.0
        rest = np.where(kept, frame - gain * centred, 0.0).astype(np.float32)
        smooth = cv2.blur(rest, (3, 3))
        noise = float(np.sqrt(((rest - smooth)[kept] ** 2).mean()))
        # White noise keeps 0.35 of what the mean took away, and about 0.5 where the small copies' areas overlap;
        # natural images that have moved keep more than is taken away. Half a level of 255 is rounding.
        level = 0.5 / 255
        if float(np.sqrt((smooth**2).mean())) > 0.75 * noise + level:
            return False
        if float(np.abs(smooth).max()) > 3 * noise + 4 * level:
            return False
    return True


def check_frames(frames: Frames) -> None:
    """Refuse a video that cannot be tracked from one reference.

    Raises
    ------
    InputError
        Nothing moves, or there is a scene cut; the message names the frame by its number in the file.
    """
    if is_still(frames.small):
        raise InputError(
            f"something must move in '{frames.name}': its {len(frames)} frames are alike up to noise and light"
        )
    cuts = scene_cuts(frames.small)
    if cuts:
        listed = ", ".join(str(int(frames.numbers[f])) for f in cuts[:5]) + (", ..." if len(cuts) > 5 else "")
        what = "a scene cut" if len(cuts) == 1 else f"{len(cuts)} scene cuts"
        first = int(frames.numbers[cuts[0]])
        raise InputError(
            f"one scene is needed, '{frames.name}' has {what} at frame {listed}: "
            f"choose a range before or from frame {first}"
        )
