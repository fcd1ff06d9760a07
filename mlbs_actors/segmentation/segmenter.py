"""Fuses the layers' posteriors into one label map by a label-cost graph cut (§7).

E(L) = Σ_i −log P_post(l_i) + Σ_i tracks(l_i) + Σ_i shadow(l_i) + Σ_(i,j) w_ij [l_i ≠ l_j] + Σ_k h_k δ_k(L)

Differs from the paper: the trajectories' own data cost (there for new layers only) is always added, not only
where samples are missing: trajectory labels decide, contrast draws the outline, appearance repairs. Cast
shadows, which move with an object, are separated from it (:mod:`mlbs_actors.segmentation.shadows`). The
published map is the cleaned one (specks, holes and contact shadows removed), and the layers learn from it. A
layer other than the background can own nothing outside its region, so nearby regions form independent groups
(:mod:`mlbs_actors.geometry.boxes`); in them the layers' proposals
(:mod:`mlbs_actors.segmentation.proposals`) are labelled (:mod:`mlbs_actors.segmentation.group_labelling`).
Layers that are parts of one object keep their own labels here; they get one id only in what is published
(:mod:`mlbs_actors.segmentation.attached_parts`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from mlbs_actors.appearance.fusion import fused_costs
from mlbs_actors.cells import cell_side, in_cells
from mlbs_actors.config import Config
from mlbs_actors.errors import FrameError
from mlbs_actors.geometry.boxes import group_regions
from mlbs_actors.messages import (
    BACKGROUND,
    NO_PICTURE,
    Array,
    FrameEvidence,
    LayerPosterior,
    LayerSummary,
    Region,
    Segmentation,
)
from mlbs_actors.segmentation.attached_parts import PartsState, find_parts
from mlbs_actors.segmentation.group_labelling import LayerStatistics, Proposals, Scene, label_proposals
from mlbs_actors.segmentation.mask_score import mask_score
from mlbs_actors.segmentation.proposals import proposal_boxes
from mlbs_actors.segmentation.shadows import ground_colour

__all__ = ["Segmenter", "SegmenterState"]


@dataclass(slots=True)
class SegmenterState:
    """Everything that determines the segmenter's next frame.

    Attributes
    ----------
    next_frame : int
        Index of the frame that :meth:`Segmenter.step` takes next.
    picture_index : int
        Frame of the last picture; −1 before the first one.
    labels, normaliser, fallback, layers
        Of its :class:`~mlbs_actors.messages.Segmentation`; empty before the first picture of an epoch.
    parts : PartsState
    """

    next_frame: int
    picture_index: int
    labels: Array
    normaliser: Array
    fallback: Array
    layers: tuple[LayerSummary, ...]
    parts: PartsState

    @staticmethod
    def beginning() -> SegmenterState:
        """Before the first frame."""
        return SegmenterState(
            0,
            -1,
            np.zeros((0, 0), np.uint16),
            np.zeros((0, 0), np.uint8),
            np.zeros((0, 0), np.int8),
            (),
            PartsState.empty(),
        )


class Segmenter:
    """Normalises, cuts and cleans one stream.

    Parameters
    ----------
    state : SegmenterState, optional
        To continue from a snapshot; a new stream by default.
    """

    def __init__(self, config: Config, state: SegmenterState | None = None) -> None:
        self.config = config
        self.state = state or SegmenterState.beginning()

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
        if evidence.status in NO_PICTURE:
            return self._carried(evidence)
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
        ground = None
        if settings.shadow > 0 or settings.contact_shadow > 0:
            ground = ground_colour(evidence, side, self.state.labels, settings)
        # Read-only as between processes: kernels are compiled separately for writable arrays.
        image = np.ascontiguousarray(frame).view()
        image.setflags(write=False)
        scene = Scene(settings, image, evidence.positions, evidence.colours, ground)
        grid = in_cells(Region(0, 0, evidence.shape[1], evidence.shape[0]), side)
        result = _Maps.of_background(evidence.shape, (grid.height, grid.width))
        stage_ms = {"fusion": 1e3 * (perf_counter() - start), "cut": 0.0, "cleaning": 0.0}
        summaries: list[LayerSummary] = []
        regions = [in_cells(one.region, side) for one in posteriors[1:]]
        for group in group_regions(regions, (grid.height, grid.width)):
            members = [posteriors[0], *(posteriors[1 + position] for position in group.members)]
            summaries += self._label_group(group.box, members, evidence, scene, result, stage_ms)
        live = {one.layer for one in evidence.tracks if one.kind == "object"}
        parts = find_parts(
            self.state.parts,
            result.labels,
            evidence.frame_index,
            live,
            self.config.layers.dormant_frames,
            frozenset(evidence.apart),
        )
        part_of = parts.objects()
        layers = tuple(
            replace(
                one,
                state="resting" if one.layer in evidence.resting else "moving",
                part_of=part_of.get(one.layer, 0),
            )
            for one in sorted(summaries, key=lambda one: one.layer)
        )
        for shared in (result.labels, result.normaliser, result.fallback):  # the layers read them back
            shared.setflags(write=False)
        camera = posteriors[0].velocity
        segmentation = Segmentation(
            frame_index=evidence.frame_index,
            labels=result.labels,
            normaliser=result.normaliser,
            fallback=result.fallback,
            layers=layers,
            camera_motion=(float(camera[0]), float(camera[1])),
            latency_frames=evidence.latency_frames,
            stage_ms={**evidence.stage_ms, **_slowest(posteriors), **stage_ms},
            status=evidence.status,
            camera=_camera(evidence),
        )
        self.state = SegmenterState(
            evidence.frame_index + 1,
            evidence.frame_index,
            result.labels,
            result.normaliser,
            result.fallback,
            layers,
            parts,
        )
        return segmentation

    def _carried(self, evidence: FrameEvidence) -> Segmentation:
        """The labels of the last picture, for a frame that is none."""
        state = self.state
        if evidence.frame_index != state.next_frame:
            raise FrameError(
                f"The segmenter is due for frame {state.next_frame}; it was given frame "
                f"{evidence.frame_index}; restart the stream from its last snapshot."
            )
        if evidence.frame_index == evidence.epoch or state.labels.shape != evidence.shape:
            side = cell_side(evidence.shape, self.config.grid.cell_px)
            grid = in_cells(Region(0, 0, evidence.shape[1], evidence.shape[0]), side)
            nothing = _Maps.of_background(evidence.shape, (grid.height, grid.width))
            state = replace(
                SegmenterState.beginning(),
                next_frame=state.next_frame,
                labels=nothing.labels,
                normaliser=nothing.normaliser,
                fallback=nothing.fallback,
            )
        self.state = replace(state, next_frame=evidence.frame_index + 1)
        return Segmentation(
            frame_index=evidence.frame_index,
            labels=state.labels,
            normaliser=state.normaliser,
            fallback=state.fallback,
            layers=state.layers,
            camera_motion=(0.0, 0.0),
            latency_frames=evidence.latency_frames,
            stage_ms=evidence.stage_ms,
            status=evidence.status,
            picture_index=state.picture_index,
            camera=_camera(evidence),
        )

    def _label_group(
        self,
        cells: Region,
        members: list[LayerPosterior],
        evidence: FrameEvidence,
        scene: Scene,
        result: _Maps,
        stage_ms: dict[str, float],
    ) -> list[LayerSummary]:
        """Fill in one group's cells of the maps, where only the background and its members are possible."""
        start = perf_counter()
        side, corner = members[0].cell, (cells.x, cells.y)
        weight, half = self.config.posterior.appearance, self.config.appearance.half_confidence_samples
        fused = fused_costs(members, cells, weight, half)
        result.normaliser[cells.slices], result.fallback[cells.slices] = fused.normaliser, fused.fallback
        own = [evidence.tracks_of(one.layer) for one in members]
        tracks = np.array([(one.start, one.end) for one in own], np.int64)
        boxes = proposal_boxes(fused.cost, fused.places, evidence.positions, tracks, corner, side)
        ids = np.array([one.layer for one in members], np.uint16)
        label_costs = self._label_costs(ids, evidence.frame_index)
        proposals = Proposals(fused.cost, fused.normaliser, boxes, tracks, ids, label_costs, corner, side)
        stage_ms["fusion"] += 1e3 * (perf_counter() - start)
        statistics = label_proposals(scene, proposals, result.labels, stage_ms)
        return _summaries(statistics, members, result.labels.size)

    def _label_costs(self, ids: Array, frame_index: int) -> Array:
        """Return h_k of layers, (K,) float64: what has been in the picture for long need not pay to stay."""
        settings, ages = self.config.segmentation, self.state.parts.ages(frame_index)
        proven = [one == BACKGROUND or ages.get(one, 0) >= settings.label_cost_frames for one in ids.tolist()]
        return np.where(proven, 0.0, settings.label_cost)


