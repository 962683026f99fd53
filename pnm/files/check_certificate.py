"""Proves a certificate of `pnm net --certificate` again, from the file alone: of this project, and of any other, it imports nothing.

`python3 check_certificate.py FILE` ends with 0 if its `PROPERTY` is proved, else with 1 and why. Each step is explored by itself; that its
inputs come follows from the order of the steps. Guards open at any moment, but reports come for live requests only.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from itertools import combinations
from pathlib import Path
from typing import Any

FORMAT, MOST = 1, 20_000  # MOST: states of one step
PROPERTY = [  # whatever the world answers, and whenever it stops the run
    "the machine comes to an end, if it is paused finitely often, and never gets stuck before",
    "it ends with one token, on the goal place or on the failed place, all others empty but counters, failure marks and free resources",
    "no other place ever holds two tokens, and places keep every ordering of the plan",
    "at the end each request has ended or was given up, after it was to be cancelled and with a failure mark if nobody asked for a stop",
    "none is sent while another of its call is alive and not given up, or before it is asked whether the run is ending",
    "the goal place is marked only by a rule that asks for the goal, after one that opens once a failure is marked",
    "not proved: that conditions, time limits, numbers of attempts, resources and recoveries are those of actions, bindings and plan",
    "not proved: that every failure is marked, that orderings are enough for what they protect, or that the plan is one for its goal",
]
KINDS = {"succeeded", "aborted", "aborted_for_good", "canceled", "rejected", "timed_out", "unavailable", "lost"}  # ends of a request
ALIVE = ("alive", "canceled", "stopped")  # states of a request; the others are "none" and "offered", by another run; ACTIONS change it
ACTIONS: dict[str | None, tuple[str, ...]] = {"SEND": ("none", "alive"), "ADOPT": ("offered", "alive"), "CANCEL": ("alive", "canceled")}
ACTIONS |= dict.fromkeys((None, "BEGIN", "FINISH", "UNDO"), ())
MOODS = {"Ending", "Failing", "CancelAsked", "PauseAsked", "Withheld", "Adopted"}  # guards that the run opens, or another one
RECORDS = {"budget", "failure mark", "resource", "restart"}


class NotProved(Exception):
    """The proof does not hold."""


def require(is_so: object, what: str) -> None:
    """Raise `NotProved` unless something is so."""
    if not is_so:
        raise NotProved(what)


def hash_of(certificate: dict[str, Any]) -> str:
    """Return the hash of everything but the hash."""
    body = {key: value for key, value in certificate.items() if key != "hash"}
    return hashlib.sha256(json.dumps(body, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


class Net:
    """The net of a certificate, by owner: a step by its number, None for the frame around all steps."""

    def __init__(self, data: dict[str, Any]) -> None:
        self.data, self.role = data, {one["name"]: one["role"] for one in data["places"]}
        self.tokens = {one["name"]: one["tokens"] for one in data["places"]}
        self.transitions = {one["name"]: one for one in data["transitions"]}
        names = [one["name"] for one in (*data["places"], *data["transitions"])]
        are_numbers = all(type(count) is int and count >= 0 for count in self.tokens.values())
        require(len({*names}) == len(names) and are_numbers, "a name is used twice, or a marking is no number of tokens")
        self.takes, self.gives = ({name: dict[str, int]() for name in self.transitions} for _ in range(2))
        for arc in data["arcs"]:
            source, target, weight = arc["source"], arc["target"], arc["weight"]
            side, place = (self.takes[target], source) if target in self.takes else (self.gives[source], target)
            is_good = type(weight) is int and (weight == 1 or (weight > 1 and self.role[place] in ("budget", "resource")))
            require(is_good and place not in side, f"an arc of weight {weight!r} from {source!r} to {target!r}")
            side[place] = weight
        self.own: dict[int | None, list[str]] = defaultdict(list)
        self.takers, self.givers = (defaultdict[str, set[int | None]](set) for _ in range(2))
        for name, transition in self.transitions.items():
            self.own[transition["call"]].append(name)
            for who, place in (*((self.takers, one) for one in self.takes[name]), *((self.givers, one) for one in self.gives[name])):
                who[place].add(transition["call"])

    def check_structure(self) -> None:
        """Check that steps touch each other only along orderings, and where one holds others; and collect those places."""
        data, steps = self.data, {one["number"]: one["name"] for one in self.data["steps"]}
        self.ports: dict[int | None, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        self.held: dict[int | None, list[dict[str, Any]]] = defaultdict(list)
        self.region_of, border = dict[int, int](), dict[str, tuple[int | None, int | None]]()
        for ordering in data["orderings"]:
            if (place := ordering["place"]) is not None:
                require(place in self.role and place not in border, f"an ordering has the place {place!r}")
                (before, moment), (after, its_moment) = ordering["before"], ordering["after"]
                border[place] = before, after
                self.ports[before]["announces" if moment == "start" else "ends"].append(place)
                self.ports[after]["starts" if its_moment == "start" else "waits"].append(place)
        for number, region in enumerate(data["regions"]):
            self.held[region["owner"]].append(region)
            require(region["first"] and region["last"], "a region has no place")
            require(region["steps"] or (region["first"] == region["last"] and len(region["first"]) == 1), "an empty region has two places")
            for step in region["steps"]:
                require(step in steps.keys() - self.region_of.keys() - {region["owner"]}, f"step {step} is in two regions or itself")
                self.region_of[step] = number
            for side, kind in (("first", "starts"), ("last", "ends")):
                for place in region[side] if region["steps"] else ():
                    (step,) = (self.takers if side == "first" else self.givers)[place]
                    require(place not in border and step in region["steps"], f"{place!r} does not connect two steps")
                    border[place] = (region["owner"], step) if side == "first" else (step, region["owner"])
                    self.ports[step][kind].append(place)
        require(self.region_of.keys() == steps.keys() == self.own.keys() - {None}, "the steps are not those of the regions, or of the net")
        sent = {steps[one["call"]] for one in data["transitions"] if one["action"] == "SEND"}
        require({one["name"] for one in data["calls"]} == sent, "the calls are not the steps that send requests")
        for place, (before, after) in border.items():
            require(self.takers[place] == {after} and before in self.givers[place] <= {before, after}, f"{place!r} is of other steps")
            back = (name for name in self.own[after] if place in self.gives[name] and before != after)
            require(all(place in self.takes[name] for name in back), f"{place!r} is marked by who waits for it")
            require(not self.role[place] or self.role[place] == "ordering", f"{place!r} has another role")
        for place in self.role.keys() - border.keys():
            role, takers = self.role[place], self.takers[place]
            require(role != "resource" or self.tokens[place], f"there is nothing of {place!r}")
            require(role != "restart" or takers <= {None}, f"{place!r} is taken from by a step")
            require(role != "failure mark" or not takers, f"{place!r} is taken from")
            require(role in ("resource", "restart") or len(takers | self.givers[place]) <= 1, f"{place!r} is touched by two steps")
        marked = [place for place, tokens in self.tokens.items() if tokens and self.role[place] not in ("budget", "resource")]
        is_one = [self.tokens[one] for one in marked] == [1] and marked[0] not in border and self.takers[marked[0]] == {None}
        require(is_one, f"marked at first: {marked}")

    def check_order(self) -> None:
        """Check that the steps of each region wait for each other without a cycle, and as the plan says."""
        events = {(step, of): {(step, "start")} if of == "end" else set[Any]() for step in self.region_of for of in ("start", "end")}
        orderings = [(tuple(one["before"]), tuple(one["after"]), one["place"]) for one in self.data["orderings"]]
        for before, after, place in orderings:
            require(before in events and after in events, f"an ordering of an unknown step: {before} < {after}")
            require(self.region_of[before[0]] == self.region_of[after[0]], f"an ordering between two regions: {before} < {after}")
            events[after] |= {before} if place is not None else set()
        earlier: dict[Any, set[Any]] = {}
        for event in TopologicalSorter(events).static_order():
            earlier[event] = events[event].union(*(earlier[one] for one in events[event]))
        for before, after, _ in orderings:
            require(before in earlier[after], f"no place keeps the ordering {before} < {after}")
        for step in self.region_of:
            require(self.ports[step]["starts"] and self.ports[step]["ends"], f"step {step} waits for nothing, or nothing for it")

    def check_rules(self) -> None:
        """Check what rules have to be asked before others."""
        goal, failed, asked = self.data["goal_place"], self.data["failed_place"], {"kind": "ConditionTrue", "condition": self.data["goal"]}
        require((self.role.get(goal), self.role.get(failed)) == ("goal", "failure"), "there is no goal place, or no failed place")
        require(not self.takers[goal] | self.takers[failed], "the goal place or the failed place is taken from")
        for owner, names in self.own.items():
            for number, name in enumerate(names):
                place = {one for one in self.takes[name] if self.role[one] not in RECORDS}
                before = [self.transitions[other] for other in names[:number] if {*self.takes[other]} <= place]
                guard, kinds = self.transitions[name]["guard"], {one["guard"]["kind"] for one in before}
                require(len(place) == 1 or (place and guard["kind"] in ("Always", "Due", *MOODS)), f"{name!r} asks at no or many places")
                if goal in self.gives[name]:
                    require(owner is None and guard == asked and "Failing" in kinds, f"{name!r} marks the goal without asking for it")
                sends = ACTIONS[self.transitions[name]["action"]] == ACTIONS["SEND"]
                require(not sends or "Ending" in kinds, f"{name!r} sends while the run is ending")

    def explore(self, owner: int | None, *, repeated: bool) -> tuple[int, set[int]]:
        """Walk through every state of a step; return their number, and which regions that it holds may be entered again."""
        names, ports = self.own[owner], self.ports[owner]
        firsts = [(region["first"], region["last"]) for region in self.held[owner]]
        around = [(name, arcs) for name in names for arcs in (self.takes[name], self.gives[name])]
        for group in (ports["starts"], ports["waits"], *(part for pair in firsts for part in pair if pair[0] != pair[1])):
            for name, arcs in around:
                require(not {*group} & arcs.keys() or all(arcs[one] == 1 for one in group), f"{name!r} takes a part of {group}")
        places = sorted({place for _, arcs in around for place in arcs})
        at = {place: number for number, place in enumerate(places)}
        asked = [number for place, number in at.items() if self.role[place] not in RECORDS]
        marks = {number for place, number in at.items() if self.role[place] in ("failure mark", "restart") and owner is not None}
        takes, gives = ({name: [(at[one], n) for one, n in side[name].items()] for name in names} for side in (self.takes, self.gives))
        exits = {number: [name for name in names if number in dict(takes[name])] for number in asked}
        resources = {at[place]: self.tokens[place] for place in places if self.role[place] == "resource"}
        starts, waits, early, ends = ([at[one] for one in ports[key]] for key in ("starts", "waits", "announces", "ends"))
        finals = [at[self.data[key]] for key in ("goal_place", "failed_place") if owner is None]
        restarts = [at[place] for place in places if owner is None and self.role[place] == "restart"]
        starts += [number for place, number in at.items() if owner is None and self.tokens[place] and number in asked]
        require(len(restarts) < 8, "more places ask for a restart than this checker looks at")
        guards = {self.transitions[name]["guard"]["kind"] for name in names}
        counters = {at[place] for place in places if self.role[place] == "budget"}
        most = sum(self.tokens[places[number]] for number in counters)
        counted = tuple([self.tokens[place] if number in counters else 0 for number, place in enumerate(places)])

        def entered(kept: tuple[int, ...]) -> Any:
            tokens = [resources.get(number, 1 if number in starts else one) for number, one in enumerate(kept)]
            return tuple(tokens), not waits, "offered" if "Adopted" in guards else "none", frozenset[int](), False

        def moved(state: Any, taken: Any, given: Any, **changed: Any) -> Any:
            tokens, supplied, life, inside, over = state
            after = [*tokens]
            for number, weight in taken:
                after[number] -= weight
            for number, weight in given:
                after[number] = 1 if number in marks else after[number] + weight
            return tuple(after), *({"supplied": supplied, "life": life, "inside": inside, "over": over} | changed).values()

        # After a failure or a stop nothing is entered again; nor after the run is ending, unless that is so for the plan to begin anew.
        for_good = {"Failing"} if "restart" in self.role.values() else {"Failing", "Ending"}
        roots, seen, again, edges = [entered(counted)], set[Any](), set[int](), dict[Any, set[Any]]()
        while roots:
            if (state := roots.pop()) in seen:
                continue
            seen.add(state)
            require(len(seen) <= MOST, f"step {owner} has more than {MOST} states")
            tokens, supplied, life, inside, over = state
            full = [place for place, number in at.items() if tokens[number] > resources.get(number, most if number in counters else 1)]
            require(not full, f"{full[:1]} may hold more tokens than it should")
            onward, possible, lacking = edges.setdefault(state, set()), dict[str, None](), False
            outside = [moved(state, (), [(one, 1) for one in waits], supplied=True)] if not supplied else []
            busy = [number for number in asked if tokens[number] and number not in (*early, *ends, *finals)]
            for number, (first, last) in enumerate(firsts):
                if first != last and all(tokens[at[one]] for one in first):
                    again |= {number} & inside
                    done = moved(state, [(at[one], 1) for one in first], [(at[one], 1) for one in last], inside=inside | {number})
                    asking = (some for size in range(len(restarts) + 1) for some in combinations(restarts, size))
                    outside += [moved(done, (), [(one, 1) for one in some]) for some in asking]
            for number in asked:
                here = list[dict[str, Any]]()
                for name in exits[number] if tokens[number] else ():
                    lacks = {one for one, weight in takes[name] if tokens[one] < weight}
                    guard = self.transitions[name]["guard"]
                    if lacks and lacks <= resources.keys():
                        lacking = True
                        break
                    if not lacks and life in {"Ends": ALIVE, "Accepts": ALIVE, "Adopted": ("offered",)}.get(guard["kind"], (life,)):
                        possible[name] = None
                        here.append(guard)
                        if guard["kind"] in ("Always", "Adopted"):
                            break
                else:
                    wrong = unanswered(here) if here else ""
                    require(not wrong or (wrong == "waits" and outside), f"{places[number]!r} {wrong}: no exit is sure to open")
            waiting = lacking or not possible or len(outside) > (not supplied)
            require(not waiting or all(tokens[one] >= full for one, full in resources.items()), f"step {owner} waits and keeps resources")
            kinds = {self.transitions[name]["guard"]["kind"] for name in possible}
            require(not lacking or "Withheld" in kinds, "resources never come")
            require(life not in ALIVE or "Ends" in kinds, f"step {owner} takes no report although its request is alive")
            require(not (busy or life in ALIVE) or not any(tokens[one] for one in (*ends, *finals)), f"step {owner} goes on and is left")
            if not possible and not outside:
                left = {number: count for number, count in enumerate(tokens) if number in asked and count}
                wanted = (*early, *ends, *[one for one in finals if tokens[one]][:1])
                require(left == dict.fromkeys(wanted, 1) and left, f"step {owner} stops with {[places[one] for one in left]}")
                require(life not in ALIVE, f"step {owner} ends while a request is alive")
                if repeated and not over:  # again, with counters as they are
                    roots.append(entered(tuple([one if number in counters else 0 for number, one in enumerate(tokens)])))
            require(possible or supplied or outside[1:] or all(tokens[one] for one in early), f"step {owner} announces its start too late")
            for name in possible:
                about, marks_it = self.transitions[name], any(self.role[one] == "failure mark" for one in self.gives[name])
                kind, given_up, (before, then) = about["guard"]["kind"], about["gives_up"], ACTIONS[about["action"]] or (life, life)
                require(life == before and (life in ALIVE or not (given_up or kind == "Ends")), f"{name!r}: its request is {life}")
                may_give_up = kind == "After" and (life == "stopped" or (life == "canceled" and marks_it))
                require(may_give_up or not given_up, f"{name!r} gives up a request that is {life}, or marks no failure")
                then = "stopped" if then == "canceled" and (marks_it or kind == "CancelAsked") else then
                then = "none" if given_up or kind == "Ends" else then
                after = moved(state, takes[name], gives[name], life=then, over=repeated and (over or marks_it or kind in for_good))
                roots.append(after)
                onward |= {after} if kind != "PauseAsked" else set()
            roots += outside
            onward |= {*outside}
        TopologicalSorter(edges).prepare()
        return len(seen), again


def unanswered(guards: list[dict[str, Any]]) -> str:
    """Return for which answer of the world none of the guards at a place opens; empty if one always does."""
    kinds = {guard["kind"] for guard in guards}
    if "Always" in kinds or kinds <= MOODS:
        return "" if "Always" in kinds else "waits"
    if "Ends" in kinds:
        lost = KINDS.difference(*(guard["kinds"] for guard in guards if guard["kind"] == "Ends"))
        return f"takes no report that a request has {'/'.join(sorted(lost))}" if lost else ""
    conditions = {name: {guard["condition"] for guard in guards if guard["kind"] == name} for name in ("ConditionTrue", "ConditionFalse")}
    is_timed = any(guard["kind"] in ("After", "Late", "Due") and guard["seconds"] < float("inf") for guard in guards)
    is_either = conditions["ConditionTrue"] & conditions["ConditionFalse"] or {"EffectsSeen", "EffectsMissing"} <= kinds
    return "" if is_timed or is_either else "waits for the world"


def check(text: str) -> str:
    """Prove a certificate again and return what was proved; raise `NotProved`."""
    try:
        data = json.loads(text)
        require(isinstance(data, dict) and (data["format"], data["property"]) == (FORMAT, PROPERTY), "its format or property is another")
        require(hash_of(data) == data["hash"] and json.dumps(data, indent=1) + "\n" == text, "the file was changed: its hash is another")
        net = Net(data)
        for part in (net.check_structure, net.check_order, net.check_rules):
            part()
        states, waiting = 0, [(None, "restart" in net.role.values())]  # each step is in one region, so it comes once
        for owner, repeated in waiting:
            count, again = net.explore(owner, repeated=repeated and owner is not None)
            states += count
            waiting += [(step, repeated or number in again) for number, region in enumerate(net.held[owner]) for step in region["steps"]]
        require({owner for owner, _ in waiting} == {None, *net.region_of}, "there are steps that nothing ever enters")
    except CycleError as error:
        raise NotProved(f"it may go round for ever, or steps wait for each other: {str(error.args[1][0])[:80]}") from None
    except (KeyError, TypeError, AttributeError, IndexError, ValueError, RecursionError) as error:
        raise NotProved(f"not of the form of a certificate: {error!r}") from None
    return f"proved again: {len(data['steps'])} steps, {len(net.role)} places, {len(net.transitions)} transitions, {states} states explored"


if __name__ == "__main__":
    path = sys.argv[1] if len(sys.argv) == 2 else sys.exit("usage: python3 check_certificate.py FILE")
    try:
        sys.stdout.write(check(Path(path).read_bytes().decode()) + "\n")
    except (NotProved, OSError, UnicodeDecodeError) as error:
        sys.exit(f"not proved: {error}")
