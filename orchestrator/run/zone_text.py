"""The text of a YAML file with other zones of one stream; everything else stays byte for byte.

An operator's comments, order and manner of writing are worth keeping, which no writer of YAML does. So the
parsed file only says where what stands, and as little text as possible is replaced there. Whoever calls this
parses the result and compares it with what was meant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from mlbs_actors.errors import ConfigError

__all__ = ["WrittenZone", "with_zones"]

_LEAST_STEP = 2  # columns by which what is below a key is indented


@dataclass(frozen=True, slots=True)
class WrittenZone:
    """A zone as the file shall have it.

    Attributes
    ----------
    content : mapping
        What is to be written of it.
    place : int, optional
        Its place in the list of the stream's zones as it is; None if it is new.
    changed : bool
        Whether it differs from what is written there.
    """

    content: Mapping[str, Any]
    place: int | None = None
    changed: bool = False


@dataclass(frozen=True, slots=True)
class _Edit:
    """Text in place of that from ``start`` to ``end``."""

    start: int
    end: int
    text: str


def with_zones(text: str, stream: str, zones: Sequence[WrittenZone]) -> str:
    """Return the text of a file with other zones below ``streams: STREAM: zones:``.

    Parameters
    ----------
    text : str
        A mapping in YAML, with the ends of its lines as they are.
    stream : str
    zones : sequence of WrittenZone
        Those that have a place in the order of these. Those of the list that are missing here are deleted.

    Raises
    ------
    ConfigError
        If what is to be changed is not written below that stream, but is an alias of another part.
    """
    edits = sorted(_edits(_Text(text), stream, zones), key=lambda edit: (edit.start, edit.end))
    parts, done = [], 0
    for edit in edits:
        parts += [text[done : edit.start], edit.text]
        done = edit.end
    return "".join([*parts, text[done:]])


class _Text:
    """A text with its lines."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.newline = "\r\n" if "\r\n" in text else "\n"

    def line_start(self, index: int) -> int:
        return max(self.text.rfind("\n", 0, index), self.text.rfind("\r", 0, index)) + 1

    def line_end(self, index: int) -> int:
        ends = (self.text.find(end, index) for end in "\r\n")
        return min((end for end in ends if end >= 0), default=len(self.text))

    def below(self, column: int) -> str:
        """Return what begins another line at a column."""
        return self.newline + " " * column


def _edits(text: _Text, stream: str, zones: Sequence[WrittenZone]) -> Iterator[_Edit]:
    tree = yaml.compose(text.text, yaml.SafeLoader)
    if not isinstance(tree, yaml.MappingNode):
        raise ConfigError("The file is no mapping of keys to values.")
    path, node, key, outer = ["streams", stream, "zones"], tree, None, tree
    while path and isinstance(node, yaml.MappingNode):
        found = next((pair for pair in node.value if pair[0].value == path[0]), None)
        if found is None:
            yield _insertion(text, tree, node, path, zones)
            return
        outer, (key, node) = node, found
        path = path[1:]
        if node.start_mark.index < key.end_mark.index:
            raise _is_alias(key.value)
    assert key is not None  # the root is a mapping
    if not path and isinstance(node, yaml.SequenceNode) and node.value:
        yield from _list_edits(text, key, node, zones)
    elif not path:
        yield _Edit(_colon(text, key), _end(text, node, key.end_mark.index), f" {_flow_list(zones)}")
    elif not outer.flow_style and len(path) == 1:  # an address alone, or nothing
        column = key.start_mark.column + _step(tree)
        start, end = node.start_mark.index, node.end_mark.index
        if end > start:
            yield _Edit(_colon(text, key), start, f"{text.below(column)}source: ")
        line_end = text.line_end(end)
        yield _Edit(line_end, line_end, text.below(column) + _block(text, path, zones, column, _step(tree)))
    elif len(path) == 1 and node.value:
        source = text.text[node.start_mark.index : node.end_mark.index]
        inner = f"{{source: {source}, {_flow(path, zones)}}}"
        yield _Edit(node.start_mark.index, node.end_mark.index, inner)
    else:
        end = node.end_mark.index
        yield _Edit(_colon(text, key), end, f" {{{_flow(path, zones)}}}")


def _insertion(
    text: _Text, tree: yaml.MappingNode, into: yaml.MappingNode, path: list[str], zones: Sequence[WrittenZone]
) -> _Edit:
    """Add a key to a mapping, behind what it has."""
    if into.flow_style:
        if not into.value:
            at = into.start_mark.index + 1
            return _Edit(at, at, _flow(path, zones))
        at = _end(text, into.value[-1][1], into.value[-1][0].end_mark.index)
        return _Edit(at, at, f", {_flow(path, zones)}")
    column = into.value[0][0].start_mark.column
    at = text.line_end(_end(text, into, 0))
    return _Edit(at, at, text.below(column) + _block(text, path, zones, column, _step(tree)))


