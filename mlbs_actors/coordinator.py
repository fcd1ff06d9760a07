"""The coordinator of one stream: follows trajectories, clusters them, and decides which layers live (§3, §4).

:meth:`Coordinator.step` takes a frame through flow → trajectories → camera → affinities → labels → evidence
for every layer.

Differs from the paper: the first frames, whose motion cannot be known yet, are held and labelled
backwards along their trajectories once the first clustering is done, so that every frame gets its label
map; with ``lookahead`` every frame waits for later ones in the same way. A frame of another size begins a new
*epoch*: held frames are emitted, and everything is reset but the frame count and the next layer id.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from mlbs_actors.cells import cell_side
from mlbs_actors.clustering.affinity import TrajectoryGraph, displacement_spread, trajectory_graph
from mlbs_actors.clustering.label_index import UNLABELLED, distinct_labels
from mlbs_actors.clustering.layer_registry import LayerRegistry, RegistryState
from mlbs_actors.clustering.motion_merging import merge_by_motion
from mlbs_actors.clustering.reidentification import colours_at
from mlbs_actors.clustering.splitting import (
    background_first,
    bled_trajectories,
    label_speeds,
    least_object_speed,
    propagate_labels,
    residual_speed,
    split_labels,
    split_origins,
)
from mlbs_actors.config import Config, length_scale
from mlbs_actors.errors import FrameError
from mlbs_actors.flow.estimate import LEAST_CELLS, FlowFunction, Picture, estimate_flow, picture_of
from mlbs_actors.flow.focus import focus_blocks, focus_boxes
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, LayerKind, LayerTracks, Segmentation
from mlbs_actors.tracking.frame_buffer import HeldFrame, by_layer, first_frame, held_frame, relabelled
from mlbs_actors.tracking.tracker import track
from mlbs_actors.tracking.trajectories import TrajectoryState, empty_trajectories

__all__ = ["Coordinator", "CoordinatorState"]


@dataclass(slots=True)
class CoordinatorState:
    """Everything that determines the coordinator's next frame.

    Attributes
    ----------
    next_frame : int
        Index of the next frame.
    epoch : int
        First frame of the present size.
    shape : (H, W) or None
    picture : Picture
        The last frame as the flow sees it.
    focus : (rows, columns) bool
        Blocks around which the next flow needs its finest level; empty for everywhere.
    trajectories : TrajectoryState
    labels : (n,) int64
        Label of each live trajectory after the last frame.
    spreads : (T,) float64
        Noise scale of the last frames' displacements, newest first, px.
    registry : RegistryState
    clustered : bool
        Whether the first clustering is done.
    held : tuple of HeldFrame
        Oldest first.
    evaluated : dict of int to int
        Last emitted frame of each layer that has a process.
    """

    next_frame: int
    epoch: int
    shape: tuple[int, int] | None
    picture: Picture
    focus: Array
    trajectories: TrajectoryState
    labels: Array
    spreads: Array
    registry: RegistryState
    clustered: bool
    held: tuple[HeldFrame, ...]
    evaluated: dict[int, int]

    @staticmethod
    def beginning(config: Config) -> CoordinatorState:
        """Return the state before the first frame."""
        return CoordinatorState(
            next_frame=0,
            epoch=0,
            shape=None,
            picture=Picture(np.zeros((0, 0), np.uint8), np.zeros((0, 0, 3), np.uint8)),
            focus=np.zeros((0, 0), bool),
            trajectories=empty_trajectories(config.trajectories),
            labels=np.zeros(0, np.int64),
            spreads=np.zeros(0),
            registry=RegistryState.empty(),
            clustered=False,
            held=(),
            evaluated={},
        )


class Coordinator:
    """Tracks, clusters and decides births and retirements of one stream.

    Parameters
    ----------
    state : CoordinatorState, optional
        To continue from a snapshot; a new stream by default.
    flow : FlowFunction, optional
        The caller's own flow, in place of ``config.flow.method``.
    """

    def __init__(
        self, config: Config, state: CoordinatorState | None = None, flow: FlowFunction | None = None
    ) -> None:
        self.config = config
        self.flow = flow
        self.state = state or CoordinatorState.beginning(config)

    def feedback_index(self, frame_index: int) -> int | None:
        """Return the frame whose segmentation :meth:`step` reads, two before the newest to emit, if any."""
        newest, epoch = frame_index - self.config.layers.lookahead, self.state.epoch
        if frame_index + 1 <= epoch + self.config.layers.init_frames or newest - 2 < epoch:
            return None
        return newest - 2 if self._emitted(newest - 2) else None

    def _emitted(self, frame_index: int) -> bool:
        first_held = self.state.held[0].frame_index if self.state.held else self.state.next_frame
        return frame_index < first_held

    def step(
        self, frame_index: int, frame: Array, feedback: Callable[[], Segmentation] | None
    ) -> list[FrameEvidence]:
        """Take one frame.

        Parameters
        ----------
        frame_index : int
            The next one, counting from 0.
        frame : (H, W, 3) uint8
            BGR; one of another size than the last begins an epoch.
        feedback : callable or None
            Returns the Segmentation of :meth:`feedback_index`. It is called last, so that another process can
            compute the label map while this one tracks and clusters.

        Returns
        -------
        list of FrameEvidence
            In frame order: none while frames are held, several when they are released.

        Raises
        ------
        FrameError
            If the frame is not the next one, or has another type.
        """
        self._check(frame_index, frame)
        shape = (int(frame.shape[0]), int(frame.shape[1]))
        if self.state.shape not in (None, shape):
            # The held frames waited for this one, and it is of another size.
            ended = [replace(one, latency_frames=one.latency_frames + 1) for one in self.flush()]
            self._begin_epoch(frame_index)
            return ended + self.step(frame_index, frame, None)
        state, config = self.state, self.config
        stage_ms: dict[str, float] = {}

        with _timed(stage_ms, "flow"):
            side = cell_side(shape, config.grid.cell_px)
            picture, flow = picture_of(frame, side, self.flow is not None), None
            previous, gray = state.picture.gray, picture.gray
            if frame_index > state.epoch and min(gray.shape) >= LEAST_CELLS:
                focus = focus_boxes(state.focus, gray.shape, config.flow) if state.focus.size else None
                flow = estimate_flow(state.picture, picture, side, config, focus, self.flow)

        with _timed(stage_ms, "tracking"):
            known = state.labels == BACKGROUND if state.clustered else np.ones(len(state.labels), bool)
            tracked = track(state.trajectories, known, flow, previous, gray, shape, config)
            trajectories, camera = tracked.trajectories, tracked.camera
            labels = np.full(len(trajectories), UNLABELLED, np.int64)
            labels[: len(tracked.survivors)] = state.labels[tracked.survivors]
            spread = displacement_spread(trajectories, config.affinity, length_scale(*shape))
            spreads = np.concatenate([[spread], state.spreads])[: config.trajectories.history_frames]

        if flow is not None and state.held and state.held[0].frame_index == state.epoch == frame_index - 1:
            first = first_frame(state.held[0], flow, previous, gray, camera, config.trajectories)
            state.held = (first,)
        state.next_frame, state.shape, state.picture = frame_index + 1, shape, picture
        state.trajectories, state.labels, state.spreads = trajectories, labels, spreads
        if self._clustering_due(frame_index):
            self._cluster(frame, frame_index, feedback, stage_ms)
        elif state.clustered:
            published = _published(feedback)
            with _timed(stage_ms, "clustering"):
                registry = LayerRegistry(config.layers, shape, state.registry)
                self._observe(registry, labels, frame, frame_index, published)
        if state.clustered:
            state.focus = focus_blocks(
                tracked.against_camera.advantage, trajectories.positions, trajectories.motions,
                state.labels > BACKGROUND, side, config.flow,
            )  # fmt: skip
        state.held = (
            *state.held,
            held_frame(
                frame_index, trajectories, state.labels, camera, flow, tracked.against_camera, stage_ms
            ),
        )
        return self._emit(frame_index - config.layers.lookahead) if state.clustered else []

    def flush(self) -> list[FrameEvidence]:
        """Emit what is still held at the end of the stream."""
        state = self.state
        if state.held and not state.clustered:
            # Fewer frames than the first clustering needs: cluster those there are.
            colourless = np.zeros((*(state.shape or (0, 0)), 3), np.uint8)
            self._cluster(colourless, state.next_frame - 1, None, {})
        return self._emit(state.next_frame - 1)

    def _check(self, frame_index: int, frame: Array) -> None:
        if frame_index != self.state.next_frame:
            raise FrameError(
                f"Frame {frame_index} came where frame {self.state.next_frame} is due; give frames in order."
            )
        if not isinstance(frame, np.ndarray):
            raise FrameError(
                f"A frame must be a (height, width, 3) uint8 BGR image, not {type(frame).__name__}; "
                "was it read at all?"
            )
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or 0 in frame.shape:
            raise FrameError(
                f"A frame must be a (height, width, 3) uint8 BGR image, not {frame.shape} {frame.dtype}; "
                "convert it first."
            )

    def _begin_epoch(self, frame_index: int) -> None:
        before = self.state
        self.state = replace(
            CoordinatorState.beginning(self.config),
            next_frame=frame_index,
            epoch=frame_index,
            registry=replace(RegistryState.empty(), next_layer=before.registry.next_layer),
            evaluated=before.evaluated,  # whose processes are to be released
        )

    def _clustering_due(self, frame_index: int) -> bool:
        """Cluster in every frame at first, while objects separate; later labels are kept for some frames."""
        layers, age = self.config.layers, frame_index - self.state.epoch
        if not self.state.clustered:
            return age + 1 >= layers.init_frames
        return age < 2 * layers.init_frames or age % layers.clustering_period == 0

    def _graph(self) -> TrajectoryGraph:
        state, history = self.state, self.config.trajectories.history_frames
        spreads = np.concatenate([state.spreads, np.full(history - len(state.spreads), state.spreads[-1])])
        assert state.shape is not None
        return trajectory_graph(state.trajectories, spreads, state.shape, self.config.affinity)

    def _cluster(
        self,
        frame: Array,
        frame_index: int,
        feedback: Callable[[], Segmentation] | None,
        stage_ms: dict[str, float],
    ) -> None:
        """Decide the label of every live trajectory, and with it which layers live."""
        state, config = self.state, self.config
        assert state.shape is not None
        scale = length_scale(*state.shape)
        registry = LayerRegistry(config.layers, state.shape, state.registry)
        with _timed(stage_ms, "affinity"):
            graph = self._graph()
            affinity = graph.matrix()
        with _timed(stage_ms, "clustering"):
            speed = residual_speed(state.trajectories, config.layers.speed_frames)
            bled = bled_trajectories(state.trajectories, speed, config.layers, scale)
            if state.clustered:
                carried = propagate_labels(affinity, state.labels, config.affinity)
                fresh = max(registry.state.next_layer, int(carried.max(initial=0)) + 1)
                labels, firm = split_labels(
                    affinity, carried, config.affinity, fresh, bled, registry.spared_labels()
                )
                registry.spare(firm)
                origins = split_origins(carried, labels)
            else:
                labels, _ = split_labels(affinity, np.full(len(bled), UNLABELLED), config.affinity, 0, bled)
                spacing = config.trajectories.seed_spacing_px * scale
                labels = background_first(labels, state.trajectories, scale, spacing)
                origins = {}
            speeds = label_speeds(speed, labels)
            least = least_object_speed(state.trajectories, labels, speeds, config.layers, scale)
            registry.judge(speeds, least)
            ages = registry.ages(frame_index)
            split = labels
            labels = merge_by_motion(graph, split, ages, speeds, least, config.layers)
            gone = set(speeds) - distinct_labels(labels)
            registry.forget({label: int(labels[split == label][0]) for label in gone})
            # Objects of the first clustering date from the first frame.
            labels = registry.admit(labels, frame_index if state.clustered else state.epoch, origins)
        published = _published(feedback)
        with _timed(stage_ms, "clustering"):
            self._observe(registry, labels, frame, frame_index, published)
            probation = config.layers.probation_frames if state.clustered else 0
            state.labels = registry.promote(state.labels, frame_index, probation)
            state.registry = registry.state
        state.clustered = True
        state.held = relabelled(state.held, state.trajectories, state.labels)

    def _observe(
        self,
        registry: LayerRegistry,
        labels: Array,
        frame: Array,
        frame_index: int,
        published: Collection[int],
    ) -> None:
        state = self.state
        state.labels = registry.observe(
            labels,
            state.trajectories.positions,
            state.trajectories.motions,
            colours_at(frame, state.trajectories.positions),
            frame_index,
            published,
        )
        state.registry = registry.state

    def _emit(self, last: int) -> list[FrameEvidence]:
        """Return the evidence of the held frames up to ``last``."""
        state = self.state
        ready = [held for held in state.held if held.frame_index <= last]
        state.held = tuple(held for held in state.held if held.frame_index > last)
        return [self._evidence(held) for held in ready]

    def _evidence(self, held: HeldFrame) -> FrameEvidence:
        state = self.state
        assert state.shape is not None
        registry = LayerRegistry(self.config.layers, state.shape, state.registry)
        owner = registry.layers_of(held.labels)
        live = sorted({BACKGROUND, *distinct_labels(owner), *registry.live_layers(held.frame_index)})
        retired = set(state.evaluated) - set(live)
        if held.frame_index == state.epoch:
            # All models are of another size, the background's too.
            retired, state.evaluated = set(state.evaluated), {}
        # Where the camera's motion explains the image as well, a trajectory is no evidence of an object: flow
        # bleeds from an object over the smooth road beside it.
        least = np.float32(self.config.layers.least_evidence)
        positions, motions, starts = by_layer(
            np.array(live), owner, held.evidence, least, held.positions, held.motions
        )
        tracks = []
        for one, start, end in zip(live, starts[:-1].tolist(), starts[1:].tolist(), strict=True):
            kind: LayerKind = (
                "background" if one == BACKGROUND else "other" if one == state.registry.other else "object"
            )
            last_frame = state.evaluated.get(one, -1)
            tracks.append(LayerTracks(one, kind, last_frame, start, end))
        state.evaluated = dict.fromkeys(live, held.frame_index)
        return FrameEvidence(
            frame_index=held.frame_index,
            shape=state.shape,
            camera=held.camera,
            flow=held.flow,
            flow_reliable=held.flow_reliable,
            unexplained=held.unexplained,
            tracks=tuple(tracks),
            positions=positions,
            motions=motions,
            retired=tuple(sorted(retired)),
            latency_frames=state.next_frame - 1 - held.frame_index,
            stage_ms=held.stage_ms,
            epoch=state.epoch,
        )


def _published(feedback: Callable[[], Segmentation] | None) -> list[int]:
    """Return the layers that own pixels of the label map that may be read."""
    return [] if feedback is None else [one.layer for one in feedback().layers]


@contextmanager
def _timed(stage_ms: dict[str, float], stage: str) -> Iterator[None]:
    start = perf_counter()
    yield
    stage_ms[stage] = stage_ms.get(stage, 0.0) + 1e3 * (perf_counter() - start)
