"""Who may import whom, read from the code; and that importing stays quick enough to be unnoticed."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.files import ROOT

ONLY = {
    "rclpy": "pnm/ros/",
    "unified_planning": "planner_bridge/planning/unified_planning/",
    "kairos": "planner_bridge/planning/",
    "click": "planner_bridge/cli",
}


def modules() -> list[Path]:
    return sorted(path for package in ("pnm", "planner_bridge") for path in (ROOT / package).rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """The modules a file imports, at any depth."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: relative import"
            yield node.module or ""


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_lead_one_way(path: Path) -> None:
    name = str(path.relative_to(ROOT))
    for module in imported(path):
        top = module.split(".")[0]
        assert not (name.startswith("pnm/") and top in ("planner_bridge", "kairos", "unified_planning")), f"{name} imports {module}"
        if top in ONLY:
            assert name.startswith(ONLY[top]), f"{name} imports {module}"
        if not name.startswith("pnm/ros/") and module.startswith("pnm.ros"):
            assert name.startswith("planner_bridge/"), f"{name} imports {module}"
        if name.startswith("planner_bridge/tasks/"):
            above = ("planner_bridge.pipeline", "planner_bridge.node", "planner_bridge.cli")
            assert not module.startswith(above), f"{name} imports {module}"


@pytest.mark.parametrize("package", ["pnm", "planner_bridge", "planner_bridge.cli.commands"])
def test_importing_brings_in_nothing_heavy(package: str) -> None:
    code = f"import {package}, sys; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split())
    assert not loaded & {"rclpy", "unified_planning", "numpy", "scipy", "networkx", "starlette"}


def test_the_core_does_no_io() -> None:
    files = [*(ROOT / "pnm" / "core").rglob("*.py")]
    assert files
    for file in files:
        used = {*imported(file)}
        io = {"asyncio", "threading", "time", "socket", "sqlite3", "os", "pathlib", "random"}
        assert not {module.split(".")[0] for module in used} & io, file
        assert all(module == "pnm.errors" or module.startswith("pnm.core.") for module in used if module.startswith("pnm")), file
