"""The streams of one run in the driver's form, and ``run.json``, which describes them."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mlbs_actors.actors.stream.protocol import StreamSink, StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.stored_motion import StoredMotion
from orchestrator.clips.packet_ring import PACKETS, PacketRing
from orchestrator.command_line import command_again
from orchestrator.credentials import mask
from orchestrator.events.delivery import Deliveries
from orchestrator.events.home_assistant import Camera
from orchestrator.events.targets import EventTarget, all_targets
from orchestrator.events.zones import read_zones
from orchestrator.option import Effect
from orchestrator.options import Arguments, recorded
from orchestrator.run.edited_files import keep_version
from orchestrator.run.file_watch import FileWatch
from orchestrator.run.list_watch import ListChange, ListWatch
from orchestrator.run.listed_stream import ListedStream, OwnSettings, StreamsFile
from orchestrator.run.reader_opening import ReaderOpening
from orchestrator.run.resumption import with_new_names
from orchestrator.run.retention_limits import Keep
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.spec_change import SpecChange
from orchestrator.run.stream_settings import StreamSettings, changes_between, settings_of, words_of_changes
from orchestrator.sinks.live_picture import LivePicture, live_picture_path
from orchestrator.sinks.private_record import PrivateRecord
from orchestrator.sinks.record import StreamRecord, ends_group
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.working_size import FullSizeRecord

__all__ = ["Job"]

#: A stream of which no file says anything.
_NOBODY = ListedStream("", parse_address("synthetic:demo", Path("/")), None)


class Job:
    """The streams of a run, including those added to a watched list.

    Parameters
    ----------
    listed : StreamsFile
        What the list says, with the streams of the arguments.
    arguments : Arguments
    config : Config
    folder : RunFolder
    live : Path, optional
        Folder of the monitor's pictures.
    say : callable
        Receives messages for the user.
    deliveries : Deliveries
        Of events.
    begun : mapping, optional
        The content of ``run.json`` that an earlier start has left.

    Attributes
    ----------
    description : dict
        Content of ``run.json``.
    """

    def __init__(
        self,
        listed: StreamsFile,
        arguments: Arguments,
        config: Config,
        folder: RunFolder,
        live: Path | None,
        say: Callable[[str], None],
        deliveries: Deliveries,
        begun: Mapping[str, Any] | None = None,
    ) -> None:
        streams = listed.streams
        self._streams = {stream.name: stream for stream in streams}
        self._deliveries = deliveries
        self._arguments = arguments
        self._config = config
        self._folder = folder
        self._live = live
        self._say = say
        self._gone: set[str] = set()  # which the list does not name any more
        self._unlisted = {stream.name for stream in streams if stream.line is None}
        self._settings = self._asked()
        self.description = self._described(begun)
        self._watch = None
        if arguments.watch and arguments.streams is not None:
            own = replace(listed, streams=tuple(one for one in streams if one.line is not None))
            self._watch = ListWatch(
                arguments.streams, own, self._recorded_source, lambda text: say(mask(text))
            )
        zones = arguments.zones
        self._zones_are_faulty = zones.fault is not None
        self._zones_watch = None
        if arguments.watch and zones.path is not None:
            self._zones_watch = FileWatch(zones.path, zones.stamp)

    @property
    def specs(self) -> list[StreamSpec]:
        """All streams, in the driver's form."""
        return [self._spec(stream) for stream in self._streams.values()]

    def add(self, stream: ListedStream) -> StreamSpec:
        """Take up another stream; return it in the driver's form."""
        self._streams[stream.name] = stream
        self._settings[stream.name] = settings_of(stream, self._arguments, self._config)
        self.keep_description(None)
        return self._spec(stream)

    def files(self, specs: Sequence[StreamSpec]) -> dict[str, SourceAddress]:
        """Return the sources of those of ``specs`` that are no cameras, by name."""
        return {spec.name: self._streams[spec.name].source for spec in specs if not spec.live}

    def settings(self, name: str) -> StreamSettings:
        """Return what a stream is asked for."""
        return self._settings[name]

    def cameras(self) -> list[Camera]:
        """Return what Home Assistant is told of the streams."""
        present = [(name, asked) for name, asked in list(self._settings.items()) if name not in self._gone]
        return [Camera.of(name, asked.rules) for name, asked in present]

    def video(self, name: str) -> Path | None:
        """Return the file that a stream reads; None of a camera."""
        stream = self._streams.get(name)
        return None if stream is None or stream.source.live else stream.source.path

    def keeps(self) -> dict[str | None, Keep]:
        """Return how much is kept of each camera that has a limit of its own, and for None of all others."""
        kept: dict[str | None, Keep] = {}
        for name, stream in self._streams.items():
            if "keep" in stream.own.options:
                kept[name] = stream.own.options["keep"] or Keep()
        if self._arguments.keep is not None:
            kept[None] = self._arguments.keep
        return kept

    def changes(self) -> SpecChange | None:
        """Return changes to the list, and to the file of zones."""
        change = None if self._watch is None else self._watch.look()
        if change is None and not self._has_other_zones():
            return None
        change = change or ListChange((), (), ())
        before = dict(self._streams), self._settings
        self._streams |= {stream.name: stream for stream in (*change.added, *change.changed)}
        self._gone = (self._gone | set(change.removed)) - {stream.name for stream in change.added}
        self._settings = self._asked()
        known = before[0].keys() - self._gone - {stream.name for stream in change.added}
        changed = self._changed(*before, [name for name in self._streams if name in known])
        self.keep_description(change.text)
        if change.targets is not None:
            self._retarget(change.targets)
        return replace(
            changed,
            added=tuple(map(self._spec, change.added)),
            removed=change.removed,
            renamed={
                one.name: (one.was, partial(self._rename, one)) for one in change.added if one.was is not None
            },
        )

    def _changed(
        self,
        streams: Mapping[str, ListedStream],
        settings: Mapping[str, StreamSettings],
        names: Sequence[str],
    ) -> SpecChange:
        """Return what is to become of streams that are other than they were, by these names."""
        reopened: list[StreamSpec] = []
        restarted: list[StreamSpec] = []
        configured: list[tuple[StreamSpec, object]] = []
        for name in names:
            now, same_source = self._settings[name], streams[name].source == self._streams[name].source
            effects = self._told_changes(name, settings[name], now, same_source=same_source)
            spec = self._spec(self._streams[name])
            is_other_file = not same_source and not (spec.live and streams[name].source.live)
            if is_other_file or {Effect.RESTART, Effect.EPOCH}.intersection(effects.values()):
                restarted.append(spec)
                continue
            if not same_source:
                reopened.append(spec)
            if "rules" in effects:
                configured.append((spec, now.rules))
        return SpecChange(reopened=tuple(reopened), restarted=tuple(restarted), configured=tuple(configured))

    def _told_changes(
        self, name: str, before: StreamSettings, now: StreamSettings, *, same_source: bool
    ) -> dict[str, Effect]:
        """Say what is other for a stream from now on; return these options, with when they take effect."""
        was, is_now = before.described(), now.described()
        effects = changes_between(was, is_now)
        words = [] if same_source else [f"it is at {self._streams[name].source} now"]
        words += [
            "other zones or rules" if key == "rules" else f"{key} {words_of_changes(was[key], is_now[key])}"
            for key in effects
            if key != "rules" or set(effects) == {"rules"}
        ]
        if words:
            epoch = "; a new epoch begins" if Effect.EPOCH in effects.values() else ""
            self._say(f"From now on for {name}: {', '.join(words)}{epoch}.")
        return effects

    def _retarget(self, targets: Sequence[EventTarget]) -> None:
        """Send events to the targets of the command and these."""
        try:
            targets = all_targets(self._arguments.events, targets)
            self._deliveries.retarget(targets)
        except (ConfigError, sqlite3.Error) as error:
            self._say(f"Events go where they went before: {error}")
        else:
            self._say(f"From now on events go to {', '.join(one.shown for one in targets) or 'nobody'}.")

    def _rename(self, stream: ListedStream) -> None:
        """Take up a stream that had another name; what was recorded of it is not written to any more."""
        try:
            self.description = with_new_names(
                self._folder, self.description, [stream], self._say, self._deliveries.rename
            )
            for known in (self._streams, self._settings):
                known.pop(stream.was or "", None)
            self._folder.redescribe(self.description)
        except (OSError, sqlite3.Error) as error:
            self._say(f"{stream.was} cannot get the name {stream.name}: {error}.")

    def _has_other_zones(self) -> bool:
        """Read the file of zones again if it has changed; return whether it says something else."""
        if self._zones_watch is None or not self._zones_watch.has_changed():
            return False
        path, before = self._arguments.zones.path, self._arguments.zones
        assert path is not None  # watched
        try:
            zones = read_zones(path)
        except ConfigError as error:
            self._say(f"{str(error).rstrip('.')}. The zones of before hold on.")
            self._zones_are_faulty = True
            return False
        self._arguments = replace(self._arguments, zones=zones)
        if unknown := sorted(zones.streams - (self._streams.keys() - self._gone)):
            self._say(f"--zones names {', '.join(unknown)}, not streams of this run at present.")
        if self._zones_are_faulty and zones.content == before.content:
            self._say("The file of zones can be read again; it says the same as before.")
        self._zones_are_faulty = False
        return True

    def _asked(self) -> dict[str, StreamSettings]:
        return {
            name: settings_of(stream, self._arguments, self._config) for name, stream in self._streams.items()
        }

    def _recorded_source(self, name: str) -> str | None:
        if name in self._unlisted:
            return "an argument of the command"
        if not self._folder.stream(name).exists():
            return None
        source: str = self.description["sources"].get(name, "")
        return source

    def keep_description(self, cameras: str | None) -> None:
        """Write ``run.json``, and what is in force of the files that are edited.

        Parameters
        ----------
        cameras : str, optional
            What the file of cameras says.
        """
        self.description = self._described(self.description)
        try:
            self._folder.redescribe(self.description)
            if cameras is not None:
                keep_version(self._folder.path, "cameras", cameras)
            if self._arguments.zones.text is not None:
                keep_version(self._folder.path, "zones", self._arguments.zones.text)
        except OSError as error:
            self._say(f"{self._folder.path} cannot be written to: {error.strerror}; free some space.")

    def _described(self, before: Mapping[str, Any] | None) -> dict[str, Any]:
        given = self._arguments
        asked = recorded({name: getattr(given, name) for name in given.__slots__})
        command = command_again(given, f"{given.results}-again")
        description = describe_run(list(self._streams.values()), self._config, asked, command, before)
        shared = description | settings_of(_NOBODY, given, self._config).described()
        own = {
            name: {key: value for key, value in asked.described().items() if value != shared[key]}
            for name, asked in self._settings.items()
            if self._streams[name].own != OwnSettings()
        }
        others = {key: one for key, one in description["settings"].items() if key not in self._settings}
        return description | {"settings": others | own}

    def _spec(self, stream: ListedStream) -> StreamSpec:
        asked = self._settings[stream.name]
        clips, packets = self._arguments.clips, None
        if clips is not None and stream.source.live:
            packets = PacketRing(self._folder.stream(stream.name) / PACKETS, clips.ring_seconds)
        record = StreamRecord if asked.max_side is None else FullSizeRecord
        picture = None
        if self._live is not None:
            picture = LivePicture(
                live_picture_path(self._live, stream.name), zones=asked.rules.zones, drawing=asked.drawing
            )
        open_sink: Callable[[], StreamSink] = partial(
            record,
            self._folder.stream(stream.name),
            stream.name,
            asked.save,
            picture,
            live=stream.source.live,
            source=stream.source,
            rules=asked.rules,
            segment_seconds=asked.segment,
            drawing=asked.drawing,
        )
        return StreamSpec(
            name=stream.name,
            config=asked.config,
            open_reader=ReaderOpening(stream.source, asked.give_up_after, asked.max_side, packets),
            open_sink=partial(PrivateRecord, open_sink) if asked.drawing.private else open_sink,
            max_frames=asked.max_frames,
            wants_background=ends_group if "background" in asked.save else None,
            source=str(stream.source),
            line=stream.line,
            live=stream.source.live,
            path=stream.source.path,
            ignored=None if asked.ignore is None else asked.ignore.mask,
            motion=self._motion(stream.name),
        )

    def _motion(self, name: str) -> StoredMotion | None:
        """Return the stored motion of a stream, if the command names any."""
        flow, tracks = self._arguments.flow, self._arguments.tracks
        if flow is None and tracks is None:
            return None
        return StoredMotion(name, flow, tracks, here=False)  # one without motion must not end the others
