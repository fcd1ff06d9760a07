"""One run of the command, from the checked arguments to its exit status."""

from __future__ import annotations

import shutil
import sqlite3
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from mlbs_actors.actors.node.memory import node_memory
from mlbs_actors.actors.stream.protocol import StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, SinkError
from mlbs_actors.kernels.machine_code import has_machine_code
from mlbs_actors.wording import count_of
from orchestrator.clips.clips import Clips
from orchestrator.counts.stream_counts import CountReader
from orchestrator.credentials import mask
from orchestrator.events.delivery import OUTBOX, Deliveries
from orchestrator.events.targets import all_targets
from orchestrator.interruption import Interruption, StopAtOnce
from orchestrator.log import Log
from orchestrator.monitor.board import Board
from orchestrator.monitor.ray_metrics import RayMetrics
from orchestrator.monitor.server import serving
from orchestrator.options import Arguments
from orchestrator.program import command_line_of
from orchestrator.progress import progress_for
from orchestrator.ray_head import RayHead
from orchestrator.ray_session import joined_ray
from orchestrator.report.page import render_report
from orchestrator.run.admission import cores
from orchestrator.run.argument_streams import DEMO
from orchestrator.run.closing_words import closing_words
from orchestrator.run.driver import Driver, KnownStreams, Observer
from orchestrator.run.edit_zones import ZoneFiles
from orchestrator.run.expected_time import words_on_expected_time
from orchestrator.run.hosting import Room, admission_to, host_of
from orchestrator.run.job import Job
from orchestrator.run.listed_stream import StreamsFile
from orchestrator.run.makings import make_of_all
from orchestrator.run.need import need_of
from orchestrator.run.publication import Publication
from orchestrator.run.resumption import (
    ended_before,
    outset_of,
    with_new_names,
    without_source,
    words_on_resuming,
)
from orchestrator.run.retention import Retention
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import STATUS, StatusFile
from orchestrator.run.stream_list import cameras_file, refuse_if_all
from orchestrator.run.stream_state import StreamState, exit_code, stopped, with_record
from orchestrator.run.whole_overlays import make_all_whole
from orchestrator.sinks.record import recorded_frames
from orchestrator.sources.survey import SourceContent, surveying
from orchestrator.storage.durable_files import replace_file

__all__ = ["run"]

#: How long files are looked into before streams start, s; faults of the rest are found when their turn comes.
_SURVEY_SECONDS = 5.0


