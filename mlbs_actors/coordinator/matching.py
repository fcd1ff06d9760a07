"""How the last picture goes on in a new one: flow, light, and where the trajectories have gone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from mlbs_actors.cells import cell_side
from mlbs_actors.config import Config, length_scale
from mlbs_actors.coordinator.state import EpochState, NewFrame
from mlbs_actors.flow.consistency import DenseFlow
from mlbs_actors.flow.estimate import LEAST_CELLS, FlowEstimator, FlowFunction, Picture, picture_of
from mlbs_actors.flow.focus import focus_boxes
from mlbs_actors.footage.continuation import continuation
from mlbs_actors.footage.continuity import (
    LEAST_FOUND,
    Likeness,
    found_again,
    is_torn,
    rows_astray,
    tells_motion,
)
from mlbs_actors.footage.fixed import FixedState
from mlbs_actors.footage.light import unchanged
from mlbs_actors.messages import BACKGROUND, Array, FrameStatus
from mlbs_actors.stages import timed
from mlbs_actors.tracking.tracker import Tracked, Transition, track
from mlbs_actors.tracking.trajectories import TrackFunction, follow_trajectories

__all__ = ["Match", "Matcher"]


@dataclass(frozen=True, slots=True)
class Match:
    """A picture compared with the last one.

    Attributes
    ----------
    status : FrameStatus
        ``"ok"`` if the last picture goes on in it.
    flow : DenseFlow or None
        None in the first picture of an epoch, and if the last picture is not found again.
    tracked : Tracked or None
        None unless the last picture is found again in its light.
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

    @property
    def lost(self) -> bool:
        """Whether the last picture is not found again."""
        return self.status == "damaged" and self.flow is None


class Matcher:
    """Compares pictures of one stream.

    Parameters
    ----------
    config : Config
    flow : FlowFunction, optional
        The caller's own flow, in place of ``config.flow.method``.
    tracks : TrackFunction, optional
        The caller's own point tracker: trajectories follow it in place of the flow.
    ignored : (h, w) bool, optional
        Mask of what is fixed in the picture, whatever is found by itself; scaled to the frame.
    """

    def __init__(
        self, config: Config, flow: FlowFunction | None, tracks: TrackFunction | None, ignored: Array | None
    ) -> None:
        self._config = config
        self._flows = FlowEstimator(config, flow)
        self._tracks = tracks
        self._ignored = ignored
        self._keeps_frames = flow is not None or tracks is not None

    def picture(self, frame: Array) -> Picture:
        """Prepare a (H, W, 3) uint8 BGR frame."""
        return picture_of(frame, self._side((frame.shape[0], frame.shape[1])), self._keeps_frames)

    def found(self, before: Picture, after: Picture, shape: tuple[int, int]) -> DenseFlow | None:
        """Return the flow from one picture of (H, W) frames to another if it is found again there."""
        flow = self._flows.between(before, after, self._side(shape))
        alike = Likeness.along(flow, before.gray, after.gray)
        return flow if found_again(flow, alike) >= LEAST_FOUND else None

    def match(self, epoch: EpochState, new: NewFrame, *, lasting: bool = False) -> Match:
        """Find the last picture of an epoch again in a new one, and follow the trajectories there.

        ``lasting`` is whether its light is known to last.
        """
        config, picture, side = self._config, new.picture, self._side(epoch.shape)
        flow, light, gray = None, unchanged(), epoch.picture.gray
        status: FrameStatus = "ok"
        astray, told, whole = np.zeros(0, np.float32), True, True
        if epoch.pictures and min(picture.gray.shape) >= LEAST_CELLS:
            boxes = focus_boxes(epoch.focus, picture.gray.shape, config.flow) if epoch.focus.size else None

            def search(before: Picture, closely: bool) -> DenseFlow:
                return self._flows.between(before, picture, side, None if closely else boxes)

            with timed(new.stage_ms, "flow"):
                goes_on = continuation(epoch.picture, picture, search)
            flow, light, gray, whole = goes_on.flow, goes_on.light, goes_on.gray, goes_on.whole
            if not goes_on.found:
                return Match("damaged", None, None, light, gray, astray, False, whole)
            if goes_on.glaring and not lasting:
                return Match("flash", flow, None, light, gray, astray, False, whole)
            told = tells_motion(flow, goes_on.alike)
        with timed(new.stage_ms, "tracking"):
            known = epoch.labels == BACKGROUND if epoch.clustered else np.ones(len(epoch.labels), bool)
            fixed = epoch.fixed if epoch.pictures else FixedState.beginning(picture.gray, self._ignored)
            follow = None
            if self._tracks is not None:
                follow = partial(
                    follow_trajectories,
                    function=self._tracks,
                    previous=epoch.picture.image,
                    current=picture.image,
                )
            transition = None if flow is None else Transition(gray, flow)
            tracked = track(
                epoch.trajectories, known, fixed, transition, picture.gray, epoch.shape, config, follow
            )
            if flow is not None:
                astray = rows_astray(flow, tracked.camera, length_scale(*epoch.shape))
                if not epoch.waiting and is_torn(astray, epoch.astray):
                    status = "damaged"
        return Match(status, flow, tracked, light, gray, astray, told, whole)

    def _side(self, shape: tuple[int, int]) -> int:
        return cell_side(shape, self._config.grid.cell_px)
