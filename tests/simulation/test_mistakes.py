"""Classic mistakes in a copy of the product: the simulation catches each, and says with which seed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.support.files import ROOT
from tests.support.runs.simulation.mistakes import MISTAKES, Change, DoesNotApply, Mistake, first_broken


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_a_mistake_is_caught_with_its_seed(mistake: Mistake, tmp_path: Path) -> None:
    assert mistake.law in first_broken(mistake, tmp_path, 400, mistake.first), f"no seed shows that {mistake.name}"


def test_a_copy_without_a_mistake_breaks_no_law(tmp_path: Path) -> None:
    assert first_broken(Mistake("nothing", (), ""), tmp_path, 10) == ""


def test_a_mistake_that_cannot_be_made_any_more_is_an_error() -> None:
    gone = replace(MISTAKES[0], changes=(Change("pnm/journal/journal.py", "what was there before", ""),))
    with pytest.raises(DoesNotApply, match="0 times"):
        gone.made_in(ROOT)
