"""Files that commands write: pictures, and others; what exists stays as it is, unless the user says otherwise."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.e2e.command_line import pnm, result
from tests.support.files import ROOT


@pytest.fixture
def domain(tmp_path: Path) -> Path:
    (tmp_path / "domain.pddl").write_text((ROOT / "domains/patrol/domain.pddl").read_text())
    (tmp_path / "problem.pddl").write_text((ROOT / "problems/patrol/p01.pddl").read_text())
    return tmp_path / "domain.pddl"


@pytest.mark.parametrize("command", ["export", "net", "simulate"])
def test_a_file_that_exists_is_not_replaced(domain: Path, command: str) -> None:
    before = domain.read_bytes()
    done = pnm(command, str(domain), str(domain.parent / "problem.pddl"), "--log" if command == "simulate" else "-o", str(domain))
    assert (done.returncode, done.stderr) == (2, f"{domain}: already exists; use --force to overwrite it\n")
    assert domain.read_bytes() == before


def test_a_net_and_its_certificate_are_two_files(domain: Path) -> None:
    files = "-o", str(domain.parent / "net"), "--certificate", str(domain.parent / "." / "net")
    done = pnm("net", str(domain), str(domain.parent / "problem.pddl"), *files, "--force")
    assert (done.returncode, "expected two files" in done.stderr) == (2, True), done.stderr
    assert not (domain.parent / "net").exists()


def test_the_output_may_be_a_device_that_is_redirected(domain: Path) -> None:
    with (domain.parent / "out").open("w") as out:
        command = [sys.executable, "-m", "planner_bridge", "export", str(domain), "-o", "/dev/stdout"]
        assert subprocess.run(command, stdout=out, stderr=subprocess.DEVNULL, check=False, cwd=ROOT).returncode == 0
    assert (domain.parent / "out").read_text().startswith("#")


def test_nothing_is_imported_over_files_that_exist(domain: Path) -> None:
    text, folder = domain.parent / "x.yaml", domain.parent
    assert pnm("export", str(domain), str(folder / "problem.pddl"), "-o", str(text)).returncode == 0
    domain.unlink()
    before = (folder / "problem.pddl").read_bytes()
    done = pnm("import", str(text), "-o", str(folder))
    assert (done.returncode, done.stderr) == (2, f"{folder / 'problem.pddl'}: already exists; use --force to overwrite it\n")
    assert not domain.exists()  # neither, if not both
    assert (folder / "problem.pddl").read_bytes() == before
    assert pnm("import", str(text), "-o", str(folder), "--force").returncode == 0
    assert domain.exists()
    assert (folder / "problem.pddl").read_bytes() != before


def test_a_new_file_is_named_and_no_folder_is_made(domain: Path) -> None:
    new = domain.parent / "x.yaml"
    done = pnm("export", str(domain), "-o", str(new))
    assert (done.returncode, done.stdout, done.stderr) == (0, "", f"wrote {new}\n")
    done = pnm("export", str(domain), "-o", str(domain.parent / "a" / "b.yaml"))
    assert done.returncode == 2
    assert done.stderr == f"{domain.parent}/a/b.yaml: cannot be written: there is no folder {domain.parent}/a\n"
    done = pnm("import", str(new), "-o", str(domain.parent / "a" / "b"))
    assert (done.returncode, (domain.parent / "a").exists()) == (2, False)
    assert done.stderr == f"{domain.parent}/a/b: not a folder, and none can be made there: No such file or directory\n"


def test_a_name_that_is_too_long_is_refused_as_any_that_cannot_be_written(domain: Path) -> None:
    for path, reason in (("a" * 300, "File name too long"), ("a" * 300 + "/x.yaml", f"there is no folder {'a' * 300}")):
        done = pnm("export", str(domain), "-o", path)
        assert (done.returncode, done.stderr) == (2, f"{path}: cannot be written: {reason}\n")


# --- pictures ---


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
