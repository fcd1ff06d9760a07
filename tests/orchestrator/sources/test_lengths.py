"""The lengths of files that wait for their turn."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from orchestrator.sources.address import parse_address
from orchestrator.sources.lengths import finding_lengths


def found(lengths: Callable[[], dict[str, int]], folder: Path, count: int) -> dict[str, int]:
    """Return the lengths as soon as so many are there."""
    while (folder / "lengths").read_text().count("\n") < count:
        time.sleep(0.01)
    return lengths()


def test_files_whose_number_of_frames_is_stated_are_known_by_it_and_others_are_left_out(
    tmp_path: Path,
) -> None:
    picture = np.zeros((48, 64, 3), np.uint8)
    video = cv2.VideoWriter(str(tmp_path / "a b.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25, (64, 48))
    for _ in range(7):
        video.write(picture)
    video.release()
    (tmp_path / "folder").mkdir()
    for index in range(3):
        cv2.imwrite(str(tmp_path / f"folder/{index}.png"), picture)
    (tmp_path / "false.mp4").write_bytes(b"no video")
    words = ("a b.mp4", "false.mp4", "gone.mp4", "folder", "synthetic:demo?frames=9")
    files = {word: parse_address(word, tmp_path) for word in words}
    with finding_lengths(files, tmp_path) as lengths:
        assert found(lengths, tmp_path, 3) == {"a b.mp4": 7, "folder": 3, "synthetic:demo?frames=9": 9}


def test_a_search_that_takes_long_is_ended_with_what_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = tmp_path / "endless"
    lines = ["#!/bin/sh", "echo $$ > pid", "echo '[\"a\", 7]'", "echo -n '[\"b\", '", "exec sleep infinity"]
    endless.write_text("\n".join(lines))
    endless.chmod(0o700)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "executable", str(endless))
    monkeypatch.setattr("orchestrator.sources.lengths._PATIENCE_SECONDS", 0.05)
    files = {name: parse_address("synthetic:street", tmp_path) for name in "ab"}
    with finding_lengths(files, tmp_path) as lengths:
        assert found(lengths, tmp_path, 1) == {"a": 7}
        assert lengths() == {"a": 7}
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
