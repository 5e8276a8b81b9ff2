"""``python -m nrsfm.cli``, where the script ``nrsfm`` is not on the path."""

import sys

from nrsfm.cli import main

sys.exit(main())
