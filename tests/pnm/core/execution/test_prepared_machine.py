"""A machine that is prepared: nothing of its calls is worked out between firings, as long as all goes well."""

from __future__ import annotations

from random import Random
from uuid import UUID

import pytest

from pnm.core.execution.machine_index import index_of, prepare
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from tests.support.benchmarks.workloads import checked, inline
from tests.support.runs.mutation.machines import random_plan, written_out


def test_nothing_of_its_calls_is_worked_out_while_it_is_executed() -> None:
    plan, known = checked(5)
    machine = generate(plan)
    prepare(machine)
    index = index_of(machine)
    made = [dict(index.closed), dict(index.limits), dict(index.conditions)]
    inline(Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1)))
    *calls, conditions = [dict(index.closed), dict(index.limits), dict(index.conditions)]
    assert calls == made[:2]
    assert len(calls[0]) == len(calls[1]) == len(made[2]) == 5
    assert len(conditions) == 6, "only the goal is asked for besides"


def test_a_machine_without_templates_is_prepared_as_well() -> None:
    plan, known = checked(2)
    machine = written_out(generate(plan))
    prepare(machine)
    inline(Run(machine, Layered(KnowledgeBase(known)), id=UUID(int=1)))


@pytest.mark.parametrize("number", range(40))
def test_any_machine_can_be_prepared(number: int) -> None:
    prepare(generate(random_plan(Random(number))))
