"""`pnm mcp`: tools for agents, over the node, or over files without any robot."""

from __future__ import annotations

from pathlib import Path

import click

from planner_bridge.cli import options
from planner_bridge.cli.options import command
from planner_bridge.cli.running_node import namespace_option
from pnm.clock import run_async
from pnm.errors import InputError
from pnm.files.database.place import Place, place_of


@click.command(epilog="Examples: pnm mcp domain.pddl problem.pddl; pnm mcp --allow-goals --policy policy.yaml")
@click.argument("domain", type=options.FILE, required=False)
@click.argument("problem", type=options.FILE, required=False)
@namespace_option
@click.option("--allow-goals", is_flag=True, help="let agents send goals, pause, resume, cancel, and answer questions")
@click.option("--policy", type=options.FILE, help="YAML file that says which goals need a person's yes; by default all")
@click.option("--http", "port", type=click.IntRange(1, 65535), help="serve over HTTP at this port of this computer, with a token")
@click.option("--journal", metavar="FILE", help="file or postgresql://… of the journal; by default the one written last on this computer")
@command
def mcp(
    *,
    domain: Path | None,
    problem: Path | None,
    namespace: str,
    allow_goals: bool,
    policy: Path | None,
    port: int | None,
    journal: str | None,
) -> int:
    """Serve agents over the Model Context Protocol.

    An agent reads the world, previews plans with their proof and odds, and asks why, over standard input and output until they are closed.
    Without DOMAIN and PROBLEM, it does so in the running node; with --allow-goals, it also acts there. A goal that needs a person's
    yes by the --policy begins only after that: the node asks on its page, at its terminal or on knowledge/questions.
    """
    from planner_bridge.node.agents import Agents, Approval, check_installed, offered_node, read_approval, serve_agents
    from planner_bridge.node.node_journal import latest_journal
    from planner_bridge.node.problem_service import served_files
    from planner_bridge.pipeline.loading import bindings_for, rates_for
    from planner_bridge.tasks.settings import Settings

    check_installed()
    if policy and not allow_goals:
        raise InputError("--policy is about goals that are sent; expected --allow-goals as well")
    if domain and (problem is None or allow_goals):
        raise InputError("expected DOMAIN and PROBLEM to look at; or neither of them for a node, which --allow-goals needs")
    approval = (read_approval(policy) if policy else Approval()) if allow_goals else None
    token = options.announced_token(port) if port else ""

    def place() -> Place:
        return place_of(journal) if journal is not None else latest_journal()

    async def serve_files(domain: Path, problem: Path) -> None:
        loaded = options.problem_in(domain, problem)
        settings = Settings(bindings=bindings_for(domain, None, loaded.vocabulary), learned=rates_for(domain, None))
        await serve_agents(Agents(served_files(loaded, settings), place), port, token)

    async def serve_node() -> None:
        from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

        async with RosThread("pnm_mcp", namespace=namespace) as ros, offered_node(ros) as node:
            await serve_agents(Agents(node, place, approval), port, token)

    run_async(serve_files(domain, problem) if domain and problem else serve_node())
    return 0
