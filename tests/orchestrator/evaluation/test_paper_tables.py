"""``scripts/evaluate --paper``: the paper's tables, held against figures worked out by hand or slowly."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evaluation_fakes import BrightSubtractor, write_bright_sequence

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array
from orchestrator.evaluation import command, scoring
from orchestrator.evaluation.command import main
from orchestrator.evaluation.datasets import open_sequence
from orchestrator.evaluation.labelling import EngineLabelling
from orchestrator.evaluation.paper_tables import (
    Table,
    moving_objects_table,
    multi_label_table,
    paper_tables,
    time_table,
    two_label_table,
)
from orchestrator.evaluation.published_figures import (
    METHODS,
    SEQUENCES,
    STAGES,
    missing_sequences,
    paper_sequences,
)
from orchestrator.evaluation.scoring import SequenceResult, score_sequence
from orchestrator.evaluation.sequence_scorer import SequenceScorer

# Object 1 has 4 px, object 2 has 2 px. Label 5 finds 3 px of object 1 (P 1, R 3/4, F 6/7), label 6 one px of
# object 2 and one px of background (P = R = F = 1/2), label 7 is one px of background (P 1, R 0, F 0).
TRUTH = np.array([[1, 1, 1, 1, 2, 2, 0, 0, 0, 0]], np.uint8)
LABELS = np.array([[5, 5, 5, 0, 6, 0, 6, 7, 0, 0]], np.uint16)
PERFECT = TRUTH.astype(np.uint16)


def scored(name: str, label_maps: list[Array], truth: Array = TRUTH) -> SequenceResult:
    """A sequence whose every frame has the same truth, labelled with these maps."""
    scorer = SequenceScorer()
    for index, labels in enumerate(label_maps):
        scorer.add(index, labels, truth)
    return SequenceResult(name, scorer.score())


def row_of(table: Table, *begin: str) -> list[str]:
    """What follows the first cells of the only row that begins with these."""
    (row,) = (row for row in table.rows if row[: len(begin)] == begin)
    return list(row[len(begin) :])


def slow_multi_label(labels: Array, truth: Array) -> tuple[float, float, float]:
    """P, R and F of one frame by the paper's text: all assignments tried, all pixels counted."""
    objects = sorted(set(truth.flat) - {0})
    found = sorted(set(labels.flat) - {0})

    def agreement(label: int | None, truth_id: int | None) -> tuple[float, float, float]:
        both = sum(int(x == label and y == truth_id) for x, y in zip(labels.flat, truth.flat, strict=True))
        if both == 0:
            return 1.0, 0.0, 0.0
        precision = both / sum(int(x == label) for x in labels.flat)
        recall = both / sum(int(y == truth_id) for y in truth.flat)
        return precision, recall, 2 * precision * recall / (precision + recall)

    best: list[tuple[float, float, float]] = []
    for order in itertools.permutations([*found, *[None] * len(objects)], len(objects)):
        pairs = [agreement(label, truth_id) for label, truth_id in zip(order, objects, strict=True)]
        # A pair that has nothing in common is a lost object and a surplus region.
        matched = sum(pair[2] > 0 for pair in pairs)
        regions = [*pairs, *[(1.0, 0.0, 0.0)] * (len(found) - matched)]
        if not best or sum(f for *_, f in pairs) > sum(f for *_, f in best[: len(objects)]) + 1e-12:
            best = regions
    columns = zip(*best, strict=True)
    precision, recall, f = (sum(values) / len(best) for values in columns)
    return precision, recall, f


# The published figures


def test_the_published_means_are_those_of_the_ten_sequences() -> None:
    means = [np.mean([one.two_label_f[method] for one in SEQUENCES]) for method in range(len(METHODS))]
    np.testing.assert_allclose(means, [89.86, 83.72, 67.27, 75.36, 75.35, 53.60], atol=0.01)


def test_the_published_times_sum_to_the_published_total() -> None:
    assert sum(one.published_ms for one in STAGES) == 6856


# Which sequences


def test_the_papers_sequences_are_found_by_the_last_part_of_their_names_in_its_order() -> None:
    names = ["bms26/cars10", "davis16/dog", "mlbs/people1", "mlbs/cars2", "cars1"]
    assert paper_sequences(names) == ["cars1", "mlbs/cars2", "mlbs/people1"]
    missing = ["cars3", "cars4", "cars5", "cars6", "cars7", "cars8", "people2"]
    assert missing_sequences(names) == missing