def run(
    arguments: Arguments,
    listed: StreamsFile,
    missing: Mapping[str, str],
    config: Config,
    scratch: Path,
    head: RayHead | None,
    log: Log,
    publication: Publication,
) -> int:
    """Segment all streams; return the exit status.

    Parameters
    ----------
    arguments : Arguments
    listed : StreamsFile
        What the list says, with the streams of the arguments behind its own.
    missing : mapping of str to str
        Streams without a source → what is wrong; they fail, the others run.
    config : Config
        The parameters according to ``arguments``.
    scratch : Path
        Folder for Ray's files, from :func:`orchestrator.ray_session.ray_settings`.
    head : RayHead, optional
        Of a Ray of our own, from :func:`orchestrator.ray_session.starting_ray`.
    log : Log
        Receives messages and progress.
    publication : Publication
        Has begun.

    Raises
    ------
    ConfigError
        If the output folder or the cluster cannot be used, or no source can be read; no stream was started.
    MlbsError
        If Ray cannot be started, or the run's own files cannot be written.
    """
    folder = RunFolder(arguments.output.resolve())
    with ExitStack() as hold, ExitStack() as session:  # the folder is locked until its last file is written
        targets = None if listed.targets is None else all_targets(arguments.events, listed.targets)
        deliveries = Deliveries(targets, folder.path, log.warn, _page_of(arguments), lambda: job.cameras())
        publication.start({OUTBOX: deliveries.copy_outbox})
        if targets is None:
            log.say("Where events are sent is not known until the list can be read; they wait.", "error")
        begun = None
        if arguments.resume and folder.holds_run:
            hold.enter_context(folder.locked())
            begun = _taken_up(folder, listed, deliveries, log)
        recorded = {} if begun is None else folder.recorded_sources(begun)
        outset = outset_of(folder, listed.streams, recorded, missing, watch=arguments.watch)
        ended, faults = dict(outset.ended), dict(outset.faults)
        # On a cluster the pictures come from other machines, through the shared folder.
        live = (
            None if arguments.monitor is None else (folder.path if arguments.address else scratch) / ".live"
        )
        before = None if begun is None else begun | {"sources": recorded if arguments.watch else {}}
        job = Job(
            replace(listed, streams=outset.streams),
            arguments,
            config,
            folder,
            live,
            log.warn,
            deliveries,
            before,
        )
        retention = Retention(folder.path, job.keeps, log.warn)
        status = StatusFile(
            folder.path / STATUS,
            kept=lambda: retention.figures,
            backlogs=deliveries.backlogs,
            published=lambda: publication.figures,
        )
        if begun is not None:
            folder.refuse_other(begun, job.description)
            earlier = ended_before(folder, job.specs)
            log.say(words_on_resuming(begun, job.description, len(earlier)))
            ended |= earlier
        else:
            folder.refuse_if_used([stream.name for stream in outset.streams])
            if arguments.resume:
                log.say(f"There is no run in {folder.path} yet; this is its first start.")
        due = [spec for spec in job.specs if spec.name not in ended]
        survey = session.enter_context(surveying(job.files(due), scratch))
        contents = survey.begin(_SURVEY_SECONDS)
        if not arguments.watch:
            bad = {name: mask(content.fault) for name, content in contents.items() if content.fault}
            refuse_if_all(arguments.streams, listed.streams, {**missing, **bad})
            ended |= {
                one.name: without_source(one, bad[one.name]) for one in listed.streams if one.name in bad
            }
            faults |= bad
            due = [spec for spec in due if spec.name not in bad]
        sizes = [None] if arguments.watch else [contents.get(one.name, SourceContent()).size for one in due]
        room = Room(node_memory(), need_of(arguments.reserve, sizes))
        for stream in listed.streams:
            if stream.name in faults:
                place = f"{arguments.streams}, line {stream.line}: " if stream.line else ""
                log.say(place + faults[stream.name], "error", stream.name)
        onlookers: list[Observer] = []
        if at_work := bool(due) or arguments.watch:
            monitored = _monitored(arguments, live, folder.path, deliveries, log)
            onlookers = session.enter_context(monitored)
            _announce(due, arguments, room, contents, log)
            session.enter_context(joined_ray(arguments.address, head))
        if at_work and arguments.ray_metrics is not None:
            onlookers.append(RayMetrics(deliveries.backlogs, counts=CountReader(folder.path).of))
            if arguments.address is None:
                log.say(f"Metrics for Prometheus at http://127.0.0.1:{arguments.ray_metrics}/metrics")
        onlookers += [retention, publication]
        if begun is None:
            folder.create(job.description)
            hold.enter_context(folder.locked())
        job.keep_description(listed.text)
        session.enter_context(deliveries)
        if arguments.clips is not None:
            session.enter_context(Clips(arguments.clips, folder.path, job.video, log.warn))
        if at_work:
            known = KnownStreams(
                {name: one.length for name, one in survey.finish().items() if one.length is not None},
                {name: one.cores or one.earlier_cores for name, one in folder.states().items()},
                ended,
            )
            states, exit_status = _drive(job, known, room, status, onlookers, folder, arguments, log)
        else:
            states = tuple(ended[spec.name] for spec in job.specs)
            exit_status = exit_code(states, None)
            progress = progress_for(sys.stdout, log)
            progress.update(states)
            progress.close()
        session.close()
        states = tuple(with_record(state, recorded_frames(folder.stream(state.name))) for state in states)
        try:
            status.finish(states, exit_status)
            _make_what_is_due(job, {spec.name for spec in due}, states, folder, arguments, log)
        except OSError as error:
            raise SinkError(f"Cannot finish {folder.path}: {error.strerror}; free some space.") from None
    log.say(closing_words(folder, states, arguments))
    return exit_status


def _taken_up(folder: RunFolder, listed: StreamsFile, deliveries: Deliveries, log: Log) -> dict[str, Any]:
    """Give the streams of the run in a folder the names of now; return its description."""
    try:
        return with_new_names(folder, folder.description(), listed.streams, log.say, deliveries.rename)
    except (OSError, sqlite3.Error) as error:
        raise ConfigError(f"Cannot write to {folder.path}: {error}.") from None


