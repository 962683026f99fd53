"""Public names that are loaded when they are asked for: importing a package then costs nothing (PEP 562)."""

from __future__ import annotations

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_exports(package: str, file: str) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of a package whose public names are those imported under ``if TYPE_CHECKING:``.

    That block in the package's ``__init__.py`` is the one list of the names: type checkers follow it, and it is read here to
    find the module of every name.
    """
    body = ast.parse(Path(file).read_bytes()).body
    imports = [node for block in body if isinstance(block, ast.If) for node in block.body if isinstance(node, ast.ImportFrom)]
    modules = {alias.name: node.module or "" for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(modules[name]), name)

    public = sorted(modules, key=lambda name: (not name.isupper(), name[0].islower(), name))
    return public, load, lambda: sorted(modules)
