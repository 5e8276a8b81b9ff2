"""The figures that experiments share."""

import numpy as np
import pytest

from nrsfm.experiments.curves import Curve, Panel, _short, curve_figure, method_colour, spread_out
from nrsfm.experiments.dots import Dot, dots_figure
from nrsfm.experiments.fields import Block, Spot, fields_figure
from nrsfm.methods import method_names
from nrsfm.viewing.style import house_style


def draw(figure):
    with house_style():
        figure.canvas.draw()
    return figure


@pytest.mark.parametrize("seed", range(20))
def test_names_are_apart_and_in_order(seed):
    places = np.sort(np.random.default_rng(seed).random(9))
    found = np.array(spread_out(list(places), 0.12))
    assert np.all(np.diff(found) >= 0.12 - 1e-9)
    assert found.mean() == pytest.approx(places.mean())


def test_names_that_are_apart_stay():
    assert spread_out([0.1, 0.5, 0.9], 0.2) == pytest.approx([0.1, 0.5, 0.9])


def test_every_method_has_a_colour_of_its_own():
    assert len({method_colour(name) for name in method_names()}) == len(method_names())


def test_numbers_on_axes():
    assert [_short(v) for v in (0.05, -0.2, 1.5, 0, 1e-5, 0.001, 20)] == [
        ".05", "−.2", "1.5", "0", "10⁻⁵", ".001", "20",
    ]  # fmt: skip


def test_a_figure_of_curves_with_everything():
    curves = [
        Curve("one", (1, 2, 4), (0.1, None, 0.3), "#2f6ea8", ring=(4,), spread=(0.01, 0.01, 0.01)),
        Curve("two", (1, 2, 4), (0.2, 0.25, 0.3), "#c8553d", dashed=True),
        Curve("published", (1, 4), (0.2, 0.1), "#4a5568", quiet=True),
    ]
    panels = [
        Panel("linear", curves, "a note", "x", "y", band=(2, 3, "band"), uprights=(1.5,), level=0.2, named=True),
        Panel("logarithmic", curves, log_x=True, log_y=True, ticks=[(1, "1"), (4, "4")]),
        Panel("empty", []),
    ]
    figure = draw(curve_figure("Title", "subtitle", [panels, panels[:2]], share="all"))
    assert len(figure.axes) == 5
    shown = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert {"one", "two", "published", "linear", "a note", "band"} <= set(shown)
    limits = {axes.get_ylim() for axes in figure.axes if axes.get_yscale() == "linear" and axes.lines}
    assert len(limits) == 1


def test_fields_say_their_numbers_and_frame_what_is_outlined():
    spots = [[Spot(0.1, ".100"), Spot(0.4, ".400 ▴", outlined=True)], [Spot(None, "failed"), Spot(0.2, ".200")]]
    blocks = [Block("a", spots), Block("b", spots)]
    figure = draw(fields_figure("T", "s", blocks, ["r", "q"], ["c\nd", "e"], bounds=(0.05, 0.5), foot="f"))
    assert len(figure.axes) == 2
    words = [text.get_text() for text in figure.axes[0].texts]
    assert {".100", ".400 ▴", "failed", "r", "c", "d"} <= set(words)
    assert [patch.get_linewidth() > 0 for patch in figure.axes[0].patches] == [False, True, False, False]


def test_dots_are_where_their_numbers_are():
    lines = [("one", "#2f6ea8", [Dot(10), Dot(100, hollow=True)]), ("two", "#c8553d", [Dot(400, crossed=True)])]
    figure = draw(dots_figure("T", "s", lines, "iterations", (120, 150, "paper")))
    marked = [line for line in figure.axes[0].lines if line.get_marker() in "ox"]
    assert [(line.get_xdata()[0], line.get_marker()) for line in marked] == [(10, "o"), (100, "o"), (400, "x")]
