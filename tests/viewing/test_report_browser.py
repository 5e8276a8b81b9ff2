"""The page of a report in a real browser without a window, opened from a file, with no network to ask."""

import contextlib
import itertools

import numpy as np
import pytest

from nrsfm import Reconstruction, Tracks
from nrsfm.viewing.report import Sources, make_report, read_run, write_report

from .conftest import picture, settle, until

FRAMES, ROWS, COLUMNS = 12, 30, 40


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A sheet that bends, with groups, truth, a warning and a wide table, as a page in an awkward folder."""
    x, y = np.meshgrid(np.linspace(-200, 200, COLUMNS), np.linspace(-100, 100, ROWS))
    bent = [np.stack([x, y, 40 * np.sin(x / 60 + f / 3)], -1).reshape(-1, 3) for f in range(FRAMES)]
    shapes = np.array(bent, dtype=np.float32)
    turns = np.stack(
        [[[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]] for a in np.arange(FRAMES) / 20]
    )
    result = Reconstruction(
        shapes, turns, np.full((FRAMES, 2), 240.0), np.ones(FRAMES), groups=np.arange(ROWS * COLUMNS) // 400,
        method="bmm", diagnostics={"warnings": ["a warning"], "iterations": 4, "history": {"energy": [4.0, 2.0, 1.0]}},
    )  # fmt: skip
    number = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    a, b, c, d = (p.ravel() for p in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    truth = shapes + 3.0 * np.random.default_rng(0).normal(size=shapes.shape)
    folder = tmp_path_factory.mktemp("runs") / "Läufe # 1 %20 ?"
    folder.mkdir()
    result.save(folder / "reconstruction.npz")
    sources = Sources(tracks=Tracks(result.project()), truth=truth, faces=faces, surface="a grid", unit="px")
    page = folder / "report.html"
    write_report(make_report(read_run(folder), sources, fps=10.0), page)
    return page, result, faces


@contextlib.contextmanager
def page_of(browser, saved, *, width=1280, height=800, scheme="light", still=True, before=""):
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme=scheme,
        reduced_motion="reduce" if still else "no-preference",
    )
    asked, problems = [], []

    def refuse(route):
        asked.append(route.request.url)
        route.abort()

    context.route(lambda url: not url.startswith(("file:", "data:", "blob:")), refuse)
    page = context.new_page()
    if before:
        page.add_init_script(before)
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.goto(saved[0].as_uri())
    yield page
    own = saved[0].as_uri()
    assert [url for url in asked if url != own and not url.startswith(("data:", "blob:"))] == []
    assert problems == []
    context.close()


def drawn(page):
    until(page, "globalThis.nrsfmPlayer?.counts.draws > 0")
    settle(page)


def test_it_opens_from_a_file_and_plays_and_asks_for_nothing(browser, saved):
    with page_of(browser, saved, still=False) as page:
        until(page, "globalThis.nrsfmPlayer?.playing")
        page.locator("#player").scroll_into_view_if_needed()
        until(page, "nrsfmPlayer.counts.shown > 4")
        assert page.locator("[data-part=play]").get_attribute("aria-label") == "Pause"


def test_the_frames_are_those_of_the_reconstruction(browser, saved):
    with page_of(browser, saved) as page:
        drawn(page)
        got = [page.evaluate(f"Array.from(nrsfmPlayer.shapes.get({f}).positions)") for f in (0, 7)]
        half = page.evaluate("nrsfmPlayer.about.half")
    shapes = saved[1].shapes
    centre = (shapes.min(axis=(0, 1)) + shapes.max(axis=(0, 1))) / 2
    for f, values in zip((0, 7), got, strict=True):
        points = np.array(values).reshape(-1, 4)[:, :3] / 32767 * half + centre
        near = np.linalg.norm(points[:, None] - shapes[f][None], axis=2).min(axis=1)
        assert near.max() < 0.5  # of 400; the points are in another order


def test_keys_buttons_and_charts_go_to_frames(browser, saved):
    with page_of(browser, saved) as page:
        drawn(page)
        assert page.evaluate("nrsfmPlayer.playing") is False  # reduced motion is asked for
        page.locator("[data-part=next]").click()
        assert page.evaluate("nrsfmPlayer.frame") == 1
        page.locator("[data-part=canvas]").focus()
        for key, frame in (("ArrowLeft", 0), ("ArrowLeft", 11), ("Home", 0), ("Shift+ArrowRight", 10), ("End", 11)):
            page.keyboard.press(key)
            assert page.evaluate("nrsfmPlayer.frame") == frame, key
        chart = page.locator("svg[data-frames]").first
        chart.scroll_into_view_if_needed()
        box = chart.bounding_box()
        page.mouse.click(box["x"] + 0.55 * box["width"], box["y"] + 0.5 * box["height"])
        assert 4 <= page.evaluate("nrsfmPlayer.frame") <= 7
        settle(page)
        assert 0.45 < page.evaluate("""(() => {
            const chart = document.querySelector("svg[data-frames]");
            return chart.querySelector(".now").x1.baseVal.value / chart.viewBox.baseVal.width;
        })()""") < 0.65  # fmt: skip


def test_the_wheel_is_the_pages_until_the_picture_is_clicked_on(browser, saved):
    with page_of(browser, saved) as page:
        drawn(page)
        canvas = page.locator("[data-part=canvas]")
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(*middle)
        page.mouse.wheel(0, 120)
        until(page, "scrollY > 0")
        assert page.evaluate("nrsfmPlayer.stage.zoom") == 1
        page.mouse.click(*middle)
        page.mouse.wheel(0, -120)
        until(page, "nrsfmPlayer.stage.zoom > 1")


def test_colours_shapes_cameras_and_turning_change_the_picture(browser, saved):
    with page_of(browser, saved) as page:
        drawn(page)
        shots = {"as it was": picture(page)}
        page.locator("[data-part=canvas]").focus()
        for key in ("3", "4", "p", "c", "d", "f", "u"):
            page.keyboard.press(key)
            settle(page)
            shots[key] = picture(page)
        assert page.evaluate("nrsfmPlayer.about.colours.map((c) => c.name).join()") == "plain,depth,groups,error"
        assert not page.locator("[data-part=legend]").is_hidden()  # of the error
    names = list(shots)
    for a, b in itertools.pairwise(names):
        assert np.abs(shots[a] - shots[b]).mean() > 0.3, (a, b)
    assert picture_is_of_something(shots["as it was"])


def picture_is_of_something(shot):
    return (np.abs(shot - shot[3, 3]).sum(axis=2) > 30).mean() > 0.05


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_sticks_out_and_text_can_be_read(browser, saved, scheme, width):
    with page_of(browser, saved, width=width, scheme=scheme) as page:
        drawn(page)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        page.evaluate("document.querySelectorAll('details').forEach((part) => (part.open = true))")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        paper = page.evaluate("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
        assert (np.mean(paper) > 128) == (scheme == "light")
        low = page.evaluate(CONTRAST)
        assert low == []
        crossed = page.evaluate(OVERLAPS)
        assert crossed == []


# Texts whose contrast with what is behind them is below 4.5 (WCAG 2.1, 1.4.3).
CONTRAST = """(() => {
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((v) => (v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = (node) => {
    for (let at = node; at; at = at.parentElement) {
      const colour = rgb(getComputedStyle(at).backgroundColor);
      if (colour.length < 4 || colour[3] > 0) return colour;
    }
  };
  const found = new Set();
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const node = walk.currentNode.parentElement;
    if (!walk.currentNode.textContent.trim() || /SCRIPT|STYLE|TITLE|OPTION/i.test(node.tagName)) continue;
    const style = getComputedStyle(node);
    const [a, b] = [light(rgb(node instanceof SVGElement ? style.fill : style.color)), light(behind(node))];
    if ((Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05) < 4.5) found.add(node.textContent.slice(0, 20));
  }
  return [...found];
})()"""

# Pairs of labels of one chart that overlap.
OVERLAPS = """[...document.querySelectorAll("svg.chart")].flatMap((chart) => {
  const boxes = [...chart.querySelectorAll("text")].map((text) => [text.textContent, text.getBoundingClientRect()]);
  return boxes.flatMap(([a, p], k) => boxes.slice(k + 1).filter(([, q]) =>
    p.left < q.right && q.left < p.right && p.top + 2 < q.bottom && q.top + 2 < p.bottom).map(([b]) => `${a} | ${b}`));
})"""


def test_without_webgl_there_is_a_picture_and_a_word(browser, saved):
    broken = "HTMLCanvasElement.prototype.getContext = () => null;"
    with page_of(browser, saved, before=broken) as page:
        until(page, "!document.querySelector('[data-part=message]').hidden")
        assert "WebGL 2" in page.locator("[data-part=message]").inner_text()
        assert picture_is_of_something(picture(page, ".player-stage img"))
        assert page.locator(".player-bar").is_hidden()


def test_a_graphics_card_that_goes_away_comes_back(browser, saved):
    with page_of(browser, saved) as page:
        drawn(page)
        before = picture(page)
        page.evaluate("(globalThis.lost = nrsfmPlayer.stage.gl.getExtension('WEBGL_lose_context'), lost.loseContext())")
        until(page, "nrsfmPlayer.stage.gl.isContextLost()")
        settle(page)
        page.evaluate("lost.restoreContext()")
        until(page, "!nrsfmPlayer.stage.gl.isContextLost() && nrsfmPlayer.drawn")
        settle(page)
        assert np.abs(picture(page) - before).mean() < 2.0
