"""Fuses the layers' posteriors into one label map by a label-cost graph cut (§7).

E(L) = Σ_i −log P_post(l_i) + Σ_i tracks(l_i) + Σ_i shadow(l_i) + Σ_(i,j) w_ij [l_i ≠ l_j] + Σ_k h_k δ_k(L)

Differs from the paper: the trajectories' own data cost (there for new layers) is always there, not only
where samples are missing: trajectory labels decide, contrast draws the outline, appearance repairs. Cast
shadows, which move with an object, are told from it (:mod:`mlbs_actors.shadows`). The published map is
the cleaned one (specks, pinholes and contact shadows removed), and it is the one the layers learn from.
A layer other than the background can own nothing outside its region, so regions near each other are looked at
together and by themselves (:mod:`mlbs_actors.region_groups`); in them what the layers claim is labelled
(:mod:`mlbs_actors.claims`).
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from mlbs_actors.cells import in_cells, in_pixels, mean_of_cells
from mlbs_actors.claims import claims_of_layers
from mlbs_actors.cleaning import clean_labels
from mlbs_actors.compilation import compiled
from mlbs_actors.config import Config, length_scale
from mlbs_actors.contact_shadow import contact_shadow
from mlbs_actors.contrast import COST_QUANTUM, contrast_weights
from mlbs_actors.data_costs import claimed_costs
from mlbs_actors.errors import FrameError
from mlbs_actors.fusion import FusedCosts, fused_costs
from mlbs_actors.graph_cut import lowest_labels
from mlbs_actors.label_cost_energy import LabelCostEnergy
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
from mlbs_actors.object_regions import box_of
from mlbs_actors.region_groups import group_regions
from mlbs_actors.shadows import darkening, ground_colour, shadow_likelihood

__all__ = ["Segmenter", "SegmenterState"]

#: Margin of a layer's claim, px of a 640×480 frame.
CLAIM_MARGIN_PX = 4.0
#: Where shadows are not looked for.
_NO_SHADOW = np.zeros((0, 0), np.float32)


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
        means, ground = mean_of_cells(frame, side), None
        if settings.shadow > 0 or settings.contact_shadow > 0:
            ground = ground_colour(means, evidence, self.state.labels, length_scale(*evidence.shape))
        scene = _Scene(evidence, frame, means, ground)
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
        claims = claims_of_layers(
            fused.cost,
            fused.places,
            evidence.positions,
            tracks,
            (cells.x, cells.y),
            side,
            round(CLAIM_MARGIN_PX * length_scale(*evidence.shape) / side),
        )
        regions = [
            Region(left, top, right - left, bottom - top) for top, bottom, left, right in claims[1:].tolist()
        ]
        groups = group_regions(regions, (cells.height, cells.width))
        stage_ms["fusion"] += 1e3 * (perf_counter() - start)
        summaries: list[LayerSummary] = []
        for group in groups:
            own = np.array([0, *(1 + position for position in group.members)])
            claimants = [members[position] for position in own]
            claimed = _Claimed(fused, cells, own, group.box, claims, tracks)
            summaries += self._label_claims(claimants, claimed, scene, result, stage_ms)
        return summaries

    def _label_claims(
        self,
        members: list[LayerPosterior],
        claimed: _Claimed,
        scene: _Scene,
        result: _Maps,
        stage_ms: dict[str, float],
    ) -> list[LayerSummary]:
        """Fill in the label map in a box around claims that touch."""
        config, scale = self.config.segmentation, length_scale(*result.labels.shape)
        start = perf_counter()
        side, fused, within = members[0].cell, claimed.fused, claimed.box
        cells = Region(claimed.cells.x + within.x, claimed.cells.y + within.y, within.width, within.height)
        box = in_pixels(cells, side, result.labels.shape)
        dark = None if scene.ground is None else darkening(scene.means, scene.ground, cells, 1.0 / side)
        shadow, strength = _NO_SHADOW, 0.0
        if dark is not None and config.shadow > 0:
            shadow, strength = shadow_likelihood(dark), config.shadow / COST_QUANTUM
        costs, places, pulls = claimed_costs(
            fused.cost,
            claimed.own,
            box_of(within),
            claimed.claims,
            shadow,
            np.float32(strength),
            scene.evidence.positions,
            claimed.tracks,
            (box.x, box.y),
            scene.evidence.shape,
            side,
            round(2.0 * config.track_cost / COST_QUANTUM),
        )
        # Arrays of their own, though the box may be the frame: kernels are compiled for one kind of memory.
        image = scene.frame[box.slices].copy()
        ready = perf_counter()
        label_costs = np.full(len(members), round(config.label_cost * scale**2 / COST_QUANTUM), np.int64)
        label_costs[0] = 0  # the background is always there
        weights = contrast_weights(image, config.contrast_strength, config.contrast_scale)
        labelling = lowest_labels(LabelCostEnergy(costs, weights, label_costs, side, pulls, places))
        solved = perf_counter()
        ids = np.array([one.layer for one in members], np.uint16)
        speck_px, hole_px = config.speck_px * scale**2, config.hole_px * scale**2
        labels = _cleaned(ids, labelling, result.labels, box.x, box.y, speck_px, hole_px)
        if dark is not None and config.contact_shadow > 0:
            strip = contact_shadow(labels, image, dark, side, scale, config.contact_shadow)
            if strip.any():
                labels[strip] = BACKGROUND
                result.labels[box.slices] = labels
        summaries = _summaries(labels, ids, claimed, members, box)
        done = perf_counter()
        for stage, duration in (
            ("fusion", ready - start),
            ("cut", solved - ready),
            ("cleaning", done - solved),
        ):
            stage_ms[stage] += 1e3 * duration
        return summaries


@dataclass(frozen=True, slots=True)
class _Claimed:
    """Claims that touch, in a group of regions that does.

    Attributes
    ----------
    fused : FusedCosts
        Of all layers of the group.
    cells : Region
        Where that lies.
    own : (k,) int64
        Which of the layers make the claims, the background first.
    box : Region
        Around the claims, within ``cells``.
    claims, tracks : Array
        Of all layers of the group; see :func:`~mlbs_actors.claims.claims_of_layers`.
    """

    fused: FusedCosts
    cells: Region
    own: Array
    box: Region
    claims: Array
    tracks: Array


@dataclass(frozen=True, slots=True)
class _Scene:
    """A frame, what is known of it, the means of its cells, and the ground's colour if that is looked at."""

    evidence: FrameEvidence
    frame: Array
    means: Array
    ground: Array | None


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


