"""A share of `tests.benchmarks.bench_soak`: tasks that are over leave no objects behind, with a journal and without."""

from __future__ import annotations

import asyncio
import gc
from collections import Counter
from pathlib import Path

import pytest

from pnm.journal import journal as journals
from pnm.tasks import REMEMBERED
from tests.support.benchmarks.soak import ours, tasks_in_a_row

FIRST, MORE = 2 * REMEMBERED, 5 * REMEMBERED
"""Tasks after which all is there that is kept for a while, such as those that are listed as past; and others."""


@pytest.mark.parametrize("is_kept", [False, True], ids=["", "with a journal"])
def test_a_task_that_is_over_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_kept: bool) -> None:
    monkeypatch.setattr(journals, "_LONG", 1)  # what it keeps of the runs of a segment is let go when each task is over

    async def soak() -> Counter[str]:
        before = Counter[str]()
        async for number in tasks_in_a_row(tmp_path / "journal" if is_kept else None):
            if number == FIRST:
                before = ours()
            if number == FIRST + MORE:
                return ours() - before
        raise AssertionError

    left = asyncio.run(soak())
    assert all(number < REMEMBERED for number in left.values()), left  # a thread may still hold what it has found last


@pytest.mark.parametrize("is_kept", [False, True], ids=["", "with a journal"])
def test_a_task_that_is_over_is_let_go_at_once(tmp_path: Path, is_kept: bool) -> None:
    """Nothing of it refers to itself: garbage is looked for seldom while robots work."""

    async def soak() -> int:
        async for number in tasks_in_a_row(tmp_path / "journal" if is_kept else None):
            if number == FIRST:
                gc.collect()
                gc.disable()
            if number == FIRST + MORE:
                return gc.collect()
        raise AssertionError

    try:
        assert asyncio.run(soak()) < MORE
    finally:
        gc.enable()
