"""``nrsfm info``: what a file holds, and whether it can be used."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nrsfm.cli.arguments import Parser
from nrsfm.cli.reconstruct import add_reading, image_size
from nrsfm.cli.summary import mirror_text
from nrsfm.cli.text import columns, to_json


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm info",
        usage="nrsfm info FILE [--order ORDER] [--array NAME] [--json]",
        description="Say what a file of tracks, shapes, cameras or a reconstruction holds.",
    )
    parser.add_argument("file", metavar="FILE", help="any file that nrsfm reads")
    add_reading(parser)
    parser.add_argument("--image-size", type=image_size, metavar="WxH", help="pixels, for relative coordinates")
    parser.add_argument("--json", action="store_true", help="JSON in place of text")
    given = parser.parse_strictly(words)

    from nrsfm.files import describe

    found = describe(
        given.file,
        order=given.order,
        name=given.array,
        tracker=given.tracker,
        image_size=given.image_size,
        seen_size=given.seen_size,
    )
    print(to_json(found) if given.json else columns(_lines(found)))
    return 0


def _lines(found: dict[str, Any]) -> list[tuple[str, str]]:
    lines = [("kind", found["kind"])]
    if found["holds"]:
        lines.append(("can be read", ", ".join(found["holds"])))
    lines += [(name, str(found[name])) for name in ("frames", "points", "dtype") if name in found]
    if found.get("missing"):
        lines.append(("missing", f"{found['missing']} entries, {100 * found['missing_share']:.2f} %"))
    lines += [(axis, f"{low:.6g} to {high:.6g}") for axis, (low, high) in found.get("range", {}).items()]
    if found["kind"] == "reconstruction":
        lines.append(("method", found["method"] or "not recorded"))
        if found["not_reconstructed"]:
            lines.append(("without a shape", f"{found['not_reconstructed']} of {found['points']} points"))
        if found["depth_deviation"]:
            middle, high = found["depth_deviation"]["median"], found["depth_deviation"]["percentile_95"]
            lines.append(("depth deviation", f"median {middle:.3g}, 95 % below {high:.3g}"))
        if found["groups"] is not None:
            lines.append(("groups", str(found["groups"])))
        mirror = mirror_text(found["diagnostics"])
        lines += [("mirror", mirror)] if mirror else []
        lines += [("warning", str(text)) for text in found["diagnostics"].get("warnings", [])]
    elif found["problem"]:
        lines.append(("as tracks", f"no: {found['problem']}"))
    lines += [("array", _array_text(array)) for array in found["arrays"]]
    lines.append(("file", f"{found['path']}, {found['bytes']} bytes"))
    return lines


def _array_text(array: dict[str, Any]) -> str:
    sizes = "x".join(str(size) for size in array["shape"]) or "scalar"
    return f"{array['name']} {array['dtype']} {sizes}".strip()
