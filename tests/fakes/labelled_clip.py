"""A clip that the engine has labelled, for tests that only read what came of it."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

from mlbs_actors import MultilayerSubtractor, Result
from mlbs_actors.messages import Array, LayerAppearance
from mlbs_actors.scenes.synthetic import SyntheticScene, scene

__all__ = ["LabelledClip"]


@dataclass(frozen=True)
class LabelledClip:
    """A scene from the first frame to the last, and what the engine found with the product's parameters.

    Attributes
    ----------
    scene : SyntheticScene
    frames : tuple of (H, W, 3) uint8
        BGR.
    results : tuple of Result
        One a frame.
    background : LayerAppearance
        What the background layer remembers after the last frame.
    """

    scene: SyntheticScene
    frames: tuple[Array, ...]
    results: tuple[Result, ...]
    background: LayerAppearance
    _begun: tuple[int, bytes]  # results of the first half, and the subtractor after it

    @classmethod
    def of(cls, name: str, frames: int, width: int, height: int) -> LabelledClip:
        """Label a built-in scene; no array of the clip may be written to, as other tests read it, too."""
        made = scene(name, frames=frames, width=width, height=height)
        subtractor = MultilayerSubtractor()
        pictures = [made.frame(index) for index in range(frames)]
        results: list[Result] = []
        begun = 0, b""
        for index, picture in enumerate(pictures):
            if index == frames // 2:
                begun = len(results), pickle.dumps(subtractor)
            results += subtractor.apply(picture)
        results += subtractor.flush()
        background = subtractor._layers[0].appearance()
        labels = [result.labels for result in results]
        for array in (*pictures, *labels, background.colours, background.known):
            array.flags.writeable = False
        return cls(made, tuple(pictures), tuple(results), background, begun)

    def first_half(self) -> tuple[list[Result], MultilayerSubtractor]:
        """Return the results of the first half of the frames, and a subtractor that goes on from there."""
        known, pickled = self._begun
        return list(self.results[:known]), pickle.loads(pickled)
