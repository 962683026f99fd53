"""Unified-planning: its Problems to ours and back, and its engines, which run in a process of their own.

The only package that imports unified-planning, and only what asks for it loads a module of this
package: that takes 1 to 3 seconds and 150 MB. Run as a program this is the process of `planner_bridge.planning.engines`.
"""

from typing import TYPE_CHECKING

from pnm.files.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from planner_bridge.planning.unified_planning.problems import (
        from_unified_planning as from_unified_planning,
        to_unified_planning as to_unified_planning,
    )
else:
    __all__, __getattr__, __dir__ = lazy_exports(__name__, __file__)
