"""Run by a test in a process of its own: which kernels are still compiled or loaded after a warming.

The first argument is "record", which labels scenes and leaves the label maps in the file that the second one
names, or what is warmed and then does its part of the same work: "coordinator", "segmenter", whose layers are
all in its process, or "layer".
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from numba.core.dispatcher import Dispatcher

from mlbs_actors import Config
from mlbs_actors.actors.parts import EngineParts, LayerPart
from mlbs_actors.messages import Array, FrameEvidence, LayerPosterior, Segmentation
from mlbs_actors.scenes.synthetic import scene

#: Scenes, their frames and height: several objects from the start, a crowd, and one that enters late.
SCENES = (("demo", 12, 480), ("steady-crowd", 20, 480), ("crowd", 60, 240), ("traffic", 24, 480))


def _arrived(message: Any) -> Any:
    """What another process reads of a message: the arrays are read-only."""
    arrays: list[pickle.PickleBuffer] = []
    description = pickle.dumps(message, protocol=5, buffer_callback=arrays.append)
    return pickle.loads(description, buffers=[array.raw().toreadonly() for array in arrays])


def compiled() -> set[tuple[str, str]]:
    """Name and signature of every kernel compiled or loaded so far."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("mlbs_actors")]
    kernels = [
        kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)
    ]
    return {(str(kernel), str(signature)) for kernel in kernels for signature in kernel.signatures}


class Layers:
    """A stream's layers, in this process."""

    def __init__(self) -> None:
        self._parts: dict[int, LayerPart] = {}
        self.most = 0

    def step(self, evidence: FrameEvidence, previous: Segmentation | None) -> list[LayerPosterior]:
        for layer in evidence.retired:
            self._parts.pop(layer, None)
        answers = []
        for own in evidence.tracks:
            part = self._parts.setdefault(own.layer, EngineParts().layer(Config(), own.layer, own.kind))
            answers.append(_arrived(part.step(evidence, previous)))
        self.most = max(self.most, len(self._parts))
        return answers


@dataclass
class Recorded:
    """A scene's messages."""

    evidence: list[FrameEvidence] = field(default_factory=list)
    labelled: list[Segmentation] = field(default_factory=list)


def frames_of(name: str, frames: int, height: int) -> list[Array]:
    length = 120 if name == "traffic" else frames
    video = scene(name, frames=length, seed=1, width=height * 4 // 3, height=height)
    return [_arrived(video.frame(t)) for t in range(frames)]


def evidence_of(frames: list[Array], labelled: list[Segmentation]) -> Iterator[FrameEvidence]:
    """Do the coordinator's work; the label maps may be made meanwhile."""
    coordinator = EngineParts().coordinator(Config())
    for t, frame in enumerate(frames):
        wanted = coordinator.feedback_index(t)
        feedback = None if wanted is None else partial(labelled.__getitem__, wanted)
        yield from map(_arrived, coordinator.step(t, frame, feedback))


def record(name: str, frames: int, height: int) -> Recorded:
    recorded, layers, segmenter = Recorded(), Layers(), EngineParts().segmenter(Config())
    pictures = frames_of(name, frames, height)
    for evidence in evidence_of(pictures, recorded.labelled):
        recorded.evidence.append(evidence)
        answers = layers.step(evidence, recorded.labelled[-1] if recorded.labelled else None)
        recorded.labelled.append(_arrived(segmenter.step(evidence, pictures[evidence.frame_index], answers)))
    assert layers.most > (1 if name == "traffic" else 3), "so few layers prove little"
    return recorded


def replay(part: str, recorded: Recorded, frames: list[Array]) -> None:
    if part == "coordinator":
        assert len(list(evidence_of(frames, recorded.labelled))) == len(recorded.evidence)
        return
    layers, segmenter = Layers(), EngineParts().segmenter(Config())
    for evidence, previous in zip(recorded.evidence, [None, *recorded.labelled], strict=False):
        answers = layers.step(_arrived(evidence), _arrived(previous))
        if part == "segmenter":
            segmenter.step(_arrived(evidence), frames[evidence.frame_index], answers)


def main(part: str, messages: Path) -> None:
    if part == "record":
        messages.write_bytes(pickle.dumps([record(*one) for one in SCENES], protocol=5))
        return
    getattr(EngineParts(), f"warm_{part}")()
    before = compiled()
    assert before, "nothing was warmed"
    for recorded, one in zip(pickle.loads(messages.read_bytes()), SCENES, strict=True):
        replay(part, recorded, frames_of(*one))
    print("later:", compiled() - before)


main(sys.argv[1], Path(sys.argv[2]))
