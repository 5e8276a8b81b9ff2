"""Videos in: frames, masks, checks, the choice of a reference frame, scores of tracks, and videos out.

Needs the extra ``nrsfm[video]``. Positions are in pixels, x to the right, y down; the centre of the top left pixel
is (0, 0), as in OpenCV.
"""

from __future__ import annotations

from nrsfm.video.checks import check_frames, is_still, scene_cuts
from nrsfm.video.choosing import reference_frame
from nrsfm.video.frames import Frames, open_frames, parse_size
from nrsfm.video.masks import read_mask
from nrsfm.video.scores import TrackScores, score_tracks
from nrsfm.video.writing import write_video

__all__ = [
    "Frames",
    "TrackScores",
    "check_frames",
    "is_still",
    "open_frames",
    "parse_size",
    "read_mask",
    "reference_frame",
    "scene_cuts",
    "score_tracks",
    "write_video",
]
