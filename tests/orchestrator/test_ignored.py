"""``--ignore``: masks and polygons of what is fixed in the picture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mlbs_actors.errors import ConfigError
from orchestrator.command import run_command
from orchestrator.ignored import read_ignored


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
def test_a_bad_file_is_refused_with_what_to_write(tmp_path: Path, content: str, words: str) -> None:
    (tmp_path / "file").write_text(content)
    with pytest.raises(ConfigError, match=words):
        read_ignored([str(tmp_path / "file")])


def test_missing_files_and_second_files_of_a_stream_are_refused(tmp_path: Path) -> None:
    (tmp_path / "corner.txt").write_text("0,0,1,0,0,1")
    with pytest.raises(ConfigError, match=r"nowhere\.png cannot be read: No such file"):
        read_ignored([str(tmp_path / "nowhere.png")])
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
