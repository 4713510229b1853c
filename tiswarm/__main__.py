"""`python -m tiswarm` is `tiswarm`."""

import os
import sys
from contextlib import suppress

with suppress(FileNotFoundError):  # the working folder is gone, and nothing can be loaded from it
    if not getattr(sys.flags, "safe_path", False) and sys.path[0] == os.getcwd():  # noqa: PTH109
        del sys.path[0]  # metadata in the working folder would load code that nobody named

from tiswarm.cli import main

main()
