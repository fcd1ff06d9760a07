"""The coordinator's view of the live layers and their processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass

from mlbs_actors.actors.ipc.channels import ChannelAddress
from mlbs_actors.actors.node.host import Handle, Reference
from mlbs_actors.actors.node.processes import get, identity, is_answered
from mlbs_actors.actors.stream.saved_states import SavedLayer
from mlbs_actors.config import Config
from mlbs_actors.messages import FrameEvidence, LayerKind

__all__ = ["LiveLayers"]


@dataclass(slots=True)
class _Living:
    """A layer, the last frame requested of it, its process and that one's id and ``serve`` call."""

    kind: LayerKind
    last_frame: int
    process: Handle | None = None
    process_id: int | None = None
    served: Reference | None = None


class LiveLayers:
    """The processes of the live layers by id, over births and retirements.

    A layer is born without a process, and lives in the segmenter's
    (:mod:`mlbs_actors.actors.stream.segmenter_actor`) until the pool has one for it. So neither a stream's
    first frame nor a birth waits, and where many are born at once their processes are started one after the
    other, beside the frames. If the node's memory is too short for one, the layer stays there.

    Parameters
    ----------
    pool : Handle
        The node's :class:`~mlbs_actors.actors.node.pool.PoolActor`.
    run : int
        The stream's number in that pool.
    config : Config
    stream : str
        The stream's name: each process is listed under its layer's.
    """

    def __init__(self, pool: Handle, run: int, config: Config, stream: str) -> None:
        self._pool = pool
        self._run = run
        self._config = config
        self._stream = stream
        self._living: dict[int, _Living] = {}
        self._asked: Reference | None = None  # a process, for any layer
        self._is_short = False

    def __len__(self) -> int:
        return len(self._living)

    @property
    def without_process(self) -> int:
        """Number of layers without a process because the node's memory is too short."""
        return self._is_short * sum(living.process is None for living in self._living.values())

    def roles(self) -> Iterator[tuple[str, str]]:
        """Yield actor id and name of every layer process, for messages."""
        for layer, living in self._living.items():
            if living.process is not None:
                yield identity(living.process), f"layer {layer}"

    def processes(self) -> list[int]:
        """Return the ids of all layer processes."""
        return [living.process_id for living in self._living.values() if living.process_id is not None]

    def served(self) -> list[Reference]:
        """Return the ``serve`` calls of all layer processes, which raise why one has failed or is gone."""
        return [living.served for living in self._living.values() if living.served is not None]

    def state(self) -> tuple[SavedLayer, ...]:
        """Return the live layers, in ascending id."""
        return tuple(
            SavedLayer(layer, living.kind, living.last_frame)
            for layer, living in sorted(self._living.items())
        )

    def restore(self, layers: Iterable[SavedLayer]) -> None:
        """Go back to a snapshot: to these layers, all without a process."""
        self._living = {own.layer: _Living(own.kind, own.last_frame) for own in layers}

    def follow(self, evidence: FrameEvidence) -> tuple[tuple[int, ChannelAddress], ...]:
        """Release the processes of retired layers, and assign available ones to layers without.

        Returns
        -------
        tuple of (int, ChannelAddress)
            The layers that have a process from this frame on, and the addresses of their channels.

        Raises
        ------
        RayError
            If the pool could not start a process, or is gone.
        """
        if not evidence.tracks:  # a frame that is passed over
            return ()
        for layer in evidence.retired:
            if layer in self._living:
                self._release(layer)
        for own in evidence.tracks:
            self._living.setdefault(own.layer, _Living(own.kind, -1)).last_frame = evidence.frame_index
        return tuple(self._assigned(evidence))

    def release_all(self) -> None:
        """Release all processes, each once it has stopped serving."""
        for layer in list(self._living):
            self._release(layer)
        if self._asked is not None:
            # Nobody needs the answer, that the stream has ended; but what nobody looks at is reported by Ray.
            self._asked.future().add_done_callback(Future.exception)

    def _assigned(self, evidence: FrameEvidence) -> Iterator[tuple[int, ChannelAddress]]:
        # Only layers live in this frame: their answer to it confirms that they have read their state.
        waiting = deque(own.layer for own in evidence.tracks if self._living[own.layer].process is None)
        if self._asked is not None and is_answered(self._asked):
            answer, self._asked = get(self._asked), None
            self._is_short = answer is None
            if answer is None:  # asked again with the next frame
                return
            process, address = answer
            if waiting:
                layer = waiting.popleft()
                self._living[layer].process = process
                self._living[layer].process_id = address.owner
                named = process.serve.options(name=f"LayerActor.serve of {self._stream}, layer {layer}")
                self._living[layer].served = named.remote(self._run)
                yield layer, address
            else:  # the layer it was requested for has retired, or sleeps
                self._release_process(process)
        if waiting and self._asked is None:
            self._asked = self._pool.acquire.remote(self._run, self._config)

    def _release(self, layer: int) -> None:
        process = self._living.pop(layer).process
        if process is not None:
            self._release_process(process)

    def _release_process(self, process: Handle) -> None:
        # The layer's own answer is an argument of the pool's call, so the pool receives it only when the
        # process has done all its steps.
        self._pool.release.remote(self._run, identity(process), process.release.remote(self._run))
