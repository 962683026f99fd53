"""Files of the language: merge keys, documents, anchors known beforehand, excerpts, damage, and worlds with their domains and plans."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given, strategies as st

from planner_bridge.pipeline.achieve import carry_out
from pnm.errors import InputError
from pnm.files.yaml_nodes import MAX_DOCUMENTS, Mapped, parse_yaml
from pnm.language import read_plans, read_world
from pnm.language.plan import parse_documents, parse_plans
from tests.support.files import input_error
from tests.support.yaml.damage import WORDS, damaged
from tests.support.yaml.examples import PAPER_DOMAIN, PAPER_PLAN, PDDL, RECIPES, RECOVERING


def only_document(text: str) -> Mapped:
    (found,), warnings = parse_documents(text, "F")
    assert not warnings
    return found


def refusal(text: str) -> str:
    with pytest.raises(InputError) as caught:
        parse_documents(text, "F")
    return str(caught.value)


def test_merged_keys_give_way_to_own_ones_wherever_they_stand() -> None:
    found = only_document("base: &base {a: 1, b: 2, c: 3}\nmore: &more {c: 4, d: 5}\nall:\n  a: 0\n  <<: [*base, *more]\n  b: 9\n")
    assert found.plain("all") == {"a": 0, "b": 9, "c": 3, "d": 5}


def test_merging_goes_through_merged_mappings() -> None:
    found = only_document("x: &x {instances: [1]}\ny: &y {<<: *x, type: t}\nz: {<<: *y, type: u}\n")
    assert found.plain("z") == {"instances": [1], "type": "u"}


def test_what_is_merged_is_told_where_it_stands() -> None:
    found = only_document("base: &base\n  number: hello\nall:\n  mine:\n    <<: *base\n")
    with pytest.raises(InputError, match=r"F:2:11: expected a number of at least 0 under 'number'"):
        found.section("all").mappings()["mine"].number("number", None)


def test_a_merge_key_in_quotes_is_a_name() -> None:
    assert only_document('"<<": 1').plain("<<") == 1


def test_documents_keep_their_positions() -> None:
    first, second = parse_documents("a: 1\n---\nb: 2\n", "F")[0]
    assert first.plain("a") == 1
    assert (second.start.line, second.position("b").column) == (3, 4)


def test_empty_documents_do_not_count() -> None:
    assert len(parse_documents("---\n---\na: 1\n---\n# nothing\n", "F")[0]) == 1
    assert refusal("---\n---\n") == "F:1:1: the file is empty; expected a mapping"


def test_every_document_is_a_mapping() -> None:
    assert refusal("a: 1\n---\n- b\n") == "F:3:1: expected a mapping (key: value)"


def test_anchors_do_not_reach_into_the_next_document() -> None:
    assert refusal("a: &here 1\n---\nb: *here\n") == "F:3:4: not YAML: found undefined alias 'here'"


def test_kinds_of_actions_have_anchors_that_a_file_may_define_itself() -> None:
    assert only_document("a: {<<: *ros_action}").plain("a") == {"type": "ros_action"}
    assert only_document("a: {<<: *base_action}").plain("a") == {}
    assert only_document("t: &ros_action {type: mine}\na: {<<: *ros_action}").plain("a") == {"type": "mine"}
    assert refusal("a: {<<: *ros_actoin}") == "F:1:9: not YAML: found undefined alias 'ros_actoin'; did you mean 'ros_action'?"


def test_other_files_do_not_have_these_anchors() -> None:
    with pytest.raises(InputError, match="undefined alias"):
        parse_yaml("a: {<<: *ros_action}", "F")


# --- excerpts as they are printed ----------------------------------------------------------

EXCERPT = """\
...
actions:
 first:
  effects:
   and:
    - one: 1
    - not:
     two: 2
     three:
      - 4
    - five: 5
 second:
