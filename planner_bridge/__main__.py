"""`python -m planner_bridge` is `pnm`."""

from planner_bridge.cli.commands import main

main()
