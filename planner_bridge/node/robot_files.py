"""The bindings and sensors of a node, which stay while problems come and go."""

from __future__ import annotations

from dataclasses import dataclass

from planner_bridge.node.options import Options
from planner_bridge.pipeline.loading import bindings_beside
from pnm.actions.bindings_file import bindings_in
from pnm.core.logic.domain import Vocabulary
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.files.yaml_nodes import Mapped, load_yaml
from pnm.knowledge.sensor_file import sensing_in
from pnm.knowledge.sensor_model import NO_SENSING, Sensing


@dataclass(frozen=True)
class RobotFiles:
    """What stood in the files of bindings and sensors when the node was configured; None without such a file."""

    bindings: Mapped | None
    sensing: Mapped | None

    @staticmethod
    def of(options: Options) -> RobotFiles:
        """Load the files; raise an `InputError` if one is no YAML."""
        chosen = (options.bindings or bindings_beside(options.domain), options.sensing)
        return RobotFiles(*[load_yaml(file) if file else None for file in chosen])

    def read(self, known: Vocabulary | None, *, strangers: bool = False) -> tuple[Bindings, Sensing]:
        """Return bindings and sensors; raise an `InputError` where a name is not declared, or used in another way.

        Args:
            known: the names of the problem; any if None.
            strangers: whether there may be bindings of actions that it does not have.
        """
        bindings = bindings_in(self.bindings, known, strangers=strangers) if self.bindings else NO_BINDINGS
        return bindings, sensing_in(self.sensing, known) if self.sensing else NO_SENSING
