"""What answers runs from outside: who is asked, what is kept, and that nothing waits without a limit."""

from __future__ import annotations

import asyncio
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.errors import InputError
from pnm.knowledge.source import Asker, MemoryKnowledge, SourceError, read_value, write_value
from pnm.knowledge.sources import Sources
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
