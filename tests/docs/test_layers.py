"""Who may import whom, read from the code; and that importing stays quick enough to be unnoticed."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.support.files import ROOT

ARCHITECTURE = (ROOT / "docs" / "project" / "architecture.md").read_text(encoding="utf-8")
ONLY = {
    "rclpy": "pnm/ros/",
    "unified_planning": "planner_bridge/planning/unified_planning.py",
    "kairos": "planner_bridge/planning/",
    "click": "planner_bridge/cli/",
    "rich": "planner_bridge/cli/",
    "starlette": "planner_bridge/view/",
    "uvicorn": "planner_bridge/view/",
    "mcp": "planner_bridge/node/agents.py",
    "opentelemetry": "planner_bridge/view/",
    "prometheus_client": "planner_bridge/view/",
    "mcap_ros2": "planner_bridge/view/",
    "networkx": "pnm/analysis.py",
    "numpy": "pnm/analysis.py",
}


def files() -> dict[str, Path]:
    """The files of both packages, by the names of their modules."""
    paths = (path for package in ("pnm", "planner_bridge") for path in (ROOT / package).rglob("*.py"))
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in sorted(paths)}


FILES = files()


@cache
def imports_of(path: Path) -> frozenset[str]:
    """The modules a file imports, at any depth; a name imported from a package may be a module."""
    return frozenset(_imports_of(path))


def _imports_of(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: relative import"
            module = node.module or ""
            yield from (full if (full := f"{module}.{alias.name}") in FILES else module for alias in node.names)


def room(path: Path) -> str:
    """The sub-package of a file; a file at the top of its package is a room of its own, and its `__init__` is none."""
    folder = path.relative_to(ROOT).parent
    if len(folder.parts) > 1:
        return str(folder)
    return "" if path.name == "__init__.py" else str(folder / path.name)


def rooms_table() -> dict[str, tuple[str, ...]]:
    """The rooms of the architecture page, with those that each may import from."""
    match = re.search(r"```imports\n(.*?)```", ARCHITECTURE, re.DOTALL)
    assert match
    lines = (line.split(":") for line in match[1].splitlines())
    return {name: tuple(entry.strip() for entry in allowed.split(",") if entry.strip()) for name, allowed in lines}


def imports_of_rooms() -> dict[str, set[str]]:
    rooms: dict[str, set[str]] = {room(path): set() for path in FILES.values()}
    for path in FILES.values():
        rooms[room(path)] |= {room(FILES[module]) for module in imports_of(path) if module in FILES}
    return {name: others - {name, ""} for name, others in rooms.items() if name}


def is_allowed(other: str, allowed: tuple[str, ...]) -> bool:
    return other == "pnm/errors.py" or any(
        other.startswith(f"{entry[:-3]}/") or other == entry[:-3] if entry.endswith("/**") else other == entry for entry in allowed
    )


def test_each_room_imports_only_what_the_architecture_page_allows() -> None:
    allowed, rooms = rooms_table(), imports_of_rooms()
    assert allowed.keys() | {"pnm/errors.py"} == rooms.keys()
    wrong = [
        f"{name} imports {other}" for name, others in rooms.items() for other in others if not is_allowed(other, allowed.get(name, ()))
    ]
    assert not wrong


def test_the_page_allows_nothing_that_nobody_needs() -> None:
    rooms = imports_of_rooms()
    unused = [
        f"{name}: {entry}"
        for name, allowed in rooms_table().items()
        for entry in allowed
        if not any(is_allowed(o, (entry,)) for o in rooms[name])
    ]
    assert not unused


def test_there_is_no_cycle_of_rooms_or_modules() -> None:
    modules = {name: {other for other in imports_of(path) if other in FILES} - {name} for name, path in FILES.items()}
    for graph in (imports_of_rooms(), modules):
        TopologicalSorter(graph).prepare()  # raises CycleError


def test_a_level_has_at_most_twelve_entries() -> None:
    entries: dict[Path, set[str]] = defaultdict(set)
    for path in FILES.values():
        parts = path.relative_to(ROOT).parts
        for depth in range(1, len(parts)):
            entries[Path(*parts[:depth])].add(parts[depth])
    assert not [folder for folder, names in entries.items() if len(names - {"__init__.py"}) > 12]


def test_the_architecture_page_names_only_files_and_functions_that_are_there() -> None:
    names = set(re.findall(r"`((?:pnm|planner_bridge|tests|docs)/[\w/.]+)`", ARCHITECTURE))
    assert len(names) > 40
    assert not [name for name in names if not (ROOT / name).exists()]
    for steps in re.findall(r"`([A-Z]\w+\.\w+(?: → [\w.]+)+)`", ARCHITECTURE):
        for step in steps.split(" → "):
            owner, _, function = step.rpartition(".")
            pattern = rf"^class {owner}\b(?:(?!^class ).)*?^    (?:async )?def {function}\(" if owner else rf"^def {function}\("
            assert any(re.search(pattern, path.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE) for path in FILES.values()), step


@pytest.mark.parametrize("library", ONLY)
def test_a_library_is_imported_in_its_room_alone(library: str) -> None:
    users = {str(path.relative_to(ROOT)) for path in FILES.values() if library in {module.split(".")[0] for module in imports_of(path)}}
    assert users
    assert not [user for user in users if not user.startswith(ONLY[library])]


@pytest.mark.parametrize(
    ("code", "light"),
    [
        ("import pnm, planner_bridge", True),
        ("from planner_bridge.cli.commands import app; app(['--help'], standalone_mode=False)", True),
        ("import planner_bridge.cli.run", False),
    ],
)
def test_importing_brings_in_nothing_heavy(code: str, light: bool) -> None:
    code = f"{code}; import sys; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split())
    assert not loaded & {
        "rclpy",
        "unified_planning",
        "numpy",
        "scipy",
        "networkx",
        "starlette",
        *(["rich", "yaml", "kairos"] if light else []),
    }


def test_the_core_does_no_io() -> None:
    files = [*(ROOT / "pnm" / "core").rglob("*.py")]
    assert files
    for file in files:
        used = imports_of(file)
        io = {"asyncio", "threading", "time", "socket", "sqlite3", "os", "pathlib", "random"}
        assert not {module.split(".")[0] for module in used} & io, file
        assert all(module == "pnm.errors" or module.startswith("pnm.core.") for module in used if module.startswith("pnm")), file
