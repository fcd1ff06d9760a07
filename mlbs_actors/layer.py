"""One layer: motion field, prediction, likelihood, posterior, update — the "processing block" (§5, §6).

:meth:`Layer.step` is called once a frame: it finishes frame t−1 with the published labels, then predicts and
evaluates frame t. The layer works on the region of its object; the background's region is the frame.

The negative logarithm of a pixel's unnormalised posterior is a weighted sum of five terms (weights in
:class:`~mlbs_actors.config.PosteriorConfig`, nats), cut to 0 … 15.9:

* appearance: the kernel density of the pixel's colour, sent apart from the others, because what a layer does
  not know is judged by what the others know (:mod:`mlbs_actors.fusion`).
* motion, −log(ε + (1 − ε) exp(−½ d²)): d² the squared distance of the dense flow from the layer's motion
  field in units of the field's marginal variance plus the flow's own; 0 where the flow is unreliable or
  where the camera's motion explains the image too.
* photometric, for an object: by how much its own motion explains the image better than the camera's
  (:mod:`mlbs_actors.photometric`). It says nothing where the image is smooth.
* away, for an object: 0 near its own trajectories and in the gaps between them, rising to 1 further off.
* prior, −log of the last posterior warped by the layer's own motion, of which the published map is half:
  neutral (0.5 by default) in a new-born layer and where the source is outside the layer's old region, at
  least 0.1 for an object and 0.5 for the background.

Outside its region an object costs 15.9 nats. It learns only where its label is sure
(:meth:`Layer._near_trajectories`).

Differs from the paper: the motion, photometric and away terms are not in it; the prior has a floor, so that
it can be overruled, and a layer is weighed by its own confidence, pixel by pixel (the authors' program makes
*all* layers uniform where one has few samples, and never uses its prior). A layer that wakes after a sleep
keeps its id, not its samples: only its place is known, not the path of its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import cv2
import numpy as np

from mlbs_actors.appearance import AppearanceModel, empty_model, update
from mlbs_actors.camera import homography_motion
from mlbs_actors.config import Config, length_scale
from mlbs_actors.errors import LayerError
from mlbs_actors.fusion import quantised_ratio, with_appearance
from mlbs_actors.gabp import MotionField, MotionParameters, motion_field, node_positions
from mlbs_actors.kde import AppearanceParameters, confidence, warp_and_evaluate
from mlbs_actors.messages import (
    COST_STEP,
    UNEXPLAINED_STEP,
    Array,
    FrameEvidence,
    LayerEvidence,
    LayerKind,
    LayerPosterior,
    Region,
    Segmentation,
)
from mlbs_actors.photometric import FramePart, photometric_advantage
from mlbs_actors.trajectory_distance import closed_distance, trajectory_distance
from mlbs_actors.warp import warp_map

__all__ = ["Layer", "LayerState"]

#: log of the uniform density over 8-bit colours, nats per unit RGB volume.
LOG_UNIFORM = -3.0 * float(np.log(256.0))


@dataclass(slots=True)
class LayerState:
    """Everything that steers the layer's next frame.

    Attributes
    ----------
    last_frame : int
        Frame evaluated last, −1 before the first.
    region : Region
        Where.
    model : AppearanceModel
        Samples at ``last_frame``, without that frame's own colours.
    cost : (h, w) uint8
        Unnormalised posterior of ``last_frame`` without the colours, as sent to the segmenter.
    log_ratio : (h, w) int8
    samples : (h, w) uint8
        What the colours said, as sent to the segmenter.
    image : (h, w, 3) uint8
        That frame's colours, to learn from once its labels are known.
    velocity : (2,) float32
        Median forward motion of the layer's trajectories, px/frame.
    trusted : (h, w) bool
        Where the layer may learn that frame.
    """

    last_frame: int
    region: Region
    model: AppearanceModel
    cost: Array
    log_ratio: Array
    samples: Array
    image: Array
    velocity: Array
    trusted: Array


class Layer:
    """One layer of one stream.

    Parameters
    ----------
    config : Config
    layer : int
        Its id.
    kind : {"background", "object", "other"}
    state : LayerState, optional
        To go on from a snapshot; new-born by default.
    """

    def __init__(self, config: Config, layer: int, kind: LayerKind, state: LayerState | None = None) -> None:
        self.config = config
        self.layer = layer
        self.kind = kind
        nowhere = Region(0, 0, 0, 0)
        self.state = state or LayerState(
            last_frame=-1,
            region=nowhere,
            model=empty_model(nowhere, config.appearance.samples),
            cost=np.zeros((0, 0), np.uint8),
            log_ratio=np.zeros((0, 0), np.int8),
            samples=np.zeros((0, 0), np.uint8),
            image=np.zeros((0, 0, 3), np.uint8),
            velocity=np.zeros(2, np.float32),
            trusted=np.zeros((0, 0), bool),
        )
        self._motion = MotionParameters(
            spacing_px=config.motion.grid_px,
            variance_spacing_px=config.motion.variance_grid_px,
            smoothness_std_px=config.motion.smoothness_std_px,
            point_std_px=config.motion.point_std_px,
            prior_std_px=config.motion.prior_std_px,
            robust_px=config.motion.robust_px,
        )
        self._appearance = AppearanceParameters(
            bandwidth_floor=config.appearance.bandwidth_floor,
            registration_px=(
                config.appearance.background_registration_px
                if kind == "background"
                else config.appearance.registration_px
            ),
            window_radius=config.appearance.window_radius,
            half_confidence_samples=config.appearance.half_confidence_samples,
        )

    def step(
        self,
        evidence: LayerEvidence,
        frame_evidence: FrameEvidence,
        frame: Array,
        previous: Segmentation | None,
    ) -> LayerPosterior:
        """Finish frame t−1, then predict and evaluate frame t.

        Parameters
        ----------
        evidence : LayerEvidence
            This layer's trajectories at t.
        frame_evidence : FrameEvidence
            Of the same frame: camera and dense flow.
        frame : (H, W, 3) uint8
        previous : Segmentation or None
            Published result of t−1; None for the first frame.

        Returns
        -------
        LayerPosterior

        Raises
        ------
        LayerError
            If the evidence is another layer's, or not the next one for this layer.
        """
        state = self.state
        if evidence.layer != self.layer or evidence.last_frame != state.last_frame:
            raise LayerError(
                f"Layer {self.layer} stands at frame {state.last_frame} but was given evidence of layer "
                f"{evidence.layer} that goes on from frame {evidence.last_frame}; "
                "restart the stream from its last snapshot."
            )
        start = perf_counter()
        posterior, support = self._finish(previous)
        finished = perf_counter()
        region = self._next_region(evidence, frame_evidence, support)
        field = self._motion_field(evidence, frame_evidence, region)
        motion = field.dense()
        moved = perf_counter()
        image = np.ascontiguousarray(frame[region.slices])
        model, log_density = warp_and_evaluate(state.model, region, motion, image, self._appearance)
        log_ratio = np.nan_to_num(log_density, nan=LOG_UNIFORM) - LOG_UNIFORM
        log_ratio = quantised_ratio(log_ratio, self.config.posterior.appearance_cap)
        samples = model.count.copy()  # the model goes on learning
        weights = self.config.posterior
        trusted, away = self._near_trajectories(evidence, frame_evidence, region)
        cost = (
            weights.motion * self._motion_cost(frame_evidence, region, field, motion)
            + weights.distance * away
            + weights.prior * self._prior_cost(posterior, region, motion)
        )
        if self.kind != "background":
            camera = _camera_motion(frame_evidence.camera, region)
            own = warp_map(posterior, state.region, region, motion, 0.0) >= 0.5
            before, now = FramePart(state.region, state.image), FramePart(region, image)
            cost -= weights.photometric * photometric_advantage(
                before, now, motion, camera, own, weights.photometric_cap
            )
        quantised = np.clip(np.rint((cost + weights.offset) / COST_STEP), 0, 255).astype(np.uint8)
        evaluated = perf_counter()

        if len(evidence.motions):
            velocity = -np.median(evidence.motions, axis=0).astype(np.float32)
        else:
            velocity = state.velocity
        self.state = LayerState(
            frame_evidence.frame_index,
            region,
            model,
            quantised,
            log_ratio,
            samples,
            image,
            velocity,
            trusted,
        )
        trust = confidence(samples, self._appearance)
        return LayerPosterior(
            layer=self.layer,
            frame_index=frame_evidence.frame_index,
            kind=self.kind,
            region=region,
            cost=quantised,
            log_ratio=log_ratio,
            samples=samples,
            outside_cost=255,
            confidence=float(trust.mean()) if trust.size else 0.0,
            velocity=velocity,
            stage_ms={
                "update": 1e3 * (finished - start),
                "gabp": 1e3 * (moved - finished),
                "posterior": 1e3 * (evaluated - moved),
            },
        )

    def _finish(self, previous: Segmentation | None) -> tuple[Array, Region | None]:
        """Learn frame t−1; return this layer's normalised posterior of it and the box of its pixels."""
        state = self.state
        nothing = np.zeros((0, 0), np.float32)
        if previous is None or previous.frame_index != state.last_frame:
            return nothing, None
        slices = state.region.slices
        mask = np.ascontiguousarray(previous.labels[slices] == self.layer)
        update(state.model, state.image, mask & state.trusted)
        cost = with_appearance(
            state.cost,
            state.log_ratio,
            state.samples,
            np.ascontiguousarray(previous.fallback[slices]),
            self.config.posterior.appearance,
            self.config.appearance.half_confidence_samples,
        )
        log_posterior = previous.normaliser[slices].astype(np.float32) - cost.astype(np.float32)
        posterior = np.exp(np.minimum(log_posterior * np.float32(COST_STEP), 0.0))
        # The published map is the better half of the knowledge: it has seen the outlines.
        posterior = 0.5 * posterior + 0.5 * mask
        if not mask.any():
            return posterior, None
        x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
        return posterior, Region(state.region.x + x, state.region.y + y, width, height)

    def _next_region(
        self, evidence: LayerEvidence, frame_evidence: FrameEvidence, support: Region | None
    ) -> Region:
        """The frame for the background; else the box of trajectories and moved support, with a margin."""
        height, width = frame_evidence.shape
        if self.kind == "background":
            return Region(0, 0, width, height)
        boxes = []
        velocity = self.state.velocity
        if len(evidence.positions):
            boxes.append(np.concatenate([evidence.positions.min(axis=0), evidence.positions.max(axis=0)]))
            velocity = -np.median(evidence.motions, axis=0)
        if support is not None:
            corner = np.array([support.x, support.y]) + velocity
            size = np.array([support.width, support.height])
            boxes.append(np.concatenate([corner, corner + size]))
        if not boxes:
            return Region(0, 0, 0, 0)
        margin = self.config.posterior.region_margin_px * length_scale(height, width)
        low = np.floor(np.min(boxes, axis=0)[:2] - margin).astype(int)
        high = np.ceil(np.max(boxes, axis=0)[2:] + margin).astype(int) + 1
        x0, y0 = np.clip(low, 0, (width, height))
        x1, y1 = np.clip(high, 0, (width, height))
        return Region(int(x0), int(y0), int(x1 - x0), int(y1 - y0))

    def _motion_field(
        self, evidence: LayerEvidence, frame_evidence: FrameEvidence, region: Region
    ) -> MotionField:
        """GaBP on the region; where nothing is known the camera's motion, or an object's own median."""
        shape = (region.height, region.width)
        corner = np.array([region.x, region.y], np.float32)
        prior: Array = np.zeros(2)
        if self.kind == "background" and region.area:
            nodes = node_positions(shape, self._motion.spacing_px)
            prior = homography_motion(frame_evidence.camera, nodes.reshape(-1, 2)).reshape(nodes.shape)
        elif len(evidence.motions):
            prior = np.median(evidence.motions, axis=0)
        elif region.area:
            prior = -self.state.velocity
        return motion_field(evidence.positions - corner, evidence.motions, shape, prior, self._motion)

    def _near_trajectories(
        self, evidence: LayerEvidence, frame_evidence: FrameEvidence, region: Region
    ) -> tuple[Array, Array]:
        """Where the layer may learn, (h, w) bool, and an object's cost in [0, 1] away from its trajectories.

        What is labelled wrongly near an outline must not be learnt. An object learns close to its own
        trajectories, where the camera's motion fails to explain the image; near an object the background
        learns beside its own ones, or where nothing moves against the camera.
        """
        weights, scale = self.config.posterior, length_scale(*frame_evidence.shape)
        noise = self.config.layers.unexplained_noise
        own = trajectory_distance([evidence], region)
        others = trajectory_distance(
            [one for one in frame_evidence.layers if one.layer != self.layer], region
        )
        unexplained = UNEXPLAINED_STEP * _to_region(frame_evidence.unexplained, region, frame_evidence.shape)
        if self.kind == "background":
            trusted = (others > weights.keep_off_px * scale) | (own + 2.0 * scale < others)
            if frame_evidence.frame_index > 0:
                trusted |= (others > weights.learn_px * scale) & (unexplained < 0.5 * noise)
            return trusted, np.zeros(own.shape, np.float32)
        trusted = (own <= weights.learn_px * scale) & (own < others) & (unexplained >= noise)
        body = closed_distance(own, weights.close_px * scale)
        away = np.clip((body - weights.near_px * scale) / (weights.fade_px * scale), 0.0, 1.0)
        return trusted, away

    def _prior_cost(self, posterior: Array, region: Region, motion: Array) -> Array:
        """−log of the last posterior warped by the layer's own motion, (h, w) float32."""
        weights = self.config.posterior
        prior = np.full(motion.shape[:2], weights.neutral_prior, np.float32)
        if posterior.size:
            prior = warp_map(posterior, self.state.region, region, motion, weights.neutral_prior)
        # Background that was hidden has been there all the same: for it the floor is the neutral value.
        floor = weights.neutral_prior if self.kind == "background" else weights.prior_floor
        return np.asarray(-np.log(np.maximum(prior, floor)))

    def _motion_cost(
        self, frame_evidence: FrameEvidence, region: Region, field: MotionField, motion: Array
    ) -> Array:
        """−log(ε + (1−ε) exp(−½d²)) of the dense flow under the motion field."""
        height, width = frame_evidence.shape
        if region.area == 0 or self.config.posterior.motion == 0 or not frame_evidence.flow_reliable.any():
            return np.zeros(motion.shape[:2], np.float32)
        source = np.dstack(
            [frame_evidence.flow.astype(np.float32), frame_evidence.flow_reliable.astype(np.float32)]
        )
        flow = _to_region(source, region, frame_evidence.shape)
        scale = length_scale(height, width)
        variance = field.dense_variance() + (self.config.motion.flow_std_px * scale) ** 2
        distance = np.square(flow[..., :2] - motion).sum(axis=2) / variance
        weights = self.config.posterior
        floor = weights.motion_floor if self.kind == "background" else weights.object_motion_floor
        cost = -np.log(floor + (1.0 - floor) * np.exp(-0.5 * distance))
        # Where the camera's motion explains the image as well, the flow may have bled there: it is not heard.
        unexplained = UNEXPLAINED_STEP * _to_region(frame_evidence.unexplained, region, frame_evidence.shape)
        heard = np.clip(2.0 * unexplained / self.config.layers.unexplained_noise - 1.0, 0.0, 1.0)
        return np.asarray(cost * flow[..., 2] * heard, np.float32)


def _camera_motion(matrix: Array, region: Region) -> Array:
    """The camera's backward motion at a region's pixels, (h, w, 2) float32, px."""
    rows, columns = np.mgrid[region.slices]
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    return homography_motion(matrix, pixels).reshape(region.height, region.width, 2)


def _to_region(coarse: Array, region: Region, shape: tuple[int, int]) -> Array:
    """Bilinear values of a map of the whole frame, coarser than it, at a region's pixels."""
    if region.area == 0:
        return np.zeros((region.height, region.width, *coarse.shape[2:]), coarse.dtype)
    rows, columns = coarse.shape[:2]
    x = ((np.arange(region.x, region.x + region.width) + 0.5) * columns / shape[1] - 0.5).astype(np.float32)
    y = ((np.arange(region.y, region.y + region.height) + 0.5) * rows / shape[0] - 0.5).astype(np.float32)
    map_x, map_y = np.meshgrid(x, y)
    return np.asarray(cv2.remap(coarse, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
