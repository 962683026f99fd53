"""Run what the README shows with an installed `pnm`, and compare what it prints.

usage: python -m tests.support.docs.readme FOLDER_OF_PNM
"""

from __future__ import annotations

import difflib
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.docs.page import as_it_is, blocks_of, follow
from tests.support.docs.shell import InstalledShell, with_examples
from tests.support.files import ROOT


def main() -> None:
    shown = (ROOT / "README.md").read_text(encoding="utf-8")
    with TemporaryDirectory() as folder:
        real = as_it_is(shown, follow(shown, InstalledShell(with_examples(Path(folder)), Path(sys.argv[1]).resolve())))
    if real != shown:
        sys.exit("".join(difflib.unified_diff(shown.splitlines(True), real.splitlines(True), "README.md", "what is printed")))
    commands = [step.command for block in blocks_of(shown, "console") for step in block.steps()]
    print(f"{len(commands)} commands of the README print what it says")


if __name__ == "__main__":
    main()
