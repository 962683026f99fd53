"""Worlds: a domain and the plans that are offered together, each of which becomes an action server."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pnm.errors import InputError
from pnm.language.domain import LanguageDomain
from pnm.language.drafts import beside, drafts, read_domain
from pnm.language.files import read_documents
from pnm.language.plan import HandWrittenPlan, finished
from pnm.language.scope import unknown
from pnm.sources.registry import Choice
from pnm.yaml_files import Mapped


@dataclass(frozen=True)
class World:
    """Plans by name, and the domain they share."""

    name: str
    plans: Mapping[str, HandWrittenPlan]
    domain: LanguageDomain

    @property
    def sources(self) -> tuple[Choice, ...]:
        """The sources of knowledge that the domain chose."""
        return self.domain.sources


def read_world(path: Path, name: str | None = None) -> World:
    """Read a world.

    Args:
        path: a file with ``domain`` and ``plans``, or with several worlds, each with ``domain`` and ``recipes``.
        name: which of several worlds.

    Raises:
        InputError: there is no such world, or something in it or its files is wrong.
    """
    documents, _ = read_documents(path)
    if len(documents) > 1:
        raise InputError("a second document begins here; expected one", documents[1].start)
    top = documents[0]
    if not top.nodes.keys().isdisjoint(("plans", "domain")):
        top.only("domain", "plans", "name")
        return _world(top.string("name") or path.stem, top, "plans")
    worlds = top.mappings()
    if name is None and len(worlds) == 1:
        name = next(iter(worlds))
    if name is None:
        raise InputError(f"there are several worlds; expected the name of one: {', '.join(worlds)}", top.start)
    if name not in worlds:
        raise unknown("world", name, worlds, top.start)
    worlds[name].only("domain", "recipes")
    return _world(name, worlds[name], "recipes")


def _world(name: str, entry: Mapped, key: str) -> World:
    file = entry.string("domain")
    domain = LanguageDomain() if file is None else read_domain(beside(entry, "domain", file))
    paths = [beside(entry, key, one) for one in entry.strings(key)]
    if not paths:
        raise InputError(f"the world {name!r} has no plans; expected files under {key!r}", entry.start)
    return World(name, finished([draft for path in paths for draft in drafts(path, domain)]), domain)
