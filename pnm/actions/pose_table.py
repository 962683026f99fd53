"""Poses of places: in a file of a person, in a map of Nav2, and as the rows of a table in a file of bindings.

A file of poses has a mapping from each place to ``[x, y]`` or ``[x, y, yaw]`` in metres and radians, or to ``{pixel: [column, row]}`` of
the map's image, with a ``yaw`` if wanted. A map is the YAML file of Nav2's map server: image, resolution, origin.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pnm.errors import InputError
from pnm.files.yaml_nodes import Node, compose, load_yaml

_SIZES: Final = re.compile(rb"P[25]\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)|\x89PNG\r\n\x1a\n....IHDR(....)(....)", re.DOTALL)
"""Width and height in the header of a PGM or a PNG."""
_HEADER: Final = 4096
_FRAME: Final = re.compile(r"[\w/.-]{1,200}", re.ASCII)
_WORDS: Final = frozenset({"y", "n", "yes", "no", "on", "off", "true", "false", "null"})
"""Words that YAML reads as something else than text."""


@dataclass(frozen=True)
class Pose:
    """A pose in the plane: metres, and the rotation about the vertical axis as z and w of a quaternion.

    Raises an `InputError` for numbers that are not finite, and for what is no name of a frame.
    """

    x: float
    y: float
    z: float = 0.0
    w: float = 1.0
    frame: str = "map"

    def __post_init__(self) -> None:
        """Refuse what is no pose: it may come from anybody who publishes."""
        if not all(map(math.isfinite, (self.x, self.y, self.z, self.w))):
            raise InputError(f"expected a pose of finite numbers, found x {self.x}, y {self.y}, z {self.z}, w {self.w}")
        if not _FRAME.fullmatch(self.frame):
            raise InputError(f"expected a pose in a frame of letters, digits, _, /, . and -, found {self.frame[:40]!r}")

    @staticmethod
    def turned(x: float, y: float, yaw: float = 0.0) -> Pose:
        """Return the pose with a rotation in radians."""
        return Pose(x, y, math.sin(yaw / 2), math.cos(yaw / 2))

    @property
    def row(self) -> str:
        """A ``geometry_msgs/PoseStamped`` as a row of a table, to millimetres."""
        place, turn = f"{{x: {self.x:.3f}, y: {self.y:.3f}}}", f"{{z: {self.z:.4f}, w: {self.w:.4f}}}"
        return f"{{header: {{frame_id: {_scalar(self.frame)}}}, pose: {{position: {place}, orientation: {turn}}}}}"


def _scalar(text: str) -> str:
    """Return a name as YAML has it: in quotes, unless it is read as text without."""
    return text if text[0].isalpha() and text.lower() not in _WORDS else f'"{text}"'


@dataclass(frozen=True)
class NavMap:
    """A map of Nav2: metres of a pixel, the pose of the lower left corner of its image, and the pixels of the image."""

    resolution: float
    origin: tuple[float, float, float]
    width: int
    height: int

    def at(self, column: float, row: float) -> tuple[float, float]:
        """Return the point in the middle of a pixel, which is counted from the upper left corner."""
        right, up = (column + 0.5) * self.resolution, (self.height - row - 0.5) * self.resolution
        x, y, yaw = self.origin
        return x + right * math.cos(yaw) - up * math.sin(yaw), y + right * math.sin(yaw) + up * math.cos(yaw)

    def has(self, x: float, y: float) -> bool:
        """Return whether a point is on the map."""
        left, low, yaw = self.origin
        right, up = (x - left) * math.cos(yaw) + (y - low) * math.sin(yaw), (y - low) * math.cos(yaw) - (x - left) * math.sin(yaw)
        return 0 <= right <= self.width * self.resolution and 0 <= up <= self.height * self.resolution


def read_map(file: Path) -> NavMap:
    """Read a map of Nav2's map server; raise `InputError` if it is none, or its image is no PGM or PNG."""
    keys = load_yaml(file)
    image = file.parent / (keys.needed("image").text or "")
    try:
        with image.open("rb") as stream:
            size = _SIZES.match(stream.read(_HEADER))
    except OSError as error:
        raise keys.needed("image").wrong(f"{image} cannot be read: {error.strerror}") from error
    if size is None:
        raise keys.needed("image").wrong(f"{image} is neither a PGM nor a PNG")
    width, height = (int(part) if len(part) != 4 or size[1] else int.from_bytes(part, "big") for part in size.groups() if part)
    origin = _numbers(keys.needed("origin"), 3)
    return NavMap(_numbers(keys.needed("resolution"), 1)[0], (origin[0], origin[1], origin[2]), width, height)


