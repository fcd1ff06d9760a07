"""Puts the coordinator of one stream together: each frame goes gate → matching → labels → evidence.

Differs from the paper: the first frames, whose motion cannot be known yet, are held and labelled
backwards along their trajectories once the first clustering is done, so that every frame gets its label
map; with ``lookahead`` every frame waits for later ones in the same way. Frames of another size, and the
first picture after a cut, begin a new *epoch*: what was held comes out, and all starts anew but the count of
frames and of layer ids. If the scene is one that was left shortly before, its objects count as lost ones.
In a picture that does not tell the camera's motion the layers go on, but nothing is clustered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mlbs_actors.clustering.left_scenes import LeftScene, moved_registry
from mlbs_actors.clustering.registry_state import RegistryState
from mlbs_actors.config import Config, length_scale
from mlbs_actors.coordinator.advance import advance, clustering_due, follow_on
from mlbs_actors.coordinator.evidence import frame_evidence, is_at_rest
from mlbs_actors.coordinator.gate import BeginScene, PassOver, Take, Wait, admitted, passed_over
from mlbs_actors.coordinator.held_frames import no_picture
from mlbs_actors.coordinator.labelling import cluster
from mlbs_actors.coordinator.matching import Matcher
from mlbs_actors.coordinator.state import CoordinatorState, EpochState, NewFrame
from mlbs_actors.errors import FrameError
from mlbs_actors.flow.estimate import FlowFunction
from mlbs_actors.messages import BACKGROUND, NO_PICTURE, Array, FrameEvidence, FrameStatus, Segmentation
from mlbs_actors.stages import timed
from mlbs_actors.tracking.trajectories import TrackFunction

__all__ = ["Coordinator"]

#: So many scenes that were left are remembered.
MOST_SCENES = 3


class Coordinator:
    """Tracks, clusters and decides births and retirements of one stream.

    Parameters
    ----------
    state : CoordinatorState, optional
        To continue from a snapshot; a new stream by default.
    flow : FlowFunction, optional
        The caller's own flow, in place of ``config.flow.method``.
    ignored : (h, w) bool, optional
        Mask of what is fixed in the picture, whatever is found by itself; scaled to the frame.
    tracks : TrackFunction, optional
        The caller's own point tracker: trajectories follow it in place of the flow.
    """

    def __init__(
        self,
        config: Config,
        state: CoordinatorState | None = None,
        flow: FlowFunction | None = None,
        ignored: Array | None = None,
        tracks: TrackFunction | None = None,
    ) -> None:
        self.config = config
        self.state = state or CoordinatorState.beginning(config)
        self._matcher = Matcher(config, flow, tracks, ignored)

    def feedback_index(self, frame_index: int) -> int | None:
        """Return the frame whose segmentation :meth:`step` reads, two before the newest to emit, if any."""
        newest, first = frame_index - self.config.layers.lookahead, self.state.epoch.first
        if frame_index + 1 <= first + self.config.layers.init_frames or newest - 2 < first:
            return None
        return newest - 2 if self._emitted(newest - 2) else None

    def possible_layers(self) -> set[int]:
        """Return a superset of the layers that frames to come, or held ones, may have."""
        epoch = self.state.epoch
        labels = [epoch.registry.labels, epoch.labels, *(one.labels for one in epoch.held)]
        labels += [one.registry.labels for one in self.state.left]
        return {epoch.registry.other, *(layer for one in labels for layer in np.unique(one).tolist())}

    def step(
        self,
        frame_index: int,
        frame: Array,
        feedback: Callable[[], Segmentation] | None,
        concealed: bool = False,
    ) -> list[FrameEvidence]:
        """Take one frame.

        Parameters
        ----------
        frame_index : int
            The next one, counting from 0.
        frame : (H, W, 3) uint8
            BGR; one of another size than the last begins an epoch.
        feedback : callable or None
            Returns the Segmentation of :meth:`feedback_index`. It is called last, if at all, so that another
            process can compute the label map while this one tracks and clusters.
        concealed : bool
            Whether the frame is known to be damaged.

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
        shape, shown = (int(frame.shape[0]), int(frame.shape[1])), list[FrameEvidence]()
        if shape != self.state.epoch.shape:
            shown, feedback = self._resized(frame_index, shape), None
        new, at_rest = self._begin(frame_index, frame), is_at_rest(self.state, self.config)
        for decision in admitted(self.state, new, self._matcher, at_rest, concealed):
            shown += self._carry_out(decision, feedback)
        return shown + self._ready()

    def begin_anew(self) -> list[FrameEvidence]:
        """End the epoch, as after a cut; return what was held of it.

        For other parameters than those of the state, by which the next picture begins another epoch.
        """
        shown = self.flush()
        self.state.left = ()
        self._begin_epoch(self.state.next_frame, self.state.epoch.shape, cut=True)
        return shown

    def flush(self) -> list[FrameEvidence]:
        """Emit what is still held at the end of the stream."""
        for one in passed_over(self.state.epoch.waiting):
            self._pass_over(one.frame_index, one.status)
        epoch, last = self.state.epoch, self.state.next_frame - 1
        if epoch.pictures and not epoch.clustered:
            # Fewer frames than the first clustering wants: cluster those there are.
            cluster(epoch, last, None, self.config, {})
        return self._emit(last)

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

    def _resized(self, frame_index: int, shape: tuple[int, int]) -> list[FrameEvidence]:
        """Begin an epoch with a frame of another size; return what was held of the last one."""
        # The held frames waited for this one.
        ended = [replace(one, latency_frames=one.latency_frames + 1) for one in self.flush()]
        self.state.left = ()
        self._begin_epoch(frame_index, shape)
        return ended

    def _begin(self, frame_index: int, frame: Array) -> NewFrame:
        """Prepare the newest frame."""
        stage_ms: dict[str, float] = {}
        with timed(stage_ms, "flow"):
            new = NewFrame(frame_index, self._matcher.picture(frame), stage_ms)
        state, oldest = self.state, frame_index - self.config.layers.dormant_frames
        state.next_frame = frame_index + 1
        state.left = tuple(one for one in state.left if one.last_frame >= oldest)
        return new

    def _carry_out(
        self, decision: PassOver | BeginScene | Take | Wait, feedback: Callable[[], Segmentation] | None
    ) -> list[FrameEvidence]:
        """Follow a decision of the gate; return what was held of an epoch that it ends."""
        if isinstance(decision, BeginScene):
            return self._begin_scene(decision.first)
        if isinstance(decision, PassOver):
            self._pass_over(decision.frame_index, decision.status)
        elif isinstance(decision, Take):
            is_newest = decision.new.frame_index == self.state.next_frame - 1
            self._take(decision, feedback if is_newest else None)
        else:
            epoch, waiting = self.state.epoch, decision.frame
            epoch.lost += int(waiting.lost)
            epoch.waiting = (*epoch.waiting, waiting)
        return []

    def _take(self, decision: Take, feedback: Callable[[], Segmentation] | None) -> None:
        epoch, new, match = self.state.epoch, decision.new, decision.match
        self._stop_waiting(new.frame_index)
        follow_on(epoch, new, match, self.config)
        due = clustering_due(epoch, new.frame_index, self.config.layers)
        if due and match.told and new.frame_index - epoch.first < 2 * self.config.layers.init_frames:
            self._recall(new)
        advance(epoch, new, match, due, feedback, self.config)

    def _recall(self, new: NewFrame) -> None:
        """If a picture is one of a scene that was left, take its objects for lost ones of this scene."""
        epoch, scale = self.state.epoch, length_scale(*self.state.epoch.shape)
        for scene in self.state.left:
            flow = self._matcher.found(scene.view, new.picture, epoch.shape)
            if flow is not None:
                lost = moved_registry(scene, flow, scale, self.config.trajectories)
                epoch.registry = epoch.registry.with_lost(lost)
                self.state.left = tuple(one for one in self.state.left if one is not scene)

    def _stop_waiting(self, frame_index: int) -> None:
        epoch = self.state.epoch
        epoch.waiting = tuple(one for one in epoch.waiting if one.frame_index != frame_index)

    def _pass_over(self, frame_index: int, status: FrameStatus) -> None:
        """Have a frame carry the labels of the last picture."""
        epoch = self.state.epoch
        self._stop_waiting(frame_index)
        epoch.held = (*epoch.held, no_picture(frame_index, status))
        if not epoch.pictures and status == "blank":
            # After that much black, say, the first picture is that of another scene.
            epoch.cut |= frame_index + 1 - epoch.first >= self.config.layers.init_frames

    def _begin_scene(self, first: NewFrame) -> list[FrameEvidence]:
        """End the epoch; return what was held of it. Another one begins with a frame."""
        self._stop_waiting(first.frame_index)
        shown, before = self.flush(), self.state.epoch
        if (before.registry.labels > BACKGROUND).any():
            left = LeftScene(before.view, first.frame_index - 1, before.registry)
            self.state.left = (left, *self.state.left[: MOST_SCENES - 1])
        self._begin_epoch(first.frame_index, before.shape, cut=True)
        return shown

    def _begin_epoch(self, first: int, shape: tuple[int, int], cut: bool = False) -> None:
        registry = replace(RegistryState.empty(), next_layer=self.state.epoch.registry.next_layer)
        self.state.epoch = EpochState.beginning(self.config, first, shape, registry, cut)

    def _emitted(self, frame_index: int) -> bool:
        epoch, first_held = self.state.epoch, self.state.next_frame
        if epoch.held:
            first_held = epoch.held[0].frame_index
        elif epoch.waiting:
            first_held = epoch.waiting[0].frame_index
        return frame_index < first_held

    def _ready(self) -> list[FrameEvidence]:
        """Emit the evidence of the frames that need not be held any longer."""
        epoch, config = self.state.epoch, self.config.layers
        newest = (epoch.waiting[0].frame_index if epoch.waiting else self.state.next_frame) - 1
        if epoch.clustered:
            return self._emit(newest - config.lookahead)
        if not epoch.pictures:
            return self._emit(newest)
        latest = [held.status in NO_PICTURE for held in epoch.held[-config.init_frames :]]
        if epoch.waiting or len(latest) < config.init_frames or not all(latest):
            return []
        # The scene stands still, or has not begun: it does when something is seen.
        shown = self.flush()
        self._begin_epoch(self.state.next_frame, epoch.shape)
        self.state.epoch.picture = epoch.picture
        return shown

    def _emit(self, last: int) -> list[FrameEvidence]:
        """Return the evidence of the held frames up to ``last``."""
        epoch = self.state.epoch
        ready = [held for held in epoch.held if held.frame_index <= last]
        epoch.held = tuple(held for held in epoch.held if held.frame_index > last)
        return [frame_evidence(self.state, held, self.config) for held in ready]
