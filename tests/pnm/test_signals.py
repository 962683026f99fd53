"""Signals cancel what runs in place of killing the process."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Iterator

import pytest

from pnm.clock import run_async


@pytest.fixture(autouse=True)
def usual() -> Iterator[None]:
    """Have signals handled as in a new process."""
    usual = dict.fromkeys((signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT), signal.SIG_DFL) | {signal.SIGINT: signal.default_int_handler}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}  # a shell's background ignores some
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


async def stopped_by(*numbers: signal.Signals) -> int:
    """Wait until it is cancelled; return how often it was."""
    for number in numbers:
        signal.raise_signal(number)
    with contextlib.suppress(asyncio.CancelledError):
        await asyncio.Event().wait()
    task = asyncio.current_task()
    assert task is not None
    return task.cancelling()


@pytest.mark.parametrize("virtual", [False, True])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGINT])
def test_a_signal_cancels_the_work_which_still_has_its_result(number: signal.Signals, virtual: bool) -> None:
    assert run_async(stopped_by(number), virtual=virtual) == 1
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL, "as it was before"


def test_signals_that_come_together_count_as_one() -> None:
    assert run_async(stopped_by(signal.SIGTERM, signal.SIGTERM, signal.SIGINT)) == 1


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert run_async(stopped_by(signal.SIGHUP, signal.SIGTERM)) == 1


def test_work_that_was_cancelled_and_has_no_result_ends_as_ctrl_c_does() -> None:
    async def work() -> None:
        signal.raise_signal(signal.SIGTERM)
        await asyncio.Event().wait()

    with pytest.raises(KeyboardInterrupt):
        run_async(work())
