"""The file of cameras: streams with what each is asked for, in YAML.

    defaults: {max_side: 960, keep: 7d}
    events: [{url: mqtt://broker/cameras}]
    streams:
      gate:
        source: rtsp://user:password@host/stream
        zones: [{name: yard, polygon: [[0, 0.5], [1, 0.5], [1, 1], [0, 1]]}]

It is edited while the run is at work, so each value is checked by itself. One that cannot be used is told,
and that of an earlier version stands in for it; a new stream waits until it is mended.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, SourceError
from orchestrator.credentials import mask
from orchestrator.events.targets import EventTarget, TargetEntry, targets_of
from orchestrator.events.zones import EventSettings
from orchestrator.option import Form
from orchestrator.options import options
from orchestrator.run.listed_stream import ListedStream, OwnSettings, StreamsFile, check_name
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.yaml_file import YamlFile, faults_of, line_of, read_yaml

__all__ = ["parse_cameras"]

_OPTIONS = {name: option for name, option in options() if option.of_streams}

#: In messages about values that flags take, too.
_FLAG = re.compile(r"(?<!\S)--([a-z][a-z-]*)")


def parse_cameras(path: Path, folder: Path, before: StreamsFile | None = None) -> StreamsFile:
    """Read a file of cameras.

    Parameters
    ----------
    path : Path
    folder : Path
        Of relative paths in it.
    before : StreamsFile, optional
        An earlier version, for what cannot be used now.

    Raises
    ------
    ConfigError
        If it cannot be read, is no YAML, or names no stream.
    """
    return _Parser(path, folder, read_yaml(path, "--streams"), before).parsed()


@dataclass(slots=True)
class _Parser:
    path: Path
    folder: Path
    file: YamlFile
    before: StreamsFile | None
    faults: dict[int, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)  # by what a disk may take for the same one

    def parsed(self) -> StreamsFile:
        content = self.file.content
        streams = content.get("streams") if isinstance(content, dict) else None
        if not isinstance(streams, dict) or not streams:
            raise ConfigError(
                f"--streams: {self.path} names no stream; write one as\n"
                "streams:\n  gate:\n    source: rtsp://user:password@host/stream"
            )
        for key in content.keys() - {"defaults", "events", "streams"}:
            self._fault([key], f"there is no key {key!r}; known are defaults, events and streams")
        earlier = {} if self.before is None else {one.name: one for one in self.before.streams}
        defaults = content.get("defaults") or {}
        self._settings(["defaults"], defaults, OwnSettings())
        if not isinstance(defaults, dict):
            defaults = {}
        parsed = [self._stream(name, entry, defaults, earlier) for name, entry in streams.items()]
        usable = tuple(stream for stream in parsed if stream is not None)
        targets = self._targets(content.get("events", []))
        return StreamsFile(usable, self.faults, None if self.faults else self.file.text, targets)

    def _targets(self, entries: object) -> tuple[EventTarget, ...] | None:
        """Read where events are sent; those of before if that cannot be used."""
        if isinstance(entries, list):
            try:
                return targets_of([TargetEntry.model_validate(entry) for entry in entries])
            except ValidationError as invalid:
                faults = faults_of(self.file.tree, invalid, ["events"])
                self._add_faults(faults)
            except (ConfigError, ValueError) as error:
                self._fault(["events"], str(error))
        else:
            self._fault(["events"], "events is no list; write each target as - url: mqtt://HOST/TOPIC")
        return None if self.before is None else self.before.targets

    def _fault(self, place: Sequence[str], words: str) -> None:
        self._add_faults({line_of(self.file.tree, place): words})

    def _add_faults(self, faults: Mapping[int, str]) -> None:
        for line, words in faults.items():
            others = f"{self.faults[line]}; " if line in self.faults else ""
            self.faults[line] = others + mask(_FLAG.sub(_as_key, words)).rstrip(".")

    def _stream(
        self,
        name: object,
        entry: object,
        defaults: Mapping[str, Any],
        earlier: Mapping[str, ListedStream],
    ) -> ListedStream | None:
        if not isinstance(name, str):
            self._fault(["streams", str(name)], f"{name!r} is no text in YAML; put the name in quotes")
            return None
        place, before = ["streams", name], earlier.get(name)
        try:
            check_name(name, given=True)
            if (same := self.names.setdefault(name.lower(), name)) != name:
                raise ConfigError(f"some disks take {name!r} for {same!r}; choose another name")
        except (ConfigError, ValueError) as error:
            self._fault(place, str(error))
            return None
        entry = {"source": entry} if isinstance(entry, str) else entry
        if not isinstance(entry, dict) or not isinstance(entry.get("source"), str):
            self._fault(place, f"{name} has no source; write source: rtsp://host/stream below it")
            return before
        was = self._was(place, entry.get("was"))
        own = {key: value for key, value in entry.items() if key not in ("source", "was")}
        source = self._source(place, entry["source"], before)
        settings = self._settings(place, own, OwnSettings() if before is None else before.own, defaults)
        if settings is None and before is not None:
            settings = before.own
        if source is None or settings is None:
            return None
        line = line_of(self.file.tree, place)
        return ListedStream(name, source, line, settings, was)

    def _was(self, place: list[str], given: object) -> str | None:
        """Read the name that a stream had before."""
        if given is None or (isinstance(given, str) and given not in self.file.content["streams"]):
            return given
        self._fault([*place, "was"], f"was: {given!r} is a stream of this file; a renamed one has one name")
        return None

    def _source(self, place: list[str], given: str, before: ListedStream | None) -> SourceAddress | None:
        try:
            return parse_address(given, self.folder)
        except (ConfigError, SourceError, ValueError) as error:
            self._fault([*place, "source"], f"source: {error}")
            return None if before is None else before.source

    def _settings(
        self, place: list[str], entry: object, before: OwnSettings, defaults: Mapping[str, Any] | None = None
    ) -> OwnSettings | None:
        """Read what an entry asks for, with the values of before for those that cannot be used.

        None if one cannot, and there is none of before.
        """
        if not isinstance(entry, dict):
            self._fault(place, f"{place[-1]} is no mapping of keys to values")
            return None
        whole, complete = _merged(defaults or {}, entry), True
        values: dict[str, Any] = {}
        for key in whole.keys() & _OPTIONS.keys():
            try:
                values[key] = self._value(key, whole[key])
            except (ConfigError, ValueError) as error:
                if key in entry:  # else it is one of the defaults, which is told there
                    self._fault([*place, key], str(error))
                complete &= key in before.options
                if key in before.options:
                    values[key] = before.options[key]
        if "ignore" in values and (faults := values["ignore"].faults):
            if "ignore" in entry:
                self._fault([*place, "ignore"], faults[0])
            values["ignore"] = before.options.get("ignore", values["ignore"])  # or nothing: the stream runs
        known = ["source", "was", *EventSettings.model_fields, *_OPTIONS]
        for key in entry.keys() - set(known):
            near = get_close_matches(str(key), known, 1)
            advice = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
            self._fault([*place, str(key)], f"there is no key {key!r}; {advice}")
            complete = False  # what it was to say is not known
        asked = {key: whole[key] for key in EventSettings.model_fields if key in whole}
        try:
            rules = EventSettings.model_validate(asked) if asked else None
        except ValidationError as invalid:
            if any(key in entry for key in asked):
                self._add_faults(faults_of(self.file.tree, invalid, place))
            rules, complete = before.rules, complete and before.rules is not None
        return OwnSettings(values, rules) if complete else None

    def _value(self, key: str, given: object) -> object:
        option = _OPTIONS[key]
        if given is None:
            raise ConfigError(f"{key} has no value; leave the key out")
        if isinstance(given, dict):
            texts = [f"{name}={_text(one)}" for name, one in given.items()]
        else:
            texts = [_text(one) for one in (given if isinstance(given, list) else [given])]
        if key == "ignore":
            texts = [str(self.folder.absolute() / text) for text in texts]
        value = option.value(key, texts if option.form in (Form.REPEATED, Form.WORDS) else ",".join(texts))
        if key == "set":
            load_config(None, value)  # whether there are such parameters
        return value


def _merged(defaults: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return an entry with the defaults of all; of parameters each one counts by itself."""
    whole = {**defaults, **entry}
    both = defaults.get("set"), entry.get("set")
    if isinstance(both[0], dict) and isinstance(both[1], dict):
        whole["set"] = {**both[0], **both[1]}
    return whole


def _as_key(flag: re.Match[str]) -> str:
    return flag[1].replace("-", "_")


def _text(value: object) -> str:
    """Return a value of YAML as the command line would have it."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else yaml.safe_dump(value).removesuffix("\n...\n").strip()
