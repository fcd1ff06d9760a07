"""The segmenter actor, between the coordinator and the layers of its stream.

The coordinator sends the work on a frame. The segmenter passes it on to the layers, which process it in
parallel, and labels the frame from their posteriors.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from mlbs_actors.actors.ipc.channels import Channel, ChannelAddress, ChannelListener, connect
from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, Slot, SlotPool
from mlbs_actors.actors.node.host import Handle, Reference
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.processes import get
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.layers_at_work import LayersAtWork, SharedEvidence
from mlbs_actors.actors.stream.messages import (
    AssignedProcess,
    FrameWork,
    LabelledFrame,
    Retirement,
    SaveState,
)
from mlbs_actors.actors.stream.order import FrameOrder
from mlbs_actors.actors.stream.saved_states import (
    PUBLISHED_FILE,
    SEGMENTER_FILE,
    PublishedState,
    SavedLayer,
    StateWriter,
)
from mlbs_actors.config import Config
from mlbs_actors.determinism import limit_process
from mlbs_actors.messages import (
    BACKGROUND,
    Array,
    FrameEvidence,
    LayerPosterior,
    Segmentation,
    readonly,
)
from mlbs_actors.source import SourceFrame
from mlbs_actors.state_file import read_state

__all__ = ["Labelling", "SegmenterActor"]


class SegmenterActor:
    """Labels the frames of one stream, each once and in order."""

    def __init__(self, parts: PartFactory, config: Config) -> None:
        limit_process()
        relax_thread_timers()
        self._segmenter = parts.segmenter(config)
        self._memory = SharedMemory()
        self._order = FrameOrder()
        self._channel = ChannelListener()
        self._layers = LayersAtWork(parts, config, self._memory)
        # Still readable by others: the last one by the layers, the one before by the coordinator.
        self._published: deque[Segmentation] = deque(maxlen=2)
        self._previous: Shared[Segmentation] | None = None
        self._writer = StateWriter()

    def address(self) -> ChannelAddress:
        """Return the address of the channel for the stream's work."""
        return self._channel.address

    def restore(
        self, folder: Path, layers: Sequence[SavedLayer], slots: Sequence[Slot]
    ) -> dict[int, Shared[Segmentation]]:
        """Go back to a snapshot.

        Parameters
        ----------
        folder : Path
        layers : sequence of SavedLayer
            Those live at that time.
        slots : sequence of Slot
            Two.

        Returns
        -------
        dict of int to Shared
            The newest label maps at that time by their frame, at most two, oldest first.
        """
        self._layers.restore(layers, folder)
        self._segmenter.state = read_state(folder / SEGMENTER_FILE, type(self._segmenter.state))
        published = read_state(folder / PUBLISHED_FILE, PublishedState).segmentations
        self._published.extend(map(readonly, published))
        self._order = FrameOrder(published[-1].frame_index if published else -1)
        shared = {
            one.frame_index: self._memory.share(one, slot)
            for one, slot in zip(published, slots, strict=False)
        }
        self._previous = shared[published[-1].frame_index] if published else None
        return shared

    def serve(self) -> None:
        """Process the coordinator's messages, in order, until the channel is closed."""
        try:
            self._channel.serve(self._answers)
        finally:
            self._layers.close()
            self._writer.finish()

    def step(self, evidence: FrameEvidence, image: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        """Label one frame from the posteriors of its layers, in ascending layer id."""
        with self._order.step(evidence.frame_index, after=evidence.frame_index - 1):
            return self._segmenter.step(evidence, image, posteriors)

    def _answers(self, message: FrameWork | Retirement | SaveState) -> Iterator[object]:
        if isinstance(message, FrameWork):
            yield self._labelled(message)
        elif isinstance(message, Retirement):
            self._layers.retire(message.layers)
        else:
            self.save(message)

    def _labelled(self, work: FrameWork) -> LabelledFrame:
        evidence, frame = self._memory.load(work.evidence), self._memory.load(work.frame)
        assert frame.image is not None  # a quarantined frame has no evidence
        self._layers.follow(evidence, work.assigned)
        previous = self._published[-1] if self._published else None
        shared = SharedEvidence(evidence, previous, work.evidence, self._previous)
        answers = {own.layer: slot for own, slot in zip(evidence.tracks, work.posteriors, strict=True)}
        posteriors = self._layers.step(shared, answers, work.background)
        background = None if work.background is None else self._layers.appearance(BACKGROUND, work.background)
        segmentation = self.step(evidence, frame.image, posteriors)
        self._published.append(readonly(segmentation))
        self._previous = self._memory.share(segmentation, work.answer)
        return LabelledFrame(evidence.frame_index, self._previous, background)

    def save(self, message: SaveState) -> None:
        """Have the layers write their states, and write this one, in parallel with the next frames."""
        published = PublishedState(tuple(self._published))
        own = {SEGMENTER_FILE: self._segmenter.state, PUBLISHED_FILE: published}
        self._writer.write(own | self._layers.save(message), message.folder)


class Labelling:
    """The coordinator's end of its segmenter and layers.

    Parameters
    ----------
    segmenter : Handle
        The stream's :class:`SegmenterActor`.
    slots : SlotPool
        Of the stream.
    memory : SharedMemory
        The coordinator's.
    stream : str
        The stream's name, under which the segmenter's process is listed.

    Attributes
    ----------
    served : Reference
        The segmenter's ``serve`` call, which raises why it ended; set by :meth:`begin`.
    under_way : int
        Frames whose label maps have not arrived.
    process : int, optional
        The segmenter's process id; set by :meth:`begin`.
    """

    served: Reference
    process: int | None = None

    def __init__(self, segmenter: Handle, slots: SlotPool, memory: SharedMemory, stream: str) -> None:
        self._segmenter = segmenter
        self._slots = slots
        self._memory = memory
        self._stream = stream
        self._in_use: deque[tuple[Slot, ...]] = deque()  # of the frames under way, and of the one before
        self._address: Reference = segmenter.address.remote()
        self._channel: Channel | None = None
        self.under_way = 0

    def restore(self, folder: Path, layers: Sequence[SavedLayer]) -> dict[int, Shared[Segmentation]]:
        """See :meth:`SegmenterActor.restore`; before :meth:`begin`. Raises RayError."""
        slots = [self._slots.acquire("segmentation") for _ in range(2)]  # kept for ever
        published: dict[int, Shared[Segmentation]] = get(
            self._segmenter.restore.remote(folder, layers, slots)
        )
        return published

    def begin(self) -> None:
        """Start the segmenter; raises RayError. All other methods raise ChannelClosedError."""
        address: ChannelAddress = get(self._address)
        self.process = address.owner
        self.served = self._segmenter.serve.options(name=f"SegmenterActor.serve of {self._stream}").remote()
        self._channel = connect(address)

    def start(
        self,
        evidence: FrameEvidence,
        frame: Shared[SourceFrame],
        assigned: Iterable[tuple[int, ChannelAddress]],
        *,
        background: bool,
    ) -> None:
        """Start labelling the next frame.

        Parameters
        ----------
        evidence : FrameEvidence
        frame : Shared
        assigned : iterable of (int, ChannelAddress)
            Layers of the evidence that have a process from this frame on.
        background : bool
            Whether the background's remembered colours after this frame are wanted.
        """
        acquire = self._slots.acquire
        moved = tuple(AssignedProcess(layer, address, acquire("state")) for layer, address in assigned)
        where, answer = acquire("evidence"), acquire("segmentation")
        posteriors = tuple(acquire("posterior") for _ in evidence.tracks)
        appearance = acquire("appearance") if background else None
        shared = self._memory.share(evidence, where)
        work = FrameWork(shared, frame, answer, posteriors, moved, appearance)
        self._opened.send(work)
        self._in_use.append(work.inner_slots)
        self.under_way += 1

    def retire(self, layers: tuple[int, ...]) -> None:
        """Retire layers after the frames that were started."""
        self._opened.send(Retirement(layers))

    def save(self, folder: Path) -> None:
        """Have the segmenter and the layers write their states after the last frame started."""
        self._opened.send(SaveState(folder))

    def has_answer(self) -> bool:
        """Whether :meth:`next` would not wait."""
        return self.under_way > 0 and self._opened.has_message()

    def next(self) -> LabelledFrame:
        """Wait for the next label map; release the slots of the frame before it."""
        labelled: LabelledFrame = self._opened.receive()
        self.under_way -= 1
        if len(self._in_use) > self.under_way + 1:
            self._slots.release(self._in_use.popleft())
        return labelled

    def close(self) -> None:
        """Stop the segmenter and the layers."""
        if self._channel is not None:
            self._channel.close()

    @property
    def _opened(self) -> Channel:
        assert self._channel is not None  # begun
        return self._channel