def _list_edits(
    text: _Text, key: yaml.Node, node: yaml.SequenceNode, zones: Sequence[WrittenZone]
) -> Iterator[_Edit]:
    """Change, delete and add what differs in a list that has something in it."""
    items = node.value
    for item, after in zip(items, [*items[1:], None], strict=True):
        if item.start_mark.index < node.start_mark.index or (
            after and after.start_mark.index < item.start_mark.index
        ):
            raise _is_alias(key.value)
    kept = {zone.place: zone for zone in zones if zone.place is not None}
    new = [zone for zone in zones if zone.place is None]
    deleted = [place for place in range(len(items)) if place not in kept]
    if node.flow_style and deleted:
        written = [
            _flow_value(zone.content)
            if zone.place is None or zone.changed
            else text.text[items[zone.place].start_mark.index : items[zone.place].end_mark.index]
            for zone in zones
        ]
        yield _Edit(node.start_mark.index, node.end_mark.index, f"[{_comma(text, node).join(written)}]")
        return
    for place, zone in kept.items():
        if zone.changed:
            item = items[place]
            yield _Edit(
                item.start_mark.index, _end(text, item, item.start_mark.index), _flow_value(zone.content)
            )
    column, last = node.start_mark.column, max(kept, default=None)
    if node.flow_style:
        at = items[-1].end_mark.index
        yield _Edit(at, at, "".join(f"{_comma(text, node)}{_flow_value(zone.content)}" for zone in new))
        return
    if not zones:
        yield _Edit(_colon(text, key), _colon(text, key), " []")
    for place in deleted:
        yield _deletion(text, items[place], column)
    at = text.line_end(key.end_mark.index if last is None else _end(text, items[last], 0))
    yield _Edit(at, at, "".join(f"{text.below(column)}- {_flow_value(zone.content)}" for zone in new))


def _deletion(text: _Text, item: yaml.Node, column: int) -> _Edit:
    """Delete the lines of an item, whose ``-`` stands at a column."""
    start = text.line_start(item.start_mark.index)
    while start and not text.text[start:].startswith(" " * column + "-"):
        start = text.line_start(start - 1)
    end = text.line_end(_end(text, item, item.start_mark.index))
    after = end + len(text.newline) if text.text.startswith(text.newline, end) else end
    if end == len(text.text) and text.text.endswith(text.newline, 0, start):
        start -= len(text.newline)  # such a file still has no end of line at its end
    return _Edit(start, after, "")


def _end(text: _Text, node: yaml.Node, begun: int) -> int:
    """Return where what a node says ends, without the comments behind it.

    Parameters
    ----------
    text : _Text
    node : yaml.Node
    begun : int
        Where it begins at the earliest; if it is an alias, it stands in the rest of that line.
    """
    if node.end_mark.index < begun:
        return text.line_end(begun)
    if isinstance(node, yaml.MappingNode) and not node.flow_style:
        key, value = node.value[-1]
        return _end(text, value, key.end_mark.index)
    if isinstance(node, yaml.SequenceNode) and not node.flow_style:
        return _end(text, node.value[-1], begun)
    end = node.end_mark.index
    if isinstance(node, yaml.ScalarNode) and node.style in ("|", ">"):
        end = node.start_mark.index + len(text.text[node.start_mark.index : end].rstrip())
    return end


def _colon(text: _Text, key: yaml.Node) -> int:
    """Return where what a key stands for may begin."""
    return text.text.index(":", key.end_mark.index) + 1


def _step(tree: yaml.MappingNode) -> int:
    """Return by how many columns the file indents."""
    for key, value in tree.value:
        if (
            isinstance(value, yaml.MappingNode)
            and not value.flow_style
            and value.start_mark.line > key.start_mark.line
        ):
            return int(max(value.start_mark.column - key.start_mark.column, _LEAST_STEP))
    return _LEAST_STEP


def _comma(text: _Text, node: yaml.SequenceNode) -> str:
    """Return what stands between the items of a list in brackets."""
    lines = {item.start_mark.line for item in node.value}
    column = node.value[0].start_mark.column
    return f",{text.below(column)}" if len(lines) > 1 else ", "


def _block(text: _Text, path: Sequence[str], zones: Sequence[WrittenZone], column: int, step: int) -> str:
    """Return keys below each other, the first at a column, with the zones below them."""
    lines = [f"{text.below(column + step * depth)}{_scalar(key)}:" for depth, key in enumerate(path)]
    below = text.below(column + step * len(path))
    lines += [f"{below}- {_flow_value(zone.content)}" for zone in zones] or [" []"]
    return "".join(lines).lstrip()


def _flow(path: Sequence[str], zones: Sequence[WrittenZone]) -> str:
    """Return the same in one line, for a mapping in braces."""
    if len(path) > 1:
        return f"{_scalar(path[0])}: {{{_flow(path[1:], zones)}}}"
    return f"{_scalar(path[0])}: {_flow_list(zones)}"


def _flow_list(zones: Sequence[WrittenZone]) -> str:
    return f"[{', '.join(_flow_value(zone.content) for zone in zones)}]"


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        """Whether what stands there twice is written twice: always."""
        return True


def _flow_value(value: object) -> str:
    return yaml.dump(
        value,
        Dumper=_Dumper,
        default_flow_style=True,
        allow_unicode=True,
        sort_keys=False,
        width=float("inf"),
    ).rstrip("\n")


def _scalar(value: str) -> str:
    return _flow_value([value])[1:-1]  # in brackets, so that it can stand anywhere


def _is_alias(key: str) -> ConfigError:
    return ConfigError(
        f"What stands below {key} is an alias (*) of another part of the file, for other streams too; write "
        "the zones of this stream out in the file, or change them there."
    )
