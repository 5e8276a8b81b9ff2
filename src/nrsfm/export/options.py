"""What an export may be told, checked in one place: formats, and numbers and words with their rules."""

from __future__ import annotations

import dataclasses
import math
import numbers
import os
from pathlib import Path
from typing import Any

from nrsfm.errors import OptionError, suggest
from nrsfm.export.axes import CONVENTIONS


@dataclasses.dataclass(frozen=True)
class Format:
    """A format: the extensions of its file (none: a folder with a file per frame) and whether its unit is the metre."""

    name: str
    extensions: tuple[str, ...]
    metres: bool
    what: str


FORMATS = {
    form.name: form
    for form in (
        Format("ply", (), False, "a folder with one binary PLY file per frame"),
        Format("obj", (), False, "a folder with one OBJ file per frame"),
        Format("glb", (".glb",), True, "animated glTF: morph targets, keyframed weights, camera"),
        Format("usd", (".usdc", ".usda", ".usd"), True, "USD: every frame's points, camera"),
        Format("npz", (".npz",), False, "NumPy arrays by name"),
        Format("csv", (".csv",), False, "a table of numbers"),
    )
}
FRAMES = ("object", "camera")
CRITERIA = ("rms", "max")
LAYOUTS = ("long", "wide")


@dataclasses.dataclass(frozen=True)
class ExportOptions:
    """Options of :func:`nrsfm.export.write` that are numbers or words; its docstring says what each means."""

    format: str
    fps: float = 25.0
    frame: str = "object"
    axes: str = "y-up"
    reference: int = 0
    scale: float | None = None
    image_size: tuple[float, float] | None = None
    tolerance: float = 1e-3
    criterion: str = "rms"
    targets: int | None = None
    layout: str = "long"

    def __post_init__(self) -> None:
        for name, choices in (
            ("frame", FRAMES),
            ("axes", CONVENTIONS),
            ("criterion", CRITERIA),
            ("layout", LAYOUTS),
        ):
            _word(name, getattr(self, name), choices)
        _number("fps", self.fps, above=0)
        _number("tolerance", self.tolerance, above=0)
        if self.scale is not None:
            _number("scale", self.scale, above=0)
        if self.targets is not None:
            _whole("targets", self.targets)
        _whole("reference", self.reference)
        if self.image_size is not None:
            if not isinstance(self.image_size, tuple | list) or len(self.image_size) != 2:
                raise OptionError(f"option 'image_size' must be (width, height), received {self.image_size!r}")
            for side in self.image_size:
                _number("image_size", side, above=0)
        if self.format == "glb" and self.axes != "y-up":
            raise OptionError(f"option 'axes' must be y-up for glb: glTF prescribes it, received {self.axes!r}")
        if self.format == "usd" and self.axes == "opencv":
            raise OptionError("option 'axes' must be y-up or z-up for usd, which knows no others, received 'opencv'")


def find_format(name: str | None, path: str | os.PathLike[str]) -> Format:
    """Return the format of that name, or the one that the path's extension says.

    Raises ``OptionError`` where it is unknown, or where the path does not have the format's extension.
    """
    suffix = Path(path).suffix.lower()
    if not os.fspath(path):
        raise OptionError("a name for the output is needed, received ''")
    if name is None:
        for form in FORMATS.values():
            if suffix in form.extensions:
                return form
        known = ", ".join(ext for form in FORMATS.values() for ext in form.extensions)
        raise OptionError(f"the format must be named for '{path}': only {known} say it by themselves")
    if not isinstance(name, str) or name not in FORMATS:
        hint = suggest(str(name), FORMATS) or f"; known are {', '.join(FORMATS)}"
        raise OptionError(f"unknown format {name!r}{hint}")
    form = FORMATS[name]
    if form.extensions and suffix not in form.extensions:
        raise OptionError(f"format {name} needs a name that ends in {' or '.join(form.extensions)}, received '{path}'")
    if not form.extensions and suffix in (".ply", ".obj"):
        raise OptionError(
            f"format {name} writes a folder with one file per frame: a folder is needed, received '{path}'"
        )
    return form


def _word(name: str, value: Any, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise OptionError(
            f"option '{name}' must be one of {', '.join(choices)}, received {value!r}{suggest(str(value), choices)}"
        )


def _number(name: str, value: Any, *, above: float) -> None:
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value) or value <= above:
        raise OptionError(f"option '{name}' must be a finite number greater than {above:g}, received {value!r}")


def _whole(name: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < 0:
        raise OptionError(f"option '{name}' must be a whole number of at least 0, received {value!r}")
