"""Guards, the kinds of questions that δ̂ asks besides the tokens, each with its traits; and rules, which say what δ̂ is for a transition.

A new kind needs a class here, in the union `Guard`; when it opens and how a check by it is explained, in
`pnm.core.execution.guards` and in the reference; and a block that asks it. All others, the proof included, ask for the traits.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import isfinite
from typing import TYPE_CHECKING, ClassVar, Final, NamedTuple, TypeAlias

from pnm.core.logic.conditions import Condition
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.requests import CallOutcome, OutcomeKind, TransitionAction

if TYPE_CHECKING:
    from typing import Protocol as _Traits  # so that no kind without all traits can be made, says the type checker
else:
    _Traits = object  # protocols look into an object when it is asked which class it has, which takes too long for the proof


class Opener(Enum):
    """Opener of a guard: what has to come for it to open."""

    TOKENS = "tokens alone"
    ENDING = "the end of the run, a stop or a pause"
    KNOWLEDGE = "knowledge, which may also close it again"
    RESOURCES = "other runs, which keep resources"
    REPORT = "a report about the request of the call, and nothing else"
    HANDOVER = "another run, which has sent the request of the call"
    TIME = "time"


class KnowledgeRead(Enum):
    """Reading of a guard: what of the knowledge it looks at."""

    NOTHING = "nothing"
    CONDITION = "what its condition is about"
    EFFECTS = "what the effects of its call are about"
    ANYTHING = "anything"


class Moods(NamedTuple):
    """Moods of a run, which open guards besides tokens and the world: it is failing, ending, or to cancel what is under way."""

    failing: bool = False
    ending: bool = False
    cancels: bool = False


class GuardKind(_Traits):
    """A kind of guard. What has no default here, every kind has to say."""

    __slots__ = ()

    opened_by: ClassVar[Opener]
    reads: ClassVar[KnowledgeRead]
    is_check: ClassVar[bool]
    """It compares a condition, data, time or resources with what is known: that it opens is a cause of failure by itself."""

    def about(self, call: int, /) -> Guard:
        """Return the same guard about another call, or itself if it is about none."""
        return self  # type: ignore[return-value]

    @property
    def asks(self) -> Condition | None:
        """The condition whose truth decides, if there is one."""
        return None

    @property
    def proved(self) -> object:
        """Its relevance for the proof besides its condition and its call: guards with the same open alike."""
        return self

    @property
    def complement(self) -> Guard | None:
        """The guard of which it is the complement: in finite time one of the two is open, whatever the world is like."""
        return None

    @property
    def is_sure(self) -> bool:
        """Whether it opens by itself, in finite time."""
        return False

    @property
    def closed_for(self) -> str:
        """The state of the world for which it stays closed, in words; empty if that is not told."""
        return ""

    @property
    def goes_well(self) -> bool:
        """Whether it opens when all goes well: pictures have such transitions in the first row."""
        return False

    def open_in(self, moods: Moods) -> bool | None:
        """Return whether it is open, closed, or either, depending on the world."""
        return None


@dataclass(frozen=True, slots=True)
class OfCall(GuardKind):
    """A guard about the call that it belongs to: of that, its traits say nothing more."""

    call: int
    is_check: ClassVar[bool] = False

    def about(self, call: int, /) -> Guard:
        return type(self)(call)  # type: ignore[return-value]  # a kind with more fields has its own method

    @property
    def proved(self) -> object:
        return type(self)


@dataclass(frozen=True, slots=True)
class Always(GuardKind):
    """Open at once."""

    opened_by = Opener.TOKENS
    reads = KnowledgeRead.NOTHING
    is_check = False
    goes_well = True

    def open_in(self, moods: Moods) -> bool | None:
        return True


# --- the run ----------------------------------------------------------------------------------


class _OfRun(GuardKind):
    """A guard that a run opens when it is ending, stopped or paused."""

    __slots__ = ()
    opened_by = Opener.ENDING
    reads = KnowledgeRead.NOTHING
    is_check = False


@dataclass(frozen=True, slots=True)
class Ending(_OfRun):
    """Open when nothing more is started: a failure place or a restart place is marked, or the run was stopped."""

    def open_in(self, moods: Moods) -> bool | None:
        return moods.ending


@dataclass(frozen=True, slots=True)
class Failing(_OfRun):
    """Open when the run can no longer succeed: a failure place is marked, or it was stopped."""

    def open_in(self, moods: Moods) -> bool | None:
        return moods.failing


@dataclass(frozen=True, slots=True)
class CancelAsked(_OfRun):
    """Open when running calls shall be cancelled: it was stopped so, or is ending under policy `CANCEL`."""

    def open_in(self, moods: Moods) -> bool | None:
        return moods.cancels


@dataclass(frozen=True, slots=True)
class PauseAsked(_OfRun):
    """Open when the run was paused at once: running calls shall be cancelled, to begin anew later."""


# --- knowledge --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _OfCondition(GuardKind):
    """A guard that the truth of a condition opens."""

    condition: Condition
    opened_by = Opener.KNOWLEDGE
    reads = KnowledgeRead.CONDITION
    is_check = True

    @property
    def asks(self) -> Condition | None:
        return self.condition

    @property
    def proved(self) -> object:
        return type(self)


@dataclass(frozen=True, slots=True)
class ConditionTrue(_OfCondition):
    """Open when the condition is true."""

    goes_well = True

    @property
    def closed_for(self) -> str:
        return f"{self.condition} does not hold"


@dataclass(frozen=True, slots=True)
class ConditionFalse(_OfCondition):
    """Open when the condition has not been true for as long as reports about it may be late."""

    @property
    def complement(self) -> Guard | None:
        return ConditionTrue(self.condition)

    @property
    def closed_for(self) -> str:
        return f"{self.condition} holds"


@dataclass(frozen=True, slots=True)
class ConditionUnknown(_OfCondition):
    """Open when that is so and the condition is unknown: it cannot be computed, or nothing reports what it is about."""


@dataclass(frozen=True, slots=True)
class InvariantFalse(_OfCondition):
    """Open when the over-all condition of a call under way is reported false; only what may not be reported yet gets the time for that."""


@dataclass(frozen=True, slots=True)
class AlreadyTrue(OfCall):
    """Open when all that the call would change is a plain fact and is so already."""

    opened_by = Opener.KNOWLEDGE
    reads = KnowledgeRead.ANYTHING


@dataclass(frozen=True, slots=True)
class DataMissing(OfCall):
    """Open when a goal field has no value."""

    opened_by = Opener.KNOWLEDGE
    reads = KnowledgeRead.ANYTHING
    is_check = True


@dataclass(frozen=True, slots=True)
class EffectsSeen(OfCall):
    """Open when every sensed effect of the call is reported and its end condition held."""

    opened_by = Opener.KNOWLEDGE
    reads = KnowledgeRead.EFFECTS
    goes_well = True
    closed_for = "the effects are not seen"


@dataclass(frozen=True, slots=True)
class EffectsMissing(OfCall):
    """Open when that has not been so for as long as the reports may be late."""

    opened_by = Opener.KNOWLEDGE
    reads = KnowledgeRead.EFFECTS

    @property
    def complement(self) -> Guard | None:
        return EffectsSeen(self.call)


@dataclass(frozen=True, slots=True)
class Withheld(OfCall):
    """Open when the call has waited `seconds` for withheld resources, those of abandoned requests that may still go on."""

    seconds: float
    action: TransitionAction | None
    """Action of the transition that waits: a request to be sent may need other resources than one that goes on."""
    opened_by = Opener.RESOURCES
    reads = KnowledgeRead.ANYTHING
    is_check = True

    def about(self, call: int, /) -> Guard:
        return Withheld(call, self.seconds, self.action)

    @property
    def proved(self) -> object:
        return Withheld, isfinite(self.seconds)


# --- requests ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Adopted(OfCall):
    """Open when another run has sent the call's request, which is under way, and this run has not taken it over yet."""

    opened_by = Opener.HANDOVER
    reads = KnowledgeRead.NOTHING


