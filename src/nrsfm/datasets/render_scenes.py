"""What the test renderer shows: surfaces in motion before a camera, and where their texture lies.

A scene puts a sequence into an image of a given size: shapes become pixels, triangles are all of one orientation,
and every vertex gets texture coordinates, in reference pixels, so that a texture is about as fine everywhere.
"""

from __future__ import annotations

import dataclasses
import os

import numpy as np

from nrsfm.datasets.render_raster import facing, rasterise
from nrsfm.errors import InputError, OptionError, suggest

SCENES = {
    "face": "the generated face, quick turns, 99 frames",
    "face-slow": "the generated face, one slow turn, 99 frames",
    "sheet": "the generated cloth, 99 frames",
    "flag": "simulated flag in the wind, orthographic, 60 frames",
    "face-seq3": "captured expressions, fast cameras, 99 frames (data folder)",
    "face-seq4": "captured expressions, slow cameras, 99 frames (data folder)",
    "ict-rom99": "blendshape face in range-of-motion, 99 frames (data folder)",
}
"""The names that :func:`~nrsfm.datasets.rendering.rendered` knows."""

_FILLED = 0.72  # share of the image's shorter side that the object takes at most


@dataclasses.dataclass(frozen=True, eq=False)
class Scene:
    """A moving surface before a camera.

    Attributes
    ----------
    name
        For messages.
    shapes
        (F, P, 3) vertices, object frame.
    faces
        (M, 3) triangles; a triangle whose signed area in the image (x right, y down) is positive shows its front.
    rotations
        (F, 3, 3) camera from object.
    translations
        (F, 3): camera coordinates are ``X = scale · R S + translation``. Orthographic: x and y are the image, in
        pixels, z the depth in pixels.
    scales
        (F,).
    focal
        ``None`` for an orthographic camera; else the focal length in pixels, and the image is
        ``focal · (X, Y) / Z + centre``.
    centre
        (2,) principal point of the perspective camera.
    uv
        (P, 2) texture coordinates in pixels of the reference image; of any origin.
    material
        Kind of texture.
    frontal
        The frame that shows most of the surface.
    """

    name: str
    shapes: np.ndarray
    faces: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    scales: np.ndarray
    uv: np.ndarray
    material: str
    focal: float | None = None
    centre: tuple[float, float] = (0.0, 0.0)
    frontal: int = 0

    @property
    def n_frames(self) -> int:
        """F."""
        return len(self.shapes)

    def camera_points(self, frame: int, points: np.ndarray | None = None) -> np.ndarray:
        """Return (N, 3) float64 camera coordinates in one frame, of its vertices or of other object points."""
        shape = self.shapes[frame] if points is None else points
        turned: np.ndarray = self.scales[frame] * (shape.astype(np.float64) @ self.rotations[frame].T)
        return turned + self.translations[frame]

    def image(self, camera_points: np.ndarray) -> np.ndarray:
        """Return the image (N, 2) of camera coordinates (N, 3), in pixels; pixel (i, j) has its centre at (j, i)."""
        if self.focal is None:
            return camera_points[:, :2]
        seen: np.ndarray = self.focal * camera_points[:, :2] / camera_points[:, 2:] + self.centre
        return seen


def triangles_of(faces: np.ndarray) -> np.ndarray:
    """Return triangles (M, 3) int64 of triangles (M, 3) or quads (M, 4)."""
    if faces.ndim != 2 or faces.shape[1] not in (3, 4):
        raise InputError(f"faces: shape (triangles, 3) or (quads, 4) is needed, received {faces.shape}")
    if faces.shape[1] == 4:
        faces = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    return np.ascontiguousarray(faces, dtype=np.int64)


def scene(
    name: str, root: str | os.PathLike[str] | None = None, *, size: int = 480, seed: int = 0, frames: int | None = None
) -> Scene:
    """Return one of :data:`SCENES` in a square image of ``size`` pixels.

    Raises
    ------
    OptionError
        Another name.
    FileError
        The data folder is needed and not there.
    """
    if name not in SCENES:
        raise OptionError(f"name must be one of {', '.join(SCENES)}, received {name!r}{suggest(str(name), SCENES)}")
    if name == "flag":
        return _flag(size, seed, frames or 60)
    if name in ("face", "face-slow", "sheet"):
        from nrsfm.datasets import synthetic

        made: synthetic.SyntheticSequence
        if name == "sheet":
            made = synthetic.sheet_sequence(frames or 99, 20_000, seed=seed, dtype=np.float32)
        else:
            camera = "slow" if name == "face-slow" else "fast"
            made = synthetic.face_sequence(frames or 99, camera=camera, seed=seed, dtype=np.float32)
        if made.shapes is None or made.rotations is None or made.faces is None:
            raise InputError(f"{name}: the generator gave no truth")
        factor = size / synthetic.IMAGE_SIZE
        places = np.concatenate([made.translations * factor, np.zeros((made.tracks.n_frames, 1))], axis=1)
        return build(
            name,
            made.shapes,
            made.faces,
            made.rotations,
            made.scales * factor,
            places,
            material="cloth" if name == "sheet" else "skin",
            wrapped=name != "sheet",
        )
    from nrsfm.datasets.loading import load

    real = load(name, root)
    if real.shapes is None or real.rotations is None or real.faces is None:
        raise InputError(f"{name}: shapes, rotations and faces are needed to render a sequence")
    shapes = real.shapes[:frames].astype(np.float32)
    # The data's faces have y up and look along z; half a turn about x puts them upright before the camera. Their
    # x, y are the same up to a sign, and orthographic tracks do not know the sign of depth.
    rotations = np.diag([1.0, -1.0, -1.0]) @ real.rotations[: len(shapes)]
    image = np.stack([s @ r[:2].T for s, r in zip(shapes, rotations, strict=True)])
    low, high = image.min(axis=(0, 1)), image.max(axis=(0, 1))
    scale = _FILLED * size / float((high - low).max())
    # A head is not held still: it wanders by a few pixels.
    t = np.linspace(0, 2 * np.pi, len(shapes))
    wander = size / 480 * np.stack([10 * np.sin(1.4 * t), 7 * np.sin(2.1 * t + 1.0)], axis=1)
    middle = (size - 1) / 2 - scale * (low + high) / 2 + wander
    places = np.concatenate([middle, np.zeros((len(shapes), 1))], axis=1)
    return build(
        name, shapes, real.faces, rotations, np.full(len(shapes), scale), places, material="skin", wrapped=True
    )


