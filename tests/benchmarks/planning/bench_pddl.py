"""How long PDDL takes to read, against unified-planning's reader, and a whole `pnm plan` against `kairos`.

usage: python -m tests.benchmarks.planning.bench_pddl [FOLDER ...]      (not a test: times are this machine's)

Every file of the folders is read; what is allowed is 20 ms + 1.5 ms per kB for a pair.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from planner_bridge.pipeline.loading import load
from pnm.errors import InputError
from tests.support.files import SHARED
from tests.support.runs.timing import seconds

KNOWN = SHARED / "pddl"
LIMIT = 60.0


def ours(pair: Path) -> float | None:
    try:
        return seconds(lambda: load(pair / "domain.pddl", pair / "problem.pddl"), 5)
    except InputError:
        return None


def read_with_unified_planning(pairs: list[Path], told: Connection) -> None:
    """Tell (name, seconds) for every pair; None for what cannot be read."""
    from unified_planning.io import PDDLReader
    from unified_planning.shortcuts import get_environment

    get_environment().credits_stream = None
    get_environment().error_used_name = False
    for pair in pairs:
        try:
            took = seconds(lambda pair=pair: PDDLReader().parse_problem(str(pair / "domain.pddl"), str(pair / "problem.pddl")), 1)  # type: ignore[misc]
        except Exception:  # its grammar raises whatever it likes
            told.send(None)
        else:
            told.send(took)


def theirs(pairs: list[Path]) -> dict[str, float | None]:
    """Read every pair in a child process, which is started anew behind a pair that takes too long."""
    found: dict[str, float | None] = {}
    while left := [pair for pair in pairs if pair.name not in found]:
        receive, send = get_context("spawn").Pipe(duplex=False)
        child = get_context("spawn").Process(target=read_with_unified_planning, args=(left, send))
        child.start()
        for pair in left:
            found[pair.name] = receive.recv() if receive.poll(LIMIT) else None
            if not receive.poll(0) and not child.is_alive():
                break
        child.kill()
        child.join()
    return found


def whole_process(command: list[str]) -> float:
    began = time.perf_counter()
    subprocess.run(command, capture_output=True, check=True)
    return time.perf_counter() - began


def main() -> None:
    folders = [Path(name) for name in sys.argv[1:]] or [KNOWN / "robots", KNOWN / "ipc"]
    pairs = sorted(pair for folder in folders for pair in folder.iterdir() if pair.is_dir())
    other = theirs(pairs)
    ratios, worst = [], 0.0
    for pair in pairs:
        size = sum((pair / name).stat().st_size for name in ("domain.pddl", "problem.pddl")) / 1000
        took, peer = ours(pair), other[pair.name]
        if took is None:
            print(f"{pair.name:42} {size:6.1f} kB   refused")
            continue
        allowed = 0.020 + 0.0015 * size
        worst = max(worst, took / allowed)
        compared = "unified-planning does not read it" if peer is None else f"unified-planning {peer:7.3f} s = {peer / took:6.0f} x"
        ratios += [] if peer is None else [peer / took]
        print(f"{pair.name:42} {size:6.1f} kB {took * 1000:7.2f} ms = {took / allowed:4.2f} of what is allowed   {compared}")
    print(f"worst: {worst:.2f} of what is allowed")
    print(f"unified-planning reads {len(ratios)} and takes {statistics.median(ratios):.0f} x as long in the median")
    folder = Path(sys.executable).parent
    robot = KNOWN / "robots" / "delivery_w6_m5_g3"
    if robot.is_dir():
        files = [str(robot / "domain.pddl"), str(robot / "problem.pddl")]
        pnm, kairos = [sys.executable, "-m", "planner_bridge", "plan", *files], [str(folder / "kairos"), *files, "--no-anytime"]
        rounds = [(whole_process(pnm), whole_process(kairos)) for _ in range(9)]
        ratio = statistics.median(one / other for one, other in rounds)
        print(f"pnm plan / kairos as whole processes on {robot.name}: {ratio:.1f}")


if __name__ == "__main__":
    main()