@dataclass(frozen=True, slots=True)
class Accepts(OfCall):
    """Opened by the report that the call's request was accepted."""

    opened_by = Opener.REPORT
    reads = KnowledgeRead.NOTHING
    goes_well = True


@dataclass(frozen=True, slots=True)
class Ends(OfCall):
    """Opened by the report that the call's request ended in one of these ways."""

    kinds: frozenset[OutcomeKind]
    opened_by = Opener.REPORT
    reads = KnowledgeRead.NOTHING

    def about(self, call: int, /) -> Guard:
        return Ends(call, self.kinds)

    @property
    def proved(self) -> object:
        return Ends, self.kinds

    @property
    def goes_well(self) -> bool:
        return OutcomeKind.SUCCEEDED in self.kinds


# --- time -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _OfTime(GuardKind):
    """A guard that opens by itself, unless one of its limits is infinite."""

    seconds: float
    opened_by = Opener.TIME
    reads = KnowledgeRead.NOTHING

    @property
    def proved(self) -> object:
        return type(self), self.is_sure

    @property
    def is_sure(self) -> bool:
        return isfinite(self.seconds)


@dataclass(frozen=True, slots=True)
class After(_OfTime):
    """Open when the token has been in the place for `seconds`."""

    is_check = False


@dataclass(frozen=True, slots=True)
class Late(_OfTime):
    """Open when the token has been in the place for `seconds`, pauses apart; it tells why `awaited`, asked before it, has not been true."""

    awaited: Condition
    is_check = True


