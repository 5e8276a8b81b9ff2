"""Rendered videos with truth: for every pixel of the reference frame its exact track and visibility.

Ours. A textured surface in motion (:mod:`~nrsfm.datasets.render_scenes`) is seen by known cameras. The point of the
surface that is seen at the centre of a reference pixel is a triangle and three weights; its track is the projection
of that point in every frame, exactly, and it is visible where it lies in the image, faces the camera, and neither
the surface itself nor a disc is in front of it (tested for the point, not for a pixel). Images are anti-aliased by
supersampling; light, blur, noise and discs come from :mod:`~nrsfm.datasets.render_camera`.

Positions are in pixels: x to the right, y down, the centre of the top left pixel at (0, 0), as in OpenCV.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator

import numpy as np

from nrsfm.datasets import render_camera as camera
from nrsfm.datasets.render_camera import VARIANTS, Effects
from nrsfm.datasets.render_layer import object_layer
from nrsfm.datasets.render_raster import facing, hidden, rasterise
from nrsfm.datasets.render_scenes import SCENES, Scene, scene
from nrsfm.datasets.render_textures import background, texture
from nrsfm.errors import InputError, OptionError
from nrsfm.tracks import Tracks
from nrsfm.video.libraries import import_cv2

__all__ = ["SCENES", "VARIANTS", "RenderedSequence", "render_scene", "rendered"]

_MARGIN = 64  # texels around the coordinates that occur


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class RenderedSequence:
    """A rendered video and its truth.

    Attributes
    ----------
    name, variant
        As asked for.
    images
        (F, H, W, 3) uint8 RGB.
    reference
        Number of the reference frame.
    queries
        (N, 2) int32 x, y: the pixels of the reference frame that show the front of the object, row by row.
    tracks
        (F, N, 2) float32, pixels: true position of the surface point seen at each query; known where it is not
        visible, too.
    visible
        (F, N) bool.
    masks
        (F, H, W) bool: pixels whose centre shows the object (front or back), discs taken away.
    scene
        The surface and its cameras: ``shapes`` (F, P, 3), ``rotations`` (F, 3, 3), ``faces`` (M, 3), ...
    triangles, weights
        (N,) and (N, 3): where on the surface the queries lie.
    discs
        (F, D, 3): x, y, radius of the discs in front; D is 0 without them.
    """

    name: str
    variant: str
    images: np.ndarray
    reference: int
    queries: np.ndarray
    tracks: np.ndarray
    visible: np.ndarray
    masks: np.ndarray
    scene: Scene
    triangles: np.ndarray
    weights: np.ndarray
    discs: np.ndarray

    def __repr__(self) -> str:
        frames, height, width = self.masks.shape
        return (
            f"RenderedSequence({self.name!r}, {self.variant!r}, {frames} frames of {width} x {height}, reference "
            f"{self.reference}, {len(self.queries)} queries, {100 * self.visible.mean():.1f}% visible)"
        )

    @property
    def shapes(self) -> np.ndarray:
        """(F, P, 3) vertices of the surface, object frame, in its own unit."""
        return self.scene.shapes

    @property
    def rotations(self) -> np.ndarray:
        """(F, 3, 3) camera from object."""
        return self.scene.rotations

    @property
    def faces(self) -> np.ndarray:
        """(M, 3) triangles of the surface."""
        return self.scene.faces

    def query_shapes(self, chosen: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return the true 3D positions (F, N, 3) float32 of the queries (or of ``chosen`` ones), object frame."""
        corners = self.faces[self.triangles[chosen]]
        weights = self.weights[chosen].astype(np.float32)
        points = np.empty((len(self.shapes), len(corners), 3), dtype=np.float32)
        for f, shape in enumerate(self.shapes):
            points[f] = np.einsum("nk,nkd->nd", weights, shape[corners].astype(np.float32))
        return points

    def perfect_tracks(self, chosen: np.ndarray | slice = slice(None)) -> Tracks:
        """Return the true tracks with their visibility, of the queries or of ``chosen`` ones."""
        return Tracks(self.tracks[:, chosen], self.visible[:, chosen])

    def flow(self, frame: int) -> np.ndarray:
        """Return the true flow (H, W, 2) float32 from the reference to a frame; NaN where there is no query."""
        field = np.full((*self.masks.shape[1:], 2), np.nan, dtype=np.float32)
        x, y = self.queries.T
        field[y, x] = self.tracks[frame] - self.queries
        return field


def rendered(
    name: str,
    root: str | os.PathLike[str] | None = None,
    variant: str = "realistic",
    size: int = 480,
    seed: int = 0,
    *,
    frames: int | None = None,
    reference: int | None = None,
    samples: int = 2,
) -> RenderedSequence:
    """Render one of :data:`SCENES` as seen under one of :data:`VARIANTS`.

    Parameters
    ----------
    name
        A scene; those from the data folder need ``root`` (or ``NRSFM_DATA``).
    variant
        One of :data:`VARIANTS`, or several joined by ``+``.
    size
        Width and height in pixels.
    seed
        Of motion, texture, conditions and noise.
    frames
        How many; by default what the scene has. Generated scenes sample the same motion in fewer frames (the flag:
        stop earlier); those from data stop earlier.
    reference
        The reference frame; by default the one that shows most of the object.
    samples
        Samples per pixel in each direction.

    Raises
    ------
    OptionError
        An unknown scene or variant, or a number out of range.
    FileError
        The data folder is needed and not there.
    """
    for what, value, least in (("size", size, 16), ("samples", samples, 1), ("frames", frames, 2)):
        if value is not None and (isinstance(value, bool) or int(value) != value or value < least):
            raise OptionError(f"{what} must be a whole number of at least {least}, received {value!r}")
    chosen = camera.effects(variant)
    made = scene(name, root, size=size, seed=seed, frames=frames)
    return render_scene(made, chosen, size, size, variant=variant, seed=seed, reference=reference, samples=samples)


