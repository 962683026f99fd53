"""Global knowledge and people in other processes."""

from __future__ import annotations

import asyncio
import json
from uuid import UUID

import pytest

from pnm.core.logic.computed_values import MISSING, Layer
from pnm.knowledge.source import Asker, SourceError
from pnm.knowledge.sources import SourceChoice, Surroundings, open_sources
from pnm.ros.knowledge import Ros2Knowledge, Ros2Person
from pnm.ros.node.services import ServiceClient
from tests.support.logic.people import about
from tests.support.processes import LIMIT
from tests.support.ros.child_process import ChildProcess, until_logged

ME = Asker(UUID(int=7), "tour")


async def next_line(process: ChildProcess) -> list[object]:
    """Return what it says next; at a first contact it may be asked the same several times."""
    before = process.said
    while process.said == before:
        process.said = await asyncio.to_thread(process.line)
    found: list[object] = json.loads(process.said)
    return found


# --- knowledge -----------------------------------------------------------------------------


async def test_knowledge_elsewhere(ros, name, begin):
    process = await asyncio.to_thread(begin, "remote_sources", "knowledge", name)
    knowledge = Ros2Knowledge(ros, name, limit=LIMIT)
    assert await knowledge.query(about("a", meta={"x": 1}), ME) is MISSING
    assert await next_line(process) == ["query", 1, "a", '{"x": 1}', ME.run.hex]
    await knowledge.update(about("a", Layer.ALL), {"b": [None, "ü"]}, ME)
    assert await next_line(process) == ["update", 1, "a", '{"b": [null, "\\u00fc"]}']
    assert await knowledge.query(about("a", Layer.ALL), ME) == {"b": [None, "ü"]}
    assert await next_line(process) == ["query", 1, "a", "", ME.run.hex]
    with pytest.raises(SourceError, match=f"the knowledge behind {name} refuses: not for you"):
        await knowledge.query(about("no"), ME)
    with pytest.raises(SourceError, match="refuses: it does not say why"):
        await knowledge.update(about("no"), 1, ME)
    with pytest.raises(SourceError, match="is not JSON"):
        await knowledge.query(about("broken"), ME)
    with pytest.raises(SourceError, match="JSON cannot say"):
        await knowledge.update(about("a"), float("nan"), ME)
    with pytest.raises(SourceError, match="field name needs text that can be sent"):
        await knowledge.query(about("a\0"), ME)
    values = [knowledge.update(about(f"v{number}"), number, ME) for number in range(50)]
    await asyncio.gather(*values)
    assert await asyncio.gather(*(knowledge.query(about(f"v{number}"), ME) for number in range(50))) == list(range(50))
    missing = Ros2Knowledge(ros, f"{name}x", limit=0.5)
    with pytest.raises(SourceError, match=f"there is no service /{name}x/query; similar are .*/{name}/query"):
        await missing.query(about("a"), ME)
    await missing.close()
    await knowledge.close()


async def test_a_service_is_asked_again_until_it_has_answered_once(ros, name, begin):
    process = await asyncio.to_thread(begin, "remote_sources", "knowledge", name, "deaf")
    knowledge = Ros2Knowledge(ros, name, limit=LIMIT)
    await knowledge.update(about("a"), 1, ME)
    assert await asyncio.gather(*[knowledge.query(about("a"), ME) for _ in range(2)]) == [1, 1]
    met = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{name}/query")
    await met.call({"name": "hello"}, LIMIT)
    with pytest.raises(SourceError, match=r"did not answer within 2\.5 s"):
        await met.call({"name": "slow"}, 2.5)
    await met.call({"name": "done"}, LIMIT)
    said = []
    while not said or said[-1][2] != "done":
        said.append(json.loads(await asyncio.to_thread(process.line)))
    asked = [(service, variable) for service, _, variable, *_ in said]
    assert asked.count(("update", "a")) >= 2
    assert asked.count(("query", "a")) >= 3, "one that is answered does not say that others were"
    assert asked.count(("query", "slow")) == 1
    await met.close()
    await knowledge.close()


async def test_a_service_that_comes_late_is_waited_for_and_one_that_is_killed_is_not(ros, name, begin):
    patient, knowledge = Ros2Knowledge(ros, name, limit=LIMIT), Ros2Knowledge(ros, name, limit=1.0)
    asking = asyncio.ensure_future(patient.query(about("a"), ME))
    process = await asyncio.to_thread(begin, "remote_sources", "knowledge", name)
    assert await asking is MISSING
    await asyncio.to_thread(process.kill)
    with pytest.raises(SourceError, match=f"the service {name}/update did not answer within 1 s"):
        await knowledge.update(about("a"), 1, ME)  # the graph does not know yet that it is dead
    await patient.close()
    await knowledge.close()


# --- people --------------------------------------------------------------------------------


