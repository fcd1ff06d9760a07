"""What the processes of a stream say to each other, in the order in which a frame passes through them.

========================  =============================================================================
coordinator → reader      ``ReadNext``, answered by a ``ReaderAnswer``; ``Skip``, or, of a live source,
                          ``Forget`` and ``Reopen``
coordinator → segmenter   ``FrameWork``, answered by a ``LabelledFrame``; ``Retirement``, ``SaveState``
segmenter → layer         ``LayerStart``; ``LayerStep``, answered by the references of a posterior and, if
                          wanted, of the remembered colours; ``SaveState``
coordinator → sink        ``LabelRow`` and ``GapRow``, several in a call through Ray
========================  =============================================================================

All but the last go through pipes (:mod:`mlbs_actors.actors.ipc.channels`). They only refer to pictures and to
the messages of the engine's parts (:mod:`mlbs_actors.messages`), which are in shared memory. A request brings
the slot for its answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from mlbs_actors.actors.ipc.channels import ChannelAddress
from mlbs_actors.actors.ipc.shared_memory import Shared, Slot
from mlbs_actors.actors.stream.saved_states import SavedLayer
from mlbs_actors.messages import FrameEvidence, LayerAppearance, Segmentation
from mlbs_actors.pickling import pickled_by_values
from mlbs_actors.source import FrameReader, GapStatus, SourceFrame, SourceSilence
from mlbs_actors.state_file import CapturedState

__all__ = [
    "AssignedProcess",
    "Forget",
    "FrameWork",
    "GapRow",
    "LabelRow",
    "LabelledFrame",
    "LayerStart",
    "LayerStep",
    "ReadNext",
    "ReaderAnswer",
    "Reopen",
    "Retirement",
    "SaveState",
    "Skip",
]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class ReadNext:
    """Requests a reader's next row.

    Attributes
    ----------
    slot : Slot
        For a picture.
    fresh : bool
        Whether to wait for a live source; else only rows that it keeps are wanted.
    """

    slot: Slot
    fresh: bool = True


@dataclass(frozen=True, slots=True)
class Skip:
    """Requests a reader to skip frames."""

    frames: int


@dataclass(frozen=True, slots=True)
class Forget:
    """Reports to a live reader that rows before this number will not be read again."""

    rows: int


@dataclass(frozen=True, slots=True)
class Reopen:
    """Has a live reader read from another place: what ``open_reader`` opens.

    It may come twice, with the same number.
    """

    open_reader: Callable[[], FrameReader]
    number: int


#: Answer of a reader to a request for its next row: a picture's reference, a row without one, or the end.
ReaderAnswer: TypeAlias = "Shared[SourceFrame] | SourceFrame | SourceSilence | None"


@pickled_by_values
@dataclass(frozen=True, slots=True)
class AssignedProcess:
    """A process newly assigned to a layer.

    Attributes
    ----------
    layer : int
    address : ChannelAddress
        Of the process.
    state : Slot
        For moving the layer's state there.
    """

    layer: int
    address: ChannelAddress
    state: Slot


@pickled_by_values
@dataclass(frozen=True, slots=True)
class FrameWork:
    """A frame to label, once the one before it is labelled.

    Attributes
    ----------
    evidence, frame : Shared
    answer : Slot
        For the label map.
    posteriors : tuple of Slot
        For the answers of the evidence's layers, in ascending id.
    assigned : tuple of AssignedProcess
        New processes of layers of the evidence.
    background : Slot, optional
        For the background's remembered colours after this frame; None if not wanted.
    """

    evidence: Shared[FrameEvidence]
    frame: Shared[SourceFrame]
    answer: Slot
    posteriors: tuple[Slot, ...]
    assigned: tuple[AssignedProcess, ...]
    background: Slot | None

    @property
    def inner_slots(self) -> tuple[Slot, ...]:
        """The slots that only the segmenter and the layers read."""
        return (self.evidence.slot, *self.posteriors, *(one.state for one in self.assigned))


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LabelledFrame:
    """The result of a :class:`FrameWork`.

    Attributes
    ----------
    frame_index : int
    segmentation : Shared
    background : Shared, optional
    """

    frame_index: int
    segmentation: Shared[Segmentation]
    background: Shared[LayerAppearance] | None


@dataclass(frozen=True, slots=True)
class Retirement:
    """Layers that get no more frames: their processes are free for layers born next."""

    layers: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class SaveState:
    """Requests a process to write its state as of the frame before, in parallel with the next ones.

    Attributes
    ----------
    folder : Path
        Of the snapshot.
    """

    folder: Path


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LayerStart:
    """Assigns a layer to a process, with the state of its part."""

    own: SavedLayer
    state: Shared[CapturedState]


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LayerStep:
    """Asks a layer to process a frame.

    Attributes
    ----------
    evidence : Shared
    previous : Shared, optional
        Published result of the frame before; None if there is none.
    answer : Slot
        For the posterior.
    appearance : Slot, optional
        For the remembered colours after that; None if not wanted.
    """

    evidence: Shared[FrameEvidence]
    previous: Shared[Segmentation] | None
    answer: Slot
    appearance: Slot | None


@pickled_by_values
@dataclass(frozen=True, slots=True)
class LabelRow:
    """One result: a row of a record, by reference."""

    segmentation: Shared[Segmentation]
    frame: Shared[SourceFrame]
    background: Shared[LayerAppearance] | None

    @property
    def slots(self) -> tuple[Slot, ...]:
        """Slots of its parts."""
        parts = (self.segmentation, self.frame, self.background)
        return tuple(part.slot for part in parts if part is not None)


@pickled_by_values
@dataclass(frozen=True, slots=True)
class GapRow:
    """A frame without label map: its source index, its time, and why."""

    index: int
    pts: float
    status: GapStatus