@compiled()
def _cleaned(
    ids: Array, positions: Array, labels: Array, left: int, top: int, speck_px: float, hole_px: float
) -> Array:
    """Put the ids of some label positions into a box of the label map, clean it there, and copy it."""
    height, width = positions.shape
    for y in range(height):
        row, own = positions[y], labels[top + y, left : left + width]
        for x in range(width):
            own[x] = ids[row[x]]
    clean_labels(labels, (left, top, width, height), speck_px, hole_px)
    return labels[top : top + height, left : left + width].copy()


def _summaries(
    labels: Array, ids: Array, claimed: _Claimed, posteriors: list[LayerPosterior], box: Region
) -> list[LayerSummary]:
    bounds, sums, likelihood = _tally(
        labels,
        ids,
        claimed.fused.cost,
        claimed.own,
        claimed.fused.normaliser,
        (claimed.box.x, claimed.box.y),
        posteriors[0].cell,
    )
    rows = []
    for own, one in enumerate(posteriors):
        (left, top, right, bottom), (area, x, y) = bounds[own].tolist(), sums[own].tolist()
        if own == 0 or area == 0:
            continue
        rows.append(
            LayerSummary(
                layer=one.layer,
                kind="other" if one.kind == "other" else "object",
                region=Region(box.x + left, box.y + top, right - left + 1, bottom - top + 1),
                area=area,
                centroid=(box.x + x / area, box.y + y / area),
                velocity=(float(one.velocity[0]), float(one.velocity[1])),
                confidence=float(likelihood[own] / area),
            )
        )
    return rows


@compiled()
def _tally(
    labels: Array, ids: Array, cost: Array, layers: Array, normaliser: Array, corner: tuple[int, int],
    side: int,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Of every id but that of the background: least and largest x and y, number of pixels and sums of x and
    y, and the sum of its posteriors, from the costs of these layers in cells from a corner on."""
    bounds, sums = np.empty((ids.size, 4), np.int64), np.zeros((ids.size, 3), np.int64)
    bounds[:, :2], bounds[:, 2:] = 2**31, -1
    likelihood = np.zeros(ids.size, np.float64)
    certain = np.exp(np.arange(256) * -COST_STEP)
    position = np.zeros(ids.max() + 1, np.int64)
    for own in range(ids.size):
        position[ids[own]] = own
    for y in range(labels.shape[0]):
        row, floor, x = labels[y], normaliser[corner[1] + y // side, corner[0] :], 0
        while x < row.size:
            label, start = row[x], x
            while x < row.size and row[x] == label:
                x += 1
            if label == BACKGROUND:
                continue
            own, length = position[label], x - start
            bounds[own, 0], bounds[own, 1] = min(bounds[own, 0], start), min(bounds[own, 1], y)
            bounds[own, 2], bounds[own, 3] = max(bounds[own, 2], x - 1), y
            sums[own, 0] += length
            sums[own, 1] += (start + x - 1) * length // 2
            sums[own, 2] += y * length
            costs = cost[layers[own], corner[1] + y // side, corner[0] :]
            for cell in range(start // side, (x - 1) // side + 1):
                posterior = certain[max(np.int64(costs[cell]) - np.int64(floor[cell]), 0)]
                for _ in range(max(start, cell * side), min(x, (cell + 1) * side)):
                    likelihood[own] += posterior
    return bounds, sums, likelihood


def _slowest(posteriors: list[LayerPosterior]) -> dict[str, float]:
    """The layers work side by side: of each stage the slowest counts."""
    stages: dict[str, float] = {}
    for one in posteriors:
        for stage, duration in one.stage_ms.items():
            stages[stage] = max(stages.get(stage, 0.0), duration)
    return stages
