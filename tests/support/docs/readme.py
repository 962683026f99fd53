"""Run what the README shows: commands after `$` and Python blocks, and compare what they print.

usage: python -m tests.support.docs.readme FOLDER_OF_PNM      (or with --write, to put the real output in)
"""

from __future__ import annotations

import difflib
import re
import subprocess
import sys
from pathlib import Path

from tests.support.files import ROOT

README = ROOT / "README.md"
CONSOLE = re.compile(r"```console\n\$ (?P<command>[^\n]+)\n(?P<output>.*?)```", re.DOTALL)
PYTHON = re.compile(r"```python\n(?P<code>.*?)```\n\n```output\n(?P<output>.*?)```", re.DOTALL)


def printed(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120)
    if done.returncode:
        sys.exit(f"{command} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def main() -> None:
    folder, write = Path(sys.argv[1]), "--write" in sys.argv
    shown = README.read_text(encoding="utf-8")

    def command(found: re.Match[str]) -> str:
        words = found["command"].split()
        return f"```console\n$ {found['command']}\n{printed([str(folder / words[0]), *words[1:]])}```"

    def code(found: re.Match[str]) -> str:
        return f"```python\n{found['code']}```\n\n```output\n{printed([str(folder / 'python'), '-c', found['code']])}```"

    real = PYTHON.sub(code, CONSOLE.sub(command, shown))
    examples = len(CONSOLE.findall(shown)) + len(PYTHON.findall(shown))
    if write:
        README.write_text(real, encoding="utf-8")
    elif real != shown:
        sys.exit("".join(difflib.unified_diff(shown.splitlines(True), real.splitlines(True), "README.md", "what is printed")))
    print(f"{examples} examples of the README print what it says")


if __name__ == "__main__":
    main()
