"""The robot of the mall, the node and the visitors, each in a process of its own."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from tests.support.e2e.deployment import RosDomain
from tests.support.e2e.mall.scripts import file_of, script
from tests.support.e2e.mall.verdict import Verdict, verdict_on
from tests.support.e2e.plan_deployment import Serving, Workers
from tests.support.files import ROOT, written
from tests.support.processes import Program

DOMAIN: Final = ROOT / "domains" / "mall"
SPEED: Final = "80"
"""How many times faster than real time the robot is: it speaks for 25 ms."""
PATIENCE: Final = 1.2
"""Seconds that the node waits for an answer before it asks again: more than this machine needs to deliver one that is late."""
EACH: Final = 60.0
"""Seconds for a script, at most; most take about one."""


class Mall(RosDomain):
    """A ROS domain with a robot and a node.

    Args:
        folder: for the files.
        ros_domain: its number.
        patience: seconds that the node waits for an answer.
    """

    def __init__(self, folder: Path, ros_domain: int, patience: float = PATIENCE) -> None:
        super().__init__(folder, ros_domain)
        self._patience = patience

    def execute(self, numbers: Iterable[int]) -> Verdict:
        """Run scripts one after the other; return the verdict."""
        numbers = list(numbers)
        robot = self.start(Workers([str(DOMAIN / "robot.py"), SPEED], self.environment))
        node = self.pnm(Serving, "serve", *self._files())
        robot.ready()
        node.ready()
        scripts = str(written(self.folder / "scripts.json", file_of(numbers)))
        visitor = self.start(Program([str(DOMAIN / "visitor.py"), scripts], self.environment))
        assert visitor.ended(60.0 + EACH * len(numbers)) == 0, str(visitor)
        node.stop()
        return verdict_on([script(number) for number in numbers], robot.objects(), visitor.objects())

    def keep(self, folder: Path) -> None:
        """Write down what the processes have printed."""
        folder.mkdir(parents=True, exist_ok=True)
        for number, program in enumerate(self._programs):
            (folder / f"{number}.out").write_text("\n".join((*program.out, "")), encoding="utf-8")
            (folder / f"{number}.err").write_text("\n".join((*program.err, "")), encoding="utf-8")

    def _files(self) -> list[str]:
        """Return the arguments of the node, whose people are to answer soon."""
        plans = DOMAIN / "plans"
        domain = (plans / "domain.yaml").read_text(encoding="utf-8")
        assert "topics]" in domain
        str(written(self.folder / "domain.yaml", domain.replace("topics]", f"{{topics: {{limit: {self._patience}}}}}]")))
        str(written(self.folder / "small_talk.yaml", (plans / "small_talk.yaml").read_text(encoding="utf-8")))
        world = str(written(self.folder / "world.yaml", (plans / "world.yaml").read_text(encoding="utf-8")))
        return [str(DOMAIN / "domain.pddl"), str(ROOT / "problems" / "mall" / "p01.pddl"), "--world", world]
