"""Streams on a cluster of three nodes, one of which comes late, and one is lost."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.scenes.synthetic import scene

pytestmark = pytest.mark.ray


@pytest.mark.long
def test_streams_go_to_all_nodes_and_those_of_a_lost_one_go_on_with_the_same_label_maps(
    tmp_path: Path,
) -> None:
    program = Path(__file__).parents[2] / "fakes/cluster_program.py"
    ran = subprocess.run(
        [sys.executable, str(program), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=580,
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    outcome = json.loads((tmp_path / "outcome.json").read_text(encoding="utf-8"))
    assert outcome["status"] == 0, outcome
    assert [state[1:] for state in outcome["states"]] == [["done", 120, None]] * 4
    assert sum("takes up to 1 " in one for one in outcome["said"]) == 3
    assert sum("is lost" in one for one in outcome["said"]) == 1
    for number in range(4):
        video = scene("demo", frames=120, seed=number, width=160, height=120)
        subtractor = MultilayerSubtractor()
        results = [one for index in range(120) for one in subtractor.apply(video.frame(index))]
        results += subtractor.flush()
        masks = sorted((tmp_path / f"s{number}" / "masks").glob("*.png"))
        assert len(masks) == 120
        for mask, result in zip(masks, results, strict=True):
            np.testing.assert_array_equal(np.asarray(Image.open(mask)), result.labels)
