"""Options, files and exit statuses that commands share, and what they say on stderr."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import wraps
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, ParamSpec

import click

from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.loading import BINDINGS, RATES, beside, bindings_for, load, rates_for, warning_lines
from pnm.errors import InputError, PnmError, Tolerated
from pnm.files.database.place import place_of
from pnm.files.signals import CANCELLED, LAST_WORDS, LEAVING, interruptible, leave_within
from pnm.files.text import secret_in, write_private

if TYPE_CHECKING:
    from rich.console import Console

    from planner_bridge.model.plan import PlanningResult
    from planner_bridge.model.rates import Rates
    from planner_bridge.planning.policies.policy import Policy
    from planner_bridge.view.serving import Controlled, PageProcess
    from pnm.actions.faults import Faults
    from pnm.core.logic.domain import Vocabulary
    from pnm.core.machine.bindings import Bindings
    from pnm.core.machine.machine import PetriNetMachine
    from pnm.knowledge.sensor_model import Sensing


P = ParamSpec("P")
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

FILE = click.Path(path_type=Path)


class Seconds(click.FloatRange):
    """A finite number of seconds."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Refuse anything but a finite number of at least the minimum."""
        number = super().convert(value, param, ctx)
        if not isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


def command(function: Callable[P, int]) -> Callable[P, None]:
    """Make a command of a function: its status is the exit status, an error becomes one message without a traceback."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            with interruptible():
                status = function(*args, **kwargs)
                sys.stdout.flush()
        except PnmError as error:
            print(error, file=sys.stderr)
            status = 2 if isinstance(error, InputError) else 1
        except BrokenPipeError:  # the reader of our output has gone, so nothing can be reported either
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            status = 1
        except KeyboardInterrupt:
            LAST_WORDS.say()
            if LAST_WORDS.is_program:  # a thread that was left alone may go on for long
                leave_within(LEAVING)
            status = CANCELLED
        except Exception as error:  # a bug; its place is enough for a report
            where = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(where.filename).name}:{where.lineno}"
            print(f"internal error, please report it: {type(error).__name__} at {place}: {error}", file=sys.stderr)
            status = 1
        LAST_WORDS.drop(status)
        sys.exit(status)

    return run


def print_json(value: object) -> None:
    """Print the JSON object that ``--json`` asks for. It says how a command went, whatever signal comes after it."""
    text = json.dumps(value, default=str)
    LAST_WORDS.drop(CANCELLED)
    print(text, flush=True)


def options(*options: Decorator) -> Decorator:
    """Combine options, for several commands."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            function = option(function)
        return function

    return add


ADOPT: Final = "--adopt"
GIVEN = "given"
"""The key of what a command was given, in the `meta` of its context."""


def state_folder() -> Path:
    """Return the folder of what is kept for this user; raise `SourceError` if the user has no home."""
    from pnm.knowledge.sources import default_path  # here, because most commands keep nothing

    return default_path().parent


def seal_of(command: Sequence[str]) -> str:
    """Return the proof that this user has given a command on this computer, by a secret of the user. Empty if there can be none."""
    try:
        import hmac  # here, because it is slow to import, and a search for a plan needs no seal

        return hmac.new(secret_in(state_folder()), json.dumps(command).encode(), "sha256").hexdigest()
    except (OSError, PnmError):
        return ""


def announce(page: PageProcess, more: str = "") -> None:
    """Say on stderr where a page is. Its token is printed on terminals alone; others are logs, which get the name of a file that has it."""
    where, _, token = page.url.partition("/#")
    is_hidden = bool(token) and not sys.stderr.isatty()
    if is_hidden:
        file = state_folder() / f"page-{where.rpartition(':')[2]}.url"
        write_private(file, f"{page.url}\n")
        more = f"{more}; the URL with the token for its controls is in {file}, which only you can read"
    print(f"view     {where if is_hidden else page.url}{more}", file=sys.stderr, flush=True)


