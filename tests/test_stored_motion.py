"""Flow and tracks of other programs: read from files, or from a function with the interface of RAFT."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from mlbs_actors.stored_motion import StoredMotion, read_flow
from orchestrator.evaluation.command import main

SCENE = "synthetic:crossing?frames=6&width=96&height=72"
SHAPE = (72, 96, 2)


def write_flo(path: Path, flow: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width = flow.shape[:2]
    path.write_bytes(struct.pack("<fii", 202021.25, width, height) + flow.astype("<f4").tobytes())


def write_npy(path: Path, flow: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, flow)


def constant(value: float) -> Array:
    return np.full(SHAPE, value, np.float32)


@pytest.fixture
def made() -> SyntheticScene:
    return scene("crossing", frames=6, width=96, height=72)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Forward and backward flow of every frame: its index, and minus its index."""
    for index in range(6):
        write_flo(tmp_path / f"forward/set/clip/{index:05d}.flo", constant(index))
        write_npy(tmp_path / f"backward/set/clip/{index:05d}.npy", constant(-index))
    return tmp_path


def followed(stored: StoredMotion, frames: list[Array]) -> StoredMotion:
    for index, frame in enumerate(frames):
        stored.follow(index, f"{index:05d}", frame)
    return stored


def flow_of(stored: StoredMotion, first: Array, second: Array) -> Array:
    assert stored.flow is not None
    return stored.flow(first, second)


def test_flow_is_that_of_the_first_frame_towards_the_second(folder: Path, made: SyntheticScene) -> None:
    frames = [made.frame(index) for index in range(4)]
    stored = followed(StoredMotion("set/clip", folder), frames)
    assert np.array_equal(flow_of(stored, frames[2], frames[3]), constant(2))
    assert np.array_equal(flow_of(stored, frames[3], frames[2]), constant(-3))
    assert stored.tracks is None


def test_flow_across_a_frame_is_not_known(folder: Path, made: SyntheticScene) -> None:
    frames = [made.frame(index) for index in range(3)]
    stored = followed(StoredMotion("set/clip", folder), frames)
    assert not flow_of(stored, frames[0], frames[2]).any()
    assert not flow_of(stored, frames[1], np.zeros_like(frames[1])).any()  # nor of what it was never told of


def test_a_repeated_picture_does_not_move_and_is_the_latest_of_them(
    folder: Path, made: SyntheticScene
) -> None:
    first, second = made.frame(0), made.frame(1)
    stored = followed(StoredMotion("set/clip", folder), [first, first, second])
    assert not flow_of(stored, first, first).any()
    assert np.array_equal(flow_of(stored, first, second), constant(1))


def test_motion_of_frames_that_were_not_followed_is_refused_rather_than_none(
    folder: Path, made: SyntheticScene
) -> None:
    frames = [made.frame(index) for index in range(3)]
    rgb = [frame[..., ::-1] for frame in frames]
    for stored in (StoredMotion("set/clip", folder), followed(StoredMotion("set/clip", folder), rgb)):
        with pytest.raises(SourceError, match=r"call follow\(index, stem, frame\) before each apply"):
            flow_of(stored, frames[0], frames[1])
    write_tracks(folder, tracks=np.zeros((3, 1, 2), np.float32), visible=np.ones((3, 1), bool))
    tracks = StoredMotion("set/clip", tracks=folder).tracks
    assert tracks is not None
    with pytest.raises(SourceError, match="call follow"):
        tracks(frames[0], frames[1], np.zeros((1, 2), np.float32))


def test_what_holds_no_motion_of_a_video_is_told_when_it_is_named(folder: Path) -> None:
    with pytest.raises(ConfigError, match="give flow=, tracks= or both"):
        StoredMotion("set/clip")
    with pytest.raises(SourceError, match=r"There is no flow in .*forward/other; .* needs forward/other"):
        StoredMotion("other", flow=folder)
    with pytest.raises(SourceError, match="There are no tracks in"):
        StoredMotion("set/clip", tracks=folder)
    StoredMotion("other", flow=folder, here=False)


def test_stored_motion_shows_what_it_reads_and_how_far_it_is(folder: Path, made: SyntheticScene) -> None:
    stored = StoredMotion("set/clip", str(folder))
    assert repr(stored) == f"StoredMotion(set/clip, flow in {folder}, no frame followed yet)"
    assert repr(followed(stored, [made.frame(0)])).endswith(", the last 00000)")


