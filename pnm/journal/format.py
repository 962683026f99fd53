"""The format of a journal: which values its records are made of."""

from __future__ import annotations

from typing import Final

from pnm import clock, errors, tasks
from pnm.core import message_fields
from pnm.core.execution import call_data, call_results, events, handover
from pnm.core.logic import computed_values, conditions, effects, expressions, rules
from pnm.core.machine import bindings, failure_causes, machine, plan_graph, requests
from pnm.journal import records
from pnm.journal.codec import Codec, value_classes

RECORDS: Final = Codec(
    value_classes(
        *(clock, errors, message_fields, computed_values, conditions, effects, expressions, rules),
        *(bindings, failure_causes, machine, plan_graph, requests, call_data, call_results, events, handover, tasks, records),
    )
)
"""The codec of what reaches runs, and of what they are made from."""
