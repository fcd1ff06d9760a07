"""Trajectories that a caller's function follows: it decides where points go and which are lost."""

from __future__ import annotations

import pickle

import cv2
import numpy as np
import pytest

from mlbs_actors import FrameError, MultilayerSubtractor
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from mlbs_actors.tracking.trajectories import TrackFunction
from orchestrator.evaluation.metrics import object_level
from orchestrator.evaluation.overlap import count_overlap

FRAMES = 10


@pytest.fixture(scope="module")
def made() -> SyntheticScene:
    return scene("demo", frames=FRAMES, width=160, height=120)


def lucas_kanade(previous: Array, current: Array, points: Array) -> tuple[Array, Array]:
    grays = [cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in (previous, current)]
    guess = points.copy()
    places, found, _ = cv2.calcOpticalFlowPyrLK(grays[0], grays[1], points, guess)
    return places, found[:, 0] == 1


def labels_by(made: SyntheticScene, tracks: TrackFunction | None) -> list[Array]:
    subtractor = MultilayerSubtractor(tracks=tracks)
    return [result.labels for _, result in subtractor.segment(made.frame(index) for index in range(FRAMES))]


def test_objects_are_found_by_the_tracks_of_another_tracker(made: SyntheticScene) -> None:
    scores = [
        object_level(count_overlap(labels, made.labels(index))).f
        for index, labels in enumerate(labels_by(made, lucas_kanade))
    ]
    assert np.mean(scores) > 0.6


def test_points_that_the_tracker_loses_are_given_to_it_no_more(made: SyntheticScene) -> None:
    asked: list[tuple[Array, Array]] = []

    def tracks(previous: Array, current: Array, points: Array) -> tuple[Array, Array]:
        assert previous.shape == current.shape == (120, 160, 3)
        assert points.dtype == np.float32
        places, seen = lucas_kanade(previous, current, points)
        seen &= points[:, 0] < 80  # it is blind on the right
        places[~seen] = np.nan
        asked.append((places, seen))
        return places, seen

    subtractor = MultilayerSubtractor(tracks=tracks)
    for index in range(4):
        subtractor.apply(made.frame(index))
    assert len(asked) == 3
    trajectories = subtractor._coordinator.state.epoch.trajectories
    places, seen = asked[-1]
    old = trajectories.positions[trajectories.ages > 1]  # new ones begin with the motion of the flow
    assert len(old)
    assert {tuple(one) for one in old.tolist()} <= {tuple(one) for one in places[seen].tolist()}


def test_a_subtractor_with_tracks_of_its_own_can_be_pickled(made: SyntheticScene) -> None:
    first = MultilayerSubtractor(tracks=lucas_kanade)
    for index in range(6):
        first.apply(made.frame(index))
    second = pickle.loads(pickle.dumps(first))
    for index in range(6, FRAMES):
        for one, other in zip(first.apply(made.frame(index)), second.apply(made.frame(index)), strict=True):
            assert np.array_equal(one.labels, other.labels)


@pytest.mark.parametrize(
    ("returned", "sentence"),
    [
        (lambda points: (points[:-1], np.ones(len(points), bool)), r"returned places \(\d+, 2\) float32"),
        (lambda points: (points, np.ones(len(points), np.uint8)), r"returned a mask \(\d+,\) uint8"),
        (lambda points: points, r"returned \(\d+, 2\) float32; it must return two arrays"),
        (lambda points: None, "returned None; it must return two arrays"),
        (lambda points: (points,), "returned a tuple of 1; it must return two arrays"),
        (lambda points: (points, [[True], []]), "returned a tuple of 2; it must return two arrays"),
        (lambda points: (points * np.nan, np.ones(len(points), bool)), "NaN or infinite places"),
    ],
)  # fmt: skip
def test_what_is_no_track_is_refused(made: SyntheticScene, returned: object, sentence: str) -> None:
    subtractor = MultilayerSubtractor(tracks=lambda previous, current, points: returned(points))  # type: ignore[operator]
    subtractor.apply(made.frame(0))
    with pytest.raises(FrameError, match=sentence):
        subtractor.apply(made.frame(1))


class CoTracker:
    """A stub with the interface of CoTracker's offline predictor: sees every point, where it was."""

    def __call__(self, video: Array, queries: Array) -> tuple[Array, Array]:
        assert video.shape == (1, 2, 3, 120, 160)
        assert video.dtype == np.float32
        assert queries.ndim == 3
        assert queries.shape[::2] == (1, 3)
        assert not queries[..., 0].any()  # of the first frame
        return np.repeat(queries[:, None, :, 1:], 2, axis=1), np.ones((1, 2, queries.shape[1]), bool)


def test_a_learned_tracker_is_a_function_around_its_network(made: SyntheticScene) -> None:
    network = CoTracker()

    def tracks(previous: Array, current: Array, points: Array) -> tuple[Array, Array]:
        video = np.stack([previous, current])[..., ::-1].transpose(0, 3, 1, 2)[None].astype(np.float32)
        places, seen = network(video, np.pad(points, ((0, 0), (1, 0)))[None])
        return places[0, 1], seen[0, 1]

    # No point moves by this tracker, so nothing is found of what does.
    assert not any(labels.any() for labels in labels_by(made, tracks))
