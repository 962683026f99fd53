"""Texts that attack whoever shows them, through every command that prints, and into every file that is written."""

from __future__ import annotations

import io
import json
from contextlib import closing
from pathlib import Path
from urllib.parse import quote
from uuid import UUID
from xml.etree import ElementTree

import pytest
from hypothesis import given, strategies as st
from rich.table import Table
from rich.text import Text

from planner_bridge.cli.console import EventLines, SafeConsole
from planner_bridge.cli.running_node import EventPrinter, TaskBoard
from planner_bridge.view.app import shown_json
from planner_bridge.view.follow import Reader
from pnm.core.pictures.export import quoted
from pnm.core.pictures.xml_text import picture, xml
from pnm.errors import printable, printable_lines
from pnm.tasks import TraceEvent, TraceKind
from tests.support.e2e.command_line import Done, pnm
from tests.support.e2e.page.hostile import HOSTILE, hostile_journal, is_safe
from tests.support.e2e.page.serving import asked, page_of
from tests.support.files import ROOT
from tests.support.processes import Program

DOMAIN, PROBLEMS = str(ROOT / "domains/delivery/domain.pddl"), ROOT / "problems/delivery"
FILES = (DOMAIN, str(PROBLEMS / "p01.pddl"))
PLAN = f"actions:\n  say: {{params: [text], server: /say, timeout: 5}}\nplan:\n  - say: {{text: {json.dumps(HOSTILE)}}}\n"
ANY = st.text(st.characters(exclude_categories=()), max_size=40) | st.just(HOSTILE)


