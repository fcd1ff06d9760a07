"""Run by a test in a process of its own: which kernels are still compiled or loaded after a warming.

The argument says what is warmed, and what is looked at then: "layer", or "stream", which is a coordinator
and a segmenter.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from numba.core.dispatcher import Dispatcher

from mlbs_actors import Config
from mlbs_actors.actors.parts import EngineParts, LayerPart, _arrived
from mlbs_actors.messages import Segmentation
from orchestrator.sources.synthetic import scene


def compiled() -> set[tuple[str, str]]:
    """Name and signature of every kernel compiled or loaded so far."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("mlbs_actors")]
    kernels = [
        kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)
    ]
    return {(str(kernel), str(signature)) for kernel in kernels for signature in kernel.signatures}


def main(warmed: str) -> None:
    parts, config = EngineParts(), Config()
    if warmed == "layer":
        parts.warm_layer()
        assert "scipy.linalg" not in sys.modules, "it takes a fifth of a process's start, and 12 MB"
    else:
        parts.warm_stream()
    assert compiled(), "nothing was warmed"
    later: dict[str, set[tuple[str, str]]] = {"layer": set(), "stream": set()}

    @contextmanager
    def noted(one: str) -> Iterator[None]:
        before = compiled()
        yield
        later[one] |= compiled() - before

    for name, frames in (("demo", 12), ("steady-crowd", 20)):
        coordinator, segmenter = parts.coordinator(config), parts.segmenter(config)
        layers: dict[int, LayerPart] = {}
        previous: Segmentation | None = None
        results: dict[int, Segmentation] = {}
        video = scene(name, frames=frames, seed=1, width=640, height=480)
        for t in range(len(video)):
            wanted = coordinator.feedback_index(t)
            feedback = None if wanted is None else partial(results.__getitem__, wanted)
            with noted("stream"):
                evidences = [*coordinator.step(t, _arrived(video.frame(t)), feedback)]
            for evidence in map(_arrived, evidences):
                for layer in evidence.retired:
                    layers.pop(layer, None)
                frame = _arrived(video.frame(evidence.frame_index))
                posteriors = []
                for own in evidence.layers:
                    part = layers.setdefault(own.layer, parts.layer(config, own.layer, own.kind))
                    with noted("layer"):
                        posteriors.append(part.step(own, evidence, frame, previous))
                with noted("stream"):
                    labelled = segmenter.step(evidence, frame, [*map(_arrived, posteriors)])
                previous = results[evidence.frame_index] = _arrived(labelled)
        assert len(layers) > 3, "a scene with one object proves little"
    print("later:", later[warmed])


main(sys.argv[1])
