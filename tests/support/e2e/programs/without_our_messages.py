"""`pnm` where `pnm_interfaces` is not installed: whatever imports it fails."""

from __future__ import annotations

import sys

from planner_bridge.__main__ import main

if __name__ == "__main__":
    sys.modules["pnm_interfaces"] = None  # type: ignore[assignment]
    main()
