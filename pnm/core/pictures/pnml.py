"""Nets as PNML (ISO/IEC 15909-2), place/transition nets of its 2009 grammar, which most tools for Petri nets read; and read back.

Written are places, transitions, arcs and tokens. What the standard has no words for (guards, actions, roles, steps) is in `toolspecific`
elements, which other tools pass over: to them every enabled transition may fire.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

from pnm.core.net.net import Marking, NetBuilder, NetError, PetriNet
from pnm.core.pictures.xml_text import Element, read_xml, xml
from pnm.errors import InputError, suggestion

GRAMMAR: Final = "http://www.pnml.org/version-2009/grammar/pnml"
"""The namespace."""
NET_TYPE: Final = "http://www.pnml.org/version-2009/grammar/ptnet"
LOST: Final = "guards, actions, times and roles are in toolspecific elements only: to other tools every enabled transition may fire"
"""The loss, in words."""
_OURS: Final = "petri-net-machines"


def to_pnml(data: Mapping[str, Any]) -> str:
    """Return a net as PNML; the same data give the same bytes.

    Args:
        data: what `as_data` of `pnm.core.pictures.export` returns of a machine, or the same of a policy.
    """
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<!-- {LOST} -->",
        f'<pnml xmlns="{GRAMMAR}">',
        f'<net id="net" type="{NET_TYPE}">',
        f"<name><text>{_OURS}</text></name>",
        _own("note", {"lost": LOST}),
        '<page id="page">',
    ]
    ids = {place["name"]: f"p{number}" for number, place in enumerate(data["places"])}
    for place in data["places"]:
        tokens = f"<initialMarking><text>{place['tokens']}</text></initialMarking>" if place["tokens"] else ""
        role = _own("about", {"role": place["role"]}) if place["role"] else ""
        lines.append(f'<place id="{ids[place["name"]]}">{_name(place["name"])}{tokens}{role}</place>')
    for number, transition in enumerate(data["transitions"]):
        name, about = transition["name"], {key: value for key, value in transition.items() if key != "name"}
        ids[name] = f"t{number}"
        lines.append(f'<transition id="{ids[name]}">{_name(name)}{_own("rule", about)}</transition>')
    for number, arc in enumerate(data["arcs"]):
        weight = f"<inscription><text>{arc['weight']}</text></inscription>" if arc["weight"] > 1 else ""
        lines.append(f'<arc id="a{number}" source="{ids[arc["source"]]}" target="{ids[arc["target"]]}">{weight}</arc>')
    return "\n".join((*lines, "</page>", "</net>", "</pnml>", ""))


def _name(text: str) -> str:
    return f"<name><text>{xml(text)}</text></name>"


def _own(tag: str, about: Mapping[str, Any]) -> str:
    """Return an element for ourselves, whose attributes are what is known; a mapping is an element in it."""

    def element(tag: str, about: Mapping[str, Any]) -> str:
        plain = {key: value for key, value in about.items() if not (value is None or isinstance(value, Mapping))}
        texts = ((key, " ".join(map(str, value)) if isinstance(value, list) else str(value)) for key, value in plain.items())
        attributes = "".join(f' {key}="{xml(text)}"' for key, text in texts)
        inner = "".join(element(key, value) for key, value in about.items() if isinstance(value, Mapping))
        return f"<{tag}{attributes}>{inner}</{tag}>" if inner else f"<{tag}{attributes}/>"

    return f'<toolspecific tool="{_OURS}" version="1">{element(tag, about)}</toolspecific>'


# --- reading ----------------------------------------------------------------------------------


class PnmlNet(NamedTuple):
    """A net as it was read."""

    net: PetriNet
    initial: Marking


def read_pnml(text: str, file: str = "text") -> PnmlNet:
    """Return the place/transition net of a text.

    Nodes go by their names, or by their ids if two have the same name. Raises an `InputError`, with line and column, if the text is no
    such net: of another type, with more nets than one, with references between pages, or with arcs that do not move tokens.
    """
    root = read_xml(text, file)
    if (root.tag, root.namespace) != ("pnml", GRAMMAR):
        raise InputError(f"expected <pnml xmlns={GRAMMAR!r}>, found <{root.tag}> of {root.namespace or 'no namespace'}", root.position)
    nets = [*root.all("net")]
    if len(nets) != 1:
        raise InputError(f"expected one net, found {len(nets)}", nets[1].position if nets else root.position)
    if (kind := nets[0].of("type")) != NET_TYPE:
        raise InputError(f"a net of type {kind!r}; expected {NET_TYPE!r}", nets[0].position)
    nodes, arcs, ids = dict[str, Element](), list[Element](), set[str]()
    for element in _objects(nets[0]):
        match element.tag:
            case "place" | "transition" | "arc" if element.of("id") in ids:
                raise InputError(f"the id {element.of('id')!r} is used twice", element.position)
            case "place" | "transition":
                nodes[element.of("id")] = element
            case "arc":
                # as an attribute, or as an element with a value or a text: tools that have other arcs write it in each of these ways
                types = [
                    element.attributes.get("type"),
                    *(one.attributes.get("value") for one in element.all("type")),
                    _label(element, "type"),
                ]
                if other := next((one for one in types if one and one != "normal"), None):
                    raise InputError(f"an arc of type {other!r}; expected 'normal'", element.position)
                arcs.append(element)
            case "referencePlace" | "referenceTransition":
                raise InputError(f"<{element.tag}> is not read; expected a net without references", element.position)
            case _:
                continue  # labels, graphics and other tools' own elements
        ids.add(element.of("id"))
    names = {id: _label(node, "name") or id for id, node in nodes.items()}
    if len({*names.values()}) < len(names):
        names = {id: id for id in nodes}
    around = {id: (dict[str, int](), dict[str, int]()) for id, node in nodes.items() if node.tag == "transition"}
    for arc in arcs:
        source, target = (end_of(arc, side, nodes) for side in ("source", "target"))
        if nodes[source].tag == nodes[target].tag:
            raise InputError(f"an arc between two {nodes[source].tag}s; expected a place and a transition", arc.position)
        inputs, outputs = around[target if target in around else source]
        weights, place = (inputs, source) if target in around else (outputs, target)
        weights[names[place]] = weights.get(names[place], 0) + _number(arc, "inscription", 1)
    builder, tokens = NetBuilder(), dict[str, int]()
    for id, node in nodes.items():
        if node.tag == "place":
            tokens[builder.place(names[id])] = _number(node, "initialMarking", 0)
    for id, weights_of in around.items():
        try:
            builder.transition(names[id], *weights_of)
        except NetError as error:
            raise InputError(str(error), nodes[id].position) from error
    return PnmlNet(builder.build(), Marking(tokens))


def _objects(page: Element) -> Iterator[Element]:
    """Yield all that is on a page, and on the pages that it has."""
    for element in page.contents:
        yield from _objects(element) if element.tag == "page" else (element,)


def _label(element: Element, tag: str) -> str:
    return next((text.text.strip() for label in element.all(tag) for text in label.all("text")), "")


def end_of(arc: Element, side: str, nodes: Mapping[str, Element]) -> str:
    """Return the id of the node at an end of an arc."""
    id = arc.of(side)
    if id not in nodes:
        hint = suggestion(id, nodes.keys())
        raise InputError(f"the {side} of an arc is {id!r}, which is neither place nor transition{hint and f'; {hint}'}", arc.position)
    return id


def _number(element: Element, tag: str, least: int) -> int:
    """Return the number of a label: `least` at least, which it is without one."""
    text = _label(element, tag)
    if text and not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) >= least):
        of = element.attributes.get("id", element.tag)
        raise InputError(f"<{tag}> of {of!r} is {text!r}; expected a number from {least}", element.position)
    return int(text) if text else least
