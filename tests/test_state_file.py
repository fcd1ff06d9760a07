"""States of parts as files: read back as they were, refused when they are anything else."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from test_coordinator import Square, configured, movie

from mlbs_actors import Config, Segmentation
from mlbs_actors.coordinator import Coordinator, CoordinatorState
from mlbs_actors.determinism import single_threaded
from mlbs_actors.errors import SnapshotError
from mlbs_actors.layer.layer import Layer
from mlbs_actors.layer.layer_state import LayerState
from mlbs_actors.messages import Array, FrameEvidence, LayerKind
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.segmentation.segmenter import Segmenter, SegmenterState
from mlbs_actors.state_file import capture, check_file, read_state


@dataclass(frozen=True)
class Inner:
    name: str
    kind: Literal["one", "two"]


@dataclass
class State:
    count: int
    ratio: float
    ready: bool
    picture: Array
    maybe: Array | None
    pair: tuple[int, float]
    inner: tuple[Inner, ...]
    last: dict[int, int]
    times: Mapping[str, float] = field(default_factory=dict)


def state(**changed: Any) -> State:
    plain = State(
        count=2**60,
        ratio=0.1 + 0.2,
        ready=True,
        picture=np.arange(24, dtype=np.uint8).reshape(2, 4, 3),
        maybe=None,
        pair=(3, -0.0),
        inner=(Inner("a", "one"), Inner("ü", "two")),
        last={7: 3, 0: -1},
        times={"flow": 1e-300},
    )
    return replace(plain, **changed)


def without_arrays(one: State) -> dict[str, Any]:
    return {name: value for name, value in vars(one).items() if not isinstance(value, np.ndarray)}


def written(folder: Path, value: object) -> Path:
    capture(value).write(folder / "state")
    return folder / "state"


def test_values_come_back_as_they_were(tmp_path: Path) -> None:
    back = read_state(written(tmp_path, state()), State)
    np.testing.assert_array_equal(back.picture, state().picture)
    assert without_arrays(back) == without_arrays(state())
    assert list(back.last) == [7, 0]
    assert [path.name for path in tmp_path.iterdir()] == ["state"]


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((0, 5, 2), np.float32),
        np.array(3.5),
        np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        np.arange(20, dtype=np.int32)[::3],
        np.array([np.nan, -0.0, np.inf], np.float16),
        np.array([True, False]),
        np.frombuffer(b"abcd", np.uint8),
    ],
)
def test_arrays_keep_bytes_type_shape_order_and_whether_they_may_be_written(
    tmp_path: Path, array: Array
) -> None:
    back = read_state(written(tmp_path, state(maybe=array)), State).maybe
    assert back is not None
    assert (back.dtype, back.shape, back.tobytes()) == (array.dtype, array.shape, array.tobytes())
    assert (back.flags.fnc, back.flags.writeable) == (array.flags.fnc, array.flags.writeable)
    assert back.flags.aligned


@pytest.mark.parametrize("arrived", [False, True])
def test_a_captured_state_is_gone_on_with_by_another_process_like_one_that_was_read(
    tmp_path: Path, arrived: bool
) -> None:
    arrays = [np.asfortranarray(np.arange(12.0).reshape(3, 4)), np.zeros((0, 5, 2), np.float32), np.array(3)]
    arrays[0].setflags(write=False)
    for array in arrays:
        captured = capture(state(maybe=array))
        if arrived:  # through shared memory: the arrays are read-only
            buffers: list[pickle.PickleBuffer] = []
            description = pickle.dumps(captured, protocol=5, buffer_callback=buffers.append)
            captured = pickle.loads(description, buffers=[one.raw().toreadonly() for one in buffers])
        given, read = captured.state(State), read_state(written(tmp_path, state(maybe=array)), State)
        for one, other in ((given.picture, read.picture), (given.maybe, read.maybe)):
            assert one is not None
            assert other is not None
            np.testing.assert_array_equal(one, other)
            assert (one.dtype, one.flags.fnc, one.flags.writeable) == (
                other.dtype,
                other.flags.fnc,
                other.flags.writeable,
            )
        assert without_arrays(given) == without_arrays(read)


def test_a_captured_state_does_not_follow_its_part(tmp_path: Path) -> None:
    living = state()
    captured = capture(living)
    living.picture[:] = 0
    captured.write(tmp_path / "state")
    assert read_state(tmp_path / "state", State).picture.any()


def test_the_same_state_gives_the_same_file(tmp_path: Path) -> None:
    first = written(tmp_path, state()).read_bytes()
    assert written(tmp_path, state()).read_bytes() == first


@pytest.mark.parametrize(
    "changed",
    [
        {"count": 1.0},
        {"count": np.int64(1)},
        {"ready": 1},
        {"picture": [1, 2]},
        {"picture": np.array([object()])},
        {"pair": (1, 2.0, 3.0)},
        {"inner": (Inner("a", "three"),)},  # type: ignore[arg-type]
        {"last": {"a": 1}},
    ],
)
def test_what_could_not_be_read_back_is_not_written(changed: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError)):
        capture(state(**changed))


def test_every_flipped_bit_and_every_cut_is_noticed(tmp_path: Path) -> None:
    path = written(tmp_path, state())
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for position in random.integers(0, 8 * len(whole), 60):
        damaged = bytearray(whole)
        damaged[position // 8] ^= 1 << position % 8
        path.write_bytes(damaged)
        with pytest.raises(SnapshotError, match="damaged"):
            read_state(path, State)
    for length in (0, 7, 40, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(SnapshotError, match="damaged"):
            check_file(path)
    path.write_bytes(whole)
    check_file(path)


def test_a_planted_pickle_runs_nothing(tmp_path: Path) -> None:
    class Planted:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "run",)

    for content in (pickle.dumps(Planted()), b"mlbs-st1" + pickle.dumps(Planted())):
        (tmp_path / "state").write_bytes(content)
        with pytest.raises(SnapshotError):
            read_state(tmp_path / "state", State)
    assert not (tmp_path / "run").exists()


def test_the_state_of_another_part_or_version_and_a_missing_one_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, Inner("a", "one"))
    with pytest.raises(SnapshotError, match="holds a Inner"):
        read_state(path, State)

    @dataclass
    class Later:
        name: str
        kind: Literal["one", "two"]
        colour: int

    Later.__name__ = "Inner"
    with pytest.raises(SnapshotError, match="not one of this version"):
        read_state(path, Later)
    with pytest.raises(SnapshotError, match="cannot be read"):
        read_state(tmp_path / "none", State)


# ---- the engine goes on from files as if nothing had happened


class Engine:
    """The parts of one stream, called one after the other; all that they know can go through files."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.coordinator, self.segmenter = Coordinator(config), Segmenter(config)
        self.layers: dict[int, Layer] = {}
        self.held: dict[int, Array] = {}
        self.published: dict[int, Segmentation] = {}

    def apply(self, picture: Array) -> Iterator[bytes]:
        index = self.coordinator.state.next_frame
        wanted = self.coordinator.feedback_index(index)
        feedback = None if wanted is None else partial(self.published.__getitem__, wanted)
        evidence = self.coordinator.step(index, picture, feedback)
        self.held[index] = picture
        for one in evidence:
            yield self.label(one)

    def label(self, evidence: FrameEvidence) -> bytes:
        index, picture = evidence.frame_index, self.held.pop(evidence.frame_index)
        for retired in evidence.retired:
            del self.layers[retired]
        posteriors = []
        for own in evidence.tracks:
            layer = self.layers.setdefault(own.layer, Layer(self.config, own.layer, own.kind))
            posteriors.append(layer.step(evidence, self.published.get(index - 1)))
        result = self.segmenter.step(evidence, picture, posteriors)
        self.published[index] = result
        self.published.pop(index - 3, None)
        return result.labels.tobytes() + result.normaliser.tobytes() + result.fallback.tobytes()

    def through_files(self, folder: Path) -> Engine:
        """A new engine that knows what this one has written to files."""
        folder.mkdir()
        kinds: dict[int, LayerKind] = {layer: part.kind for layer, part in self.layers.items()}
        capture(self.coordinator.state).write(folder / "coordinator")
        capture(self.segmenter.state).write(folder / "segmenter")
        for layer, part in self.layers.items():
            capture(part.state).write(folder / f"layer-{layer}")
        for index, published in self.published.items():
            capture(published).write(folder / f"labels-{index}")
        other = Engine(self.config)
        other.coordinator = Coordinator(self.config, read_state(folder / "coordinator", CoordinatorState))
        other.segmenter = Segmenter(self.config, read_state(folder / "segmenter", SegmenterState))
        other.layers = {
            layer: Layer(self.config, layer, kind, read_state(folder / f"layer-{layer}", LayerState))
            for layer, kind in kinds.items()
        }
        other.published = {
            index: read_state(folder / f"labels-{index}", Segmentation) for index in self.published
        }
        other.held = dict(self.held)
        return other


