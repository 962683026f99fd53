"""`pnm export`, `pnm import` and `pnm schema`: PDDL as YAML and back, and what editors check YAML by."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path

import click

from planner_bridge.cli import options
from planner_bridge.cli.console import SafeConsole
from planner_bridge.pipeline.loading import bindings_for
from planner_bridge.yaml.convert import exported, imported, schema_text
from planner_bridge.yaml.writer import unwritten
from pnm.errors import InputError


@click.command(epilog="Example: pnm export domain.pddl problem.pddl -o robots.yaml --with-plan")
@click.argument("domain", type=options.FILE)
@click.argument("problem", type=options.FILE, required=False)
@options.output_options
@click.option("--with-plan", is_flag=True, help="also find and write a plan for the problem")
@options.bindings_option
@options.planning
@options.command
def export(
    *,
    domain: Path,
    problem: Path | None,
    output: Path | None,
    force: bool,
    with_plan: bool,
    bindings: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
) -> int:
    """Write a domain, a problem and a plan as YAML."""
    bound = bindings_for(domain, bindings, None)
    with options.searching(planner, planner_timeout) if with_plan else nullcontext():
        result = exported(domain, problem, with_plan=with_plan, bindings=bound, planner=planner, timeout=planner_timeout, improve=improve)
    options.print_warnings(result.warnings)
    if result.reason:
        SafeConsole(stderr=True).print_reason("no plan:", result.reason)
        return 1
    if left_out := [f"{key!r}" for key in unwritten(bound)]:
        print(f"{' and '.join(left_out)} of the bindings are not in the text: give --bindings when it is run", file=sys.stderr)
    options.write(output, result.text, force=force)
    return 0


@click.command("import", epilog="Example: pnm import robots.yaml -o robots")
@click.argument("file", type=options.FILE)
@click.option(
    "-o", "--output", type=options.FILE, required=True, help="the folder of domain.pddl, problem.pddl and bindings.yaml; created if missing"
)
@options.force_option
@options.command
def from_yaml(file: Path, output: Path, force: bool) -> int:
    """Write a domain in YAML as PDDL.

    Also writes its problem, if it has one, and its bindings as bindings.yaml.
    """
    result = imported(file)
    options.print_warnings(result.warnings)
    try:
        output.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{output}: not a folder, and none can be made there: {error.strerror}") from error
    options.write_files({output / name: text for name, text in result.texts.items()}, force=force)
    return 0


@click.command(epilog="Example: pnm schema -o pnm.json")
@options.output_options
@options.command
def schema(output: Path | None, force: bool) -> int:
    """Write the JSON Schema of YAML files, for editors.

    Editors complete and check plans, domains and worlds with it.
    """
    options.write(output, schema_text(), force=force)
    return 0
