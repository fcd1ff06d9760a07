"""Parameters and options as documents: ``configs/default.yaml`` and two pages of the docs.

They are generated from the models of :mod:`mlbs_actors.config` and from :mod:`orchestrator.options`, so a
default, a meaning or a range is stated once. ``scripts/configuration`` writes them; a test fails while they
differ.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mlbs_actors.config import Config
from orchestrator.command_options import flag_of
from orchestrator.option import Form, Option
from orchestrator.options import options

__all__ = [
    "Parameter",
    "Section",
    "as_markdown",
    "as_yaml",
    "configuration_texts",
    "describe",
    "main",
    "options_as_markdown",
]

_YAML_HEAD = """\
# Every parameter with its default value. To change some, write a file with only the lines that differ
# and give it with --config FILE, or give --set section.key=value.
# One set of values serves all videos. Most lengths are px of a 640×480 frame and scale with the square
# root of the frame's area; taken as they are: consistency_px2, and motion but for flow_std_px.
# Written by scripts/configuration from mlbs_actors/config/: change the defaults there.
"""

_MARKDOWN_HEAD = """\
# Parameters

One set of values serves all videos. § is a section of the paper. Most lengths are px of a 640×480 frame and
scale with its side, in frames larger than 960×540 with the power of 0.4. These are taken as they are:
`consistency_px2`, and the section `motion` but for `flow_std_px`.

Change a value with `--set section.key=value`, or give a YAML file with `--config FILE`. The file may hold
any subset; [`configs/default.yaml`](../configs/default.yaml) holds all. In Python:
`load_config("file.yaml", ["layers.lookahead=4"])`.

This page and that file are written by `scripts/configuration` from
[`mlbs_actors/config/`](../mlbs_actors/config). Do not edit them by hand.
"""

_OPTIONS_HEAD = """\
# Options

