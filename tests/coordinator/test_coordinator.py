"""The coordinator: what it holds, emits, refuses and forgets, on small frames with squares that move."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import cv2
import numpy as np
import pytest

from mlbs_actors.clustering.label_index import UNLABELLED
from mlbs_actors.config import Config
from mlbs_actors.coordinator import Coordinator
from mlbs_actors.determinism import single_threaded
from mlbs_actors.errors import FrameError
from mlbs_actors.messages import BACKGROUND, Array, FrameEvidence, LayerSummary, Region, Segmentation

SHAPE = (96, 128)
SIDE = 26


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """As in every process that runs a coordinator."""
    with single_threaded():
        yield


def configured(**layers: int) -> Config:
    """Fewer trajectories than usual, for speed, and closer patches of the flow: the pictures are small."""
    return Config.model_validate(
        {"trajectories": {"seed_spacing_px": 18.0}, "flow": {"patch_stride_px": 4}, "layers": layers}
    )


def texture(seed: int, height: int = 160, width: int = 240) -> Array:
    noise = np.random.default_rng(seed).normal(size=(height, width, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(255 * (smooth - smooth.min()) / np.ptp(smooth), np.uint8)


@dataclass(frozen=True)
class Square:
    """A textured square: its corner at frame 0, its motion (px/frame), and when it is there."""

    x: int
    y: int
    vx: int
    vy: int = 0
    first: int = 0
    end: int = 10**6


#: The one that most scenes have.
CAR = Square(20, 30, 4)


def movie(frames: int, *squares: Square) -> list[Array]:
    """A panning camera (1 px a frame) and squares."""
    canvas = texture(30)
    pictures = []
    for t in range(frames):
        picture = canvas[20 : 20 + SHAPE[0], 20 + t : 20 + t + SHAPE[1]].copy()
        for number, square in enumerate(squares):
            if square.first <= t < square.end:
                left, top = square.x + square.vx * t, square.y + square.vy * t
                picture[top : top + SIDE, left : left + SIDE] = texture(31 + number)[:SIDE, :SIDE]
        pictures.append(picture)
    return pictures


def run(pictures: Sequence[Array], config: Config, flush: bool = True) -> list[FrameEvidence]:
    coordinator = Coordinator(config)
    emitted = [one for t, picture in enumerate(pictures) for one in coordinator.step(t, picture, None)]
    return emitted + (coordinator.flush() if flush else [])


def as_bytes(evidence: FrameEvidence) -> dict[str, object]:
    """All that steers the rest, without the times."""
    values = {one.name: getattr(evidence, one.name) for one in fields(evidence) if one.name != "stage_ms"}
    return {
        name: (value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value
        for name, value in values.items()
    }


def inside(positions: Array, x: float, y: float) -> Array:
    return np.asarray(
        (positions[:, 0] > x)
        & (positions[:, 0] < x + SIDE)
        & (positions[:, 1] > y)
        & (positions[:, 1] < y + SIDE)
    )


# When frames come out


@pytest.mark.parametrize("held", [1, 2, 5])
def test_the_first_frames_are_held_and_then_all_come_at_once(held: int) -> None:
    coordinator = Coordinator(configured(init_frames=held))
    pictures = movie(held + 3)
    counts = []
    emitted = []
    for t, picture in enumerate(pictures):
        now = coordinator.step(t, picture, None)
        counts.append(len(now))
        emitted += now
    assert counts == [0] * (held - 1) + [held] + [1] * 3
    assert [one.frame_index for one in emitted] == list(range(held + 3))
    assert [one.latency_frames for one in emitted] == [*range(held - 1, -1, -1), 0, 0, 0]
    assert coordinator.flush() == []


@pytest.mark.parametrize("lookahead", [1, 3, 7])
def test_every_frame_is_delayed_by_exactly_the_lookahead(lookahead: int) -> None:
    coordinator = Coordinator(configured(init_frames=3, lookahead=lookahead))
    came_at: dict[int, int] = {}
    for t, picture in enumerate(movie(12)):
        for one in coordinator.step(t, picture, None):
            came_at[one.frame_index] = t
            assert one.latency_frames == t - one.frame_index
    assert came_at == {t: max(t + lookahead, 2) for t in range(12 - lookahead)}
    rest = coordinator.flush()
    assert [one.frame_index for one in rest] == list(range(12 - lookahead, 12))


@pytest.mark.parametrize("frames", [1, 2, 3])
@pytest.mark.parametrize("lookahead", [0, 2])
def test_a_stream_shorter_than_the_hold_gives_one_result_a_frame(frames: int, lookahead: int) -> None:
    emitted = run(movie(frames, CAR), configured(init_frames=5, lookahead=lookahead))
    assert [one.frame_index for one in emitted] == list(range(frames))
    assert all(one.layers[0].layer == BACKGROUND for one in emitted)


def test_flushing_again_or_without_a_frame_gives_nothing() -> None:
    coordinator = Coordinator(configured())
    assert coordinator.flush() == []
    coordinator.step(0, movie(1)[0], None)
    assert len(coordinator.flush()) == 1
    assert coordinator.flush() == []


@pytest.mark.parametrize("lookahead", [0, 2])
def test_it_reads_the_segmentation_of_two_frames_before_the_newest_it_emits(lookahead: int) -> None:
    coordinator = Coordinator(configured(init_frames=3, lookahead=lookahead))
    emitted: set[int] = set()
    wanted = []
    for t, picture in enumerate(movie(9)):
        index = coordinator.feedback_index(t)
        wanted.append(index)
        assert index is None or index in emitted
        emitted |= {one.frame_index for one in coordinator.step(t, picture, None)}
    steady = t - lookahead - 2
    assert wanted[-1] == steady
    known = [index for index in wanted if index is not None]
    assert known == list(range(known[0], steady + 1))
    assert wanted[:3] == [None] * 3


# What is refused


def test_a_frame_out_of_order_is_refused() -> None:
    coordinator = Coordinator(configured())
    picture = movie(1)[0]
    with pytest.raises(FrameError, match=r"Frame 1 came where frame 0 is due; give frames in order\."):
        coordinator.step(1, picture, None)
    coordinator.step(0, picture, None)
    with pytest.raises(FrameError, match="Frame 0 came where frame 1 is due"):
        coordinator.step(0, picture, None)


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((96, 128), np.uint8),
        np.zeros((96, 128, 1), np.uint8),
        np.zeros((96, 128, 4), np.uint8),
        np.zeros((96, 128, 3), np.float32),
        np.zeros((96, 128, 3), np.uint16),
        np.zeros((0, 128, 3), np.uint8),
    ],
    ids=["grey", "one channel", "alpha", "float", "16 bit", "empty"],
)
def test_what_is_no_colour_image_is_refused(frame: Array) -> None:
    with pytest.raises(FrameError, match=r"A frame must be a \(height, width, 3\) uint8 BGR image, not "):
        Coordinator(configured()).step(0, frame, None)


@pytest.mark.parametrize("frame", [None, [[[0, 0, 0]]]], ids=["nothing", "a list"])
def test_what_is_no_array_is_refused(frame: object) -> None:
    with pytest.raises(FrameError, match=r"A frame must be a .*, not (NoneType|list)"):
        Coordinator(configured()).step(0, frame, None)  # type: ignore[arg-type]


def test_a_refused_frame_leaves_the_stream_as_it_was() -> None:
    pictures = movie(4, CAR)
    coordinator = Coordinator(configured(init_frames=2))
    emitted = []
    for t, picture in enumerate(pictures):
        with pytest.raises(FrameError):
            coordinator.step(t, picture[..., 0], None)
        with pytest.raises(FrameError):
            coordinator.step(t + 1, picture, None)
        emitted += coordinator.step(t, picture, None)
    undisturbed = run(pictures, configured(init_frames=2))
    assert [as_bytes(one) for one in emitted] == [as_bytes(one) for one in undisturbed]


# What the evidence says


def test_a_moving_square_gets_a_layer_and_its_trajectories() -> None:
    emitted = run(movie(9, CAR), configured())
    for evidence in emitted:
        assert [one.layer for one in evidence.layers] == [BACKGROUND, 1]
        assert [one.kind for one in evidence.layers] == ["background", "object"]
        background, square = evidence.layers
        place = (20 + 4 * evidence.frame_index, 30)
        assert len(square.positions) >= 10
        assert inside(square.positions, *place).mean() > 0.8
        assert inside(background.positions, *place).mean() < 0.02
    square = emitted[-1].layers[1]
    np.testing.assert_allclose(np.median(square.motions, axis=0), (-4, 0), atol=0.3)
    camera = emitted[-1].camera
    np.testing.assert_allclose(camera, [[1, 0, 1], [0, 1, 0], [0, 0, 1]], atol=0.05)


def test_without_a_mover_the_background_has_every_trajectory() -> None:
    for evidence in run(movie(9), configured()):
        assert [one.layer for one in evidence.layers] == [BACKGROUND]
        assert len(evidence.layers[0].positions) > 100


@pytest.mark.parametrize("lookahead", [0, 3])
def test_each_layer_is_told_the_frame_it_was_evaluated_in_before(lookahead: int) -> None:
    config = configured(lookahead=lookahead)
    last: dict[int, int] = {}
    for evidence in run(movie(12, CAR, Square(80, 60, -3, end=9)), config):
        ids = [one.layer for one in evidence.layers]
        assert ids == sorted(set(ids))
        assert ids[0] == BACKGROUND
        for one in evidence.layers:
            assert one.last_frame == last.get(one.layer, -1)
            assert one.positions.shape == one.motions.shape == (len(one.positions), 2)
            last[one.layer] = evidence.frame_index
    assert len(last) == 3


def test_the_maps_of_a_frame_share_one_grid() -> None:
    emitted = run(movie(7, CAR), configured())
    grid = emitted[0].flow.shape[:2]
    for evidence in emitted:
        assert evidence.shape == SHAPE
        assert evidence.flow.shape == (*grid, 2)
        assert evidence.flow_reliable.shape == evidence.unexplained.shape == grid
        assert evidence.flow.dtype == np.float32
        assert evidence.unexplained.dtype == np.uint8
    for t in (0, 6):
        square = np.s_[35:50, 20 + 4 * t + 5 : 20 + 4 * t + 20]
        full = cv2.resize(emitted[t].unexplained, SHAPE[::-1]).astype(float)
        assert full[square].mean() > 3 * full[:20].mean()


def test_the_first_frame_moves_as_the_second_one_does() -> None:
    first, second = run(movie(7, CAR), configured())[:2]
    for one in (first, second):
        square = np.s_[35:50, 20 + 4 * one.frame_index + 5 : 20 + 4 * one.frame_index + 20]
        flow = one.flow.astype(np.float32)
        np.testing.assert_allclose(np.median(flow[square], axis=(0, 1)), (-4, 0), atol=0.1)
        np.testing.assert_allclose(np.median(flow[70:], axis=(0, 1)), (1, 0), atol=0.1)
        assert one.flow_reliable[square].mean() > 0.9
        background, car = (np.median(own.motions, axis=0) for own in one.layers)
        np.testing.assert_allclose(background, (1, 0), atol=0.1)
        np.testing.assert_allclose(car, (-4, 0), atol=0.1)
    np.testing.assert_array_equal(first.camera, second.camera)


def test_a_lone_frame_has_no_motion() -> None:
    (only,) = run(movie(1, CAR), configured())
    assert not only.flow.any()
    assert not only.flow_reliable.any()
    assert not only.unexplained.any()
    assert not only.layers[0].motions.any()


# Lives and deaths


def test_a_layer_that_vanishes_gives_its_process_back_at_once_and_its_id_is_not_given_again() -> None:
    config = configured(dormant_frames=3, coast_frames=0, probation_frames=1)
    emitted = run(movie(28, Square(20, 30, 4, end=8), Square(-50, 55, 3, first=19)), config)
    live = [[one.layer for one in evidence.layers] for evidence in emitted]
    last = max(t for t in range(28) if 1 in live[t])
    assert (
        7 <= last <= 11
    )  # gone from frame 8 on; a few wrong tracks may last until clusterings find them resting
    retired = {layer: t for t in range(28) for layer in emitted[t].retired}
    assert retired[1] == last + 1
    assert len(retired) == sum(len(evidence.retired) for evidence in emitted)
    assert all(layer not in live[later] for layer, t in retired.items() for later in range(t, 28))
    assert {layer for t in range(19, 28) for layer in live[t]} - {BACKGROUND}  # the second square


@pytest.mark.parametrize("shown", [True, False])
def test_a_layer_that_lost_its_trajectories_stays_while_the_map_of_two_frames_ago_shows_it(
    shown: bool,
) -> None:
    config = configured(dormant_frames=3, coast_frames=3, probation_frames=1)
    coordinator, live = Coordinator(config), {}
    summary = LayerSummary(1, "object", Region(20, 30, 5, 5), 25, (22.0, 32.0), (0.0, 0.0), 1.0)
    nothing = np.zeros((1, 1), np.uint8)
    for t, picture in enumerate(movie(16, Square(20, 30, 4, end=8))):
        wanted = coordinator.feedback_index(t)
        feedback = None
        if wanted is not None:
            layers = (summary,) if shown else ()
            told = Segmentation(
                wanted, nothing.astype(np.uint16), nothing, nothing.astype(np.int8), layers, (0.0, 0.0), 0
            )
            feedback = partial(replace, told)
        for one in coordinator.step(t, picture, feedback):
            live[one.frame_index] = 1 in {own.layer for own in one.layers}
    last = max(t for t in live if live[t])
    assert last == (7 + config.layers.coast_frames if shown else 7)  # the square ends after frame 7


def test_a_trajectory_ends_where_the_image_no_longer_shows_its_point() -> None:
    pictures = movie(9, Square(20, 30, 4, end=8))
    left = []
    for most in (8.0, 1e6):
        config = Config.model_validate({"trajectories": {"seed_spacing_px": 18.0, "most_mismatch": most}})
        coordinator = Coordinator(config)
        for t, picture in enumerate(pictures):
            coordinator.step(t, picture, None)
        left.append(
            int(
                (
                    (coordinator.state.epoch.labels > BACKGROUND)
                    & (coordinator.state.epoch.trajectories.ages > 1)
                ).sum()
            )
        )
    assert left[0] < left[1]


def test_past_the_cap_objects_share_a_layer_of_their_own_kind() -> None:
    squares = [Square(6, 6, 3), Square(60, 6, 0, 2), Square(6, 60, 3), Square(90, 60, -2)]
    for evidence in run(movie(8, *squares), configured(max_layers=3)):
        kinds = [one.kind for one in evidence.layers]
        assert kinds[0] == "background"
        assert sorted(kinds[1:]) == ["object", "other"]
    for evidence in run(movie(8, *squares), configured(max_layers=5)):
        assert [one.kind for one in evidence.layers] == ["background"] + ["object"] * 4


# Always the same


def labels_of_trajectories(coordinator: Coordinator) -> dict[int, int]:
    epoch = coordinator.state.epoch
    return dict(zip(epoch.trajectories.ids.tolist(), epoch.labels.tolist(), strict=True))


def test_between_two_clusterings_trajectories_keep_their_labels_and_new_ones_wait() -> None:
    config = configured(init_frames=2, clustering_period=4)
    coordinator = Coordinator(config)
    clustered = []
    for t, picture in enumerate(movie(13, CAR)):
        before = dict(
            zip(coordinator.state.epoch.trajectories.ids, coordinator.state.epoch.labels, strict=True)
        )
        evidence = coordinator.step(t, picture, None)
        after = dict(
            zip(coordinator.state.epoch.trajectories.ids, coordinator.state.epoch.labels, strict=True)
        )
        if any("affinity" in one.stage_ms for one in evidence):
            clustered.append(t)
        elif t > 0:
            assert all(after[track] == before[track] for track in after if track in before)
            assert all(after[track] == UNLABELLED for track in after if track not in before)
    assert clustered == [1, 2, 3, 4, 8, 12]


def test_what_begins_to_move_between_two_clusterings_is_a_layer_soon_after_the_next() -> None:
    config = configured(init_frames=2, clustering_period=4, probation_frames=2)
    evidence = run(movie(16, Square(20, 30, 4, first=5)), config)
    found = [one.frame_index for one in evidence if len(one.layers) > 1]
    assert found
    assert found[0] in (8, 12)


def test_it_goes_on_from_its_state() -> None:
    pictures = movie(12, CAR)
    config = configured(lookahead=2)
    one = Coordinator(config)
    for t in range(7):
        one.step(t, pictures[t], None)
    other = Coordinator(config, copy.deepcopy(one.state))
    for t in range(7, 12):
        for expected, got in zip(
            one.step(t, pictures[t], None), other.step(t, pictures[t], None), strict=True
        ):
            assert as_bytes(expected) == as_bytes(got)


def test_frames_without_structure_have_a_background_and_nothing_else() -> None:
    ramp = np.linspace(60, 120, SHAPE[1]).astype(np.uint8)[None, :, None]
    smooth = [np.ascontiguousarray(np.broadcast_to(ramp + 5 * index, (*SHAPE, 3))) for index in range(7)]
    for evidence in run(smooth, configured()):
        assert [one.layer for one in evidence.layers] == [BACKGROUND]
        assert np.isfinite(evidence.camera).all()
