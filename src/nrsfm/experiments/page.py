"""The pages of all experiments: ``results.md`` with its pictures, and ``report.html``, which needs no other file."""

from __future__ import annotations

import base64
import html
import io
import os
from collections.abc import Sequence
from pathlib import Path

from nrsfm.experiments import sequences
from nrsfm.experiments.machine import in_words, machine
from nrsfm.experiments.markdown import anchor, folded, table, to_html
from nrsfm.experiments.report import Outcome, Settings
from nrsfm.viewing.style import ESTIMATE, GREY, HAIRLINE, INK, PAPER

MARKER = "Written by `nrsfm experiment all`; do not edit."
TITLE = "Results of the experiments"
IMAGES = Path("images") / "results"
_LARGEST = 3_000_000  # bytes of all pictures of the page together
_WIDTHS = (1200, 1000, 800, 640)  # pixels across, the largest that fits
_COLOURS = 128
_SHOWN = 8  # cells listed for one reason before "and ... more"
_VERDICTS = {"reproduced": "good", "not reproduced": "bad", "in part": "half", "not measured": "none"}


def page_lines(outcomes: Sequence[Outcome], settings: Settings, links: dict[str, str]) -> list[str]:
    """The page as Markdown; ``links`` are those of the pictures by name."""
    lines = [f"# {TITLE}", "", MARKER, "", *_about(settings), *_summary(outcomes)]
    for outcome in outcomes:
        lines += _section(outcome, links)
    return lines


def _about(settings: Settings) -> list[str]:
    lines = [
        "Every number was measured with one set of defaults for every sequence. What is said beside a figure is "
        "written by rules from its numbers, and can come out either way.",
        "",
    ]
    here = sequences.available(settings.root) if settings.sequences is None else settings.sequences
    if any(name.startswith("original-") for name in here):
        found = ", ".join(name for name in here if name.startswith("original-"))
        lines += [f"Of the paper's own sequences these are here: {found}.", ""]
    elif settings.root is not None:
        lines += [
            "The paper's own sequences are not here. `face-seq1` to `face-seq4` stand in for its four faces: made by "
            "the same recipe from another face, so that curves and rankings can be compared, but not digits.",
            "",
        ]
    else:
        lines += ["No folder of data was given: every sequence is built in, and generated.", ""]
    if settings.quick:
        lines += ["**A quick run: few sequences, points, repeats. Its numbers are not results.**", ""]
    if settings.methods or settings.sequences:
        lines += ["**Only a part was asked for (`--methods`, `--sequences`).**", ""]
    lines += [f"Machine: {in_words(machine())}", ""]
    return lines


def _summary(outcomes: Sequence[Outcome]) -> list[str]:
    rows = []
    for outcome in outcomes:
        link = f"[{outcome.title}](#{anchor(outcome.title)})"
        rows += [[link if i == 0 else "", f.claim, f"**{f.verdict}**"] for i, f in enumerate(outcome.findings)]
        if not outcome.findings:
            rows.append([link, "no claim of the paper", ""])
    counts = {v: sum(f.verdict == v for o in outcomes for f in o.findings) for v in _VERDICTS}
    said = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count)
    return [
        "## Summary",
        "",
        f"Claims: {said or 'none'}.",
        "",
        *table(["experiment", "claim", "verdict"], rows, texts=3),
    ]


def _section(outcome: Outcome, links: dict[str, str]) -> list[str]:
    lines = [f"## {outcome.title}", "", f"*{outcome.question}* (`nrsfm experiment {outcome.name}`)", ""]
    lines += [f"- **{f.verdict}**: {f.claim} {f.text}" for f in outcome.findings]
    lines.append("")
    for picture in outcome.pictures:
        lines += [f"![{outcome.title}]({links[picture.name]})", ""]
        lines += [picture.caption, ""] if picture.caption else []
    lines += [*outcome.table, ""]
    if not outcome.cells:
        lines += ["**Nothing was measured: no sequence or method that this needs is here.**", ""]
    count = sum(len(cells) for cells in outcome.failures.values())
    if count:
        shown = []
        for reason, cells in outcome.failures.items():
            more = f"; and {len(cells) - _SHOWN} more" if len(cells) > _SHOWN else ""
            shown.append(f"- {reason}: {'; '.join(cells[:_SHOWN])}{more}")
        lines += folded(f"{count} of {outcome.cells} cells have no numbers, for these reasons", shown)
    return lines


def write_pages(outcomes: Sequence[Outcome], settings: Settings, page: Path | None) -> list[Path]:
    """Write ``report.html`` and the Markdown page; return what was written, without pictures.

    ``page``: where the Markdown goes, with its pictures under ``images/results/`` beside it; by default into the
    output folder, where the pictures are.
    """
    from nrsfm.files.atomic import atomic_file

    report = settings.out / "report.html"
    with atomic_file(report) as stream:
        stream.write(report_html(outcomes, settings).encode())
    if page is None:
        page = settings.out / "results.md"
        links = {p.name: p.png.name for o in outcomes for p in o.pictures}
    else:
        links = {}
        pictures = compact([p.png for o in outcomes for p in o.pictures])
        for png, content in pictures.items():
            target = page.parent / IMAGES / png.name
            with atomic_file(target) as stream:
                stream.write(content)
            links[png.stem] = (IMAGES / png.name).as_posix()
    text = "\n".join(_without_double_blanks(page_lines(outcomes, settings, links))).rstrip() + "\n"
    with atomic_file(page) as stream:
        stream.write(text.encode())
    return [report, page]


