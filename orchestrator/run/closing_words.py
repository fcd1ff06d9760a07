"""What a run says last."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from mlbs_actors.wording import count_of
from orchestrator.options import Arguments
from orchestrator.program import command_line_of
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.overlay import overlays, stream_remarks
from orchestrator.storage.segments import segment_folders

__all__ = ["closing_words", "what_to_look_at"]


def closing_words(folder: RunFolder, states: Sequence[StreamState], arguments: Arguments) -> str:
    """Return what a run says last: how many streams are complete, what others lack, where to look."""
    done = sum(state.state == "done" for state in states)
    lines = [f"{done} of {count_of(len(states), 'stream')} complete. Results: {arguments.results}"]
    lines += [
        f"  {f'line {state.line}, ' if state.line else ''}{state.name} ({state.state}): {state.error}"
        for state in states
        if state.error is not None
    ]
    lines += [
        f"  {one.name}: no picture has come from it"
        for one in states
        if one.state == "done" and one.live and not one.read
    ]
    lines += [f"  {state.name}: {note}" for state in states if (note := state.memory_note) is not None]
    lines += [
        f"  {state.name}: {remark}"
        for state in states
        for remark in stream_remarks(folder.stream(state.name))
    ]
    begun = [state.name for state in states if state.committed]
    if arguments.store is not None:
        lines.append(f"Fetch them: {command_line_of('fetch', arguments.results, 'DIR')}")
    elif begun:
        lines.append(f"Look at {what_to_look_at(folder.stream(begun[0]), arguments.save)}")
        lines.append(f"and at {folder.path / 'report.html'}")
    if any(state.interrupted for state in states):
        given = f"--resume --output {shlex.quote(arguments.results)}"
        lines.append(f"To continue what was interrupted, give the same command with {given}.")
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
