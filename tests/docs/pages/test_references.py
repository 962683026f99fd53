"""The reference pages name what is in the code, no more and no less: causes, codes, keys, options, messages."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner
from geometry_msgs.msg import PoseWithCovarianceStamped
from porter_msgs.action import NavigateToPose

from planner_bridge.cli.commands import app
from planner_bridge.node.options import PARAMETERS
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.result import code_of_failures
from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import FaultKind
from pnm.core.execution.call_results import Failure
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.message_fields import value_in
from pnm.core.readiness import ReadyState
from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import instances, read
from pnm.language.plan import read_world
from pnm.language.runner import Program
from pnm.ros.node.messages import fitted, fitted_binding
from pnm.tasks import Code
from tests.support.docs.page import DOCS, blocks_of, files_of
from tests.support.files import ROOT, written

ROW = re.compile(r"^\| (.*) \|$", re.MULTILINE)
WORD = re.compile(r"`([^`]+)`")


def text(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def tables(page: str, heading: str = "") -> Iterator[list[list[str]]]:
    """The tables of a page, or of the part under a heading: rows of cells."""
    part = text(page).partition(f"## {heading}\n")[2].partition("\n## ")[0] if heading else text(page)
    for lines in re.findall(r"(?:^\|.*\n?)+", part, re.MULTILINE):
        yield [re.split(r" *(?<!\\)\| *", row)[1:-1] for row in lines.splitlines()][2:]


def words(page: str, heading: str = "", column: int = 0) -> list[str]:
    """The words of code in a column of the tables."""
    return [word for table in tables(page, heading) for row in table for word in WORD.findall(row[column])]


def test_every_cause_of_a_failure_has_its_row_and_its_code() -> None:
    rows = [row for table in tables("reference/failures.md", "A call") for row in table]
    said = {row[0].strip("`"): row[-1].strip("`") for row in rows}
    call = ActionCall(0, GroundAction("a"))
    assert said == {
        cause: code_of_failures([Failure(call, cause, "", "")]).word for cause in Cause if cause not in (Cause.BEFORE, Cause.AFTER)
    }


def test_the_codes_of_tasks_are_those_of_the_messages() -> None:
    (table,) = tables("reference/ros.md", "How a task ends")
    assert [(int(row[0]), row[1].strip("`")) for row in table] == [(code.value, code.word) for code in Code]


def test_every_parameter_of_the_node_has_its_row_and_its_default() -> None:
    (table,) = tables("reference/parameters.md")
    said = {row[0].strip("`"): row[1].strip("`") for row in table}
    assert said == {one.name: str(one.default).lower() if isinstance(one.default, bool) else str(one.default) for one in PARAMETERS}


def test_states_of_readiness_and_kinds_of_faults_have_their_rows() -> None:
    assert set(words("reference/bindings.md", "Check them")) == {state.value for state in ReadyState}
    assert {kind.value for kind in FaultKind} <= set(words("guides/rehearsal.md"))


def test_the_bindings_that_are_shown_are_read(tmp_path: Path) -> None:
    for page in ("reference/bindings.md", "guides/several-robots.md"):
        assert read_bindings(written(tmp_path / "bindings.yaml", files_of(text(page))["bindings.yaml"])).actions


def test_the_files_of_the_page_about_nav2_fit_types_of_its_shape(tmp_path: Path) -> None:
    files = {name: written(tmp_path / name, body) for name, body in files_of(text("guides/nav2.md")).items()}
    problem = load(files["domain.pddl"], files["problem.pddl"])
    assert fitted_binding(read_bindings(files["bindings.yaml"], problem.vocabulary).of("navigate_to_pose"), NavigateToPose)
    (sensor,) = instances(read_sensing(files["sensing.yaml"], problem.vocabulary), {})
    (reports,) = (fitted(one, PoseWithCovarianceStamped) for one in read_sensing(files["sensing.yaml"]).sensors)
    assert len(reports.statements) == len(problem.objects)
    table = yaml.safe_load(files["bindings.yaml"].read_text())["actions"]["navigate_to_pose"]["goal"]["pose"]["table"]
    for place, stamped in table.items():
        reading = read(sensor, partial(value_in, {"pose": stamped}), {})  # a pose with covariance has its pose inside of a pose
        assert [fluent for fluent, value in reading.facts.items() if value is True] == [("at", place)]


def test_the_patrol_of_the_page_about_nav2_goes_to_its_dock_when_the_battery_is_low(tmp_path: Path) -> None:
    files = {name: written(tmp_path / name, body) for name, body in files_of(text("guides/nav2.md")).items()}
    low = files["patrol-problem.pddl"].read_text().replace("(:init (docked))", "(:init (low))")
    problem = load(files["patrol-domain.pddl"], written(tmp_path / "low.pddl", low))
    bindings = read_bindings(files["patrol-bindings.yaml"], problem.vocabulary)
    assert {binding.type for binding in bindings.actions.values()} == {
        f"nav2_msgs/action/{name}" for name in ("DockRobot", "UndockRobot", "FollowWaypoints")
    }
    (sensor,) = instances(read_sensing(files["patrol-sensing.yaml"], problem.vocabulary), {})
    for charge, seen in ((0.2, ["low"]), (0.5, []), (0.95, ["charged"])):
        reading = read(sensor, partial(value_in, {"percentage": charge}), {})
        assert [name for (name, *_), value in reading.facts.items() if value is True] == seen
    plan = solve(problem).plan
    assert plan is not None
    assert [step.action for step in plan.steps][:2] == ["dock_robot", "undock_robot"]


def test_every_command_has_its_help() -> None:
    steps = [step.command for block in blocks_of(text("reference/command-line.md"), "console") for step in block.steps()]
    assert {f"pnm help {name}" for name in app.list_commands(None)} <= set(steps)


def test_the_keys_of_the_json_of_a_run_are_those_that_it_has(tmp_path: Path) -> None:
    plan = written(tmp_path, "actions: {wave: }\nplan: [wave: ]\n")
    printed = json.loads(CliRunner().invoke(app, ["run", "--plan", str(plan), "--json"]).output)
    said = words("reference/command-line.md", "JSON")
    assert set(said) == set(printed)
    (call,) = printed["calls"]
    (row,) = (row for table in tables("reference/command-line.md", "JSON") for row in table if row[0] == "`calls`")
    assert set(WORD.findall(row[1])) == set(call)


def messages() -> list[str]:
    """What is quoted in the troubleshooting page as messages of this code."""
    sections = ("Installing", "Action servers", "Files", "No plan", "Running")
    first = [row[0] for heading in sections for table in tables("start/troubleshooting.md", heading) for row in table]
    return [quoted.strip("` ") for cell in first if " (of " not in cell for quoted in re.findall(r"``.+?``|`[^`]+`", cell)]


def texts_of_the_code() -> Iterator[str]:
    """Every text of the code, with an ellipsis for what is computed; texts that stand side by side are one."""
    for file in (*(ROOT / "pnm").rglob("*.py"), *(ROOT / "planner_bridge").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                yield "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield re.sub(r"%\w", "…", node.value)


TEXTS = [*texts_of_the_code()]


@pytest.mark.parametrize("message", messages())
def test_a_message_that_is_explained_is_in_the_code(message: str) -> None:
    parts = [part for part in message.split("…") if part.strip(" ;,.")]
    assert parts
    pattern = re.compile(".*".join(map(re.escape, parts)), re.DOTALL)
    assert any(pattern.search(one) for one in TEXTS)


def test_the_words_of_the_glossary_are_in_order() -> None:
    (table,) = tables("start/glossary.md")
    names = [re.sub(r"[^a-z ]", "", row[0].lower()) for row in table]
    assert all(one < two for one, two in pairwise(names))


def test_the_proof_that_is_shown_is_that_of_the_plan() -> None:
    shown = re.search(r"^plan +round_trip: proved (.*)$", text("guides/serving.md"), re.MULTILINE)
    plans = read_world(ROOT / "domains/delivery/plans/world.yaml").plans
    assert shown
    assert shown[1] == str(Program.of(plans["round_trip"]).proof)
