"""Signals cancel what runs in place of killing the process."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Iterator
from itertools import count

import pytest

from pnm.clock import FollowingLoop, run_async
from pnm.files import signals
from pnm.files.signals import CANCELLED
from tests.support.processes import Program


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


def test_signals_that_do_not_stop_coming_are_a_second_request(monkeypatch: pytest.MonkeyPatch) -> None:
    now = count(start=0.0, step=0.5)
    monkeypatch.setattr(signals, "monotonic", lambda: next(now))
    with pytest.raises(KeyboardInterrupt):
        run_async(stopped_by(*[signal.SIGINT] * 4))


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert run_async(stopped_by(signal.SIGHUP, signal.SIGTERM)) == 1


def test_work_that_was_cancelled_and_has_no_result_ends_as_ctrl_c_does() -> None:
    async def work() -> None:
        signal.raise_signal(signal.SIGTERM)
        await asyncio.Event().wait()

    with pytest.raises(KeyboardInterrupt):
        run_async(work())


def test_what_ends_does_not_wait_for_a_clock_that_was_followed() -> None:
    async def work() -> bool:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, FollowingLoop)
        loop.follow(lambda: 100.0)  # of a simulation that has ended
        signal.raise_signal(signal.SIGTERM)
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.Event().wait()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.01):
                await asyncio.Event().wait()
        return not loop.is_following

    assert run_async(work())


def test_a_process_that_is_no_program_of_ours_leaves_when_its_own_program_does(monkeypatch: pytest.MonkeyPatch) -> None:
    left: list[float] = []
    monkeypatch.setattr(signals, "_ONE_REQUEST", 0.0)
    monkeypatch.setattr(signals, "leave_within", left.append)

    async def work() -> None:
        for _ in range(2):
            signal.raise_signal(signal.SIGTERM)
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.Event().wait()

    for is_program in (False, True):
        monkeypatch.setattr(signals.LAST_WORDS, "is_program", is_program)
        run_async(work())
        assert left == [signals.LEAVING] * is_program


BEGINNING = """
import asyncio, threading
from pnm.files import signals
from pnm.clock import run_async

signals._ONE_REQUEST = 0.0
signals.LEAVING = 0.2
signals.LAST_WORDS.belong_to_program(lambda: print("last words", flush=True))


async def work():
"""
HANGING = {
    "awaits at its end": """
    print("begun", flush=True)
    try:
        await asyncio.Event().wait()
    finally:
        print("cancelled", flush=True)
        while True:
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                pass
""",
    "has a thread that does not end": """
    threading.Thread(target=threading.Event().wait).start()
    print("begun", flush=True)
    try:
        await asyncio.Event().wait()
    finally:
        print("cancelled", flush=True)
        await asyncio.to_thread(threading.Event().wait)
""",
    "has nobody who reads its last words": """
    signals.LAST_WORDS.belong_to_program(threading.Event().wait)
    print("last words", flush=True)
    print("begun", flush=True)
    while True:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            print("cancelled", flush=True)
""",
}


@pytest.mark.parametrize("hanging", HANGING.values(), ids=HANGING)
def test_after_a_second_signal_a_process_leaves_whatever_it_does(hanging: str) -> None:
    program = Program(["-c", f"{BEGINNING}{hanging}\n\nrun_async(work())\n"], {})
    try:
        program.until(lambda: "begun" in program.out)
        program.process.send_signal(signal.SIGTERM)
        program.until(lambda: "cancelled" in program.out)
        program.process.send_signal(signal.SIGTERM)
        assert program.ended(20.0) == CANCELLED
        assert "last words" in program.out
    finally:
        program.close()
