"""Forecasts of runs beside what came of them: how right their chances are, and their times."""

from __future__ import annotations

from collections import defaultdict
from math import sqrt
from random import Random
from typing import NamedTuple

from planner_bridge.pipeline.odds import Odds
from planner_bridge.tasks.result import TaskResult


class Forecast(NamedTuple):
    """A forecast, and what came of it."""

    world: str
    chance: float
    reached: bool
    seconds: float | None
    """The share of the forecast times below that of the run, some by chance of those that equal it; None if it did not reach the goal."""

    @staticmethod
    def of(world: str, odds: Odds, result: TaskResult, random: Random) -> Forecast:
        """Return the forecast that odds have made, beside what came of it.

        The time of the run counts as one more of those that equal it: its place among few forecast times would not be even.
        """
        took = max((call.ended - result.began for call in result.calls if call.ended is not None), default=0.0)
        below, equal = 0.0, 1.0
        for time in odds.times:
            below += time < 0.98 * took  # learned seconds are within 1 % of what was measured
            equal += 0.98 * took <= time <= 1.02 * took
        share = (below + random.random() * equal) / (len(odds.times) + 1) if odds.times and result.goal_reached else None
        return Forecast(world, odds.chance, result.goal_reached, share)


def summary(forecasts: list[Forecast]) -> str:
    """Return the Brier score, the tenths and the times of forecasts."""
    tenths: dict[int, list[Forecast]] = defaultdict(list)
    for one in forecasts:
        tenths[min(9, int(10 * one.chance))].append(one)
    brier = sum((one.chance - one.reached) ** 2 for one in forecasts) / len(forecasts)
    perfect = sum(one.chance * (1.0 - one.chance) for one in forecasts) / len(forecasts)
    lines = [f"{len(forecasts)} runs: Brier score {brier:.4f}, {perfect:.4f} if all chances are right"]
    for tenth, ones in sorted(tenths.items()):
        meant, seen = (sum(values) / len(ones) for values in ([one.chance for one in ones], [one.reached for one in ones]))
        by_luck = sqrt(sum(one.chance * (1.0 - one.chance) for one in ones)) / len(ones)
        lines.append(
            f"{tenth * 10:3} to {tenth * 10 + 10:3} %: {len(ones):4} runs, {meant:.3f} forecast, {seen:.3f} reached, ±{by_luck:.3f} by luck"
        )
    below = sorted(one.seconds for one in forecasts if one.seconds is not None)
    shares = [sum(share <= bound for share in below) / max(1, len(below)) for bound in (0.5, 0.9)]
    error = sum(abs(sum(share <= bound / 10 for share in below) / max(1, len(below)) - bound / 10) for bound in range(1, 10)) / 9
    lines.append(f"times: {shares[0]:.2f} within the median, {shares[1]:.2f} within the time of 90 %, of {len(below)}; error {error:.3f}")
    return "\n".join(lines)
