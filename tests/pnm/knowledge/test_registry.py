"""Sources of knowledge by name, with options."""

from __future__ import annotations

from pathlib import Path
from uuid import UUID

import pytest

from pnm.core.logic.computed_values import Layer
from pnm.errors import InputError, Position
from pnm.knowledge import sources
from pnm.knowledge.source import Asker, SourceError
from pnm.knowledge.sources import SourceChoice, Surroundings, check_source, open_sources, register_source, source_names
from tests.support.logic.people import DelayedSource, about, run_questions

ME = Asker(UUID(int=7), "tour")


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
    assert {"shops", "broken", "screen"} <= set(source_names())
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