def announced_token(port: int) -> str:
    """Return a new token for HTTP at a port of this computer; say on stderr where that is, and the token as `announce` does.

    Raises an `InputError` if the port is in use.
    """
    import secrets  # here, because most commands serve nothing
    import socket

    with socket.socket() as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind(("127.0.0.1", port))
        except OSError as error:
            raise InputError(f"nothing can be served at port {port}: {error.strerror}") from error
    token, url = secrets.token_urlsafe(32), f"http://127.0.0.1:{port}/mcp"
    if sys.stderr.isatty():
        print(f"mcp      {url} with the header  Authorization: Bearer {token}", file=sys.stderr, flush=True)
    else:
        file = state_folder() / f"mcp-{port}.token"
        write_private(file, f"{token}\n")
        print(f"mcp      {url}; its token is in {file}, which only you can read", file=sys.stderr, flush=True)
    return token


VIEW_PORT: Final = 8421
"""The port of the page, unless another one is chosen."""


class ViewingCommand(click.Command):
    """A command with `view_option`, whose port may be left out: what follows it is another argument then.

    It keeps its arguments, so that another process can get the same.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Note the arguments, and give the page its port."""
        ctx.meta[GIVEN] = tuple(args)
        named = zip(args, [*args[1:], ""], strict=False)
        given = [f"--view={VIEW_PORT}" if one == "--view" and not after.isdecimal() else one for one, after in named]
        return super().parse_args(ctx, given)


files = options(click.argument("domain", type=FILE), click.argument("problem", type=FILE))
files_or_plan = options(
    click.argument("domain", type=FILE, required=False),
    click.argument("problem", type=FILE, required=False),
    click.option(
        "--plan", "--world", "plan_file", type=FILE, help="a hand-written plan in YAML, or a world of plans, instead of DOMAIN and PROBLEM"
    ),
    click.option("--name", help="the plan of that file, if it has several"),
)
set_option = click.option("--set", "given", metavar="NAME=VALUE", multiple=True, help="a parameter of that plan; the value in YAML")


planning = options(
    click.option("--planner", default="kairos", show_default=True, help="kairos, any engine of unified-planning, race, or race:NAME,NAME"),
    click.option("--planner-timeout", type=Seconds(0.01), default=30.0, show_default=True, help="seconds for the planner"),
    click.option(
        "--improve",
        type=Seconds(0),
        help="seconds to search for a better plan, and again while robots work; by default a twentieth of the time that it takes, "
        "at most 5; 0: the first plan, the same every time",
    ),
)
quiet_option = click.option("-q", "--quiet", is_flag=True, help="print only the result")
as_json_option = click.option("--json", "as_json", is_flag=True, help="print only one JSON object, as the last line")
bindings_option = click.option("--bindings", type=FILE, help="the bindings of actions to servers; by default bindings.yaml beside DOMAIN")
rates_option = click.option("--rates", type=FILE, help="the rates that `pnm learn` writes; by default rates.yaml beside DOMAIN")
learn_option = click.option("--learn", "learns", is_flag=True, help="add to the rates how the calls of this run ended, as `pnm learn` does")
limits_option = click.option(
    "--learned-limits", "is_limited", is_flag=True, help="take the limits of calls from the rates, where no binding says one"
)
force_option = click.option("--force", is_flag=True, help="overwrite existing files")
output_options = options(click.option("-o", "--output", type=FILE, help="a new file; by default the terminal"), force_option)
adopt_option = click.option(
    ADOPT, is_flag=True, help="also take a journal of a node or of another computer, a copy, or one without its last records"
)
journal_options = options(
    click.option(
        "--journal",
        type=place_of,
        metavar="FILE OR URL",
        help="file or postgresql://… for the run: `pnm resume` continues it if this process dies",
    ),
    click.option(
        "--durability",
        type=click.Choice(["process-crash", "power-loss"]),
        help="the crash that the journal survives: of the process, or of the computer, which is slower; by default process-crash for a"
        " file, power-loss for PostgreSQL",
    ),
    adopt_option,
)
timeline_option = click.option("--timeline", type=FILE, help="a new SVG file with planned and executed calls, failures and new plans")
knowledge_option = click.option(
    "--knowledge",
    type=place_of,
    metavar="FILE OR URL",
    help="SQLite file or postgresql://… of the global knowledge, instead of the choice of the plans",
)
sensing_option = click.option("--sensing", type=FILE, help="file with the topics and services of ROS 2 that report facts")
view_option = click.option(
    "--view",
    metavar="[PORT]",
    type=click.IntRange(0, 65535),
    help=f"show a page in a browser, at this port (default {VIEW_PORT}, 0 for any)",
)
controls_option = click.option(
    "--view-controls", "controls", is_flag=True, help="let people control tasks on that page, if they have its URL with the token"
)
faults_option = click.option("--faults", type=FILE, help="file with the failures of the simulated robots")