FOREIGN = """
import os, sys
from planner_bridge.cli import commands
commands.app = lambda **_: (os.write(1, b"[RTPS_TRANSPORT_SHM Error]\\n"), print("{}", flush=True), open(sys.argv[1], "a").write("[]\\n"))
commands.main()
"""
"""A command in which a library writes to the standard output itself, as Fast DDS does when the port of another process is taken."""


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The journal of a run with failures, in which every name and message attacks."""
    folder = tmp_path_factory.mktemp("hostile")
    done = pnm("run", *FILES, "--faults", str(PROBLEMS / "faults.yaml"), "--quiet", "--journal", str(folder / "good.journal"))
    assert done.returncode == 0
    return hostile_journal(folder / "good.journal", folder / "evil.journal")


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    file = tmp_path / "hello.yaml"
    file.write_text(PLAN)
    return file


def test_what_a_library_prints_is_not_among_lines_of_ours() -> None:
    with closing(Program(["-c", FOREIGN, "/dev/stdout"], {})) as program:
        program.ended()
    assert (program.out, program.err) == (["{}", "[]"], ["[RTPS_TRANSPORT_SHM Error]"])


# --- the functions that texts pass ---


@given(ANY)
def test_a_printable_text_controls_nothing_and_stays_as_it_is(text: str) -> None:
    shown = printable(text)
    assert is_safe(shown.replace("\u200c", "").replace("\u200d", ""))
    assert "\n" not in shown
    assert (printable(shown), len(shown)) == (shown, len(text))
    assert printable_lines(text).split("\n") == [printable(line) for line in text.split("\n")]


@given(ANY)
def test_any_text_can_be_drawn_and_read_again(text: str) -> None:
    drawn = ElementTree.fromstring(picture("plan", text, "", 1, 1, [f'<text class="{xml(text)}">{xml(text)}</text>']))
    assert [part.text or "" for part in drawn.iter() if part.tag.endswith(("title", "text"))] == [printable_lines(text)] * 2
    assert is_safe(quoted(text).replace("\u200c", "").replace("\u200d", ""))
    assert json.loads(shown_json(text)).isascii() or shown_json(text).encode()


@given(ANY, st.booleans())
def test_a_console_prints_any_text_as_a_text_whatever_it_comes_in(text: str, is_terminal: bool) -> None:
    out = io.StringIO()
    console = SafeConsole(file=out, width=200, force_terminal=is_terminal, color_system=None)
    table = Table(text, box=None)
    table.add_row(text, Text(text, "bold"))
    console.print(text, Text(text), table, sep="\n")
    console.print_text(text, "[bold]goal[/] ")
    console.print_reason("[bold]goal[/]", text)
    EventLines(console).print(0.0, Text(text), text, text)
    assert is_safe(out.getvalue().replace("\u200c", "").replace("\u200d", ""))
    assert out.getvalue().count("[/nope]") >= 8 * text.count("[/nope]")


@given(ANY)
def test_what_a_node_says_is_printed_as_it_is(text: str) -> None:
    out = io.StringIO()
    printer = EventPrinter(SafeConsole(file=out, width=200))
    for kind in (TraceKind.GOAL, TraceKind.STATE, TraceKind.SENT, TraceKind.ENDED):
        printer.print(TraceEvent(UUID(int=1), 1.0, kind, text, text), text)
    SafeConsole(file=out).print(TaskBoard({UUID(int=1): text}, {UUID(int=1): text}, {UUID(int=1): {text: (None, text)}}).shown(0.0))
    printer.close()
    assert is_safe(out.getvalue().replace("\u200c", "").replace("\u200d", ""))


# --- commands ---


def safe(done: Done, *, attacks: bool = True) -> str:
    """What a command has printed, which must attack nobody; by default something of it tried to."""
    printed = done.stdout + done.stderr
    assert is_safe(printed), ascii(printed)
    assert "internal error" not in printed
    assert ("OWNED" in printed) or not attacks, printed
    return done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("history",),
        ("history", "--json"),
        ("replay",),
        ("replay", "--json"),
        ("replay", "--to", "60"),
        ("why", "--journal"),
        ("why", "--json", "--journal"),
        ("why", "--call", "1", "--journal"),
        ("resume",),
    ],
    ids=" ".join,
)
def test_a_journal_attacks_no_terminal(arguments: tuple[str, ...], journal: Path) -> None:
    printed = safe(pnm(*arguments, str(journal)))
    if "--json" in arguments:
        assert all(json.loads(line) for line in printed.splitlines())


def test_a_timeline_of_a_journal_is_a_picture(journal: Path, tmp_path: Path) -> None:
    file = tmp_path / "t.svg"
    assert pnm("replay", str(journal), "--timeline", str(file)).returncode == 0
    assert is_safe(file.read_text())
    assert "OWNED" in "".join(ElementTree.parse(file).getroot().itertext())


def test_the_page_of_a_journal_gets_texts_and_pictures(journal: Path) -> None:
    with page_of(journal) as url:
        last = Reader(journal).newest().number
        parts = json.loads(asked(url, f"/state?at={last}")[2])["parts"]
        paths = [f"/state?at={last}", *(f"/call?call={call}&at={last}" for call in parts["calls"])]
        paths += [f"/why?call={[*parts['calls']][-1]}&at={last}", *(f"/plan?run={run}&at={last}" for run in parts["runs"])]
        for path in paths:
            status, _, text = asked(url, path)
            assert status == 200, path
            assert is_safe(text), path
            assert "OWNED" in text, path
            if path.startswith("/plan"):
                assert json.loads(text)[0]["cells"]
        for name in ("/state?at=", "/call?at=1&call="):
            status, _, text = asked(url, name + quote(HOSTILE))
            assert (status, is_safe(text)) == (400, True)


@pytest.mark.parametrize("written_as", ["dot", "svg", "json"])
def test_a_plan_is_written_in_every_format(written_as: str, plan: Path, tmp_path: Path) -> None:
    file = tmp_path / "net"
    printed = safe(pnm("net", "--plan", str(plan), "--format", written_as))
    assert pnm("net", "--plan", str(plan), "--format", written_as, "-o", str(file)).returncode == 0
    assert file.read_text() == printed
    if written_as == "svg":
        assert "OWNED" in "".join(ElementTree.fromstring(printed).itertext())
    if written_as == "json":
        assert HOSTILE in json.loads(printed)["calls"][0]["arguments"]


@pytest.mark.parametrize("option", ["--quiet", "--verbose", "--json"])
def test_a_run_prints_and_draws_what_it_has_done(option: str, plan: Path, tmp_path: Path) -> None:
    file = tmp_path / "t.svg"
    safe(pnm("run", "--plan", str(plan), option, "--timeline", str(file)), attacks=option == "--verbose")
    assert is_safe(file.read_text())
    assert "OWNED" in "".join(ElementTree.parse(file).getroot().itertext())


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "--plan", f"no{HOSTILE.replace(chr(0), '')}.yaml"),
        ("history", f"no{HOSTILE.replace(chr(0), '')}.journal"),
        ("plan", DOMAIN, f"no{HOSTILE.replace(chr(0), '')}.pddl"),
        ("plan", *FILES, "--planner", HOSTILE.replace("\0", "")),
        ("replay", f"postgresql://u@127.0.0.1:1/{HOSTILE.replace(chr(0), '')}"),
        ("nothing", HOSTILE.replace("\0", "")),
        ("why", *FILES, "--not", HOSTILE.replace("\0", "")),
    ],
    ids=lambda arguments: arguments[0],
)
def test_an_error_attacks_no_terminal(arguments: tuple[str, ...]) -> None:
    done = pnm(*arguments)
    assert done.returncode in (1, 2)
    safe(done, attacks=False)
    assert done.stderr


def test_a_process_attacks_no_terminal() -> None:
    with closing(Program(["-m", "planner_bridge", "run", "--plan", f"no{HOSTILE.replace(chr(0), '')}.yaml"], {})) as program:
        assert program.ended() == 2
        assert is_safe("\n".join((*program.out, *program.err)))
        assert program.err