def _make_what_is_due(
    job: Job,
    due: Collection[str],
    states: Sequence[StreamState],
    folder: RunFolder,
    arguments: Arguments,
    log: Log,
) -> None:
    """Make of the records of a run that has ended whole overlays, the report, and what ``--make`` names."""
    overlays = arguments.save >= {"overlay", "parquet"}
    goes_on = not overlays or make_all_whole(job, due, states, folder, log.warn)
    replace_file(folder.path / "report.html", render_report(folder.path).encode())
    if goes_on:
        make_of_all(arguments.make, job, due, states, folder, log.say)


def _page_of(arguments: Arguments) -> str | None:
    """Return the address of the live page for links, if it is known."""
    monitor = arguments.monitor
    if arguments.page is not None or monitor is None or not monitor.port or monitor.host in ("0.0.0.0", "::"):
        return arguments.page
    return f"http://{monitor.host}:{monitor.port}"


@contextmanager
def _monitored(
    arguments: Arguments, live: Path | None, folder: Path, deliveries: Deliveries, log: Log
) -> Iterator[list[Observer]]:
    """Serve the monitor's page if requested; yield its observer of the driver."""
    if arguments.monitor is None or live is None:
        yield []
        return
    zones = ZoneFiles(cameras_file(arguments.streams), arguments.zones.path, arguments.watch)
    board = Board(live, folder, deliveries.backlogs)
    with serving(arguments.monitor, board, zones) as url:
        live.mkdir(parents=True, exist_ok=True)
        log.say(f"Look on at {url}")
        try:
            yield [board]
        finally:
            shutil.rmtree(live, ignore_errors=True)


def _announce(
    due: Sequence[StreamSpec],
    arguments: Arguments,
    room: Room,
    contents: Mapping[str, SourceContent],
    log: Log,
) -> None:
    """Announce the run, and anything about it that may surprise."""
    count = count_of(len(due), "stream")
    if [spec.source for spec in due] == [DEMO]:
        log.say(f"This is a built-in scene; for a video of your own: {command_line_of('VIDEO')}")
    if arguments.address is not None:
        log.say(f"Joining Ray at {arguments.address}; {count}.")
        return
    machine = f"{count_of(cores(), 'core')}, {room.memory.available / 2**30:.1f} GiB of memory"
    at_once = f"up to {arguments.places or room.places} at a time"
    if _allowed(arguments, room) is None and any(spec.live for spec in due):
        at_once = f"files {at_once}, cameras as long as CPU time and memory last"
    log.say(f"Starting Ray; {count}, {at_once} ({machine}).")
    files = [contents.get(spec.name, SourceContent()) for spec in due if not spec.live]
    if words := words_on_expected_time(files, cores(), arguments.max_frames, arguments.max_side):
        log.say(words)
    if not has_machine_code():
        log.say("This is the first run of this installation: it compiles for one to three minutes, once.")


def _drive(
    job: Job,
    known: KnownStreams,
    room: Room,
    status: StatusFile,
    onlookers: Sequence[Observer],
    folder: RunFolder,
    arguments: Arguments,
    log: Log,
) -> tuple[tuple[StreamState, ...], int]:
    """Run the streams; return their final states, and the run's exit status."""
    output = sys.stdout
    # Ray prints its own warnings; standard output belongs to the progress.
    ray_log = folder.path / "ray.log"
    with (
        ray_log.open("a", encoding="utf-8") as of_ray,
        redirect_stdout(of_ray),
        Interruption(log.say) as interruption,
    ):
        log.on_reader_gone = interruption.ask
        status.stopping = lambda: interruption.signal_number is not None
        progress = progress_for(output, log)
        try:
            most = _most_at_once(job, known.ended, room, arguments)
            host = host_of(folder.path, most, room.need, log.warn, shared=arguments.address is not None)
            driver = Driver(
                job.specs,
                host,
                admission=admission_to(host, room, _allowed(arguments, room)),
                observers=[status, *onlookers, progress],
                interruption=interruption,
                known=known,
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


def _allowed(arguments: Arguments, room: Room) -> int | None:
    """Return how many streams the user allows at once, whatever they take; None for what fits."""
    if arguments.places is None and arguments.reserve is not None and arguments.address is None:
        return room.places
    return arguments.places


def _most_at_once(job: Job, ended: Mapping[str, StreamState], room: Room, arguments: Arguments) -> int:
    """Return for how many streams this machine's memory is reserved."""
    due = [spec for spec in job.specs if spec.name not in ended]
    most = room.places_by_memory if any(spec.live for spec in due) else room.places
    most = _allowed(arguments, room) or most
    return most if arguments.watch else min(most, len(due))  # only a watched list can get more
