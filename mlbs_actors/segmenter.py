"""Fuses the layers' posteriors into one label map by a label-cost graph cut (§7).

E(L) = Σ_i −log P_post(l_i) + Σ_i tracks(l_i) + Σ_i shadow(l_i) + Σ_(i,j) w_ij [l_i ≠ l_j] + Σ_k h_k δ_k(L)

Differs from the paper: the trajectories' own data cost (there for new layers) is always there, not only
where samples are missing: trajectory labels decide, contrast draws the outline, appearance repairs. Cast
shadows, which move with an object, are told from it (:mod:`mlbs_actors.shadows`). The published map is
the cleaned one (specks, pinholes and contact shadows removed), and it is the one the layers learn from.
A layer other than the background can own nothing outside its region, so each group of regions near each
other is labelled by itself (:mod:`mlbs_actors.region_groups`).
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numba import njit

from mlbs_actors.cleaning import clean_labels
from mlbs_actors.config import Config, length_scale
from mlbs_actors.contrast import COST_QUANTUM, MAX_COST, contrast_weights
from mlbs_actors.cut_pruning import LabelCostEnergy
from mlbs_actors.errors import FrameError
from mlbs_actors.fusion import FusedCosts, fused_costs
from mlbs_actors.graph_cut import minimise
from mlbs_actors.messages import (
    BACKGROUND,
    COST_STEP,
    Array,
    FrameEvidence,
    LayerEvidence,
    LayerPosterior,
    LayerSummary,
    Region,
    Segmentation,
)
from mlbs_actors.region_groups import common, group_regions, slices_in
from mlbs_actors.shadows import contact_shadow, darkening, ground_colour, shadow_likelihood

__all__ = ["Segmenter", "SegmenterState"]


@dataclass(slots=True)
class SegmenterState:
    """Everything that steers the segmenter's next frame.

    Attributes
    ----------
    next_frame : int
        Index of the frame that :meth:`Segmenter.step` takes next.
    labels : (H, W) uint16
        Last published label map; empty before the first of an epoch.
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
        start = perf_counter()
        if evidence.frame_index == evidence.epoch:
            self.state.labels = np.zeros((0, 0), np.uint16)
        settings = self.config.segmentation
        ground = None
        if settings.shadow > 0 or settings.contact_shadow > 0:
            ground = ground_colour(frame, evidence, self.state.labels, length_scale(*evidence.shape))
        result = _Maps.of_background(evidence.shape)
        stage_ms = {"fusion": 1e3 * (perf_counter() - start), "cut": 0.0, "cleaning": 0.0}
        layers = list(zip(posteriors, evidence.layers, strict=True))
        summaries: list[LayerSummary] = []
        for group in group_regions([one.region for one in posteriors[1:]], evidence.shape):
            members = [layers[0], *(layers[1 + position] for position in group.members)]
            summaries += self._label(group.box, members, frame, ground, result, stage_ms)
        self.state = SegmenterState(evidence.frame_index + 1, result.labels)
        for shared in (result.labels, result.normaliser, result.fallback):  # the layers read them back
            shared.setflags(write=False)
        camera = posteriors[0].velocity
        return Segmentation(
            frame_index=evidence.frame_index,
            labels=result.labels,
            normaliser=result.normaliser,
            fallback=result.fallback,
            layers=tuple(sorted(summaries, key=lambda one: one.layer)),
            camera_motion=(float(camera[0]), float(camera[1])),
            latency_frames=evidence.latency_frames,
            stage_ms={**evidence.stage_ms, **_slowest(posteriors), **stage_ms},
        )

    def _label(
        self,
        box: Region,
        members: list[tuple[LayerPosterior, LayerEvidence]],
        frame: Array,
        ground: Array | None,
        result: _Maps,
        stage_ms: dict[str, float],
    ) -> list[LayerSummary]:
        """Fill in one group's box of the maps, in which only the background and its members live."""
        config, scale = self.config.segmentation, length_scale(*result.labels.shape)
        start = perf_counter()
        posteriors = [posterior for posterior, _ in members]
        weight, half = self.config.posterior.appearance, self.config.appearance.half_confidence_samples
        fused = fused_costs(posteriors, box, weight, half)
        unary = _data_costs(fused.cost, posteriors, box)
        _pull_tracks(
            unary, [evidence for _, evidence in members], box, result.labels.shape, config.track_cost
        )
        image = np.ascontiguousarray(frame[box.slices])
        dark = None if ground is None else darkening(frame, ground, box)
        if dark is not None and config.shadow > 0:
            _discount_shadows(unary, posteriors, box, shadow_likelihood(dark), config.shadow)
        ready = perf_counter()
        label_costs = np.full(len(members), round(config.label_cost * scale**2 / COST_QUANTUM), np.int64)
        label_costs[0] = 0  # the background is always there
        weights = contrast_weights(image, config.contrast_strength, config.contrast_scale)
        cut = minimise(LabelCostEnergy(unary, weights, label_costs))
        solved = perf_counter()
        labels = result.labels[box.slices]
        labels[...] = np.array([one.layer for one in posteriors], np.uint16)[cut.labels]
        speck_px, hole_px = config.speck_px * scale**2, config.hole_px * scale**2
        labels[...] = clean_labels(result.labels, box, speck_px=speck_px, hole_px=hole_px)
        if dark is not None and config.contact_shadow > 0:
            labels[contact_shadow(labels, image, dark, scale, config.contact_shadow)] = BACKGROUND
        result.normaliser[box.slices], result.fallback[box.slices] = fused.normaliser, fused.fallback
        summaries = _summaries(labels, fused, posteriors, box)
        done = perf_counter()
        for stage, duration in (
            ("fusion", ready - start),
            ("cut", solved - ready),
            ("cleaning", done - solved),
        ):
            stage_ms[stage] += 1e3 * duration
        return summaries


