"""What answers runs from outside: sources by name, who is asked, what is kept, and that nothing waits without a limit."""

from __future__ import annotations

import asyncio
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.errors import InputError, Position
from pnm.knowledge import sources
from pnm.knowledge.source import Asker, MemoryKnowledge, SourceError, read_value, write_value
from pnm.knowledge.sources import SourceChoice, Sources, Surroundings, check_source, open_sources, register_source
from tests.support.logic.people import DelayedSource, about, run_questions

ME = Asker(UUID(int=7), "tour")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


# --- the chain ---


@pytest.mark.parametrize("layer", [Layer.GLOBAL, Layer.ALL])
def test_knowledge_bases_are_asked_in_order(layer: Layer) -> None:
    sources = Sources([DelayedSource({"a": 1}), DelayedSource({"a": 2, "b": None, "c": False})])
    found = [run_questions(sources.query(about(name, layer), ME)) for name in "abcd"]
    assert found == [1, MISSING, False, MISSING]


@pytest.mark.parametrize("question", [about("shop", Layer.PERSON), about("USER"), about("CONTROLLER", Layer.ALL)], ids=str)
def test_people_are_asked_and_told_what_is_for_them(question: Question) -> None:
    person, shared = DelayedSource({question.name: "bakery"}), DelayedSource({question.name: "wrong"})
    sources = Sources([shared], person)
    assert run_questions(sources.query(question, ME)) == "bakery"
    run_questions(sources.update(question, "done", ME))
    assert (person.updates, shared.updates) == ([(question.name, "done")], [])


def test_an_update_goes_where_the_next_query_finds_it() -> None:
    first, second = MemoryKnowledge(), DelayedSource({"a": "old"})
    sources = Sources([first, second])
    run_questions(sources.update(about("a"), "new", ME))
    assert run_questions(sources.query(about("a"), ME)) == "new"
    assert second.updates == []
    run_questions(sources.update(about("a"), None, ME))
    assert run_questions(first.query(about("a"), ME)) is MISSING


@pytest.mark.parametrize(
    ("sources", "question", "said"),
    [
        (Sources(), about("a", Layer.PERSON), r"nobody can be asked or told person\[a\]"),
        (Sources([DelayedSource(seconds=9)]), about("a"), r"<DelayedSource> has not (answered|stored) global\[a\] within 5 s"),
        (Sources([], DelayedSource(seconds=99)), about("a", Layer.PERSON), r"nobody has (answered|heard) person\[a\] within 61 s"),
        (Sources([DelayedSource(seconds=2)], limit=1.0), about("a"), "within 1 s"),
    ],
)
def test_nobody_and_too_late_are_errors(sources: Sources, question: Question, said: str) -> None:
    with pytest.raises(SourceError, match=said):
        run_questions(sources.query(question, ME))
    with pytest.raises(SourceError, match=said):
        run_questions(sources.update(question, 1, ME))


def test_storing_without_a_knowledge_base_is_an_error() -> None:
    with pytest.raises(SourceError, match=r"no knowledge base to store global\[a\]"):
        run_questions(Sources().update(about("a"), 1, ME))


@pytest.mark.parametrize("error", [SourceError("the disk is full"), TimeoutError("the disk is full"), InputError("the disk is full")])
def test_a_failing_source_is_not_passed_over(error: Exception) -> None:
    with pytest.raises(SourceError, match="the disk is full"):
        run_questions(Sources([DelayedSource(error=error), DelayedSource({"a": 1})]).query(about("a"), ME))


def test_closing_closes_all_whatever_becomes_of_one(caplog: pytest.LogCaptureFixture) -> None:
    last = DelayedSource()
    run_questions(Sources([DelayedSource(error=OSError("gone"))], last).close())
    assert last.closed
    assert "<DelayedSource> cannot be closed: gone" in caplog.text


def test_a_question_that_is_withdrawn_is_cancelled() -> None:
    async def main() -> None:
        seen: list[str] = []

        class Slow(DelayedSource):
            async def query(self, question: Question, asker: Asker, /) -> object:
                try:
                    return await super().query(question, asker)
                except asyncio.CancelledError:
                    seen.append(question.name)
                    raise

        asking = asyncio.ensure_future(Sources([], Slow(seconds=50)).query(about("a", Layer.PERSON), ME))
        await asyncio.sleep(1)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        assert seen == ["a"]

    run_questions(main())


# --- values ---


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


# --- answers by other ways ---


def test_an_answer_by_another_way_is_the_answer_and_the_person_is_not_asked_any_more() -> None:
    person = DelayedSource({"a": "late"}, seconds=50)
    sources, asker = Sources([], person), Asker(UUID(int=7), "tour", UUID(int=8))

    async def ask() -> object:
        asking = asyncio.ensure_future(sources.query(about("a", Layer.PERSON), asker))
        await asyncio.sleep(1.0)
        assert not sources.answer(UUID(int=9), "of another question")
        assert sources.answer(UUID(int=8), "early")
        assert not sources.answer(UUID(int=8), "twice")
        return await asking

    assert run_questions(ask()) == "early"
    assert not sources.answer(UUID(int=8), "too late")


