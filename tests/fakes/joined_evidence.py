"""Evidence of a frame from that of its layers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mlbs_actors.messages import FrameEvidence, LayerEvidence, LayerTracks


def joined_evidence(layers: Sequence[LayerEvidence], **others: Any) -> FrameEvidence:
    """The other fields are those of :class:`FrameEvidence`."""
    ends = np.cumsum([0, *(len(one.positions) for one in layers)]).tolist()
    nothing = np.zeros((0, 2), np.float32)
    return FrameEvidence(
        tracks=tuple(
            LayerTracks(one.layer, one.kind, one.last_frame, start, end)
            for one, start, end in zip(layers, ends[:-1], ends[1:], strict=True)
        ),
        positions=np.concatenate([nothing, *(one.positions for one in layers)]),
        motions=np.concatenate([nothing, *(one.motions for one in layers)]),
        **others,
    )
