"""Pictures from the command line: of plans, of their machines, and of when things were done."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.e2e.command_line import pnm, result
from tests.support.files import ROOT

DELIVERY = (str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl"))
FAULTS = str(ROOT / "problems/delivery/faults.yaml")


@pytest.mark.parametrize("written_as", [["net"], ["net", "--format", "dot"], ["net", "--format", "svg", "--level", "net"]], ids=" ".join)
def test_the_same_plan_is_written_in_the_same_bytes(tmp_path: Path, written_as: list[str]) -> None:
    one = pnm(*written_as, *DELIVERY)
    pnm(*written_as, *DELIVERY, "-o", str(tmp_path / "net"))
    assert one.returncode == 0
    assert (tmp_path / "net").read_text() == one.stdout


def test_a_plan_and_its_machine_are_drawn_as_calls() -> None:
    plan, net, calls = (
        pnm(command, *DELIVERY, "--improve", "0", "--format", "svg", *more)
        for command, more in (("plan", []), ("net", []), ("net", ["--level", "calls"]))
    )
    assert plan.stdout == net.stdout == calls.stdout
    assert "(at r1 hall)" in plan.stdout


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["net", "--level", "calls"], "--format json has the whole net"),
        (["plan", "--json", "--format", "svg"], "--json prints a plan as JSON; expected no --format"),
        (["plan", "--json", "-o", "/dev/null"], "--json prints a plan as JSON; expected no --format"),
    ],
)
def test_options_that_contradict_each_other_are_refused(given: list[str], words: str) -> None:
    done = pnm(*given, *DELIVERY)
    assert done.returncode == 2
    assert done.stderr.startswith(words)


@pytest.mark.parametrize("keeps", [True, False])
def test_the_timeline_of_a_run_and_that_of_its_journal_are_the_same(tmp_path: Path, keeps: bool) -> None:
    journal, drawn, replayed = (str(tmp_path / name) for name in ("run.journal", "run.svg", "replay.svg"))
    done = pnm("run", *DELIVERY, "--faults", FAULTS, "--json", "--timeline", drawn, *(["--journal", journal] if keeps else []))
    assert (done.returncode, done.stderr) == (0, f"wrote {drawn}\n")
    assert result(done)["goal_reached"]
    text = Path(drawn).read_text(encoding="utf-8")
    assert "↻2" in text
    assert " s, aborted: the way is blocked" in text
    if keeps:
        assert pnm("replay", journal, "--timeline", replayed).returncode == 0
        assert Path(replayed).read_text(encoding="utf-8") == text


def test_a_timeline_that_cannot_be_written_is_refused_before_anything_moves(tmp_path: Path) -> None:
    (tmp_path / "t.svg").write_text("mine")
    done = pnm("run", *DELIVERY, "--timeline", str(tmp_path / "t.svg"))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"{tmp_path / 't.svg'}: already exists; use --force to overwrite it\n"
    done = pnm("replay", str(tmp_path / "t.svg"), "--timeline", str(tmp_path / "u.svg"))
    assert done.returncode == 2
    assert not (tmp_path / "u.svg").exists()
    done = pnm("replay", "j", "--to", "3", "--timeline", str(tmp_path / "u.svg"))
    assert (done.returncode, done.stderr) == (2, "--view and --timeline show all of the journal; expected no --to, and no --json\n")
