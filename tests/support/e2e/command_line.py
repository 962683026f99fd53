"""The command line in this process, where a command begins at once, and mistakes that people make there.

How processes begin and end is for `tests.support.processes`.
"""

from __future__ import annotations

import json
import logging
import os
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import click
import pytest
from click.testing import CliRunner

from planner_bridge.cli.commands import _Warnings, app
from pnm.files.process import make_streams_safe
from tests.support.files import ROOT


@dataclass(frozen=True)
class Done:
    """What came of a command."""

    returncode: int
    stdout: str
    stderr: str
    output: str
    """Both, as they were printed."""


def pnm(*arguments: str, cwd: Path = ROOT) -> Done:
    """Give a command, in a folder; all that is printed is as safe as by `planner_bridge.cli.commands.main`."""
    with _inside(cwd):
        done = CliRunner().invoke(_Main(), arguments, prog_name="pnm")
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert "Traceback" not in done.output
    assert "internal error" not in done.output
    return Done(done.exit_code, done.stdout, done.stderr, done.output)


def result(done: Done) -> dict[str, Any]:
    """Return the JSON object on the last line that a command has printed."""
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


class _Main(click.Command):
    """The commands, with warnings and streams as in a process of their own."""

    def __init__(self) -> None:
        super().__init__("pnm")

    def main(self, *arguments: Any, **options: Any) -> Any:
        """Run a command."""
        make_streams_safe()
        warnings = _Warnings(logging.WARNING)
        logging.getLogger().addHandler(warnings)
        try:
            return app.main(*arguments, **options)
        finally:
            logging.getLogger().removeHandler(warnings)


# --- mistakes ---


WIDEST: Final = 200
"""Characters of a line that a person reads."""

FILES: Final = {
    "robots/domain.pddl": """\
(define (domain fetch)
  (:requirements :typing :durative-actions :numeric-fluents)
  (:types robot place item)
  (:predicates
    (at ?r - robot ?p - place)
    (on ?i - item ?p - place)
    (holding ?r - robot ?i - item)
    (door_open)
    (linked ?a ?b - place))
  (:functions (speed ?r - robot))
  (:durative-action move
    :parameters (?r - robot ?from ?to - place)
    :duration (= ?duration (/ 4 (speed ?r)))
    :condition (and (at start (at ?r ?from)) (at start (linked ?from ?to)) (over all (door_open)))
    :effect (and (at start (not (at ?r ?from))) (at end (at ?r ?to))))
  (:durative-action grasp
    :parameters (?r - robot ?i - item ?p - place)
    :duration (= ?duration 1)
    :condition (and (over all (at ?r ?p)) (at start (on ?i ?p)))
    :effect (and (at end (not (on ?i ?p))) (at end (holding ?r ?i)))))
""",
    "robots/problem.pddl": """\
(define (problem fetch1)
  (:domain fetch)
  (:objects r1 r2 - robot dock hall - place cup - item)
  (:init (at r1 dock) (at r2 dock) (on cup hall) (door_open)
    (= (speed r1) 1)
    (= (speed r2) 2)
    (linked dock hall) (linked hall dock))
  (:goal (holding r1 cup)))
""",
    "tea.yaml": """\
actions:
  go: {params: [place]}
  say: {params: [text]}
params: [guest]
plan:
  - go: {place: kitchen}
  - if: {Comparison: [eq, [{PersonQuery: drink}, tea]]}
    then: [say: {text: tea for {LocalQuery: guest}}]
    else: [say: {text: water}]
""".replace("{text: tea for {LocalQuery: guest}}", "{text: {LocalQuery: guest}}"),
}
"""What lies in the person's folder."""


@dataclass(frozen=True)
class Mistake:
    """What a person did, and what there should be to read.

    Args:
        command: what was typed behind ``pnm``.
        status: the exit status.
        says: parts of the message, in this order.
        files: texts by name, besides `FILES`.
        edits: what is otherwise in one of `FILES`: its name, the words in it and those in their place.
    """

    command: str
    status: int
    says: tuple[str, ...]
    files: Mapping[str, str] = field(default_factory=dict)
    edits: tuple[tuple[str, str, str], ...] = ()

    def check(self, folder: Path) -> None:
        """Make the mistake in an empty folder."""
        for name, text in {**FILES, **self.files}.items():
            for file, before, after in self.edits:
                if file == name:
                    assert before in text
                    text = text.replace(before, after, 1)
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        before_it = _contents(folder)
        done = pnm(*shlex.split(self.command), cwd=folder)
        shown = done.output
        assert done.returncode == self.status, shown
        position = 0
        for part in self.says:
            assert part in done.output[position:], f"{part!r} is not in\n{shown}"
            position = done.output.index(part, position) + len(part)
        assert all(len(line) <= WIDEST for line in done.output.splitlines()), shown
        if self.status == 2:
            assert done.stdout == "", shown
            assert _contents(folder) == before_it


def mistakes(table: Mapping[str, Mistake]) -> pytest.MarkDecorator:
    """Return the parameters of a test: one mistake at a time, under its name."""
    return pytest.mark.parametrize("mistake", [pytest.param(mistake, id=name) for name, mistake in table.items()])


def plan(command: str = "run --plan tea.yaml --set guest=Ada", *, status: int = 2, says: str | tuple[str, ...], **edit: Any) -> Mistake:
    """Return a mistake in the hand-written plan."""
    return Mistake(command, status, (says,) if isinstance(says, str) else says, **edit)


def _contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