def _flag(size: int, seed: int, frames: int) -> Scene:
    from nrsfm.datasets.flag_cloth import refine, simulate

    coarse = simulate(frames, seed, rows=32, columns=44)
    shapes, faces = refine(coarse, 32, 44, 4)
    turn = np.radians(-18)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    rotations = np.tile(rotation, (frames, 1, 1))
    image = shapes @ rotation[:2].T
    low, high = image.min(axis=(0, 1)), image.max(axis=(0, 1))
    scale = 0.86 * size / float((high - low).max())
    place = np.append((size - 1) / 2 - scale * (low + high) / 2, 0.0)
    return build(
        "flag",
        shapes.astype(np.float32),
        faces,
        rotations,
        np.full(frames, scale),
        np.tile(place, (frames, 1)),
        material="print",
        wrapped=False,
        uv=_rest_uv(coarse[0], 32, 44, 4) * scale,
    )


def _rest_uv(positions: np.ndarray, rows: int, columns: int, factor: int) -> np.ndarray:
    """The flag's own flat coordinates, in its units: cloth is printed before it is hung."""
    pole = np.linalg.norm(np.diff(positions.reshape(rows, columns, 3)[:, 0], axis=0), axis=1).sum()
    step = pole / (rows - 1)
    v, u = np.meshgrid(
        np.arange((rows - 1) * factor + 1) * step / factor,
        np.arange((columns - 1) * factor + 1) * step / factor,
        indexing="ij",
    )
    return np.stack([u.ravel(), v.ravel()], axis=1)


def build(
    name: str,
    shapes: np.ndarray,
    faces: np.ndarray,
    rotations: np.ndarray,
    scales: np.ndarray,
    translations: np.ndarray,
    *,
    material: str = "skin",
    wrapped: bool = False,
    uv: np.ndarray | None = None,
    focal: float | None = None,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Scene:
    """Return a scene of any mesh: triangles oriented, texture coordinates chosen.

    ``wrapped`` lays the texture around an upright cylinder (for heads), else flat onto the most frontal frame.
    Triangles are turned over together so that most of what the camera sees in that frame are fronts.
    """
    triangles = triangles_of(np.asarray(faces))
    rough = Scene(name, shapes, triangles, rotations, translations, scales, np.zeros((0, 2)), material, focal, centre)
    frame, sign = _most_frontal(rough)
    if sign < 0:
        triangles = triangles[:, [0, 2, 1]]
    if uv is None:
        x, y, z = (rough.camera_points(frame)).T
        scale = 1.0 if focal is None else focal / float(np.median(z))
        if wrapped:
            back, middle = float(z.max()), float(np.median(x))
            # The axis lies at three quarters of the depth, so that ears are not stretched to nothing.
            axis = float(z.min()) + 0.75 * (back - float(z.min()))
            radius = float(np.median(np.hypot(x - middle, z - axis)))
            x = radius * np.arctan2(x - middle, axis - z)
        uv = scale * np.stack([x, y], axis=1)
    return dataclasses.replace(rough, faces=triangles, frontal=frame, uv=np.ascontiguousarray(uv, dtype=np.float32))


def _most_frontal(rough: Scene) -> tuple[int, float]:
    """The frame in which the surface covers most of the image, and the sign of the side that it shows there.

    Decided by what is seen, at about 120 samples across: a closed surface has as much back as front.
    """
    best, chosen, sign = 0, 0, 1.0
    for frame in range(0, rough.n_frames, max(1, rough.n_frames // 33)):
        seen = rough.camera_points(frame)
        xy = rough.image(seen)
        low, high = xy.min(axis=0), xy.max(axis=0)
        if frame == 0:
            fine = 120 / max(float((high - low).max()), 1e-9)
        hits = rasterise(
            (xy - low) * fine,
            seen[:, 2],
            rough.faces,
            *(int(n * fine) + 2 for n in high - low),
            perspective=rough.focal is not None,
        )
        if len(hits.pixel) > best:
            best, chosen = len(hits.pixel), frame
            sign = float(np.sign(np.sign(facing(xy, rough.faces[hits.triangle])).sum())) or 1.0
    return chosen, sign
