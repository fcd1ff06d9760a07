"""The coordinator's list of the layers that live, and of their processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import ray

from mlbs_actors.actors.ipc.channels import ChannelOffer
from mlbs_actors.actors.node.processes import Handle, Reference, identity
from mlbs_actors.actors.stream.saved_states import SavedLayer
from mlbs_actors.config import Config
from mlbs_actors.messages import FrameEvidence, LayerKind

__all__ = ["LiveLayers"]

#: So many layers of a new stream have a process from its first frame on: nothing is under way that would be
#: held up, and the pool starts processes for them when the stream is let in.
_FIRST_LAYERS = 4


@dataclass(slots=True)
class _Living:
    """A layer, how far it has been asked to go, its process, and what says that that serves no more."""

    kind: LayerKind
    last_frame: int
    process: Handle | None = None
    served: Reference | None = None


class LiveLayers:
    """The coordinator's list of its layers: layer id → process, over births and retirements.

    A layer is born without a process, and lives in the segmenter's
    (:mod:`mlbs_actors.actors.stream.segmenter_actor`) until the pool has one for it. So a birth waits for
    nothing, and where many are born at once their processes come one after the other, beside the frames.
    Where the node's memory holds no more, it goes on living there.

    Parameters
    ----------
    pool : Handle
        The node's :class:`~mlbs_actors.actors.node.pool.PoolActor`.
    run : int
        The stream's number in that pool.
    config : Config
    """

    def __init__(self, pool: Handle, run: int, config: Config) -> None:
        self._pool = pool
        self._run = run
        self._config = config
        self._living: dict[int, _Living] = {}
        self._asked: deque[Reference] = deque()  # processes, of whatever layers
        self._begun = self._is_short = False

    def __len__(self) -> int:
        return len(self._living)

    @property
    def without_process(self) -> int:
        """How many have no process because the node's memory holds no more."""
        return self._is_short * sum(living.process is None for living in self._living.values())

    def roles(self) -> Iterator[tuple[str, str]]:
        """Actor id and name of every layer process, for messages."""
        for layer, living in self._living.items():
            if living.process is not None:
                yield identity(living.process), f"layer {layer}"

    def served(self) -> list[Reference]:
        """What raises why a layer's process serves no more, where that failed or is gone."""
        return [living.served for living in self._living.values() if living.served is not None]

    def state(self) -> tuple[SavedLayer, ...]:
        """The layers as they stand, in ascending id."""
        return tuple(
            SavedLayer(layer, living.kind, living.last_frame)
            for layer, living in sorted(self._living.items())
        )

    def restore(self, layers: Iterable[SavedLayer]) -> None:
        """Go back to a snapshot: to these layers, none of which has a process yet."""
        self._living = {own.layer: _Living(own.kind, own.last_frame) for own in layers}
        self._begun = True

    def follow(self, evidence: FrameEvidence) -> tuple[tuple[int, ChannelOffer], ...]:
        """Give the retired layers' processes back, and take those that there are for layers without one.

        Returns
        -------
        tuple of (int, ChannelOffer)
            The layers that have a process from this frame on, and the channels of these.

        Raises
        ------
        RayError
            If the pool could not start a process, or is gone.
        """
        for layer in evidence.retired:
            if layer in self._living:
                self._release(layer)
        for own in evidence.tracks:
            self._living.setdefault(own.layer, _Living(own.kind, -1)).last_frame = evidence.frame_index
        return tuple(self._assigned(evidence))

    def release_all(self) -> None:
        """Give all processes back, each once it serves no more."""
        for layer in list(self._living):
            self._release(layer)

    def _assigned(self, evidence: FrameEvidence) -> Iterator[tuple[int, ChannelOffer]]:
        # Of those that do this frame: by their answer it is known that they have read the state they got.
        waiting = deque(own.layer for own in evidence.tracks if self._living[own.layer].process is None)
        awaited = 0 if self._begun else min(len(waiting), _FIRST_LAYERS)
        self._begun = True
        while len(self._asked) < min(len(waiting), max(awaited, 1)):
            self._asked.append(self._pool.acquire.remote(self._run, self._config, awaited=awaited > 0))
        while self._asked and (awaited or _is_there(self._asked[0])):
            answer = ray.get(self._asked.popleft())
            awaited = max(awaited - 1, 0)
            self._is_short = answer is None
            if answer is None:  # asked again with the next frame
                continue
            process, offer = answer
            if waiting:
                layer = waiting.popleft()
                self._living[layer].process = process
                self._living[layer].served = process.serve.remote(self._run)
                yield layer, offer
            else:  # who it was asked for has retired, or sleeps
                self._give_back(process)

    def _release(self, layer: int) -> None:
        process = self._living.pop(layer).process
        if process is not None:
            self._give_back(process)

    def _give_back(self, process: Handle) -> None:
        # The layer's own answer is an argument of the pool's call, so the pool hears of it only when the
        # process has done all its steps.
        self._pool.release.remote(self._run, identity(process), process.release.remote(self._run))


def _is_there(reference: Reference) -> bool:
    there, _ = ray.wait([reference], timeout=0)
    return bool(there)
