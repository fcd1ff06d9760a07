"""Messages between the parts of one stream: typed, array-valued, the same in one process and over Ray.

The way of a frame::

    frame ─► Coordinator.step ─► FrameEvidence ─► Layer.step (one a layer) ─► LayerPosterior
                   ▲                                   ▲                          │
                   │ segmentations up to t−2           │ segmentation of t−1      ▼
                   └───────────────────────────────────┴──── Segmentation ◄─ Segmenter.step

Conventions: images are (H, W, 3) uint8 BGR; a pixel is (x right, y down); frame indices count from 0; a
*motion* is backward: the displacement of a point of frame t to where it was in frame t−1, in px. A layer's id
is never reused; id 0 is the background.

In the order of that way: ``evidence``, ``posterior``, ``segmentation``. ``terms`` has what these have in
common; ``read_only`` makes messages within one process like those that arrive from another one.
"""

from mlbs_actors.messages.evidence import UNEXPLAINED_STEP, FrameEvidence, LayerEvidence, LayerTracks
from mlbs_actors.messages.posterior import COST_STEP, LayerAppearance, LayerPosterior
from mlbs_actors.messages.read_only import readonly
from mlbs_actors.messages.segmentation import Boxes, LayerSummary, ObjectState, Segmentation
from mlbs_actors.messages.terms import BACKGROUND, NO_PICTURE, Array, FrameStatus, LayerKind, Region

__all__ = [
    "BACKGROUND",
    "COST_STEP",
    "NO_PICTURE",
    "UNEXPLAINED_STEP",
    "Array",
    "Boxes",
    "FrameEvidence",
    "FrameStatus",
    "LayerAppearance",
    "LayerEvidence",
    "LayerKind",
    "LayerPosterior",
    "LayerSummary",
    "LayerTracks",
    "ObjectState",
    "Region",
    "Segmentation",
    "readonly",
]
