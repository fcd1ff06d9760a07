"""One run of the command, from the checked arguments to its exit status."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

from mlbs_actors.actors import Node
from mlbs_actors.actors.stream_protocol import StreamSpec
from mlbs_actors.config import Config
from mlbs_actors.errors import SinkError
from orchestrator.admission import available_memory, cores, places
from orchestrator.command_line import Arguments
from orchestrator.driver import Driver
from orchestrator.durable_files import replace_file
from orchestrator.interruption import Interruption
from orchestrator.progress import progress_for
from orchestrator.ray_session import ray_session
from orchestrator.report import render_report
from orchestrator.run_folder import RunFolder, StatusFile, describe_run
from orchestrator.sinks.record import StreamRecord, recorded_frames
from orchestrator.sources.address import SourceKind
from orchestrator.sources.opening import open_reader
from orchestrator.stream_list import ListedStream
from orchestrator.stream_state import StreamState, with_record

__all__ = ["run"]


def run(arguments: Arguments, streams: Sequence[ListedStream], config: Config, scratch: Path) -> int:
    """Segment all streams; return the exit status.

    Parameters
    ----------
    arguments : Arguments
    streams : sequence of ListedStream
        What ``arguments.streams`` lists.
    config : Config
        What ``arguments`` asks for.
    scratch : Path
        Folder for Ray's files, from :func:`orchestrator.ray_session.ray_settings`.

    Raises
    ------
    ConfigError
        If the output folder or the cluster cannot be used; nothing was started.
    MlbsError
        If Ray cannot be started, or the run's own files cannot be written.
    """
    folder = RunFolder(arguments.output.absolute())
    specs = [
        StreamSpec(
            name=stream.name,
            config=config,
            open_reader=partial(open_reader, stream.source),
            open_sink=partial(StreamRecord, folder.stream(stream.name), stream.name, arguments.save),
            max_frames=arguments.max_frames,
            replayable=stream.source.kind in (SourceKind.PATH, SourceKind.SYNTHETIC),
        )
        for stream in streams
    ]
    description = describe_run(streams, config, arguments.save, arguments.max_frames)
    ended: Mapping[str, StreamState] = {}
    limit = places(available_memory(), cores())
    with ExitStack() as stack:
        if arguments.resume:
            begun = folder.refuse_other(description)
            stack.enter_context(folder.held())
            ended = folder.ended() | _not_to_be_resumed(folder, specs)
            _say(_words_on_resuming(begun, description, len(ended)))
            description = begun
        else:
            folder.refuse_if_used([stream.name for stream in streams])
        _say(f"Starting Ray; {len(specs) - len(ended)} streams, up to {limit} at a time.")
        stack.enter_context(ray_session(arguments.address, scratch))
        if not arguments.resume:
            folder.claim(description)
            stack.enter_context(folder.held())
        status = StatusFile(folder.path / "status.json")
        states, exit_status = _drive(specs, ended, limit, status, folder.path / "ray.log")
    states = tuple(with_record(state, recorded_frames(folder.stream(state.name))) for state in states)
    try:
        status.finish(states, exit_status)
        report = render_report(description, states, exit_status)
        replace_file(folder.path / "report.html", report.encode())
    except OSError as error:
        raise SinkError(f"Cannot finish {folder.path}: {error.strerror}; free some space.") from None
    _say(_closing_words(folder, states, arguments.save))
    return exit_status


def _drive(
    specs: Sequence[StreamSpec],
    ended: Mapping[str, StreamState],
    limit: int,
    status: StatusFile,
    ray_log: Path,
) -> tuple[tuple[StreamState, ...], int]:
    output = sys.stdout
    # Ray prints its own warnings; standard output belongs to the progress.
    with ray_log.open("a", encoding="utf-8") as log, redirect_stdout(log), Interruption() as interruption:
        progress = progress_for(output)
        try:
            node = Node()
            driver = Driver(
                specs,
                node,
                limit=limit,
                observers=[status, progress],
                interruption=interruption,
                ended=ended,
            )
            exit_status = driver.run()
            node.close()
        finally:
            progress.close()
    return driver.states, exit_status


def _not_to_be_resumed(folder: RunFolder, specs: Sequence[StreamSpec]) -> dict[str, StreamState]:
    """Cameras that have begun: what they showed meanwhile is lost, so their records are left as they are."""
    begun = {spec.name: recorded_frames(folder.stream(spec.name)) for spec in specs if not spec.replayable}
    words = (
        "A camera's stream cannot be resumed; what was committed is kept. Start it anew in another folder."
    )
    return {
        name: StreamState(name, "partial", read=frames, committed=frames, error=words)
        for name, frames in begun.items()
        if frames
    }


def _words_on_resuming(begun: Mapping[str, Any], description: Mapping[str, Any], ended: int) -> str:
    """What the user should know of a run that is gone on with."""
    words = f"Going on with the run of {begun['started']}; {ended} streams have ended already."
    for key in ("versions", "machine"):
        if begun.get(key) != description[key]:
            words += f"\nThe {key} are not those of then (see run.json): label maps from here on may differ."
    return words


def _closing_words(folder: RunFolder, states: Sequence[StreamState], save: frozenset[str]) -> str:
    done = sum(state.state == "done" for state in states)
    lines = [f"{done} of {len(states)} streams are complete. Results: {folder.path}"]
    lines += [f"  {state.name} ({state.state}): {state.error}" for state in states if state.error is not None]
    lines += [
        f"  {state.name}: {error.read_text(encoding='utf-8').strip()}"
        for state in states
        if (error := folder.stream(state.name) / "overlay.error").exists()
    ]
    begun = [state.name for state in states if state.committed]
    if begun:
        lines.append(f"Look at {_what_to_look_at(folder.stream(begun[0]), save)}")
        lines.append(f"and at {folder.path / 'report.html'}")
    return "\n".join(lines)


def _what_to_look_at(stream: Path, save: frozenset[str]) -> Path:
    overlays = sorted(stream.glob("overlay*.mp4"))
    if overlays:
        return overlays[-1]
    return stream / "masks" if "masks" in save else stream


def _say(text: str) -> None:
    """Tell the user; standard output is left to the progress, which a program may read."""
    print(text, file=sys.stderr, flush=True)
