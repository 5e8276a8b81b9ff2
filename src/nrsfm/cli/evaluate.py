"""``nrsfm evaluate``: a reconstruction against the truth, under every alignment."""

from __future__ import annotations

from collections.abc import Sequence

from nrsfm.cli.arguments import Parser
from nrsfm.cli.reconstruct import add_truth, load_truth
from nrsfm.cli.scores import score_lines, scores
from nrsfm.cli.text import columns, to_json


def run(words: Sequence[str]) -> int:
    """Run the verb and return the exit code."""
    parser = Parser(
        prog="nrsfm evaluate",
        usage="nrsfm evaluate RECONSTRUCTION TRUTH [--truth-frame object|camera] [--json]",
        description="Score a reconstruction against the true shapes: e3D under every alignment, the mocap\n"
        "literature's error, and the rotation error where the truth has cameras.",
    )
    parser.add_argument("reconstruction", metavar="RECONSTRUCTION", help="reconstruction.npz")
    add_truth(parser, "truth", metavar="TRUTH", help="file with the true shapes")
    parser.add_argument("--json", action="store_true", help="JSON in place of a table")
    given = parser.parse_strictly(words)

    from nrsfm.numerics.threads import single_thread
    from nrsfm.reconstruction import load_reconstruction

    result = load_reconstruction(given.reconstruction)
    truth = load_truth(given.truth, given.truth_frame)
    with single_thread():  # many small products: threads would wait for each other
        found = scores(result, truth)
    print(to_json(found) if given.json else columns(score_lines(found)))
    return 0