def test_a_question_that_is_answered_or_withdrawn_is_not_open_any_more() -> None:
    sources, asker = Sources([], DelayedSource({"a": 1}, seconds=5)), Asker(UUID(int=7), "tour", UUID(int=8))

    async def ask() -> None:
        assert await sources.query(about("a", Layer.PERSON), asker) == 1
        assert not sources.answer(UUID(int=8), 2)
        withdrawn = asyncio.ensure_future(sources.query(about("a", Layer.PERSON), asker))
        await asyncio.sleep(1.0)
        withdrawn.cancel()
        await asyncio.wait((withdrawn,))
        assert not sources.answer(UUID(int=8), 2)

    run_questions(ask())


# --- sources by name, with options ---


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "_registered", {})


@pytest.mark.parametrize("name", ["RPKnowledgeBase", "rpn_planner_kb.rpn_planner_knowledge_base.RPKnowledgeBase"])
def test_classes_of_the_original_are_the_default(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert check_source(name) == "RPKnowledgeBase"
    sources = open_sources([SourceChoice(name)], Surroundings())
    assert repr(sources) == f"<Sources <DatabaseKnowledge {tmp_path}/pnm/knowledge.sqlite>; <Terminal>>"
    assert not list(tmp_path.iterdir()), "nothing is opened before it is needed"


def test_an_unknown_name_is_refused_with_the_nearest_and_the_way_to_register() -> None:
    with pytest.raises(InputError) as caught:
        check_source("my.sqlit", Position("domain.yaml", 3, 5))
    assert str(caught.value).startswith("domain.yaml:3:5: there is no source of knowledge 'my.sqlit'; did you mean 'sqlite'?")
    assert "pnm.knowledge.sources.register_source('my.sqlit', factory)" in str(caught.value)
    with pytest.raises(InputError, match="expected one of memory, person, postgres, ros2, sqlite, terminal, topics"):
        check_source("zzz")


def test_a_source_of_ones_own(registered: None) -> None:
    mine, people = DelayedSource({"a": 1}), DelayedSource({"shop": 2})
    register_source("my.module.Ontology", lambda options, surroundings: mine)
    register_source("screen", lambda options, surroundings: people, layer=Layer.PERSON)
    sources = open_sources([SourceChoice("my.module.Ontology"), SourceChoice("screen"), SourceChoice("memory")], Surroundings())
    assert run_questions(sources.query(about("a"), ME)) == 1
    assert run_questions(sources.query(about("shop", Layer.PERSON), ME)) == 2
    with pytest.raises(InputError, match="screen speaks for people, and so does another source"):
        open_sources([SourceChoice("person"), SourceChoice("screen")], Surroundings())


def test_a_source_of_a_package(registered: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "shop_kb-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Name: shop_kb\nVersion: 1.0\n")
    points = (
        "[pnm.knowledge.sources]",
        "shops = pnm.knowledge.sources:memory",
        "broken = gone:make",
        "[pnm.people]",
        "screen = pnm.knowledge.sources:memory",
    )
    (package / "entry_points.txt").write_text("\n".join(points))
    monkeypatch.syspath_prepend(str(tmp_path))
    assert (
        repr(open_sources([SourceChoice("shops"), SourceChoice("screen")], Surroundings()))
        == "<Sources <MemoryKnowledge>; <MemoryKnowledge>>"
    )
    with pytest.raises(InputError, match="'broken' is registered but cannot be loaded: No module named 'gone'"):
        open_sources([SourceChoice("broken")], Surroundings())


def test_a_limit_that_is_chosen_is_waited_for(registered: None) -> None:
    slow = DelayedSource({"shop": 1}, seconds=200)
    register_source("slow", lambda options, surroundings: slow)
    register_source("thinker", lambda options, surroundings: slow, layer=Layer.PERSON)
    short = open_sources([SourceChoice("slow"), SourceChoice("thinker", {"limit": "long"})], Surroundings())
    long = open_sources([SourceChoice("slow", {"limit": 250}), SourceChoice("thinker", {"limit": 250.0})], Surroundings())
    for layer in (Layer.GLOBAL, Layer.PERSON):
        with pytest.raises(SourceError, match="within"):
            run_questions(short.query(about("shop", layer), ME))
        assert run_questions(long.query(about("shop", layer), ME)) == 1


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (SourceChoice("sqlite", {"fil": "x"}), "sqlite: unknown option 'fil'; did you mean 'file'"),
        (SourceChoice("sqlite", {"file": 3}), "expected a text for file, found 3"),
        (SourceChoice("memory", {"x": 3}), "unknown option 'x'; it has no options"),
        (SourceChoice("terminal", {"limit": 0}), "expected a number of seconds for limit, found 0"),
        (SourceChoice("person", {"limit": True}), "person: .*expected a number of seconds for limit, found True"),
        (SourceChoice("person", {"limit": 4000.0}), "at most 3599"),
        (SourceChoice("terminal", {"limit": 3600.0}), "at most 3599"),
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
    run_questions(sources.update(about("a"), 1, ME))
    run_questions(sources.close())
    assert (tmp_path / "kb.sqlite").is_file()