@dataclass(frozen=True, slots=True)
class _Maps:
    """The maps of a `Segmentation`."""

    labels: Array
    normaliser: Array
    fallback: Array

    @classmethod
    def of_background(cls, shape: tuple[int, int], grid: tuple[int, int]) -> _Maps:
        """Return the maps of a frame without objects, for this many pixels and cells."""
        return cls(np.zeros(shape, np.uint16), np.full(grid, 255, np.uint8), np.zeros(grid, np.int8))


def _summaries(
    statistics: LayerStatistics, posteriors: list[LayerPosterior], frame_px: int
) -> list[LayerSummary]:
    """Summarise the layers that have won a pixel; ``frame_px`` is the number of pixels of the frame."""
    rows = []
    measured = (one.tolist() for one in statistics)
    for one, bounds, sums, likelihood in zip(posteriors, *measured, strict=True):
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
                score=mask_score(likelihood / area, one.confidence, area / frame_px),
            )
        )
    return rows


def _camera(evidence: FrameEvidence) -> Array | None:
    """Return the camera's motion since the last picture, None where it is unknown."""
    known = evidence.frame_index > evidence.epoch and evidence.status != "untracked"
    return evidence.camera if known else None


def _slowest(posteriors: list[LayerPosterior]) -> dict[str, float]:
    """Return each stage's time in the slowest layer, as layers run in parallel."""
    stages: dict[str, float] = {}
    for one in posteriors:
        for stage, duration in one.stage_ms.items():
            stages[stage] = max(stages.get(stage, 0.0), duration)
    return stages
