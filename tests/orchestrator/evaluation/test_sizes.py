"""The table of working sizes: the engine sees other sizes, the scores are of the truth's own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from evaluation_fakes import BrightSubtractor, write_bright_sequence

from mlbs_actors.messages import Array, Segmentation
from orchestrator.evaluation import command, scoring
from orchestrator.evaluation.command import main
from orchestrator.evaluation.labelling import ResizingSubtractor


class SizeRecorder(BrightSubtractor):
    """Remembers the sizes of the frames."""

    shapes: list[tuple[int, ...]]

    def apply(self, frame: Array) -> list[Segmentation]:
        self.shapes.append(frame.shape[:2])
        return super().apply(frame)


def test_each_size_is_a_row_scored_in_the_size_of_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bright_sequence(tmp_path / "data" / "clip")  # 24×16 px
    SizeRecorder.shapes = []
    monkeypatch.setattr(scoring, "MultilayerSubtractor", lambda config, flow, tracks: SizeRecorder())
    monkeypatch.setattr(command, "warm_engine", lambda: None)
    figures = tmp_path / "figures.json"
    arguments = ["--sizes", "96,72", "--data", f"{tmp_path}/data", "--jobs", "1", "--json", str(figures)]
    assert main(arguments) == 0
    heading, *lines = capsys.readouterr().out.splitlines()
    assert [line[:11].strip() for line in lines] == ["as it is", "72 px", "96 px"]
    assert heading.split()[2:4] == ["two_label_f", "j&f"]
    assert dict.fromkeys(SizeRecorder.shapes) == dict.fromkeys([(16, 24), (48, 72), (64, 96)])
    rows = json.loads(figures.read_text())["rows"]
    assert [row["mean"]["two_label_f"] for row in rows] == [100, 100, 100]
    assert all(row["mean"]["cpu_ms"] > 0 for row in rows)
    assert lines[0].split()[-1] == "1.00"


def test_a_label_map_of_a_smaller_picture_is_brought_back_to_size() -> None:
    frame = np.zeros((90, 160, 3), np.uint8)
    frame[30:60, 40:80] = 255
    (result,) = ResizingSubtractor(BrightSubtractor(), 80).apply(frame)
    assert np.array_equal(result.labels == 1, frame[..., 0] == 255)


@pytest.mark.parametrize("sizes", ["", "640,", "big", "32"])
def test_a_size_that_is_none_is_refused(sizes: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--sizes", sizes, "--sequences", "synthetic:demo?frames=3"])
    assert "px, 64 or more each" in capsys.readouterr().err