...
"""


def test_an_excerpt_is_read_as_it_was_meant() -> None:
    (found,), warnings = parse_documents(EXCERPT, "F")
    assert found.plain("actions") == {
        "first": {"effects": {"and": [{"one": 1}, {"not": {"two": 2, "three": [4]}}, {"five": 5}]}},
        "second": None,
    }
    assert [str(one) for one in warnings] == [
        "F:1:1: warning: '...' at the beginning is left out",
        "F:8:1: warning: indented less than its owner in line 7",
    ]


def test_nothing_is_mended_in_what_can_be_read() -> None:
    text = "text: |\n  - not:\n   two\nlist:\n- a:\n    b\n"
    (found,), warnings = parse_documents(text, "F")
    assert found.plain("text") == "- not:\n two\n"
    assert not warnings


def test_what_cannot_be_mended_is_told_as_it_stands() -> None:
    assert refusal("...\na: [1\n") == "F:1:1: not YAML: expected the node content, but found '<document end>'"
    assert refusal("a:\n  - b:\n   c: 1\n d: }\n").startswith("F:3:4: not YAML")


def test_a_file_is_not_read_further_than_its_values_may_be_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pnm.files.yaml_nodes.MAX_NODES", 10)
    assert refusal("a: [" + "1, " * 20 + "}").endswith("not YAML: more than 10 values")


def test_documents_are_counted() -> None:
    assert refusal("---\na: 1\n" * (MAX_DOCUMENTS + 1)).endswith(f"not YAML: more than {MAX_DOCUMENTS} documents")
    assert len(parse_documents("---\na: 1\n" * MAX_DOCUMENTS, "F")[0]) == MAX_DOCUMENTS


# --- damage: whatever a person does to a good file, it is read or refused with a place; nothing else is ever raised ---


GOOD = (PDDL, RECIPES, RECOVERING)
MARKS = (*WORDS, ":", "-", "[", "]", "{", "}", "'", '"', "&a ", "*a", "\t", "---\n", "...\n")


@given(st.data(), st.sampled_from(GOOD))
def test_damaged_trees_are_read_or_refused_with_a_place(data: st.DataObject, text: str) -> None:
    check(damaged(data, text))


@given(st.data(), st.sampled_from((*GOOD, PAPER_DOMAIN, PAPER_PLAN)))
@example(None, "...\n- not:\n a")  # type: ignore[arg-type]
def test_damaged_texts_are_read_or_refused_with_a_place(data: st.DataObject | None, text: str) -> None:
    for _ in range(3 if data else 0):
        assert data is not None
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.sampled_from(MARKS)) + text[end:]
    check(text)


def check(text: str) -> None:
    error = input_error(lambda: parse_plans(text, "F"))
    assert error is None or (error.position is not None and str(error).startswith("F:")), error


# --- worlds: a domain and plans in files of their own ---


DOMAIN = "external_knowledge_base: {module: m, class: RPKnowledgeBase}\nactions: {a: , b: {params: [x]}}\n"
FILES = {
    "domains/one.yaml": DOMAIN,
    "plans/count.yaml": "count: {server: {module: actionlib, class: SimpleActionServer}, plan: [a: ]}\n",
    "plans/both.yaml": "first: {params: [x], plan: [count: ]}\nsecond: {plan: [first: {x: 1}, b: {x: 2}]}\n",
    "plans/own.yaml": "name: alone\ndomain: ../domains/two.yaml\nplan: [c: ]\n",
    "domains/two.yaml": "actions: {c: }\n",
    "worlds.yaml": """\
small: {domain: domains/one.yaml, recipes: [plans/count.yaml]}
large:
  domain: domains/one.yaml
  recipes:
    - plans/count.yaml
    - plans/both.yaml
    - plans/own.yaml
