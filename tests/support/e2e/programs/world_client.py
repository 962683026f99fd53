"""Asks the node that takes goals about the world, and prints a JSON object per answer. Run as a module."""

from __future__ import annotations

from typing import Any

import rclpy
from pnm_interfaces.srv import GetProblem, LoadProblem, QueryFacts, SaveProblem, UpdateFacts

from tests.support.processes import LIMIT, say_event


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("world_client")

    def ask(event: str, kind: Any, name: str, **fields: Any) -> None:
        client = node.create_client(kind, name)
        assert client.wait_for_service(LIMIT)
        future = client.call_async(kind.Request(**fields))
        while not future.done():  # everything that is asked here may be asked twice: a first answer may get lost
            rclpy.spin_until_future_complete(node, future, timeout_sec=3.0)
            future = future if future.done() else client.call_async(kind.Request(**fields))
        answer = future.result()
        told = {name: getattr(answer, name) for name in answer.get_fields_and_field_types()}
        say_event(event, **told)

    ask("query", QueryFacts, "knowledge/query", questions=["(takes_parcels hall)", "(takes_parcels yard)", "(speed r1)"])
    ask("wrong", UpdateFacts, "knowledge/update", add=["(takes_parcels yard)", "(takes_parcels hal)"])
    ask("update", UpdateFacts, "knowledge/update", add=["(takes_parcels yard)"])
    ask("get", GetProblem, "problem/get")
    ask("save", SaveProblem, "problem/save", file="now.pddl")
    ask("outside", SaveProblem, "problem/save", file="../now.pddl")
    ask("load", LoadProblem, "problem/load", problem="(define (problem q))")


if __name__ == "__main__":
    main()
