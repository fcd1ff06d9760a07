"""Fuses the layers' posteriors into one label map by a label-cost graph cut (§7).

E(L) = Σ_i −log P_post(l_i) + Σ_i tracks(l_i) + Σ_i shadow(l_i) + Σ_(i,j) w_ij [l_i ≠ l_j] + Σ_k h_k δ_k(L)

Differs from the paper: the trajectories' own data cost (there for new layers) is always there, not only where
samples are missing: trajectory labels decide, contrast draws the outline, appearance repairs. Cast shadows,
which move with an object, are told from it (:mod:`mlbs_actors.segmentation.shadows`). The published map is
the cleaned one (specks, pinholes and contact shadows removed), and it is the one the layers learn from. A
layer other than the background can own nothing outside its region, so regions near each other are looked at
together and by themselves (:mod:`mlbs_actors.segmentation.region_groups`); in them what the layers claim
(:mod:`mlbs_actors.segmentation.proposals`) is labelled (:mod:`mlbs_actors.segmentation.group_labelling`).
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from mlbs_actors.appearance.fusion import fused_costs
from mlbs_actors.cells import in_cells, in_pixels, mean_of_cells
from mlbs_actors.config import Config, length_scale
from mlbs_actors.errors import FrameError
from mlbs_actors.graphcut.energy import LabelCostEnergy
from mlbs_actors.graphcut.graph_cut import MAX_SWEEPS, MOST_CUT_WHOLE, searched_labels
from mlbs_actors.messages import (
    BACKGROUND,
    Array,
    FrameEvidence,
    LayerPosterior,
    LayerSummary,
    Region,
    Segmentation,
)
from mlbs_actors.segmentation.contact_shadow import shadow_strips
from mlbs_actors.segmentation.contrast import COST_QUANTUM, weights_by_distance
from mlbs_actors.segmentation.group_labelling import (
    Claims,
    CutRules,
    Ground,
    Tally,
    label_claims,
    publish_claims,
    tally,
)
from mlbs_actors.segmentation.proposals import claims_of_layers
from mlbs_actors.segmentation.region_groups import group_regions
from mlbs_actors.segmentation.shadows import blur_weights, ground_colour

__all__ = ["Segmenter", "SegmenterState"]

#: Where shadows are not looked for.
_NO_GROUND = np.zeros((0, 0, 4), np.float32)


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
        ids = [one.layer for one in evidence.tracks]
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
        side = posteriors[0].cell
        means, colour, scale = mean_of_cells(frame, side), None, length_scale(*evidence.shape)
        if settings.shadow > 0 or settings.contact_shadow > 0:
            colour = ground_colour(means, evidence, self.state.labels, scale)
        ground = Ground(
            means,
            blur_weights(1.0 / side),
            _NO_GROUND if colour is None else colour,
            np.float32(settings.shadow / COST_QUANTUM),
        )
        rules = CutRules(
            weights_by_distance(settings.contrast_strength, settings.contrast_scale),
            round(settings.label_cost * scale**2 / COST_QUANTUM),
            round(2.0 * settings.track_cost / COST_QUANTUM),
            MOST_CUT_WHOLE,
            MAX_SWEEPS,
        )
        # Read-only here as between processes: kernels are compiled for one kind of memory.
        image = np.ascontiguousarray(frame).view()
        image.setflags(write=False)
        scene = _Scene(evidence, image, ground, rules)
        grid = in_cells(Region(0, 0, evidence.shape[1], evidence.shape[0]), side)
        result = _Maps.of_background(evidence.shape, (grid.height, grid.width))
        stage_ms = {"fusion": 1e3 * (perf_counter() - start), "cut": 0.0, "cleaning": 0.0}
        summaries: list[LayerSummary] = []
        regions = [in_cells(one.region, side) for one in posteriors[1:]]
        for group in group_regions(regions, (grid.height, grid.width)):
            members = [posteriors[0], *(posteriors[1 + position] for position in group.members)]
            summaries += self._label_group(group.box, members, scene, result, stage_ms)
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

    def _label_group(
        self,
        cells: Region,
        members: list[LayerPosterior],
        scene: _Scene,
        result: _Maps,
        stage_ms: dict[str, float],
    ) -> list[LayerSummary]:
        """Fill in one group's cells of the maps, in which only the background and its members live."""
        start = perf_counter()
        evidence, side = scene.evidence, members[0].cell
        weight, half = self.config.posterior.appearance, self.config.appearance.half_confidence_samples
        fused = fused_costs(members, cells, weight, half)
        result.normaliser[cells.slices], result.fallback[cells.slices] = fused.normaliser, fused.fallback
        told = [evidence.tracks_of(one.layer) for one in members]
        tracks = np.array([(one.start, one.end) for one in told], np.int64)
        corner = (cells.x, cells.y)
        boxes = claims_of_layers(fused.cost, fused.places, evidence.positions, tracks, corner, side)
        ids = np.array([one.layer for one in members], np.uint16)
        claims = Claims(fused.cost, fused.normaliser, boxes, tracks, ids, corner, side)
        fused_at = perf_counter()
        config, scale = self.config.segmentation, length_scale(*result.labels.shape)
        limits = (config.speck_px * scale**2, config.hole_px * scale**2)
        tallied = Tally.of_nothing(len(members))
        unsolved, shady = label_claims(
            scene.frame, claims, evidence.positions, scene.ground, scene.rules, limits, result.labels, tallied
        )
        for own, box, energy, dark in unsolved:
            costs, weights, label_costs, pulls, places = energy
            labelling = searched_labels(LabelCostEnergy(costs, weights, label_costs, side, pulls, places))
            seen = publish_claims(labelling, claims, own, box, limits, dark, result.labels, tallied)
            shady.append((own, box, seen))
        labelled_at = perf_counter()
        for own, box, seen in shady if config.contact_shadow > 0 else ():
            left, top, width, height = box
            cells_of_box = Region(cells.x + left, cells.y + top, width, height)
            place = in_pixels(cells_of_box, side, result.labels.shape)
            labels = result.labels[place.slices].copy()
            strip = shadow_strips(labels, scene.frame[place.slices], seen, side, scale, config.contact_shadow)
            if strip.any():
                labels[strip] = BACKGROUND
                result.labels[place.slices] = labels
                tally(labels, claims, own, box, tallied)
        summaries = _summaries(tallied, members)
        stage_ms["fusion"] += 1e3 * (fused_at - start)
        stage_ms["cut"] += 1e3 * (labelled_at - fused_at)
        stage_ms["cleaning"] += 1e3 * (perf_counter() - labelled_at)
        return summaries


