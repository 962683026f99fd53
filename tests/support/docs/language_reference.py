"""The examples of docs/language.md: files, commands and what these print, and lists of formulas.

usage: python -m tests.support.docs.language_reference      (puts what is really printed into the page)
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from click.testing import CliRunner

from planner_bridge.cli.commands import app
from tests.support.files import ROOT

PAGE = ROOT / "docs" / "language.md"
BLOCK = re.compile(r"```(?P<kind>yaml|console) ?(?P<name>[^\n]*)\n(?P<body>.*?)```", re.DOTALL)
LEFT_OUT = "…\n"


@dataclass(frozen=True)
class Shown:
    """What a command is shown to print."""

    command: str
    output: str

    def printed(self) -> str:
        """Return what it really prints, here."""
        done = CliRunner().invoke(app, self.command.split()[1:])
        return done.output

    def agrees(self, printed: str) -> bool:
        """Tell whether the lines are those that are printed; an ellipsis stands for any lines."""
        pattern = "(?:.*\n)*?".join(map(re.escape, f"\n{self.output}".split(LEFT_OUT)))
        return re.fullmatch(pattern, f"\n{printed}") is not None


def blocks_of(kind: str, page: str) -> list[tuple[str, str]]:
    """Return the blocks of a kind: what stands behind it, and what is in them."""
    return [(found["name"], found["body"]) for found in BLOCK.finditer(page) if found["kind"] == kind]


def example_files(page: str) -> dict[str, str]:
    """Return the files that the page shows, by name."""
    return {name: body for name, body in blocks_of("yaml", page) if name.endswith(".yaml")}


def command_shown(body: str) -> Shown:
    """Return the command of a block and what it prints."""
    first, _, rest = body.partition("\n")
    return Shown(first.removeprefix("$ "), rest)


@contextmanager
def inside_of(folder: Path) -> Iterator[None]:
    """Be in a folder; knowledge that outlasts a process is kept there."""
    before, state = Path.cwd(), os.environ.get("XDG_STATE_HOME")
    os.chdir(folder)
    os.environ["XDG_STATE_HOME"] = str(folder)
    try:
        yield
    finally:
        os.chdir(before)
        del os.environ["XDG_STATE_HOME"]
        if state is not None:
            os.environ["XDG_STATE_HOME"] = state


def put_files(page: str, folder: Path) -> None:
    """Write the files that the page shows."""
    for name, text in example_files(page).items():
        (folder / name).write_text(text, encoding="utf-8")


def abridged(printed: str) -> str:
    """Leave out what an example is not about: the size of the machine, and the counts at the end."""
    lines = printed.splitlines(keepends=True)
    if lines and lines[0].startswith("machine"):
        return "".join([LEFT_OUT, *lines[1:-1], LEFT_OUT])
    return printed


def main() -> None:
    page = PAGE.read_text(encoding="utf-8")
    with TemporaryDirectory() as folder, inside_of(Path(folder)):
        put_files(page, Path(folder))

        def real(found: re.Match[str]) -> str:
            if found["kind"] == "yaml":
                return found[0]
            one = command_shown(found["body"])
            return f"```console\n$ {one.command}\n{abridged(one.printed())}```"

        PAGE.write_text(BLOCK.sub(real, page), encoding="utf-8")


if __name__ == "__main__":
    main()
