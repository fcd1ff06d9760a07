"""The injector of faults: its table tells the truth, and a real run survives a kill."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mlbs_actors.actors.stream_protocol import SourceFrame
from mlbs_actors.messages import Segmentation
from orchestrator.chaos import command
from orchestrator.chaos.faults import FAULTS, Fault, Place
from orchestrator.chaos.observed_run import NotHeldError, content
from orchestrator.sinks.record import StreamRecord


def write(folder: Path, frames: int) -> None:
    record = StreamRecord(folder, folder.name, frozenset({"masks", "parquet"}))
    empty = np.zeros((8, 8), np.uint8)
    for index in range(frames):
        labels = empty.astype(np.uint16)
        result = Segmentation(index, labels, empty, empty.view(np.int8), (), (0.0, 0.0), 0, {"cut": index})
        record.write(result, SourceFrame(index, None, index / 25, f"{index:05d}"))
    record.close(whole=True)


def test_content_leaves_times_out_and_refuses_what_is_not_complete(tmp_path: Path) -> None:
    write(tmp_path / "a", 40)
    whole = content(tmp_path / "a")
    assert len(whole["masks"]) == len(whole["frames"]) == 40
    assert not any("ms_" in key for row in whole["frames"] for key in row)
    mask = tmp_path / "a/masks/00007.png"
    kept = mask.read_bytes()
    mask.unlink()
    with pytest.raises(NotHeldError, match="39 masks for 40"):
        content(tmp_path / "a")
    mask.write_bytes(kept)
    log = tmp_path / "a/commits.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    for damaged in (lines[:1], lines[1:]):
        log.write_text("".join(damaged))
        with pytest.raises(NotHeldError, match="committed frames"):
            content(tmp_path / "a")
    log.write_text("".join(lines))
    (tmp_path / "a/frames-00000064.parquet").write_bytes(
        (tmp_path / "a/frames-00000032.parquet").read_bytes()
    )
    with pytest.raises(NotHeldError, match="committed frames"):
        content(tmp_path / "a")
    assert [json.loads(line)["last"] for line in lines] == [7, 31, 39]


def test_the_table_says_which_seeds_were_held_and_why_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def held(place: Place) -> float:
        return float(place.random.uniform(1, 2))

    def not_always(place: Place) -> None:
        if place.folder.name.endswith("1"):
            raise NotHeldError("a frame is missing")

    def undisturbed(folder: Path) -> dict[str, Any]:
        return {}

    monkeypatch.setattr(command, "FAULTS", (Fault("1", "one", held), Fault("2 3", "two", not_always)))
    monkeypatch.setattr(command, "undisturbed", undisturbed)
    assert command.main([]) == 1
    rows = capsys.readouterr().out.splitlines()
    assert rows[1].split()[:3] == ["1", "one", "3/3"]
    assert rows[2].split() == ["2", "3", "two", "2/3"]
    assert rows[3] == "2 3 two, seed 1: a frame is missing"
    assert command.main(["--faults", "1,9"]) == 0
    assert command.main(["--faults", "9"]) == 2


def test_every_number_of_a_fault_is_one_of_the_list() -> None:
    assert {int(number) for fault in FAULTS for number in fault.number.split()} <= set(range(1, 29))


@pytest.mark.long
@pytest.mark.ray
def test_a_run_survives_the_kill_of_its_driver() -> None:
    assert command.main(["--faults", "19", "--seeds", "1"]) == 0