All flags of [the command](command_line.md). The last column says when another value takes effect in a run
that has begun. *Within seconds* needs `--watch` and a value in the
[file of cameras](command_line.md#a-file-of-cameras), or in the file of `--zones`; a flag itself takes effect
at the next start with `--resume`.

This page is written by `scripts/configuration` from
[`orchestrator/options.py`](../orchestrator/options.py). Do not edit it by hand.
"""

_OPTIONS_END = """\
In the file of cameras these can be given for each camera, and for all below `defaults`: {keys}.
"""

# A meaning ends with its unit where the name does not include it: "..., nats." or "..., px (not scaled ...)."
_UNIT_IN_MEANING = re.compile(r", (px/frame|px × nats|px²|px|nats|grey levels|× noise)(?: \([^)]*\))?\.$")
_UNIT_OF_SUFFIX = {
    "px": "px",
    "px2": "px²",
    "frames": "frames",
    "levels": "grey levels",
    "tracks": "trajectories",
}

_SIGN_OF_BOUND = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter as documented.

    Attributes
    ----------
    key : str
        Name within its section.
    default : str
        As it is written in YAML.
    meaning : str
        A sentence.
    unit : str
        Empty for a pure number or a word.
    allowed : str
        The range, for example ``"> 0, ≤ 1"``; empty if there is none.
    """

    key: str
    default: str
    meaning: str
    unit: str
    allowed: str


@dataclass(frozen=True, slots=True)
class Section:
    """One section of the configuration: its key, its title, its parameters in order."""

    key: str
    title: str
    parameters: tuple[Parameter, ...]


def describe(model: type[BaseModel]) -> tuple[Section, ...]:
    """List the sections and parameters of a configuration.

    Parameters
    ----------
    model : subclass of pydantic.BaseModel
        Every field is a section: a model again, with a default, whose docstring's first line is its title.

    Returns
    -------
    tuple of Section
        In the order of the fields.
    """
    defaults = model()
    sections = []
    for key in model.model_fields:
        section: BaseModel = getattr(defaults, key)
        title = (type(section).__doc__ or "").strip().partition("\n")[0]
        sections.append(Section(key, title, tuple(_parameters(section))))
    return tuple(sections)


def as_yaml(sections: tuple[Section, ...]) -> str:
    """Write a configuration file: every parameter with its default, its meaning in a comment above it."""
    lines = [_YAML_HEAD]
    for section in sections:
        lines += [f"# {section.title}", f"{section.key}:"]
        for parameter in section.parameters:
            notes = [f"Unit: {parameter.unit}."] if _adds_to(parameter.meaning, parameter.unit) else []
            notes += [f"Allowed: {parameter.allowed}."] if parameter.allowed else []
            lines.append(f"  # {' '.join([parameter.meaning, *notes])}")
            lines.append(f"  {parameter.key}: {parameter.default}")
        lines.append("")
    return "\n".join(lines)


def as_markdown(sections: tuple[Section, ...]) -> str:
    """Write the page: one table per section."""
    lines = [_MARKDOWN_HEAD]
    for section in sections:
        lines += [f"## `{section.key}`", "", section.title, ""]
        lines += ["| parameter | default | unit | allowed | meaning |", "|---|---|---|---|---|"]
        for one in section.parameters:
            cells = (f"`{one.key}`", one.default, one.unit, one.allowed, one.meaning)
            lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
        lines.append("")
    return "\n".join(lines)


def options_as_markdown() -> str:
    """Write the page of the options of the command."""
    lines = [_OPTIONS_HEAD, "| option | meaning | another value takes effect |", "|---|---|---|"]
    for name, option in options():
        more = f"; [more]({option.page})" if option.page else ""
        cells = (_as_given(name, option), f"{option.meaning}{more}", option.effect.value)
        lines.append("| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |")
    keys = ", ".join(f"`{name}`" for name, option in options() if option.of_streams)
    return "\n".join([*lines, "", _OPTIONS_END.format(keys=keys)])


def _as_given(name: str, option: Option) -> str:
    flag = flag_of(name)
    match option.form:
        case Form.FLAG:
            return f"`{flag}`"
        case Form.OPTIONAL_VALUE:
            return f"`{flag} [{option.metavar}]`"
        case Form.WORDS | Form.REPEATED:
            return f"`{flag} {option.metavar} ...`"
        case Form.VALUE:
            return f"`{flag} {option.metavar}`"


def configuration_texts() -> dict[str, str]:
    """Return the content of the generated files by path in the repository."""
    sections = describe(Config)
    return {
        "configs/default.yaml": as_yaml(sections),
        "docs/configuration.md": as_markdown(sections),
        "docs/options.md": options_as_markdown(),
    }


def main() -> int:
    """Write the files into the repository of this module; return the exit status."""
    root = Path(__file__).resolve().parents[1]
    for name, text in configuration_texts().items():
        (root / name).write_text(text, encoding="utf-8")
        print(f"Written: {name}")
    return 0


def _parameters(section: BaseModel) -> Iterator[Parameter]:
    for key, field in type(section).model_fields.items():
        meaning = field.description or ""
        # Through PyYAML, because not every number as Python writes it is one in YAML (1e-05 is a text there).
        written = yaml.safe_dump({key: getattr(section, key)}, allow_unicode=True)
        default = written.removeprefix(f"{key}:").strip()
        yield Parameter(key, default, meaning, _unit(key, meaning), _allowed(field))


def _unit(key: str, meaning: str) -> str:
    stated = _UNIT_IN_MEANING.search(meaning)
    return stated[1] if stated else _UNIT_OF_SUFFIX.get(key.rpartition("_")[2], "")


def _adds_to(meaning: str, unit: str) -> bool:
    return bool(unit) and unit.lower() not in meaning.lower()


def _allowed(field: FieldInfo) -> str:
    if get_origin(field.annotation) is Literal:
        return ", ".join(str(choice) for choice in get_args(field.annotation))
    return ", ".join(
        f"{sign} {getattr(bound, name):g}"
        for bound in field.metadata
        for name, sign in _SIGN_OF_BOUND.items()
        if hasattr(bound, name)
    )


if __name__ == "__main__":
    sys.exit(main())
