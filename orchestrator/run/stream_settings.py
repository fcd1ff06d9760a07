"""What one stream is asked for: the options of the command, with what a file of cameras says of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from mlbs_actors.config import Config, with_overrides
from orchestrator.clips.settings import has_clips
from orchestrator.events.zones import EventRules
from orchestrator.ignored import IgnoredFile
from orchestrator.option import Effect
from orchestrator.options import Arguments, options
from orchestrator.pictures.content import Drawing
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.retention_limits import Keep, segment_with

__all__ = ["StreamSettings", "changes_between", "settings_of", "words_of_changes"]

_EFFECTS = {name: option.effect for name, option in options()} | {
    "config": Effect.EPOCH,
    "rules": Effect.AT_ONCE,
}

#: Most differences that a message lists.
_MOST_CHANGES = 3

#: Of these an event tells, not of what only limits or ends.
_TOLD = ("config", "save", "max_side", "ignore", "segment")


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """The values of the options for one stream, each under the option's name.

    Attributes
    ----------
    config : Config
        All parameters.
    save : frozenset of str
    max_frames, max_side : int, optional
    ignore : IgnoredFile, optional
    segment : int, optional
        s; None for a file.
    keep : Keep, optional
    give_up_after : int, optional
        s.
    rules : EventRules
        What its events depend on.
    drawing : Drawing
        What its pictures show.
    """

    config: Config
    save: frozenset[str]
    max_frames: int | None
    max_side: int | None
    ignore: IgnoredFile | None
    segment: int | None
    keep: Keep | None
    give_up_after: int | None
    rules: EventRules
    drawing: Drawing

    def described(self) -> dict[str, Any]:
        """Return each value as ``run.json`` has it."""
        return {
            "config": self.config.model_dump(mode="json"),
            "save": sorted(self.save),
            "max_frames": self.max_frames,
            "max_side": self.max_side,
            "ignore": None if self.ignore is None else self.ignore.digest,
            "segment": self.segment,
            "keep": None if self.keep is None else list(self.keep.words),
            "give_up_after": self.give_up_after,
            "rules": self.rules.digest,
            "draw": self.drawing.names,
            "time_zone": self.drawing.time_zone,
        }


def settings_of(stream: ListedStream, arguments: Arguments, config: Config) -> StreamSettings:
    """Return what a stream is asked for; ``config`` has the parameters of the command."""
    own = stream.own.options
    asked = {name: own.get(name, getattr(arguments, name)) for name, _ in options()}
    values = {one.name: asked[one.name] for one in fields(StreamSettings) if one.name in asked}
    if "set" in own:
        config = with_overrides(config, own["set"])
    ignored = own.get("ignore", arguments.ignore)
    segment = segment_with(values["segment"], values["keep"])
    remembered = config.layers.dormant_frames
    rules = arguments.zones.rules_of(stream.name, remembered)
    if stream.own.rules is not None:
        rules = stream.own.rules.event_rules(arguments.zones.content.minimum, remembered)
    if arguments.clips is not None and has_clips(stream.source):
        rules = replace(rules, clips=arguments.clips.kinds)
    values |= {
        "config": config,
        "ignore": ignored.file_of(stream.name),
        "segment": segment if stream.source.live else None,
        "rules": rules,
        "drawing": Drawing.of(asked["draw"], asked["time_zone"], private=arguments.private),
    }
    settings = StreamSettings(**values)
    told = {key: value for key, value in settings.described().items() if key in _TOLD}
    digest = hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]
    del told["config"]
    told |= _named(config.model_dump(mode="json", exclude_defaults=True))
    return replace(settings, rules=replace(rules, settings=digest, told=told))


def _named(parameters: Mapping[str, Any], section: str = "") -> dict[str, Any]:
    """Return parameters by the names that ``--set`` has for them."""
    named: dict[str, Any] = {}
    for key, value in parameters.items():
        name = f"{section}.{key}" if section else key
        named |= _named(value, name) if isinstance(value, Mapping) else {name: value}
    return named


def changes_between(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, Effect]:
    """Return the options that differ between two described settings, with when they take effect."""
    return {name: _EFFECTS[name] for name in now if name in before and before[name] != now[name]}


def words_of_changes(before: object, now: object) -> str:
    """Say how a part of a run's description has changed."""
    changes = list(_differences(before, now))
    more = len(changes) - _MOST_CHANGES
    return "; ".join(changes[:_MOST_CHANGES]) + (f"; and {more} more" if more > 0 else "")


def _differences(before: object, now: object, name: str = "") -> Iterator[str]:
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in sorted(before.keys() | now.keys()):
            yield from _differences(before.get(key), now.get(key), f"{name}.{key}" if name else key)
    elif before != now:
        yield f"{name} was {_given(before)}, now {_given(now)}".lstrip()


def _given(value: object) -> str:
    if value is None:
        return "not given"
    return ", ".join(map(str, value)) if isinstance(value, (list, Mapping)) else str(value)
