"""The site of all pages is built, and no link of it leads nowhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.support.files import ROOT


def test_the_site_is_built_with_strict_links(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-f", str(ROOT / "docs" / "mkdocs.yml"), "-d", str(tmp_path)]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    page = (tmp_path / "docs" / "guides" / "journal.html").read_text(encoding="utf-8")
    assert 'id="a-fleet-on-several-nodes"' in page, "a heading behind a fence"
    assert not [file for file in tmp_path.rglob("*.md") if file.stat().st_size], "a page is a page, and no file to load down"
