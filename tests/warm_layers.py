"""Run by a test in a process of its own: which kernels a warmed layer process still compiles."""

from __future__ import annotations

import sys
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


def main() -> None:
    parts, config = EngineParts(), Config()
    parts.warm_layer()
    assert compiled(), "nothing was warmed"
    assert "scipy.linalg" not in sys.modules, "it takes a fifth of a process's start, and 12 MB"
    coordinator, segmenter = parts.coordinator(config), parts.segmenter(config)
    layers: dict[int, LayerPart] = {}
    previous: Segmentation | None = None
    results: dict[int, Segmentation] = {}
    later: set[tuple[str, str]] = set()
    video = scene("demo", frames=8, seed=1, width=320, height=240)
    for t in range(len(video)):
        wanted = coordinator.feedback_index(t)
        feedback = None if wanted is None else partial(results.__getitem__, wanted)
        for evidence in coordinator.step(t, video.frame(t), feedback):
            frame = _arrived(video.frame(evidence.frame_index))
            posteriors = []
            for own in evidence.layers:
                layer = layers.setdefault(own.layer, parts.layer(config, own.layer, own.kind))
                before = compiled()
                posteriors.append(layer.step(_arrived(own), _arrived(evidence), frame, _arrived(previous)))
                later |= compiled() - before
            previous = segmenter.step(evidence, frame, posteriors)
            results[evidence.frame_index] = previous
    assert len(layers) > 1, "a scene without an object proves little"
    print("compiled later:", later)


main()