def controlled_by(view: int | None, what: Controlled, *, controls: bool) -> Controlled:
    """Return the part that a page may control, by the options; raise an `InputError` if there is no page."""
    from planner_bridge.view.serving import Controlled  # here, because most commands show no page

    if controls and view is None:
        raise InputError("--view-controls needs the page; expected --view as well")
    return what if controls else Controlled.NOTHING


def named_values(given: tuple[str, ...], option: str) -> list[tuple[str, str]]:
    """Return the names and texts of an option that is given as ``name=value``."""
    values: list[tuple[str, str]] = []
    for setting in given:
        name, equals, text = setting.partition("=")
        if not name or not equals:
            raise InputError(f"expected NAME=VALUE after {option}, found {setting!r}")
        values.append((name, text))
    return values


def plan_parameters(given: tuple[str, ...]) -> dict[str, object]:
    """Return the parameters that `set_option` gives a plan."""
    from pnm.files.yaml_nodes import parse_value  # here, because a search for a plan reads no YAML

    return {name: parse_value(text, f"--set {name}") for name, text in named_values(given, "--set")}


def chosen_files(domain: Path | None, problem: Path | None, plan_file: Path | None) -> Path | tuple[Path, Path]:
    """Return the file of a hand-written plan, or DOMAIN and PROBLEM; raise an `InputError` if neither is given, or both."""
    if plan_file is not None:
        if domain is not None:
            raise InputError("--plan replaces DOMAIN and PROBLEM; expected one or the other")
        return plan_file
    if domain is None or problem is None:
        raise InputError("expected DOMAIN and PROBLEM, or --plan and a file")
    return domain, problem


def problem_in(domain: Path, problem: Path) -> Problem:
    """Read a problem; warnings about its files go to stderr."""
    loaded = load(domain, problem)
    print_warnings(loaded.warnings)
    return loaded


class Planned(NamedTuple):
    """A problem, what a planner has found for it, and what is known of its robots: None where there is no file about that."""

    problem: Problem
    result: PlanningResult
    bindings: Bindings | None
    learned: Rates | None


def planned(
    files: tuple[Path, Path],
    bindings: Path | None,
    rates: Path | None,
    planner: str,
    timeout: float,
    improve: float | None,
    *,
    is_looked_at: bool = False,
) -> Planned:
    """Read a problem, and what there is about its robots, and search for a plan.

    Args:
        is_looked_at: whether the plan is for people alone; see `solve`.
    """
    from planner_bridge.planning.solve import solve  # here, because most commands search for no plan

    domain, problem = files
    loaded = problem_in(domain, problem)
    with searching(planner, timeout):
        bound, learned = robots_of(domain, loaded, bindings, rates)
        result = solve(
            loaded, planner=planner, timeout=timeout, improve=improve, bindings=bound, learned=learned, is_looked_at=is_looked_at
        )
    return Planned(loaded, result, bound, learned)


def robots_of(domain: Path, problem: Problem, bindings: Path | None, rates: Path | None) -> tuple[Bindings | None, Rates | None]:
    """Return the bindings and the rates of robots, by default from the files beside the domain; None where there are none."""
    bound = bindings_for(domain, bindings, problem.vocabulary) if bindings or beside(domain, BINDINGS) else None
    return bound, rates_for(domain, rates) if rates or beside(domain, RATES) else None


def policy_of(result: PlanningResult) -> Policy | None:
    """Return the policy that a plan is the beginning of, if its actions have several outcomes."""
    if result.policy is None:
        return None
    from planner_bridge.planning.policies.policy import Thinking  # here, because most actions have one outcome

    return result.policy.policy if isinstance(result.policy, Thinking) else None


def write(path: Path | None, text: str, *, force: bool) -> None:
    """Write a text to a new file, or to stdout without one; as `write_files` does."""
    if path is None:
        print(text, end="")
    else:
        write_files({path: text}, force=force)


