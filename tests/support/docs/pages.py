"""Do what the pages show whose robots are simulated, and compare what is printed, and the pictures that are written.

usage: python -m tests.support.docs.pages [--write] [PAGE ...]      (--write puts the real output and pictures in; by default all pages)
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from tests.support.docs.page import PAGES, as_it_is, blocks_of, follow, has_keys, needs_robots, pictures_in, with_keys
from tests.support.docs.shell import OwnShell, with_examples
from tests.support.files import ROOT


def _is_simulated(page: Path) -> bool:
    text = page.read_text(encoding="utf-8")
    return (has_keys(text) or bool(blocks_of(text, "console", "output"))) and not needs_robots(text)


SIMULATED: Final = tuple(page for page in PAGES if _is_simulated(page))
"""The pages that need no ROS."""


def differences(page: Path, folder: Path, *, write: bool = False) -> Iterator[str]:
    """Do what a page shows in an empty folder; yield how the page, and its pictures, differ from what is so.

    Args:
        page: the page.
        folder: an empty folder.
        write: whether to put into the page what is so.
    """
    shown = page.read_text(encoding="utf-8")
    real = with_keys(as_it_is(shown, follow(shown, OwnShell(with_examples(folder)))))
    yield from difflib.unified_diff(shown.splitlines(keepends=True), real.splitlines(keepends=True), page.name, "what is printed")
    if write and real != shown:
        page.write_text(real, encoding="utf-8")
    for picture, file in pictures_in(folder):
        if not picture.exists() or picture.read_bytes() != file.read_bytes():
            yield f"{picture.name} is not what its command draws\n"
            if write:
                picture.write_bytes(file.read_bytes())


def main() -> None:
    write, names = "--write" in sys.argv, [argument for argument in sys.argv[1:] if argument != "--write"]
    different = False
    for page in [Path(name).resolve() for name in names] or SIMULATED:
        with TemporaryDirectory() as folder:
            lines = [*differences(page, Path(folder), write=write)]
        state = "as shown" if not lines else "written" if write else "different"
        print(f"{page.relative_to(ROOT)}: {state}\n{''.join(lines)}", end="")
        different |= bool(lines)
    sys.exit(different and not write)


if __name__ == "__main__":
    main()
