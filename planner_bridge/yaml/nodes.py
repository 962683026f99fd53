"""From YAML to the lists of words that PDDL has, as if they stood in the YAML file: every part knows where it does.

So what the file says is checked and understood by the readers of PDDL, with their errors.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final

from planner_bridge.pddl.syntax.expressions import Atom, Group, Source, parse_part
from planner_bridge.pddl.syntax.expressions import Node as Part
from pnm.errors import InputError
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.scope import shown
from pnm.language.formulas.values import comparison_parts, operation_parts
from pnm.language.formulas.words import ARITHMETIC, COMPARISONS, TESTS, Form, form, needed_form

_SYMBOLS: Final = {**COMPARISONS, **ARITHMETIC, **{symbol: symbol for symbol in (*COMPARISONS.values(), *ARITHMETIC.values())}}
_CHANGES: Final = {word.replace("-", mark): word for word in ("assign", "increase", "decrease", "scale-up", "scale-down") for mark in "-_"}
_EFFECTS: Final = ("and", "not", "holds", "when", "forall", *_CHANGES)
_MOMENTS: Final = {"at_start": ("at", "start"), "over_all": ("over", "all"), "at_end": ("at", "end")}
_BOUNDS: Final = ("=", "<=", ">=")


@dataclass(frozen=True)
class Parts:
    """Makes parts of PDDL from those of a YAML file."""

    source: Source

    # --- words and lists ---

    def offset(self, node: Node) -> int:
        """Return where the node begins."""
        return int(node.raw.start_mark.index)

    def atom(self, text: str, offset: int) -> Atom:
        """Return a word that stands for something there."""
        return Atom(text, offset, self.source)

    def group(self, items: Iterable[Part], offset: int) -> Group:
        """Return a list that stands for something there."""
        return Group(tuple(items), offset, self.source)

    def headed(self, word: str, items: Iterable[Part], offset: int) -> Group:
        """Return a list that begins with a word, or with several."""
        return self.group((*(self.atom(one, offset) for one in word.split()), *items), offset)

    def text(self, node: Node) -> tuple[Part, ...]:
        """Read a scalar as PDDL's text.

        Raises:
            InputError: it is a list, a mapping or nothing, or no such text.
        """
        if node.is_mapping or node.items is not None or node.is_null:
            raise node.wrong(f"expected a text, found {shown(node)}")
        start, end = self.offset(node), int(node.raw.end_mark.index)
        written = node.written
        found = self.source.text.find(written, start, end)
        return parse_part(written, self.source, found if found >= 0 else None, start)

    def one(self, node: Node, what: str) -> Part:
        """Read a scalar that is one word or one list."""
        if node.is_mapping or node.items is not None or node.is_null:
            raise node.wrong(f"expected {what}, found {shown(node)}")
        found = self.text(node)
        if len(found) != 1:
            raise node.wrong(f"expected {what}, found {shown(node)}")
        return found[0]

    def fact(self, node: Node, what: str = "something like (at ?r kitchen)") -> Group:
        """Read a scalar that is one list."""
        found = self.one(node, what)
        if not isinstance(found, Group):
            raise node.wrong(f"expected {what}, found {shown(node)}")
        return found

    def texts(self, node: Node | None, kind: str = "object") -> tuple[Part, ...]:
        """Read a text, or a list of texts, as the words of all.

        Args:
            node: the text or the list.
            kind: what names of a text are if it does not say; in PDDL, the next type would be theirs.
        """
        if node is None or node.is_null:
            return ()
        if node.items is None:
            return self.text(node)
        texts = [self.text(item) for item in node.items if not item.is_null]
        last = max((number for number, words in enumerate(texts) if _is_typed(words)), default=0)
        untyped = [number < last and bool(words) and not _is_typed(words[-2:]) for number, words in enumerate(texts)]
        kinds = [self._kind(words[-1].offset, kind) if missing else () for words, missing in zip(texts, untyped, strict=True)]
        return tuple([part for words, own in zip(texts, kinds, strict=True) for part in (*words, *own)])

    def _kind(self, offset: int, kind: str) -> tuple[Part, Part]:
        return self.atom("-", offset), self.atom(kind, offset)

    # --- conditions ---

    def condition(self, node: Node) -> Part:
        """Read a condition: a text, a form, or a list of conditions that must all hold."""
        if node.items is not None:
            return self.headed("and", map(self.condition, node.items), self.offset(node))
        if not node.is_mapping:
            return self.fact(node, "a condition such as (at ?r kitchen)")
        return self._compound(self.pddl_form(node, TESTS, "a condition"), self.offset(node))

    def pddl_form(self, node: Node, words: Iterable[str], what: str) -> Form:
        """Take apart a form."""
        return needed_form(node, tuple(words), what)

    def _compound(self, found: Form, offset: int) -> Part:
        match found.word:
            case "and" | "or" as word:
                return self.headed(word, map(self.condition, found.operands()), offset)
            case "not":
                return self.headed("not", map(self.condition, found.items(1)), offset)
            case "imply":
                return self.headed("imply", map(self.condition, found.items(2)), offset)
            case "holds":
                return self.fact(found.items(1)[0])
            case "comparison":
                operator, left, right = comparison_parts(found)
                return self._comparison(operator, left, right, offset)
            case "forall" | "exists" as word if found.argument.is_mapping and "variables" in found.argument.mapped().nodes:
                variables, body = self.quantified(found, "condition")
                return self.headed(word, (variables, self.condition(body)), offset)
            case _:
                raise InputError(f"PDDL has no {found.written!r}: it knows facts and functions, not variables", found.position)

    def _comparison(self, operator: Node, left: Node, right: Node, offset: int) -> Group:
        word = self._symbol(operator, (*COMPARISONS.values(),), "compare")
        compared = self.headed("=" if word == "!=" else word, map(self.expression, (left, right)), offset)
        return self.headed("not", (compared,), offset) if word == "!=" else compared

    def _symbol(self, operator: Node, known: Collection[str], verb: str) -> str:
        symbol = _SYMBOLS.get(operator.written, "")
        if symbol not in known:
            near = get_close_matches(operator.written, [name for name, one in _SYMBOLS.items() if one in known], 1)
            hint = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
            raise operator.wrong(f"PDDL does not {verb} with {shown(operator)}; {hint}")
        return symbol

    def quantified(self, found: Form, key: str) -> tuple[Group, Node]:
        """Return the variables of a quantifier, and what they are bound in."""
        entry = found.argument.mapped()
        entry.only("variables", key)
        variables = entry.needed("variables")
        return self.group(self.texts(variables), self.offset(variables)), entry.needed(key)

    # --- expressions ---

    def expression(self, node: Node) -> Part:
        """Read an expression."""
        found = form(node, ("value", "operation"))
        if found is None:
            return self.one(node, "a number, a name or something like (battery ?r)")
        if found.word == "value":
            return self.fact(found.items(1)[0])
        operator, operands = operation_parts(found)
        return self.headed(self._symbol(operator, (*ARITHMETIC.values(),), "calculate"), map(self.expression, operands), self.offset(node))

    # --- effects ---

    def effects(self, node: Node, moment: str = "") -> Group:
        """Read effects, those of a durative action at a moment."""
        items = (node,) if node.items is None else node.items
        parts = [self._effect(item, moment) for item in items]
        whole = self.headed("and", parts, self.offset(node))
        return whole if parts or not moment else self.headed(moment, (whole,), self.offset(node))

    def _effect(self, node: Node, moment: str) -> Part:
        offset = self.offset(node)
        if moment and not _is_early(node):
            return self.headed(moment, (self._effect(node, ""),), offset)
        if not node.is_mapping:
            return self.fact(node, "an effect such as (at ?r kitchen)")
        found = self.pddl_form(node, _EFFECTS, "an effect")
        match found.word:
            case "and":
                return self.headed("and", (self._effect(item, moment) for item in found.operands()), offset)
            case "holds":
                return self.fact(found.items(1)[0])
            case "not":
                (fact,) = found.items(1)
                inner = form(fact, ("holds",))
                return self.headed("not", (self.fact(inner.items(1)[0] if inner else fact),), offset)
            case "when":
                return self._when(found, moment, offset)
            case "forall":
                variables, body = self.quantified(found, "effects")
                return self.headed("forall", (variables, self.effects(body, moment)), offset)
            case word:
                target, value = found.items(2)
                return self.headed(_CHANGES[word], (self.fact(target), self.expression(value)), offset)

    def _when(self, found: Form, moment: str, offset: int) -> Part:
        entry = found.argument.mapped()
        entry.only("condition", "at_start", "effects")
        late, early = entry.node("condition"), entry.node("at_start")
        tested = late or early
        if tested is None or (late and early):
            raise found.argument.wrong("'when' takes effects, and either a condition or, for one that is tested early, at_start")
        condition = self.condition(tested)
        if early and not moment:
            raise InputError("only an effect at the end of a durative action can be tested at its start", entry.nodes["at_start"][0])
        if moment:
            condition = self.headed("at start" if early else moment, (condition,), self.offset(tested))
        return self.headed("when", (condition, self.effects(entry.needed("effects"), moment)), offset)

    # --- moments and durations ---

    def moments(self, node: Node, effects: bool) -> Group:
        """Read the conditions or the effects of a durative action, by moment; effects without one are at the end."""
        keys = ("at_start", "at_end") if effects else tuple(_MOMENTS)
        if not node.is_mapping or node.mapped().nodes.keys().isdisjoint(_MOMENTS):
            moment = "at end" if effects else "at start"
            return self.effects(node, moment) if effects else self.headed(moment, (self.condition(node),), self.offset(node))
        entry = node.mapped()
        entry.only(*keys)
        parts: list[Part] = []
        for key, _, value in entry.entries():
            moment = " ".join(_MOMENTS[key])
            if not value.is_null:
                part = self.effects(value, moment) if effects else self.headed(moment, (self.condition(value),), self.offset(value))
                parts.append(part)
        return self.headed("and", parts, self.offset(node))

    def duration(self, node: Node) -> Group:
        """Read how long an action takes: an expression, or a list of bounds."""
        offset = self.offset(node)
        if node.items is None and form(node, _BOUNDS) is None:
            return self._bound("=", node, offset)
        found = [needed_form(one, _BOUNDS, "a bound") for one in ((node,) if node.items is None else node.items)]
        bounds = [self._bound(one.word, one.argument, self.offset(one.argument)) for one in found]
        return self.headed("and", bounds, offset) if bounds else self.group((), offset)

    def _bound(self, operation: str, node: Node, offset: int) -> Group:
        return self.headed(operation, (self.atom("?duration", offset), self.expression(node)), offset)


def _is_typed(words: tuple[Part, ...]) -> bool:
    return any(isinstance(word, Atom) and word.text[0] == "-" for word in words)


def _is_early(node: Node) -> bool:
    """Tell whether an effect, or one inside it, is tested at the start of the action."""
    if node.items is not None:
        return any(map(_is_early, node.items))
    if not node.is_mapping:
        return False
    return any(
        key == "at_start" or (key in ("when", "forall", "effects", "and") and _is_early(value)) for key, _, value in node.mapped().entries()
    )
