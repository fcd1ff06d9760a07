"""``scripts/evaluate --ablate``: the method built up stage by stage, and left without one part."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from evaluation_fakes import BrightSubtractor, write_bright_sequence

from mlbs_actors.config import Config, load_config
from mlbs_actors.motion_field.field import MotionField, MotionParameters, motion_field
from orchestrator.evaluation import scoring
from orchestrator.evaluation.ablation import PARTS, STAGES, Stage, ablation_variants
from orchestrator.evaluation.command import main


def parameters(config: Config) -> dict[str, object]:
    """Every ``section.key`` and its value."""
    return {
        f"{section}.{key}": value
        for section, group in config.model_dump().items()
        for key, value in group.items()
    }


def switched(stage: Stage) -> set[str]:
    return {override.partition("=")[0] for override in stage.off}


def part(name: str) -> Stage:
    return next(stage for stage in PARTS if stage.name == name)


def test_the_row_of_the_last_stage_is_the_whole_method() -> None:
    assert load_config(None, ablation_variants([], parts=())[-1].overrides) == Config()


def test_each_row_switches_on_just_the_stage_it_is_named_by() -> None:
    rows = ablation_variants([], parts=())
    assert [row.name for row in rows] == [stage.name for stage in STAGES]
    values = [parameters(load_config(None, row.overrides)) for row in rows]
    default = parameters(Config())
    for before, after, stage in zip(values[:-1], values[1:], STAGES[1:], strict=True):
        assert {name for name in default if before[name] != after[name]} == switched(stage)
        assert all(after[name] == default[name] for name in switched(stage))


def test_every_stage_can_be_switched_off_and_is_on_by_default() -> None:
    assert not STAGES[0].off  # what is left without all stages
    default = parameters(Config())
    for stage in STAGES[1:]:
        off = parameters(load_config(None, stage.off))
        assert switched(stage) <= {name for name in default if off[name] != default[name]}


def test_each_further_row_is_the_whole_method_without_the_part_it_is_named_by() -> None:
    rows = ablation_variants([])[len(STAGES) :]
    assert [row.name for row in rows] == [stage.name for stage in PARTS]
    default = parameters(Config())
    for row, stage in zip(rows, PARTS, strict=True):
        values = parameters(load_config(None, row.overrides))
        assert {name for name in default if values[name] != default[name]} == switched(stage)


def bent_field(stage: Stage) -> MotionField:
    """The motion field of trajectories that turn and spread, as the method without some part has it."""
    random = np.random.default_rng(3)
    positions = random.uniform(0, 200, (300, 2)).astype(np.float32)
    motions = (0.02 * positions + random.normal(size=positions.shape)).astype(np.float32)
    parameters = MotionParameters.configured(load_config(None, stage.off), (480, 640), 2)
    return motion_field(positions, motions, (200, 200), np.array([1.0, 2.0]), parameters)


def test_a_rigid_motion_is_one_for_the_whole_layer() -> None:
    whole, rigid = bent_field(Stage("whole")), bent_field(part("without motion field (rigid)"))
    assert whole.mean.std(axis=(0, 1)).min() > 0.5
    assert rigid.mean.std(axis=(0, 1)).max() < 0.01
    np.testing.assert_allclose(rigid.mean.mean(axis=(0, 1)), whole.mean.mean(axis=(0, 1)), atol=0.2)


def test_without_the_variance_the_mean_is_the_same_to_the_bit() -> None:
    whole, sure = bent_field(Stage("whole")), bent_field(part("without variance of the motion"))
    assert np.array_equal(whole.mean, sure.mean)
    np.testing.assert_allclose(sure.variance, whole.variance / 128**2, rtol=1e-5)


def test_parameters_of_the_user_hold_in_every_row_but_do_not_switch_a_stage_on() -> None:
    rows = ablation_variants(["posterior.appearance=0.7", "layers.lookahead=2"])
    configs = [load_config(None, row.overrides) for row in rows]
    assert {config.layers.lookahead for config in configs} == {2}
    assert [config.posterior.appearance for config in configs] == [0, *[0.7] * (len(rows) - 1)]


def test_of_two_stages_that_switch_one_parameter_the_earlier_decides_while_both_are_off() -> None:
    stages = (
        Stage("base"),
        Stage("+ prior", ("posterior.prior=0",)),
        Stage("+ strong prior", ("posterior.prior=0.01",)),
    )
    rows = ablation_variants([], stages, parts=())
    assert [load_config(None, row.overrides).posterior.prior for row in rows] == [
        0,
        0.01,
        Config().posterior.prior,
    ]


def test_the_table_has_a_row_for_each_stage_and_part_with_means_and_sequences(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        write_bright_sequence(tmp_path / "data" / name)
    monkeypatch.setattr(
        scoring,
        "MultilayerSubtractor",
        lambda config, flow, tracks: BrightSubtractor(blind=config.posterior.appearance == 0),
    )
    figures = tmp_path / "figures.json"
    command = ["--ablate", "--data", f"{tmp_path}/data", "--jobs", "1", "--json", str(figures)]
    assert main(command) == 0
    printed = capsys.readouterr()
    heading, *lines = printed.out.splitlines()
    names = [row.name for row in ablation_variants([])]
    assert heading.split() == ["stage", "two_label_f", "object_f", "extra", "switches", "a", "b"]
    assert [line.split()[-6:] for line in lines] == [
        ["0", "0", "0", "0", "0", "0"],
        *[["100", "100", "0", "0", "100", "100"]] * (len(names) - 1),
    ]
    assert all(line.startswith(name) for line, name in zip(lines, names, strict=True))
    progress = printed.err.splitlines()
    assert progress[2] == f"3 of {2 * len(names)}: {STAGES[1].name}, a: done"
    rows = json.loads(figures.read_text())["rows"]
    assert [row["name"] for row in rows] == names
    assert [row["mean"]["two_label_f"] for row in rows] == [0, *[100] * (len(names) - 1)]
    assert rows[1]["sequences"]["b"]["score"]["all_frames"]["two_label_f"] == 1
    assert rows[len(STAGES) - 1]["overrides"] == []


def test_a_row_that_lost_a_sequence_has_no_mean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b"):
        write_bright_sequence(tmp_path / "data" / name)
    made: list[Config] = []

    def engine(config: Config, flow: object, tracks: object) -> BrightSubtractor:
        made.append(config)
        if len(made) == 1:
            raise ZeroDivisionError("planted")
        return BrightSubtractor()

    monkeypatch.setattr(scoring, "MultilayerSubtractor", engine)
    assert main(["--ablate", "--data", f"{tmp_path}/data", "--jobs", "1"]) == 1
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[1].split()[-6:] == ["-", "-", "-", "-", "-", "100"]
    assert lines[2].split()[-6:] == ["100", "100", "0", "0", "100", "100"]
    assert f"{STAGES[0].name}, a: Traceback" in printed.err
    assert "planted" in printed.err


@pytest.mark.parametrize("other", [["--disturb"], ["--paper"], ["--run", "out"], ["--sheets", "sheets"]])
def test_what_does_not_go_with_it_is_refused(other: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--ablate", "--sequences", "synthetic:demo", *other])
    assert ended.value.code == 2
    assert "--ablate" in capsys.readouterr().err.splitlines()[-1]
