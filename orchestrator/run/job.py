"""The streams of one run in the driver's form, and ``run.json``, which describes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mlbs_actors.actors.stream.protocol import StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.source import FrameReader
from orchestrator.command_line import command_again
from orchestrator.credentials import mask
from orchestrator.events.zones import EventRules, read_zones
from orchestrator.options import Arguments
from orchestrator.run.driver import SpecChange
from orchestrator.run.file_watch import FileWatch
from orchestrator.run.list_watch import ListWatch
from orchestrator.run.run_folder import CHANGING, RunFolder, RunSettings, describe_run
from orchestrator.run.stream_list import ListedStream
from orchestrator.run.zones_history import keep_zones
from orchestrator.sinks.live_picture import LivePicture, live_picture_path
from orchestrator.sinks.record import StreamRecord, ends_group
from orchestrator.sources.address import SourceAddress
from orchestrator.sources.opening import open_reader
from orchestrator.working_size import FullSizeRecord, ShrinkingReader

__all__ = ["Job"]


class Job:
    """The streams of a run, including those added to a watched list.

    Parameters
    ----------
    streams : sequence of ListedStream
    arguments : Arguments
    config : Config
    folder : RunFolder
    live : Path, optional
        Folder of the monitor's pictures.
    say : callable
        Receives messages for the user.
    recorded : mapping of str to str, optional
        Sources of streams that an earlier run in the folder has recorded, by name. Those that the list does
        not name any more stay in the description, so that their results can be exported.

    Attributes
    ----------
    description : dict
        Content of ``run.json``.
    """

    def __init__(
        self,
        streams: Sequence[ListedStream],
        arguments: Arguments,
        config: Config,
        folder: RunFolder,
        live: Path | None,
        say: Callable[[str], None],
        recorded: Mapping[str, str] | None = None,
    ) -> None:
        self._streams = {stream.name: stream for stream in streams}
        self._arguments = arguments
        self._config = config
        self._folder = folder
        self._live = live
        self._say = say
        self._sources = dict(recorded or {})
        self._gone: set[str] = set()  # which the list does not name any more
        self._unlisted = {stream.name for stream in streams if stream.line is None}
        self.description = self._described()
        self._watch = None
        if arguments.watch and arguments.streams is not None:
            listed = [stream for stream in streams if stream.line is not None]
            self._watch = ListWatch(
                arguments.streams, listed, self._recorded_source, lambda text: say(mask(text))
            )
        zones = arguments.zones.path
        self._zones_are_faulty = arguments.zones.fault is not None
        self._zones_watch = FileWatch(zones) if arguments.watch and zones is not None else None

    @property
    def specs(self) -> list[StreamSpec]:
        """All streams, in the driver's form."""
        return [self._spec(stream) for stream in self._streams.values()]

    def files(self, specs: Sequence[StreamSpec]) -> dict[str, SourceAddress]:
        """Return the sources of those of ``specs`` that are no cameras, by name."""
        return {spec.name: self._streams[spec.name].source for spec in specs if not spec.live}

    def rules(self, name: str) -> EventRules:
        """Return what the events of a stream depend on."""
        return self._arguments.zones.rules_of(name, self._config.layers.dormant_frames)

    def changes(self) -> SpecChange | None:
        """Return changes to the list, and to the file of zones."""
        change = None if self._watch is None else self._watch.look()
        before = self._arguments.zones
        configured = self._with_other_zones()
        if change is None and self._arguments.zones == before:
            return None
        added, removed = ((), ()) if change is None else (change.added, change.removed)
        self._streams |= {stream.name: stream for stream in added}
        self._gone = (self._gone | set(removed)) - {stream.name for stream in added}
        described = self._described()
        self.description |= {key: described[key] for key in CHANGING}
        try:
            self._folder.redescribe(self.description)
        except OSError as error:
            self._say(f"{self._folder.path}/run.json cannot be written: {error.strerror}; free some space.")
        others = ((self._spec(self._streams[name]), self.rules(name)) for name in configured)
        return SpecChange(tuple(map(self._spec, added)), removed, tuple(others))

    def _with_other_zones(self) -> list[str]:
        """Read the file of zones again if it has changed; return the streams with other rules."""
        if self._zones_watch is None or not self._zones_watch.has_changed():
            return []
        path = self._arguments.zones.path
        assert path is not None  # watched
        before = {name: self.rules(name) for name in self._streams}
        try:
            zones = read_zones(path)
        except ConfigError as error:
            self._say(f"{str(error).rstrip('.')}. The zones of before hold on.")
            self._zones_are_faulty = True
            return []
        self._arguments = replace(self._arguments, zones=zones)
        here = self._streams.keys() - self._gone
        if unknown := sorted(zones.streams - here):
            self._say(f"--zones names {', '.join(unknown)}, not streams of this run at present.")
        changed = [name for name in before if name in here and before[name] != self.rules(name)]
        if changed:
            self._say(f"Other zones, from now on: {', '.join(changed)}.")
        elif self._zones_are_faulty:
            self._say("The file of zones can be read again; it says the same as before.")
        self._zones_are_faulty = False
        try:
            keep_zones(self._folder.path, zones.text or "")
        except OSError as error:
            self._say(f"{self._folder.path} cannot be written to: {error.strerror}; free some space.")
        return changed

    def _recorded_source(self, name: str) -> str | None:
        if name in self._unlisted:
            return "an argument of the command"
        return self._sources.get(name, "") if self._folder.stream(name).exists() else None

    def _described(self) -> dict[str, Any]:
        given = self._arguments
        settings = RunSettings(
            save=given.save,
            max_frames=given.max_frames,
            max_side=given.max_side,
            ignored=given.ignore.digests,
            zones=given.zones.digest,
            segment=given.segment,
            keep=given.keep.words if given.keep else (),
        )
        command = command_again(given, f"{self._folder.path}-again")
        description = describe_run(
            list(self._streams.values()), self._config, settings, command, self._sources
        )
        self._sources = description["sources"]
        return description

    def _spec(self, stream: ListedStream) -> StreamSpec:
        save, max_side = self._arguments.save, self._arguments.max_side
        reader: Callable[[], FrameReader] = partial(open_reader, stream.source, self._arguments.give_up_after)
        record = StreamRecord
        if max_side is not None:
            reader, record = partial(ShrinkingReader, reader, max_side), FullSizeRecord
        rules = self.rules(stream.name)
        picture = None
        if self._live is not None:
            picture = LivePicture(live_picture_path(self._live, stream.name), zones=rules.zones)
        folder = self._folder.stream(stream.name)
        return StreamSpec(
            name=stream.name,
            config=self._config,
            open_reader=reader,
            open_sink=partial(
                record,
                folder,
                stream.name,
                save,
                picture,
                live=stream.source.live,
                source=stream.source,
                rules=rules,
                segment_seconds=self._arguments.segment if stream.source.live else None,
            ),
            max_frames=self._arguments.max_frames,
            wants_background=ends_group if "background" in save else None,
            source=str(stream.source),
            line=stream.line,
            live=stream.source.live,
            path=stream.source.path,
            ignored=self._arguments.ignore.mask_of(stream.name),
        )
