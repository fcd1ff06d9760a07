"""Overlays drawn anew from a record and its source."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path

import av
import numpy as np
import pytest
from record_fakes import HEIGHT, WIDTH, segmentation, write_run

from mlbs_actors.config import Config
from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame
from orchestrator.export.__main__ import main
from orchestrator.export.replay import with_pictures
from orchestrator.options import recorded
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.private_record import PrivateRecord
from orchestrator.sinks.record import StreamRecord
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader

# pycocotools decodes through an __array__ method that NumPy 2 finds outdated.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

SAVED = frozenset({"parquet", "overlay"})
SCENE = f"synthetic:demo?frames=20&width={WIDTH}&height={HEIGHT}"


def record(run: Path, sources: dict[str, str], *, private: bool = False) -> None:
    """A run over these sources; what cannot be read is recorded as the scene."""
    streams = []
    for line, (name, uri) in enumerate(sources.items(), start=1):
        reader = open_reader(parse_address(SCENE, run))
        open_record = partial(StreamRecord, run / name, name, SAVED)
        written = PrivateRecord(open_record) if private else open_record()
        while isinstance(frame := reader.read(), SourceFrame):
            written.write(segmentation(frame.index, 3, 5), frame)
        written.close(whole=True)
        streams.append(ListedStream(name, parse_address(uri, run), line))
    RunFolder(run).create(describe_run(streams, Config(), recorded({"save": SAVED})))


def pictures(path: Path) -> tuple[list[float | None], Array]:
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
        return [frame.time for frame in frames], np.stack(
            [frame.to_ndarray(format="rgb24") for frame in frames]
        )


def test_an_overlay_drawn_anew_is_the_one_of_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", {"yard": SCENE, "gate": "rtsp://bob:hunter2@cam/x"})
    assert main(["overlay", str(tmp_path / "run"), str(tmp_path / "out")]) == 0
    assert [path.name for path in (tmp_path / "out").glob("*.mp4")] == ["yard.mp4"]
    times, drawn = pictures(tmp_path / "out/yard.mp4")
    times_of_run, drawn_in_run = pictures(tmp_path / "run/yard/overlay.mp4")
    assert times == times_of_run
    np.testing.assert_array_equal(drawn, drawn_in_run)
    said = capsys.readouterr().err
    assert "stream 'gate' gave 0 of its 20 frames" in said
    assert "hunter2" not in said


def test_a_run_of_which_nothing_can_be_read_again_is_refused_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", {"moved": "/nowhere/film.mp4"})
    assert main(["overlay", str(tmp_path / "run"), str(tmp_path / "out")]) == 2
    assert "'moved' gave 0 of its 20 frames" in capsys.readouterr().err
    shutil.rmtree(tmp_path / "run")
    write_run(tmp_path / "run", [StreamState("gone", "failed")])
    assert main(["overlay", str(tmp_path / "run"), str(tmp_path / "out")]) == 2
    assert "no label maps" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_pictures_of_another_size_than_recorded_are_not_drawn_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "run", {"yard": SCENE.replace(str(WIDTH), str(2 * WIDTH))})
    assert main(["overlay", str(tmp_path / "run"), str(tmp_path / "out")]) == 2
    assert "in the size recorded" in capsys.readouterr().err


def test_the_overlay_of_a_private_run_hides_the_same_when_drawn_anew(tmp_path: Path) -> None:
    run = tmp_path / "run"
    record(run, {"yard": SCENE}, private=True)
    described = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(described | {"private": True}))
    assert main(["overlay", str(run), str(tmp_path / "out")]) == 0
    np.testing.assert_array_equal(
        pictures(tmp_path / "out/yard.mp4")[1], pictures(run / "yard/overlay.mp4")[1]
    )
    record(tmp_path / "plain", {"yard": SCENE})
    assert (pictures(run / "yard/overlay.mp4")[1] != pictures(tmp_path / "plain/yard/overlay.mp4")[1]).any()


def test_pictures_that_are_read_again_are_private_from_the_first_frame_on(tmp_path: Path) -> None:
    record(tmp_path / "run", {"yard": SCENE})
    stream = tmp_path / "run/yard"
    open_pairs = partial(with_pictures, source=SCENE)
    plain = list(open_pairs(stream))
    private = list(open_pairs(stream, private=True))
    assert [frame.index for frame, _ in private] == [frame.index for frame, _ in plain]
    for (frame, before), (_, after) in zip(plain, private, strict=True):
        assert before is not None
        assert after is not None
        changed = (before != after).any(axis=2)
        assert changed[frame.labels() > 0].mean() > 0.9
