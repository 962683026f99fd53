"""A world of plans in files, and the global knowledge that its actions use."""

from __future__ import annotations

import asyncio
from pathlib import Path
from uuid import UUID

from pnm.core.logic.computed_values import Layer, Question
from pnm.knowledge.source import Asker
from pnm.knowledge.sources import DatabaseKnowledge

DOMAIN = """
actions:
  wait: {params: [time], timeout: 600}
  broken: {params: [value]}
  dummy_server: {type: rpn_action, params: [value], store: {time: result}, effects: {and: {Exists: [LocalQuery: result]}}}
  add_one: {params: [value], store: {time: result}, preconditions: {and: [Exists: [LocalQuery: value]]}}
  remember: {type: rpn_action, params: [value]}
  alarm: {type: rpn_action, params: [value]}
  watched_wait: {params: [time], server: wait, preconditions: {over_all: {not: {Exists: [LocalQuery: alarm]}}}, timeout: 600}
  know: {type: kb_action, params: [operation]}
"""


PLANS = """
count:
  initial_knowledge: {value: 5}
  results: [value, result]
  plan:
    - dummy_server: {}
    - while:
        condition: {Comparison: [ne, [LocalQuery: value, 10]]}
        actions:
          - add_one: {}
          - know: {operation: {LocalUpdate: [value, {LocalQuery: result}]}}
empty:
  plan: []
forks:
  plan:
    - concurrent_actions:
        - broken: {value: 2}
        - wait: {time: 0.25}
        - [wait: {time: 0.5}, wait: {time: 78}]
waits:
  params: [time]
  initial_knowledge: {time: 59}
  plan:
    - wait: {}
goes_on:
  plan:
    - wait: {time: 3001}
    - add_one: {value: 41}
  initial_knowledge: {value: 0}
  results: [result]
knows:
  params: [value]
  results: [spam, eggs, time]
  plan:
    - remember: {}
    - know: {operation: {LocalUpdate: [eggs, {RemoteQuery: eggs}]}}
    - wait: {time: {LocalQuery: spam}}
asks_what_is_shared:
  results: [eggs]
  plan:
    - know: {operation: {LocalUpdate: [eggs, {RemoteQuery: eggs}]}}
alarmed:
  on_failure: cancel
  plan:
    - concurrent_actions:
        - watched_wait: {time: 3002}
        - alarm: {value: 1}
calls:
  params: [shop]
  results: [told]
  plan:
    - called: {place: {LocalQuery: shop}, time: 3003}
called:
  params: [place, time]
  results: [told]
  plan:
    - know: {operation: {LocalUpdate: [told, {LocalQuery: place}]}}
    - wait: {}
"""


def shared(file: Path, name: str) -> object:
    """Return a variable of the global knowledge in a file."""

    async def look() -> object:
        source = DatabaseKnowledge(file)
        found = await source.query(Question(name, Layer.GLOBAL, "null"), Asker(UUID(int=0)))
        await source.close()
        return found

    return asyncio.run(look())


WORLD = "domain: domain.yaml\nplans: [plans.yaml]\n"


FILES = {"domain.yaml": DOMAIN, "plans.yaml": PLANS, "world.yaml": WORLD}