def read_poses(file: Path, on: NavMap | None) -> dict[str, Pose]:
    """Read a file of poses; raise `InputError` if one is not on the map, or is a pixel and there is no map."""
    poses: dict[str, Pose] = {}
    for place, _, node in load_yaml(file).entries():
        if node.is_mapping:
            keys = node.mapped()
            keys.only("pixel", "yaw")
            if on is None:
                raise node.wrong(f"{place} is a pixel of a map; expected --map and the file of the map")
            x, y = on.at(*_numbers(keys.needed("pixel"), 2))
            yaw = _numbers(keys.needed("yaw"), 1)[0] if "yaw" in keys.nodes else 0.0
        else:
            x, y, yaw = (*_numbers(node, 2, 3), 0.0)[:3]
        if on is not None and not on.has(x, y):
            raise node.wrong(f"{place}, at {x:g} m and {y:g} m, is not on the map")
        poses[place] = Pose.turned(x, y, yaw)
    return poses


def _numbers(node: Node, *lengths: int) -> list[float]:
    """Return the numbers of a list, or the only one."""
    values = [item.plain() for item in node.each]
    if len(values) not in lengths or not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        raise node.wrong(f"expected {' or '.join(map(str, lengths))} number{'s' * (lengths != (1,))}")
    return [float(str(value)) for value in values]


def with_row(text: str, file: str, place: str, row: str, action: str = "") -> str:
    """Return bindings in which the tables of poses have a row for the place: put in place of that there is, or else last.

    Args:
        text: of the file; all of it that is no row of this place stays as it is, comments included.
        action: the action whose tables are meant; by default those of all.

    Raises:
        InputError: there is no such table, or its rows have no lines of their own.
    """
    actions = compose(text, file)[0].mapped().needed("actions").mapped()
    if action and action not in actions.nodes:
        raise InputError(f"there is no binding of {action}; expected one of {', '.join(actions.nodes)}", actions.start)
    tables = [table for name, _, node in actions.entries() if action in ("", name) for table in _tables(node)]
    if not tables:
        raise InputError("no goal field has a table of poses; expected one as `pnm init` writes it", actions.start)
    lines = text.splitlines(keepends=True)
    for table in reversed(tables):  # from the last one, so that positions stay
        rows = table.mapped().nodes
        where, last = rows[place] if place in rows else [*rows.values()][-1]
        end = last.raw.end_mark
        if table.is_in_braces or last.raw.start_mark.line != end.line:
            raise InputError(f"expected a line for each row of the table of poses, to write one for {place}", where)
        written = f"{_scalar(place)}: {row}"
        if place in rows:
            line = lines[end.line]
            lines[end.line] = line[: where.column - 1] + written + line[end.column :]
        else:
            lines[end.line] = lines[end.line].rstrip("\n") + "\n"
            lines.insert(end.line + 1, f"{' ' * (where.column - 1)}{written}\n")
    return "".join(lines)


def _tables(node: Node) -> list[Node]:
    """Return the tables of stamped poses in a part of a binding, in the order of the file."""
    if not node.is_mapping:
        return []
    keys = node.mapped()
    if keys.nodes.keys() == {"of", "table"} and (table := keys.needed("table")).is_mapping:
        return [table] if any(row.is_mapping and "pose" in row.mapped().nodes for _, _, row in table.mapped().entries()) else []
    return [table for _, _, part in keys.entries() for table in _tables(part)]
