"""Differences between methods over sequences, and the engine with other values of its parameters."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from evaluation_fakes import BrightSubtractor, write_bright_sequence

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from orchestrator.evaluation import scoring
from orchestrator.evaluation.command import main
from orchestrator.evaluation.comparison import difference_of
from orchestrator.evaluation.sweep import sweep_variants


def test_the_interval_is_that_of_the_means_of_sequences_drawn_again() -> None:
    values = [3.0, -1.0, 4.0, 1.0, -5.0, 9.0]
    figures = {str(place): 50 + value for place, value in enumerate(values)}
    one = difference_of(figures, dict.fromkeys(figures, 50.0))
    drawn = np.random.default_rng(99)
    means = sorted(math.fsum(drawn.choice(values, len(values))) / len(values) for _ in range(20_000))
    assert one.mean == pytest.approx(11 / 6)
    assert one.low == pytest.approx(means[500], abs=0.2)
    assert one.high == pytest.approx(means[-500], abs=0.2)
    assert (one.higher, one.sequences) == (4, 6)
    assert one == difference_of(figures, dict.fromkeys(figures, 50.0))  # always the same draws


def test_sequences_of_one_method_alone_do_not_count() -> None:
    one = difference_of({"a": 3.0, "b": 9.0}, {"a": 1.0, "c": 0.0})
    assert (one.mean, one.higher, one.sequences) == (2.0, 1, 1)
    assert math.isnan(one.low)
    assert math.isnan(difference_of({}, {"a": 1.0}).mean)


def test_a_sweep_is_every_combination_but_the_default() -> None:
    rows = sweep_variants(["posterior.prior=0.5"], ["layers.lookahead=0,2", "posterior.motion=0.25,0.75"])
    assert [row.name for row in rows] == [
        "default",
        *(f"layers.lookahead={a} posterior.motion={b}" for a in (0, 2) for b in (0.25, 0.75)),
    ]
    assert rows[-1].overrides == ("posterior.prior=0.5", "layers.lookahead=2", "posterior.motion=0.75")
    assert [row.name for row in sweep_variants([], ["layers.lookahead=0,2"])] == [
        "default",
        "layers.lookahead=2",
    ]


@pytest.mark.parametrize(
    "text", ["layers.lookahead", "layers.lookahead=1,,2", "no.such=1", "layers.lookahead=x"]
)
def test_a_sweep_of_what_is_no_parameter_is_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        sweep_variants([], [text])


def test_a_sweep_is_a_table_with_differences_from_the_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one", "two"):
        write_bright_sequence(tmp_path / "data" / name)

    def engine(config: Config, flow: object, tracks: object) -> BrightSubtractor:
        return BrightSubtractor(blind=config.layers.lookahead > 2)

    monkeypatch.setattr(scoring, "MultilayerSubtractor", engine)
    arguments = ["--data", f"{tmp_path}/data", "--jobs", "1", "--sweep", "layers.lookahead=2,4"]
    files = ["--json", f"{tmp_path}/json", "--summary", f"{tmp_path}/summary"]
    assert main([*arguments, "--columns", "j", *files]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines] == [
        ["parameters", "j", "Δ", "95", "%"],
        ["default", "100.0"],
        ["layers.lookahead=2", "100.0", "+0.0", "+0.0", "…", "+0.0"],
        ["layers.lookahead=4", "0.0", "-100.0", "-100.0", "…", "-100.0"],
    ]
    record = json.loads((tmp_path / "json").read_text())
    assert record["differences"]["layers.lookahead=4"]["j"]["mean"] == -100
    assert (tmp_path / "summary").read_text().splitlines()[-1].startswith("layers.lookahead=4,two,0.000")
