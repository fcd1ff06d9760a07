"""The life of layers: probation, sleep, waking, forgetting, and the cap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
import pytest

from mlbs_actors.clustering.label_index import UNLABELLED
from mlbs_actors.clustering.layer_registry import RESTED_CLUSTERINGS, LayerRegistry
from mlbs_actors.clustering.registry_state import RegistryState
from mlbs_actors.config import Config, IdentityConfig, LayersConfig
from mlbs_actors.messages import BACKGROUND, Array

CONFIG = LayersConfig(
    probation_frames=3,
    part_probation_frames=5,
    min_tracks=4,
    coast_frames=2,
    dormant_frames=20,
    fleeting_frames=6,
    max_layers=12,
)
IDENTITY = IdentityConfig(place_px=50.0)
RED, GREEN, BLUE = (20, 20, 220), (20, 220, 20), (220, 20, 20)


@dataclass(frozen=True)
class Thing:
    """A cluster of trajectories as it stands in one frame."""

    tracks: int = 10
    place: tuple[float, float] = (100.0, 100.0)
    velocity: tuple[float, float] = (0.0, 0.0)
    colour: tuple[int, int, int] = RED
    part_of: str = ""


@dataclass
class Stream:
    """Feeds the registry the clusters of one frame after the other, as the coordinator does."""

    config: LayersConfig = CONFIG
    state: RegistryState | None = None
    frame_index: int = -1
    labels: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.registry = LayerRegistry(Config(layers=self.config, identity=IDENTITY), (480, 640), self.state)

    def see(
        self,
        things: Mapping[str, Thing] = MappingProxyType({}),
        *,
        published: tuple[int, ...] = (),
        at_once: bool = False,
        another_thing: str | None = None,
    ) -> set[int]:
        """One frame, in which a name may turn out to be no part; returns the layers that are live in it."""
        self.frame_index += 1
        fresh = max([self.registry.state.next_layer, *self.labels.values()]) + 1
        given, names = [], list(things)
        for name in names:
            label = self.labels.get(name, UNLABELLED)
            if label == UNLABELLED:
                label, fresh = fresh, fresh + 1
            given.append(label)
        counts = [things[name].tracks for name in names]
        origins = {
            label: self.labels.get(things[name].part_of, BACKGROUND)
            for name, label in zip(names, given, strict=True)
        }

        def spread(values: list[tuple[float, float]]) -> Array:
            return np.repeat(np.array(values, np.float32).reshape(-1, 2), counts, axis=0)

        colours = np.array([things[name].colour for name in names], np.uint8).reshape(-1, 3)
        labels = self.registry.observe(
            self.registry.admit(np.repeat(np.array(given, np.int64), counts), self.frame_index, origins),
            spread([things[name].place for name in names]),
            -spread([things[name].velocity for name in names]),
            np.repeat(colours, counts, axis=0),
            self.frame_index,
            published,
        )
        probation = 0 if at_once else self.config.probation_frames
        starts = np.cumsum([0, *counts])
        parted = [int(labels[starts[names.index(another_thing)]])] if another_thing else []
        labels = self.registry.promote(labels, self.frame_index, probation, parted)
        self.labels = {name: int(labels[start]) for name, start in zip(names, starts, strict=False)}
        for name, start, count in zip(names, starts, counts, strict=False):
            assert set(labels[start : start + count].tolist()) == {self.labels[name]}
        return set(self.registry.live_layers(self.frame_index))

    def layer_of(self, name: str) -> int | None:
        """The layer of a thing seen in the newest frame, None before its birth."""
        (layer,) = self.registry.layers_of(np.array([self.labels[name]])).tolist()
        return layer if layer > BACKGROUND else None

    def remembered(self) -> set[int]:
        """The layers that live or sleep."""
        labels = self.registry.state.labels
        return set(self.registry.layers_of(labels[labels > 0]).tolist())

    def skip(self, frames: int) -> None:
        for _ in range(frames):
            self.see()


# Births


def test_a_cluster_becomes_a_layer_only_after_its_probation() -> None:
    stream = Stream()
    for _ in range(CONFIG.probation_frames):
        assert stream.see({"car": Thing()}) == set()
        assert stream.layer_of("car") is None
    assert stream.see({"car": Thing()}) == {1}
    assert stream.layer_of("car") == 1


def test_what_is_known_to_be_no_part_of_the_object_it_was_split_off_has_the_probation_of_any_other() -> None:
    stream = Stream()
    stream.see({"man": Thing()}, at_once=True)
    parted = {"man": Thing(), "dog": Thing(place=(120.0, 100.0), colour=BLUE, part_of="man")}
    assert stream.see(parted, another_thing="dog") == {1}
    for _ in range(CONFIG.probation_frames - 1):
        assert stream.see(parted) == {1}
    assert stream.see(parted) == {1, 2}
    assert stream.layer_of("dog") == 2


def test_what_falls_off_an_object_is_a_part_of_it_until_its_longer_probation_ends() -> None:
    stream = Stream()
    stream.see({"man": Thing()}, at_once=True)
    parted = {"man": Thing(), "arm": Thing(place=(120.0, 100.0), colour=BLUE, part_of="man")}
    for _ in range(CONFIG.part_probation_frames):
        assert stream.see(parted) == {1}
        assert stream.layer_of("arm") == stream.layer_of("man") == 1
    assert stream.see(parted) == {1, 2}
    assert stream.layer_of("arm") == 2


def test_what_falls_off_a_part_belongs_to_the_same_object() -> None:
    stream = Stream()
    stream.see({"man": Thing()}, at_once=True)
    stream.see({"man": Thing(), "arm": Thing(part_of="man")})
    stream.see({"man": Thing(), "arm": Thing(), "hand": Thing(part_of="arm")})
    assert stream.layer_of("hand") == 1
    assert stream.registry.parts() == {stream.labels["arm"], stream.labels["hand"]}


def test_a_part_that_is_all_that_is_left_of_its_object_is_that_object() -> None:
    stream = Stream()
    stream.skip(1)
    for _ in range(CONFIG.probation_frames + 1):
        stream.see({"man": Thing(), "car": Thing(place=(400.0, 300.0))})
    man = stream.layer_of("man")
    parted = {"man": Thing(), "body": Thing(colour=BLUE, part_of="man"), "car": Thing(place=(400.0, 300.0))}
    stream.see(parted)
    assert stream.layer_of("body") == man
    before = stream.labels["body"]
    stream.see({name: thing for name, thing in parted.items() if name != "man"})
    assert stream.labels["body"] == man != before
    for _ in range(3 * CONFIG.part_probation_frames):
        assert man in stream.see({"body": Thing(colour=BLUE)})


def test_of_two_parts_of_a_lost_object_the_first_is_that_object_and_the_other_remains_its_part() -> None:
    stream = Stream()
    for _ in range(CONFIG.probation_frames + 1):
        stream.see({"man": Thing()})
    man = stream.layer_of("man")
    parts = {
        "body": Thing(place=(90.0, 100.0), part_of="man"),
        "legs": Thing(place=(110.0, 140.0), colour=BLUE, part_of="man"),
    }
    stream.see({"man": Thing(), **parts})
    stream.see(parts)
    assert stream.layer_of("body") == stream.layer_of("legs") == man
    assert sorted(label > BACKGROUND for label in stream.labels.values()) == [False, True]


def test_a_part_of_an_object_that_shares_the_layer_other_is_in_that_layer_too() -> None:
    stream = Stream(CONFIG.model_copy(update={"max_layers": 3}))
    pair = {"large": Thing(tracks=30), "small": Thing(place=(300.0, 100.0)), "tiny": Thing(tracks=5)}
    stream.see(pair, at_once=True)
    stream.see({**pair, "limb": Thing(tracks=4, part_of="tiny")})
    assert stream.layer_of("limb") == stream.layer_of("tiny") == stream.registry.state.other


def test_when_an_object_is_merged_into_another_its_parts_go_with_it() -> None:
    stream = Stream()
    things = {"van": Thing(), "man": Thing(place=(200.0, 100.0))}
    stream.see(things, at_once=True)
    stream.see({**things, "arm": Thing(tracks=5, part_of="man")})
    van, man = stream.layer_of("van"), stream.layer_of("man")
    assert van is not None
    assert man is not None
    assert stream.layer_of("arm") == man
    stream.registry.forget({man: van})
    assert stream.layer_of("arm") == van


@pytest.mark.parametrize("pooled", [False, True])
def test_an_object_that_became_background_lives_on_in_its_part(pooled: bool) -> None:
    stream = Stream(CONFIG.model_copy(update={"max_layers": 3}) if pooled else CONFIG)
    things = {
        "large": Thing(tracks=30),
        "van": Thing(tracks=20, place=(300.0, 100.0)),
        "man": Thing(tracks=6),
    }
    stream.see(things, at_once=True)
    stream.see({**things, "arm": Thing(tracks=4, part_of="man")})
    man = stream.layer_of("man")
    assert (man == stream.registry.state.other) == pooled
    stream.registry.forget({stream.labels["man"]: BACKGROUND})
    del things["man"]
    stream.see({**things, "arm": Thing(tracks=4)})
    assert stream.layer_of("arm") == man
    assert stream.labels["arm"] not in stream.registry.parts()


def test_an_object_that_became_background_with_its_parts_is_forgotten() -> None:
    stream = Stream()
    stream.see({"man": Thing()}, at_once=True)
    stream.see({"man": Thing(), "arm": Thing(part_of="man")})
    stream.registry.forget(dict.fromkeys(stream.labels.values(), BACKGROUND))
    assert not stream.registry.state.labels.size


def test_what_falls_off_the_background_belongs_to_no_layer_at_first() -> None:
    stream = Stream()
    assert stream.see({"car": Thing(part_of="road")}) == set()
    assert stream.layer_of("car") is None


def test_a_cluster_that_breaks_its_probation_begins_again() -> None:
    stream = Stream()
    for _ in range(CONFIG.probation_frames):
        stream.see({"car": Thing()})
    stream.see({"car": Thing(tracks=CONFIG.min_tracks - 1)})
    for _ in range(CONFIG.probation_frames):
        assert stream.see({"car": Thing()}) == set()
    assert stream.see({"car": Thing()}) == {1}


def test_without_probation_a_cluster_is_a_layer_at_once() -> None:
    stream = Stream()
    assert stream.see({"car": Thing(), "dog": Thing(colour=BLUE)}, at_once=True) == {1, 2}


def test_too_few_trajectories_never_become_a_layer() -> None:
    stream = Stream()
    for _ in range(3 * CONFIG.probation_frames):
        assert stream.see({"fleck": Thing(tracks=CONFIG.min_tracks - 1)}) == set()
        assert stream.labels["fleck"] == UNLABELLED
    assert stream.remembered() == set()


def test_the_older_of_two_candidates_gets_the_lower_id() -> None:
    stream = Stream()
    stream.see({"car": Thing()})
    for _ in range(CONFIG.probation_frames + 1):
        stream.see({"dog": Thing(colour=BLUE), "car": Thing()})
    assert (stream.layer_of("car"), stream.layer_of("dog")) == (1, 2)


def test_the_background_is_older_than_all() -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    stream.see({"car": Thing()})
    ages = stream.registry.ages(stream.frame_index)
    assert ages[1] == 1
    assert ages[BACKGROUND] > 10**6


# Sleep and waking


def test_a_layer_without_enough_trajectories_sleeps_and_is_remembered() -> None:
    stream = Stream()
    assert stream.see({"car": Thing()}, at_once=True) == {1}
    assert stream.see({"car": Thing(tracks=CONFIG.min_tracks - 1)}) == set()
    assert stream.labels["car"] == UNLABELLED
    assert stream.remembered() == {1}


def test_a_layer_that_still_owns_pixels_coasts_for_a_while() -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    for _ in range(CONFIG.coast_frames):
        assert stream.see(published=(1,)) == {1}
    assert stream.see(published=(1,)) == set()


def test_a_layer_that_slept_does_not_wake_by_pixels_alone() -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    assert stream.see() == set()
    assert stream.see(published=(1,)) == set()


@pytest.mark.parametrize("gap", [1, 3, 5])
def test_what_comes_back_with_like_colours_is_the_same_layer(gap: int) -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    stream.skip(gap)
    born = stream.see({"again": Thing(place=(110.0, 95.0))}, at_once=True)
    assert born == {1}
    assert stream.layer_of("again") == 1


def test_it_is_looked_for_where_it_should_have_gone() -> None:
    stream = Stream()
    stream.see({"car": Thing(velocity=(20.0, 0.0))}, at_once=True)
    stream.skip(4)
    stream.see({"again": Thing(place=(205.0, 100.0))}, at_once=True)
    assert stream.layer_of("again") == 1


@pytest.mark.parametrize(
    ("place", "velocity"),
    [((20.0, 100.0), (-12.0, 0.0)), ((620.0, 100.0), (12.0, 0.0)), ((100.0, 470.0), (0.0, 12.0))],
)
def test_what_comes_in_where_a_layer_has_left_the_frame_is_another(
    place: tuple[float, float], velocity: tuple[float, float]
) -> None:
    stream = Stream()
    stream.see({"car": Thing(place=place, velocity=velocity)}, at_once=True)
    stream.skip(4)
    stream.see({"another": Thing(place=place)}, at_once=True)
    assert stream.layer_of("another") == 2


def test_a_layer_that_was_held_up_is_found_where_it_fell_asleep() -> None:
    stream = Stream()
    stream.see({"car": Thing(velocity=(40.0, 0.0))}, at_once=True)
    stream.skip(4)
    stream.see({"again": Thing()}, at_once=True)
    assert stream.layer_of("again") == 1


@pytest.mark.parametrize(("hidden", "known"), [(3, 2), (CONFIG.dormant_frames - 1, 1)])
def test_the_longer_it_was_hidden_the_farther_away_it_may_appear(hidden: int, known: int) -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    for _ in range(CONFIG.moving_clusterings):
        stream.registry.judge({1: 2.0}, 1.0)
    stream.skip(hidden)
    stream.see({"again": Thing(place=(300.0, 100.0))}, at_once=True)
    assert stream.layer_of("again") == known


def test_the_edge_that_disappears_last_does_not_change_its_colours() -> None:
    stream = Stream()
    stream.see({"car": Thing(tracks=100)}, at_once=True)
    for _ in range(10):
        stream.see({"car": Thing(tracks=5, colour=BLUE)})
    stream.skip(2)
    stream.see({"again": Thing(tracks=100)}, at_once=True)
    assert stream.layer_of("again") == 1


@pytest.mark.parametrize("other", [Thing(colour=GREEN), Thing(place=(300.0, 100.0))])
def test_other_colours_or_a_far_place_make_another_layer(other: Thing) -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    stream.skip(2)
    stream.see({"another": other}, at_once=True)
    assert stream.layer_of("another") == 2
    assert stream.remembered() == {1, 2}


def test_what_comes_out_from_behind_an_object_is_what_was_hidden_and_no_part_of_it() -> None:
    stream = Stream()
    stream.see({"van": Thing(), "car": Thing(place=(130.0, 100.0), colour=BLUE)}, at_once=True)
    stream.see({"van": Thing()})
    out = {"van": Thing(), "again": Thing(place=(80.0, 100.0), colour=BLUE, part_of="van")}
    stream.see(out, at_once=True)
    assert stream.layer_of("again") == 2


def test_what_falls_off_an_object_is_its_part_though_something_like_it_is_hidden() -> None:
    stream = Stream()
    stream.see({"van": Thing(), "car": Thing(place=(130.0, 100.0))}, at_once=True)
    stream.see({"van": Thing()})
    stream.see({"van": Thing(), "door": Thing(place=(80.0, 100.0), part_of="van")}, at_once=True)
    assert stream.layer_of("door") == 1


def test_the_better_match_of_two_sleepers_wakes() -> None:
    stream = Stream()
    stream.see({"car": Thing(colour=RED), "dog": Thing(colour=BLUE)}, at_once=True)
    stream.skip(1)
    stream.see({"again": Thing(colour=BLUE)}, at_once=True)
    assert stream.layer_of("again") == 2


def test_one_sleeper_wakes_once() -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    stream.skip(1)
    assert stream.see({"one": Thing(), "other": Thing()}, at_once=True) == {1, 2}


def test_a_layer_that_is_awake_is_not_taken_for_a_new_cluster() -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    stream.see({"car": Thing(), "twin": Thing()}, at_once=True)
    assert (stream.layer_of("car"), stream.layer_of("twin")) == (1, 2)


@pytest.mark.parametrize(
    ("moved", "frames"),
    [
        (CONFIG.moving_clusterings - 1, CONFIG.fleeting_frames),
        (CONFIG.moving_clusterings, CONFIG.dormant_frames),
    ],
)
def test_a_layer_that_sleeps_too_long_is_forgotten_and_its_id_is_not_given_again(
    moved: int, frames: int
) -> None:
    stream = Stream()
    stream.see({"car": Thing()}, at_once=True)
    for _ in range(moved):
        stream.registry.judge({1: 2.0}, 1.0)
    stream.skip(frames)
    assert stream.remembered() == {1}
    stream.skip(1)
    assert stream.remembered() == set()
    stream.see({"car": Thing()}, at_once=True)
    assert stream.layer_of("car") == 2


# The cap


def crowd(count: int) -> dict[str, Thing]:
    """Things of growing size, far from one another."""
    return {f"thing{i}": Thing(tracks=5 + i, place=(1000.0 * i, 0.0)) for i in range(count)}


def test_up_to_the_cap_every_object_has_its_own_layer() -> None:
    stream = Stream()
    live = stream.see(crowd(CONFIG.max_layers - 1), at_once=True)
    assert live == set(range(1, CONFIG.max_layers))
    assert stream.registry.state.other == -1


@pytest.mark.parametrize("count", [12, 13, 40])
def test_past_the_cap_the_smallest_share_one_layer(count: int) -> None:
    stream = Stream()
    live = stream.see(crowd(count), at_once=True)
    other = stream.registry.state.other
    assert len(live) == CONFIG.max_layers - 1
    assert other in live
    shared = [name for name in crowd(count) if stream.layer_of(name) == other]
    assert shared == [f"thing{i}" for i in range(count - (CONFIG.max_layers - 2))]
    own = [stream.layer_of(name) for name in crowd(count) if name not in shared]
    assert len(set(own)) == CONFIG.max_layers - 2


def test_the_smallest_cap_holds_too() -> None:
    stream = Stream(CONFIG.model_copy(update={"max_layers": 2}))
    assert len(stream.see({"one": Thing()}, at_once=True)) == 1
    live = stream.see({"one": Thing(), "two": Thing(place=(900.0, 0.0))}, at_once=True)
    assert live == {stream.registry.state.other}


def test_who_shares_the_layer_other_does_so_for_life() -> None:
    stream = Stream()
    everyone = crowd(14)
    stream.see(everyone, at_once=True)
    other = stream.registry.state.other
    for count in (10, 6, 3):
        few = {name: everyone[name] for name in list(everyone)[:count]}
        stream.see(few)
        assert stream.layer_of("thing0") == other


# Over a long time


@pytest.mark.parametrize("seed", range(4))
def test_in_a_long_stream_no_id_is_given_twice_and_the_cap_holds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stream = Stream(CONFIG.model_copy(update={"max_layers": 5}))
    present: dict[str, Thing] = {}
    first_owner: dict[int, str] = {}
    forgotten: set[int] = set()
    remembered: set[int] = set()
    names = 0
    for _ in range(150):
        for name in [name for name in present if rng.random() < 0.15]:
            del present[name]
        while rng.random() < 0.5:
            blue, green, red = rng.integers(0, 256, 3).tolist()
            place = (float(rng.uniform(0, 5000)), 0.0)
            present[f"thing{names}"] = Thing(int(rng.integers(2, 30)), place, colour=(blue, green, red))
            names += 1
        live = stream.see(present)
        assert len(live) <= 4
        for name, label in stream.labels.items():
            if label > BACKGROUND:
                assert first_owner.setdefault(label, name) == name
        now = stream.remembered()
        forgotten |= remembered - now
        remembered = now
        assert not (now - {stream.registry.state.other}) & forgotten
        labels = stream.registry.state.labels
        assert (np.diff(labels) > 0).all()
    assert len(first_owner) > 20
    assert len(forgotten) > 10
    assert stream.registry.state.other > 0


def test_a_registry_goes_on_from_its_state() -> None:
    one = Stream()
    one.see({"car": Thing()}, at_once=True)
    one.see({"car": Thing(), "dog": Thing(colour=BLUE, place=(400.0, 0.0))})
    state = one.registry.state
    copy = replace(
        state,
        **{
            name: getattr(state, name).copy()
            for name in state.__slots__
            if isinstance(getattr(state, name), np.ndarray)
        },
    )
    other = Stream(state=copy, frame_index=one.frame_index, labels=dict(one.labels))
    for things in ({"dog": Thing(colour=BLUE)}, {}, {"car": Thing(), "dog": Thing()}, {"car": Thing()}):
        for at_once in (False, True):
            assert one.see(things, at_once=at_once) == other.see(things, at_once=at_once)
    assert one.labels == other.labels


# Colours


# Objects that hardly move


def test_a_label_that_has_hardly_moved_stays_as_young_as_on_its_first_frame() -> None:
    stream = Stream()
    for frame in range(12):
        stream.see({"car": Thing(), "kerb": Thing(place=(300.0, 300.0))})
        speeds = {stream.labels["car"]: 2.0, stream.labels["kerb"]: 2.0 if frame < 2 else 0.1}
        stream.registry.judge(speeds, 1.0)
        ages = stream.registry.ages(frame)
        assert ages[stream.labels["car"]] == frame
        moved_in = min(frame + 1, 2) / (frame + 1)
        assert ages[stream.labels["kerb"]] == (frame if moved_in >= CONFIG.least_moving else 0)
    assert ages[stream.labels["kerb"]] == 0


def test_what_has_moved_often_enough_may_rest_for_ever() -> None:
    stream = Stream()
    for frame in range(100):
        stream.see({"car": Thing(), "kerb": Thing(place=(300.0, 300.0))})
        moved = {"car": CONFIG.moving_clusterings, "kerb": CONFIG.moving_clusterings - 1}
        speeds = {stream.labels[name]: 2.0 * (frame < count) for name, count in moved.items()}
        stream.registry.judge(speeds, 1.0)
    ages = stream.registry.ages(99)
    assert ages[stream.labels["car"]] == 99
    assert ages[stream.labels["kerb"]] == 0


def test_what_has_not_moved_in_some_clusterings_rests_until_it_moves() -> None:
    stream = Stream()
    for _ in range(6):
        stream.see({"car": Thing()})
    car, resting = stream.labels["car"], []
    for speed in (2.0, *[0.0] * RESTED_CLUSTERINGS, 2.0):
        stream.registry.judge({car: speed}, 1.0)
        resting.append(stream.registry.resting_layers())
    assert resting == [*[()] * RESTED_CLUSTERINGS, (car,), ()]


def test_what_has_no_trajectories_is_not_judged() -> None:
    stream = Stream()
    for _ in range(6):
        stream.see({"car": Thing()})
        stream.registry.judge({stream.labels["car"]: 2.0}, 1.0)
    for _ in range(30):
        stream.registry.judge({}, 1.0)
    assert stream.registry.ages(6)[stream.labels["car"]] == 6


def test_an_object_that_holds_together_firmly_is_spared_the_next_three_tests() -> None:
    stream = Stream()
    stream.see({"car": Thing(), "bus": Thing(place=(300.0, 300.0))}, at_once=True)
    car, bus = stream.labels["car"], stream.labels["bus"]
    stream.see({"car": Thing(), "bus": Thing(place=(300.0, 300.0)), "new": Thing(place=(500.0, 50.0))})
    candidate, spared = stream.labels["new"], []
    for firm in ([BACKGROUND, car, candidate], [], [], [], [bus, car]):
        stream.registry.spare(np.array(firm, np.int64))
        spared.append(set(stream.registry.spared_labels()))
    assert spared == [{car}, {car}, {car}, set(), {car, bus}]
