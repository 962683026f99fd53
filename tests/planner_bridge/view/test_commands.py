"""The option `--view` of commands: what is wrong with it is said before anything moves."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pnm.errors import installation
from tests.support.e2e.command_line import pnm
from tests.support.e2e.page.serving import Stream, asked
from tests.support.processes import Program, parent, until

FILES = ("domains/delivery/domain.pddl", "problems/delivery/p01.pddl")


@pytest.fixture
def taken() -> Iterator[int]:
    """A port that somebody else has."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("replay", "{journal}", "--view=0", "--to", "3"), "expected no --to"),
        (("replay", "/nowhere/at.journal", "--view=0"), "there is no such file"),
        (("replay", "{journal}", "--view=70000"), "65535"),
        (("serve", *FILES, "--journal", "none", "--view=0"), "expected one, and not --journal none"),
    ],
)
def test_what_cannot_be_shown_is_refused(arguments: tuple[str, ...], said: str, delivery: Path) -> None:
    done = pnm(*(argument.format(journal=delivery) for argument in arguments))
    assert done.returncode == 2
    assert said in done.stderr


def test_a_port_that_is_taken_is_said_before_anything_moves_and_may_be_left_out(taken: int, delivery: Path) -> None:
    for arguments in (("run", "--view", str(taken), *FILES), ("replay", str(delivery), f"--view={taken}")):
        done = pnm(*arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"cannot be at port {taken}" in done.stderr
        assert "--view=0" in done.stderr
    done = pnm("run", "--view", "domains/none.pddl", "problems/none.pddl")
    assert "none.pddl" in done.stderr or "port 8421" in done.stderr


def test_what_serves_the_page_is_named_if_it_is_not_there(delivery: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    done = pnm("replay", str(delivery), "--view=0")
    assert (done.returncode, done.stdout) == (2, "")
    assert installation("view") in done.stderr


def url_in(program: Program) -> str:
    return program.until(lambda: next((line.split()[1] for line in program.err if line.startswith("view ")), ""))


def test_a_journal_is_shown_until_ctrl_c_ends_it_also_while_a_browser_watches(delivery: Path, tmp_path: Path) -> None:
    program = Program(["-m", "planner_bridge", "replay", str(delivery), "--view=0"], {"TMPDIR": str(tmp_path)})
    try:
        stream = Stream(url_in(program))
        assert stream.next()[1]["is_whole"]
        program.process.send_signal(signal.SIGINT)
        assert program.ended() == 0
        with pytest.raises(EOFError):
            stream.next()
        stream.close()
        assert not list(tmp_path.glob("pnm-view-*"))
    finally:
        program.close()


def test_the_page_of_a_run_ends_with_the_run_whatever_ends_that(tmp_path: Path) -> None:
    program = Program(["-m", "planner_bridge", "run", *FILES, "--view=0", "--journal", str(tmp_path / "journal")], {})
    try:
        url = url_in(program)
        program.until(lambda: any("stays until" in line for line in program.err))
        stream = Stream(url)
        last = stream.next()[1]["number"]
        stream.close()
        assert json.loads(asked(url, f"/state?at={last}")[2])["parts"]["tasks"]
        children = [int(folder.name) for folder in Path("/proc").glob("[0-9]*") if _is_child(int(folder.name), program.process.pid)]
        assert len(children) == 1
        program.process.kill()
        until(lambda: not _lives(children[0]))
    finally:
        program.close()


def _is_child(process: int, of: int) -> bool:
    try:
        return parent(process) == of
    except OSError:
        return False


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
