"""A frame with its labels, as the overlay and the monitor show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2

from mlbs_actors.messages import Array, Region, Segmentation
from mlbs_actors.pictures.drawing import draw_caption, draw_labels, draw_outlines
from mlbs_actors.record.scene_place import ScenePlace
from mlbs_actors.source import SourceFrame
from orchestrator.events.outlines import outlines
from orchestrator.events.zones import Zone
from orchestrator.pictures.content import Drawing

__all__ = ["LabelledPicture"]


@dataclass(frozen=True, slots=True)
class LabelledPicture:
    """A frame and what is known of it.

    Attributes
    ----------
    image : (H, W, 3) uint8
        BGR.
    labels : (H, W) uint16
    index : int
        Of the frame.
    pts : float
        s.
    taken : float, optional
        When a camera took it, seconds since 1970.
    regions : mapping of int to Region, optional
        The layers' bounding boxes, where they are known.
    pixel_aspect : float
        How wide a pixel is to be shown for its height.
    scene : ScenePlace, optional
        Where the zones are that are fixed to the scene.
    """

    image: Array
    labels: Array
    index: int
    pts: float
    taken: float | None = None
    regions: Mapping[int, Region] | None = None
    pixel_aspect: float = 1.0
    scene: ScenePlace | None = None

    @classmethod
    def of(
        cls,
        segmentation: Segmentation,
        frame: SourceFrame,
        image: Array,
        taken: float | None,
        scene: ScenePlace | None,
    ) -> LabelledPicture:
        """Return a frame's picture ``image`` with its labels; for the others see the attributes."""
        return cls(
            image=image,
            labels=segmentation.labels,
            index=frame.index,
            pts=frame.pts,
            taken=taken,
            regions={layer.layer: layer.region for layer in segmentation.layers},
            pixel_aspect=frame.pixel_aspect,
            scene=scene,
        )

    def drawn(self, zones: Sequence[Zone], drawing: Drawing, most_width: int | None = None) -> Array:
        """Draw labels, zones and a caption over the picture.

        Parameters
        ----------
        zones : sequence of Zone
        drawing : Drawing
        most_width : int, optional
            A wider picture is shrunk to it first.

        Returns
        -------
        (h, w, 3) uint8
        """
        height, width = self.labels.shape
        shown = self
        if most_width is not None and width > most_width:
            size = (most_width, max(1, round(height * most_width / width)))
            image = cv2.resize(self.image, size, interpolation=cv2.INTER_AREA)
            labels = cv2.resize(self.labels, size, interpolation=cv2.INTER_NEAREST)
            shown = replace(self, image=image, labels=labels, regions=None)
        picture = draw_labels(shown.image, shown.labels, shown.regions, ids=drawing.ids)
        if drawing.zones:
            scale = picture.shape[1] / width
            draw_outlines(picture, outlines(zones, (height, width), self.scene, scale))
        if caption := drawing.caption(self.index, self.pts, self.taken):
            draw_caption(picture, caption)
        return picture
