"""One run of the command, from the checked arguments to its exit status."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from mlbs_actors.actors import Cluster, Node, PoolPolicy
from mlbs_actors.actors.node.memory import NodeMemory, node_memory
from mlbs_actors.actors.stream.protocol import FrameReader, StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, SinkError
from mlbs_actors.kernels.machine_code import has_machine_code
from mlbs_actors.wording import count_of
from orchestrator.command_line import Arguments
from orchestrator.credentials import mask
from orchestrator.events.delivery import delivering
from orchestrator.events.zones import EventRules
from orchestrator.interruption import Interruption, StopAtOnce
from orchestrator.monitor.address import MonitorAddress
from orchestrator.monitor.board import Board
from orchestrator.monitor.ray_metrics import RayMetrics
from orchestrator.monitor.server import serving
from orchestrator.program import command_line_of
from orchestrator.progress import progress_for
from orchestrator.ray_session import ray_session
from orchestrator.report.page import render_report
from orchestrator.run.admission import cores, places, places_here, warn_of_cameras
from orchestrator.run.argument_streams import DEMO
from orchestrator.run.driver import Driver, Observer, SpecChange
from orchestrator.run.durable_files import replace_file
from orchestrator.run.list_watch import ListWatch
from orchestrator.run.retention import Retention
from orchestrator.run.run_folder import RunFolder, StatusFile, describe_run
from orchestrator.run.stream_list import ListedStream
from orchestrator.run.stream_state import StreamState, after_failure, exit_code, stopped, with_record
from orchestrator.run.whole_overlays import is_in_parts, is_lost, make_whole
from orchestrator.sinks.live_picture import LivePicture, live_picture_path
from orchestrator.sinks.overlay import overlays, stream_remarks
from orchestrator.sinks.record import StreamRecord, ends_group, has_snapshot, recorded_frames
from orchestrator.sinks.segments import segment_folders
from orchestrator.sources.address import SourceAddress, SourceKind
from orchestrator.sources.lengths import finding_lengths
from orchestrator.sources.opening import open_reader
from orchestrator.working_size import FullSizeRecord, ShrinkingReader

__all__ = ["run", "what_to_look_at"]


def run(
    arguments: Arguments,
    streams: Sequence[ListedStream],
    missing: Mapping[str, str],
    config: Config,
    scratch: Path,
) -> int:
    """Segment all streams; return the exit status.

    Parameters
    ----------
    arguments : Arguments
    streams : sequence of ListedStream
        Of the list, then of the arguments.
    missing : mapping of str to str
        Streams without a source → what is wrong; they fail, the others run.
    config : Config
        The parameters according to ``arguments``.
    scratch : Path
        Folder for Ray's files, from :func:`orchestrator.ray_session.ray_settings`.

    Raises
    ------
    ConfigError
        If the output folder or the cluster cannot be used; nothing was started.
    MlbsError
        If Ray cannot be started, or the run's own files cannot be written.
    """
    folder = RunFolder(arguments.output.resolve())
    sourceless = [stream for stream in streams if stream.name in missing]
    for stream in sourceless:
        place = f"{arguments.streams}, line {stream.line}: " if stream.line else ""
        _say(place + missing[stream.name])
    if arguments.watch:  # their lines are ignored until they are corrected
        streams, sourceless = [stream for stream in streams if stream.name not in missing], []
    ended = {
        stream.name: after_failure(StreamState(stream.name, line=stream.line), missing[stream.name])
        for stream in sourceless
    }
    # On a cluster the pictures come from other machines, through the shared folder.
    live = None if arguments.monitor is None else (folder.path if arguments.address else scratch) / ".live"
    job = _Job(streams, arguments, config, folder, live)
    memory = node_memory()
    limit = places(memory, cores())
    retention = None if arguments.keep is None else Retention(folder.path, arguments.keep, _say)
    status = StatusFile(
        folder.path / "status.json", kept=None if retention is None else lambda: retention.figures
    )
    with ExitStack() as hold, ExitStack() as session:  # the folder is locked until its last file is written
        if arguments.resume:
            begun = folder.refuse_other(job.description)
            hold.enter_context(folder.locked())
            changed = {key: job.description[key] for key in ("sources", "hashes", "keep", "command")}
            if changed != {key: begun.get(key) for key in changed}:
                try:
                    folder.redescribe(begun | changed)
                except OSError as error:
                    raise ConfigError(f"Cannot write to {folder.path}: {error.strerror}.") from None
            earlier = _not_to_be_resumed(folder, job.specs)
            _say(_words_on_resuming(begun, job.description, len(earlier)))
            ended |= earlier
        else:
            folder.refuse_if_used([stream.name for stream in streams])
        due = [spec for spec in job.specs if spec.name not in ended]
        onlookers: list[Observer] = []
        lengths: Callable[[], dict[str, int]] = dict
        if at_work := bool(due) or arguments.watch:
            onlookers = session.enter_context(_monitored(arguments.monitor, live))
            _announce(due, arguments, limit, memory)
            lengths = session.enter_context(finding_lengths(job.files(due[1:]), scratch))
            session.enter_context(ray_session(arguments.address, scratch, arguments.ray_metrics))
        if at_work and arguments.ray_metrics is not None:
            onlookers.append(RayMetrics())
            if arguments.address is None:
                _say(f"Metrics for Prometheus at http://127.0.0.1:{arguments.ray_metrics}/metrics")
        if retention is not None:
            onlookers.append(retention)
        if not arguments.resume:
            folder.create(job.description)
            hold.enter_context(folder.locked())
        session.enter_context(delivering(arguments.events, folder.path, _say))
        if at_work:
            states, exit_status = _drive(job, ended, limit, lengths(), status, onlookers, folder, arguments)
        else:
            states = tuple(ended[spec.name] for spec in job.specs)
            exit_status = exit_code(states, None)
            progress = progress_for(sys.stdout)
            progress.update(states)
            progress.close()
        session.close()
        states = tuple(with_record(state, recorded_frames(folder.stream(state.name))) for state in states)
        try:
            status.finish(states, exit_status)
            _make_overlays_whole(job, {spec.name for spec in due}, states, folder, arguments.save)
            replace_file(folder.path / "report.html", render_report(folder.path).encode())
        except OSError as error:
            raise SinkError(f"Cannot finish {folder.path}: {error.strerror}; free some space.") from None
    _say(_closing_words(folder, states, arguments))
    return exit_status


@contextmanager
def _monitored(address: MonitorAddress | None, live: Path | None) -> Iterator[list[Observer]]:
    """Serve the monitor's page if requested; yield its observer of the driver."""
    if address is None or live is None:
        yield []
        return
    board = Board(live)
    with serving(address, board) as url:
        live.mkdir(parents=True, exist_ok=True)
        _say(f"Look on at {url}")
        try:
            yield [board]
        finally:
            shutil.rmtree(live, ignore_errors=True)