@dataclass(frozen=True, slots=True)
class _Scene:
    """A frame, what is known of it, what shadows are told by, and how it is cut."""

    evidence: FrameEvidence
    frame: Array
    ground: Ground
    rules: CutRules


@dataclass(frozen=True, slots=True)
class _Maps:
    """The arrays of a `Segmentation`."""

    labels: Array
    normaliser: Array
    fallback: Array

    @classmethod
    def of_background(cls, shape: tuple[int, int], grid: tuple[int, int]) -> _Maps:
        """What holds where no object has a say, of so many pixels and cells."""
        return cls(np.zeros(shape, np.uint16), np.full(grid, 255, np.uint8), np.zeros(grid, np.int8))


def _summaries(tallied: Tally, posteriors: list[LayerPosterior]) -> list[LayerSummary]:
    """What of a tally is an object's."""
    rows = []
    for one, bounds, sums, likelihood in zip(
        posteriors, tallied.bounds.tolist(), tallied.sums.tolist(), tallied.likelihood.tolist(), strict=True
    ):
        (left, top, right, bottom), (area, x, y) = bounds, sums
        if area == 0:
            continue
        rows.append(
            LayerSummary(
                layer=one.layer,
                kind="other" if one.kind == "other" else "object",
                region=Region(left, top, right - left + 1, bottom - top + 1),
                area=area,
                centroid=(x / area, y / area),
                velocity=(float(one.velocity[0]), float(one.velocity[1])),
                confidence=likelihood / area,
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