def test_missing_flow_is_told_by_its_path(folder: Path, made: SyntheticScene) -> None:
    frames = [made.frame(index) for index in range(2)]
    stored = followed(StoredMotion("set/clip", folder), frames)
    (folder / "forward/set/clip/00000.flo").unlink()
    with pytest.raises(SourceError, match=r"no 00000\.flo and no 00000\.npy in .*/forward/set/clip"):
        flow_of(stored, *frames)
    with pytest.raises(SourceError, match="forward/set/clip"):
        followed(StoredMotion("set/clip", folder / "elsewhere"), frames)


def test_flow_of_another_size_is_refused(folder: Path, made: SyntheticScene) -> None:
    write_flo(folder / "forward/set/clip/00000.flo", constant(0)[:60])
    frames = [made.frame(index) for index in range(2)]
    stored = followed(StoredMotion("set/clip", folder), frames)
    with pytest.raises(SourceError, match=r"\(60, 96\)"):
        flow_of(stored, *frames)


def test_motion_goes_on_from_the_frames_that_another_process_followed(
    folder: Path, made: SyntheticScene
) -> None:
    frames = [made.frame(index) for index in range(4)]
    before = followed(StoredMotion("set/clip", folder), frames[:3])
    after = StoredMotion("set/clip", folder)
    after.followed = before.followed
    after.follow(3, "00003", frames[3])
    assert np.array_equal(flow_of(after, frames[2], frames[3]), constant(2))


def write_tracks(folder: Path, **arrays: Array) -> Path:
    path = folder / "set/clip.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return folder


def test_points_go_as_the_nearest_stored_one_does(tmp_path: Path, made: SyntheticScene) -> None:
    places = np.array([[[10, 10], [50, 50], [80, 20]], [[13, 9], [50, 50], [80, 20]]], np.float32)
    visible = np.array([[True, True, True], [True, True, False]])
    frames = [made.frame(index) for index in range(2)]
    stored = StoredMotion("set/clip", tracks=write_tracks(tmp_path, tracks=places, visible=visible))
    tracks = followed(stored, frames).tracks
    assert tracks is not None
    points = np.array([[11, 11], [51, 48], [79, 21], [30, 60]], np.float32)
    moved, seen = tracks(frames[0], frames[1], points)
    assert seen.tolist() == [True, True, False, False]  # hidden; far from all
    assert moved[:2].tolist() == [[14, 10], [51, 48]]


@pytest.mark.parametrize(
    ("arrays", "complaint"),
    [
        ({}, "There are no tracks in"),
        ({"tracks": np.zeros((2, 3, 2))}, "cannot be read as tracks"),
        (
            {"tracks": np.zeros((2, 3, 3)), "visible": np.ones((2, 3), bool)},
            r"holds tracks \(2, 3, 3\) float64",
        ),
        ({"tracks": np.zeros((2, 3, 2)), "visible": np.ones((2, 3))}, "visible float64"),
        ({"tracks": np.zeros((2, 3, 2)), "visible": np.ones((3, 3), bool)}, r"holds visible \(3, 3\)"),
    ],
)
def test_what_are_no_tracks_is_told_with_what_is_expected(
    tmp_path: Path, made: SyntheticScene, arrays: dict[str, Array], complaint: str
) -> None:
    if arrays:
        write_tracks(tmp_path, **arrays)
    stored = StoredMotion("set/clip", tracks=tmp_path, here=False)
    with pytest.raises(SourceError, match=complaint + r"(.|\n)*tracks \(frames, points, 2\) float"):
        stored.follow(0, "00000", made.frame(0))


def damaged(content: bytes) -> Iterator[bytes]:
    """A file that ends early, and one with a byte that is another one, at many places."""
    for end in range(0, len(content), 7):
        yield content[:end]
        yield content[:end] + bytes([content[end] ^ 0x2A]) + content[end + 1 :]


@pytest.mark.parametrize("write", [np.savez, np.savez_compressed])
def test_damaged_tracks_are_told_whatever_is_wrong_with_them(
    tmp_path: Path, made: SyntheticScene, write: Callable[..., None]
) -> None:
    path = tmp_path / "clip.npz"
    write(path, tracks=np.zeros((2, 3, 2), np.float32), visible=np.ones((2, 3), bool))
    single = io.BytesIO()
    np.save(single, np.zeros((2, 3, 2), np.float32))
    told = set()
    for content in [*damaged(path.read_bytes()), single.getvalue()]:
        path.write_bytes(content)
        try:
            StoredMotion("clip", tracks=tmp_path).follow(0, "00000", made.frame(0))
        except SourceError as error:
            told.add(str(error))
    assert len(told) > 10
    assert all(words.startswith(f"{path} ") and "visible (frames, points) bool" in words for words in told)
    assert any("it is a single array" in words for words in told)


