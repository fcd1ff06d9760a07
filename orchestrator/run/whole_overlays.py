"""One overlay for a stream that went back to a snapshot or was resumed.

Until then its video is in parts: that of a killed run is lost, and that of an interrupted one ends with label
maps that do not count any more. Once the stream has ended, it is drawn anew from the record and the source.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from orchestrator.events.zones import Zone
from orchestrator.pictures.content import DEFAULT_DRAWING, Drawing
from orchestrator.run.job import Job
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_state import StreamState, has_ended
from orchestrator.sinks.overlay import forget_overlay, move_overlay, overlay_path

__all__ = ["is_in_parts", "is_lost", "make_all_whole", "make_whole"]

#: The new overlay before it replaces the parts.
_DRAFT = ".overlay-whole.mp4"


def make_all_whole(
    job: Job,
    due: Collection[str],
    states: Sequence[StreamState],
    folder: RunFolder,
    say: Callable[[str], None],
) -> bool:
    """Draw anew the overlays of ended streams that are in parts or, of the streams ``due``, were lost.

    A signal ends it, but not the run: see :mod:`orchestrator.early_signals`. Returns whether none came.
    """
    ended = {state.name for state in states if state.committed and has_ended(state)}
    for spec in job.specs:
        stream = folder.stream(spec.name)
        wanted = is_in_parts(stream) or (spec.name in due and is_lost(stream))
        if not spec.live and spec.name in ended and wanted:
            asked = job.settings(spec.name)
            try:
                make_whole(stream, spec.source, say, asked.rules.zones, asked.drawing)
            except SystemExit:  # a signal; the run is complete without it
                say(
                    f"The overlay of {spec.name} stays as it is; to go on, give the same command with "
                    "--resume."
                )
                return False
    return True


def is_in_parts(folder: Path) -> bool:
    """Whether a part of a stream's overlay begins, or should, later than the stream."""
    return any(folder.glob("overlay-*"))


def is_lost(folder: Path) -> bool:
    """Whether there is no overlay, nor a reason why it could not be written."""
    return not any(folder.glob("overlay*"))


def make_whole(
    folder: Path,
    source: str,
    say: Callable[[str], None],
    zones: Sequence[Zone] = (),
    drawing: Drawing = DEFAULT_DRAWING,
) -> None:
    """Replace the parts of a stream's overlay by one video; keep them if it cannot be drawn.

    Parameters
    ----------
    folder : Path
        Of the stream.
    source : str
        Its address.
    say : callable
        Takes a sentence for the user.
    zones : sequence of Zone
        Drawn over every frame.
    drawing : Drawing
        What is drawn beside them.
    """
    # Imported here, because it imports the engine, which the driver needs for nothing else.
    from orchestrator.export.overlay import draw_overlay

    say(f"Drawing the overlay of {folder.name} anew, in one piece.")
    draft = folder / _DRAFT
    try:
        remarks = draw_overlay(folder, source, draft, zones, drawing)
        if remarks:
            say(f"The overlay of {folder.name} stays as it is. {' '.join(remarks)}")
            return
        for part in folder.glob("overlay*"):
            part.unlink()
        move_overlay(draft, overlay_path(folder, 0))
    finally:
        forget_overlay(draft)
