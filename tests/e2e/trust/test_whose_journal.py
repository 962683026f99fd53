"""Journals are like scripts: whose they are, who may read them, and what they keep to themselves."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import stat
import subprocess
import sys
from contextlib import closing
from itertools import takewhile
from pathlib import Path
from types import SimpleNamespace

import pytest

from planner_bridge.cli.options import announce
from pnm.errors import InputError
from pnm.files.database.place import ServerUrl, without_password
from pnm.files.text import private_folder, secret_in
from tests.support.e2e.command_line import pnm
from tests.support.files import ROOT
from tests.support.processes import LIMIT, Program
from tests.support.tasks.scenarios.forged_journal import forged

PRECIOUS = "precious\nDo you want that? y"
"""The name of a file, which looks like an answer where its line break is printed."""
FILES = (str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl"))


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def died(tmp_path: Path) -> Path:
    """The journal of a run that was killed, with an option that replaces a file."""
    journal, other = tmp_path / "run.journal", tmp_path / PRECIOUS
    other.write_text("precious")
    given = ["run", *FILES, "--actions", "simulated", "--timeline", str(other), "--force", "--view=0", "--journal", str(journal)]
    with closing(Program(["-m", "planner_bridge", *given], {})) as program:
        program.until(lambda: any("start" in line for line in program.out))
        program.process.send_signal(signal.SIGKILL)
        program.process.wait()
    assert other.read_text() == "precious"
    return journal


def test_a_journal_that_somebody_else_has_begun_is_asked_about(died: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "elsewhere"))  # another user, or another computer
    done = pnm("resume", str(died))
    assert done.returncode == 2
    for said in ("not begun by you", "--timeline writes a file", "--force replaces files", "--view serves a page", str(FILES[0]), "--yes"):
        assert said in done.stderr
    assert (tmp_path / PRECIOUS).read_text() == "precious"


@pytest.mark.parametrize("answer", ["", "y"])
def test_at_a_terminal_it_is_done_if_somebody_says_so(answer: str, died: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "elsewhere"))
    hands, terminal = pty.openpty()
    os.write(hands, f"{answer}\n".encode())
    command = [sys.executable, "-m", "planner_bridge", "resume", str(died)]
    resumed = subprocess.Popen(command, cwd=ROOT, stdin=terminal, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with resumed, os.fdopen(hands), os.fdopen(terminal):
        if answer != "y":
            _, err = resumed.communicate(timeout=LIMIT)
        else:
            assert resumed.stderr
            err = "".join(takewhile(lambda line: "stays until" not in line, resumed.stderr))
            resumed.send_signal(signal.SIGINT)
            err += resumed.communicate(timeout=LIMIT)[1]
    would, question, *_ = err.splitlines()
    assert would.startswith(f"{died} was not begun by you on this computer")
    assert " ".join(PRECIOUS.split()) in would
    assert question.startswith("Do you want that? [y/N]: ")
    assert ((tmp_path / PRECIOUS).read_text() == "precious") is (answer != "y")
    assert ("nothing was done" in err, resumed.returncode) == ((False, 0) if answer == "y" else (True, 2))


def test_another_journal_goes_on_with_yes(died: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "elsewhere"))
    with closing(Program(["-m", "planner_bridge", "resume", str(died), "--yes"], {})) as program:
        program.until(lambda: any("stays until" in line for line in program.err))
        program.process.send_signal(signal.SIGINT)
        program.ended()
    assert (tmp_path / PRECIOUS).read_text().startswith("<svg")


def test_a_command_that_was_changed_in_a_journal_of_ones_own_is_asked_about(died: Path, tmp_path: Path) -> None:
    with forged(died) as journal:
        number, text = journal.execute("SELECT sequence, text FROM records WHERE text LIKE '%SharedBegan%'").fetchone()
        record = json.loads(text)
        record["command"] = [*record["command"], "--timeline", str(tmp_path / "other")]
        journal.execute("UPDATE records SET text = ? WHERE sequence = ?", (json.dumps(record), number))
    done = pnm("resume", str(died))
    assert done.returncode == 2
    assert "not begun by you" in done.stderr
    assert not (tmp_path / "other").exists()


def test_only_its_user_may_read_a_journal_and_the_folders_made_for_it(tmp_path: Path) -> None:
    previous = os.umask(0o022)
    try:
        journal, knowledge = tmp_path / "run.journal", tmp_path / "knowledge.sqlite"
        given = ["run", *FILES, "--journal", str(journal)]
        with closing(Program(["-m", "planner_bridge", *given], {})) as program:
            program.until(lambda: any("start" in line for line in program.out))
            made = sorted(file for file in tmp_path.iterdir() if file.name.startswith("run.journal"))
            assert [file.name.removeprefix("run.journal") for file in made if "tmp" not in file.name][:4] == ["", "-lock", "-shm", "-wal"]
            assert {mode(file) for file in made} == {0o600}
        private_folder(tmp_path / "a" / "b")
        secret_in(tmp_path / "a" / "b")
        assert (mode(tmp_path / "a"), mode(tmp_path / "a" / "b"), mode(tmp_path / "a" / "b" / "secret")) == (0o700, 0o700, 0o600)
        plan = tmp_path / "plan.yaml"
        plan.write_text("plan:\n  - LocalUpdate: {x: 1}\n  - GlobalUpdate: {x: 1}\n")
        pnm("run", "--plan", str(plan), "--knowledge", str(knowledge))
        assert not knowledge.exists() or mode(knowledge) == 0o600
    finally:
        os.umask(previous)


def test_no_password_is_kept_or_printed(tmp_path: Path) -> None:
    journal, plan = tmp_path / "run.journal", tmp_path / "hello.yaml"
    plan.write_text("actions:\n  say: {params: [text], server: /say, timeout: 5}\nplan:\n  - say: {text: hello}\n")
    url = "postgresql://ada:sekret@pw@127.0.0.1:1/db"
    done = pnm("run", "--plan", str(plan), "--journal", str(journal), "--knowledge", url)
    printed = done.stdout + done.stderr + pnm("replay", str(journal), "--json").stdout + pnm("resume", str(journal)).stderr
    kept = b"".join(file.read_bytes() for file in tmp_path.iterdir())
    assert b"postgresql://ada@127.0.0.1:1/db" in kept
    assert "sekret" not in printed
    assert b"sekret" not in kept


@pytest.mark.parametrize(
    "url", ["postgresql://u:sek#ret@h/db", "postgresql://u:sek/ret@h/db", "postgresql://u:sek?ret=1@h/db", "postgresql://u:9sek@h:x/db"]
)
def test_an_error_about_a_url_quotes_nothing_of_a_password(url: str) -> None:
    with pytest.raises(InputError) as error:
        ServerUrl.of(url)
    assert not {"sek", "ret"} & {*re.findall("sek|ret", str(error.value))}


def test_no_password_is_in_the_list_of_processes(tmp_path: Path) -> None:
    plan = tmp_path / "hello.yaml"
    plan.write_text("actions:\n  say: {params: [text], server: /say, timeout: 5}\nplan:\n  - say: {text: hello}\n")
    given = ["run", "--plan", str(plan), "--view=0", "--knowledge", "postgresql://ada:sekret@127.0.0.1:1/db"]
    with closing(Program(["-m", "planner_bridge", *given], {})) as program:
        program.until(lambda: any("view  " in line for line in program.err))
        listed = Path(f"/proc/{program.process.pid}/cmdline").read_text()
        assert "postgresql://ada@127.0.0.1:1/db" in listed
        assert "sekret" not in listed
        assert str(plan) in listed.split("\0")


def test_options_keep_everything_but_passwords() -> None:
    for text in ("--set=a=b:c@d", "postgresql://ada@host/db?name=x", "--knowledge=/a:b@c", "http://u:p@h"):
        assert without_password(text) == text
    assert without_password("--knowledge=postgres://:p:@q@h/db") == "--knowledge=postgres://@h/db"


def test_the_token_of_a_page_is_printed_on_terminals_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    state = tmp_path / "state"
    monkeypatch.setenv("XDG_STATE_HOME", str(state))
    with closing(Program(["-m", "planner_bridge", "run", *FILES, "--view=0", "--view-controls"], {})) as program:
        program.until(lambda: any("stays until" in line for line in program.err))
        assert "token=" not in str(program)
        (file,) = (state / "pnm").glob("page-*.url")
        assert str(file) in str(program)
        assert (mode(file), mode(file.parent)) == (0o600, 0o700)
        assert "/#token=" in file.read_text()
        program.process.send_signal(signal.SIGINT)
        program.ended()
    read, write = os.openpty()
    monkeypatch.setattr(sys, "stderr", os.fdopen(write, "w"))
    announce(SimpleNamespace(url="http://127.0.0.1:1/#token=abc"))  # type: ignore[arg-type]
    assert b"/#token=abc" in os.read(read, 1000)
    sys.stderr.close()
    os.close(read)
