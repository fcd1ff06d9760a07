"""The contents of a stream's snapshot, and how each process writes its own part beside its work.

Each process writes files of its own into the snapshot's folder: no state passes through another process. All
are asked between the same two frames, so the states belong together whenever they reach the disk.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

from mlbs_actors.messages import LayerKind, Segmentation
from mlbs_actors.source import SourceFrame, SourcePosition, SourceStatus
from mlbs_actors.state_file import CapturedState, capture
from mlbs_actors.stored_motion import FollowedFrame

__all__ = [
    "CONDUCTOR_FILE",
    "COORDINATOR_FILE",
    "PUBLISHED_FILE",
    "SEGMENTER_FILE",
    "ConductorState",
    "PublishedState",
    "SavedLayer",
    "StateWriter",
    "layer_file",
]

_log = logging.getLogger(__name__)

#: Files of a snapshot, besides one for each layer.
CONDUCTOR_FILE, COORDINATOR_FILE = "conductor", "coordinator"
SEGMENTER_FILE, PUBLISHED_FILE = "segmenter", "published"


def layer_file(layer: int) -> str:
    """Return the name of a layer's file."""
    return f"layer-{layer}"


@dataclass(frozen=True, slots=True)
class SavedLayer:
    """A live layer.

    Attributes
    ----------
    layer : int
    kind : {"background", "object", "other"}
    last_frame : int
        Last frame requested of it, −1 for none.
    """

    layer: int
    kind: LayerKind
    last_frame: int


@dataclass(frozen=True, slots=True)
class ConductorState:
    """Work under way in a stream, as its coordinator tracks it.

    Attributes
    ----------
    counts : mapping of str to int
        Frames taken from the source, by their status.
    position : SourcePosition
    waiting : tuple of SourceFrame
        Read and not yet labelled, in source order.
    layers : tuple of SavedLayer
    config : str
        All parameters, as JSON.
    followed : tuple of FollowedFrame
        The newest frames, if their motion is stored.
    """

    counts: Mapping[SourceStatus, int]
    position: SourcePosition
    waiting: tuple[SourceFrame, ...]
    layers: tuple[SavedLayer, ...]
    config: str
    followed: tuple[FollowedFrame, ...]


@dataclass(frozen=True, slots=True)
class PublishedState:
    """The newest label maps.

    Attributes
    ----------
    segmentations : tuple of Segmentation
        At most two, oldest first.
    """

    segmentations: tuple[Segmentation, ...]


class StateWriter:
    """Writes the states of one process in a thread of its own, one set after the other."""

    def __init__(self) -> None:
        self._thread: Thread | None = None

    def write(self, states: Mapping[str, object], folder: Path) -> None:
        """Copy the states and return; a thread writes the files.

        If a file cannot be written the snapshot is incomplete, and the one before stays the newest.

        Parameters
        ----------
        states : mapping of str to dataclass
            By file name.
        folder : Path
            Created if missing.
        """
        captured = {name: capture(state) for name, state in states.items()}
        self.finish()  # at most one set of copies in memory
        self._thread = Thread(target=_write, args=(captured, folder))
        self._thread.start()

    def finish(self) -> None:
        """Wait until all files have been handed to the disk."""
        if self._thread is not None:
            self._thread.join()


def _write(captured: Mapping[str, CapturedState], folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, state in captured.items():
            state.write(folder / name)
    except OSError as error:
        _log.warning("The snapshot %s cannot be written: %s.", folder, error.strerror)