""",
    "world.yaml": "name: mine\ndomain: domains/one.yaml\nplans: [plans/count.yaml, plans/both.yaml]\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_a_world_has_all_plans_of_its_recipes(folder: Path) -> None:
    world = read_world(folder / "worlds.yaml", "large")
    assert list(world.plans) == ["count", "first", "second", "alone"]
    assert [choice.name for choice in world.domain.sources] == ["RPKnowledgeBase"]
    assert world.plans["second"].calls == {"first"}
    assert world.plans["first"].calls == {"count"}
    assert world.plans["alone"].sources == ()
    assert list(read_world(folder / "worlds.yaml", "small").plans) == ["count"]


def test_a_file_may_be_a_single_world(folder: Path) -> None:
    world = read_world(folder / "world.yaml")
    assert (world.name, list(world.plans)) == ("mine", ["count", "first", "second"])


def test_the_only_world_need_not_be_named(folder: Path) -> None:
    (folder / "worlds.yaml").write_text("only: {domain: domains/one.yaml, recipes: [plans/count.yaml]}\n")
    assert read_world(folder / "worlds.yaml").name == "only"


def why_no_world(folder: Path, text: str, name: str | None = None) -> str:
    (folder / "worlds.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_world(folder / "worlds.yaml", name)
    return str(caught.value).removeprefix(f"{folder}/")


def test_what_is_wrong_with_a_world(folder: Path) -> None:
    two = FILES["worlds.yaml"]
    assert why_no_world(folder, two) == "worlds.yaml:1:1: there are several worlds; expected the name of one: small, large"
    assert why_no_world(folder, two, "smal") == "worlds.yaml:1:1: there is no world 'smal' here; did you mean 'small'?"
    assert why_no_world(folder, "w: {domian: x}") == "worlds.yaml:1:5: unknown key 'domian'; did you mean 'domain'?"
    assert why_no_world(folder, "domain: domains/one.yaml\nplans: []") == (
        "worlds.yaml:1:1: the world 'worlds' has no plans; expected files under 'plans'"
    )
    assert why_no_world(folder, "w: {domain: domains/one.yaml, recipes: [plans/cuont.yaml]}") == (
        "worlds.yaml:1:40: there is no file 'plans/cuont.yaml' beside this one; did you mean 'count.yaml'?"
    )
    assert why_no_world(folder, "w: {recipes: [plans/count.yaml]}").startswith(
        "plans/count.yaml:1:72: there is no domain that would have an action 'a'"
    )
    assert why_no_world(folder, "w: {domain: plans/count.yaml, recipes: [plans/count.yaml]}") == (
        "plans/count.yaml:1:1: there is no domain in the file; expected the key 'actions'"
    )
    assert why_no_world(folder, "w: {domain: domains/one.yaml, recipes: [plans/count.yaml, plans/count.yaml]}") == (
        "plans/count.yaml:1:8: there is a plan called 'count' already"
    )
    assert why_no_world(folder, "a: 1\n---\nb: 2") == "worlds.yaml:3:1: a second document begins here; expected one"


def test_plans_that_call_each_other_in_a_circle_are_refused(folder: Path) -> None:
    (folder / "plans/count.yaml").write_text("count: {plan: [second: ]}\n")
    assert "the plan would never end: " in why_no_world(folder, FILES["worlds.yaml"], "large")


def test_the_plans_of_a_world_can_be_run_without_serving_it(folder: Path) -> None:
    assert list(read_plans(folder / "world.yaml")) == ["count", "first", "second"]
    assert carry_out(folder / "world.yaml", "second").goal_reached
    with pytest.raises(InputError, match=r"worlds.yaml:1:1: there are several worlds; expected the name of one: small, large"):
        read_plans(folder / "worlds.yaml")


def test_a_world_is_no_plan_of_another(folder: Path) -> None:
    (folder / "world.yaml").write_text("domain: domains/one.yaml\nplans: [worlds.yaml]\n")
    with pytest.raises(InputError, match=r"worlds.yaml:1:1: this is a world; expected a plan"):
        read_plans(folder / "world.yaml")