def compare(config: Config, pictures: list[Array], folder: Path) -> set[str]:
    """Take every frame twice, the second time after all went through files; return what happened."""
    undisturbed, restored, events = Engine(config), Engine(config), set()
    with single_threaded():
        for t, picture in enumerate(pictures):
            restored = restored.through_files(folder / str(t))
            expected = list(undisturbed.apply(picture))
            assert list(restored.apply(picture)) == expected, t
            registry = undisturbed.coordinator.state.epoch.registry
            happened = {
                "birth": (registry.born > 0).any(),
                "sleep": ((registry.labels > 0) & (registry.seen < t)).any(),
                "other": registry.other > 0,
            }
            events |= {event for event, is_so in happened.items() if is_so}
        restored = restored.through_files(folder / "end")
        left = [[one.label(late) for late in one.coordinator.flush()] for one in (undisturbed, restored)]
    assert left[0] == left[1]
    return events


@pytest.mark.parametrize(
    ("layers", "squares", "events"),
    [
        (
            {"lookahead": 1, "probation_frames": 1, "coast_frames": 0},
            [Square(20, 30, 4, end=8), Square(80, 60, -3, first=3)],
            {"sleep"},
        ),
        (
            {"lookahead": 2, "max_layers": 3, "probation_frames": 1, "coast_frames": 0},
            [Square(20, 10, 4, end=8), Square(90, 60, -3), Square(10, 60, 3, first=4)],
            {"birth", "other"},
        ),
    ],
)
def test_an_engine_that_goes_through_files_before_every_frame_gives_the_same_bytes(
    tmp_path: Path, layers: dict[str, int], squares: list[Square], events: set[str]
) -> None:
    assert events <= compare(configured(**layers), movie(14, *squares), tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "layers"), [("steady-crowd", {"max_layers": 4}), ("late-entry", {}), ("demo", {"lookahead": 3})]
)
def test_the_same_holds_for_the_scenes(tmp_path: Path, name: str, layers: dict[str, int]) -> None:
    video = scene(name, frames=40, width=128, height=96)
    pictures = [video.frame(t) for t in range(len(video))]
    compare(Config.model_validate({"layers": layers}), pictures, tmp_path)
