"""The record of a camera in segments: written, killed, gone on with, merged, and read."""

from __future__ import annotations

import errno
import io
import os
import tarfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image
from record_fakes import frame, segmentation
from segment_fakes import SAVE, Camera

from mlbs_actors.errors import SinkError
from mlbs_actors.record.commits import read_commits
from mlbs_actors.record.record_tables import read_rows
from orchestrator.evaluation.labelling import run_label_maps
from orchestrator.evaluation.sequences import FolderSequence
from orchestrator.report.history import read_history
from orchestrator.report.pictures import overlay_strip
from orchestrator.sinks.overlay import overlays
from orchestrator.sinks.record import StreamRecord, recorded_frames
from orchestrator.storage import commit_log, durable_files, picture_archive
from orchestrator.storage.segments import segment_folders

TABLES = frozenset({"masks", "parquet"})


def masks(folder: Path) -> dict[str, bytes]:
    """What others read of the masks."""
    found: dict[str, bytes] = {}
    for path in sorted(folder.glob("*/masks.tar")):
        with tarfile.open(path) as archive:
            for entry in archive:
                content = archive.extractfile(entry)
                assert content is not None
                assert entry.name not in found
                found[entry.name] = content.read()
    return found


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of the same frames without segments."""
    folder = tmp_path_factory.mktemp("plain") / "gate"
    record = StreamRecord(folder, "gate", SAVE)
    for index in range(250):
        record.write(segmentation(index, 3, *([5] if index // 10 % 2 else [])), frame(index))
    record.close(whole=True)
    return folder


def expect_the_same(folder: Path, plain: Path) -> None:
    """Every picture and every row counts once."""
    assert masks(folder) == {path.name: path.read_bytes() for path in (plain / "masks").iterdir()}
    assert [*read_rows(folder)] == [*read_rows(plain)]
    assert (folder / "objects.csv").read_bytes() == (plain / "objects.csv").read_bytes()


def test_segments_hold_what_a_record_without_them_holds(tmp_path: Path, plain: Path) -> None:
    camera = Camera(tmp_path / "gate")
    camera.send(250)
    camera.record.close(whole=True)
    folders = segment_folders(tmp_path / "gate")
    assert [path.name for path in folders] == ["20261127T140000Z", "20261127T140010Z", "20261127T140020Z"]
    expect_the_same(tmp_path / "gate", plain)
    # A closed segment has one file of each kind, and the log one line.
    names = sorted(path.name for path in folders[1].iterdir())
    assert names == ["cutouts.tar", "frames.parquet", "layers.parquet", "masks.tar", "overlay-00000120.mp4"]
    assert [one.first for one in read_commits(tmp_path / "gate")][:3] == [0, 100, 200]
    labels = np.asarray(Image.open(io.BytesIO(masks(tmp_path / "gate")["img010.png"])))
    np.testing.assert_array_equal(labels, segmentation(10, 3, 5).labels)
    # Evaluation reads the archives, by the frames' names.
    truth = tmp_path / "truth"
    truth.mkdir()
    for name in ("img010.png", "img230.png"):
        (truth / name).write_bytes((plain / "masks" / name).read_bytes())
    sequence = FolderSequence("gate", truth, None)
    scored = dict(run_label_maps(sequence, tmp_path / "gate/masks"))
    np.testing.assert_array_equal(scored[1], segmentation(230, 3, 5).labels)


class Killed(BaseException):
    """What no code of the record may catch."""


def test_a_record_killed_at_any_step_goes_on_to_the_same_content(
    tmp_path: Path, plain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = 0

    def dies(function: Callable[..., Any]) -> Callable[..., Any]:
        def step(*given: Any, **named: Any) -> Any:
            nonlocal left
            left -= 1
            if left == 0:
                raise Killed
            return function(*given, **named)

        return step

    def torn(path: Path, length: int, pictures: Iterable[tuple[str, bytes, int]]) -> int:
        with path.open("ab") as archive:
            archive.write(b"half a picture")
        return int(append(path, length, pictures))

    append = dies(picture_archive.append_pictures)
    monkeypatch.setattr("orchestrator.storage.segments.append_pictures", torn)
    monkeypatch.setattr(durable_files, "_sync", dies(durable_files._sync))
    monkeypatch.setattr(commit_log, "append_line", dies(durable_files.append_line))
    monkeypatch.setattr(Path, "replace", dies(Path.replace))
    monkeypatch.setattr(Path, "unlink", dies(Path.unlink))
    monkeypatch.setattr(Path, "mkdir", dies(Path.mkdir))
    kills = 0
    for number in range(1, 150, 12):
        folder = tmp_path / str(number) / "gate"
        folder.parent.mkdir()
        left = number
        try:
            camera = Camera(folder, TABLES)
            camera.send(130)
            camera.record.close(whole=False)
        except Killed:
            kills += 1
        left = 0
        counted = recorded_frames(folder)
        again = Camera(folder, TABLES)
        assert again.rows == counted
        again.send(250)
        again.record.close(whole=True)
        expect_the_same(folder, plain)
        assert not [*folder.rglob("*.part")]
    assert kills > 9


def test_the_overlay_of_a_killed_record_can_be_played(tmp_path: Path) -> None:
    camera = Camera(tmp_path / "gate")
    camera.send(190)  # and killed
    parts = overlays(tmp_path / "gate")
    assert [first for first, _ in parts] == [0, 120]
    again = Camera(tmp_path / "gate")
    again.send(250)
    again.record.close(whole=False)
    shown = {}
    for first, path in overlays(tmp_path / "gate"):
        with av.open(str(path)) as container:
            shown[first] = len([*container.decode(video=0)])
    assert shown.keys() == {0, 120, 180, 220}
    assert shown[0] == 120
    assert shown[120] >= 64  # of 70: whole fragments of 32
    assert shown[220] == 30
    history = read_history(tmp_path / "gate")
    assert history is not None
    strip = overlay_strip(tmp_path / "gate", history, 8)
    assert [picture.frame for picture in strip] == [0, 34, 68, 102, 137, 171, 205, 239]


def test_a_stream_that_comes_back_the_next_day_begins_another_segment(tmp_path: Path) -> None:
    camera = Camera(tmp_path / "gate", TABLES)
    camera.send(40)
    again = Camera(tmp_path / "gate", TABLES, rate=0.0005)
    again.send(60)
    names = [path.name for path in segment_folders(tmp_path / "gate")]
    assert names == ["20261127T140000Z", "20261128T224640Z"]


def test_what_was_provisional_is_replaced(tmp_path: Path, plain: Path) -> None:
    camera = Camera(tmp_path / "gate", TABLES)
    camera.send(100)
    camera.record.provisional()
    camera.send(115)
    camera.record.close(whole=False)
    assert len(masks(tmp_path / "gate")) == 115
    again = Camera(tmp_path / "gate", TABLES)
    assert again.rows == 100
    again.send(250)
    again.record.close(whole=True)
    expect_the_same(tmp_path / "gate", plain)


def test_a_full_disk_fails_the_stream_and_loses_nothing_that_was_committed(
    tmp_path: Path, plain: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Camera(tmp_path / "gate", TABLES)
    camera.send(130)

    def full(path: Path, length: int, pictures: Iterable[tuple[str, bytes, int]]) -> int:
        with path.open("ab") as archive:
            archive.write(b"half a picture")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("orchestrator.storage.segments.append_pictures", full)
        with pytest.raises(SinkError, match="No space left on device"):
            camera.send(250)
    camera.record.close(whole=False)
    assert recorded_frames(tmp_path / "gate") == 120
    again = Camera(tmp_path / "gate", TABLES)
    again.send(250)
    again.record.close(whole=True)
    expect_the_same(tmp_path / "gate", plain)


def all_masks(folder: Path) -> dict[str, bytes]:
    """Those in archives, and those in files of their own."""
    return masks(folder) | {path.name: path.read_bytes() for path in folder.glob("masks/*.png")}


@pytest.mark.parametrize("lengths", [(10, 3), (None, 5, None, 5)])
def test_a_record_may_begin_or_end_to_be_in_segments_whenever_it_is_opened(
    tmp_path: Path, plain: Path, lengths: tuple[int | None, ...]
) -> None:
    for number, seconds in enumerate(lengths, start=1):
        camera = Camera(tmp_path / "gate", seconds=seconds)
        camera.send(250 * number // len(lengths) // 20 * 20)
        camera.record.close(whole=False)
    camera = Camera(tmp_path / "gate", seconds=lengths[-1])
    camera.send(250)
    camera.record.close(whole=True)
    assert all_masks(tmp_path / "gate") == {
        path.name: path.read_bytes() for path in (plain / "masks").iterdir()
    }
    assert [*read_rows(tmp_path / "gate")] == [*read_rows(plain)]
    assert (tmp_path / "gate/objects.csv").read_bytes() == (plain / "objects.csv").read_bytes()
