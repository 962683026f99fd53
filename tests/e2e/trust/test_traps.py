"""A folder full of Python files that have the names of what our processes import: none of them is executed, whatever is started there."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from contextlib import closing
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tests.support.files import ROOT
from tests.support.processes import Program, ros_domain
from tests.support.ros.middleware import middleware

COMMAND = str(Path(sys.executable).parent / "pnm")
FILES = (str(ROOT / "domains/delivery/domain.pddl"), str(ROOT / "problems/delivery/p01.pddl"))
MALL = (str(ROOT / "domains/mall/domain.pddl"), str(ROOT / "problems/mall/p01.pddl"))
TRAP = "import pathlib\npathlib.Path({log!r}).open('a').write(__name__ + '\\n')\nraise ImportError('a trap')\n"


@pytest.fixture
def traps(tmp_path: Path) -> tuple[Path, Path]:
    """The folder, and the file that says which traps were executed."""
    folder, log = tmp_path / "traps", tmp_path / "executed"
    folder.mkdir()
    for name in {*sys.stdlib_module_names, *packages_distributions(), "pnm", "planner_bridge"}:
        if name.isidentifier():
            (folder / f"{name}.py").write_text(TRAP.format(log=str(log)))
    shutil.copytree(folder, folder / "planner_bridge")
    (folder / "planner_bridge" / "__init__.py").write_text(TRAP.format(log=str(log)))
    return folder, log


def test_the_traps_work(traps: tuple[Path, Path]) -> None:
    folder, log = traps
    subprocess.run([sys.executable, "-m", "uvicorn"], cwd=folder, capture_output=True, timeout=60, check=False)
    assert log.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("plan", *MALL, "--planner", "race:fast-downward"),
        ("serve", *FILES, "--view=0", "--journal", "t.journal"),
        ("replay", "{journal}", "--view=0"),
        ("demo", "mall"),
    ],
    ids=lambda arguments: " ".join(Path(argument).name for argument in arguments),
)
def test_nothing_of_the_current_folder_is_executed(arguments: tuple[str, ...], traps: tuple[Path, Path], tmp_path: Path) -> None:
    folder, log = traps
    journal = tmp_path / "before.journal"
    if "{journal}" in arguments:
        Program([COMMAND, "run", *FILES, "--quiet", "--journal", str(journal)], {}, cwd=tmp_path).ended()
    with ros_domain() as domain:
        environment = middleware(tmp_path, domain)
        command = [COMMAND, *(argument.format(journal=journal) for argument in arguments)]
        with closing(Program(command, environment, cwd=folder)) as program:
            if "--view=0" in arguments:  # which stays
                ready = "ready:" if arguments[0] == "serve" else ""
                program.until(lambda: all(any(word in line for line in (*program.out, *program.err)) for word in ("view  ", ready)))
                program.process.send_signal(signal.SIGINT)
            program.ended()
    assert not log.exists(), log.read_text()
    if arguments[0] == "plan":
        assert program.out, str(program)


def test_python_is_started_in_one_place_alone() -> None:
    users = [
        str(file.relative_to(ROOT))
        for package in ("pnm", "planner_bridge")
        for file in (ROOT / package).rglob("*.py")
        if "sys.executable" in file.read_text(encoding="utf-8")
    ]
    assert users == ["pnm/files/process.py"]


def test_our_packages_are_found_where_none_is_installed(tmp_path: Path) -> None:
    """As from a clone, by `PYTHONPATH` alone, without what `pip install -e` makes."""
    for package in ("pnm", "planner_bridge"):
        (tmp_path / package).symlink_to(ROOT / package)
    hidden = "import sys; sys.meta_path = [finder for finder in sys.meta_path if 'editable' not in str(finder)]; "
    code = f"{hidden}import planner_bridge; print(planner_bridge.__file__); from planner_bridge.cli.commands import main; main()"
    with closing(Program(["-c", code, "run", *FILES, "--quiet", "--view=0"], {"PYTHONPATH": str(tmp_path)}, cwd=tmp_path)) as program:
        program.until(lambda: any("view  " in line for line in program.err))
        assert str(tmp_path) in program.out[0]
        program.process.send_signal(signal.SIGINT)
        program.ended()
