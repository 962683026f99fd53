"""What the page costs: the browser's time at 1000 calls, and what an executor has left while somebody watches. Not a test.

usage: python -m tests.benchmarks.bench_page [frames | watched | crowd]

The first paint: from the moment when the page has the state until plan and timeline of 1000 calls of 50 robots are drawn. A frame: all
scripts of the page between two paints, while a journal with 1000 calls grows as one of busy robots does. The throughput: a run whose
requests are answered at once, with every event committed, alone and with a browser that watches it; in turn, several times, on the
same machine. The crowd: the same with 500 connections, which are real ones, and are all read.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median
from typing import Final
from urllib.parse import urlsplit
from uuid import UUID

from playwright.sync_api import Browser, Page

from planner_bridge.view.serving import PageProcess
from pnm.core.execution.machine_index import prepare
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.generate import generate
from pnm.journal.journal import Journal
from tests.support.e2e.page.browser import browser
from tests.support.e2e.page.busy_run import answered, rounds, with_journal
from tests.support.e2e.page.journals import GrowingJournal
from tests.support.e2e.page.serving import page_of
from tests.support.runs.timing import seconds

CALLS: Final = 1000
ROBOTS: Final = 50
BROWSERS: Final = 500
CROWD_TURNS: Final = 1
TURNS: Final = 5
_PACE: Final = 0.05
"""Seconds between two commits of the journal that grows, and the records of each: some 40 calls a second."""
_RECORDS: Final = 6
_GROWS: Final = 12.0
_MEASURE: Final = """
window.frames_ = []; window.first = null;
let spent = 0;
const timed = (work) => (...args) => {
  const began = performance.now();
  try { return work(...args); } finally { spent += performance.now() - began; }
};
const add = EventSource.prototype.addEventListener;
EventSource.prototype.addEventListener = function (name, work) {
  return add.call(this, name, timed((event) => {
    if (name === "message") window.first ??= performance.now();
    return work(event);
  }));
};
const raf = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (work) => raf(timed(work));
const tick = () => { if (spent) window.frames_.push(spent); spent = 0; raf(tick); };
raf(tick);
"""
"""Adds up the time of the page's scripts from paint to paint."""


def opened(chromium: Browser, url: str) -> Page:
    """A page that measures itself, with all its calls drawn."""
    page = chromium.new_page(viewport={"width": 1280, "height": 900}, bypass_csp=True)  # which would keep it from being measured
    page.add_init_script(_MEASURE)
    page.goto(url)
    return page


def kept(work: Callable[[Journal, KnowledgeBase], int], file: Path) -> None:
    """Do some work with a journal, on a thread: on this one the browser has its event loop."""
    with ThreadPoolExecutor(1) as thread:
        thread.submit(with_journal, work, file).result()


def browser_time(chromium: Browser, journal: Path, folder: Path) -> None:
    """Measure the first paint, and the frames of a journal that grows."""
    paints = []
    with page_of(journal) as url:
        for _ in range(3):
            page = opened(chromium, url)
            page.wait_for_function("document.querySelector('#picture [data-state]') && document.querySelector('#lanes .ac')", polling="raf")
            paints.append(page.evaluate("performance.now() - window.first"))
            page.close()
    print(f"first paint of {CALLS} calls: {median(paints) / 1000:.2f} s after the page has the state (at most 1)")
    growing = GrowingJournal(journal, folder / "growing")
    growing.grow(20)
    with page_of(growing.place) as url:
        page = opened(chromium, url)
        page.wait_for_function("document.querySelectorAll('#picture [data-state]').length > 0")
        page.evaluate("window.frames_ = []")
        ends = time.monotonic() + _GROWS
        while time.monotonic() < ends and growing.length + _RECORDS <= growing.longest:
            growing.grow(growing.length + _RECORDS)
            page.wait_for_timeout(1000 * _PACE)
        frames = sorted(page.evaluate("window.frames_"))
        page.close()
    growing.close()
    worst = frames[int(0.99 * len(frames))]
    print(f"script per frame: {median(frames):.0f} ms, 99 % below {worst:.0f}, at most {frames[-1]:.0f} (at most 16); {len(frames)} frames")


