"""What the README promises, on the real sequences that MLBS_DATA names (not part of the repository)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from statistics import mean

import cv2
import numpy as np
import pytest
from PIL import Image

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.scenes.synthetic import scene
from orchestrator.evaluation.metrics import object_level, two_label
from orchestrator.evaluation.overlap import count_overlap

SEQUENCES = ("cars1", "cars2", "cars4", "cars5", "people1")
NO_DATA = "MLBS_DATA names no folder of real sequences"


@pytest.fixture
def sequences() -> Path:
    folder = Path(os.environ.get("MLBS_DATA", "")) / "mlbs"
    if not folder.is_dir():
        pytest.skip(NO_DATA)
    return folder.absolute()


@pytest.mark.long
@pytest.mark.data
@pytest.mark.timeout(900)
def test_the_five_sequences_in_one_run_have_a_good_mask_for_every_frame(
    sequences: Path, tmp_path: Path
) -> None:
    together, alone = tmp_path / "together.txt", tmp_path / "alone.txt"
    together.write_text("".join(f"{name} {sequences / name / 'frames'}\n" for name in SEQUENCES))
    alone.write_text(f"cars2 {sequences / 'cars2' / 'frames'}\n")
    for streams in (together, alone):
        command = [
            sys.executable,
            "-m",
            "orchestrator",
            "--streams",
            streams,
            "--output",
            tmp_path / streams.stem,
        ]
        subprocess.run([str(part) for part in command], check=True, capture_output=True)

    two_label_f, object_f = [], []
    for name in SEQUENCES:
        overlaps = []
        for truth in sorted((sequences / name / "gt").glob("*.png")):
            labels = np.asarray(Image.open(tmp_path / "together" / name / "masks" / truth.name))
            overlaps.append(count_overlap(labels, np.asarray(Image.open(truth))))
        assert len(overlaps) == len(list((sequences / name / "frames").iterdir()))
        two_label_f.append(mean(two_label(overlap).f for overlap in overlaps))
        object_f.append(mean(object_level(overlap).f for overlap in overlaps))
    assert mean(two_label_f) >= 0.915
    assert mean(object_f) >= 0.88

    subtractor, results = MultilayerSubtractor(), []
    frames = sorted((sequences / "cars2" / "frames").iterdir())
    for frame in frames:
        picture = cv2.imread(str(frame))
        assert picture is not None
        results += subtractor.apply(picture)
    results += subtractor.flush()
    for frame, result in zip(frames, results, strict=True):
        one, other = (
            tmp_path / run / "cars2" / "masks" / f"{frame.stem}.png" for run in ("together", "alone")
        )
        assert one.read_bytes() == other.read_bytes()
        np.testing.assert_array_equal(np.asarray(Image.open(one)), result.labels)


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["no-mover", "static-empty"])
def test_where_nothing_moves_there_is_no_layer_in_500_frames(name: str) -> None:
    nothing_moves = scene(name, frames=500)
    subtractor = MultilayerSubtractor()
    for index in range(len(nothing_moves)):
        for result in subtractor.apply(nothing_moves.frame(index)):
            assert not result.labels.any(), f"frame {result.frame_index}"
