"""Fuses the layers' posteriors into one label map by a label-cost graph cut (§7).

E(L) = Σ_i −log P_post(l_i) + Σ_i tracks(l_i) + Σ_i shadow(l_i) + Σ_(i,j) w_ij [l_i ≠ l_j] + Σ_k h_k δ_k(L)

Differs from the paper: the trajectories' own data cost (there for new layers) is always there, not only
where samples are missing: trajectory labels decide, contrast draws the outline, appearance repairs. Cast
shadows, which move with an object, are told from it (:mod:`mlbs_actors.shadows`). The published map is
the cleaned one (specks, pinholes and contact shadows removed), and it is the one the layers learn from.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from mlbs_actors.cleaning import clean_labels
from mlbs_actors.config import Config, length_scale
from mlbs_actors.errors import FrameError
from mlbs_actors.fusion import fused_costs
from mlbs_actors.graph_cut import contrast_weights, minimise
from mlbs_actors.messages import (
    BACKGROUND,
    COST_STEP,
    Array,
    FrameEvidence,
    LayerPosterior,
    LayerSummary,
    Region,
    Segmentation,
)
from mlbs_actors.shadows import contact_shadow, darkening, shadow_likelihood

__all__ = ["Segmenter", "SegmenterState"]


@dataclass(slots=True)
class SegmenterState:
    """Everything that steers the segmenter's next frame.

    Attributes
    ----------
    next_frame : int
        Index of the frame that :meth:`Segmenter.step` takes next.
    labels : (H, W) uint16
        Last published label map; empty before the first.
    """

    next_frame: int
    labels: Array


class Segmenter:
    """Normalises, cuts and cleans one stream.

    Parameters
    ----------
    config : Config
    state : SegmenterState, optional
        To go on from a snapshot; a new stream by default.
    """

    def __init__(self, config: Config, state: SegmenterState | None = None) -> None:
        self.config = config
        self.state = state or SegmenterState(0, np.zeros((0, 0), np.uint16))

    def step(self, evidence: FrameEvidence, frame: Array, posteriors: list[LayerPosterior]) -> Segmentation:
        """Label one frame.

        Parameters
        ----------
        evidence : FrameEvidence
        frame : (H, W, 3) uint8
        posteriors : list of LayerPosterior
            Of all live layers of this frame, in ascending id, the background first.

        Returns
        -------
        Segmentation

        Raises
        ------
        FrameError
            If the frame is not the next one, or the posteriors are not those of its live layers.
        """
        ids = [one.layer for one in evidence.layers]
        given = [(one.layer, one.frame_index) for one in posteriors]
        expected = [(layer, self.state.next_frame) for layer in ids]
        if evidence.frame_index != self.state.next_frame or given != expected:
            raise FrameError(
                f"The segmenter is due for frame {self.state.next_frame}; it was given frame "
                f"{evidence.frame_index} with the layers {[one.layer for one in posteriors]} of {ids}; "
                "restart the stream from its last snapshot."
            )
        config = self.config.segmentation
        start = perf_counter()
        cost, fallback = fused_costs(
            posteriors,
            evidence.shape,
            self.config.posterior.appearance,
            self.config.appearance.half_confidence_samples,
        )
        normaliser = _normaliser(cost)
        unary = cost.astype(np.float32) * np.float32(COST_STEP)
        _pull_tracks(unary, evidence, config.track_cost)
        scale = length_scale(*evidence.shape)
        dark = None
        if config.shadow > 0 or config.contact_shadow > 0:
            dark = darkening(frame, evidence, self.state.labels, scale)
        if dark is not None and config.shadow > 0:
            _discount_shadows(unary, posteriors, shadow_likelihood(dark), config.shadow)
        fused = perf_counter()
        label_costs = np.full(len(ids), config.label_cost * scale**2)
        label_costs[0] = 0.0  # the background is always there
        weights = contrast_weights(frame, config.contrast_strength, config.contrast_scale)
        cut = minimise(unary, weights, label_costs)
        solved = perf_counter()
        speck_px, hole_px = config.speck_px * scale**2, config.hole_px * scale**2
        positions = clean_labels(cut.labels, speck_px=speck_px, hole_px=hole_px)
        if dark is not None and config.contact_shadow > 0:
            positions[contact_shadow(positions, frame, dark, scale, config.contact_shadow)] = 0
        labels = np.array(ids, np.uint16)[positions]
        summaries = _summaries(positions, cost, normaliser, posteriors)
        done = perf_counter()
        self.state = SegmenterState(evidence.frame_index + 1, labels)
        for shared in (labels, normaliser, fallback):  # the layers read them back at the next frame
            shared.setflags(write=False)
        camera = posteriors[0].velocity
        return Segmentation(
            frame_index=evidence.frame_index,
            labels=labels,
            normaliser=normaliser,
            fallback=fallback,
            layers=summaries,
            camera_motion=(float(camera[0]), float(camera[1])),
            latency_frames=evidence.latency_frames,
            stage_ms={
                **evidence.stage_ms,
                **_slowest(posteriors),
                "fusion": 1e3 * (fused - start),
                "cut": 1e3 * (solved - fused),
                "cleaning": 1e3 * (done - solved),
            },
        )


def _normaliser(cost: Array) -> Array:
    """−log Σ_k exp(−cost_k) in quanta, summed in ascending layer id."""
    total = np.zeros(cost.shape[1:], np.float32)
    likelihood = np.exp(np.arange(256, dtype=np.float32) * np.float32(-COST_STEP))
    for one in cost:
        total += likelihood[one]
    return np.clip(np.rint(-np.log(total) / np.float32(COST_STEP)), 0, 255).astype(np.uint8)


def _pull_tracks(unary: Array, evidence: FrameEvidence, strength: float) -> None:
    """Add the trajectories' data cost: −c for their own label at their pixel, +c for every other."""
    height, width = evidence.shape
    for position, layer in enumerate(evidence.layers):
        x = np.clip(np.rint(layer.positions[:, 0]).astype(np.intp), 0, width - 1)
        y = np.clip(np.rint(layer.positions[:, 1]).astype(np.intp), 0, height - 1)
        for other in range(len(unary)):
            np.add.at(unary[other], (y, x), np.float32(-strength if other == position else strength))


