"""The grammar of YAML mappings: which keys one has, from which its reader, its JSON Schema and the tables of the pages follow.

A grammar is a class of keys, and its instances read a mapping:

    class Loop(Keys):
        condition = needed(CONDITION, "tested before every round")
        limit = whole("how many rounds at most", 1000, least=1)

    loop = Loop(entry)      # refuses unknown keys
    loop.limit              # an int; raises `InputError` with the position
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from enum import Enum
from typing import Any, ClassVar, Final, Generic, TypeAlias, TypeVar, overload

from pnm.errors import InputError
from pnm.files.yaml_nodes import Mapped, Node

Schema: TypeAlias = Mapping[str, Any]
"""A JSON Schema, draft 7."""

T = TypeVar("T")
D = TypeVar("D")
E = TypeVar("E", bound=Enum)
K = TypeVar("K", bound="Keys")

TEXT: Final[Schema] = {"type": "string"}
ANYTHING: Final[Schema] = {}


def ref(name: str) -> Schema:
    """Return a reference to a definition of the schema."""
    return {"$ref": f"#/definitions/{name}"}


def pair(*items: Schema) -> Schema:
    """Return the schema of a list of exactly these items."""
    return {"type": "array", "items": [*items], "minItems": len(items), "maxItems": len(items)}


def described(words: str, schema: Schema) -> Schema:
    """Return a schema with a sentence about it; beside a reference nothing else may stand."""
    return {"description": f"{words[:1].upper()}{words[1:]}.", **({"allOf": [schema]} if "$ref" in schema else schema)}


class Key(Generic[T]):
    """A key of a mapping, with its reader, its schema, its meaning and its usual value in words."""

    name = ""

    def __init__(
        self, read: Callable[[Mapped, str], T], schema: Schema, words: str, usual: str = "", inner: type[Keys] | None = None
    ) -> None:
        self.read, self.schema, self.words, self.usual, self.inner = read, schema, words, usual, inner
        self.is_needed = False

    def __set_name__(self, owner: type[Keys], name: str) -> None:
        self.name = self.name or name.rstrip("_")  # `if_` for what Python has as a word

    @overload
    def __get__(self, keys: None, owner: type[Keys]) -> Key[T]: ...

    @overload
    def __get__(self, keys: Keys, owner: type[Keys]) -> T: ...

    def __get__(self, keys: Keys | None, owner: type[Keys]) -> Key[T] | T:
        return self if keys is None else self.read(keys.entry, self.name)

    def named(self, name: str) -> Key[T]:
        """Return the same key under another name."""
        key = copy(self)
        key.name = name
        return key

    def must(self) -> Key[T]:
        """Return the key, which must be there."""
        self.is_needed = True
        return self

    @property
    def about(self) -> Schema:
        """The schema of the key."""
        return described(f"{self.words}; by default {self.usual}" if self.usual else self.words, self.schema)


class Keys:
    """A mapping that is read. Classes of it have the keys that there may be, and their first line says what it is."""

    known: ClassVar[Mapping[str, Key[Any]]]
    """All keys by their names: first those of its bases, as fields of data classes."""
    others: ClassVar[Schema | None]
    extra: ClassVar[Schema]

    def __init_subclass__(cls, others: Schema | None = None, schema: Schema | None = None) -> None:
        """Take what the schema says besides, and of keys that the class does not have; these are refused if it says nothing."""
        found = {attribute: key for kind in reversed(cls.__mro__) for attribute, key in vars(kind).items() if isinstance(key, Key)}
        cls.known, cls.others, cls.extra = {key.name: key for key in found.values()}, others, schema or {}

    def __init__(self, entry: Mapped) -> None:
        self.entry = entry
        if self.others is None:
            self.check(entry)

    @classmethod
    def check(cls, entry: Mapped) -> None:
        """Refuse every key that the mapping cannot have, naming the nearest, or the one that it belongs under."""
        for key, (where, _) in entry.nodes.items():
            for name, outer in cls.known.items() if key not in cls.known else ():
                if outer.inner is not None and name in entry.nodes and key in outer.inner.known:
                    raise InputError(f"{key!r} belongs under {name!r}: two more spaces before it", where)
        entry.only(*cls.known)
        for name in (name for name, key in cls.known.items() if key.is_needed):
            entry.needed(name)

    @classmethod
    def json(cls, *, or_null: bool = False) -> Schema:
        """Return the JSON Schema of the mapping."""
        return {
            "description": (cls.__doc__ or "").partition("\n")[0],
            "type": ["object", "null"] if or_null else "object",
            "properties": {name: key.about for name, key in cls.known.items()},
            "required": [name for name, key in cls.known.items() if key.is_needed],
            "additionalProperties": False if cls.others is None else cls.others,
            **cls.extra,
        }

    @classmethod
    def rows(cls) -> str:
        """Return the rows of a table for people; what is ignored has none."""
        rows = ((name, key) for name, key in cls.known.items() if not key.words.startswith("ignored"))
        return "".join(f"| `{name}` | {key.words} | {key.usual} |\n".replace("|  |", "| |") for name, key in rows)


# --- kinds of values -----------------------------------------------------------------------


def node(schema: Schema, words: str, usual: str = "") -> Key[Node | None]:
    """Make a key whose value is read elsewhere; None if there is no value."""
    return Key(Mapped.filled, schema, words, usual)


def written(schema: Schema, words: str, usual: str = "") -> Key[Node | None]:
    """Make a key whose value is read elsewhere, be it nothing; None if the key is not there."""
    return Key(Mapped.node, schema, words, usual)


def listed(schema: Schema, words: str, usual: str = "") -> Key[tuple[Node, ...]]:
    """Make a key for one value or a list of values that are read elsewhere."""
    return Key(Mapped.listed, schema, words, usual)


def needed(schema: Schema, words: str) -> Key[Node]:
    """Make a key that must be there, whose value is read elsewhere."""
    return Key(Mapped.needed, schema, words).must()


def text(words: str, usual: str = "") -> Key[str | None]:
    """Make a key for a text."""
    return Key(Mapped.string, {"type": ["string", "null"]}, words, usual)


def names(words: str, usual: str = "") -> Key[list[str]]:
    """Make a key for a list of texts."""
    return Key(Mapped.strings, {"type": ["array", "null"], "items": TEXT}, words, usual)


def texts(expected: str, words: str, usual: str = "") -> Key[dict[str, str]]:
    """Make a key for a mapping of names to texts; an error says what was expected."""

    def read(entry: Mapped, key: str) -> dict[str, str]:
        found = entry.plain(key)
        if found is not None and not (isinstance(found, dict) and all(isinstance(text, str) for text in found.values())):
            raise InputError(expected, entry.position(key))
        return found or {}

    return Key(read, {"type": ["object", "null"], "additionalProperties": TEXT}, words, usual)


def flag(words: str, usual: str = "`false`") -> Key[bool]:
    """Make a key for true or false."""
    return Key(Mapped.flag, {"type": ["boolean", "null"]}, words, usual)


def choice(kinds: type[E], words: str, usual: str = "") -> Key[E | None]:
    """Make a key for one of the values of an enumeration."""
    return Key(lambda entry, key: entry.choice(key, kinds), {"enum": [*(kind.value for kind in kinds), None]}, words, usual)


def number(words: str, default: D, usual: str = "") -> Key[float | D]:
    """Make a key for a number that is not negative."""
    schema = {"type": ["number", "null"], "minimum": 0}
    return Key(lambda entry, key: entry.number(key, default), schema, words, usual or _usual(default))


def whole(words: str, default: D, usual: str = "", *, least: int = 0, most: int | None = None) -> Key[int | D]:
    """Make a key for a whole number, from `least` to `most`."""

    def read(entry: Mapped, key: str) -> int | D:
        value = entry.whole(key, default)
        if isinstance(value, int) and not (least <= value and (most is None or value <= most)):
            limits = f"from {least} to {most}" if most is not None else f"of at least {least}"
            raise InputError(f"expected a whole number {limits} under {key!r}, found {value}", entry.position(key))
        return value

    schema = {"type": ["integer", "null"], "minimum": least, **({} if most is None else {"maximum": most})}
    return Key(read, schema, words, usual or _usual(default))


def section(values: Schema, words: str, usual: str = "") -> Key[Mapped]:
    """Make a key for a mapping of names to values that are read elsewhere."""
    return Key(Mapped.section, {"type": ["object", "null"], "additionalProperties": values}, words, usual)


def each(kind: type[K], values: Schema, words: str, usual: str = "") -> Key[dict[str, K]]:
    """Make a key for mappings of one kind by their names."""
    schema = {"type": ["object", "null"], "additionalProperties": values}
    return Key(lambda entry, key: {name: kind(inner) for name, inner in entry.section(key).mappings().items()}, schema, words, usual)


def inside(kind: type[K], words: str) -> Key[K]:
    """Make a key for a mapping of another kind; without it, an empty one is read."""
    return Key(lambda entry, key: kind(entry.section(key)), kind.json(or_null=True), words, "", kind)


def needed_inside(kind: type[K], words: str) -> Key[K]:
    """Make a key for a mapping of another kind that must be there."""
    return Key(lambda entry, key: kind(entry.needed(key).mapped()), kind.json(), words, "", kind).must()


def _usual(default: object) -> str:
    return f"{default:g}" if isinstance(default, int | float) and default not in (float("inf"),) else ""
