"""``nrsfm export``: a reconstruction as files that other programs open."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nrsfm.cli.arguments import Parser
from nrsfm.cli.reconstruct import image_size
from nrsfm.cli.text import columns, to_json
from nrsfm.errors import OptionError

if TYPE_CHECKING:
    from nrsfm.export import Exported

_RECONSTRUCTION = "reconstruction.npz"


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    from nrsfm.export.axes import CONVENTIONS
    from nrsfm.export.options import CRITERIA, FORMATS, FRAMES, LAYOUTS

    listed = "\n".join(f"  {form.name:4} {form.what}" for form in FORMATS.values())
    parser = Parser(
        prog="nrsfm export",
        usage=f"nrsfm export RECONSTRUCTION --format {'|'.join(FORMATS)} --out PATH [options]",
        description="Write a reconstruction for other programs: surfaces or points, colours, cameras, animation.",
        epilog=f"formats:\n{listed}",
    )
    parser.add_argument(
        "reconstruction", metavar="RECONSTRUCTION", help="reconstruction.npz, or the folder of a run that holds it"
    )
    parser.add_argument("--format", metavar="F", help=f"{', '.join(FORMATS)} [default: by the extension of PATH]")
    parser.add_argument("--out", required=True, metavar="PATH", help="file to make; for ply and obj a folder")
    parser.add_argument(
        "--faces",
        metavar="FACES",
        default="none",
        help="none (points), auto (triangles between neighbours), grid:ROWSxCOLS (points in rows), or a file with "
        "faces: an array 'faces' or a mesh [default: none]",
    )
    parser.add_argument(
        "--colours",
        metavar="C",
        help="image, groups, confidence, depth or #rrggbb [default: image, where one is given]",
    )
    parser.add_argument("--image", metavar="FILE", help="picture of the reference frame, for colours and its size")
    parser.add_argument("--mask", metavar="FILE", help="picture of the object in it, not 0 there; for --faces auto")
    parser.add_argument("--image-size", type=image_size, metavar="WxH", help="pixels that the cameras see")
    parser.add_argument("--fps", type=float, default=25.0, metavar="X", help="frames a second [default: 25]")
    parser.add_argument(
        "--frame",
        default="object",
        metavar="{" + ",".join(FRAMES) + "}",
        help="the camera moves around the object, or the object before a still camera [default: object]",
    )
    parser.add_argument(
        "--axes",
        default="y-up",
        metavar="{" + ",".join(CONVENTIONS) + "}",
        help="axes of the world, as the reference frame's camera sees it; glb: y-up only [default: y-up]",
    )
    parser.add_argument(
        "--reference", type=int, metavar="N", help="frame whose image shows the object upright [default: 0]"
    )
    parser.add_argument(
        "--scale",
        type=float,
        metavar="X",
        help="numbers (glb, usd: metres) per unit of the reconstruction "
        "[default: 1; glb, usd: the object's largest side is 1 m]",
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-3,
        metavar="X",
        help="glb: what the morph targets may leave, over the object's rms radius [default: 0.001]",
    )
    parser.add_argument(
        "--criterion",
        default="rms",
        metavar="{" + ",".join(CRITERIA) + "}",
        help="glb: of all points together, or of the worst one [default: rms]",
    )
    parser.add_argument("--targets", type=int, metavar="K", help="glb: this many morph targets [default: by tolerance]")
    parser.add_argument(
        "--layout", default="long", metavar="{" + ",".join(LAYOUTS) + "}", help="csv: table [default: long]"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an output of that name")
    parser.add_argument("--quiet", action="store_true", help="no progress and no summary")
    parser.add_argument("--json", action="store_true", help="JSON in place of text")
    given = parser.parse_strictly(words)

    from nrsfm.export import write
    from nrsfm.export.options import find_format
    from nrsfm.numerics.threads import single_thread
    from nrsfm.progress import TerminalProgress, silent
    from nrsfm.reconstruction import load_reconstruction

    find_format(given.format, given.out)  # before a large file is read
    source = Path(given.reconstruction)
    if source.is_dir():
        source /= _RECONSTRUCTION
    if os.path.realpath(source) == os.path.realpath(given.out):
        raise OptionError(f"option '--out' must be another file than the reconstruction itself, received '{given.out}'")
    result = load_reconstruction(source)
    options: dict[str, Any] = {
        name: getattr(given, name)
        for name in (
            *("format", "faces", "colours", "image", "mask", "image_size", "fps", "frame", "axes", "reference"),
            *("scale", "tolerance", "criterion", "targets", "layout", "overwrite"),
        )
    }
    with single_thread(), TerminalProgress() as line:
        found = write(result, given.out, **options, progress=silent if given.quiet else line)
    if not given.quiet:
        print(to_json(dataclasses.asdict(found)) if given.json else columns(_lines(found)))
    return 0


def _lines(found: Exported) -> list[tuple[str, str]]:
    files = f"{found.files} files, " if found.files > 1 else ""
    lines = [
        ("output", f"{found.path} ({files}{_bytes(found.size)})"),
        ("frames", f"{found.frames}, {found.fps:g} a second"),
        ("points", f"{found.points}" + (f"; {found.left_out} without a shape left out" if found.left_out else "")),
        ("surface", f"{found.faces} triangles: {found.surface}" if found.faces else f"{found.surface} (see --faces)"),
        ("unit", _unit(found)),
        ("camera", f"{found.camera}, a view of {found.view[0]:.6g} × {found.view[1]:.6g} pixels"),
    ]
    cut = found.truncation
    if cut is not None:
        lines.append(
            (
                "targets",
                f"{cut['targets']}; left out: rms {cut['rms']:.3g}, at most {cut['largest']:.3g} units of the "
                f"reconstruction ({100 * cut['relative_rms']:.3g} % and {100 * cut['relative_largest']:.3g} % of the "
                "object's rms radius)",
            )
        )
    return lines + [("warning", text) for text in found.warnings]


def _unit(found: Exported) -> str:
    if found.metres is None:
        return f"{found.unit:g} per unit of the reconstruction"
    return f"{found.unit * found.metres:g} m per unit of the reconstruction"


def _bytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"
