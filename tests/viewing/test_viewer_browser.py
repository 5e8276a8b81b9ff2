"""The viewer in a real browser without a window: a Chromium of the system, driven through playwright."""

import contextlib
import time

import numpy as np
import pytest

from nrsfm import Reconstruction, Tracks
from nrsfm.viewing.viewer import ViewServer, make_content

from .conftest import picture, settle, until

FRAMES, ROWS, COLUMNS = 12, 30, 40


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def sheet():
    """A sheet that bends, seen by a camera that turns; a wide one, with one corner cut off by a lost point."""
    x, y = np.meshgrid(np.linspace(-200, 200, COLUMNS), np.linspace(-100, 100, ROWS))
    bent = [np.stack([x, y, 40 * np.sin(x / 60 + f / 3)], -1).reshape(-1, 3) for f in range(FRAMES)]
    shapes = np.array(bent, dtype=np.float32)
    shapes[:, -1] = np.nan
    turns = np.stack([turned(0.05 * f) for f in range(FRAMES)])
    number = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    a, b, c, d = (p.ravel() for p in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    result = Reconstruction(
        shapes, turns, np.full((FRAMES, 2), 240.0), np.ones(FRAMES), diagnostics={"warnings": ["a warning"]}
    )
    return result, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


@pytest.fixture(scope="module")
def served():
    result, faces = sheet()
    truth = np.where(np.isfinite(result.shapes), result.shapes, 0.0)
    truth[:, :200] += 3.0 * np.random.default_rng(0).normal(size=(FRAMES, 200, 3))
    seen = np.ones(truth.shape[:2], dtype=bool)
    seen[:, -1] = False
    tracks = Tracks(np.where(seen[..., None], result.project(), np.nan), seen)
    content = make_content(result, title="Sheet", tracks=tracks, truth=truth, faces=faces, surface="a grid", fps=10.0)
    with ViewServer(content, port=0) as server:
        yield server, result, faces


@contextlib.contextmanager
def page_of(browser, served, words="", *, width=1000, height=700, scheme="light", still=True):
    motion = "reduce" if still else "no-preference"
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, reduced_motion=motion
    )
    page = context.new_page()
    problems, asked = [], []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"{served[0].address}#{words}")
    until(page, f"globalThis.nrsfmView?.counts.distinct > 0 && nrsfmView.store.frames.size === {FRAMES}")
    yield page
    assert problems == []
    assert all(url.startswith((served[0].address, "blob:")) for url in asked)  # nothing from elsewhere
    context.close()


def frame(page):
    return page.evaluate("nrsfmView.frame")


def test_points_are_drawn_where_the_camera_sees_them(browser, served):
    _, result, _ = served
    with page_of(browser, served, "shape=points&reference=camera&yaw=0.000001&input=0&colour=plain") as page:
        page.evaluate("nrsfmView.controls.set({parallel: true, size: 0.3})")
        page.evaluate("(nrsfmView.stage.pitch = 0, nrsfmView.stage.yaw = 0, nrsfmView.change())")
        for f in (0, 7):
            page.evaluate(f"nrsfmView.go({f})")
            settle(page)
            seen = picture(page, "#scene")
            drawn = np.argwhere(np.abs(seen - seen[2, 2]).max(axis=2) > 40)
            scale = page.evaluate("1 / nrsfmView.stage.perPixel") / page.evaluate("nrsfmView.scene.half")
            content = served[0]._server.answers._content
            centre = content._centre + content._half * np.array(content.about["middle"])
            expected = ((result.shapes[f] - centre) @ result.rotations[f].T)[:, :2] * scale
            expected = expected[np.isfinite(expected).all(axis=1)] + np.array([seen.shape[1], seen.shape[0]]) / 2
            # argwhere: rows first; a point covers a few pixels
            assert np.abs(drawn.min(axis=0)[::-1] + 0.5 - expected.min(axis=0)).max() < 3.5
            assert np.abs(drawn.max(axis=0)[::-1] + 0.5 - expected.max(axis=0)).max() < 3.5


