"""What answers runs from outside: who is asked, what is kept, and that nothing waits without a limit."""

from __future__ import annotations

import asyncio
import json
import os
import pty
import sqlite3
import subprocess
import sys
from collections.abc import Coroutine, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pnm.clock import run_async
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.errors import InputError, Position
from pnm.knowledge.sources import (
    Asker,
    SourceChoice,
    SourceError,
    Sources,
    Surroundings,
    check_source,
    open_sources,
    register_source,
    registry,
    source_names,
)
from pnm.knowledge.sources import sqlite as sqlite_source
from pnm.knowledge.sources.memory import MemoryKnowledge, read_value, write_value
from pnm.knowledge.sources.person_text import message_text, printable, question_text, read_answer
from pnm.knowledge.sources.sqlite import SqliteKnowledge, default_path
from pnm.knowledge.sources.terminal import TerminalSource

ME = Asker(UUID(int=7), "tour")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


def about(name: str, layer: Layer = Layer.GLOBAL, meta: object = None) -> Question:
    return Question(name, layer, json.dumps(meta))


def run(main: Coroutine[Any, Any, Any], *, virtual: bool = True) -> Any:
    async def bounded() -> Any:
        return await asyncio.wait_for(main, 1000.0)

    return run_async(bounded(), virtual=virtual)


@dataclass
class Scripted:
    """A source that answers what it is told to, after a while."""

    answers: dict[str, object] = field(default_factory=dict)
    seconds: float = 0.0
    error: Exception | None = None
    updates: list[tuple[str, object]] = field(default_factory=list)
    closed: bool = False

    async def query(self, question: Question, asker: Asker, /) -> object:
        await asyncio.sleep(self.seconds)
        if self.error:
            raise self.error
        return self.answers.get(question.name, MISSING)

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        await asyncio.sleep(self.seconds)
        self.updates.append((question.name, value))

    async def close(self) -> None:
        if self.error:
            raise self.error
        self.closed = True

    def __repr__(self) -> str:
        return "<Scripted>"


# --- the chain -----------------------------------------------------------------------------


@pytest.mark.parametrize("layer", [Layer.GLOBAL, Layer.ALL])
def test_knowledge_bases_are_asked_in_order(layer: Layer) -> None:
    sources = Sources([Scripted({"a": 1}), Scripted({"a": 2, "b": None, "c": False})])
    found = [run(sources.query(about(name, layer), ME)) for name in "abcd"]
    assert found == [1, MISSING, False, MISSING]


@pytest.mark.parametrize("question", [about("shop", Layer.PERSON), about("USER"), about("CONTROLLER", Layer.ALL)], ids=str)
def test_people_are_asked_and_told_what_is_for_them(question: Question) -> None:
    person, shared = Scripted({question.name: "bakery"}), Scripted({question.name: "wrong"})
    sources = Sources([shared], person)
    assert run(sources.query(question, ME)) == "bakery"
    run(sources.update(question, "done", ME))
    assert (person.updates, shared.updates) == ([(question.name, "done")], [])


def test_a_local_variable_called_user_is_no_person() -> None:
    assert run(Sources([Scripted({"USER": 1})], Scripted()).query(about("USER", Layer.LOCAL), ME)) == 1


def test_an_update_goes_where_the_next_query_finds_it() -> None:
    first, second = MemoryKnowledge(), Scripted({"a": "old"})
    sources = Sources([first, second])
    run(sources.update(about("a"), "new", ME))
    assert run(sources.query(about("a"), ME)) == "new"
    assert second.updates == []
    run(sources.update(about("a"), None, ME))
    assert run(first.query(about("a"), ME)) is MISSING


@pytest.mark.parametrize(
    ("sources", "question", "said"),
    [
        (Sources(), about("a", Layer.PERSON), r"there is nobody who could be asked or told person\[a\]"),
        (Sources([Scripted(seconds=9)]), about("a"), r"<Scripted> has not (answered|stored) global\[a\] within 5 s"),
        (Sources([], Scripted(seconds=99)), about("a", Layer.PERSON), r"nobody has (answered|heard) person\[a\] within 61 s"),
        (Sources([Scripted(seconds=2)], limit=1.0), about("a"), "within 1 s"),
    ],
)
def test_nobody_and_too_late_are_errors(sources: Sources, question: Question, said: str) -> None:
    with pytest.raises(SourceError, match=said):
        run(sources.query(question, ME))
    with pytest.raises(SourceError, match=said):
        run(sources.update(question, 1, ME))


