"""`pnm run --journal FILE`: a run that was killed goes on with `pnm resume FILE`; with robots over ROS 2 see `test_outcomes`."""

from __future__ import annotations

import json
import signal
from collections import Counter
from contextlib import closing
from pathlib import Path

from pnm.journal.store import JournalFile
from tests.support.e2e.command_line import pnm, result
from tests.support.files import written
from tests.support.processes import LIMIT, Program


def history(journal: Path | str) -> list[dict[str, object]]:
    return [json.loads(line) for line in pnm("history", str(journal), "--json").stdout.splitlines()]


def dies(commits: int, *arguments: str) -> None:
    """Have `pnm run` be killed after so many commits of its journal."""
    with closing(Program(["-m", "tests.support.e2e.programs.dying_run", str(commits), *arguments], {})) as dying:
        assert dying.process.wait(LIMIT) == -signal.SIGKILL


def test_simulated_robots_die_with_a_run_and_begin_anew_where_they_were_known_to_be(root: Path, tmp_path: Path) -> None:
    files = [str(root / "domains/delivery/domain.pddl"), str(root / "problems/delivery/p01.pddl")]
    journal = tmp_path / "j"
    dies(11, *files, "--journal", str(journal), "--improve", "0", "--json")
    done = pnm("resume", str(journal))
    assert result(done)["goal_reached"] is True
    outcomes = Counter(call["outcome"] for call in result(done)["calls"])  # type: ignore[attr-defined]
    assert outcomes.keys() == {"succeeded", "already true"}  # a robot that had arrived is not sent there again
    assert outcomes.total() == 8
    replays = [json.loads(line) for line in pnm("replay", str(journal), "--json").stdout.splitlines()]
    assert any("go on in another process" in replay["words"] for replay in replays)


def test_a_journal_of_other_files_or_of_a_node_is_refused_with_what_to_do(root: Path, tmp_path: Path) -> None:
    domain, first, second = (
        str(root / name) for name in ("domains/delivery/domain.pddl", *(f"problems/delivery/p0{n}.pddl" for n in "12"))
    )
    journal = tmp_path / "j"
    dies(8, domain, first, "--journal", str(journal), "--improve", "0")
    other = pnm("run", domain, second, "--journal", str(journal))
    assert other.returncode == 2
    assert "tasks of another domain, problem or world are not finished: the goal of the problem" in other.stderr
    assert [task["code"] for task in history(journal)] == [None]
    for text, words in (("goals: {}\n", "cannot be opened"), ("", "cannot be opened")):
        wrong = pnm("resume", str(written(tmp_path / "wrong.txt", text)))
        assert wrong.returncode == 2
        assert words in wrong.stderr
    assert pnm("resume", str(tmp_path / "missing.journal")).returncode == 2
    JournalFile(tmp_path / "new.journal", 0.0).close()
    assert "has no task: the process died before it began one" in pnm("resume", str(tmp_path / "new.journal")).stderr


def test_a_plan_by_hand_is_kept_as_well_and_its_values_belong_to_it(root: Path, tmp_path: Path) -> None:
    plan = str(root / "domains/delivery/plans/errands.yaml")
    dies(5, "--plan", plan, "--name", "round_trip", "--set", "robot=r1", "--journal", str(tmp_path / "j"), "--json")
    done = pnm("resume", str(tmp_path / "j"))
    assert result(done)["goal_reached"] is True
    assert [task["code"] for task in history(tmp_path / "j")] == ["goal_reached"]
