"""The source ``ros2``: global knowledge behind a pair of ROS 2 services, of an ontology, a database or another executive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final
from uuid import UUID

from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.errors import InputError
from pnm.knowledge.source import Asker, Source, SourceError, read_value, write_value
from pnm.knowledge.sources import Surroundings, only, seconds, text
from pnm.ros.knowledge.knowledge_services import LAYERS
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.node.service_client import ServiceClient

NAME: Final = "knowledge"
LIMIT: Final = 4.0
"""Seconds to find the service and for its response; new nodes discover each other within 3."""


class Ros2Knowledge:
    """A client of ``<name>/query`` and ``<name>/update``, of the types ``QueryKnowledge`` and ``UpdateKnowledge``."""

    def __init__(self, ros: RosThread, name: str = NAME, *, limit: float = LIMIT) -> None:
        self._name = name
        self._limit = limit
        self._queries = ServiceClient(ros, "pnm_interfaces/srv/QueryKnowledge", f"{name}/query")
        self._updates = ServiceClient(ros, "pnm_interfaces/srv/UpdateKnowledge", f"{name}/update")

    def __repr__(self) -> str:
        return f"<Ros2Knowledge {self._name}>"

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Query the service; return the value, or `MISSING`."""
        answer = await self._queries.call(self._request(question, asker), self._limit)
        self._check(answer)
        return read_value(answer.value) if answer.found else MISSING

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Have the service store the value."""
        self._check(await self._updates.call({**self._request(question, asker), "value": write_value(value)}, self._limit))

    async def close(self) -> None:
        """Destroy both clients."""
        await self._queries.close()
        await self._updates.close()

    def _request(self, question: Question, asker: Asker) -> dict[str, object]:
        return {
            "goal_id": uuid_field(asker.run),
            "layer": LAYERS.index(Layer.GLOBAL),
            "name": question.name,
            "meta": "" if question.meta == "null" else question.meta,
            "timeout": self._limit,
        }

    def _check(self, answer: Any) -> None:
        if not answer.success:
            raise SourceError(f"the knowledge behind {self._name} refuses: {answer.message or 'it does not say why'}")


def uuid_field(uuid: UUID) -> dict[str, object]:
    """Return the fields of a ``unique_identifier_msgs/UUID``."""
    return {"uuid": list(uuid.bytes)}


def ros2(options: Mapping[str, object], surroundings: Surroundings) -> Source:
    """Make the source ``ros2``: ``name`` is the prefix of the names of the services, ``limit`` in seconds."""
    only(options, "name", "limit")
    return Ros2Knowledge(thread(surroundings), text(options, "name", NAME), limit=seconds(options, "limit", LIMIT))


def thread(surroundings: Surroundings) -> RosThread:
    """Return the thread of the node; raise an `InputError` if there is none."""
    if not isinstance(surroundings.ros, RosThread):
        raise InputError("needs ROS 2, which is not used here; expected --actions ros2")
    return surroundings.ros
