"""The coordinator of one stream: follows trajectories, clusters them, and decides which layers live (§3, §4).

:meth:`Coordinator.step` takes a frame through flow → trajectories → camera → affinities → labels → evidence
for every layer.

Differs from the paper: the first frames, whose motion cannot be known yet, are held and labelled
backwards along their trajectories once the first clustering is done, so that every frame gets its label
map; with ``lookahead`` every frame waits for later ones in the same way. Frames of another size, and the
first picture after a cut, begin a new *epoch*: what was held comes out, and all starts anew but the count of
frames and of layer ids. If the scene is one that was left shortly before, its objects count as lost ones.

Nor does the paper know frames that show nothing of the scene (:mod:`mlbs_actors.footage`). They are passed
over: they carry the labels of the last picture, and the next picture is compared with that one. A frame in
which the last picture is not found again waits for the next frame. If the last picture goes on there, the
frame between was damaged; if the frame itself does, a new scene has begun with it. In a picture that does not
tell the camera's motion the layers go on, but nothing is clustered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mlbs_actors.cells import cell_side
from mlbs_actors.clustering.affinity import displacement_spread
from mlbs_actors.clustering.label_index import UNLABELLED, distinct_labels
from mlbs_actors.clustering.layer_registry import LayerRegistry
from mlbs_actors.clustering.left_scenes import LeftScene, moved_registry
from mlbs_actors.clustering.registry_state import RegistryState
from mlbs_actors.clustering.two_views import Places
from mlbs_actors.config import Config, length_scale
from mlbs_actors.coordinator_labels import cluster, observe
from mlbs_actors.coordinator_state import CoordinatorState, NewFrame, UnsettledFrame
from mlbs_actors.errors import FrameError
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.flow.estimate import LEAST_CELLS, FlowEstimator, FlowFunction, Picture, picture_of
from mlbs_actors.flow.focus import focus_blocks, focus_boxes
from mlbs_actors.footage.continuation import continuation
from mlbs_actors.footage.continuity import LEAST_FOUND, found_again, is_torn, rows_astray, tells_motion
from mlbs_actors.footage.fixed import FixedState
from mlbs_actors.footage.light import colour_samples, unchanged
from mlbs_actors.footage.pictures import is_blank, is_still, repeats
from mlbs_actors.messages import (
    BACKGROUND,
    NO_PICTURE,
    Array,
    FrameEvidence,
    FrameStatus,
    LayerKind,
    LayerTracks,
    Segmentation,
)
from mlbs_actors.stages import timed
from mlbs_actors.tracking.frame_buffer import (
    HeldFrame,
    by_layer,
    first_frame,
    held_frame,
    no_picture,
    relabelled,
)
from mlbs_actors.tracking.tracker import Tracked, track
from mlbs_actors.tracking.trajectories import TrackFunction, follow_trajectories

__all__ = ["Coordinator"]


#: So many frames in a row with a glare are no flash, but have a new light.
LASTING_LIGHT = 3
#: After so many frames in which the last picture is not found, the scene is taken for another one.
LONGEST_LOSS = 5
#: So many scenes that were left are remembered.
MOST_SCENES = 3
#: An object rests if less than this share of its trajectories has evidence of motion.
RESTING = 0.5


@dataclass(frozen=True, slots=True)
class _Match:
    """A picture compared with the last one.

    Attributes
    ----------
    status : FrameStatus
        ``"ok"`` if it goes on from there.
    flow : DenseFlow or None
        None in the first picture of an epoch, and if the last picture is not found again.
    tracked : Tracked or None
        None if the flow does not find the last picture again.
    light : (3, 256) or (0, 256) uint8
    gray : (h, w) uint8
        The last picture, as the flow sees it, in the new light.
    astray : (rows,) float32
    told : bool
        Whether it tells the camera's motion.
    whole : bool
        Whether the last picture goes on nearly everywhere.
    """

    status: FrameStatus
    flow: DenseFlow | None
    tracked: Tracked | None
    light: Array
    gray: Array
    astray: Array
    told: bool
    whole: bool


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
        self.flow = flow
        self.ignored = ignored
        self.tracks = tracks
        self.state = state or CoordinatorState.beginning(config)
        self._flows = FlowEstimator(config, flow)

    def feedback_index(self, frame_index: int) -> int | None:
        """Return the frame whose segmentation :meth:`step` reads, two before the newest to emit, if any."""
        newest, epoch = frame_index - self.config.layers.lookahead, self.state.epoch
        if frame_index + 1 <= epoch + self.config.layers.init_frames or newest - 2 < epoch:
            return None
        return newest - 2 if self._emitted(newest - 2) else None

    def possible_layers(self) -> set[int]:
        """Return a superset of the layers that frames to come, or held ones, may have."""
        state = self.state
        labels = [state.registry.labels, state.labels, *(one.labels for one in state.held)]
        labels += [one.registry.labels for one in state.left]
        return {state.registry.other, *(layer for one in labels for layer in np.unique(one).tolist())}

    def _emitted(self, frame_index: int) -> bool:
        state, first_held = self.state, self.state.next_frame
        if state.held:
            first_held = state.held[0].frame_index
        elif state.unsettled:
            first_held = state.unsettled[0].frame_index
        return frame_index < first_held

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
            Returns the Segmentation of :meth:`feedback_index`. It is called last, so that another process can
            compute the label map while this one tracks and clusters.
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
        shape = (int(frame.shape[0]), int(frame.shape[1]))
        if self.state.shape not in (None, shape):
            # The held frames waited for this one, and it is of another size.
            self._settle()
            ended = [replace(one, latency_frames=one.latency_frames + 1) for one in self.flush()]
            self._begin_epoch(frame_index)
            return ended + self.step(frame_index, frame, None, concealed)
        stage_ms: dict[str, float] = {}
        with timed(stage_ms, "flow"):
            side = cell_side(shape, self.config.grid.cell_px)
            picture = picture_of(frame, side, self.flow is not None or self.tracks is not None)
        self.state.shape = shape
        self.state.next_frame = frame_index + 1
        oldest = frame_index - self.config.layers.dormant_frames
        self.state.left = tuple(one for one in self.state.left if one.last_frame >= oldest)
        if concealed:
            return self._pass_over(frame_index, "damaged", feedback)
        if is_blank(picture.gray, self.state.picture.gray):
            return self._pass_over(frame_index, "blank", feedback)
        seen = is_still if self._is_at_rest() else repeats
        if not self.state.unsettled and seen(picture.gray, self.state.picture.gray):
            return self._pass_over(frame_index, "repeated", feedback)
        shown = self._go_on(NewFrame(frame_index, frame, picture), feedback, stage_ms)
        newest = frame_index if not self.state.unsettled else self.state.unsettled[0].frame_index - 1
        return shown + (self._emit(newest - self.config.layers.lookahead) if self.state.clustered else [])

    def _go_on(
        self, new: NewFrame, feedback: Callable[[], Segmentation] | None, stage_ms: dict[str, float]
    ) -> list[FrameEvidence]:
        """Go on to a frame that is no repetition, or have it wait; return what ends before a new scene."""
        state, shown = self.state, []
        match = self._matched(new, stage_ms)
        if match.status == "ok":
            self._settle()
        elif state.unsettled and state.unsettled[-1].lost and self._begins(state.unsettled[-1], new.picture):
            first = state.unsettled[-1].new
            self._settle(state.unsettled[:-1])
            shown = self._begin_scene(first)
            self._take(first, self._matched(first, {}), None, {})
            match = self._matched(new, stage_ms)
        elif match.status == "flash" and len(state.unsettled) + 1 >= LASTING_LIGHT:
            for one in state.unsettled:
                self._take_or_pass_over(one.new, None, {})
            state.unsettled = ()
            self._take_or_pass_over(new, feedback, stage_ms)
            return []
        lost = match.status == "damaged" and match.flow is None
        if lost and self.state.lost + 1 >= LONGEST_LOSS:
            self._settle()
            shown += self._begin_scene(new)
            match = self._matched(new, stage_ms)
        if match.status == "ok":
            self._take(new, match, feedback, stage_ms)
            return shown
        if match.status != "flash":
            self._settle()
        if feedback is not None:
            feedback()  # the layers must keep pace
        self.state.lost += int(lost)
        self.state.unsettled = (*self.state.unsettled, UnsettledFrame(new, match.status, lost))
        return shown

    def _begin_scene(self, first: NewFrame) -> list[FrameEvidence]:
        """End the epoch; return what was held of it. Another one begins with a frame."""
        ended = self.flush()
        before = self.state
        self._begin_epoch(first.frame_index)
        state = self.state
        state.next_frame, state.shape, state.cut = before.next_frame, before.shape, True
        state.left = before.left
        if (before.registry.labels > BACKGROUND).any():
            left = LeftScene(before.view, first.frame_index - 1, before.registry)
            state.left = (left, *before.left[: MOST_SCENES - 1])
        return ended

    def _recall(self, picture: Picture) -> None:
        """If the picture is one of a scene that was left, take its objects for lost ones of this scene."""
        state, config = self.state, self.config
        assert state.shape is not None
        side = cell_side(state.shape, config.grid.cell_px)
        for scene in state.left:
            flow = self._flows.between(scene.view, picture, side)
            if found_again(flow, scene.view.gray, picture.gray) >= LEAST_FOUND:
                lost = moved_registry(scene, flow, length_scale(*state.shape), config.trajectories)
                state.registry = state.registry.with_lost(lost)
                state.left = tuple(one for one in state.left if one is not scene)

    def _take_or_pass_over(
        self, new: NewFrame, feedback: Callable[[], Segmentation] | None, stage_ms: dict[str, float]
    ) -> None:
        """Go on to a frame in its new light."""
        match = self._matched(new, stage_ms, lasting=True)
        if match.tracked is None:
            self.state.held = (*self.state.held, no_picture(new.frame_index, match.status))
        else:
            self._take(new, match, feedback, stage_ms)

    def _matched(self, new: NewFrame, stage_ms: dict[str, float], *, lasting: bool = False) -> _Match:
        """Find the last picture again in a new one, and follow the trajectories there.

        ``lasting`` is whether its light is known to last.
        """
        state, config, picture = self.state, self.config, new.picture
        assert state.shape is not None
        side = cell_side(state.shape, config.grid.cell_px)
        flow, light, gray = None, unchanged(), state.picture.gray
        status: FrameStatus = "ok"
        astray, told, whole = np.zeros(0, np.float32), True, True
        if state.pictures and min(picture.gray.shape) >= LEAST_CELLS:
            boxes = focus_boxes(state.focus, picture.gray.shape, config.flow) if state.focus.size else None

            def search(before: Picture, closely: bool) -> DenseFlow:
                return self._flows.between(before, picture, side, None if closely else boxes)

            with timed(stage_ms, "flow"):
                goes_on = continuation(state.picture, state.colours, picture, new.frame, search)
            flow, light, gray, whole = goes_on.flow, goes_on.light, goes_on.gray, goes_on.whole
            if not goes_on.found:
                return _Match("damaged", None, None, light, gray, astray, False, whole)
            if goes_on.glaring and not lasting:
                return _Match("flash", flow, None, light, gray, astray, False, whole)
            told = tells_motion(flow, gray, picture.gray)
        with timed(stage_ms, "tracking"):
            known = state.labels == BACKGROUND if state.clustered else np.ones(len(state.labels), bool)
            fixed = state.fixed if state.pictures else FixedState.beginning(picture.gray, self.ignored)
            follow = None
            if self.tracks is not None:
                follow = partial(
                    follow_trajectories,
                    function=self.tracks,
                    previous=state.picture.image,
                    current=picture.image,
                )
            tracked = track(
                state.trajectories, known, fixed, flow, gray, picture.gray, state.shape, config, follow
            )
            if flow is not None:
                astray = rows_astray(flow, tracked.camera, length_scale(*state.shape))
                if not state.unsettled and is_torn(astray, state.astray):
                    status = "damaged"
        return _Match(status, flow, tracked, light, gray, astray, told, whole)

    def _begins(self, unsettled: UnsettledFrame, picture: Picture) -> bool:
        """Whether a frame in which the last picture was not found goes on in the next one: a new scene."""
        assert self.state.shape is not None
        before, side = unsettled.new.picture, cell_side(self.state.shape, self.config.grid.cell_px)
        flow = self._flows.between(before, picture, side)
        return found_again(flow, before.gray, picture.gray) >= LEAST_FOUND

    def _take(
        self,
        new: NewFrame,
        match: _Match,
        feedback: Callable[[], Segmentation] | None,
        stage_ms: dict[str, float],
    ) -> None:
        """Go on to a picture."""
        frame_index, frame, picture = new.frame_index, new.frame, new.picture
        state, config, flow, tracked = self.state, self.config, match.flow, match.tracked
        assert tracked is not None
        assert state.shape is not None
        side = cell_side(state.shape, config.grid.cell_px)
        with timed(stage_ms, "tracking"):
            trajectories, camera = tracked.trajectories, tracked.camera
            labels = np.full(len(trajectories), UNLABELLED, np.int64)
            labels[: len(tracked.survivors)] = state.labels[tracked.survivors]
            static = np.full(len(trajectories), np.nan, np.float32)
            static[: len(tracked.survivors)] = state.static[tracked.survivors]
            spread = displacement_spread(trajectories, config.affinity, length_scale(*state.shape))
            spreads = np.concatenate([[spread], state.spreads])[: config.trajectories.history_frames]

        if flow is not None and state.pictures == 1 and state.held:
            first = next(place for place, one in enumerate(state.held) if one.status not in NO_PICTURE)
            known = first_frame(
                state.held[first], flow, match.gray, picture.gray, camera, config.trajectories
            )
            state.held = (*state.held[:first], known, *state.held[first + 1 :])
        status: FrameStatus = "ok" if match.told else "untracked"
        if state.pictures == 0:
            status = "cut" if state.cut else "ok"
            state.epoch = frame_index
        state.pictures, state.lost = state.pictures + 1, 0
        state.picture, state.colours, state.astray = picture, colour_samples(frame, side), match.astray
        if match.whole:
            state.view = picture
        state.fixed = tracked.fixed
        state.trajectories, state.labels, state.static = trajectories, labels, static
        state.spreads = spreads
        newest, before = Places(trajectories.ids, trajectories.positions), state.places
        if tracked.swing is not None:
            before = tuple(one.without(tracked.swing) for one in before)
        state.places = (newest, *before)[: config.layers.scene_frames + 1]
        if not match.told and self._clustering_due(frame_index) and not state.clustered:
            # Nothing is known of what moves: all is background until the camera's motion is told.
            state.labels, state.clustered = np.full(len(trajectories), BACKGROUND, np.int64), True
            state.held = relabelled(state.held, trajectories, state.labels)
        if match.told and self._clustering_due(frame_index):
            state.last_clustering = frame_index
            if state.left and frame_index - state.epoch < 2 * config.layers.init_frames:
                self._recall(picture)
            cluster(state, frame, frame_index, feedback, config, stage_ms)
        elif state.clustered:
            latest = None if feedback is None else feedback()
            with timed(stage_ms, "clustering"):
                registry = LayerRegistry(config, state.shape, state.registry)
                observe(state, registry, labels, frame, frame_index, latest)
        if state.clustered:
            state.focus = focus_blocks(
                tracked.against_camera.advantage, trajectories.positions, trajectories.motions,
                state.labels > BACKGROUND, side, config.flow,
            )  # fmt: skip
        held = held_frame(frame_index, tracked, state.labels, flow, stage_ms, status, match.light)
        state.held = (*state.held, held)

    def _is_at_rest(self) -> bool:
        """Whether nothing moves in the last picture: whatever is or may become an object has long rested.

        What has not moved often may still turn out to be a part of the scene, and is looked at on.
        """
        state = self.state
        if not state.clustered or state.shape is None:
            return False
        registry = LayerRegistry(self.config, state.shape, state.registry)
        at_rest = {BACKGROUND, *(registry.lasting_layers() & set(registry.resting_layers()))}
        return at_rest.issuperset({*state.evaluated, *distinct_labels(state.labels)})

    def _pass_over(
        self, frame_index: int, status: FrameStatus, feedback: Callable[[], Segmentation] | None
    ) -> list[FrameEvidence]:
        """Have a frame that shows nothing new carry the labels of the last picture."""
        self._settle()
        if feedback is not None:
            feedback()  # the layers must keep pace
        state, config = self.state, self.config.layers
        state.held = (*state.held, no_picture(frame_index, status))
        newest = [held.status in NO_PICTURE for held in state.held[-config.init_frames :]]
        if not state.clustered and len(newest) == config.init_frames and all(newest):
            # The scene stands still, or has not begun: it does when something is seen.
            shown = self.flush()
            picture, colours, cut = state.picture, state.colours, state.cut
            self._begin_epoch(frame_index + 1)
            self.state.shape, self.state.picture, self.state.colours = state.shape, picture, colours
            self.state.cut, self.state.left = cut and not state.pictures, state.left
            return shown
        if not state.pictures:
            # After that much black, say, the first picture is that of another scene.
            state.cut |= status == "blank" and frame_index + 1 - state.epoch >= config.init_frames
            return self._emit(frame_index)
        return self._emit(frame_index - config.lookahead) if state.clustered else []

    def _settle(self, those: tuple[UnsettledFrame, ...] | None = None) -> None:
        """Pass over frames that wait, all by default: the scene goes on without them."""
        for one in self.state.unsettled if those is None else those:
            self.state.held = (*self.state.held, no_picture(one.frame_index, one.status))
        self.state.unsettled = ()

    def flush(self) -> list[FrameEvidence]:
        """Emit what is still held at the end of the stream."""
        self._settle()
        state = self.state
        if state.pictures and not state.clustered:
            # Fewer frames than the first clustering wants: cluster those there are.
            colourless = np.zeros((*(state.shape or (0, 0)), 3), np.uint8)
            cluster(state, colourless, state.next_frame - 1, None, self.config, {})
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
            return self.state.pictures >= layers.init_frames
        # A frame in which it was due may have been passed over.
        last = self.state.last_clustering - self.state.epoch
        return (
            age < 2 * layers.init_frames or age // layers.clustering_period > last // layers.clustering_period
        )

    def _emit(self, last: int) -> list[FrameEvidence]:
        """Return the evidence of the held frames up to ``last``."""
        state = self.state
        ready = [held for held in state.held if held.frame_index <= last]
        state.held = tuple(held for held in state.held if held.frame_index > last)
        return [self._evidence(held) for held in ready]

    def _evidence(self, held: HeldFrame) -> FrameEvidence:
        state = self.state
        assert state.shape is not None
        evidence = FrameEvidence(
            frame_index=held.frame_index,
            shape=state.shape,
            camera=held.camera,
            flow=held.flow,
            flow_reliable=held.flow_reliable,
            unexplained=held.unexplained,
            tracks=(),
            positions=held.positions,
            motions=held.motions,
            retired=(),
            latency_frames=state.next_frame - 1 - held.frame_index,
            stage_ms=held.stage_ms,
            # Before the first picture of an epoch there are no labels to carry.
            epoch=state.epoch if state.pictures else held.frame_index,
            status=held.status,
            light=held.light,
            fixed=held.fixed,
        )
        if held.status in NO_PICTURE:
            return evidence
        registry = LayerRegistry(self.config, state.shape, state.registry)
        owner = registry.layers_of(held.labels)
        live = sorted({BACKGROUND, *distinct_labels(owner), *registry.live_layers(held.frame_index)})
        retired = set(state.evaluated) - set(live)
        if held.frame_index == state.epoch:
            # All models are of another scene or size, the background's too.
            retired, state.evaluated = set(state.evaluated), {}
        # Where the camera's motion explains the image as well, a trajectory is no evidence of an object: flow
        # bleeds from an object over the smooth road beside it. But of an object at rest none is left.
        least = np.float32(self.config.layers.least_evidence)
        proof = held.evidence.copy()
        for layer in registry.lasting_layers():
            own = owner == layer
            if own.any() and (proof[own] >= least).mean() < RESTING:
                proof[own] = least
        positions, motions, starts = by_layer(
            np.array(live), owner, proof, least, held.positions, held.motions
        )
        tracks = []
        for one, start, end in zip(live, starts[:-1].tolist(), starts[1:].tolist(), strict=True):
            kind: LayerKind = (
                "background" if one == BACKGROUND else "other" if one == state.registry.other else "object"
            )
            last_frame = state.evaluated.get(one, -1)
            tracks.append(LayerTracks(one, kind, last_frame, start, end))
        state.evaluated = dict.fromkeys(live, held.frame_index)
        return replace(
            evidence,
            tracks=tuple(tracks),
            positions=positions,
            motions=motions,
            retired=tuple(sorted(retired)),
            resting=registry.resting_layers(),
            apart=state.repulsion.apart(live, self.config.identity.apart),
        )