def test_storing_without_a_knowledge_base_is_an_error() -> None:
    with pytest.raises(SourceError, match=r"no knowledge base to store global\[a\]"):
        run(Sources().update(about("a"), 1, ME))


@pytest.mark.parametrize("error", [SourceError("the disk is full"), TimeoutError("the disk is full"), InputError("the disk is full")])
def test_a_failing_source_is_not_passed_over(error: Exception) -> None:
    with pytest.raises(SourceError, match="the disk is full"):
        run(Sources([Scripted(error=error), Scripted({"a": 1})]).query(about("a"), ME))


def test_closing_closes_all_whatever_becomes_of_one(caplog: pytest.LogCaptureFixture) -> None:
    last = Scripted()
    run(Sources([Scripted(error=OSError("gone"))], last).close())
    assert last.closed
    assert "<Scripted> cannot be closed: gone" in caplog.text


def test_a_question_that_is_withdrawn_is_cancelled() -> None:
    seen: list[str] = []

    class Slow(Scripted):
        async def query(self, question: Question, asker: Asker, /) -> object:
            try:
                return await super().query(question, asker)
            except asyncio.CancelledError:
                seen.append(question.name)
                raise

    async def main() -> None:
        asking = asyncio.ensure_future(Sources([], Slow(seconds=50)).query(about("a", Layer.PERSON), ME))
        await asyncio.sleep(1)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking

    run(main())
    assert seen == ["a"]


# --- values --------------------------------------------------------------------------------


@given(JSON)
def test_values_come_back_as_they_went(value: object) -> None:
    assert read_value(write_value(value)) == value


@pytest.mark.parametrize("value", [float("nan"), [float("inf")], {1, 2}, MISSING, "x" * 2_000_000], ids=lambda value: repr(value)[:20])
def test_what_json_cannot_say_is_refused(value: object) -> None:
    with pytest.raises(SourceError, match="JSON"):
        write_value(value)


@pytest.mark.parametrize("text", ["", "kitchen", "NaN", "[1", "[" * 100_000, " " * 2_000_000 + "1"], ids=lambda text: text[:9])
def test_what_is_no_json_is_refused(text: str) -> None:
    with pytest.raises(SourceError):
        read_value(text)


# --- what people see and say ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("question", "said"),
    [
        (about("shop", Layer.PERSON), "What is shop?"),
        (about("shop", Layer.PERSON, "Which shop?"), "Which shop?"),
        (about("shop", Layer.PERSON, {"text": "Which shop?", "shops": [1]}), "Which shop?"),
        (about("shop", Layer.PERSON, {"shops": [1]}), "What is shop?"),
        (about("shop", Layer.PERSON, ["x"]), "What is shop?"),
        (about("USER", meta=""), "What do you say?"),
        (Question("shop", Layer.PERSON, "no JSON"), "no JSON"),
    ],
    ids=str,
)
def test_the_words_of_a_question(question: Question, said: str) -> None:
    assert question_text(question) == said


@pytest.mark.parametrize(
    ("question", "value", "said"),
    [
        (about("USER"), "Follow me!", "Follow me!"),
        (about("CONTROLLER", meta={"status": 1}), {"at": "hall"}, '{"at": "hall"}'),
        (about("shop", Layer.PERSON), "bakery", "shop: bakery"),
        (about("shop", Layer.PERSON, "The shop is"), ["ü"], 'The shop is: ["ü"]'),
    ],
    ids=str,
)
def test_the_words_of_a_message(question: Question, value: object, said: str) -> None:
    assert message_text(question, value) == said


@pytest.mark.parametrize(
    ("text", "value"),
    [("kitchen", "kitchen"), (" 5 ", 5), ('"5"', "5"), ("true", True), ("null", None), ("[1, 2]", [1, 2]), ("NaN", "NaN"), ("on", "on")],
)
def test_what_people_write(text: str, value: object) -> None:
    assert read_answer(text) == value


@pytest.mark.parametrize("text", ['{"a": 1', '"kitchen', "[1, 2"])
def test_a_slip_of_the_pen_is_no_answer(text: str) -> None:
    with pytest.raises(SourceError, match="is not JSON"):
        read_answer(text)


def test_texts_from_elsewhere_do_nothing_to_a_terminal() -> None:
    assert printable("a\x1b[2Jb\nc\u202e") == "a\N{REPLACEMENT CHARACTER}[2Jb c\N{REPLACEMENT CHARACTER}"


