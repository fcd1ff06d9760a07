"""What the files of a run hold, found before their turn."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import pytest

from orchestrator.sources import survey
from orchestrator.sources.address import parse_address
from orchestrator.sources.survey import SourceContent, surveying


def test_files_are_known_by_their_stated_length_and_size_or_by_what_is_wrong_with_them(
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
    words = ("a b.mp4", "false.mp4", "gone.mp4", "folder", "synthetic:demo?frames=9&width=80&height=60")
    files = dict(zip("abcde", (parse_address(word, tmp_path) for word in words), strict=True))
    with surveying(files, tmp_path) as looked:
        found = looked.begin(60)
        assert looked.finish() == found
    faults = {name: content.fault for name, content in found.items() if content.fault}
    assert sorted(faults) == ["b", "c"]
    assert str(tmp_path / "false.mp4") in faults["b"]
    assert {name: content for name, content in found.items() if name not in faults} == {
        "a": SourceContent(7, (48, 64)),
        "d": SourceContent(3, (48, 64)),
        "e": SourceContent(9, (60, 80)),
    }


def test_a_survey_that_takes_long_is_ended_with_what_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = json.dumps(["a", asdict(SourceContent(7, (48, 64)))])
    endless = tmp_path / "endless"
    lines = (
        *("#!/bin/sh", f"echo $$ > '{tmp_path}/pid'", f"echo '{answer}'"),
        *("printf '[\"b\", '", "exec sleep infinity"),
    )
    endless.write_text("\n".join(lines))
    endless.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(endless))
    monkeypatch.setattr(survey, "_PATIENCE_SECONDS", 0.05)
    files = {name: parse_address("synthetic:street", tmp_path) for name in "ab"}
    known = {"a": SourceContent(7, (48, 64))}
    with surveying(files, tmp_path) as looked:
        assert looked.begin(0) == known
        assert looked.finish() == known
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_without_files_there_is_nothing_to_look_into(tmp_path: Path) -> None:
    with surveying({}, tmp_path) as looked:
        assert (looked.begin(60), looked.finish()) == ({}, {})
    assert not list(tmp_path.iterdir())
