"""Work in stages that goes on where it stopped: each stage is done again only where what it depends on has changed.

:func:`open_stages` opens a folder, :class:`Stage` says what a stage depends on, ``folder.run(stage)`` does it or not.
"""

from __future__ import annotations

from nrsfm.stages.folder import RECORD, Stage, StageFolder, open_stages
from nrsfm.stages.identity import identity, is_same, is_there, plain

__all__ = ["RECORD", "Stage", "StageFolder", "identity", "is_same", "is_there", "open_stages", "plain"]
