"""OBJ: a folder with one text file per frame.

Colours that differ follow the position of each vertex, ``v x y z r g b`` from 0 to 1 in sRGB: an extension that
Blender, MeshLab and others read and the rest ignore. One colour for all is that of the material in ``surface.mtl``
(``Kd``, sRGB); there is no material otherwise, because readers that know both take it in place of the vertices'
colours. Points without faces are written as elements ``p``. OBJ has no unit, time or attributes: see ``about.json``.

Source: Wavefront's Object Files (.obj), appendix B1 of the Advanced Visualizer manual.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from nrsfm.export.folders import frame_names, write_about
from nrsfm.export.scene import Scene

MATERIAL = "surface.mtl"
_PER_LINE = 16  # points of an element ``p``


def write_obj(scene: Scene, folder: Path, progress: Callable[[float], None]) -> None:
    """Write the sequence into an existing folder."""
    plain = "v %.9g %.9g %.9g"
    single = scene.colours is not None and bool((scene.colours == scene.colours[0]).all())
    if scene.colours is None or single:
        template = (plain + "\n") * scene.n_points
    else:
        colours = (scene.colours / 255.0).tolist()
        template = "".join(f"{plain} {r:.4g} {g:.4g} {b:.4g}\n" for r, g, b in colours)
    elements = _elements(scene.faces, scene.n_points)
    opening = "o surface\n"
    if single and scene.colours is not None:
        red, green, blue = (scene.colours[0] / 255.0).tolist()
        material = f"newmtl surface\nKa 0 0 0\nKd {red:.4g} {green:.4g} {blue:.4g}\nKs 0 0 0\nillum 1\n"
        (folder / MATERIAL).write_text(material, encoding="ascii")
        opening = f"mtllib {MATERIAL}\n{opening}usemtl surface\n"
    for frame, name in enumerate(frame_names(scene.n_frames, ".obj")):
        # Rounded as the other formats round: what differs between them is the container alone.
        numbers = scene.points(frame).astype(np.float32).ravel().tolist()
        head = f"# frame {frame} of {scene.n_frames}, {scene.options.fps:.9g} frames a second; see about.json\n"
        with (folder / name).open("x", encoding="ascii", newline="\n") as stream:
            stream.write(head + opening)
            stream.write(template % tuple(numbers))
            stream.write(elements)
        progress((frame + 1) / scene.n_frames)
    write_about(scene, folder)


def _elements(faces: np.ndarray | None, points: int) -> str:
    """The lines after the vertices; OBJ counts from 1."""
    if faces is not None:
        return ("f %d %d %d\n" * len(faces)) % tuple((faces + 1).ravel().tolist())
    numbers = [str(number) for number in range(1, points + 1)]
    return "".join(f"p {' '.join(numbers[i : i + _PER_LINE])}\n" for i in range(0, points, _PER_LINE))
