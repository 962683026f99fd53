"""Classic mistakes in a copy of the product: the simulation catches each, and says with which seed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.runs.simulation.mistakes import MISTAKES, Change, DoesNotApply, Mistake, first_broken

SEEDS = 400
"""Of which one has to catch a mistake."""


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_a_mistake_is_caught_with_its_seed(mistake: Mistake, tmp_path: Path) -> None:
    caught = first_broken(mistake, tmp_path / "first", SEEDS, mistake.first)
    assert caught is not None, f"none of {SEEDS} seeds shows that {mistake.name}"
    assert mistake.law in caught.report
    again = first_broken(mistake, tmp_path / "again", 1, caught.seed)
    assert again is not None
    assert again.what == caught.what


def test_a_copy_without_a_mistake_breaks_no_law(tmp_path: Path) -> None:
    assert first_broken(Mistake("nothing", (), ""), tmp_path, 60) is None


def test_a_mistake_that_cannot_be_made_any_more_is_an_error(tmp_path: Path) -> None:
    gone = replace(MISTAKES[0], changes=(Change("pnm/journal/journal.py", "what was there before", ""),))
    with pytest.raises(DoesNotApply, match="0 times"):
        first_broken(gone, tmp_path, 1)
