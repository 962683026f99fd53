"""A page with examples: its blocks, the files and commands that they show, and what these print.

    ```yaml NAME.yaml          a file of the page's folder; so is ```pddl NAME.pddl
    ```console                 commands after `$ `, each with what it prints; `…` stands for any lines
    ```console terminal 2      the same in one of several terminals, with the robot of the tutorial
    ```console not run         needs a robot, or a file that there is not: only the options of its commands are looked at
    ```python … ```output      a program and what it prints

The rows of a table below ``<!-- keys of MODULE.CLASS -->`` are the keys of a grammar.

A picture ``docs/pictures/NAME`` is what the commands of a page write into a file of that name.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Final, Protocol

from tests.support.files import ROOT

DOCS: Final = ROOT / "docs"
PICTURES: Final = DOCS / "pictures"
PAGES: Final = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md")))
NOT_RUN: Final = "not run"
LEFT_OUT: Final = "…\n"
_BLOCK = re.compile(r"^```(?P<kind>\w+)(?: (?P<name>[^\n]+))?\n(?P<body>.*?)^```$", re.DOTALL | re.MULTILINE)
_KEYS = re.compile(r"^(?P<head><!-- keys of (?P<module>[\w.]+)\.(?P<name>\w+) -->\n(?:\|.*\n){2})(?:\|.*\n)*", re.MULTILINE)
_TRAILING = re.compile(r" +$", re.MULTILINE)
_VARYING = (
    (re.compile(r" *\d+\.\d+ s\b"), " TIME"),
    (re.compile(r"\b[0-9a-f]{8}\b"), "TASK"),
    (_TRAILING, ""),
    (re.compile(r"^machine .*", re.MULTILINE), "MACHINE"),
    (re.compile(r"^journal: .*", re.MULTILINE), "JOURNAL"),
)
"""What differs from run to run where robots are processes of their own."""


@dataclass(frozen=True)
class Step:
    """A command of a page and what it prints; without a command, what one that goes on has printed since."""

    command: str
    output: str
    terminal: str = ""

    def agrees(self, printed: str) -> bool:
        """Tell whether the lines are those that are printed, in a terminal but for what differs from run to run."""
        shown, real = (_normal(self.output), _normal(printed)) if self.terminal else (self.output, printed)
        pattern = "(?:.*\n)*?".join(map(re.escape, f"\n{shown}".split(LEFT_OUT)))
        return re.fullmatch(pattern, f"\n{real}") is not None

    def as_printed(self, printed: str) -> str:
        """Return the lines for the page: those that it has, if they agree with what is really printed."""
        command = f"$ {self.command}\n" if self.command else ""
        return command + (self.output if self.agrees(printed) else self._abridged(_TRAILING.sub("", printed)))

    def _abridged(self, printed: str) -> str:
        """Leave out what the page leaves out: what it shows between two ellipses begins, and ends, with the lines that are most alike."""
        if LEFT_OUT not in self.output:
            return printed
        lines = printed.splitlines(keepends=True)
        first, *between, last = (part.splitlines(keepends=True) for part in self.output.split(LEFT_OUT))
        kept, at, end = lines[: len(first)], len(first), max(len(first), len(lines) - len(last))
        for part in filter(None, between):
            begins = _most_alike(part[0], lines, at, end)
            at = min(end, _most_alike(part[-1], lines, begins, end) + 1)
            kept += [LEFT_OUT, *lines[begins:at]]
        return "".join([*kept, LEFT_OUT, *lines[end:]])


@dataclass(frozen=True)
class Block:
    """A block of a page: its kind, what stands behind that, what is in it, and where that is."""

    kind: str
    name: str
    body: str
    start: int
    end: int

    @property
    def is_file(self) -> bool:
        """Whether it is a file of the page's folder."""
        return "." in self.name and " " not in self.name

    def steps(self) -> Iterator[Step]:
        """Yield the steps of a console."""
        terminal = self.name if self.name.startswith("terminal") else ""
        first, *rest = re.split(r"^\$ ", self.body, flags=re.MULTILINE)
        if first:
            yield Step("", first, terminal)
        for part in rest:
            command, _, output = part.partition("\n")
            yield Step(command, output, terminal)


class Shell(Protocol):
    """Whatever carries out the commands of a page."""

    folder: Path

    def printed(self, step: Step) -> str:
        """Carry out a step; return what is printed."""


def blocks_of(text: str, *kinds: str) -> list[Block]:
    """Return the blocks of these kinds, or all of them."""
    found = (Block(one["kind"], one["name"] or "", one["body"], *one.span("body")) for one in _BLOCK.finditer(text))
    return [block for block in found if not kinds or block.kind in kinds]


def files_of(text: str) -> dict[str, str]:
    """Return the files that a page shows, by name."""
    return {block.name: block.body for block in blocks_of(text) if block.is_file}


def needs_robots(text: str) -> bool:
    """Tell whether a page has terminals."""
    return any(step.terminal for block in blocks_of(text, "console") for step in block.steps())


def follow(text: str, shell: Shell) -> Iterator[tuple[Block, list[tuple[Step, str]]]]:
    """Do what a page shows, from its beginning to its end; yield the blocks with steps, and what each step has printed."""
    code = ""
    for block in blocks_of(text):
        if block.is_file:
            file = shell.folder / block.name
            file.parent.mkdir(exist_ok=True)
            file.write_text(block.body, encoding="utf-8")
        elif block.kind == "console" and block.name != NOT_RUN:
            yield block, [(step, shell.printed(step)) for step in block.steps()]
        elif block.kind == "python":
            code = block.body
        elif block.kind == "output":
            done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120, check=False)
            yield block, [(Step("", block.body), done.stdout + done.stderr)]


def has_keys(text: str) -> bool:
    """Tell whether a page has tables of keys."""
    return _KEYS.search(text) is not None


def with_keys(text: str) -> str:
    """Return the page with the keys that there are in its tables of keys."""
    return _KEYS.sub(lambda found: found["head"] + getattr(import_module(found["module"]), found["name"]).rows(), text)


def as_it_is(text: str, followed: Iterable[tuple[Block, list[tuple[Step, str]]]]) -> str:
    """Return the page with what is really printed."""
    parts, end = [], 0
    for block, steps in followed:
        parts += [text[end : block.start], *(step.as_printed(printed) for step, printed in steps)]
        end = block.end
    return "".join([*parts, text[end:]])


def pictures_in(folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the pictures of the docs that the commands of a page have written, each with the file that it has written."""
    shown = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    yield from ((PICTURES / file.name, file) for file in sorted(folder.glob("*.svg")) if f"pictures/{file.name})" in shown)


def _most_alike(line: str, lines: list[str], start: int, end: int) -> int:
    """Return the position of the first of the lines that are most alike, from `start`; `end` if there is none."""
    alike = get_close_matches(line, lines[start:end], n=1)
    return lines.index(alike[0], start, end) if alike else end


def _normal(text: str) -> str:
    for pattern, word in _VARYING:
        text = pattern.sub(word, text)
    return text
