"""The application of the page: who may ask, and what is answered."""

from __future__ import annotations

import http.client
import json
import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from planner_bridge.view import app
from planner_bridge.view.app import PAGE
from planner_bridge.view.story import View
from tests.support.e2e.page.journals import GrowingJournal
from tests.support.e2e.page.serving import Stream, asked, page_of
from tests.support.processes import LIMIT, until


@pytest.fixture(scope="module")
def url(delivery: Path) -> Iterator[str]:
    with page_of(delivery) as served:
        yield served


def test_the_page_and_its_files_come_with_what_keeps_them_among_themselves(url: str) -> None:
    files = ["/", "/page/tokens.css", *(f"/page/{file.name}" for file in PAGE.iterdir())]
    assert len(files) > 5
    for file in files:
        status, headers, text = asked(url, file)
        assert (status, bool(text)) == (200, True)
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in headers


def test_the_page_needs_nothing_from_elsewhere() -> None:
    for file in PAGE.iterdir():
        text = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"""https?:|["'(]//|@import""", text), file


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:{port}"])
def test_a_request_to_another_name_is_refused(url: str, host: str) -> None:
    status, _, text = asked(url, "/state?at=1", Host=host.format(port=urlsplit(url).port))
    assert (status, "tasks" in text) == (421, False)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1"])
@pytest.mark.parametrize("path", ["/", "/state?at=1", "/events"])
def test_a_request_of_another_page_is_refused(url: str, origin: str, path: str) -> None:
    assert asked(url, path, Origin=origin.format(port=urlsplit(url).port))[0] == 403


def test_its_own_page_may_ask_under_both_names_of_this_computer_and_change_nothing(url: str) -> None:
    port = urlsplit(url).port
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert asked(url, "/state?at=1", method)[0] == 405
    for name in ("127.0.0.1", "localhost"):
        assert asked(url, "/state?at=1", Host=f"{name}:{port}", Origin=f"http://{name}:{port}")[0] == 200


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/nothing", 404),
        ("/page/nothing.js", 404),
        ("/page/../app.py", 404),
        ("/page/%2e%2e/app.py", 404),
        ("/state", 400),
        ("/state?at=x", 400),
        ("/state?at=-1", 400),
        ("/state?at=0", 404),
        ("/state?at=99999", 404),
        ("/state?at=99999999999999999999999999", 404),
        (f"/state?at={'9' * 5000}", 400),
        (f"/call?call={'0' * 32}/{'9' * 5000}&at=5", 400),
        ("/call?at=5", 400),
        ("/call?call=0/x&at=5", 400),
        ("/call?call=0/0&at=5", 400),
        (f"/call?call={'0' * 32}/0&at=5", 404),
        ("/why?at=5", 400),
        (f"/why?call={'0' * 32}/0&at=5", 404),
        ("/plan?run=0&at=5", 404),
        ("/state?time=x", 400),
        ("/state?time=1e5", 400),
    ],
)
def test_what_is_not_there_is_said_so(url: str, path: str, status: int) -> None:
    found, headers, text = asked(url, path)
    assert found == status
    assert "Traceback" not in text
    assert headers["content-security-policy"]


def test_so_many_browsers_may_watch_and_no_more_until_one_has_left(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "WATCHING", 8)
    watching = [Stream(url) for _ in range(8)]
    status, _, text = asked(url, "/events")
    assert (status, "8 browsers" in text) == (503, True)
    assert asked(url, "/state?at=5")[0] == 200
    for stream in watching:
        stream.close()
    until(lambda: _can_watch(url))


def _can_watch(url: str) -> bool:
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=60)
    connection.request("GET", "/events", headers={"Last-Event-ID": "9" * 5000})
    status = connection.getresponse().status
    connection.close()
    return status == 200


