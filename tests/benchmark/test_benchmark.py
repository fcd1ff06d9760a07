"""The benchmark: what is timed, what is scored, and that its peers are worth a comparison."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from benchmark import command
from benchmark.in_process.comparison import ENGINE, frame_order, measure
from benchmark.in_process.peers import PEERS, Peer
from benchmark.measurements.methods import methods_table
from mlbs_actors import Config
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from orchestrator.evaluation.sequences import SceneSequence

SMALL = "synthetic:demo?frames=8&width=160&height=120"


class Everything:
    """A peer for which all moves, and which sleeps."""

    def __init__(self, seconds: float = 0.0) -> None:
        self.seconds = seconds
        self.given: list[bytes] = []

    def apply(self, frame: Array) -> Array:
        self.given.append(frame.tobytes())
        time.sleep(self.seconds)
        return np.ones(frame.shape[:2], bool)


def demo(frames: int) -> SceneSequence:
    return SceneSequence("demo", scene("demo", frames=frames, width=160, height=120))


def test_a_sequence_is_played_back_and_forth_without_a_repeat_at_its_ends() -> None:
    assert frame_order(4, 11) == [0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2]
    assert frame_order(1, 3) == [0, 0, 0]
    assert frame_order(5, 2) == [0, 1]


@pytest.mark.long
def test_every_method_gets_every_frame_and_is_scored_on_the_first_pass_alone() -> None:
    sequence, peers = demo(6), [Everything()]
    measured = measure(sequence, {"all": lambda: peers[0]}, Config(), frames=9, warm=7)
    assert [one.method for one in measured] == [ENGINE, "all"]
    assert peers[0].given == [sequence.frame(index).tobytes() for index in frame_order(6, 9)]
    assert [one.score.frames for one in measured] == [5, 5]  # the first frame has no motion
    assert measured[1].score.all_frames.recall == 1.0
    assert measured[0].score.all_frames.precision > measured[1].score.all_frames.precision


@pytest.mark.long
def test_waiting_is_wall_time_and_no_cpu_time() -> None:
    peers = {"slow": lambda: Everything(0.5), "quick": Everything}
    engine, slow, quick = measure(demo(4), peers, Config(), frames=4, warm=1)
    assert slow.wall_ms >= 500.0
    assert slow.cpu_ms < 50.0
    assert engine.cpu_ms > quick.cpu_ms


@pytest.mark.long
def test_the_engines_stages_make_up_its_time() -> None:
    engine = measure(demo(8), {}, Config(), frames=8, warm=6)[0]
    assert {"flow", "clustering", "posterior", "cut"} <= set(engine.stage_ms)
    assert sum(engine.stage_ms.values()) > 0.0


@pytest.mark.long
@pytest.mark.parametrize("name", PEERS)
def test_a_peer_finds_a_walker_before_a_moving_camera(name: str) -> None:
    sequence = SceneSequence("demo", scene("demo", frames=10, width=320, height=240))
    peer: Peer = PEERS[name]()
    found = []
    for index in range(len(sequence.stems)):
        frame = sequence.frame(index)
        mask = peer.apply(frame)
        assert mask.shape == frame.shape[:2]
        assert mask.dtype == bool
        truth = sequence.truth(index)
        assert truth is not None
        if index >= 5:
            moving = truth > 0
            found.append(2 * (mask & moving).sum() / (mask.sum() + moving.sum()))
    assert np.mean(found) > 0.3  # all of the frame has 0.1


@pytest.mark.long
@pytest.mark.parametrize("name", PEERS)
def test_for_a_peer_nothing_moves_in_a_frozen_video(name: str) -> None:
    frame = scene("demo", frames=2, width=160, height=120).frame(0)
    peer = PEERS[name]()
    masks = [peer.apply(frame) for _ in range(4)]
    assert not masks[-1].any()


@pytest.mark.long
def test_the_command_prints_a_row_for_each_method_and_writes_the_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "figures.json"
    flags = [
        "--sequences",
        SMALL,
        "--frames",
        "8",
        "--warm",
        "6",
        "--peers",
        "composite",
        "--json",
        str(path),
    ]
    assert command.main(flags, tmp_path) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines[1:3]] == [ENGINE, "composite"]
    assert lines[2].split()[-1] == "1.00"
    figures = json.loads(path.read_text())[SMALL]
    assert set(figures) == {ENGINE, "composite"}
    assert figures[ENGINE]["stage_ms"]["flow"] > 0


@pytest.mark.long
def test_several_sequences_are_followed_by_the_means_of_each_method() -> None:
    peers = {"composite": PEERS["composite"]}
    measured = {
        name: measure(demo(frames), peers, Config(), frames=6, warm=5)
        for name, frames in (("a", 5), ("b", 6))
    }
    rows = [line.split() for line in methods_table(measured).splitlines()]
    assert [row[:2] for row in rows[-2:]] == [["mean", ENGINE], ["mean", "composite"]]
    for column in range(2, 6):
        values = [float(row[column]) for row in rows if row[1] == "composite"]
        assert values[-1] == pytest.approx(np.mean(values[:-1]), abs=0.11)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--peers", "yolo"], "composite"),
        (["--frames", "5", "--warm", "5"], "give more"),
        (["--measure", "speed"], "births"),
        (["--measure", ","], "names nothing"),
        (["--sequences", "nowhere"], "--data"),
        (["--set", "flow.scal=1"], "flow"),
    ],
)
def test_wrong_usage_ends_with_status_2_and_says_what_to_do(
    flags: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("MLBS_DATA", raising=False)
    with pytest.raises(SystemExit) as ended:
        command.main(flags, tmp_path)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
