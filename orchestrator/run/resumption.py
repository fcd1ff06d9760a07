"""A run in a folder that holds one already: which streams continue, which have ended, what has changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mlbs_actors.actors.stream.protocol import StreamSpec
from mlbs_actors.errors import ConfigError
from mlbs_actors.wording import count_of
from orchestrator.credentials import MASK
from orchestrator.options import recorded
from orchestrator.run.cameras_file import parse_cameras
from orchestrator.run.edited_files import newest_version
from orchestrator.run.identity import other_source
from orchestrator.run.listed_stream import ListedStream, StreamsFile
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_settings import words_of_changes
from orchestrator.run.stream_state import ENDED, StreamState, after_failure, has_ended, with_record
from orchestrator.sinks.record import has_snapshot, recorded_frames
from orchestrator.sources.address import SourceAddress, parse_address

__all__ = [
    "Outset",
    "earlier_streams",
    "ended_before",
    "gone_from_list",
    "is_known",
    "outset_of",
    "with_new_names",
    "without_source",
    "words_on_resuming",
]


def earlier_streams(folder: RunFolder, near: Path) -> StreamsFile:
    """Return the streams as they were in force, of which addresses with passwords are not known any more.

    Parameters
    ----------
    folder : RunFolder
    near : Path
        The file that named them.
    """
    cameras = newest_version(folder.path, "cameras")
    if cameras is not None:
        with suppress(ConfigError):
            return replace(parse_cameras(cameras, near.parent), targets=None)
    states, known = folder.states(), []
    for name, source in folder.description().get("sources", {}).items():
        if name not in states or states[name].line is not None:  # else it has left the list
            with suppress(ConfigError):  # of an earlier version
                known.append(ListedStream(name, parse_address(source, near.parent), 1))
    return StreamsFile(tuple(known), {})


def with_new_names(
    folder: RunFolder,
    begun: Mapping[str, Any],
    streams: Sequence[ListedStream],
    say: Callable[[str], None],
    rename: Callable[[str, str], None],
) -> dict[str, Any]:
    """Give records of streams that had another name the one of now; return the run's description with it.

    That is done where there is a record of the name before and none of this one. OSError as the disk says.
    """
    sources = dict(begun.get("sources", {}))
    for stream in streams:
        if stream.was is None or stream.was not in sources:
            continue
        before, now = folder.stream(stream.was), folder.stream(stream.name)
        if before.is_dir() and not now.exists():
            rename(stream.was, stream.name)
            say(f"{stream.was} is {stream.name} now, with all that was recorded of it.")
            sources[stream.name] = sources.pop(stream.was)
    return {**begun, "sources": sources}


def is_known(source: SourceAddress) -> bool:
    """Whether no part of an address is hidden."""
    return MASK not in source.location


@dataclass(frozen=True, slots=True)
class Outset:
    """Which streams a run begins with.

    Attributes
    ----------
    streams : tuple of ListedStream
        Those that it has; without ``--watch`` also those that have failed already.
    faults : mapping of str to str
        Names of those that cannot run → why, a sentence.
    ended : mapping of str to StreamState
        Streams that are not started.
    """

    streams: tuple[ListedStream, ...]
    faults: Mapping[str, str]
    ended: Mapping[str, StreamState]


def outset_of(
    folder: RunFolder,
    streams: Sequence[ListedStream],
    recorded: Mapping[str, str],
    missing: Mapping[str, str],
    *,
    watch: bool,
) -> Outset:
    """Return which streams begin.

    Parameters
    ----------
    folder : RunFolder
    streams : sequence of ListedStream
        That are listed.
    recorded : mapping of str to str
        Names of streams with a record → their sources.
    missing : mapping of str to str
        Names of streams without a source → what is wrong.
    watch : bool
        Whether what cannot run is ignored until it is corrected, or else fails.
    """
    if not watch:
        failed = {one.name: without_source(one, missing[one.name]) for one in streams if one.name in missing}
        return Outset(tuple(streams), missing, failed)
    faults = dict(missing)
    for stream in streams:
        fault = other_source(stream, recorded[stream.name]) if stream.name in recorded else None
        if fault is not None:
            faults[stream.name] = f"{fault[0].upper()}{fault[1:]}."
    usable = tuple(stream for stream in streams if stream.name not in faults)
    return Outset(usable, faults, gone_from_list(folder, recorded, usable, faults))


def without_source(stream: ListedStream, fault: str) -> StreamState:
    """Return the state of a stream whose source is missing or cannot be read."""
    return after_failure(StreamState(stream.name, line=stream.line), fault)


def ended_before(folder: RunFolder, specs: Sequence[StreamSpec]) -> dict[str, StreamState]:
    """Select streams that do not continue: those that have ended, and cameras without a snapshot."""
    words = (
        "This camera's stream has no snapshot to continue from; what was committed is kept. "
        "Start it anew in another folder."
    )
    states, ended = folder.states(), {}
    for spec in specs:
        state = replace(states.get(spec.name, StreamState(spec.name)), line=spec.line)
        frames = recorded_frames(folder.stream(spec.name))
        if has_ended(state):
            ended[spec.name] = state
        elif frames and spec.live and not has_snapshot(folder.stream(spec.name)):
            counted = with_record(after_failure(state, words), frames)
            ended[spec.name] = replace(counted, state="partial")
    return ended


def gone_from_list(
    folder: RunFolder, recorded: Mapping[str, str], listed: Sequence[ListedStream], faults: Mapping[str, str]
) -> dict[str, StreamState]:
    """Return the states of streams with a record that the list does not name any more, or wrongly.

    Parameters
    ----------
    folder : RunFolder
    recorded : mapping of str to str
        Names of streams with a record → their sources.
    listed : sequence of ListedStream
        The usable lines.
    faults : mapping of str to str
        Names in other lines → a sentence about the line.
    """
    states, gone = folder.states(), {}
    for name in sorted(recorded.keys() - {stream.name for stream in listed}):
        state = replace(states.get(name, StreamState(name)), line=None)
        counted = with_record(
            after_failure(state, faults.get(name, "")), recorded_frames(folder.stream(name))
        )
        if name in faults:
            gone[name] = counted
        elif state.state in ENDED:
            gone[name] = state
        else:
            gone[name] = replace(counted, state="done", error=None, interrupted=True)
    return gone


def words_on_resuming(begun: Mapping[str, Any], description: Mapping[str, Any], ended: int) -> str:
    """Return what the user should know about the resumed run."""
    words = f"Going on with the run of {begun['started']}"
    words += f"; {count_of(ended, 'stream')} ended before." if ended else "."
    if begun.get("zones") != description["zones"]:
        words += "\nThe zones are others than then: events follow them from here on."
    for key in (*recorded({}).keys() - {"zones"}, "config"):
        if key in begun and begun[key] != description[key]:
            changes = words_of_changes(begun[key], description[key])
            words += f"\nOf cameras {key} is another one from here on: {changes}."
    for key in ("versions", "machine"):
        if begun.get(key) != description[key]:
            words += f"\nThe {key} are not those of then (see run.json): label maps from here on may differ."
    return words