def test_a_frame_is_made_once_for_all_browsers_that_have_seen_the_same(growing: GrowingJournal, monkeypatch: pytest.MonkeyPatch) -> None:
    made = list[tuple[View | None, View]]()

    def counted(before: View | None, after: View) -> dict[str, Any]:
        made.append((before, after))
        return own(before, after)

    own = app.frame
    monkeypatch.setattr(app, "frame", counted)
    growing.grow(5)
    received = 0
    with page_of(growing.place) as served:
        watching = [Stream(served) for _ in range(40)]
        for record in range(5, growing.longest, 10):
            growing.grow(record)
            for stream in watching:
                received += 1
                while stream.next()[1]["number"] < record:
                    received += 1
        for stream in watching:
            stream.close()
    pairs = [(id(before), id(after)) for before, after in made]
    assert len(pairs) == len(set(pairs)), "no frame is made twice"
    assert received >= 40 * len({after for _, after in pairs}) > 0
    assert len(pairs) < received / 10, "those who keep up have seen the same"


def test_what_many_ask_of_a_call_is_answered_once(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked_for = list[object]()
    own = app.drawn

    def counted(run: Any) -> list[dict[str, Any]]:
        asked_for.append(run)
        return own(run)

    monkeypatch.setattr(app, "drawn", counted)
    run = next(iter(json.loads(asked(url, "/state?at=60")[2])["parts"]["runs"]))
    answers = {asked(url, f"/plan?run={run}&at=58")[2] for _ in range(10)}
    assert (len(answers), len(asked_for)) == (1, 1)
    assert [asked(url, f"/plan?run={run}&at=99999")[0] for _ in range(2)] == [404, 404]


def test_the_state_a_call_and_a_plan_after_a_record(url: str) -> None:
    state = json.loads(asked(url, "/state?at=60")[2])
    assert (state["number"], state["is_whole"]) == (60, True)
    for key, call in state["parts"]["calls"].items():
        told = json.loads(asked(url, f"/call?call={key}&at=60")[2])
        assert told["action"] == call["action"]
    for run in state["parts"]["runs"]:
        (whole,) = json.loads(asked(url, f"/plan?run={run}&at=60")[2])
        calls = {call["index"] for call in state["parts"]["calls"].values() if call["run"] == run}
        assert {cell["step"] for cell in whole["cells"]} == calls
        assert all(arrow["protects"] for arrow in whole["arrows"]), "the facts that are waited for"


def test_a_moment_is_found_by_its_time(url: str) -> None:
    """The state by a time is that after the last record until then; before all of them it is that after the first one."""
    for time, latest in ((-1.0, 0.0), (12.0, 12.0), (13.99, 12.0), (1e6, 1e6)):
        found = json.loads(asked(url, f"/state?time={time:f}")[2])
        assert found["time"] <= latest
        following = asked(url, f"/state?at={found['number'] + 1}")
        assert following[0] == 404 or json.loads(following[2])["time"] > time or found["number"] == 1


def test_a_day_has_all_tasks_with_what_robots_did_for_them(url: str) -> None:
    (task,) = json.loads(asked(url, "/day")[2])
    assert (task["title"], task["code"], task["plans"]) == ("(and (at parcel1 hall) (at parcel2 kitchen))", "goal_reached", 2)
    assert task["ended"] - task["accepted"] == task["seconds"] > 0.0
    assert set(task["busy"]) == {"r1", "r2"}


@pytest.mark.parametrize(("path", "reads"), [("/metrics", "metrics.Metrics.text"), ("/day", "app.day_of")])
def test_who_has_a_whole_journal_read_keeps_nobody_from_the_page(
    path: str, reads: str, delivery: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, goes_on = threading.Event(), threading.Event()

    def read(*_: object) -> str:
        begun.set()
        goes_on.wait(LIMIT)
        return ""

    monkeypatch.setattr(f"planner_bridge.view.{reads}", read)
    with page_of(delivery) as url, ThreadPoolExecutor(40) as others:
        waiting = [others.submit(asked, url, path) for _ in range(40)]  # more than the threads of the page
        begun.wait(LIMIT)
        status = asked(url, "/state?at=5")[0]
        assert (status, any(one.done() for one in waiting)) == (200, False)
        goes_on.set()
        assert {one.result()[0] for one in waiting} == {200}