def certificate_text(machine: PetriNetMachine) -> str:
    """Return a certificate of the proof of a machine, as JSON; raise an `InputError` if it is more than the checker looks at."""
    from importlib.metadata import version  # here and below, because few commands prove anything

    from pnm.core.pictures.export import certified
    from pnm.files import check_certificate

    made_by = {"petri-net-machines": version("petri-net-machines"), "python": sys.version.split()[0]}
    data = {"format": check_certificate.FORMAT, "made_by": made_by, "property": check_certificate.PROPERTY, **certified(machine)}
    text = json.dumps({**data, "hash": check_certificate.hash_of(data)}, indent=1) + "\n"
    try:
        check_certificate.check(text)  # so that nobody gets one that is of no use
    except check_certificate.NotProved as error:
        raise InputError(f"the machine is proved, and its certificate is not: {error}") from error
    return text


def write_certificate(path: Path, machine: PetriNetMachine, *, force: bool) -> None:
    """Write a certificate, and say how it is checked."""
    from pnm.files import check_certificate

    write_files({path: certificate_text(machine)}, force=force)
    print(f"check it with: python3 {check_certificate.__file__} {path}", file=sys.stderr)


def check_output(path: Path, *, force: bool) -> None:
    """Raise an `InputError` if a file exists that is not to be replaced, or its folder does not."""
    if not os.path.isdir(path.parent):  # unlike `Path.is_dir` and `Path.is_file` also for names that are too long
        raise InputError(f"{path}: cannot be written: there is no folder {path.parent}")
    if os.path.isfile(path) and not force and not path.is_relative_to("/dev"):  # /dev/stdout may be redirected to a file
        raise InputError(f"{path}: already exists; use --force to overwrite it")


def write_files(texts: Mapping[Path, str | bytes], *, force: bool) -> None:
    """Write texts, or bytes, to new files in folders that exist, and name them on stderr.

    Raises:
        InputError: a file exists, unless they are replaced, or cannot be written. Nothing is written if that is known before.
    """
    for path in texts:
        check_output(path, force=force)
    for path, text in texts.items():
        try:
            with path.open("wb" if force or path.exists() else "xb") as stream:
                stream.write(text.encode() if isinstance(text, str) else text)
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
        print(f"wrote {path}", file=sys.stderr)


def faults_in(file: Path | None, known: Vocabulary | None) -> Faults:
    """Read the faults of a simulation, of known actions if these are given; none without a file."""
    from pnm.actions.faults import NO_FAULTS, read_faults  # here, because most commands simulate nothing

    return read_faults(file, known) if file else NO_FAULTS


def sensing_in(file: Path | None, known: Vocabulary | None) -> Sensing:
    """Read a file of sensors, of known names if these are given; none without a file."""
    from pnm.knowledge.sensor_file import read_sensing  # here, because most commands hear no sensors
    from pnm.knowledge.sensor_model import NO_SENSING

    return read_sensing(file, known) if file else NO_SENSING


# --- words on stderr ------------------------------------------------------------------------------
# What commands say on stderr: warnings about files, and what is being waited for.


def searching(planner: str, limit: float) -> AbstractContextManager[object]:
    """Return a display on stderr, while it is entered, of the planner's search; see `waiting`."""
    return waiting(planner_words(planner, limit)) if sys.stderr.isatty() else nullcontext()


def planner_words(planner: str, limit: float) -> str:
    """Return the words for waiting for a planner."""
    return f"{planner} is looking for a plan, {limit:g} s at most"


def waiting(text: str, console: Console | None = None) -> AbstractContextManager[object]:
    """Return a display, while it is entered, of waiting, its limit and its seconds so far; on terminals only.

    Args:
        console: that of the output; by default stderr.
    """
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from planner_bridge.cli.console import SafeConsole  # here, because most commands have no use for it

    console = console or SafeConsole(stderr=True)
    if not console.is_terminal:
        return nullcontext()
    progress = Progress(
        SpinnerColumn(), TextColumn("{task.description}:", markup=False), TimeElapsedColumn(), console=console, transient=True
    )
    progress.add_task(text)
    return progress


def print_warnings(warnings: Iterable[Tolerated]) -> None:
    """Print warnings about files on stderr."""
    for line in warning_lines(warnings):
        print(line, file=sys.stderr)