def render_scene(
    made: Scene,
    chosen: Effects,
    width: int,
    height: int,
    *,
    variant: str = "own",
    seed: int = 0,
    reference: int | None = None,
    samples: int = 2,
) -> RenderedSequence:
    """Render any scene (see :func:`~nrsfm.datasets.render_scenes.build`); parameters as in :func:`rendered`."""
    import_cv2()  # says what to install before anything is computed
    reference = made.frontal if reference is None else reference
    if not 0 <= reference < made.n_frames:
        raise InputError(f"reference must be from 0 to {made.n_frames - 1}, received {reference}")
    discs = camera.disc_paths(
        made.n_frames, chosen.discs, chosen.disc_radius, width, height, np.random.default_rng([seed, 3])
    )
    images = np.empty((made.n_frames, height, width, 3), dtype=np.uint8)
    masks = np.empty(images.shape[:3], dtype=bool)
    for f, (image, mask) in enumerate(_frames(made, chosen, discs, width, height, seed, samples)):
        images[f], masks[f] = image, mask
    queries, triangles, weights = _queries(made, reference, discs[reference], width, height)
    tracks, visible = _truth(made, triangles, weights, discs, width, height)
    return RenderedSequence(
        made.name, variant, images, reference, queries, tracks, visible, masks, made, triangles, weights, discs
    )


def _queries(
    made: Scene, reference: int, discs: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    seen = made.camera_points(reference)
    xy = made.image(seen)
    hits = rasterise(xy, seen[:, 2], made.faces, width, height, perspective=made.focal is not None)
    y, x = np.divmod(hits.pixel, width)
    queries = np.stack([x, y], axis=1).astype(np.int32)
    kept = (facing(xy, made.faces)[hits.triangle] > 0) & ~camera.inside_discs(queries, discs)
    return queries[kept], hits.triangle[kept], hits.weights[kept]


def _truth(
    made: Scene, triangles: np.ndarray, weights: np.ndarray, discs: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    corners = made.faces[triangles]
    tracks = np.empty((made.n_frames, len(triangles), 2), dtype=np.float32)
    visible = np.empty(tracks.shape[:2], dtype=bool)
    for f in range(made.n_frames):
        seen = made.camera_points(f)
        xy = made.image(seen)
        points = np.einsum("nk,nkd->nd", weights, seen[corners])
        image = made.image(points)
        tracks[f] = image
        inside = ((image > -0.5) & (image < (width - 0.5, height - 0.5))).all(axis=1)
        inside &= facing(xy, made.faces)[triangles] > 0
        if made.focal is not None:
            inside &= points[:, 2] > 0
        inside &= ~camera.inside_discs(image, discs[f])
        asked = np.flatnonzero(inside)
        # A ten-thousandth of the depth range: two neighbours meet at an edge, up to rounding.
        tolerance = 1e-4 * float(np.ptp(seen[:, 2]))
        behind = hidden(
            image[asked],
            points[asked, 2],
            triangles[asked],
            xy,
            seen[:, 2],
            made.faces,
            tolerance=tolerance,
            perspective=made.focal is not None,
        )
        inside[asked[behind]] = False
        visible[f] = inside
    return tracks, visible


def _frames(
    made: Scene, chosen: Effects, discs: np.ndarray, width: int, height: int, seed: int, samples: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Image (H, W, 3) uint8 and mask (H, W) of every frame."""
    rng = np.random.default_rng([seed, 4])
    state = camera.conditions(made.n_frames, chosen, np.random.default_rng([seed, 5]))
    low = made.uv.min(axis=0)
    shape = np.ceil(samples * np.ptp(made.uv, axis=0)).astype(int) + 2 * _MARGIN
    surface = texture(made.material, (int(shape[1]), int(shape[0])), seed, texels=float(samples))
    uv = samples * (made.uv - low) + _MARGIN
    behind = background((height, width), seed)
    cover = texture("cloth", (height, width), seed + 1, texels=1.0) if len(discs[0]) else behind
    for f in range(made.n_frames):
        layer, velocity, mask = object_layer(made, f, chosen, state.light[f], surface, uv, width, height, samples)
        if chosen.shutter:
            layer = camera.motion_blur(layer, velocity, chosen.shutter)
        image = layer[..., :3] + (1 - layer[..., 3:]) * behind
        image = camera.defocus(image, state.defocus[f])
        if len(discs[f]):
            image = camera.paint_discs(image, discs[f], cover, state.defocus[f])
            rows, columns = np.nonzero(mask)
            covered = camera.inside_discs(np.stack([columns, rows], axis=1), discs[f])
            mask[rows[covered], columns[covered]] = False
        yield camera.develop(image, chosen, state.gain[f], state.gamma[f], rng), mask