class _Job:
    """The streams of this run, including those added to a watched list."""

    def __init__(
        self,
        streams: Sequence[ListedStream],
        arguments: Arguments,
        config: Config,
        folder: RunFolder,
        live: Path | None,
    ) -> None:
        self._streams = list(streams)
        self._arguments = arguments
        self._config = config
        self._folder = folder
        self._live = live
        self.description = self._described()
        self._watch = None
        if arguments.watch and arguments.streams is not None:
            unlisted = {stream.name for stream in streams if stream.line is None}
            self._watch = ListWatch(
                arguments.streams,
                [stream for stream in streams if stream.name not in unlisted],
                lambda name: name in unlisted or folder.stream(name).exists(),
                lambda text: _say(mask(text)),
            )

    @property
    def specs(self) -> list[StreamSpec]:
        """All streams, in the driver's form."""
        return [self._spec(stream) for stream in self._streams]

    def files(self, specs: Sequence[StreamSpec]) -> dict[str, SourceAddress]:
        """Return the sources of those of ``specs`` that are no cameras, by name."""
        names = {spec.name for spec in specs if spec.replayable}
        return {stream.name: stream.source for stream in self._streams if stream.name in names}

    def rules(self, name: str) -> EventRules:
        """Return what the events of a stream depend on."""
        return self._arguments.zones.rules_of(name, self._config.layers.dormant_frames)

    def changes(self) -> SpecChange | None:
        """Return changes to the list."""
        change = None if self._watch is None else self._watch.look()
        if change is None:
            return None
        self._streams += change.added
        self.description = self._described() | {"started": self.description["started"]}
        try:
            self._folder.redescribe(self.description)
        except OSError as error:
            _say(f"{self._folder.path}/run.json cannot be written: {error.strerror}; free some space.")
        return SpecChange(tuple(self._spec(stream) for stream in change.added), change.removed)

    def _described(self) -> dict[str, Any]:
        given = self._arguments
        command = given.command(f"{self._folder.path}-again")
        return describe_run(
            self._streams, self._config, given.save, given.max_frames, given.max_side, command,
            given.ignored.digests, given.zones.digest, given.segment, given.keep.words if given.keep else (),
        )  # fmt: skip

    def _spec(self, stream: ListedStream) -> StreamSpec:
        save, max_side = self._arguments.save, self._arguments.max_side
        reader: Callable[[], FrameReader] = partial(open_reader, stream.source)
        record = StreamRecord
        if max_side is not None:
            reader, record = partial(ShrinkingReader, reader, max_side), FullSizeRecord
        rules = self.rules(stream.name)
        picture = None
        if self._live is not None:
            picture = LivePicture(live_picture_path(self._live, stream.name), zones=rules.zones)
        folder = self._folder.stream(stream.name)
        replayable = stream.source.kind in (SourceKind.PATH, SourceKind.SYNTHETIC)
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
                replayable=replayable,
                source=stream.source,
                rules=rules,
                segment_seconds=None if replayable else self._arguments.segment,
            ),
            max_frames=self._arguments.max_frames,
            wants_background=ends_group if "background" in save else None,
            source=str(stream.source),
            line=stream.line,
            replayable=replayable,
            path=stream.source.path,
            ignored=self._arguments.ignored.mask_of(stream.name),
        )


