"""The SROS2 policy of the page names what a node has in the graph, and nothing else."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from fnmatch import fnmatch
from xml.etree import ElementTree

import pytest

from tests.support.e2e.deployment import ProblemDeployment
from tests.support.e2e.plan_deployment import Serving
from tests.support.files import ROOT
from tests.support.processes import until

PAGE = (ROOT / "docs" / "reference" / "security.md").read_text(encoding="utf-8")
POLICY = ElementTree.fromstring(PAGE.partition("```xml\n")[2].partition("```")[0])
AT_TIMES = {"/clock", "/knowledge/questions", "/knowledge/answers"}
"""With use_sim_time, and where plans ask over topics."""


def named(kind: str, use: str) -> set[str]:
    """The names of the policy, as those of a node without a namespace."""
    texts = [one.text or "" for group in POLICY.iter(f"{kind}s") if group.get(use) == "ALLOW" for one in group]
    return {text if text.startswith("/") else f"/{text}" for text in texts}


def test_the_policy_of_the_page_has_the_names_of_a_running_node(
    deploy: Callable[..., ProblemDeployment], monkeypatch: pytest.MonkeyPatch
) -> None:
    deployment = deploy("delivery/p01", quick=True)
    for name, value in deployment.environment.items():
        monkeypatch.setenv(name, value)
    deployment.pnm(Serving, "serve", *deployment.files, "--journal", "none").ready()
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.action.graph import get_action_server_names_and_types_by_node as servers

    context = rclpy.Context()
    context.init(domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("looks", context=context)

    def differ(found: Iterable[tuple[str, list[str]]], kind: str, use: str) -> set[str]:
        """What is there and not in the policy, or the other way round."""
        names, allowed = {name for name, _ in found if "/_action/" not in name}, named(kind, use)
        unused = {one for one in allowed - AT_TIMES if not any(fnmatch(name, one) for name in names)}
        return {name for name in names if not any(fnmatch(name, one) for one in allowed)} | unused

    def differences() -> dict[str, set[str]]:
        try:
            return {
                "actions": differ(servers(node, "pnm", "/"), "action", "execute"),
                "services": differ(node.get_service_names_and_types_by_node("pnm", "/"), "service", "reply"),
                "topics": differ(node.get_publisher_names_and_types_by_node("pnm", "/"), "topic", "publish"),
                "heard": differ(node.get_subscriber_names_and_types_by_node("pnm", "/"), "topic", "subscribe"),
            }
        except (rclpy.node.NodeNameNonExistentError, RCLError) as error:
            return {str(error): {"/pnm"}}  # it is not seen yet

    seen: list[dict[str, set[str]]] = [{}]

    def is_the_same() -> bool:
        seen[0] = differences()
        return not any(seen[0].values())

    try:
        until(is_the_same, 20.0)
    except AssertionError:
        pytest.fail(f"the policy and the node differ: {seen[0]}")
    finally:
        node.destroy_node()
        context.shutdown()