@pytest.mark.parametrize(
    ("names", "words"),
    [(["davis16/dog"], "None of the paper's"), (["a/cars1", "b/cars1"], "a/cars1 and b/cars1")],
)
def test_names_that_leave_no_choice_or_too_much_are_refused(names: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        paper_sequences(names)


def test_a_sequence_that_is_missing_has_a_dash_and_is_named() -> None:
    results = [scored("mlbs/cars1", [LABELS]), scored("mlbs/cars5", [PERFECT])]
    table = two_label_table(results)
    assert [row[0] for row in table.rows[:10]] == [one.name for one in SEQUENCES]
    # 4 of 6 px found, 4 of 6 right: F = 2/3.
    assert row_of(table, "cars1")[:2] == ["66.67", "92.04"]
    assert row_of(table, "cars3") == ["-", "93.16", "72.94", "73.57", "41.27", "79.22", "60.91"]
    assert row_of(table, "mean of these 2")[:2] == ["83.33", "89.33"]  # of cars1 and cars5 alone
    assert row_of(table, "mean of all 10")[:2] == ["-", "89.86"]
    last = paper_tables(results).splitlines()[-1]
    assert last == (
        "Sequences of the paper that are not there: "
        "cars2, cars3, cars4, cars6, cars7, cars8, people1, people2."
    )


def test_with_all_ten_there_is_one_mean_and_nothing_missing() -> None:
    results = [scored(one.name, [PERFECT]) for one in SEQUENCES]
    table = two_label_table(results)
    assert len(table.rows) == 11
    assert row_of(table, "mean of these 10")[:2] == ["100.00", "89.86"]
    assert paper_tables(results).splitlines()[-1] == "All ten sequences are there."


def test_a_sequence_that_could_not_be_scored_counts_in_no_mean() -> None:
    results = [scored("cars1", [PERFECT]), SequenceResult("cars2", error="planted")]
    table = two_label_table(results)
    assert row_of(table, "cars2")[0] == "-"
    assert row_of(table, "mean of these 1")[:2] == ["100.00", "92.04"]
    assert row_of(time_table(results), "total") == ["6856", "-", "-"]


# Tables 2 and 3


def test_table_2_takes_the_mean_over_the_sequences_with_so_many_objects() -> None:
    names = {"cars1": LABELS, "people1": PERFECT, "cars5": LABELS}
    table = moving_objects_table([scored(name, [labels]) for name, labels in names.items()])
    assert [row[0] for row in table.rows] == ["1", "1–2", "2", "2–3", "3"]
    one = row_of(table, "1")
    assert one[:2] == ["83.33", "86.71"]  # (2/3 + 1)/2; (92.04 + 81.38)/2
    assert one[-1] == "cars1, people1"
    assert row_of(table, "2") == ["-"] * 8
    assert row_of(table, "3") == ["66.67", "86.62", "81.66", "70.94", "60.44", "74.56", "51.97", "cars5"]


def test_table_3_has_the_figures_worked_out_by_hand_of_ten_frames_and_of_all() -> None:
    # Ten frames as above, then ten perfect ones.
    table = multi_label_table([scored("cars1", [LABELS] * 10 + [PERFECT] * 10)])
    text = [(1 + 1 / 2 + 1) / 3, (3 / 4 + 1 / 2 + 0) / 3, (6 / 7 + 1 / 2 + 0) / 3]
    program = [(1 + 1 / 2) / 2, (3 / 4 + 1 / 2) / 2, 3.125 / 4.0625]
    for who, first_ten in (("ours, paper's text", text), ("ours, authors' code", program)):
        assert row_of(table, "first ten frames", who) == [f"{100 * value:.2f}" for value in first_ten]
        whole = [50 * (value + 1) for value in first_ten]
        assert row_of(table, "all frames", who) == [f"{value:.2f}" for value in whole]
    assert row_of(table, "first ten frames", "MLBS") == ["-", "-", "85.06"]
    assert row_of(table, "all frames", "MLBS") == ["88.60", "85.05", "86.16"]
    assert row_of(table, "all frames", "SLT (offline)") == ["89.51", "78.24", "82.00"]


def test_table_3_equals_a_slow_computation_on_random_maps() -> None:
    random = np.random.default_rng(7)
    truth = random.integers(0, 3, (4, 5)).astype(np.uint8)
    truth.flat[:2] = 1, 2  # both objects are there
    maps = [random.integers(0, 4, truth.shape).astype(np.uint16) for _ in range(12)]
    table = multi_label_table([scored("cars2", maps, truth)])
    for frames, chosen in (("first ten frames", maps[:10]), ("all frames", maps)):
        expected = np.mean([slow_multi_label(labels, truth) for labels in chosen], axis=0)
        shown = row_of(table, frames, "ours, paper's text")
        np.testing.assert_allclose([float(cell) for cell in shown], 100 * expected, atol=0.01)


# Table 4


def test_table_4_sums_our_stages_by_the_papers() -> None:
    times = {
        "flow": 3.0, "tracking": 1.0, "affinity": 0.5, "clustering": 0.25, "gabp": 2.0, "posterior": 4.0,
        "fusion": 1.0, "cut": 2.0, "cleaning": 0.5, "update": 0.75,
    }  # fmt: skip
    slow = {stage: 3 * time for stage, time in times.items()}
    results = [
        replace(scored("mlbs/cars1", [PERFECT]), stage_ms=times, ms_per_frame=20.0),
        replace(scored("mlbs/cars2", [PERFECT]), stage_ms=slow, ms_per_frame=60.0),
    ]
    table = time_table(results)
    assert table.rows == (
        ("clustering", "1109", "1.8", "3.5"),
        ("motion estimation", "3675", "2", "4"),
        ("model propagation", "144", "4", "8"),
        ("graph cut", "1369", "3.5", "7"),
        ("model update", "559", "0.8", "1.5"),
        ("total", "6856", "12", "24"),
        ("optical flow", "-", "3", "6"),
        ("everything, in one process", "-", "20", "40"),
    )
    assert "  graph cut = fusion + cut + cleaning (with shadows, specks and holes)" in table.notes


def test_a_stage_that_no_table_knows_is_shown_and_not_lost() -> None:
    result = replace(scored("cars1", [PERFECT]), stage_ms={"cut": 2.0, "newfangled": 5.0})
    assert row_of(time_table([result]), "newfangled") == ["-", "5", "5"]


def test_every_stage_of_the_engine_has_a_home() -> None:
    sequence = open_sequence("synthetic:crossing?frames=8&width=96&height=72", None)
    labelling = EngineLabelling(sequence, MultilayerSubtractor())
    result = score_sequence(sequence, labelling)
    assert result.score is not None
    known = {stage for one in STAGES for stage in one.stages} | {"flow"}
    assert set(labelling.stage_ms) == known


# The command


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two of the paper's sequences and one that is not; the engine is one that sees at once."""
    for name in ("mlbs/cars1", "mlbs/cars4", "davis/dog"):
        write_bright_sequence(tmp_path / "data" / name)
    monkeypatch.setattr(scoring, "MultilayerSubtractor", lambda config, flow, tracks: BrightSubtractor())
    monkeypatch.setattr(command, "warm_engine", lambda: None)
    return tmp_path / "data"


def test_the_command_prints_the_four_tables_of_the_sequences_that_are_there(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    assert main(["--paper", "--data", str(data), "--jobs", "1", "--json", str(figures)]) == 0
    printed = capsys.readouterr().out
    lines = printed.splitlines()
    titles = [line.partition(".")[0] for line in lines if line.startswith("Table")]
    assert titles == ["Table 1", "Table 2", "Table 3", "Table 4"]
    assert next(line for line in lines if line.startswith("cars1")).split()[:3] == [
        "cars1",
        "100.00",
        "92.04",
    ]
    assert "dog" not in printed
    assert "are not there: cars2, cars3, cars5, cars6, cars7, cars8, people1, people2." in lines[-1]
    assert list(json.loads(figures.read_text())["sequences"]) == ["mlbs/cars1", "mlbs/cars4"]


def test_its_parameters_and_sequences_are_those_of_the_ordinary_evaluation(
    data: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    configs: list[Config] = []

    def engine(config: Config, flow: object, tracks: object) -> BrightSubtractor:
        configs.append(config)
        return BrightSubtractor(blind=True)

    monkeypatch.setattr(scoring, "MultilayerSubtractor", engine)
    arguments = ["--paper", "--data", str(data), "--sequences", "mlbs/cars4", "--jobs", "1"]
    assert main([*arguments, "--lookahead", "2", "--set", "segmentation.label_cost=7"]) == 0
    assert [(one.layers.lookahead, one.segmentation.label_cost) for one in configs] == [(2, 7)]
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if line.startswith("cars4")).split()[1] == "0.00"
    assert next(line for line in lines if line.startswith("cars1")).split()[1] == "-"


def test_kernels_are_loaded_before_anything_is_timed(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []

    def engine(config: Config, flow: object, tracks: object) -> BrightSubtractor:
        order.append("engine")
        return BrightSubtractor()

    monkeypatch.setattr(scoring, "MultilayerSubtractor", engine)
    monkeypatch.setattr(command, "warm_engine", lambda: order.append("warm"))
    main(["--paper", "--data", str(data), "--jobs", "1"])
    assert order == ["warm", "engine", "engine"]


def test_it_takes_no_sequence_that_is_not_the_papers(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for names, words in (
        ("mlbs/cars1,davis/dog", "leave davis/dog out"),
        ("davis/dog", "None of the paper's"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["--paper", "--data", str(data), "--sequences", names])
        assert ended.value.code == 2
        assert words in capsys.readouterr().err
