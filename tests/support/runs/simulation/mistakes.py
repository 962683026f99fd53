"""Classic mistakes of durable execution, each as a change of a copy of the product: the simulation has to catch every one."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.support.files import ROOT


class DoesNotApply(Exception):
    """The product has changed so that the mistake cannot be made in this way any more: write it anew."""


@dataclass(frozen=True, slots=True)
class Change:
    """A text of a file, which is there once, and what stands there with the mistake."""

    file: str
    right: str
    wrong: str


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake.

    Args:
        name: of it, for people.
        changes: what makes it.
        law: the law that it breaks.
        first: the seed to begin with, for what only rare courses show.
    """

    name: str
    changes: tuple[Change, ...]
    law: str
    first: int = 0

    def made_in(self, copy: Path) -> None:
        """Make the mistake in a copy of the product; raises `DoesNotApply`."""
        for change in self.changes:
            file = copy / change.file
            text = file.read_text(encoding="utf-8")
            if text.count(change.right) != 1:
                raise DoesNotApply(f"{self.name}: {change.file} has {text.count(change.right)} times\n{change.right}")
            file.write_text(text.replace(change.right, change.wrong), encoding="utf-8")


_JOURNAL: Final = "pnm/journal/journal.py"
_RUN: Final = "pnm/core/execution/run.py"
MISTAKES: Final = (
    Mistake(
        "the intent is kept after the request was sent",
        (
            Change(
                _JOURNAL,
                "        self._waiting.append((perform, tuple(commands)))\n        sent = ",
                "        perform(commands)\n        sent = ",
            ),
        ),
        "nothing_is_sent_before_its_intent_is_kept",
    ),
    Mistake(
        "effects are kept in a second transaction",
        (
            Change(
                _JOURNAL,
                "run.fired, tuple(deltas), records.intents_of(commands), run.told), now)\n",
                "run.fired, (), records.intents_of(commands), run.told), now)\n"
                "        self._write()\n"
                "        for delta in deltas:\n            self._record(delta)\n"
                "        self._due = self._due or self._loop.call_soon(self._write)\n",  # or timers are lost
            ),
            Change(
                "pnm/journal/replay.py",
                '        if deltas != record.deltas:\n            _differ(number, "changes", deltas, record.deltas)\n',
                "",
            ),
        ),
        "knowledge_is_the_fold_of_its_changes",
        55,
    ),
    Mistake(
        "there are no epochs",
        (
            Change("pnm/journal/store.py", "if epoch > self.epoch:", "if epoch < self.epoch:"),
            Change("pnm/journal/store.py", "self._mend(int(last) if epoch == self.epoch else 0)", "self._last = int(last)"),
        ),
        "knowledge_is_the_fold_of_its_changes",
        40,
    ),
    Mistake(
        "results are not told apart from repeated ones",
        (
            Change(
                "pnm/core/execution/call_requests.py",
                "        self.open: dict[UUID, int] = {}\n",
                "        self.open: dict[UUID, int] = {}\n        self.ever: dict[UUID, int] = {}\n",
            ),
            Change(
                "pnm/core/execution/call_requests.py",
                "        self.open[identity] = call\n",
                "        self.open[identity] = self.ever[identity] = call\n",
            ),
            Change(
                _RUN, "call = self._calls.open.get(report.request)\n        if", "call = self._calls.ever.get(report.request)\n        if"
            ),
            Change(
                _RUN, "            del self._calls.open[report.request]  #", "            self._calls.open.pop(report.request, None)  #"
            ),
        ),
        "an_end_comes_after_the_intent_and_counts_once",
        15,
    ),
    Mistake(
        "retries have no budget",
        (
            Change(
                "pnm/core/machine/call_block.py",
                'self.add(again, [recover, budget], [ready, spent], title=f"{phase}retry")',
                'self.add(again, [recover, budget], [ready, budget], title=f"{phase}retry")',
            ),
        ),
        "a_call_is_tried_as_often_as_it_may_be",
        50,
    ),
    Mistake(
        "a call between two attempts counts as under way while its run is held",
        (
            Change("pnm/core/machine/call_block.py", 'again = Rule("retry", outcome=CallOutcome.SUSPENDED)', 'again = Rule("retry")'),
            Change(
                "pnm/executor.py",
                "return len(self.run.open_requests) == len(self.run.under_way()) and not self.run.settling",
                "return not (self.run.settling or any(call.kind.value == 'running' for call in self.run.interim_result().calls))",
            ),
            Change("pnm/executor.py", "            if self.paused and not self.run.looks_for_effects:\n                return False\n", ""),
        ),
        "every_task_ends",
        80,
    ),
    Mistake(
        "the lease is not looked at before something is sent",
        (Change(_JOURNAL, "while self._waiting and self._hold.is_mine():", "while self._waiting:"),),
        "nothing_is_sent_after_another_has_taken_over",
        965,
    ),
    Mistake(
        "guards are evaluated again, with what is known now",
        (
            Change(
                _JOURNAL,
                "        if self._handling:\n            self._deltas.append(delta)\n        else:\n            self._record(delta)\n",
                "        if self._handling:\n            self._deltas.append(delta)\n",
            ),
        ),
        "every_task_ends",
    ),
)


def first_broken(mistake: Mistake, folder: Path, seeds: int, first: int = 0) -> str:
    """Make the mistake in a copy of the product and simulate seeds with it; return what is said of the first that breaks a law, if any."""
    shutil.copytree(ROOT / "pnm", folder / "pnm", ignore=shutil.ignore_patterns("__pycache__"))
    mistake.made_in(folder)
    done = subprocess.run(
        [sys.executable, "-m", "tests.simulation", "--seeds", str(seeds), "--first", str(first), "--jobs", "1", "--stop"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == ("\nseed " in f"\n{done.stdout}"), done.stderr
    return done.stdout if done.returncode else ""