@dataclass(frozen=True, slots=True)
class Due(_OfTime):
    """Open `seconds` after the origin of the run, the moment it was planned from."""

    since: tuple[tuple[str, float], ...] = ()
    """And for each of these places, its seconds after the place was marked."""
    is_check = True

    @property
    def is_sure(self) -> bool:
        return all(map(isfinite, (self.seconds, *(delay for _, delay in self.since))))


Guard: TypeAlias = (
    Always
    | Ending
    | Failing
    | CancelAsked
    | PauseAsked
    | ConditionTrue
    | ConditionFalse
    | ConditionUnknown
    | InvariantFalse
    | AlreadyTrue
    | DataMissing
    | EffectsSeen
    | EffectsMissing
    | Withheld
    | Adopted
    | Accepts
    | Ends
    | After
    | Late
    | Due
)


# --- rules --------------------------------------------------------------------------------------

_ALWAYS: Final = Always()


class Rule(NamedTuple):
    """δ̂ for one transition: its guard, and what its firing means for its call. Nothing else is known by its name."""

    name: str
    """The event for people and exports, such as ``start`` or ``aborted``; the same for every call."""
    guard: Guard = _ALWAYS
    call: int | None = None
    """The number of the step it belongs to, which most often is a call; None for the frame around all steps."""
    action: TransitionAction | None = None
    outcome: CallOutcome | None = None
    """The outcome of the call from now on; None when that stays as it is."""
    cause: Cause | None = None
    """Why the step is about to recover or has failed; None when no new cause arises."""
    expected: str = ""
    """The expectation at that point, for the text of a failure; empty where the guard explains it."""
    observed: str = ""
    """The observation instead; ``{message}`` stands for the message of the request's end, which is all if this is empty."""
    gives_up: bool = False
    """The request is no longer waited for, although its server may still be at work."""
    replans: bool = False
    """The plan asks for a planner to find another way."""
    restarts: bool = False
    """The whole plan begins anew."""


def check_rule(cause: Cause, guard: Guard = _ALWAYS, action: TransitionAction | None = None) -> Rule:
    """Return the rule of a check, which goes by the name of the cause that it finds."""
    return Rule(cause.value, guard, action=action, cause=cause)