def _discount_shadows(unary: Array, posteriors: list[LayerPosterior], shadow: Array, strength: float) -> None:
    """Take away, as far as a pixel is a shadow, what an object has over the background, and a little more."""
    for position, one in enumerate(posteriors):
        if one.layer != BACKGROUND:
            own, darkened = unary[position][one.region.slices], shadow[one.region.slices]
            lead = np.maximum(unary[0][one.region.slices] - own, 0.0)
            own += darkened * (lead + np.float32(strength))


def _summaries(
    positions: Array, cost: Array, normaliser: Array, posteriors: list[LayerPosterior]
) -> tuple[LayerSummary, ...]:
    rows = []
    for position, one in enumerate(posteriors):
        if one.layer == BACKGROUND:
            continue
        y, x = np.nonzero(positions[one.region.slices] == position)
        if len(x) == 0:
            continue
        y, x = y + one.region.y, x + one.region.x
        log_posterior = (normaliser[y, x].astype(np.float64) - cost[position][y, x]) * COST_STEP
        rows.append(
            LayerSummary(
                layer=one.layer,
                kind="other" if one.kind == "other" else "object",
                region=Region(int(x.min()), int(y.min()), int(np.ptp(x)) + 1, int(np.ptp(y)) + 1),
                area=len(x),
                centroid=(float(x.mean()), float(y.mean())),
                velocity=(float(one.velocity[0]), float(one.velocity[1])),
                confidence=float(np.exp(np.minimum(log_posterior, 0.0)).mean()),
            )
        )
    return tuple(rows)


def _slowest(posteriors: list[LayerPosterior]) -> dict[str, float]:
    """The layers work side by side: of each stage the slowest counts."""
    stages: dict[str, float] = {}
    for one in posteriors:
        for stage, duration in one.stage_ms.items():
            stages[stage] = max(stages.get(stage, 0.0), duration)
    return stages
