"""The benchmark of plan executives: ours and its peers in turn, in one run. Not a test.

usage: python -m tests.benchmarks [--peers FOLDER] [--rounds N] [--only WORDS] [--json FILE] [--write]
       python -m tests.benchmarks --paid [--rounds N] [--write]
       python -m tests.benchmarks --gate [--write]

The peers run in a virtual environment of their own in FOLDER, which is made if it is not there; without one they are named as not
installed. --write puts the tables into docs/reference/benchmarks.md. --paid measures what users pay beside its floors. --gate ends with
status 1 if something of ours has become much slower than it was when its limit was stored; --gate --write stores the limits anew.
"""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from tests.support.benchmarks import paid
from tests.support.benchmarks.executives import gate
from tests.support.benchmarks.executives.measured import MeasuredRow, measure
from tests.support.benchmarks.executives.page import PAGE, cell, measured_part, put_in
from tests.support.benchmarks.executives.table import ROWS
from tests.support.benchmarks.executives.workers import asked_of, machine, our_worker, peers_python, peers_worker, versions


def compare(arguments: argparse.Namespace) -> None:
    """Measure the rows, and print, write and keep what they take."""
    python = peers_python(arguments.peers) if arguments.peers else None
    found: list[MeasuredRow] = []
    with ExitStack() as processes:
        ours = processes.enter_context(our_worker())
        peers = processes.enter_context(peers_worker(python)) if python else None
        for row in (row for row in ROWS if arguments.only.lower() in row.what.lower()):
            for size in row.sizes:
                found.append(measure(row, size, partial(asked_of, ours, peers), arguments.rounds))
                print(f"{row.what}, {size} {row.item}: {shown(found[-1])}", flush=True)
    about, installed = machine(), versions(python)
    if arguments.json:
        content = {"machine": about, "peers": installed, "rows": [measured.as_json() for measured in found]}
        arguments.json.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    if arguments.write:
        part = measured_part(found, about, installed, arguments.rounds)
        PAGE.write_text(put_in(PAGE.read_text(encoding="utf-8"), part), encoding="utf-8")


def pay(arguments: argparse.Namespace) -> None:
    """Measure what users pay, and print and write the table."""
    lines = []
    with our_worker() as worker:
        for line in paid.paid(worker, arguments.rounds):
            print(line, flush=True)
            lines.append(line)
    if arguments.write:
        about = machine()
        part = f"Measured on {about['cpu']}, {about['cores']} cores (load {about['load']}): the least of {arguments.rounds}.\n\n"
        part += "".join(f"{line}\n" for line in lines)
        PAGE.write_text(put_in(PAGE.read_text(encoding="utf-8"), part, paid.BEGIN, paid.END), encoding="utf-8")


def shown(measured: MeasuredRow) -> str:
    """Return what a row has taken, on one line."""
    ours = measured.taken[0]
    return ", ".join(f"{taken.subject.label} {cell(taken, ours, measured.row.unit)}" for taken in measured.taken)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description="ours and other plan executives, in turn")
    parser.add_argument("--peers", type=Path, metavar="FOLDER", help="the virtual environment of the peers")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="how often each is measured, at most")
    parser.add_argument("--only", default="", metavar="WORDS", help="rows whose titles have these words")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep everything that was measured")
    parser.add_argument("--write", action="store_true", help="put the tables, or the limits, into their file")
    parser.add_argument("--paid", action="store_true", help="what users pay, beside its floors")
    parser.add_argument("--gate", action="store_true", help="fail if something has become much slower")
    arguments = parser.parse_args()
    if arguments.write and arguments.only:
        parser.error("--write puts all rows onto the page, and needs them: leave out --only")
    if arguments.gate:
        if arguments.write:
            gate.store()
        lines, reasons = gate.compared()
        print("\n".join(lines))
        if reasons:
            raise SystemExit("\n".join(("too slow:", *reasons)))
    elif arguments.paid:
        pay(arguments)
    else:
        compare(arguments)


if __name__ == "__main__":
    main()
