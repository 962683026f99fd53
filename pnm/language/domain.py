"""Domains: the model that people and planners share, and how its actions are executed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.logic.domain import ProblemModel
from pnm.errors import Tolerated
from pnm.files.yaml_nodes import Mapped, Node
from pnm.knowledge.sources import SourceChoice, check_source
from pnm.language.actions import LanguageAction, read_action, read_class, read_schema
from pnm.language.declarations import read_declarations, read_derived, read_initial
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import NOTHING_DECLARED, FormulaScope, shown
from pnm.language.grammar import DomainKeys


@dataclass(frozen=True)
class LanguageDomain:
    """A domain and its problem, and how the actions are executed, by name."""

    model: ProblemModel = NOTHING_DECLARED
    """With the section ``problem``, if there is one."""
    actions: Mapping[str, LanguageAction] = field(default_factory=dict)
    sources: tuple[SourceChoice, ...] = ()
    """The sources of knowledge that the file chose."""
    warnings: tuple[Tolerated, ...] = ()
    """The tolerated mistakes in the file."""
    file: str = ""
    """Its source file."""


def domain_from(top: Mapped, warnings: tuple[Tolerated, ...] = ()) -> LanguageDomain:
    """Read a domain from a document that may have other keys as well."""
    keys = DomainKeys(top)
    keys.action_types  # noqa: B018  only anchors are made there; their contents are read where they are used
    model, actions = read_model(keys), keys.actions
    return LanguageDomain(
        model,
        {name: read_action(schema, actions[name], FormulaScope(model)) for name, schema in model.domain.actions.items()},
        sources=_read_sources(keys),
        warnings=warnings,
        file=top.file,
    )


def read_model(top: DomainKeys, *, strict: bool = False) -> ProblemModel:
    """Read the domain of a document and its problem; `strict` is that of `FormulaScope`."""
    section = top.problem if top.entry.filled("problem") else None
    declared = read_declarations(top, section, strict=strict)
    scope = FormulaScope(declared, {}, strict, borrows=section is None)
    domain = replace(declared.domain, rules=read_derived(top, scope))
    scope = replace(scope, declared=replace(declared, domain=domain))
    domain = replace(domain, actions={name: read_schema(name, keys, scope) for name, keys in top.actions.items()})
    if section is None:
        return replace(declared, domain=domain)
    facts, timed = read_initial(section, scope)
    return replace(declared, domain=domain, init=facts, timed=timed, goal=read_goal(section.goal, scope))


def read_goal(node: Node | None, scope: FormulaScope) -> Condition:
    """Read a goal; true when there is none."""
    return TRUE if node is None else read_condition(node, scope)


def _read_sources(top: DomainKeys) -> tuple[SourceChoice, ...]:
    """Read the sources of knowledge that a file chooses.

    ``external_knowledge_base`` has a class of the original implementation, for which a registered source stands; ``knowledge``
    has names of sources, or ``{name: {option: value}}``: one, or a list of them.
    """
    sources: list[SourceChoice] = []
    external = top.external_knowledge_base
    if external is not None:
        name = check_source(".".join(read_class(external)), external.position)
        sources.append(SourceChoice(name, {}, external.position))
    for node in top.knowledge:
        if node.text is not None:
            sources.append(SourceChoice(check_source(node.text, node.position), {}, node.position))
        elif not node.is_mapping:
            raise node.wrong(f"expected the name of a source of knowledge, found {shown(node)}")
        else:
            for name, position, options in node.mapped().entries():
                plain = {} if options.is_null else options.plain()
                if not isinstance(plain, dict):
                    raise options.wrong(f"expected options of {name} (option: value), found {shown(options)}")
                sources.append(SourceChoice(check_source(name, position), plain, position))
    return tuple(sources)
