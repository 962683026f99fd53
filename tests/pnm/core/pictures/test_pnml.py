"""Nets as PNML: read back as they were; damaged files are refused where they are wrong; other tools see the same net, and its runs."""

from __future__ import annotations

import warnings
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis.strategies import integers
from stormpy import gspn

from pnm.core.execution.events import Fired, Observer
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.pictures import xml_text
from pnm.core.pictures.export import as_data
from pnm.core.pictures.pnml import GRAMMAR, NET_TYPE, read_pnml, to_pnml
from pnm.errors import InputError
from tests.support.runs.commands import RUN
from tests.support.runs.mutation.machines import random_machine
from tests.support.yaml.chaos import Chaos

PAIR, ARC = '<place id="p"/><transition id="t"/>', '<arc id="a" source="p" target="t"'
FRAME = f'<pnml xmlns="{GRAMMAR}"><net id="n" type="{NET_TYPE}"><page id="g">\n%s\n</page></net></pnml>'


@settings(deadline=None, max_examples=60)
@given(integers(0, 10**6))
def test_a_machine_is_read_back_as_it_was_written(number: int) -> None:
    machine = random_machine(number)
    found = read_pnml(to_pnml(as_data(machine)))
    assert found.net == machine.net
    assert found.net.transitions == machine.net.transitions  # in whose order rules are asked
    assert found.initial == machine.initial


@pytest.mark.parametrize(
    ("inside", "error"),
    [
        ('<place id="p"/><transition id="t"/><arc id="a" source="p" target="q"/>', "2:36: the target of an arc is 'q', which is neither"),
        ('<place id="p"/><place id="q"/><arc id="a" source="p" target="q"/>', "2:31: an arc between two places"),
        ('<place id="p"/><place id="p"/>', "2:16: the id 'p' is used twice"),
        ('<place id="p"><initialMarking><text>-1</text></initialMarking></place>', "2:1: <initialMarking> of 'p' is '-1'; expected"),
        (f'{PAIR}\n<arc id="p" source="p" target="t"/>', "3:1: the id 'p' is used twice"),
        (f"{PAIR}{ARC}/>\n{ARC}/>", "3:1: the id 'a' is used twice"),
        (f"{PAIR}\n{ARC}><type value='inhibitor'/></arc>", "3:1: an arc of type 'inhibitor'; expected 'normal'"),
        (f"{PAIR}\n{ARC}><type><text>reset</text></type></arc>", "3:1: an arc of type 'reset'; expected 'normal'"),
        (f"{PAIR}\n{ARC} type='read'/>", "3:1: an arc of type 'read'; expected 'normal'"),
        ("<place/>", "2:1: <place> lacks its attribute 'id'"),
        ('<referencePlace id="r" ref="p"/>', "2:1: <referencePlace> is not read"),
        ('<place id="p">', "3:3: not XML: mismatched tag"),
        ("<page id='h'>" * 200, "is nested too deeply"),
    ],
)
def test_a_wrong_net_is_refused_where_it_is_wrong(inside: str, error: str) -> None:
    with pytest.raises(InputError) as caught:
        read_pnml(FRAME % inside, "net.pnml")
    assert error in str(caught.value)


def test_an_arc_may_say_that_it_is_normal() -> None:
    assert len(read_pnml(FRAME % f"{PAIR}{ARC}><type value='normal'/></arc>").net.arcs) == 1


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ('<!DOCTYPE p [<!ENTITY a "aaaa">]>\n<pnml/>', "expected no document type"),
        ('<!DOCTYPE p SYSTEM "file:///etc/passwd">\n<pnml/>', "expected no document type"),
        ("<pnml/>", "x:1:1: expected <pnml xmlns="),
        (f'<pnml xmlns="{GRAMMAR}"/>', "expected one net, found 0"),
        (f'<pnml xmlns="{GRAMMAR}"><net id="n" type="http://www.pnml.org/version-2009/grammar/symmetricnet"/></pnml>', "a net of type"),
        ("", "x:1:1: not XML: no element found"),
    ],
)
def test_what_is_no_place_transition_net_is_refused(text: str, error: str) -> None:
    with pytest.raises(InputError) as caught:
        read_pnml(text, "x")
    assert error in str(caught.value)


def test_a_file_of_too_many_elements_is_refused_where_they_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xml_text, "MOST_ELEMENTS", 5)
    assert len(read_pnml(FRAME % PAIR).net.transitions) == 1
    with pytest.raises(InputError, match="net:3:1: expected 5 elements at most"):
        read_pnml(FRAME % f"{PAIR}\n{ARC}/>", "net")


