"""Where the project's files are, and files that tests write."""

from __future__ import annotations

from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
SHARED: Final = ROOT.parent / "shared"
"""Problems and plans beside the project, on machines that have them."""


def written(path: Path, content: str | bytes) -> Path:
    """Write a file and return its path; in a folder, it is called plan.yaml."""
    file = path / "plan.yaml" if path.is_dir() else path
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return file
