"""Rendered videos: their truth is exact, and the pixels agree with it."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the renderer needs the extra [video]")

from nrsfm.datasets import render_camera, render_raster, render_scenes, render_textures
from nrsfm.datasets.flag_cloth import refine, simulate
from nrsfm.datasets.rendering import VARIANTS, render_scene, rendered
from nrsfm.errors import InputError, OptionError


def _bumps(frames: int = 4, *, focal: float | None = None, size: int = 96) -> render_scenes.Scene:
    """A sheet with a moving fold that hides part of itself, seen obliquely."""
    from nrsfm.datasets.grids import full_grid

    u, v, faces = full_grid(900, 60.0, 60.0)
    shapes = []
    for t in np.linspace(0, 1, frames):
        height = 26 * np.exp(-0.5 * ((u - 12 + 20 * t) / 5) ** 2) * (1 + 0.2 * np.sin(v / 9))
        shapes.append(np.stack([u, -v, -height], axis=1))
    angles = np.radians(np.linspace(10, 48, frames))
    rotations = np.zeros((frames, 3, 3))
    rotations[:, 1, 1] = 1
    rotations[:, 0, 0] = rotations[:, 2, 2] = np.cos(angles)
    rotations[:, 0, 2], rotations[:, 2, 0] = np.sin(angles), -np.sin(angles)
    place = [size / 2, size / 2, 0.0] if focal is None else [0.0, 0.0, 150.0]
    return render_scenes.build(
        "bumps", np.stack(shapes), faces, rotations, np.ones(frames), np.tile(place, (frames, 1)),
        material="cloth", focal=focal, centre=(size / 2, size / 2),
    )  # fmt: skip


@pytest.fixture(scope="module", params=[None, 200.0], ids=["orthographic", "perspective"])
def small(request: pytest.FixtureRequest) -> tuple:
    made = _bumps(focal=request.param)
    return made, render_scene(made, render_camera.Effects(), 96, 96, reference=0)


def test_every_query_of_the_reference_is_its_own_pixel_and_visible(small: tuple) -> None:
    _, video = small
    assert np.abs(video.tracks[0] - video.queries).max() < 1e-4
    assert video.visible[0].all()
    x, y = video.queries.T
    assert video.masks[0][y, x].all()
    assert video.masks[0].sum() == len(video.queries)  # nothing turns its back in the reference


def test_tracks_are_the_projection_of_the_true_points(small: tuple) -> None:
    made, video = small
    points = video.query_shapes()
    for f in range(4):
        own = made.image(made.camera_points(f, points[f]))
        np.testing.assert_allclose(video.tracks[f], own, atol=2e-4)
    # A query that falls on a vertex has that vertex's track.
    vertex = np.flatnonzero(video.weights.max(axis=1) > 0.98)
    nearest = video.faces[video.triangles[vertex], video.weights[vertex].argmax(axis=1)]
    image = np.stack([made.image(made.camera_points(f))[nearest] for f in range(4)])
    assert len(vertex)
    assert np.abs(image - video.tracks[:, vertex]).max() < 0.25


def _first_hits(origins: np.ndarray, directions: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance (N,) to the first triangle (M, 3, 3) along each ray, by the determinants of Möller and Trumbore."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    first = np.full(len(origins), np.inf)
    for n, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        p = np.cross(direction, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / np.einsum("mk,mk->m", a, p)
            away = origin - corners[:, 0]
            q = np.cross(away, a)
            u, v = np.einsum("mk,mk->m", away, p) * inverse, (q @ direction) * inverse
            distance = np.einsum("mk,mk->m", b, q) * inverse
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
        if hit.any():
            first[n] = distance[hit].min()
    return first


def test_visibility_is_that_of_an_independent_ray_caster(small: tuple) -> None:
    made, video = small
    chosen = np.random.default_rng(0).choice(len(video.queries), 400, replace=False)
    points = video.query_shapes(chosen)
    folded = 0
    for f in (1, 3):
        vertices = made.camera_points(f)
        targets = made.camera_points(f, points[f])
        if made.focal is None:
            directions = np.tile([0.0, 0.0, 1.0], (len(targets), 1))
            origins = targets - 500 * directions
        else:
            directions = targets / np.linalg.norm(targets, axis=1, keepdims=True)
            origins = np.zeros_like(targets)
        depth = _first_hits(origins, directions, vertices[made.faces])
        in_front = depth < np.linalg.norm(targets - origins, axis=1) - 1e-2
        image = video.tracks[f][chosen]
        inside = ((image > -0.5) & (image < 95.5)).all(axis=1)
        own = vertices[made.faces[video.triangles[chosen]]]
        normals = np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0])
        front = np.einsum("nk,nk->n", normals, directions) > 0
        np.testing.assert_array_equal(video.visible[f][chosen], inside & front & ~in_front)
        folded += np.count_nonzero(in_front & front)
    assert folded > 5


def test_a_pixel_keeps_its_colour_along_its_track_when_there_is_no_light(small: tuple) -> None:
    """Sampled at its true position, each visible frame shows the reference's colour, up to interpolation."""
    import cv2

    _, video = small
    x, y = video.queries.T
    start = video.images[0][y, x].astype(float)
    for f in (1, 2):
        rim = cv2.erode(video.masks[f].astype(np.uint8), np.ones((5, 5))) > 0
        at = np.round(video.tracks[f]).astype(int).clip(0, 95)
        inner = video.visible[f] & rim[at[:, 1], at[:, 0]]
        # Away from folds, where the neighbouring pixel shows another part.
        flow = video.tracks[f]
        now = cv2.remap(
            video.images[f].astype(np.float32), flow[None, :, 0].copy(), flow[None, :, 1].copy(), cv2.INTER_LINEAR
        )[0]
        error = np.abs(now - start).mean(axis=1)[inner]
        wrong = np.abs(video.images[f][y, x].astype(float) - start).mean(axis=1)[inner]
        assert np.median(error) < 5
        assert np.median(error) < 0.5 * np.median(wrong)


