"""The `pnm` command. Exit status: 0 the goal holds, 1 it does not, 2 the input is wrong.

Commands import what they need in their functions, so that each starts as fast as it can.
"""

from __future__ import annotations

import logging
import sys
from importlib import import_module
from pathlib import Path
from typing import Final

import click

from planner_bridge.cli import options
from planner_bridge.cli.options import command
from pnm.core.net.no_collection import no_collection
from pnm.errors import InputError
from pnm.files.database.place import without_password
from pnm.files.process import make_streams_safe, own_standard_output
from pnm.files.text import hide_arguments

ELSEWHERE: Final = {
    "answer": ("running_node", "Answer a question that a task asks a person."),
    "cancel": ("running_node", "Cancel a task, and wait for its robots."),
    "check": ("robot", "Check servers and sensors in the ROS graph."),
    "export": ("convert", "Write a domain, a problem and a plan as YAML."),
    "facts": ("running_node", "Print or change the facts of the node."),
    "give": ("running_node", "Give a robot back that you have taken over."),
    "goal": ("running_node", "Send a goal, and follow it to its end."),
    "history": ("journal", "List the tasks of a journal."),
    "import": ("convert", "Write YAML as PDDL, or a tree as a plan."),
    "init": ("robot", "Write first files for a running robot."),
    "journal": ("journal", "Check, move, copy or prune a journal."),
    "learn": ("journal", "Learn chances and durations from journals."),
    "mcp": ("agents", "Serve agents over the Model Context Protocol."),
    "odds": ("robot", "Say how likely and how soon a goal is reached."),
    "pause": ("running_node", "Pause a task: it starts nothing more."),
    "pose": ("robot", "Write where a robot is now as the pose of a place."),
    "replay": ("journal", "Execute the runs of a journal again."),
    "resume": ("running_node", "Continue a paused task, or a run that has died."),
    "run": ("run", "Plan, execute, and replan until the goal holds."),
    "schema": ("convert", "Write the JSON Schema of YAML files, for editors."),
    "serve": ("running_node", "Take goals over ROS 2 until interrupted."),
    "status": ("running_node", "Show the tasks of the node."),
    "telemetry": ("journal", "Give a journal to OpenTelemetry or Foxglove."),
    "take": ("running_node", "Take a robot over: nothing is sent to it."),
    "watch": ("running_node", "Follow the tasks of the node until interrupted."),
    "why": ("why", "Explain a plan, or why there is none, or a run."),
}
"""Commands in modules of their own, which are imported when they are looked up: their options come from what no other needs.

Each has the first line of its help here as well: the list of all commands imports none of them.
"""


