"""What follows from a domain alone, found once for each: robots wait for a new plan, and the domain is still that of the last one."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, Final, ParamSpec, TypeVar
from weakref import ref

from planner_bridge.model.problem import Domain

P = ParamSpec("P")
T = TypeVar("T")

_KEPT: Final = 2_000
"""Answers about one domain, at most; then all are found anew."""


def once_per_domain(find: Callable[Concatenate[Domain, P], T]) -> Callable[Concatenate[Domain, P], T]:
    """Return a function that keeps its answers for as long as the domain is in use; domains are told apart by identity.

    The other arguments are positional and hashable. An answer that has a reference to its domain would keep both for good.
    """
    kept: dict[int, tuple[ref[Domain], dict[object, T]]] = {}

    @wraps(find)
    def once(domain: Domain, /, *args: P.args, **kwargs: P.kwargs) -> T:
        number = id(domain)
        if number not in kept:
            kept[number] = ref(domain, lambda _: kept.pop(number, None)), {}
        answers = kept[number][1]
        try:
            return answers[args]
        except KeyError:
            if len(answers) >= _KEPT:
                answers.clear()
        answer = answers[args] = find(domain, *args, **kwargs)
        return answer

    return once
