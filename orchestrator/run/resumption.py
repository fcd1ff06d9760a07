"""A run in a folder that holds one already: which streams continue, which have ended, what has changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from mlbs_actors.actors.stream.protocol import StreamSpec
from mlbs_actors.wording import count_of
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_list import ListedStream
from orchestrator.run.stream_state import ENDED, StreamState, after_failure, has_ended, with_record
from orchestrator.sinks.record import has_snapshot, recorded_frames

__all__ = ["changed_sources", "ended_before", "gone_from_list", "words_on_resuming"]


def changed_sources(streams: Sequence[ListedStream], recorded: Mapping[str, str]) -> dict[str, str]:
    """Find streams whose names stand for other sources than in the record.

    Parameters
    ----------
    streams : sequence of ListedStream
    recorded : mapping of str to str
        Names of streams with a record → their sources.

    Returns
    -------
    dict of str to str
        Stream name → a sentence.
    """
    return {
        stream.name: f"The name {stream.name!r} stands for {recorded[stream.name]} in this run; "
        "choose another one."
        for stream in streams
        if recorded.get(stream.name, str(stream.source)) != str(stream.source)
    }


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
    for key in ("versions", "machine"):
        if begun.get(key) != description[key]:
            words += f"\nThe {key} are not those of then (see run.json): label maps from here on may differ."
    return words