# --- SQLite --------------------------------------------------------------------------------


async def stored(knowledge: SqliteKnowledge, **values: object) -> None:
    for name, value in values.items():
        await knowledge.update(about(name), value, ME)


async def read(path: Path, *names: str) -> list[object]:
    knowledge = SqliteKnowledge(path)
    try:
        return [await knowledge.query(about(name), ME) for name in names]
    finally:
        await knowledge.close()


def test_what_is_stored_is_there_later(tmp_path: Path) -> None:
    file = tmp_path / "new" / "folder" / "kb.sqlite"

    async def main() -> None:
        knowledge = SqliteKnowledge(file)
        await stored(knowledge, a=1, b={"x": [None, "ü"]}, c=False)
        await stored(knowledge, a=2, d=1)
        await stored(knowledge, d=None, e=None)
        await knowledge.close()
        await knowledge.close()
        with pytest.raises(SourceError, match="is closed"):
            await knowledge.query(about("a"), ME)

    run(main())
    assert run(read(file, "a", "b", "c", "d", "e")) == [2, {"x": [None, "ü"]}, False, MISSING, MISSING]


def corrupt(path: Path) -> None:
    path.write_bytes(b"not a database at all" * 100)


def torn(path: Path) -> None:
    """A file of ours whose pages were overwritten."""
    run(fill(path))
    whole = path.read_bytes()
    path.write_bytes(whole[:4096] + b"\xff" * (len(whole) - 4096))


async def fill(path: Path) -> None:
    knowledge = SqliteKnowledge(path)
    await stored(knowledge, **{f"name{number}": "x" * 500 for number in range(20)})
    await knowledge.close()


def foreign(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE variables (name TEXT)")
    connection.close()


def later(path: Path) -> None:
    run(fill(path))
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 2")
    connection.close()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (corrupt, "file is not a database"),
        (torn, "malformed"),
        (foreign, "a database of something else"),
        (later, "a later version of this program"),
        (Path.mkdir, "unable to open database file"),
    ],
)
def test_a_file_that_is_no_knowledge_is_an_error_and_left_as_it_is(tmp_path: Path, spoil: Any, said: str) -> None:
    file = tmp_path / "kb.sqlite"
    spoil(file)
    before = file.read_bytes() if file.is_file() else b""
    with pytest.raises(SourceError, match=f"the knowledge in {file} cannot be used: .*{said}"):
        run(read(file, "name19"))
    assert (file.read_bytes() if file.is_file() else b"") == before


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SourceError, match=r"cannot be used: .*file"):
        run(read(tmp_path / "file" / "kb.sqlite", "a"))


def test_after_an_error_the_file_is_tried_again(tmp_path: Path) -> None:
    file = tmp_path / "kb.sqlite"
    corrupt(file)

    async def main() -> object:
        knowledge = SqliteKnowledge(file)
        with pytest.raises(SourceError):
            await knowledge.query(about("a"), ME)
        file.unlink()
        await stored(knowledge, a=1)
        found = await knowledge.query(about("a"), ME)
        await knowledge.close()
        return found

    assert run(main()) == 1