@dataclass(frozen=True, slots=True)
class _Maps:
    """The arrays of a `Segmentation`."""

    labels: Array
    normaliser: Array
    fallback: Array

    @classmethod
    def of_background(cls, shape: tuple[int, int]) -> _Maps:
        """What holds where no object has a say."""
        return cls(np.zeros(shape, np.uint16), np.full(shape, 255, np.uint8), np.zeros(shape, np.int8))


def _data_costs(cost: Array, posteriors: list[LayerPosterior], box: Region) -> Array:
    """Unary costs (K, h, w) int32 in ``COST_QUANTUM``; outside its region no layer can own a pixel."""
    unary = np.full(cost.shape, MAX_COST, np.int32)
    for own, fused, one in zip(unary, cost, posteriors, strict=True):
        place = slices_in(common(one.region, box), box)
        np.multiply(fused[place], round(COST_STEP / COST_QUANTUM), out=own[place], dtype=np.int32)
    return unary


def _pull_tracks(
    unary: Array, layers: list[LayerEvidence], box: Region, shape: tuple[int, ...], strength: float
) -> None:
    """Add the trajectories' data cost: −c for their own label at their pixel, +c for every other.

    Up to a constant, which does not matter, that is −2c for their own.
    """
    pull = round(2.0 * strength / COST_QUANTUM)
    for own, layer in zip(unary, layers, strict=True):
        x = np.clip(np.rint(layer.positions[:, 0]).astype(np.intp), 0, shape[1] - 1) - box.x
        y = np.clip(np.rint(layer.positions[:, 1]).astype(np.intp), 0, shape[0] - 1) - box.y
        inside = (x >= 0) & (x < box.width) & (y >= 0) & (y < box.height)
        np.subtract.at(own, (y[inside], x[inside]), pull)


def _discount_shadows(
    unary: Array, posteriors: list[LayerPosterior], box: Region, shadow: Array, strength: float
) -> None:
    """Take away, as far as a pixel is a shadow, what an object has over the background, and a little more."""
    for own, one in zip(unary[1:], posteriors[1:], strict=True):
        place = slices_in(one.region, box)
        _discount(own[place], unary[0][place], shadow[place], np.float32(strength / COST_QUANTUM))


@njit(cache=True)
def _discount(own: Array, background: Array, shadow: Array, strength: np.float32) -> None:
    for y in range(own.shape[0]):
        for x in range(own.shape[1]):
            lead = np.float32(max(background[y, x] - own[y, x], 0))
            own[y, x] += np.int32(np.rint(shadow[y, x] * (lead + strength)))


def _summaries(
    labels: Array, fused: FusedCosts, posteriors: list[LayerPosterior], box: Region
) -> list[LayerSummary]:
    rows = []
    for cost, one in zip(fused.cost[1:], posteriors[1:], strict=True):
        place = slices_in(one.region, box)
        own = np.flatnonzero(labels[place] == one.layer)
        if len(own) == 0:
            continue
        normaliser = fused.normaliser[place].reshape(-1)[own].astype(np.float64)
        log_posterior = (normaliser - cost[place].reshape(-1)[own]) * COST_STEP
        y, x = np.divmod(own, one.region.width)
        y, x = y + one.region.y, x + one.region.x
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
    return rows


def _slowest(posteriors: list[LayerPosterior]) -> dict[str, float]:
    """The layers work side by side: of each stage the slowest counts."""
    stages: dict[str, float] = {}
    for one in posteriors:
        for stage, duration in one.stage_ms.items():
            stages[stage] = max(stages.get(stage, 0.0), duration)
    return stages
