"""Mistakes that people make at the command line: what they did, the exit status, and the message that they get."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pytest
from click.testing import CliRunner

from planner_bridge.cli.commands import app

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
        with _inside(folder):
            done = CliRunner().invoke(app, shlex.split(self.command), prog_name="pnm")
        shown = f"{done.output}\n{done.exception!r}"
        assert done.exit_code == self.status, shown
        position = 0
        for part in self.says:
            assert part in done.output[position:], f"{part!r} is not in\n{shown}"
            position = done.output.index(part, position) + len(part)
        assert all(len(line) <= WIDEST for line in done.output.splitlines()), shown
        assert "internal error" not in done.output
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


@contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