def refusal(text: str) -> InputError | None:
    try:
        read_pnml(text)
    except InputError as error:
        return error
    return None


def test_damaged_files_are_refused_in_sentences_or_are_nets() -> None:
    whole = to_pnml(as_data(random_machine(7)))
    for seed in range(300):
        random, letters = Random(seed), [*whole]
        for _ in range(random.randint(1, 4)):
            place = random.randrange(len(letters))
            letters[place : place + random.randint(0, 3)] = random.choice(["", "<", "0", '"', "/", "p1", "\x00", "&a;"])
        error = refusal("".join(letters))
        assert error is None or error.position, f"seed {seed}: {error}"


# --- other tools ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pm4py() -> ModuleType:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says its licence (AGPL-3.0), and what other libraries no longer like of it
        import pm4py as library
    return library


def read_by(pm4py: ModuleType, machine: PetriNetMachine, folder: Path) -> tuple[Any, Any]:
    file = folder / "net.pnml"
    file.write_text(to_pnml(as_data(machine)), encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # there is no final marking: the standard has none
        net, initial, _ = pm4py.read_pnml(str(file))
    return net, initial


@pytest.mark.parametrize("number", [1, 7, 23, 42])
def test_pm4py_reads_the_same_net(pm4py: ModuleType, number: int, tmp_path: Path) -> None:
    machine = random_machine(number)
    net, initial = read_by(pm4py, machine, tmp_path)
    assert len(net.places) == len(machine.net.places)
    assert len(net.transitions) == len(machine.net.transitions)
    found = {(arc.source.name, arc.target.name, arc.weight) for arc in net.arcs}
    ids = {element: (f"p{number}") for number, element in enumerate(machine.net.places)}
    ids |= {element: (f"t{number}") for number, element in enumerate(machine.net.transitions)}
    assert found == {(ids[arc.source], ids[arc.target], arc.weight) for arc in machine.net.arcs}
    assert {place.name: count for place, count in initial.items()} == {ids[place]: count for place, count in machine.initial.items()}


class Trace(Observer):
    """The transitions that have fired."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def fired(self, fired: Fired, now: float) -> None:
        self.names.append(fired.name)


def test_pm4py_replays_ten_random_runs_of_a_machine_with_fitness_one(pm4py: ModuleType, tmp_path: Path) -> None:
    import pandas as pd

    machine = random_machine(1)
    net, initial = read_by(pm4py, machine, tmp_path)
    labels = {place.properties["place_name_tag"]: place for place in net.places}
    ends = set()
    for seed in range(10):
        random, trace = Random(seed), Trace()
        knowledge = Layered(KnowledgeBase({("powered",): True, ("free",): True}), KnowledgeBase())
        run = Run(machine, knowledge, id=RUN, asks=False, observer=trace)
        for _ in Chaos(run, knowledge, random).drive(3_000):
            pass
        final = type(initial)({labels[place]: count for place, count in run.marking.items()})
        log = pd.DataFrame({"case:concept:name": "run", "concept:name": trace.names})
        log["time:timestamp"] = pd.to_datetime(range(len(trace.names)), unit="s", utc=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pm4py.fitness_token_based_replay(log, net, initial, final)
            (broken,) = pm4py.conformance_diagnostics_token_based_replay(log.iloc[1:], net, initial, final)
        assert found["log_fitness"] == 1.0, (seed, found)
        assert not broken["trace_is_fit"]
        ends.add(tuple(trace.names))
    assert len(ends) > 1


def test_storm_reads_the_same_net_once_its_transitions_have_rates(tmp_path: Path) -> None:
    """Its PNML is that of stochastic nets: it refuses transitions of which nothing says whether and how fast they are timed."""
    machine, file = random_machine(7), tmp_path / "net.pnml"
    text = to_pnml(as_data(machine))
    file.write_text(text, encoding="utf-8")
    with pytest.raises(RuntimeError, match="Unknown transition type"):
        gspn.load_gspn_file(file)
    rated = text.replace("</transition>", "<rate><value>1.0</value></rate><timed><value>true</value></timed></transition>")
    file.write_text(rated, encoding="utf-8")
    net = gspn.load_gspn_file(file)
    assert len(net.get_places()) == len(machine.net.places)
    assert len(net.get_timed_transitions()) == len(machine.net.transitions)
    arcs = sum(len(one.get_input_places()) + len(one.get_output_places()) for one in net.get_timed_transitions())
    assert arcs == len(machine.net.arcs)
    assert sum(place.get_number_of_initial_tokens() for place in net.get_places()) == sum(machine.initial.values())