def test_discs_hide_exactly_the_points_they_cover() -> None:
    made = _bumps()
    plain = render_scene(made, render_camera.Effects(), 96, 96, reference=0)
    discs = render_scene(made, render_camera.Effects(discs=2, disc_radius=0.15), 96, 96, reference=0)
    assert discs.discs.shape == (4, 2, 3)
    keys = {tuple(q): n for n, q in enumerate(plain.queries)}
    same = np.array([keys[tuple(q)] for q in discs.queries])
    np.testing.assert_array_equal(plain.tracks[:, same], discs.tracks)
    covered = np.stack(
        [
            (np.hypot(*(discs.tracks[f][:, None] - discs.discs[f, None, :, :2]).T) <= discs.discs[f, :, 2:]).any(axis=0)
            for f in range(4)
        ]
    )
    assert covered.any()
    assert not covered.all()
    np.testing.assert_array_equal(discs.visible, plain.visible[:, same] & ~covered)
    assert not covered[0].any()  # no query where the reference shows a disc


def test_nearest_surface_wins_and_shared_edges_leave_no_gap() -> None:
    xy = np.array([[0.0, 0], [9, 0], [9, 9], [0, 9]])
    square = np.array([[0, 1, 2], [0, 2, 3]])
    hits = render_raster.rasterise(xy, np.zeros(4), square, 10, 10)
    np.testing.assert_array_equal(hits.pixel, np.arange(100))
    np.testing.assert_allclose(np.einsum("nk,nkd->nd", hits.weights, xy[square[hits.triangle]]),
                               np.stack([hits.pixel % 10, hits.pixel // 10], axis=1), atol=1e-9)  # fmt: skip
    both = np.concatenate([xy, xy])
    order = render_raster.rasterise(both, np.repeat([5.0, 2.0], 4), np.concatenate([square, square + 4]), 10, 10)
    assert (order.triangle >= 2).all()


def test_slivers_and_triangles_outside_do_no_harm() -> None:
    xy = np.array([[0.0, 0], [4, 4], [8, 8], [50, 50], [60, 50], [50, 60], [-9, -9], [30, -9], [-9, 30]])
    faces = np.array([[0, 1, 2], [3, 4, 5], [0, 0, 1], [6, 7, 8]])
    hits = render_raster.rasterise(xy, np.zeros(9), faces, 6, 6)
    assert len(hits.pixel) == 36
    assert (hits.triangle == 3).all()
    empty = render_raster.rasterise(xy, np.zeros(9), faces[:1], 6, 6)
    assert len(empty.pixel) == 0


@pytest.mark.parametrize("kind", render_textures.KINDS)
def test_textures_have_the_spectrum_of_real_surfaces_and_weak_zones(kind: str) -> None:
    grey = render_textures.texture(kind, (256, 256), 0).mean(axis=2)
    power = np.abs(np.fft.fft2(grey - grey.mean())) ** 2
    radius = np.hypot(*np.meshgrid(np.fft.fftfreq(256), np.fft.fftfreq(256)))
    bands = [power[(radius >= low) & (radius < 2 * low)].mean() for low in (0.008, 0.016, 0.032, 0.064, 0.128)]
    assert all(np.diff(bands) < 0)  # falls with frequency
    detail = np.abs(grey[:, 1:] - grey[:, :-1])[:, :240].reshape(16, 16, 15, 16).mean(axis=(1, 3))
    assert np.quantile(detail, 0.1) < 0.5 * np.quantile(detail, 0.9)


def test_variants_change_the_images_and_not_the_truth() -> None:
    videos = {v: rendered("sheet", variant=v, size=64, frames=3, samples=1) for v in ("plain", "realistic")}
    np.testing.assert_array_equal(videos["plain"].tracks, videos["realistic"].tracks)
    assert (videos["plain"].images != videos["realistic"].images).any()
    again = rendered("sheet", variant="realistic", size=64, frames=3, samples=1)
    np.testing.assert_array_equal(again.images, videos["realistic"].images)
    assert again.perfect_tracks().n_points == len(again.queries)
    flow = again.flow(2)
    assert np.isfinite(flow).all(axis=2).sum() == len(again.queries)


def test_noise_variants_have_the_stated_strength() -> None:
    made = _bumps()
    clean = render_scene(made, render_camera.effects("plain"), 96, 96).images.astype(float) / 255
    grey = np.abs(clean - 0.5).max(axis=3) < 0.1
    noisy = render_scene(made, render_camera.effects("gaussian"), 96, 96).images / 255 - clean
    assert abs(noisy[grey].std() - 0.2) < 0.01
    salted = render_scene(made, render_camera.effects("salt-and-pepper"), 96, 96).images
    hit = (salted == 0).all(axis=3) | (salted == 255).all(axis=3)
    assert abs(hit.mean() - 0.1) < 0.01


def test_motion_blur_widens_along_the_motion_only() -> None:
    layer = np.zeros((41, 41, 4), dtype=np.float32)
    layer[20, 20] = 1
    velocity = np.zeros((41, 41, 2), dtype=np.float32)
    velocity[20, 20] = 8, 0
    blurred = render_camera.motion_blur(layer, velocity, 1.0, samples=17)[..., 3]
    rows, columns = np.nonzero(blurred > 1e-6)
    assert set(rows) == {20}
    assert columns.min() >= 15
    assert columns.max() <= 25
    assert len(columns) > 5


def test_flag_keeps_its_lengths_and_its_pole() -> None:
    held = simulate(4, 0, rows=12, columns=16)
    grid = held.reshape(4, 12, 16, 3)
    across = np.linalg.norm(np.diff(grid, axis=2), axis=3) / (1.26 / 15)
    assert np.abs(across - 1).mean() < 0.02
    assert np.isfinite(held).all()
    assert np.ptp(grid[:, :, 0], axis=0).max() == 0
    fine, faces = refine(held, 12, 16, 3)
    assert fine.shape == (4, 34 * 46, 3)
    assert faces.max() == 34 * 46 - 1
    np.testing.assert_allclose(fine.reshape(4, 34, 46, 3)[:, ::3, ::3], grid, atol=1e-12)


def test_refusals() -> None:
    with pytest.raises(OptionError, match=r"name must be one of .* did you mean 'sheet'"):
        rendered("shet")
    with pytest.raises(OptionError, match="variant must be one of"):
        rendered("sheet", variant="realistic+fog")
    with pytest.raises(OptionError, match="size must be"):
        rendered("sheet", size=3)
    with pytest.raises(InputError, match="reference must be from 0 to 3"):
        render_scene(_bumps(), render_camera.Effects(), 96, 96, reference=4)
    assert dataclasses.is_dataclass(render_camera.effects("+".join(VARIANTS)))


@pytest.mark.parametrize("name", ["face-seq4", "ict-rom99"])
def test_face_meshes_render_upright_with_their_fronts(name: str, data_root: object) -> None:
    video = rendered(name, str(data_root), "plain", 96, frames=3, samples=1)
    assert 0.1 < video.masks.mean() < 0.7
    assert video.visible[video.reference].all()
    assert video.visible.mean() > 0.6
