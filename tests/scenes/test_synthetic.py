"""The synthetic scenes are exact, repeatable, and do what their names say."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.scene_scripts import SCRIPTS
from mlbs_actors.scenes.synthetic import SyntheticScene, scene, scene_from_uri

#: One scene of each kind; the tests of the others are long.
SHORT = ("crowd", "demo", "parallax", "walker")
SCENES = {
    name: name if name in SHORT else pytest.param(name, marks=pytest.mark.long) for name in sorted(SCRIPTS)
}
MOVERS = [one for name, one in SCENES.items() if name not in ("no-mover", "near-scene", "static-empty")]


def source_pixels(flow: Array) -> tuple[Array, Array]:
    """Where each pixel was one frame before: x and y, (H, W) float32."""
    y, x = np.mgrid[: flow.shape[0], : flow.shape[1]].astype(np.float32)
    return x + flow[..., 0], y + flow[..., 1]


def seen_before(made: SyntheticScene, index: int) -> Array:
    """Pixels well inside one surface in both frames: not uncovered, on an outline or from outside."""
    owners, before = made.surface_numbers(index), made.surface_numbers(index - 1)
    x, y = source_pixels(made.flow(index))
    inside = (x >= 2) & (y >= 2) & (x <= made.width - 3) & (y <= made.height - 3)
    kernel = np.ones((7, 7), np.uint8)
    interior = [
        cv2.erode(o.astype(np.float32), kernel) == cv2.dilate(o.astype(np.float32), kernel)
        for o in (owners, before)
    ]
    columns = np.clip(np.rint(x).astype(int), 0, made.width - 1)
    rows = np.clip(np.rint(y).astype(int), 0, made.height - 1)
    same = before[rows, columns] == owners
    known: Array = inside & interior[0] & interior[1][rows, columns] & same
    return known


def carried_error(made: SyntheticScene, index: int, shift: tuple[float, float]) -> Array:
    """Grey levels between a frame and the frame before, carried by the exact motion plus a shift, (H, W)."""
    x, y = source_pixels(made.flow(index))
    warped = cv2.remap(made.frame(index - 1), x + shift[0], y + shift[1], cv2.INTER_CUBIC)
    error: Array = np.abs(warped.astype(float) - made.frame(index)).mean(axis=2)
    return error


@pytest.mark.parametrize("name", SCENES.values())
def test_the_exact_motion_carries_the_frame_before_onto_the_frame(name: str) -> None:
    made = replace(scene(name, frames=36, seed=1), noise=0.0)
    for index in (1, 21):
        known, labels = seen_before(made, index), made.labels(index)
        exact = carried_error(made, index, (0.0, 0.0))
        shifts = ((0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25))
        wrong = [carried_error(made, index, shift) for shift in shifts]
        # What is left is the blur of sampling twice. It must be small on each object by itself too, and a
        # motion that is off by a quarter px in any direction must be clearly worse.
        for label in np.unique(labels[known]).tolist():
            surface = known & (labels == label)
            if surface.sum() < 100:
                continue
            assert exact[surface].mean() < 2.0
            assert all(error[surface].mean() > 1.2 * exact[surface].mean() for error in wrong)


@pytest.mark.parametrize("name", MOVERS)
def test_labels_move_with_the_exact_motion(name: str) -> None:
    made = scene(name, frames=60, seed=2)
    for index in (5, 30):
        labels, before = made.labels(index), made.labels(index - 1)
        x, y = source_pixels(made.flow(index))
        carried = cv2.remap(before, x, y, cv2.INTER_NEAREST)
        # What differs is uncovered or on an outline: little, and not on the objects' insides.
        core = cv2.erode((labels > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        assert (carried != labels).mean() < 0.03
        assert (carried[core & seen_before(made, index)] == labels[core & seen_before(made, index)]).all()


@pytest.mark.parametrize("name", MOVERS)
def test_each_object_moves_against_the_background_beside_it(name: str) -> None:
    made = scene(name, frames=60)
    speeds: dict[int, list[float]] = {}
    for index in range(1, 60, 4):
        labels, flow = made.labels(index), made.flow(index)
        for label in np.unique(labels[labels > 0]).tolist():
            own = (labels == label).astype(np.uint8)
            ring = (cv2.dilate(own, np.ones((25, 25), np.uint8)) > 0) & (labels == 0)
            difference = flow[own > 0].mean(axis=0) - flow[ring].mean(axis=0)
            speeds.setdefault(label, []).append(float(np.hypot(*difference)))
    assert speeds
    # Slower, an object cannot be told from its surroundings; the object of "stop" rests half of the time.
    for of_label in speeds.values():
        assert np.quantile(of_label, 0.75 if name == "stop" else 0.5) > 1.0


def test_equal_seeds_give_equal_bytes_in_any_order_of_asking() -> None:
    first, second = scene("demo", frames=12, seed=7), scene("demo", frames=12, seed=7)
    forward = [(first.frame(i), first.labels(i), first.flow(i)) for i in range(12)]
    for index in (11, 3, 3, 0, 7):
        again = second.frame(index), second.labels(index), second.flow(index)
        for one, other in zip(forward[index], again, strict=True):
            assert one.tobytes() == other.tobytes()


def test_another_seed_gives_another_picture_and_another_name_too() -> None:
    base = scene("pan", frames=2, seed=1).frame(0)
    assert not np.array_equal(base, scene("pan", frames=2, seed=2).frame(0))
    assert not np.array_equal(base, scene("no-mover", frames=2, seed=1).frame(0))


@pytest.mark.parametrize("name", SCENES.values())
def test_every_scene_comes_in_every_size_with_its_types(name: str) -> None:
    for width, height in ((160, 120), (214, 120), (64, 49)):
        made = scene(name, frames=3, width=width, height=height)
        assert len(made) == 3
        assert made.frame(2).shape == (height, width, 3)
        assert made.labels(2).shape == (height, width)
        assert made.flow(2).shape == (height, width, 2)
        types = [array.dtype.name for array in (made.frame(2), made.labels(2), made.flow(2))]
        assert types == ["uint8", "uint8", "float32"]


def test_the_first_frame_has_no_motion() -> None:
    assert not scene("demo", frames=2).flow(0).any()


def test_a_larger_picture_shows_the_same_scene() -> None:
    small, large = scene("demo", frames=20), scene("demo", frames=20, width=640, height=480)
    for label in (1, 2, 3):
        share = [(made.labels(15) == label).mean() for made in (small, large)]
        assert share[0] == pytest.approx(share[1], rel=0.1)
    assert np.abs(large.flow(15)).mean() == pytest.approx(2 * np.abs(small.flow(15)).mean(), rel=0.05)


@pytest.mark.parametrize("index", [-1, 5])
def test_frames_outside_the_scene_are_refused(index: int) -> None:
    made = scene("pan", frames=5)
    for ask in (made.frame, made.labels, made.flow):
        with pytest.raises(IndexError):
            ask(index)


def test_an_unknown_scene_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(ConfigError, match="roll-zoom"):
        scene("nowhere")


@pytest.mark.parametrize("wrong", [{"frames": 0}, {"width": 8}, {"height": 99_999}, {"seed": -1}])
def test_impossible_sizes_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        scene("pan", **wrong)


def test_a_uri_names_scene_length_seed_and_size() -> None:
    made = scene_from_uri("synthetic:stop?frames=7&seed=3&width=96&height=64")
    assert (made.name, len(made), made.seed, made.width, made.height) == ("stop", 7, 3, 96, 64)
    assert len(scene_from_uri("synthetic:stop")) == 60


@pytest.mark.parametrize(
    "uri",
    ["demo", "synthetic:", "synthetic:demo?fps=3", "synthetic:demo?frames=", "synthetic:demo?frames=-3",
     "synthetic:demo?frames=3&frames=4", "synthetic:demo?frames=999999999999999999999"],
)  # fmt: skip
def test_a_wrong_uri_is_refused(uri: str) -> None:
    with pytest.raises(ConfigError):
        scene_from_uri(uri)


def objects_by_frame(name: str, frames: int) -> list[set[int]]:
    made = scene(name, frames=frames)
    return [set(np.unique(made.labels(index)).tolist()) - {0} for index in range(frames)]


def test_the_crowd_grows_from_one_object_to_32_and_shrinks_to_one() -> None:
    present = objects_by_frame("crowd", 60)
    assert present[0] == {1}
    assert max(len(labels) for labels in present) == 32
    assert present[-1] == {1}


@pytest.mark.parametrize("objects", [1, 5, 32])
def test_the_steady_crowd_shows_as_many_objects_as_asked_for_of_one_percent_each_all_the_time(
    objects: int,
) -> None:
    made = scene_from_uri(f"synthetic:steady-crowd?frames=40&objects={objects}")
    for index in (0, 13, 39):
        area = np.bincount(made.labels(index).ravel(), minlength=objects + 1)[1:] / (320 * 240)
        assert len(area) == objects
        assert area.min() > 0.008
        assert area.max() < 0.012


def test_neighbours_in_the_steady_crowd_never_move_alike() -> None:
    made = scene_from_uri("synthetic:steady-crowd?frames=60&objects=32")
    for index in range(4, 60, 4):
        labels, flow = made.labels(index), made.flow(index)
        objects = range(1, 33)
        places = np.array([np.argwhere(labels == one).mean(axis=0) for one in objects])
        motions = np.array([flow[labels == one].mean(axis=0) for one in objects])
        near = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) < 50
        apart = np.hypot(*(motions[:, None] - motions[None]).transpose(2, 0, 1))
        assert apart[near & ~np.eye(32, dtype=bool)].min() > 1.0


def test_the_number_of_objects_is_asked_for_only_where_it_is_left_open() -> None:
    assert len(set(np.unique(scene("steady-crowd", frames=1).labels(0)).tolist())) == 9
    with pytest.raises(ConfigError, match="steady-crowd"):
        scene("demo", objects=3)
    with pytest.raises(ConfigError, match="objects"):
        scene("steady-crowd", objects=33)


def test_late_entrants_are_absent_first_and_stay_once_there() -> None:
    present = objects_by_frame("late-entry", 60)
    assert present[0] == {1}
    assert present[-1] == {1, 2, 3}
    for label in (2, 3):
        entry = next(index for index, labels in enumerate(present) if label in labels)
        assert entry > 10
        assert all(label in labels for labels in present[entry:])


def test_the_leaver_is_there_first_and_gone_at_last() -> None:
    present = objects_by_frame("leave", 80)
    assert present[0] == {1, 2}
    assert present[-1] == {1}


def test_one_of_two_crossing_objects_is_hidden_and_comes_back() -> None:
    made = scene("crossing", frames=60)
    area = np.array([(made.labels(index) == 1).sum() for index in range(60)])
    hidden = int(area.argmin())
    assert area[hidden] < 0.5 * area[0]
    assert area[-1] > 0.9 * area[0]
    assert 20 < hidden < 40


def test_the_stopped_object_stands_still_in_the_world() -> None:
    made = scene("stop", frames=60)
    relative = []
    for index in (10, 45):
        labels, flow = made.labels(index), made.flow(index)
        own = (labels == 1).astype(np.uint8)
        foot = np.zeros_like(own, bool)
        bottom = int(np.flatnonzero(own.any(axis=1)).max())
        columns = np.flatnonzero(own.any(axis=0))
        foot[bottom + 2 : bottom + 4, columns.min() : columns.max()] = True
        relative.append(np.hypot(*(flow[own > 0].mean(axis=0) - flow[foot].mean(axis=0))))
    assert relative[0] > 1.5
    assert relative[1] < 0.3


def test_scenes_without_movers_have_no_labels() -> None:
    for name in ("no-mover", "static-empty"):
        assert not any(objects_by_frame(name, 40))


def test_long_pans_keep_moving_and_stay_textured() -> None:
    made = scene("no-mover", frames=500)
    speed = [np.hypot(*made.flow(index).mean(axis=(0, 1))) for index in range(1, 500, 25)]
    assert np.median(speed) > 1.0
    assert max(speed) < 6.0
    assert all(cv2.Laplacian(made.frame(index), cv2.CV_32F).std() > 5 for index in (0, 250, 499))


def test_a_still_camera_changes_by_sensor_noise_only() -> None:
    made = scene("static-empty", frames=3)
    assert not made.flow(2).any()
    difference = made.frame(2).astype(float) - made.frame(1)
    assert difference.std() == pytest.approx(2.0 * 2**0.5, rel=0.15)


def test_the_camera_stops_and_goes_on() -> None:
    made = scene("camera-stops", frames=60)
    speed = [np.hypot(*made.flow(index)[made.labels(index) == 0].mean(axis=0)) for index in (10, 30, 50)]
    assert speed[0] > 1.5
    assert speed[1] == 0.0
    assert speed[2] > 1.5


def test_parallax_shifts_near_things_more_than_far_ones() -> None:
    made = scene("parallax", frames=10)
    flow, labels = made.flow(5), made.labels(5)
    far, near = flow[:20][labels[:20] == 0], flow[-20:][labels[-20:] == 0]
    assert abs(near[:, 0].mean()) > 2 * abs(far[:, 0].mean()) > 1.0


def test_the_walker_swings_its_limbs_against_its_trunk() -> None:
    made = scene("static-walker", frames=30)
    labels, flow = made.labels(20), made.flow(20)
    rows = np.flatnonzero((labels == 1).any(axis=1))
    legs = np.zeros_like(labels, bool)
    legs[int(np.quantile(rows, 0.6)) :] = True
    motions = flow[(labels == 1) & legs][:, 0]
    assert np.ptp(motions) > 2.0
    assert not flow[labels == 0].any()
