"""How long hand-written plans take to be read, translated, proved and run, per step, as ratios within one run.

Reading is compared with PyYAML's own loading of the same text, everything else with a plain Python loop; exporting and
importing with reading the PDDL files they start from. Run with ``python -m tests.benchmarks.bench_language``.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml

from planner_bridge.pipeline.loading import load
from planner_bridge.yaml.convert import exported, imported
from pnm.core.machine.generate import generate
from pnm.core.machine.verification.verify import verify
from pnm.language.plan import read_plans
from tests.support.files import ROOT
from tests.support.runs.direct import drive
from tests.support.runs.timing import seconds

HEAD = "actions:\n  go: {params: [place]}\n  set: {type: kb_action}\nplan:\n"
STEP = (
    "  - concurrent_actions:\n      - go: {place: a}\n      - - go: {place: b}\n"
    "        - if: {Comparison: [eq, [{LocalQuery: n}, 1]]}\n          then: [go: {place: c}]\n          else: [go: {place: d}]\n"
    "  - while: {condition: {Comparison: [lt, [{LocalQuery: n}, 0]]}, actions: [set: {operation: {LocalUpdate: [n, 1]}}]}\n"
)
PER_STEP = 7
"""Steps in one `STEP`, those inside others included."""


def main() -> None:
    unit = seconds(lambda: list(range(1_000_000))) / 1_000_000
    print(f"unit: one turn of a plain loop, {unit * 1e9:.0f} ns")
    with tempfile.TemporaryDirectory() as folder:
        for blocks in (10, 100, 1000):
            text = HEAD + STEP * blocks
            file = Path(folder) / "plan.yaml"
            file.write_text(text, encoding="utf-8")
            steps = blocks * PER_STEP
            plain = seconds(lambda text=text: yaml.safe_load(text))
            read = seconds(lambda file=file: read_plans(file))
            graph = read_plans(file)["plan"].graph
            made = seconds(lambda graph=graph: generate(graph))
            machine = generate(graph)
            proved = seconds(lambda machine=machine: verify(machine))
            ran = seconds(lambda graph=graph: drive(graph, variables={"n": 1})) - made - proved
            each = [round(one / unit / steps) for one in (read, made, proved, ran)]
            told = "read {}, generate {}, prove {}, run {} units per step".format(*each)
            print(f"{steps} steps: {told}; reading takes {read / plain:.1f} times as long as PyYAML's loading")
        for name in ("delivery", "mall_guide", "patrol"):
            domain, problem = ROOT / "domains" / name / "domain.pddl", ROOT / "problems" / name / "p01.pddl"
            out = Path(folder) / f"{name}.yaml"
            reading = seconds(lambda domain=domain, problem=problem: load(domain, problem))
            writing = seconds(lambda domain=domain, problem=problem: exported(domain, problem))
            out.write_text(exported(domain, problem).text, encoding="utf-8")
            back = seconds(lambda out=out: imported(out))
            print(f"{name}: export {writing / reading:.1f}, import {back / reading:.1f} times as long as reading the PDDL")


if __name__ == "__main__":
    main()