def test_it_plays_in_time_and_stops(browser, served):
    with page_of(browser, served, "input=0", still=False) as page:
        until(page, "nrsfmView.playing")
        begin = page.evaluate("({n: nrsfmView.counts.distinct, t: performance.now()})")
        time.sleep(1.2)
        end = page.evaluate("({n: nrsfmView.counts.distinct, t: performance.now()})")
        rate = 1000 * (end["n"] - begin["n"]) / (end["t"] - begin["t"])
        assert 6.0 < rate < 11.5  # 10 asked for; a busy machine may drop some, and none may be added
        page.keyboard.press("Space")
        assert not page.evaluate("nrsfmView.playing")
        settle(page)
        draws = page.evaluate("nrsfmView.counts.draws")
        time.sleep(0.3)
        assert page.evaluate("nrsfmView.counts.draws") <= draws + 1  # once more, finely; then it costs nothing


def test_keys(browser, served):
    with page_of(browser, served) as page:
        steps = (
            *(("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("Home", 0), ("ArrowLeft", FRAMES - 1)),
            *(("Home", 0), ("Shift+ArrowRight", 10), ("End", FRAMES - 1)),
        )
        for key, expected in steps:
            page.keyboard.press(key)
            assert frame(page) == expected, key
        for key, state, before, after in (
            ("c", "nrsfmView.stage.look.cameras", False, True),
            ("f", "nrsfmView.stage.look.reference", "object", "camera"),
            ("p", "nrsfmView.stage.look.shape", "surface", "points"),
            ("s", "nrsfmView.stage.look.shape", "points", "surface"),
            ("i", "nrsfmView.controls.inputShown", True, False),
            ("t", "nrsfmView.picture.showTracks", True, False),
            ("u", "nrsfmView.stage.look.over", False, True),
            ("o", "nrsfmView.stage.look.parallel", False, True),
            ("ArrowUp", "nrsfmView.speed", 1, 1.5),
            ("7", "nrsfmView.stage.look.colour.name", "plain", "error"),
            ("5", "nrsfmView.stage.look.colour.name", "error", "error"),  # no confidence here
            ("3", "nrsfmView.stage.look.colour.name", "error", "depth"),
        ):
            assert page.evaluate(state) == before, key
            page.keyboard.press(key)
            assert page.evaluate(state) == after, key
        page.keyboard.press("Space")
        assert page.evaluate("nrsfmView.playing")


def test_controls_and_words(browser, served):
    with page_of(browser, served) as page:
        assert page.inner_text("#title") == "Sheet"
        assert "1,199 of 1,200 points" in page.inner_text("#facts")
        assert "1 point was not reconstructed, and not shown." in page.inner_text("#warnings")
        assert "A warning." in page.inner_text("#warnings")
        assert page.locator("#colour option[value=texture]").is_disabled()
        assert not page.locator("#legend").is_visible()
        page.select_option("#colour", "error")
        assert page.locator("#legend").is_visible()
        assert "Error" in page.inner_text("#legend")
        page.locator("#scrub").fill("5")
        until(page, "nrsfmView.frame === 5")
        page.get_by_role("radio", name="Camera").click()
        assert page.evaluate("nrsfmView.stage.look.reference") == "camera"
        before = page.evaluate("[nrsfmView.stage.yaw, nrsfmView.stage.zoom]")
        box = page.locator("#scene").bounding_box()
        page.mouse.move(box["x"] + 100, box["y"] + 100)
        page.mouse.down()
        page.mouse.move(box["x"] + 150, box["y"] + 100)
        page.mouse.up()
        page.mouse.wheel(0, -200)
        until(page, f"nrsfmView.stage.yaw > {before[0]} && nrsfmView.stage.zoom > {before[1]}")


def test_colours_change_what_is_drawn(browser, served):
    with page_of(browser, served, "input=0&yaw=0.001") as page:
        shots = {}
        for name in ("plain", "depth", "error"):
            page.evaluate(f"nrsfmView.controls.colour('{name}')")
            settle(page)
            shots[name] = picture(page, "#scene")
        assert np.abs(shots["plain"] - shots["depth"]).mean() > 3
        assert np.abs(shots["depth"] - shots["error"]).mean() > 3


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_light_and_dark_narrow_and_wide(browser, served, scheme):
    with page_of(browser, served, "colour=depth", scheme=scheme) as page:
        for width in (390, 1400):
            page.set_viewport_size({"width": width, "height": 800})
            settle(page)
            assert (picture(page, "#scene")[3, 3].mean() > 200) == (scheme == "light")
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")  # nothing sticks out
            for part in ("#scene", "#play", "#scrub", "#picture", "#legend"):
                box = page.locator(part).bounding_box()
                assert box["width"] > 20
                assert box["x"] >= 0
                assert box["x"] + box["width"] <= width + 0.5, part
        page.locator("#theme").click()
        settle(page)
        assert (picture(page, "#scene")[3, 3].mean() > 200) == (scheme == "dark")


def test_normals_and_the_order_of_triangles(browser, served):
    _, result, faces = served
    points = np.zeros((ROWS * COLUMNS, 4), np.int16)
    points[:, :3] = np.nan_to_num(result.shapes[3]) * 100
    with page_of(browser, served) as page:
        normals = np.array(page.evaluate("""async ([positions, faces]) => {
            const { normalsOf } = await import("/normals.js");
            return Array.from(normalsOf(Int16Array.from(positions), Uint32Array.from(faces)));
        }""", [points.ravel().tolist(), faces.ravel().tolist()])).reshape(-1, 4)[:, :3]  # fmt: skip
        corners = points[:, :3].astype(float)[faces]
        area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        expected = np.zeros((len(points), 3))
        for k in range(3):
            np.add.at(expected, faces[:, k], area)
        expected *= 127 / np.linalg.norm(expected, axis=1, keepdims=True)
        assert np.abs(normals - expected).max() <= 1.01
        shuffled = np.random.default_rng(0).permutation(faces)
        ordered = np.array(page.evaluate("""async ([faces, points]) => {
            const { inGoodOrder } = await import("/order.js");
            return Array.from(inGoodOrder(Uint32Array.from(faces), points));
        }""", [shuffled.ravel().tolist(), len(points)])).reshape(-1, 3)  # fmt: skip
    assert sorted(map(tuple, ordered)) == sorted(map(tuple, faces))  # the same triangles, the same way round
    assert worked_out(ordered) < 1.0 < 2.5 < worked_out(shuffled)


def test_a_coarser_surface_has_half_the_triangles_and_the_same_outline(browser, served):
    rows, columns = 30, 40
    y, x = np.mgrid[:rows, :columns]
    rng = np.random.default_rng(0)
    points = np.zeros((rows * columns, 4), np.int16)
    points[:, 0], points[:, 1] = (np.stack([x, y]).reshape(2, -1) * 100 + rng.integers(-30, 30, (2, rows * columns)))[:]
    first = (y * columns + x)[:-1, :-1].ravel()
    faces = np.concatenate(
        [
            np.stack([first, first + 1, first + columns], 1),
            np.stack([first + 1, first + columns + 1, first + columns], 1),
        ]
    )
    with page_of(browser, served) as page:
        fewer = np.array(page.evaluate("""async ([faces, positions]) => {
            const { coarser } = await import("/coarse.js");
            return Array.from(coarser(Uint32Array.from(faces), Int16Array.from(positions)));
        }""", [faces.ravel().tolist(), points.ravel().tolist()])).reshape(-1, 3)  # fmt: skip
    assert 0.4 < len(fewer) / len(faces) < 0.6
    assert (np.diff(np.sort(fewer, axis=1), axis=1) > 0).all()  # three different points each

    def area(triangles):
        a, b, c = points[triangles, :2].astype(float).transpose(1, 0, 2)
        (ux, uy), (vx, vy) = (b - a).T, (c - a).T
        return ((ux * vy - uy * vx) / 2).sum()

    assert area(fewer) == pytest.approx(area(faces), rel=0.03)


def worked_out(faces, room=16):
    """Points worked out per triangle by a card that keeps the last 16."""
    kept, count = [], 0
    for point in faces.ravel().tolist():
        if point not in kept:
            count += 1
            kept = [*kept, point][-room:]
    return count / len(faces)


def test_a_viewer_that_has_ended_says_so(browser):
    result, faces = sheet()
    server = ViewServer(make_content(result, faces=faces), port=0)
    with server:
        page = browser.new_context(reduced_motion="reduce").new_page()
        page.goto(server.address)
        until(page, f"globalThis.nrsfmView?.store.frames.size === {FRAMES}")
    page.evaluate("(nrsfmView.store.frames.clear(), nrsfmView.go(3))")
    until(page, "document.getElementById('message').textContent.includes('has ended')")
    page.context.close()
