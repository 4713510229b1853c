"""`python -m tiswarm` is `tiswarm`."""

import os
import sys

if not getattr(sys.flags, "safe_path", False) and sys.path[0] == os.getcwd():  # noqa: PTH109
    del sys.path[0]  # metadata in the working folder would load code that nobody named

from tiswarm.cli import main

main()