def _announce(due: Sequence[StreamSpec], arguments: Arguments, limit: int, memory: NodeMemory) -> None:
    """Announce the run, and anything about it that may surprise."""
    count = count_of(len(due), "stream")
    if [spec.source for spec in due] == [DEMO]:
        _say(f"This is a built-in scene; for a video of your own: {command_line_of('VIDEO')}")
    if arguments.address is not None:
        _say(f"Joining Ray at {arguments.address}; {count}.")
        return
    room = f"{count_of(cores(), 'core')}, {memory.available / 2**30:.1f} GiB of memory"
    _say(f"Starting Ray; {count}, up to {limit} at a time ({room}).")
    if not has_machine_code():
        _say("This is the first run of this installation: it compiles for one to three minutes, once.")
    endless = sum(not spec.replayable and spec.max_frames is None for spec in due)
    if (warning := warn_of_cameras(endless, len(due), limit)) is not None:
        _say(warning)


def _drive(
    job: _Job,
    ended: Mapping[str, StreamState],
    limit: int,
    lengths: Mapping[str, int],
    status: StatusFile,
    onlookers: Sequence[Observer],
    folder: RunFolder,
    arguments: Arguments,
) -> tuple[tuple[StreamState, ...], int]:
    """Run the streams; return their final states, and the run's exit status."""
    output = sys.stdout
    # Ray prints its own warnings; standard output belongs to the progress.
    ray_log = folder.path / "ray.log"
    with ray_log.open("a", encoding="utf-8") as log, redirect_stdout(log), Interruption() as interruption:
        progress = progress_for(output)
        try:
            host: Node | Cluster
            most: int | Callable[[], int] = limit
            if arguments.address is None:
                # Only a watched list can get more.
                at_once = limit if arguments.watch else min(limit, len(job.specs) - len(ended))
                host = Node(policy=PoolPolicy(streams=at_once))
            else:
                host = Cluster(partial(places_here, folder.path), _say)
                most = host.places
            driver = Driver(
                job.specs,
                host,
                limit=most,
                observers=[status, *onlookers, progress],
                interruption=interruption,
                lengths=lengths,
                ended=ended,
                changes=job.changes if arguments.watch else None,
            )
            try:
                exit_status = driver.run()
            except StopAtOnce as stop:
                with suppress(OSError):
                    status.finish(stopped(driver.states), 128 + stop.signal_number)
                raise
            host.close()
        finally:
            progress.close()
    return driver.states, exit_status


