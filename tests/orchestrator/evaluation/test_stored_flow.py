"""Flow of other programs: read from files, or from a function with the interface of RAFT."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from orchestrator.evaluation.command import main
from orchestrator.evaluation.sequences import SceneSequence
from orchestrator.evaluation.stored_flow import StoredFlow, read_flow

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
def sequence() -> SceneSequence:
    return SceneSequence("set/clip", scene("crossing", frames=6, width=96, height=72))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Forward and backward flow of every frame: its index, and minus its index."""
    for index in range(6):
        write_flo(tmp_path / f"forward/set/clip/{index:05d}.flo", constant(index))
        write_npy(tmp_path / f"backward/set/clip/{index:05d}.npy", constant(-index))
    return tmp_path


def test_flow_is_that_of_the_first_frame_towards_the_second(folder: Path, sequence: SceneSequence) -> None:
    flow = StoredFlow(folder, sequence)
    frames = [sequence.frame(index) for index in range(4)]
    for index, frame in enumerate(frames):
        flow.follow(index, frame)
    assert np.array_equal(flow(frames[2], frames[3]), constant(2))
    assert np.array_equal(flow(frames[3], frames[2]), constant(-3))


def test_flow_across_a_frame_is_not_known(folder: Path, sequence: SceneSequence) -> None:
    flow = StoredFlow(folder, sequence)
    for index in range(3):
        flow.follow(index, sequence.frame(index))
    assert not flow(sequence.frame(0), sequence.frame(2)).any()


def test_a_repeated_picture_does_not_move_and_is_the_latest_of_them(
    folder: Path, sequence: SceneSequence
) -> None:
    flow = StoredFlow(folder, sequence)
    first, second = sequence.frame(0), sequence.frame(1)
    for index, frame in enumerate((first, first, second)):
        flow.follow(index, frame)
    assert not flow(first, first).any()
    assert np.array_equal(flow(first, second), constant(1))


def test_missing_flow_is_told_by_its_path(folder: Path, sequence: SceneSequence) -> None:
    flow = StoredFlow(folder, sequence)
    frames = [sequence.frame(index) for index in range(2)]
    for index, frame in enumerate(frames):
        flow.follow(index, frame)
    (folder / "forward/set/clip/00000.flo").unlink()
    with pytest.raises(SourceError, match=r"no 00000\.flo and no 00000\.npy in .*/forward/set/clip"):
        flow(*frames)
    with pytest.raises(SourceError, match="forward/set/clip"):
        StoredFlow(folder / "elsewhere", sequence)


def test_flow_of_another_size_is_refused(folder: Path, sequence: SceneSequence) -> None:
    write_flo(folder / "forward/set/clip/00000.flo", constant(0)[:60])
    flow = StoredFlow(folder, sequence)
    for index in range(2):
        flow.follow(index, sequence.frame(index))
    with pytest.raises(SourceError, match=r"\(60, 96\)"):
        flow(sequence.frame(0), sequence.frame(1))


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
