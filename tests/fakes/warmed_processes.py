"""Run by a test in a process of its own: which kernels are still compiled or loaded after a warming.

The first argument says what is warmed, and does the work of scenes then: "stream", which is a coordinator and
a segmenter with layers that have no process yet, or "layer", which takes what the former has told its layers
from the file that the second argument names.
"""

from __future__ import annotations

import pickle
import sys
from functools import partial
from pathlib import Path
from typing import Any

from numba.core.dispatcher import Dispatcher

from mlbs_actors import Config
from mlbs_actors.actors.parts import EngineParts, LayerPart
from mlbs_actors.messages import FrameEvidence, Segmentation
from orchestrator.sources.synthetic import scene

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

    def step(self, evidence: FrameEvidence, previous: Segmentation | None) -> list[object]:
        for layer in evidence.retired:
            self._parts.pop(layer, None)
        answers: list[object] = []
        for own in evidence.tracks:
            part = self._parts.setdefault(own.layer, EngineParts().layer(Config(), own.layer, own.kind))
            answers.append(_arrived(part.step(evidence, previous)))
        self.most = max(self.most, len(self._parts))
        return answers


def play(name: str, frames: int, height: int) -> list[tuple[FrameEvidence, Segmentation | None]]:
    """Label a scene; return what its layers were told, frame by frame."""
    parts, layers = EngineParts(), Layers()
    coordinator, segmenter = parts.coordinator(Config()), parts.segmenter(Config())
    results: list[Segmentation] = []
    told: list[tuple[FrameEvidence, Segmentation | None]] = []
    length = 120 if name == "traffic" else frames
    video = scene(name, frames=length, seed=1, width=height * 4 // 3, height=height)
    for t in range(frames):
        wanted = coordinator.feedback_index(t)
        feedback = None if wanted is None else partial(results.__getitem__, wanted)
        for evidence in map(_arrived, coordinator.step(t, _arrived(video.frame(t)), feedback)):
            frame = _arrived(video.frame(evidence.frame_index))
            told.append((evidence, results[-1] if results else None))
            answers = layers.step(*told[-1])
            results.append(_arrived(segmenter.step(evidence, frame, answers)))  # type: ignore[arg-type]
    assert layers.most > (1 if name == "traffic" else 3), "so few layers prove little"
    return told


def main(warmed: str, messages: Path) -> None:
    parts = EngineParts()
    if warmed == "layer":
        parts.warm_layer()
    else:
        parts.warm_stream()
    before = compiled()
    assert before, "nothing was warmed"
    if warmed == "layer":
        for told in pickle.loads(messages.read_bytes()):
            layers = Layers()
            for one in told:
                layers.step(*map(_arrived, one))
    else:
        messages.write_bytes(pickle.dumps([play(*one) for one in SCENES], protocol=5))
    print("later:", compiled() - before)


main(sys.argv[1], Path(sys.argv[2]))
