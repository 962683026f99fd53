"""The tests themselves: a test module can be read alone, and no folder or file is larger than a person can take in."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from tests.support.files import ROOT

TESTS: Final = ROOT / "tests"
MODULES: Final = sorted(TESTS.rglob("*.py"))
FOLDERS: Final = sorted({file.parent for file in MODULES})


def imported(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert not node.level, f"{file}: relative import"
            yield from (f"{node.module}.{name.name}" for name in node.names)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


def test_modules_import_the_product_and_helpers_and_no_other_test() -> None:
    names = [(str(file), name.split(".")) for file in MODULES for name in imported(file)]
    assert not [(file, parts) for file, parts in names if parts[0] == "tests" and parts[1] != "support"]


def test_modules_are_short() -> None:
    assert not [file for file in MODULES if len(file.read_text(encoding="utf-8").splitlines()) > 300]


def test_folders_are_small_packages() -> None:
    entries = {folder: {entry.name for entry in folder.iterdir()} - {"__pycache__"} for folder in FOLDERS}
    assert not [folder for folder, names in entries.items() if len(names) > 12 or "__init__.py" not in names]
