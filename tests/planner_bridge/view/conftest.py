"""A journal that grows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.e2e.page.journals import GrowingJournal


@pytest.fixture
def growing(delivery: Path, tmp_path: Path) -> Iterator[GrowingJournal]:
    journal = GrowingJournal(delivery, tmp_path / "growing.journal")
    yield journal
    journal.close()
