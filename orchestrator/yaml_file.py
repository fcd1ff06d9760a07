"""YAML files that operators write: read with the line of everything that cannot be used."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from mlbs_actors.errors import ConfigError
from orchestrator.credentials import MASK, mask

__all__ = ["YamlFile", "faults_of", "line_of", "masked_yaml", "read_yaml", "words_of"]

#: Largest file that is read.
MAX_BYTES = 8 * 2**20

#: Keys whose values are secrets, and those that may hold an address without its scheme.
_SECRETS = re.compile(r".*(pass|secret|token|pwd|key).*", re.IGNORECASE)
_ADDRESSES = ("source", "url")


@dataclass(frozen=True, slots=True)
class YamlFile:
    """A file of YAML.

    Attributes
    ----------
    text : str
        With the ends of its lines as they are.
    tree : yaml.Node, optional
        What it says, with lines; None if it is empty.
    content
        The same as values.
    """

    text: str
    tree: yaml.Node | None
    content: Any


def read_yaml(path: Path, flag: str) -> YamlFile:
    """Read a file.

    Parameters
    ----------
    path : Path
    flag : str
        What names the file, for messages.

    Raises
    ------
    ConfigError
        If it cannot be read, is no YAML, or names something twice; names the line.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{flag}: {path} is larger than {MAX_BYTES // 2**20} MiB; split it.")
        text = path.read_bytes().decode()
        tree = yaml.compose(text, yaml.SafeLoader)
        if tree is not None:
            _refuse_twice(path, flag, tree, set())
        return YamlFile(text, tree, yaml.safe_load(text))
    except OSError as error:
        raise ConfigError(f"{flag}: {path} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{flag}: {path} is no text in UTF-8.") from None
    except yaml.MarkedYAMLError as error:
        line = 1 if error.problem_mark is None else error.problem_mark.line + 1
        raise ConfigError(f"{flag}: {path}, line {line}: {error.problem}.") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{flag}: {path} is no YAML: {error}") from None
    except (ValueError, TypeError, RecursionError) as error:  # such as a date that there is not, or a loop
        raise ConfigError(f"{flag}: {path} cannot be understood: {error}.") from None


def masked_yaml(text: str) -> str:
    """Return a text of YAML without the passwords and tokens in it; all else is as it was."""
    tree = yaml.compose(text, yaml.SafeLoader)
    pieces, end = [], 0
    for begin, after, hidden in sorted(set(_secrets(tree, "", set()))):
        pieces += [mask(text[end:begin]), json.dumps(hidden, ensure_ascii=False)]
        end = after
    return "".join([*pieces, mask(text[end:])])


def _secrets(node: yaml.Node | None, key: str, seen: set[int]) -> Iterator[tuple[int, int, str]]:
    """Yield where each value begins and ends that holds a secret, and the value without it."""
    if node is None or id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            yield from _secrets(value, str(name.value), seen)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            yield from _secrets(item, key, seen)
    elif isinstance(node, yaml.ScalarNode):
        hidden = MASK if _SECRETS.fullmatch(key) else mask(node.value)
        if key in _ADDRESSES and "@" in hidden and MASK not in hidden:
            hidden = f"{MASK}@{hidden.rpartition('@')[2]}"
        if hidden != node.value:
            yield node.start_mark.index, node.end_mark.index, hidden


def line_of(tree: yaml.Node | None, place: Sequence[int | str]) -> int:
    """Return the number, from 1, of the line with a key or an item, or with what is nearest above it."""
    node, line = tree, 1
    for step in place:
        if isinstance(node, yaml.MappingNode):
            found = [(key, value) for key, value in node.value if str(key.value) == str(step)]
            if not found:
                break
            key, node = found[0]
            line = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            node = node.value[step]
            line = node.start_mark.line + 1
    return line


def faults_of(
    tree: yaml.Node | None,
    invalid: ValidationError,
    place: Sequence[int | str] = (),
    model: type[BaseModel] | None = None,
) -> Mapping[int, str]:
    """Return what is wrong by the number of the line, of a part at a place of the file that a model reads."""
    faults = {}
    for one in invalid.errors():
        where = ".".join(str(step) for step in one["loc"])
        faults[line_of(tree, [*place, *one["loc"]])] = (
            f"{where + ': ' if where else ''}{words_of(one, model)}"
        )
    return faults


def words_of(fault: ErrorDetails, model: type[BaseModel] | None = None) -> str:
    """Return what is wrong with a value, as it may stand behind its name.

    Parameters
    ----------
    fault : ErrorDetails
    model : type, optional
        What has refused it: names the key that may be meant by one that there is not.
    """
    words = fault["msg"].removeprefix("Value error, ")
    if not words.startswith("Extra inputs"):
        return words
    known = [] if model is None else _keys_at(model, fault["loc"][:-1])
    near = get_close_matches(str(fault["loc"][-1]), known, 1)
    return f"there is no such key{f'; did you mean {near[0]}?' if near else ''}"


def _keys_at(model: type[BaseModel], place: Sequence[int | str]) -> list[str]:
    """Return the keys at a place of what a model reads; none if they depend on what stands there."""
    for step in place:
        field = model.model_fields.get(str(step))
        if field is None:  # a number in a list, or a name in a mapping
            continue
        models = _models_in(field.annotation)
        if len(models) != 1:
            return []
        model = models[0]
    return list(model.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if parts := get_args(annotation):  # asked first: Python 3.10 takes tuple[…] for a class
        return [model for part in parts for model in _models_in(part)]
    return [annotation] if isinstance(annotation, type) and issubclass(annotation, BaseModel) else []


def _refuse_twice(path: Path, flag: str, node: yaml.Node, seen: set[int]) -> None:
    """Refuse a key that stands twice in one mapping: YAML would silently take the last."""
    if id(node) in seen:  # of an alias, which may stand for much
        return
    seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        names = set()
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise ConfigError(f"{flag}: {path}, line {line}: this is no name.")
            if key.value in names:
                raise ConfigError(f"{flag}: {path}, line {line}: {key.value!r} stands there twice.")
            names.add(key.value)
            _refuse_twice(path, flag, value, seen)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_twice(path, flag, item, seen)
