"""`python -m tiswarm` is `tiswarm`."""

from tiswarm.cli import main

main()
