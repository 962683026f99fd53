"""Worlds: a domain and plans in files of their own, all of one file or some by name; in both spellings."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pipeline.carry_out import carry_out
from pnm.errors import InputError
from pnm.language import read_plans, read_world

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
