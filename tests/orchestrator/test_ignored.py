"""``--ignore``: masks and polygons of what is fixed in the picture."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator import command
from orchestrator.command import run_command
from orchestrator.ignored import read_ignored
from orchestrator.options import recorded
from orchestrator.run.run_description import describe_run
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_list import read_stream_list


def test_a_picture_and_polygons_become_masks_of_their_streams(tmp_path: Path) -> None:
    mask = np.zeros((30, 40), np.uint8)
    mask[20:] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    (tmp_path / "corner.txt").write_text("# the clock\n0,0, 0.5,0, 0.5,0.25, 0,0.25\n\n")
    ignored = read_ignored([str(tmp_path / "mask.png"), f"gate={tmp_path / 'corner.txt'}"])
    for_all, of_gate = ignored.mask_of("yard"), ignored.mask_of("gate")
    assert for_all is not None
    np.testing.assert_array_equal(for_all, mask > 0)
    assert of_gate is not None
    height, width = of_gate.shape
    assert of_gate[: height // 4, : width // 2].all()
    assert of_gate.mean() == pytest.approx(0.125, abs=0.001)
    assert ignored.streams == {"gate"}
    assert read_ignored(list(ignored.digests)).digests == ignored.digests


def test_a_stream_without_a_file_has_no_mask(tmp_path: Path) -> None:
    (tmp_path / "corner.txt").write_text("0,0,1,0,0,1")
    assert read_ignored([f"gate={tmp_path / 'corner.txt'}"]).mask_of("yard") is None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("0,0,1,0", "neither a picture nor a list of polygons"),
        ("0,0,1,0,0.5,2", "from 0 to 1"),
        ("a,b,c,d,e,f", "neither a picture"),
        ("-0,-0,1,0,1,1,0,1", "covers the whole picture"),
    ],
)
def test_of_a_bad_file_it_is_said_what_to_write(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "file").write_text(content)
    [fault] = read_ignored([str(tmp_path / "file")]).faults
    assert re.search(words, fault)


def test_a_missing_file_ignores_nothing_in_its_stream_and_leaves_the_others_as_they_are(
    tmp_path: Path,
) -> None:
    (tmp_path / "corner.txt").write_text("0,0,1,0,0,1")
    ignored = read_ignored([str(tmp_path / "corner.txt"), f"gate={tmp_path / 'nowhere.png'}"])
    assert ["nowhere.png cannot be read: No such file" in fault for fault in ignored.faults] == [True]
    of_gate, for_all = ignored.mask_of("gate"), ignored.mask_of("yard")
    assert of_gate is not None
    assert not of_gate.any()
    assert for_all is not None
    assert for_all.any()


def test_second_files_of_a_stream_are_refused(tmp_path: Path) -> None:
    (tmp_path / "corner.txt").write_text("0,0,1,0,0,1")
    with pytest.raises(ConfigError, match="two files for the stream 'gate'"):
        read_ignored([f"gate={tmp_path / 'corner.txt'}"] * 2)


def test_a_stream_that_is_not_in_the_list_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "corner.txt").write_text("0,0,1,0,0,1")
    (tmp_path / "list.txt").write_text("gate synthetic:demo?frames=5\n")
    command = ["--streams", str(tmp_path / "list.txt"), "--output", str(tmp_path / "out")]
    assert run_command([*command, "--ignore", f"gat={tmp_path / 'corner.txt'}"]) == 2
    assert "'gat', which is not one of this run" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("flags", "status"), [([], 2), (["--watch", "--resume"], 1)])
def test_a_mask_that_is_gone_ends_a_first_start_but_not_that_of_a_service(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    flags: list[str],
    status: int,
) -> None:
    def no_ray(_: object) -> None:
        raise MlbsError("Streams would start now.")

    monkeypatch.setattr(command, "ray_settings", no_ray)
    listed, output = tmp_path / "list.txt", tmp_path / "out"
    listed.write_text("gate synthetic:demo\n")
    output.mkdir()
    RunFolder(output).create(describe_run(read_stream_list(listed).streams, Config(), recorded({})))
    words = ["--streams", str(listed), "--output", str(output), "--ignore", f"gate={tmp_path / 'gone.png'}"]
    assert run_command([*words, *flags]) == status
    said = capsys.readouterr().err
    assert "gone.png cannot be read: No such file" in said
    assert ("nothing is ignored there" in said, "would start now" in said) == (status == 1, status == 1)
