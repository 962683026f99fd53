"""`python -m planner_bridge` is `pnm`."""

from planner_bridge.cli import main

main()