def _make_overlays_whole(
    job: _Job,
    due: Collection[str],
    states: Sequence[StreamState],
    folder: RunFolder,
    save: frozenset[str],
) -> None:
    """Draw anew the overlays of ended streams that are in parts or, of the streams ``due``, were lost."""
    if not save >= {"overlay", "parquet"}:
        return
    ended = {
        state.name
        for state in states
        if state.state in ("done", "partial") and state.committed and not state.interrupted
    }
    for spec in job.specs:
        stream = folder.stream(spec.name)
        wanted = is_in_parts(stream) or (spec.name in due and is_lost(stream))
        if spec.replayable and spec.name in ended and wanted:
            try:
                make_whole(stream, spec.source, _say, job.rules(spec.name).zones)
            except KeyboardInterrupt:
                _say("The overlay stays as it is; to try again, give the same command with --resume.")
                return


def _not_to_be_resumed(folder: RunFolder, specs: Sequence[StreamSpec]) -> dict[str, StreamState]:
    """Select streams that are not resumed: those that ended, and cameras without a snapshot."""
    words = (
        "This camera's stream has no snapshot to continue from; what was committed is kept. "
        "Start it anew in another folder."
    )
    states, left = folder.states(), {}
    for spec in specs:
        state = replace(states.get(spec.name, StreamState(spec.name)), line=spec.line)
        frames = recorded_frames(folder.stream(spec.name))
        if state.state == "done" or (state.state == "partial" and not state.interrupted):
            left[spec.name] = state
        elif frames and not spec.replayable and not has_snapshot(folder.stream(spec.name)):
            counted = with_record(after_failure(state, words), frames)
            left[spec.name] = replace(counted, state="partial")
    return left


def _words_on_resuming(begun: Mapping[str, Any], description: Mapping[str, Any], ended: int) -> str:
    """Return what the user should know about the resumed run."""
    words = f"Going on with the run of {begun['started']}"
    words += f"; {count_of(ended, 'stream')} ended before." if ended else "."
    for key in ("versions", "machine"):
        if begun.get(key) != description[key]:
            words += f"\nThe {key} are not those of then (see run.json): label maps from here on may differ."
    return words


def _closing_words(folder: RunFolder, states: Sequence[StreamState], arguments: Arguments) -> str:
    done = sum(state.state == "done" for state in states)
    lines = [f"{done} of {count_of(len(states), 'stream')} complete. Results: {folder.path}"]
    lines += [
        f"  {f'line {state.line}, ' if state.line else ''}{state.name} ({state.state}): {state.error}"
        for state in states
        if state.error is not None
    ]
    lines += [f"  {state.name}: {note}" for state in states if (note := state.memory_note) is not None]
    lines += [
        f"  {state.name}: {remark}"
        for state in states
        for remark in stream_remarks(folder.stream(state.name))
    ]
    begun = [state.name for state in states if state.committed]
    if begun:
        lines.append(f"Look at {what_to_look_at(folder.stream(begun[0]), arguments.save)}")
        lines.append(f"and at {folder.path / 'report.html'}")
    if any(state.interrupted for state in states):
        but = ", without --watch" if arguments.watch else ""
        given = f"--resume --output {shlex.quote(str(folder.path))}"
        lines.append(f"To continue what was interrupted, give the same command with {given}{but}.")
    return "\n".join(lines)


def what_to_look_at(stream: Path, save: frozenset[str]) -> str:
    """Return the results of a stream that show its labels best: the videos, or the masks without any."""
    videos = overlays(stream)
    if not videos:
        in_archives = stream.is_dir() and segment_folders(stream)
        return str(stream / "masks" if "masks" in save and not in_archives else stream)
    # A resumed run has one for each start, that of a camera one for each segment.
    parts = stream / "overlay*.mp4" if videos[0][1].parent == stream else stream / "*/overlay*.mp4"
    return f"{videos[0][1]}" if len(videos) == 1 else f"{parts} ({len(videos)} parts)"


def _say(text: str) -> None:
    """Print a message on standard error: standard output is for the progress, which a program may read."""
    print(text, file=sys.stderr, flush=True)