def test_a_file_that_somebody_keeps_locked_is_an_error_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sqlite_source, "LIMIT", 0.2)
    file = tmp_path / "kb.sqlite"
    run(fill(file))
    holder = sqlite3.connect(file, isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")

    async def main() -> None:
        knowledge = SqliteKnowledge(file)
        assert await knowledge.query(about("name1"), ME) == "x" * 500, "reading does not wait for who writes"
        with pytest.raises(SourceError, match="database is locked"):
            await stored(knowledge, a=1)
        await knowledge.close()

    run(main())
    holder.close()


def test_a_file_that_another_process_is_just_making_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "kb.sqlite"
    other = sqlite3.connect(file, isolation_level=None, check_same_thread=False)
    other.execute("BEGIN IMMEDIATE")
    waited: list[float] = []

    def pause(seconds: float) -> None:
        waited.append(seconds)
        other.execute("ROLLBACK")

    monkeypatch.setattr(sqlite_source, "sleep", pause)
    assert run(read(file, "a")) == [MISSING]
    assert len(waited) == 1
    other.close()


def test_names_that_cannot_be_written_are_an_error(tmp_path: Path) -> None:
    async def main() -> None:
        knowledge = SqliteKnowledge(tmp_path / "kb.sqlite")
        with pytest.raises(SourceError, match="surrogates not allowed"):
            await knowledge.update(about("\ud800"), 1, ME)
        await knowledge.close()

    run(main())


WRITER = """
import asyncio, sys
from pathlib import Path
from uuid import UUID
from pnm.core.logic.computed_values import Layer, Question
from pnm.knowledge.sources import Asker
from pnm.knowledge.sources.sqlite import SqliteKnowledge

async def main(file, name, count):
    knowledge = SqliteKnowledge(Path(file))
    for number in range(int(count)):
        await knowledge.update(Question(f"{name}{number}", Layer.GLOBAL, "null"), number, Asker(UUID(int=1)))
        print(number, flush=True)
    await knowledge.close()

asyncio.run(main(*sys.argv[1:]))
"""


def writer(file: Path, name: str, count: int) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-c", WRITER, str(file), name, str(count)], stdout=subprocess.PIPE, text=True)


def out(process: subprocess.Popen[str]) -> IO[str]:
    assert process.stdout is not None
    return process.stdout


@pytest.mark.parametrize("count", [1, 30])
def test_what_was_acknowledged_survives_sigkill(tmp_path: Path, count: int) -> None:
    file = tmp_path / "kb.sqlite"
    process = writer(file, "a", 1_000_000)
    for _ in range(count):
        out(process).readline()
    process.kill()
    rest, _ = process.communicate(timeout=30.0)
    acknowledged = count + len([line for line in rest.splitlines(keepends=True) if line.endswith("\n")])
    assert run(read(file, *(f"a{number}" for number in range(acknowledged)))) == list(range(acknowledged))


def test_processes_write_at_the_same_time_to_a_file_that_is_not_there_yet(tmp_path: Path) -> None:
    file = tmp_path / "kb.sqlite"
    processes = [writer(file, name, 20) for name in "abcd"]
    for process in processes:
        process.communicate(timeout=60.0)
        assert process.returncode == 0
    names = [f"{name}{number}" for name in "abcd" for number in range(20)]
    assert run(read(file, *names)) == [number for _ in "abcd" for number in range(20)]


def test_where_knowledge_is_kept_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert default_path() == Path("/state/pnm/knowledge.sqlite")
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    monkeypatch.setenv("HOME", "/home/me")
    assert default_path() == Path("/home/me/.local/state/pnm/knowledge.sqlite")


# --- the registry --------------------------------------------------------------------------


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_registered", {})


@pytest.mark.parametrize("name", ["sqlite", "memory", "person", "ros2", "terminal", "topics"])
def test_built_in_names(name: str) -> None:
    assert check_source(name) == name
    assert name in source_names()


@pytest.mark.parametrize("name", ["RPKnowledgeBase", "rpn_planner_kb.rpn_planner_knowledge_base.RPKnowledgeBase"])
def test_classes_of_the_original_are_the_default(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert check_source(name) == "RPKnowledgeBase"
    sources = open_sources([SourceChoice(name)], Surroundings())
    assert repr(sources) == f"<Sources <SqliteKnowledge {tmp_path}/pnm/knowledge.sqlite>; <Terminal>>"
    assert not list(tmp_path.iterdir()), "nothing is opened before it is needed"


def test_an_unknown_name_is_refused_with_the_nearest_and_the_way_to_register() -> None:
    with pytest.raises(InputError) as caught:
        check_source("my.sqlit", Position("domain.yaml", 3, 5))
    assert str(caught.value).startswith("domain.yaml:3:5: there is no source of knowledge 'my.sqlit'; did you mean 'sqlite'?")
    assert "pnm.knowledge.sources.register_source('my.sqlit', factory)" in str(caught.value)
    with pytest.raises(InputError, match="expected one of memory, person, ros2, sqlite, terminal, topics"):
        check_source("zzz")


def test_a_source_of_ones_own(registered: None) -> None:
    mine, people = Scripted({"a": 1}), Scripted({"shop": 2})
    register_source("my.module.Ontology", lambda options, surroundings: mine)
    register_source("screen", lambda options, surroundings: people, layer=Layer.PERSON)
    sources = open_sources([SourceChoice("my.module.Ontology"), SourceChoice("screen"), SourceChoice("memory")], Surroundings())
    assert run(sources.query(about("a"), ME)) == 1
    assert run(sources.query(about("shop", Layer.PERSON), ME)) == 2
    with pytest.raises(InputError, match="screen speaks for people, and so does another source"):
        open_sources([SourceChoice("person"), SourceChoice("screen")], Surroundings())


def test_a_source_of_a_package(registered: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "shop_kb-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Name: shop_kb\nVersion: 1.0\n")
    points = (
        "[pnm.knowledge.sources]",
        "shops = pnm.knowledge.sources.registry:memory",
        "broken = gone:make",
        "[pnm.people]",
        "screen = pnm.knowledge.sources.registry:memory",
    )
    (package / "entry_points.txt").write_text("\n".join(points))
    monkeypatch.syspath_prepend(str(tmp_path))
    assert {"shops", "broken", "screen"} <= set(source_names())
    assert (
        repr(open_sources([SourceChoice("shops"), SourceChoice("screen")], Surroundings()))
        == "<Sources <MemoryKnowledge>; <MemoryKnowledge>>"
    )
    with pytest.raises(InputError, match="'broken' is registered but cannot be loaded: No module named 'gone'"):
        open_sources([SourceChoice("broken")], Surroundings())


def test_a_limit_that_is_chosen_is_waited_for(registered: None) -> None:
    slow = Scripted({"shop": 1}, seconds=200)
    register_source("slow", lambda options, surroundings: slow)
    register_source("thinker", lambda options, surroundings: slow, layer=Layer.PERSON)
    short = open_sources([SourceChoice("slow"), SourceChoice("thinker", {"limit": "long"})], Surroundings())
    long = open_sources([SourceChoice("slow", {"limit": 250}), SourceChoice("thinker", {"limit": 250.0})], Surroundings())
    for layer in (Layer.GLOBAL, Layer.PERSON):
        with pytest.raises(SourceError, match="within"):
            run(short.query(about("shop", layer), ME))
        assert run(long.query(about("shop", layer), ME)) == 1


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (SourceChoice("sqlite", {"fil": "x"}), "sqlite: unknown option 'fil'; did you mean 'file'"),
        (SourceChoice("sqlite", {"file": 3}), "expected a text for file, found 3"),
        (SourceChoice("memory", {"x": 3}), "unknown option 'x'; it has no options"),
        (SourceChoice("terminal", {"limit": 0}), "expected a number of seconds for limit, found 0"),
        (SourceChoice("person", {"limit": True}), "person: .*expected a number of seconds for limit, found True"),
        (SourceChoice("ros2"), "ros2: needs ROS 2, which is not used here"),
        (SourceChoice("topics"), "topics: needs ROS 2, which is not used here"),
    ],
    ids=str,
)
def test_wrong_options_are_refused_where_they_stand(choice: SourceChoice, said: str) -> None:
    choice = SourceChoice(choice.name, choice.options, Position("plan.yaml", 2, 1))
    with pytest.raises(InputError, match=f"plan.yaml:2:1: .*{said}"):
        open_sources([choice], Surroundings())