def throughput(chromium: Browser, folder: Path) -> None:
    """Measure what an executor does while its journal is watched, and while it is not."""
    machine = generate(rounds(CALLS))
    prepare(machine)
    took: dict[bool, list[float]] = {False: [], True: []}
    worked: dict[bool, list[float]] = {False: [], True: []}
    """Seconds of the processor, which do not count what else runs on a busy machine."""

    def work(journal: Journal, world: KnowledgeBase, is_watched: bool) -> int:
        began = time.process_time()
        took[is_watched].append(seconds(lambda: answered(machine, journal, world, UUID(int=1)), 1))
        worked[is_watched].append(time.process_time() - began)
        return CALLS

    for turn in range(2 * TURNS):
        is_watched, file = bool(turn % 2), folder / f"run{turn}"
        if not is_watched:
            kept(lambda journal, world: work(journal, world, False), file)
            continue
        with PageProcess(0) as served:
            served.follow(str(file))
            page = opened(chromium, served.url)
            kept(lambda journal, world: work(journal, world, True), file)
            page.close()
    ratio, usual = (of(took[False]) / of(took[True]) for of in (min, median))
    times = f"{CALLS / min(took[True]):.0f} and {CALLS / min(took[False]):.0f} calls a second"
    print(f"executor with the page open / without: {ratio:.2f}, of medians {usual:.2f} (at least 0.9); {times}")
    print(f"the same by the time of its processor: {min(worked[False]) / min(worked[True]):.2f}")


async def watched(url: str, number: int) -> tuple[int, int]:
    """Watch by so many connections until the input ends; return the frames that came, and the connections that have had the first one."""
    host, port = urlsplit(url).hostname, urlsplit(url).port
    frames, first = 0, 0

    async def watch() -> None:
        nonlocal frames, first
        reader, writer = await asyncio.open_connection(host, port, limit=2**26)
        writer.write(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
        is_first = True
        while line := await reader.readline():
            if line.startswith(b"data: "):
                frames, first = frames + 1, first + is_first
                if is_first and first == number:
                    print("all watch", flush=True)
                is_first = False

    watching = [asyncio.create_task(watch()) for _ in range(number)]
    await asyncio.to_thread(sys.stdin.read)
    for task in watching:
        task.cancel()
    await asyncio.gather(*watching, return_exceptions=True)
    return frames, first


def crowd(folder: Path) -> None:
    """Measure what an executor does while hundreds watch, and while nobody does; and how many frames they get."""
    machine = generate(rounds(CALLS))
    prepare(machine)
    took: dict[bool, list[float]] = {False: [], True: []}

    def work(journal: Journal, world: KnowledgeBase, is_watched: bool) -> int:
        took[is_watched].append(seconds(lambda: answered(machine, journal, world, UUID(int=1)), 1))
        return CALLS

    told = ""
    for turn in range(2 * CROWD_TURNS):
        is_watched, file = bool(turn % 2), folder / f"crowd{turn}"
        if not is_watched:
            kept(lambda journal, world: work(journal, world, False), file)
            continue
        with PageProcess(0) as served:
            served.follow(str(file))
            command = [sys.executable, "-m", "tests.benchmarks.bench_page", "watch", served.url, str(BROWSERS)]
            with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as watching:
                assert watching.stdout is not None
                watching.stdout.readline()  # all watch
                kept(lambda journal, world: work(journal, world, True), file)
                told = watching.communicate()[0].strip()
    ratio, usual = (of(took[False]) / of(took[True]) for of in (min, median))
    print(f"executor with {BROWSERS} connections / without: {ratio:.2f}, of medians {usual:.2f}; the last time {told}")


def main() -> None:
    """Measure all of it, or a part, in one run."""
    parts = sys.argv[1:] or ["frames", "watched", "crowd"]
    if parts[0] == "watch":  # the connections, in a process of their own
        frames, first = asyncio.run(watched(parts[1], int(parts[2])))
        print(f"{frames} frames came, and {first} connections had one")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if "crowd" in parts:
            crowd(folder)
        if not {"frames", "watched"} & {*parts}:
            return
        with browser() as chromium:
            if "frames" in parts:
                machine = generate(rounds(CALLS, ROBOTS))
                kept(lambda journal, world: answered(machine, journal, world), folder / "thousand")
                browser_time(chromium, folder / "thousand", folder)
            if "watched" in parts:
                throughput(chromium, folder)


if __name__ == "__main__":
    main()
