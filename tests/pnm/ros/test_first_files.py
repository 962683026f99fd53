"""First files from a snapshot of the ROS graph: what they have, what they leave out, and that they are read without complaint."""

from __future__ import annotations

from pathlib import Path

import pytest
from pnm_interfaces.action import RunPlan
from porter_msgs.action import Grip

from planner_bridge.pipeline.loading import bindings_for, load
from pnm.actions.bindings_file import read_bindings
from pnm.core.machine.bindings import Table
from pnm.core.message_fields import Comparison, parse_field
from pnm.errors import InputError
from pnm.knowledge.sensor_file import read_sensing
from pnm.ros.first_files import first_files, verdict_lines
from pnm.ros.node.graph import GraphSnapshot
from tests.support.files import written

FIBONACCI, TASK = "test_msgs/action/Fibonacci", "pyrobosim_msgs/action/ExecuteTaskAction"
ROBOTS = GraphSnapshot({"/r1/count": (FIBONACCI,), "/r2/count": (FIBONACCI,), "/execute_action": (TASK,)}, {}, {})


def read(graph: GraphSnapshot, folder: Path):
    """Write the files, read them as the commands do, and return problem, bindings and sensors."""
    for name, text in first_files(graph, "robot").items():
        written(folder / name, text)
    problem = load(folder / "domain.pddl", folder / "problem.pddl")
    return (
        problem,
        bindings_for(folder / "domain.pddl", None, problem.vocabulary),
        read_sensing(folder / "sensing.yaml", problem.vocabulary),
    )


@pytest.mark.parametrize(
    ("servers", "said"),
    [
        ({}, "there is no action server in the ROS graph"),
        ({"/achieve_goal": ("pnm_interfaces/action/AchieveGoal",)}, "there is no action server in the ROS graph"),
        ({"/go": ("far_away_msgs/action/Go",)}, "/go: the ROS type far_away_msgs/action/Go is not installed"),
        ({"/go": (FIBONACCI, TASK)}, "/go has several types: test_msgs/action/Fibonacci, pyrobosim_msgs/action/ExecuteTaskAction"),
    ],
)
def test_without_a_server_that_can_be_used_it_is_said_why(servers, said) -> None:
    with pytest.raises(InputError) as error:
        first_files(GraphSnapshot(servers, {}, {}), "robot")
    assert said in error.value.message


def test_what_is_left_out_is_named_in_the_bindings() -> None:
    texts = first_files(GraphSnapshot({"/count": (FIBONACCI,), "/go": ("far_away_msgs/action/Go",)}, {}, {}), "robot")
    assert "# left out: /go: the ROS type far_away_msgs/action/Go is not installed" in texts["bindings.yaml"]


def test_servers_of_one_type_under_the_names_of_robots_are_one_action(tmp_path: Path) -> None:
    problem, bindings, _ = read(ROBOTS, tmp_path)
    assert problem.vocabulary.actions == {"count": {"robot": ("robot",)}, "execute_action": {}}
    assert problem.objects == {"r1": ("robot",), "r2": ("robot",)}
    assert bindings.of("count").server == "/{robot}/count"
    assert bindings.of("count").goal == {"order": 0}
    assert bindings.of("execute_action").success is not None, "fields of results that look like a verdict are taken for one"
    assert bindings.of("execute_action").reason is not None
    (line,) = [line for line in (tmp_path / "bindings.yaml").read_text().splitlines() if "execution_result.status" in line]
    assert "which of UNKNOWN (-1), SUCCESS (0), " in line, "defaults of fields are no constants"
    for file in tmp_path.iterdir():
        assert file.name == "sensing.yaml" or "decide: " in file.read_text()


def test_a_boolean_of_the_result_is_a_verdict_before_any_number(tmp_path: Path) -> None:
    lines = list(verdict_lines(RunPlan.Result))
    assert lines[0].startswith("    success: {field: success}")
    binding = read_bindings(written(tmp_path / "bindings.yaml", "\n".join(("actions:", "  go:", *lines)))).of("go")
    assert binding.success is not None
    assert str(binding.reason.field if binding.reason else "") == "reason"


def test_constants_of_the_result_say_which_number_is_a_success_and_what_the_others_mean(tmp_path: Path) -> None:
    class OnlyACode(Grip.Result):  # type: ignore[misc]
        @classmethod
        def get_fields_and_field_types(cls) -> dict[str, str]:
            return {"code": "uint8"}

    success, reason = verdict_lines(OnlyACode)
    assert success.endswith("decide: which of DONE (0), SLIPPED (1), OUT_OF_REACH (2), NOT_HELD (3) is a success")
    text = "\n".join(("actions:", "  grip:", success, reason))
    binding = read_bindings(written(tmp_path / "bindings.yaml", text)).of("grip")
    assert str(binding.success) == str(Comparison(parse_field("code"), "eq", "DONE"))
    assert binding.reason is not None
    assert binding.reason.table == {"SLIPPED": "slipped", "OUT_OF_REACH": "out of reach", "NOT_HELD": "not held"}


def test_a_pose_is_a_table_of_places_and_a_text_that_is_a_setting_no_object(tmp_path: Path) -> None:
    drive = GraphSnapshot({"/navigate_to_pose": ("porter_msgs/action/NavigateToPose",)}, {}, {})
    problem, bindings, _ = read(drive, tmp_path)
    assert problem.vocabulary.actions == {"navigate_to_pose": {"pose": ("place",)}}
    goal = bindings.of("navigate_to_pose").goal or {}
    assert isinstance(goal["pose"], Table)
    assert goal["behavior_tree"] == ""


def test_what_not_every_robot_has_is_an_action_of_its_own(tmp_path: Path) -> None:
    problem, bindings, _ = read(GraphSnapshot({"/r1/do": (FIBONACCI,), "/r2/do": (TASK,)}, {}, {}), tmp_path)
    assert {bindings.of(name).server for name in problem.domain.actions} == {"/r1/do", "/r2/do"}
    assert problem.vocabulary.actions == {"do": {}, "r2_do": {}}


def test_topics_of_known_types_are_sensors_and_the_others_are_listed(tmp_path: Path) -> None:
    topics = {"/r1/docked": ("std_msgs/msg/Bool",), "/r2/docked": ("std_msgs/msg/Bool",), "/odom": ("nav_msgs/msg/Odometry",)}
    graph = GraphSnapshot(ROBOTS.servers, topics, {})
    problem, _, sensing = read(graph, tmp_path)
    assert "docked" in problem.domain.predicates
    assert sensing.names == {"docked"}
    assert "# /odom   nav_msgs/msg/Odometry" in (tmp_path / "sensing.yaml").read_text()
