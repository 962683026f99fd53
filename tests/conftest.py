"""Where things are, and plans to try things on."""

from __future__ import annotations

import gc
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from planner_bridge.pipeline.achieve import achieve
from pnm.actions.faults import read_faults
from pnm.files.database.place import Place, place_of
from tests.support.e2e.hosts.postgres import PostgresServer, postgres_server
from tests.support.files import ROOT

END_TO_END = ROOT / "tests" / "e2e"
OVER_ROS = (END_TO_END, ROOT / "tests" / "pnm" / "ros")
"""Tests over a middleware whose discovery promises no time."""
TOO_LONG = 600
"""Seconds after which a test hangs, on however busy a machine."""

patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])  # a busy machine takes its time
settings.register_profile("commit", patient, max_examples=40)  # others for every commit
settings.register_profile("thorough", patient, max_examples=1000)  # before a release: --hypothesis-profile thorough
settings.load_profile("commit")

for ignored in (signal.SIGINT, signal.SIGHUP):  # we may be in the background of a shell: our children are not to ignore them as well
    if signal.getsignal(ignored) is signal.SIG_IGN:
        signal.signal(ignored, signal.default_int_handler if ignored is signal.SIGINT else signal.SIG_DFL)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """Have the files distributed in the order below; by default, the few long tests of many processes would all be at the end."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files whose tests mostly wait for other processes among the others, so that the processors always have work.

    Those over ROS have a second try, as in the continuous integration of ROS 2 itself; the summary says who needed it, and why.
    """
    for item in items:
        if any(folder in item.path.parents for folder in OVER_ROS):
            item.add_marker(pytest.mark.flaky(reruns=1))
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    waiting = [file for file in files if END_TO_END in file.parents]
    others = [file for file in files if END_TO_END not in file.parents]
    places = [(number * 3 * len(others) // (4 * len(waiting)), file) for number, file in enumerate(waiting)]
    for place, file in reversed(places):
        others.insert(place, file)
    items[:] = [item for file in others for item in files[file]]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say why tests were run again: what fails now and then is to be understood as well."""
    for report in terminalreporter.getreports("rerun"):
        terminalreporter.write_sep("_", f"run again: {report.nodeid}")
        terminalreporter.write_line(report.longreprtext)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Have a test that hangs fail where it does, with its stack, and the others go on."""

    def fail(number: int, frame: object) -> None:
        pytest.fail(f"{item.name} has not ended within {TOO_LONG} s")

    signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, TOO_LONG, 10)  # again and again, for callbacks of an event loop swallow it
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def pytest_collection_finish() -> None:
    """Take what is loaded by now for what it is: no garbage. Hundreds of tests look for garbage, and would look through all of it."""
    gc.freeze()


@pytest.fixture
def root() -> Path:
    return ROOT


@pytest.fixture(autouse=True)
def own_state(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep tests, and the processes they start, away from the knowledge of whoever runs them."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp() / "state"))


@pytest.fixture(scope="session")
def postgres() -> Iterator[PostgresServer]:
    """A PostgreSQL server of this test session."""
    with postgres_server() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgres"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    """A place for a database, where there is none yet: a file, and then PostgreSQL."""
    if request.param == "sqlite":
        return tmp_path / "database"
    server: PostgresServer = request.getfixturevalue("postgres")
    return place_of(server.database())


@pytest.fixture(scope="session")
def delivery(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of a run in which a move fails four times: the plan goes on once, and there is a new one then."""
    journal = tmp_path_factory.mktemp("delivery") / "run.journal"
    domain, problems = ROOT / "domains" / "delivery" / "domain.pddl", ROOT / "problems" / "delivery"
    result = achieve(domain, problems / "p01.pddl", faults=read_faults(problems / "faults.yaml", None), journal=journal)
    assert (result.goal_reached, result.replans) == (True, 2)
    return journal