def _without_double_blanks(lines: Sequence[str]) -> list[str]:
    return [line for i, line in enumerate(lines) if line or i == 0 or lines[i - 1]]


def written_before(page: Path) -> bool:
    """Whether a page of results is there that this command wrote."""
    try:
        return MARKER in page.read_text(encoding="utf-8")[:2000]
    except (OSError, UnicodeDecodeError):
        return False


def compact(pictures: Sequence[Path], largest: int = _LARGEST) -> dict[Path, bytes]:
    """Pictures as small PNG files, all of one width, together at most ``largest`` bytes if any width allows it."""
    found: dict[Path, bytes] = {}
    for width in _WIDTHS:
        found = {path: _small(path, width) for path in pictures}
        if sum(map(len, found.values())) <= largest:
            break
    return found


def _small(path: Path, width: int) -> bytes:
    from PIL import Image

    with Image.open(path) as opened:
        image = opened.convert("RGB")
    if image.width > width:
        image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    image.quantize(_COLOURS, dither=Image.Dither.NONE).save(stream, "PNG", optimize=True)
    return stream.getvalue()


def report_html(outcomes: Sequence[Outcome], settings: Settings) -> str:
    """One page with its pictures inside: no network, no other file."""
    sources = {}
    for outcome in outcomes:
        for picture in outcome.pictures:
            encoded = base64.b64encode(_small(picture.png, 1600)).decode()
            sources[picture.name] = f"data:image/png;base64,{encoded}"
    lines = page_lines(outcomes, settings, {name: name for name in sources})
    body = to_html(lines, lambda name: sources[name])
    for verdict, kind in _VERDICTS.items():
        body = body.replace(f"<strong>{verdict}</strong>", f'<span class="verdict {kind}">{verdict}</span>')
    links = "".join(f'<a href="#{anchor(o.title)}">{html.escape(o.name)}</a>' for o in outcomes)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{TITLE}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<nav>{links}</nav>\n<main>\n{body}</main>\n"
        "</body>\n</html>\n"
    )


def default_page(settings: Settings) -> Path | None:
    """``docs/results.md`` of the working folder, where a complete run may replace the page that it wrote before."""
    page = Path("docs") / "results.md"
    return page if settings.complete and written_before(Path(os.curdir) / page) else None


_STYLE = f"""
:root {{ color-scheme: light; }}
body {{ margin: 0; background: {PAPER}; color: {INK}; font: 15px/1.55 system-ui, "DejaVu Sans", sans-serif; }}
main {{ max-width: 1060px; margin: 0 auto; padding: 1rem 1.5rem 5rem; }}
nav {{ position: sticky; top: 0; background: {PAPER}; border-bottom: 1px solid {HAIRLINE}; padding: .55rem 1.5rem;
  display: flex; flex-wrap: wrap; gap: .2rem 1.1rem; font-size: 13px; z-index: 1; }}
nav a {{ color: {GREY}; text-decoration: none; }}
nav a:hover {{ color: {INK}; text-decoration: underline; }}
h1 {{ font-size: 1.9rem; margin: 1.6rem 0 .4rem; }}
h2 {{ font-size: 1.35rem; margin: 3.2rem 0 .5rem; padding-top: .6rem; border-top: 1px solid {HAIRLINE};
  scroll-margin-top: 3.2rem; }}
figure {{ margin: 1.2rem 0 .3rem; }}
img {{ width: 100%; height: auto; display: block; border: 1px solid {HAIRLINE}; border-radius: 6px; }}
.wide {{ overflow-x: auto; margin: .8rem 0 1.2rem; }}
table {{ border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }}
th, td {{ padding: .3rem .7rem; border-bottom: 1px solid {HAIRLINE}; text-align: right; vertical-align: top; }}
th:first-child, td:first-child {{ text-align: left; }}
h2#summary + p + .wide :is(td, th) {{ text-align: left; }}
th {{ color: {GREY}; font-weight: 600; }}
code {{ background: #f1eee8; border-radius: 3px; padding: .05em .3em; font-size: .92em; }}
li {{ margin: .35rem 0; }}
details {{ margin: 1rem 0; color: {GREY}; }}
summary {{ cursor: pointer; }}
.verdict {{ display: inline-block; border-radius: 9px; padding: 0 .6em; font-size: 12px; font-weight: 600;
  white-space: nowrap; }}
.good {{ background: #d7eadf; color: #1f5c43; }} .bad {{ background: #f6d9d0; color: #8b2f1a; }}
.half {{ background: #f5e7c6; color: #735210; }} .none {{ background: {ESTIMATE}55; color: {INK}; }}
@media print {{ nav {{ display: none; }} h2 {{ break-after: avoid; }} figure {{ break-inside: avoid; }} }}
"""