def test_files_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    sources = open_sources([SourceChoice("sqlite", {"file": "kb.sqlite"})], Surroundings(folder=tmp_path))
    run(sources.update(about("a"), 1, ME))
    run(sources.close())
    assert (tmp_path / "kb.sqlite").is_file()


# --- the terminal --------------------------------------------------------------------------


class TerminalUser:
    """Somebody at a terminal, who sees what is shown there and types."""

    def __init__(self) -> None:
        self.hands, screen = pty.openpty()
        self.stream = os.fdopen(screen, "r+b", buffering=0)
        self.answers = open(screen, encoding="utf-8", closefd=False)  # noqa: SIM115 - closed below
        self.shown = open(screen, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        self._seen = ""

    async def sees(self, text: str) -> None:
        """Wait until the text appears; what comes before it is forgotten."""
        loop = asyncio.get_running_loop()
        while text not in self._seen:
            self._seen += (await loop.run_in_executor(None, os.read, self.hands, 4096)).decode()
        self._seen = self._seen.partition(text)[2]

    def types(self, text: str) -> None:
        os.write(self.hands, text.encode())

    def leave(self) -> None:
        for one in (self.answers, self.shown, self.stream):
            one.close()
        os.close(self.hands)


@pytest.fixture
def person() -> Iterator[TerminalUser]:
    somebody = TerminalUser()
    yield somebody
    somebody.leave()


def test_a_question_at_the_terminal(person: TerminalUser) -> None:
    async def main() -> list[object]:
        terminal = TerminalSource(person.answers, person.shown)
        found = []
        for typed in ("bakery\n", "5\n", "[1]\n", "\n"):
            asking = asyncio.ensure_future(terminal.query(about("shop", Layer.PERSON, "Which shop?"), ME))
            await person.sees("[tour] Which shop? ")
            person.types(typed)
            found.append(await asking)
        return found

    assert run(main(), virtual=False) == ["bakery", 5, [1], MISSING]


def test_a_slip_of_the_pen_is_asked_for_once_more(person: TerminalUser) -> None:
    async def main() -> object:
        asking = asyncio.ensure_future(TerminalSource(person.answers, person.shown).query(about("shop", Layer.PERSON), ME))
        await person.sees("What is shop? ")
        person.types('["a"\n')
        await person.sees("is not JSON")
        await person.sees("once more: ")
        person.types('["a"]\n')
        return await asking

    assert run(main(), virtual=False) == ["a"]


def test_questions_queue_and_say_who_asks(person: TerminalUser) -> None:
    async def main() -> list[object]:
        terminal = TerminalSource(person.answers, person.shown)
        one = asyncio.ensure_future(terminal.query(about("a", Layer.PERSON), Asker(UUID(int=1), "first")))
        two = asyncio.ensure_future(terminal.query(about("b", Layer.PERSON), Asker(UUID(int=2), "second")))
        told = asyncio.ensure_future(terminal.update(about("USER"), "Bye!", Asker(UUID(int=2))))
        await person.sees("[first] What is a? ")
        assert not two.done()
        person.types("1\n")
        await person.sees("[second] What is b? ")
        person.types("2\n")
        await person.sees("Bye!")
        return [await one, await two, await told]

    assert run(main(), virtual=False) == [1, 2, None]


def test_a_withdrawn_question_makes_place_and_its_late_answer_is_not_taken(person: TerminalUser) -> None:
    async def main() -> object:
        terminal = TerminalSource(person.answers, person.shown)
        one = asyncio.ensure_future(terminal.query(about("a", Layer.PERSON), ME))
        await person.sees("What is a? ")
        one.cancel()
        await asyncio.wait([one])
        assert one.cancelled()
        await person.sees("(no longer asked)")
        person.types("late\n")
        two = asyncio.ensure_future(terminal.query(about("b", Layer.PERSON), ME))
        await person.sees("What is b? ")
        person.types("good\n")
        return await two

    assert run(main(), virtual=False) == "good"


@pytest.mark.parametrize("virtual", [True, False])
def test_nobody_answers_at_the_terminal(person: TerminalUser, virtual: bool) -> None:
    async def main() -> None:
        with pytest.raises(SourceError, match=r"nobody has answered on the terminal within 0\.2 s"):
            await TerminalSource(person.answers, person.shown, limit=0.2).query(about("a", Layer.PERSON), ME)
        await person.sees("(no longer asked)")

    run(main(), virtual=virtual)


def test_thinking_takes_no_virtual_time(person: TerminalUser) -> None:
    async def main() -> tuple[object, float]:
        asking = asyncio.ensure_future(Sources([], TerminalSource(person.answers, person.shown)).query(about("a", Layer.PERSON), ME))
        await person.sees("What is a? ")
        person.types("x\n")
        return await asking, asyncio.get_running_loop().time()

    assert run(main()) == ("x", 0.0)


def test_the_terminal_is_closed_while_somebody_thinks(person: TerminalUser) -> None:
    async def main() -> None:
        asking = asyncio.ensure_future(TerminalSource(person.answers, person.shown).query(about("a", Layer.PERSON), ME))
        await person.sees("What is a? ")
        person.types("\x04")
        with pytest.raises(SourceError, match="the terminal was closed"):
            await asking

    run(main(), virtual=False)


NO_TERMINAL = """
import asyncio, sys
from uuid import UUID
from pnm.core.logic.computed_values import Layer, Question
from pnm.knowledge.sources import Asker, SourceError
from pnm.knowledge.sources.terminal import TerminalSource
question = Question("USER", Layer.PERSON, "null")
for asking in (TerminalSource().query(question, Asker(UUID(int=1))), TerminalSource().update(question, 1, Asker(UUID(int=1)))):
    try:
        asyncio.run(asking)
    except SourceError as error:
        print(error)
"""


@pytest.mark.parametrize("stdin", ["<&-", "</dev/null"])
def test_without_a_terminal_that_is_said(stdin: str) -> None:
    command = f'exec "$0" -c "$1" {stdin}'
    ended = subprocess.run(["sh", "-c", command, sys.executable, NO_TERMINAL], capture_output=True, text=True, timeout=60.0, check=True)
    said = "a person was to be asked or told something, but there is no terminal to do it on\n"
    assert ended.stdout == said * 2