class Commands(click.Group):
    """The commands, here and elsewhere."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        return sorted((*super().list_commands(ctx), *ELSEWHERE))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command by name."""
        if cmd_name not in ELSEWHERE:
            return super().get_command(ctx, cmd_name)
        with no_collection():
            module = import_module(f"planner_bridge.cli.{ELSEWHERE[cmd_name][0]}")
        return next(command for command in vars(module).values() if isinstance(command, click.Command) and command.name == cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what each command does."""
        lines = {name: command.get_short_help_str(formatter.width) for name, command in self.commands.items()}
        with formatter.section("Commands"):
            formatter.write_dl(sorted((lines | {name: line for name, (_, line) in ELSEWHERE.items()}).items()))


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="petri-net-machines", prog_name="pnm")
def app() -> None:
    """Run robots from goals: PDDL goal, plan, Petri Net Machine, ROS 2 actions, and a new plan after a failure."""


@app.command(epilog="Example: pnm plan domain.pddl problem.pddl --format svg -o plan.svg")
@options.files
@options.bindings_option
@options.rates_option
@options.planning
@click.option(
    "--format",
    "written_as",
    type=click.Choice(["text", "dot", "svg"]),
    default="text",
    show_default=True,
    help="dot and svg draw its calls and their orderings, or the policy",
)
@options.output_options
@options.as_json_option
@command
def plan(
    *,
    domain: Path,
    problem: Path,
    bindings: Path | None,
    rates: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
    written_as: str,
    output: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Find and print a plan."""
    from planner_bridge.model.plan import PlanningStatus
    from planner_bridge.planning.kairos import DEFAULT_PLANNER

    if as_json and (written_as != "text" or output):
        raise InputError("--json prints a plan as JSON; expected no --format or --output with it")
    if output:
        options.check_output(output, force=force)
    files = domain, problem
    loaded, result, bound, learned = options.planned(files, bindings, rates, planner, planner_timeout, improve, is_looked_at=True)
    odds, policy = None, options.policy_of(result)
    if result.plan is not None and learned is not None and learned.calls:
        from planner_bridge.pipeline.roll_outs import odds_of_goal
        from planner_bridge.tasks.settings import DEFAULTS, Settings
        from pnm.actions.faults import NO_FAULTS

        settings = Settings(bindings=bound or DEFAULTS.bindings, learned=learned)
        odds = odds_of_goal(loaded, result.plan, settings, NO_FAULTS, policy=result.policy, seconds=0.0)
    if as_json:
        steps = [
            {"action": step.action, "arguments": [*step.arguments], "start": round(step.start, 6), "duration": round(step.duration, 6)}
            | ({"outcome": step.outcome} if step.outcome else {})
            for step in (result.plan.steps if result.plan else ())
        ]
        plan = result.plan
        found = {"cost": plan.cost, "expected_seconds": plan.seconds, "is_best": plan.is_best, "above_best": plan.above} if plan else {}
        fields: dict[str, object] = {"status": result.status.value, "message": result.message, "planner": result.planner, **found}
        fields |= {"until": round(plan.until, 6)} if plan and plan.until else {}
        fields |= {"odds": odds.as_json()} if odds else {}
        fields |= {"policy": policy.as_json()} if policy else {}
        options.print_json({**fields, "steps": steps if result.plan else None})
    elif result.plan is None:
        from planner_bridge.cli.console import SafeConsole  # here and below: a plan alone needs neither rich nor pictures

        SafeConsole(stderr=written_as != "text").print_reason("no plan:", result.reason)
    elif written_as != "text" and policy:
        from planner_bridge.planning.policies.net import steps_dot, steps_svg

        taken = policy.steps()
        options.write(output, steps_svg(taken, policy.claim) if written_as == "svg" else steps_dot(taken), force=force)
    elif written_as != "text":
        from planner_bridge.ordering.plan_to_graph import plan_graph
        from pnm.core.pictures.plan_picture import plan_dot, plan_svg

        graph = plan_graph(loaded, result.plan)
        options.write(output, plan_svg(graph) if written_as == "svg" else plan_dot(graph), force=force)
    else:
        lines = [f"plan     {result.plan}"]
        if result.planner != planner:
            lines.append(f"planner  {result.planner}")
        if odds and odds.best:
            lines.append(f"odds     {odds}")
        if policy:
            lines.append(f"policy   {policy}")
        if result.message:
            lines.append(f"note     {result.message}")
        if improve is None and planner == DEFAULT_PLANNER and result.plan.steps and not (result.plan.is_best or policy):
            lines.append("note     --improve SECONDS may find a better one")
        options.write(output, "\n".join((*lines, "")), force=force)
    return 0 if result.plan else 2 if result.status is PlanningStatus.INVALID else 1


@app.command(epilog="Example: pnm net domain.pddl problem.pddl --format svg -o plan.svg")
@options.files_or_plan
@click.option(
    "--format",
    "written_as",
    type=click.Choice(["json", "pnml", "dot", "svg"]),
    default="json",
    show_default=True,
    help="json has everything; pnml is for other tools for Petri nets; dot and svg are pictures",
)
@click.option("--level", type=click.Choice(["calls", "net"]), help="of a picture: calls and their orderings (default), or the whole net")
@options.output_options
@click.option("-v", "--verbose", is_flag=True, help="list the transitions that can never fire, with the reason")
@click.option(
    "--certificate",
    type=options.FILE,
    help="a new file from which the proof can be made again; prints the command that does it, without this project",
)
@options.bindings_option
@options.rates_option
@options.planning
@command
def net(
    *,
    domain: Path | None,
    problem: Path | None,
    plan_file: Path | None,
    name: str | None,
    written_as: str,
    level: str | None,
    output: Path | None,
    force: bool,
    verbose: bool,
    certificate: Path | None,
    bindings: Path | None,
    rates: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
) -> int:
    """Write the Petri Net Machine of a plan.

    A planner finds the plan, or --plan names a hand-written one. Where actions have several outcomes, it is the net of the policy: a place
    for each step, a transition for each outcome.
    """
    from planner_bridge.ordering.plan_to_graph import plan_graph
    from pnm import generate, net_svg, plan_dot, plan_svg, verify
    from pnm.core.pictures.export import as_data, to_dot, to_json
    from pnm.core.pictures.pnml import LOST, to_pnml

    if written_as in ("json", "pnml") and level == "calls":
        raise InputError(f"--format {written_as} has the whole net; expected --format dot or svg with --level calls")
    if written_as == "pnml":
        print(f"note     {LOST}", file=sys.stderr)
    if certificate:
        options.check_output(certificate, force=force)
        if output is not None and output.resolve() == certificate.resolve():
            raise InputError(f"{certificate}: cannot be the net and its certificate; expected two files")
    chosen = options.chosen_files(domain, problem, plan_file)
    if isinstance(chosen, Path):
        from pnm.actions.bindings_file import read_bindings
        from pnm.language.plan import chosen_plan, read_plans

        plans = read_plans(chosen)
        plan = plans[chosen_plan(plans, name)]
        options.print_warnings(plan.warnings)
        own = read_bindings(bindings).before(plan.bindings) if bindings else plan.bindings
        machine = generate(plan.graph, own, on_failure=plan.on_failure)
    else:
        loaded, result, bound, _ = options.planned(chosen, bindings, rates, planner, planner_timeout, improve)
        if result.plan is None:
            from planner_bridge.cli.console import SafeConsole

            SafeConsole(stderr=True).print_reason("no plan:", result.reason)
            return 1
        if policy := options.policy_of(result):
            from planner_bridge.planning.policies.net import PolicyNet, steps_dot, steps_svg

            if certificate:
                raise InputError("the plan is a policy, for whose net there is no certificate; expected actions with one outcome each")
            whole = PolicyNet(policy.steps())
            match written_as, level:
                case "json", _:
                    text = whole.as_json()
                case "pnml", _:
                    text = to_pnml(whole.as_data())
                case "svg", _:
                    text = steps_svg(whole.steps, policy.claim)
                case _:
                    text = whole.dot() if level == "net" else steps_dot(whole.steps)
            options.write(output, text, force=force)
            print(whole.claim, file=sys.stderr)
            return 0
        machine = generate(plan_graph(loaded, result.plan), bound)
    proof = verify(machine)
    match written_as, level:
        case "json", _:
            text = to_json(machine)
        case "pnml", _:
            text = to_pnml(as_data(machine))
        case "dot", "net":
            text = to_dot(machine)
        case "svg", "net":
            text = net_svg(machine)
        case _:
            text = plan_svg(machine.plan) if written_as == "svg" else plan_dot(machine.plan)
    options.write(output, text, force=force)
    if certificate:
        options.write_certificate(certificate, machine, force=force)
    never = f"{len(proof.never)} of {len(machine.net.transitions)} transitions can never fire"
    print(f"proved {proof}; {never}{'' if verbose else ', -v lists them'}", *(proof.never if verbose else ()), sep="\n", file=sys.stderr)
    return 0


@app.command(epilog="Examples: pnm simulate domain.pddl problem.pddl --faults faults.yaml; pnm simulate --plan round.yaml --set robot=r1")
@options.files_or_plan
@options.set_option
@options.bindings_option
@options.faults_option
@click.option("--speed", type=options.Seconds(0.001), help="simulated seconds per real second; default 20, or 1 with timed facts")
@click.option("--log", type=options.FILE, help="a new file for the true events, one JSON object a line")
@options.force_option
@command
def simulate(
    *,
    domain: Path | None,
    problem: Path | None,
    plan_file: Path | None,
    name: str | None,
    given: tuple[str, ...],
    bindings: Path | None,
    faults: Path | None,
    speed: float | None,
    log: Path | None,
    force: bool,
) -> int:
    """Simulate the robots, as action servers of ROS 2.

    There is one for each action of DOMAIN, or as the bindings say; with --plan, for each action of the plans of a file. Sensors publish
    their facts.
    """
    from planner_bridge.node.simulate import play, play_plans
    from planner_bridge.pipeline.loading import bindings_for

    if log:
        options.check_output(log, force=force)
    chosen = options.chosen_files(domain, problem, plan_file)
    if isinstance(chosen, Path):
        own, parameters = bindings_for(None, bindings, None), options.plan_parameters(given)
        return play_plans(chosen, name, parameters, own, options.faults_in(faults, None), speed or 20.0, log)
    if name or given:
        raise InputError("--name and --set belong to hand-written plans; expected --plan and a file")
    loaded = options.problem_in(*chosen)
    bound = bindings_for(chosen[0], bindings, loaded.vocabulary)
    return play(
        loaded, bound, options.faults_in(faults, loaded.vocabulary), speed or (1.0 if loaded.timed or loaded.domain.nature else 20.0), log
    )


@app.command("help", epilog="Example: pnm help run")
@click.argument("name", metavar="[COMMAND]", required=False)
@click.pass_context
def show_help(context: click.Context, name: str | None) -> None:
    """Show the help of a command."""
    parent = context.parent
    assert parent is not None
    if name:
        _, found, _ = app.resolve_command(parent, [name])
        assert found is not None
        parent = click.Context(found, info_name=name, parent=parent)
    click.echo(parent.get_help())


@app.command(epilog="Example: pnm demo mall")
@click.argument("story", type=click.Choice(["delivery", "mall"]), default="delivery")
@command
def demo(story: str) -> int:
    """Show a goal with failures on simulated robots.

    Plan, machine, run, failure, replan, goal.

    `mall`, over ROS 2: several tasks share a robot, and people interrupt it and answer late.
    """
    from planner_bridge.cli.console import SafeConsole
    from planner_bridge.cli.demo import show_delivery, show_mall

    return show_mall(SafeConsole()) if story == "mall" else show_delivery(SafeConsole())


def main() -> None:
    """Run the command line."""
    own_standard_output()
    make_streams_safe()
    hide_arguments(without_password)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", handlers=[_Warnings()])
    app(prog_name="pnm")


class _Warnings(logging.Handler):
    """Prints warnings on stderr, on terminals in lines that are not too long."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a warning."""
        from planner_bridge.cli.console import SafeConsole

        for line in self.format(record).split("\n"):
            SafeConsole(stderr=True).print_text(line)
