"""The list of the layers that live, and which of them get a process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from actor_fakes import CONFIG, still_evidence
from thread_host import ThreadHost, answered

from mlbs_actors.actors.ipc.channels import ChannelAddress
from mlbs_actors.actors.node.host import Reference
from mlbs_actors.actors.node.processes import hosted_by
from mlbs_actors.actors.stream.live_layers import LiveLayers
from mlbs_actors.actors.stream.saved_states import SavedLayer
from mlbs_actors.config import Config
from mlbs_actors.messages import FrameEvidence, LayerEvidence


@dataclass
class Method:
    """Of an actor that answers at once."""

    call: Callable[..., object]

    def remote(self, *given: object, **named: object) -> Reference:
        answer: Reference = answered(self.call(*given, **named))
        return answer

    def options(self, *, name: str) -> Method:
        return self


@dataclass
class Process:
    serve: Method = field(default_factory=lambda: Method(int))


class Pool:
    """Has a process at hand whenever it is asked."""

    def __init__(self) -> None:
        self.asked = 0
        self.acquire = Method(self._lend)

    def _lend(self, run: int, config: Config) -> tuple[Process, ChannelAddress]:
        self.asked += 1
        return Process(), ChannelAddress(1, self.asked, self.asked)


def evidence(frame: int, layers: tuple[int, ...]) -> FrameEvidence:
    nothing = np.zeros((0, 2), np.float32)
    return still_evidence(
        [
            LayerEvidence(layer, "object" if layer else "background", frame - 1, nothing, nothing)
            for layer in layers
        ],
        frame,
    )


@pytest.fixture(autouse=True)
def host() -> Iterator[None]:
    with hosted_by(ThreadHost()):
        yield


def test_a_layer_that_sleeps_gets_its_process_when_it_wakes() -> None:
    pool = Pool()
    layers = LiveLayers(pool, 1, CONFIG, "stream")
    layers.restore([SavedLayer(0, "background", 3), SavedLayer(1, "object", 3), SavedLayer(2, "object", 3)])
    # Nobody would know when it has read the state that was sent there: it answers no frame.
    assigned = [[layer for layer, _ in layers.follow(evidence(t, (0, 2)))] for t in range(4, 9)]
    assert sorted(layer for some in assigned for layer in some) == [0, 2]
    assert [layer for t in (9, 10) for layer, _ in layers.follow(evidence(t, (0, 1, 2)))] == [1]
    assert pool.asked == 3