@pytest.mark.filterwarnings("ignore:Reading `.npy`")  # a header that is nearly one of Python 2
def test_damaged_flow_is_told_whatever_is_wrong_with_it(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    write_npy(path, constant(1)[:2, :3])
    told = set()
    for content in damaged(path.read_bytes()):
        path.write_bytes(content)
        try:
            read_flow(path)
        except SourceError as error:
            told.add(str(error))
    assert len(told) > 10
    assert all(str(path) in words for words in told)


def test_frames_beyond_the_stored_tracks_are_told(tmp_path: Path, made: SyntheticScene) -> None:
    write_tracks(tmp_path, tracks=np.zeros((1, 1, 2), np.float32), visible=np.ones((1, 1), bool))
    frames = [made.frame(index) for index in range(2)]
    tracks = followed(StoredMotion("set/clip", tracks=tmp_path), frames).tracks
    assert tracks is not None
    with pytest.raises(SourceError, match="has tracks of 1 frames; frame 1 is beyond them"):
        tracks(frames[0], frames[1], np.zeros((1, 2), np.float32))


def test_flow_marked_as_unknown_is_zero(tmp_path: Path) -> None:
    flow = np.dstack([np.arange(12.0).reshape(3, 4), np.ones((3, 4))])
    flow[0, 0, 1], flow[2, 3] = 1.7e9, np.nan
    write_flo(tmp_path / "a.flo", flow)
    expected = flow.astype(np.float32)
    expected[0, 0], expected[2, 3] = 0, 0
    assert np.array_equal(read_flow(tmp_path / "a.flo"), expected)


@pytest.mark.parametrize("content", [b"", b"PIEHxxxx", struct.pack("<fii", 202021.25, 96, 72) + b"\0" * 100])
def test_a_file_that_is_no_flow_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.flo").write_bytes(content)
    with pytest.raises(SourceError, match=r"a\.flo"):
        read_flow(tmp_path / "a.flo")


def test_an_array_of_another_shape_is_no_flow(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros((2, 72, 96), np.float32))
    with pytest.raises(SourceError, match="height, width, 2"):
        read_flow(tmp_path / "a.npy")


def test_the_command_runs_the_engine_with_stored_flow(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for index in range(6):
        write_npy(tmp_path / f"forward/{SCENE}/{index:05d}.npy", constant(0))
        write_npy(tmp_path / f"backward/{SCENE}/{index:05d}.npy", constant(0))
    arguments = ["--sequences", SCENE, "--jobs", "1", "--flow", str(tmp_path)]
    assert main(arguments) == 0
    # Nothing moves by this flow, so nothing is found of what does.
    header, line = capsys.readouterr().out.splitlines()[:2]
    assert dict(zip(header.split(), line.split(), strict=True))["j"] == "0"
    (tmp_path / f"backward/{SCENE}/00003.npy").unlink()
    assert main(arguments) == 1
    assert "no 00003.flo and no 00003.npy" in capsys.readouterr().err


class Raft:
    """A stub with the interface of RAFT of torchvision.

    It takes two batches (N, 3, H, W) of RGB in [-1, 1], H and W divisible by 8, and gives a list of ever
    better flow, (N, 2, H, W).
    """

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, first: Array, second: Array) -> list[Array]:
        for batch in (first, second):
            assert batch.shape == (1, 3, 72, 104)
            assert batch.dtype == np.float32
            assert -1 <= batch.min() < 0 < batch.max() <= 1
        self.calls += 1
        return [np.full((1, 2, 72, 104), 50, np.float32), np.zeros((1, 2, 72, 104), np.float32)]


def test_a_learned_flow_is_a_function_around_its_network() -> None:
    network = Raft()

    def batch(frame: Array) -> Array:
        padded = np.pad(frame, ((0, -frame.shape[0] % 8), (0, -frame.shape[1] % 8), (0, 0)), mode="edge")
        scaled: Array = padded[..., ::-1].transpose(2, 0, 1)[None].astype(np.float32) / 127.5 - 1
        return scaled

    def flow(first: Array, second: Array) -> Array:
        found = network(batch(first), batch(second))[-1][0]
        moved: Array = found.transpose(1, 2, 0)[: first.shape[0], : first.shape[1]]
        return moved

    subtractor = MultilayerSubtractor(flow=flow)
    made = scene("crossing", frames=6, width=100, height=70)
    results = [result for index in range(6) for result in subtractor.apply(made.frame(index))]
    results += subtractor.flush()
    assert len(results) == 6
    assert network.calls == 2 * 5
