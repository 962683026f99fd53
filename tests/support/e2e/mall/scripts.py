"""Scripts by number: what a visitor asks for, when she interrupts, and how she answers. The same number is the same script."""

from __future__ import annotations

import json
import random
from collections.abc import Iterable
from typing import Any, Final

Script = dict[str, Any]

SHOPS: Final = ("shop_0", "shop_1", "shop_2", "shop_3")
TOPICS: Final = ("films", "books", "music", "football")
VISITORS: Final = ("ann", "bob")
"""They take turns: whoever comes, the others are forgotten."""
MOMENTS: Final = {
    "shop": ("", "look_up", "point_at", "describe_route", "ask_understood", "question", "hear_answer"),
    "topic": ("", "say", "question"),
}
"""What of a request the next one may follow; nothing is as soon as it is sent."""
GUIDED: Final = ((), (), ("late",), ("no",), ("no", "late"), ("silent",), ("silent", "late"))
"""How questions about the way are answered. A robot that fails twice at the same does not try that again, so once is enough."""
CHAT: Final = ("now", "now", "late", "silent")
LATE: Final = 0.2
"""Seconds after which a late answer comes, whatever the robot talks about."""
PATIENCE: Final = 1.0
"""Seconds after which a visitor does not wait for the moment to interrupt any more."""


def script(number: int) -> Script:
    """Return a script."""
    chance = random.Random(number)
    shops, topics = chance.sample(SHOPS, len(SHOPS)), chance.sample(TOPICS, len(TOPICS))
    wishes = [_guide(chance, shops.pop())]
    for _ in range(chance.choice((0, 1, 1, 2, 2, 3))):
        moment = chance.choice(MOMENTS["shop" if "shop" in wishes[-1] else "topic"])
        wish = _guide(chance, shops.pop()) if chance.random() < 0.6 else _talk(chance, topics.pop())
        wishes.append({**wish, "on": moment, "after": round(chance.uniform(0.0, 0.08), 3)})
    return {"name": str(number), "visitor": VISITORS[number % len(VISITORS)], "requests": wishes}


def file_of(numbers: Iterable[int]) -> str:
    """Return the text of a file for `visitor.py`."""
    return json.dumps({"late": LATE, "patience": PATIENCE, "scripts": [script(number) for number in numbers]}, indent=1)


def _guide(chance: random.Random, shop: str) -> Script:
    return {"shop": shop, "replies": list(chance.choice(GUIDED))}


def _talk(chance: random.Random, topic: str) -> Script:
    turns = chance.randint(1, 3)
    return {"topic": topic, "turns": turns, "replies": [chance.choice(CHAT) for _ in range(turns)]}
