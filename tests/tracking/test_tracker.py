"""From one frame's trajectories to the next one's."""

from __future__ import annotations

import numpy as np
import pytest
from flow_fakes import dense_flow, flow_gray

from mlbs_actors.config import Config
from mlbs_actors.footage.fixed import FixedState
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.tracking import tracker
from mlbs_actors.tracking.tracker import Tracked, Transition, track
from mlbs_actors.tracking.trajectories import TrajectoryState, empty_trajectories

CONFIG = Config()
SHAPE, SIDE = (240, 320), 1


def two_frames() -> tuple[Array, Array, Array]:
    """Frames of a panning camera, and where objects are in the second."""
    shown = scene("pan", frames=8, width=SHAPE[1], height=SHAPE[0])
    return shown.frame(6), shown.frame(7), shown.labels(7) > 0


def first(frame: Array) -> Tracked:
    before = empty_trajectories(CONFIG.trajectories)
    gray = flow_gray(frame, SIDE)
    fixed = FixedState.beginning(gray)
    return track(before, np.zeros(0, bool), fixed, None, gray, SHAPE, CONFIG)


def transition(one: Array, other: Array) -> tuple[Transition, Array]:
    """How one frame becomes the other, and that one as the flow sees it."""
    before, now = flow_gray(one, SIDE), flow_gray(other, SIDE)
    return Transition(before, dense_flow(before, now, SIDE, CONFIG)), now


def followed(one: Array, other: Array) -> tuple[TrajectoryState, Tracked]:
    begun = first(one)
    before = begun.trajectories
    known = np.ones(len(before), bool)
    return before, track(before, known, begun.fixed, *transition(one, other), SHAPE, CONFIG)


def test_the_first_frame_only_begins_trajectories() -> None:
    tracked = first(two_frames()[0])
    assert len(tracked.trajectories) > 100
    assert len(tracked.survivors) == 0
    assert not tracked.trajectories.ages.any()
    assert not tracked.against_camera.advantage.any()


def test_survivors_stand_first_and_are_those_of_the_frame_before() -> None:
    before, tracked = followed(*two_frames()[:2])
    count = len(tracked.survivors)
    assert 0.5 * len(before) < count < len(tracked.trajectories)
    np.testing.assert_array_equal(tracked.trajectories.ids[:count], before.ids[tracked.survivors])
    assert tracked.trajectories.ids[count:].min() >= before.next_id


def test_objects_have_motion_and_evidence_of_their_own_and_the_ground_has_not() -> None:
    one, other, objects = two_frames()
    trajectories = followed(one, other)[1].trajectories
    column, row = np.rint(trajectories.positions).astype(int).T
    inside = objects[row, column]
    own = np.hypot(*trajectories.residuals[:, 0].T)
    assert inside.sum() > 20
    assert np.median(own[inside]) > 5 * np.median(own[~inside])
    assert np.median(trajectories.evidence[inside]) > 1.0 > np.median(trajectories.evidence[~inside])


@pytest.mark.parametrize("told_by", ["the ground", "the crowd"])
def test_a_crowd_does_not_make_the_camera_drive_where_one_homography_explains_the_ground(
    monkeypatch: pytest.MonkeyPatch, told_by: str
) -> None:
    shown = scene("steady-crowd", frames=8, width=SHAPE[1], height=SHAPE[0], objects=32)
    one, other = shown.frame(6), shown.frame(7)
    before = first(one).trajectories
    column, row = np.rint(before.positions).astype(int).T
    background = (shown.labels(6)[row, column] == 0) == (told_by == "the ground")
    asked = []
    monkeypatch.setattr(tracker, "forward_motion", lambda *given: asked.append(given))
    fixed = FixedState.beginning(flow_gray(one, SIDE))
    track(before, background, fixed, *transition(one, other), SHAPE, CONFIG)
    assert len(asked) == (0 if told_by == "the ground" else 1)
