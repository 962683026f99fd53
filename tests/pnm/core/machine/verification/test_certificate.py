"""Certificates: proved again from the file alone; what was changed is noticed, by its hash, and by the proof if that was made anew."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis.strategies import integers

from planner_bridge.cli.options import certificate_text
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.pictures.export import certified
from pnm.files import check_certificate
from pnm.files.check_certificate import PROPERTY, NotProved, check, hash_of
from tests.support.runs.mutation.edits import mutant
from tests.support.runs.mutation.gate import is_proved
from tests.support.runs.mutation.machines import random_machine


def with_hash(data: dict[str, Any]) -> str:
    """The text of a certificate whose hash is that of its contents."""
    return json.dumps({**data, "hash": hash_of(data)}, indent=1) + "\n"


def holds(text: str) -> bool:
    try:
        check(text)
    except NotProved:
        return False
    return True


@settings(deadline=None, max_examples=40)
@given(integers(0, 10**6))
def test_every_proved_machine_has_a_certificate_that_is_proved_again(number: int) -> None:
    assert check(certificate_text(random_machine(number, under_way=number % 5 == 0)))


def test_the_checker_is_a_program_of_its_own(tmp_path: Path) -> None:
    source = Path(check_certificate.__file__).read_text(encoding="utf-8")
    assert len(source.splitlines()) <= 300
    program, file = tmp_path / "check.py", tmp_path / "machine.certificate"
    program.write_text(source, encoding="utf-8")
    text = certificate_text(random_machine(7))
    usage = subprocess.run([sys.executable, "-I", "-S", str(program)], capture_output=True, text=True)
    assert (usage.returncode, usage.stderr) == (1, "usage: python3 check_certificate.py FILE\n")
    for contents, status in ((text, 0), (text.replace('"tokens": 1', '"tokens": 2', 1), 1), ("{}", 1), ("[" * 99_999, 1)):
        file.write_text(contents, encoding="utf-8")
        run = [sys.executable, "-I", "-S", "-OO", str(program), str(file)]  # without docstrings and assertions, too
        done = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == status, done.stderr
        assert (done.stdout if status == 0 else done.stderr).startswith("proved again: " if status == 0 else "not proved: ")


def test_every_edit_of_the_text_is_noticed() -> None:
    text = certificate_text(random_machine(20))
    for seed in range(250):
        random, letters = Random(seed), [*text]
        place = random.randrange(len(letters))
        match random.randrange(4):
            case 0:
                del letters[place]
            case 1:
                letters.insert(place, random.choice(' \n\r0"a,}'))
            case 2:
                letters[place] = random.choice([one for one in '01 a"' if one != letters[place]])
            case _:
                other = random.choice([at for at, letter in enumerate(letters) if letter != letters[place]])
                letters[place], letters[other] = letters[other], letters[place]
        assert not holds("".join(letters)), f"seed {seed}"


def broken(data: dict[str, Any], random: Random) -> str:
    """Change a certificate so that its net is none that could be proved; return what was done."""
    transitions, roles = data["transitions"], {one["name"]: one["role"] for one in data["places"]}
    # that failures are marked, and tries are counted rightly, is not looked at
    arcs = [one for one in data["arcs"] if not {"failure mark", "budget"} & {roles.get(one[end]) for end in ("source", "target")}]
    match random.randrange(8):
        case 0:
            arc = random.choice(arcs)
            arc["weight"] += 1
            return f"{arc} weighs more"
        case 1:
            arc = random.choice(arcs)
            data["arcs"].remove(arc)
            return f"{arc} is lost"
        case 2:
            place = random.choice([one for one in data["places"] if one["role"] not in ("budget", "resource")])
            place["tokens"] += 1
            return f"{place} has one more token"
        case 3:
            ordering = random.choice(data["orderings"] or [{"before": [0, "start"], "after": [0, "end"]}])
            data["orderings"].append({**ordering, "before": ordering["after"], "after": ordering["before"], "place": None})
            return f"{ordering} is asked for the other way round, too"
        case 4:
            transition = random.choice([one for one in transitions if one["action"] == "SEND"])
            transition["action"] = None
            return f"{transition['name']} no longer sends"
        case 5:
            data["goal_place"], data["failed_place"] = data["failed_place"], data["goal_place"]
            return "goal and failed are swapped"
        case 6:
            data["goal"] = "another goal"
            return "the goal is another one"
        case _:
            step = random.choice(data["steps"])
            data["steps"].remove(step)
            return f"{step} is left out"


def test_a_broken_net_is_noticed_although_its_hash_is_right() -> None:
    for seed in range(250):
        random = Random(seed)
        data = {"format": 1, "property": PROPERTY, **certified(random_machine(random.randrange(40)))}
        done = broken(data, random)
        assert not holds(with_hash(data)), f"seed {seed}: {done}"


def entered_by_nobody() -> dict[str, Any]:
    """A certificate whose frame goes straight to its end, and two steps that hold each other."""
    machines = map(random_machine, range(100))
    machine = next(one for one in machines if len(one.plan.every_step) == 1 and "resource" not in map(one.role, one.net.places))
    data: dict[str, Any] = {"format": 1, "property": PROPERTY, **certified(machine)}
    (region,) = data["regions"]
    (first,), (last,) = region["first"], region["last"]
    frame = {one["name"] for one in data["transitions"] if one["call"] is None}
    inner = [one for one in data["arcs"] if not {one["source"], one["target"]} & frame]
    others = {end: f"another {end}" for arc in inner for end in (arc["source"], arc["target"])}
    for kind in ("places", "transitions"):
        data[kind] += [{**one, "name": others[one["name"]]} for one in data[kind] if one["name"] in others]
    for one in data["transitions"]:
        one["call"] = 1 if one["name"] in others.values() else one["call"]
    outer = [one for one in data["arcs"] if one not in inner]
    data["arcs"] = [*inner, *({**one, "source": others[one["source"]], "target": others[one["target"]]} for one in inner)]
    data["arcs"] += [{**one, **{end: "past" for end in ("source", "target") if one[end] in (first, last)}} for one in outer]
    data["places"].append({"name": "past", "role": "", "tokens": 0})
    for holder, (begins, ends) in enumerate([(others[first], others[last]), (first, last)]):
        loop = {"name": f"loop {holder}", "event": "loop", "call": holder, "guard": {"kind": "Always"}, "action": None, "gives_up": False}
        data["transitions"].append(loop)
        data["arcs"] += [{"source": ends, "target": loop["name"], "weight": 1}, {"source": loop["name"], "target": begins, "weight": 1}]
    data["steps"].append({"number": 1, "name": "another"})
    data["calls"].append({**data["calls"][0], "name": "another"})
    data["regions"] = [
        {"owner": None, "steps": [], "first": ["past"], "last": ["past"]},
        {"owner": 1, "steps": [0], "first": [first], "last": [last]},
        {"owner": 0, "steps": [1], "first": [others[first]], "last": [others[last]]},
    ]
    return data


def test_steps_that_nothing_enters_are_noticed() -> None:
    data = entered_by_nobody()
    with pytest.raises(NotProved, match="nothing ever enters"):
        check(with_hash(data))


def test_a_region_that_holds_its_own_owner_is_noticed() -> None:
    data: dict[str, Any] = {"format": 1, "property": PROPERTY, **certified(random_machine(7))}
    data["regions"][0]["owner"] = data["regions"][0]["steps"][0]
    with pytest.raises(NotProved, match="or itself"):
        check(with_hash(data))


def without(data: dict[str, Any], names: set[str]) -> dict[str, Any]:
    """A certificate without some transitions."""
    arcs = [one for one in data["arcs"] if not {one["source"], one["target"]} & names]
    return {**data, "transitions": [one for one in data["transitions"] if one["name"] not in names], "arcs": arcs}


@pytest.mark.parametrize("state", ["requested", "running", "overdue"])
def test_a_request_whose_reports_nothing_takes_is_noticed(state: str) -> None:
    data: dict[str, Any] = {"format": 1, "property": PROPERTY, **certified(random_machine(7))}
    exits = {one["target"] for one in data["arcs"] if one["source"] == f"a1()#1 {state}"}
    ends = {one["name"] for one in data["transitions"] if one["name"] in exits and one["guard"]["kind"] == "Ends"}
    assert ends
    with pytest.raises(NotProved, match="takes no report"):
        check(with_hash(without(data, ends)))


def rules(data: dict[str, Any], event: str) -> list[dict[str, Any]]:
    return [one for one in data["transitions"] if one["event"] == event]


def gives_up_at_once(data: dict[str, Any]) -> None:
    rule = rules(data, "timed_out")[0]
    rule |= {"gives_up": True, "action": None}
    (arc,) = (one for one in data["arcs"] if one["source"] == rule["name"])
    arc["target"] = arc["target"].replace("overdue", "done")


def never_cancels(data: dict[str, Any]) -> None:
    for one in data["transitions"]:
        one["action"] = None if one["action"] == "CANCEL" else one["action"]


def marks_nothing(data: dict[str, Any]) -> None:
    marks = {one["name"] for one in data["places"] if one["role"] == "failure mark"}
    data["arcs"] = [one for one in data["arcs"] if one["target"] not in marks]


def does_something_else(data: dict[str, Any]) -> None:
    rules(data, "accepted")[0]["action"] = "DANCE"


def has_no_calls(data: dict[str, Any]) -> None:
    data["calls"] = []


def claims_more(data: dict[str, Any]) -> None:
    data["property"] = [*data["property"], "the robot is never late"]


@pytest.mark.parametrize("change", [gives_up_at_once, never_cancels, marks_nothing, does_something_else, has_no_calls, claims_more])
def test_what_a_certificate_says_of_itself_is_not_believed(change: Callable[[dict[str, Any]], None]) -> None:
    data: dict[str, Any] = {"format": 1, "property": PROPERTY, **certified(random_machine(7))}
    assert holds(with_hash(data))
    change(data)
    assert not holds(with_hash(data))


def of_mutant(machine: PetriNetMachine) -> str:
    try:
        return with_hash({"format": 1, "property": PROPERTY, **certified(machine)})
    except KeyError:  # it cannot be written
        return ""


def test_of_mutants_that_the_proof_refutes_most_are_refuted_from_their_certificates_and_no_others() -> None:
    verdicts = Counter[tuple[bool, bool]]()
    for number in range(24):
        random = Random(number)
        for _ in range(3):
            name, changed = mutant(random_machine(number), random)
            proved, found = is_proved(changed), holds(of_mutant(changed))
            assert found or not proved, f"machine {number}, {name}: proved, and its certificate is refused"
            verdicts[proved, found] += 1
    assert verdicts[False, False] > 4 * verdicts[False, True]