async def test_answers_reach_who_asked_in_whatever_order_they_come(ros, name, begin):
    person = Ros2Person(ros, name, limit=LIMIT)
    first = asyncio.ensure_future(person.query(about("shop", Layer.PERSON, "Which shop?"), ME))
    second = asyncio.ensure_future(person.query(about("USER"), Asker(UUID(int=8), "talk\x1b")))
    process = await asyncio.to_thread(begin, "remote_sources", "person", name, "reversed")  # hears of them although it comes later
    assert await asyncio.gather(first, second) == ["shop it is", "USER it is"]
    said: list[list[object]] = []
    while sum(kind == "withdraw" for kind, *_ in said) < 2:
        said.append(await next_line(process))
    assert ["ask", "shop", "Which shop?", "tour", '"Which shop?"', ""] in said
    assert ["ask", "USER", "What do you say?", "talk\N{REPLACEMENT CHARACTER}", "null", ""] in said
    assert [one[:2] for one in said].count(["withdraw", "shop"]) == 1, "others who show the question learn that it is answered"
    assert [one[:2] for one in said].count(["withdraw", "USER"]) == 1
    await person.close()


async def test_a_question_is_repeated_for_somebody_who_has_just_been_discovered(ros, name, begin):
    person = Ros2Person(ros, name, limit=LIMIT)
    process = await asyncio.to_thread(begin, "remote_sources", "person", name, "deaf")
    assert await person.query(about("shop", Layer.PERSON, "Which shop?"), ME) == 1, "what it had answered at once may have been lost"
    assert await next_line(process) == ["ask", "shop", "Which shop?", "tour", '"Which shop?"', ""]
    await person.close()


async def test_a_message_is_told_and_closing_ends_open_questions(ros, name, begin):
    process = await asyncio.to_thread(begin, "remote_sources", "person", name, "never")
    person = Ros2Person(ros, name, limit=LIMIT)
    await person.update(about("CONTROLLER", meta={"status": 1}), {"at": "hall"}, ME)
    assert await next_line(process) == ["tell", "CONTROLLER", '{"at": "hall"}', "tour", '{"status": 1}', '{"at": "hall"}']
    asking = asyncio.ensure_future(person.query(about("shop", Layer.PERSON), ME))
    assert (await next_line(process))[:2] == ["ask", "shop"]
    await person.close()
    with pytest.raises(SourceError, match="the question was not answered before the end"):
        await asking
    assert (await next_line(process))[:2] == ["withdraw", "shop"]
    with pytest.raises(SourceError, match="nobody can be asked or told anything any more"):
        await person.update(about("USER"), 1, ME)


async def test_a_question_that_nobody_answers_is_withdrawn_and_telling_nobody_is_an_error(ros, name, begin, monkeypatch):
    person = Ros2Person(ros, name, limit=0.3)
    monkeypatch.setattr("pnm.ros.knowledge.LISTENER", 0.3)
    with pytest.raises(SourceError, match=f"nobody listens on {name}/questions to be told 'Bye!'"):
        await person.update(about("USER"), "Bye!", ME)
    with pytest.raises(SourceError, match=f"nobody has answered 'Which shop\\?' within 0.3 s; nobody listens on {name}/questions"):
        await person.query(about("shop", Layer.PERSON, "Which shop?"), ME)
    process = await asyncio.to_thread(begin, "remote_sources", "person", name, "never")
    assert [(await next_line(process))[:2] for _ in range(2)] == [["ask", "shop"], ["withdraw", "shop"]]
    with pytest.raises(SourceError, match=r"nobody has answered 'What is shop\?' within 0\.3 s$"):
        await person.query(about("shop", Layer.PERSON), ME)
    await person.close()


async def test_a_question_that_is_cancelled_is_withdrawn_and_its_late_answer_ignored(ros, name, begin, caplog):
    caplog.set_level("INFO")
    process = await asyncio.to_thread(begin, "remote_sources", "person", name, "late")
    person = Ros2Person(ros, name, limit=LIMIT)
    asking = asyncio.ensure_future(person.query(about("shop", Layer.PERSON), ME))
    assert (await next_line(process))[:2] == ["ask", "shop"]
    asking.cancel()
    assert (await next_line(process))[:2] == ["withdraw", "shop"]
    await until_logged(caplog, "comes too late, or is for others")
    assert asking.cancelled()
    await person.close()


async def test_answers_that_are_none_leave_the_question_open(ros, name, begin, caplog):
    await asyncio.to_thread(begin, "remote_sources", "person", name, "wrong")
    person = Ros2Person(ros, name, limit=LIMIT)
    assert await person.query(about("shop", Layer.PERSON), ME) is MISSING, "the first that says something counts"
    await person.close()
    assert f"ignored an answer on {name}/answers: '[1' is not JSON" in caplog.text


async def test_both_by_name(ros, name):
    choices = [SourceChoice("ros2", {"name": name, "limit": 0.2}), SourceChoice("topics", {"name": name, "limit": 0.2})]
    sources = open_sources(choices, Surroundings(ros))
    assert repr(sources) == f"<Sources <Ros2Knowledge {name}>; <Ros2Person {name}, 0 questions open>>"
    with pytest.raises(SourceError, match=f"there is no service /{name}/query"):
        await sources.query(about("a"), ME)
    with pytest.raises(SourceError, match="nobody has answered"):
        await sources.query(about("USER"), ME)
    await sources.close()
    assert "Ros2Person" in repr(open_sources([SourceChoice("memory"), SourceChoice("person")], Surroundings(ros)))
