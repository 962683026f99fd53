"""The tests themselves: a test module can be read alone, and no folder or file is larger than a person can take in."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

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


@pytest.mark.parametrize("file", MODULES, ids=lambda file: str(file.relative_to(TESTS)))
def test_modules_import_the_product_and_helpers_and_no_other_test(file: Path) -> None:
    assert not [name for name in imported(file) if name.split(".")[0] == "tests" and name.split(".")[1] != "support"]


@pytest.mark.parametrize("file", MODULES, ids=lambda file: str(file.relative_to(TESTS)))
def test_modules_are_short(file: Path) -> None:
    assert len(file.read_text(encoding="utf-8").splitlines()) <= 300


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: str(folder.relative_to(ROOT)))
def test_folders_are_small_packages(folder: Path) -> None:
    entries = [entry.name for entry in folder.iterdir() if entry.name != "__pycache__"]
    assert len(entries) <= 12
    assert "__init__.py" in entries
