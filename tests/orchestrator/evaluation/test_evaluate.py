"""``scripts/evaluate``: finished runs and the engine, scored from the outside."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from evaluation_fakes import BrightSubtractor
from PIL import Image

from mlbs_actors.config import Config
from mlbs_actors.errors import ConfigError, FrameError, SourceError
from mlbs_actors.messages import Array, Region, Segmentation
from mlbs_actors.pictures.layer_colours import layer_colour
from mlbs_actors.scenes.synthetic import SyntheticScene, scene
from orchestrator.evaluation import scoring
from orchestrator.evaluation.command import main
from orchestrator.evaluation.contact_sheet import SheetFrame, contact_sheet, spread_evenly
from orchestrator.evaluation.datasets import data_root, find_sequences, open_sequence
from orchestrator.evaluation.figures import format_table, mean_of_sequences
from orchestrator.evaluation.labelling import EngineLabelling
from orchestrator.evaluation.scoring import score_sequence
from orchestrator.evaluation.sequences import FolderSequence, SceneSequence, read_label_map

TINY_CROSSING = "synthetic:crossing?frames=8&width=96&height=72"


def write_label_map(path: Path, labels: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.fromarray(labels.astype(np.uint8))
    image.putpalette([value for index in range(256) for value in (255 - index, index, 7)])
    image.save(path)


@pytest.fixture
def sequence_folder(tmp_path: Path) -> Path:
    """Three frames of 8×6 px with one object of 2×2 px that moves right; frame 2 has no truth."""
    folder = tmp_path / "data" / "set" / "clip"
    (folder / "frames").mkdir(parents=True)
    for index in (1, 2, 3):
        cv2.imwrite(str(folder / "frames" / f"{index:05d}.jpg"), np.full((6, 8, 3), 40 * index, np.uint8))
        truth = np.zeros((6, 8), np.uint8)
        truth[2:4, index : index + 2] = 1
        if index != 2:
            write_label_map(folder / "gt" / f"{index:05d}.png", truth)
    return folder


def write_run(folder: Path, out: Path, frames: Sequence[int], labels: Sequence[Array]) -> None:
    for index, mask in zip(frames, labels, strict=True):
        write_label_map(out / folder.name / "masks" / f"{index:05d}.png", mask)


def half_right() -> list[Array]:
    """Masks of frames 1 and 3: the first is the truth, the second is as large but half off it."""
    first, last = np.zeros((6, 8), np.uint8), np.zeros((6, 8), np.uint8)
    first[2:4, 1:3] = 9
    last[2:4, 4:6] = 9
    return [first, last]


def test_a_run_is_scored_by_the_stems_of_its_masks(
    sequence_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(sequence_folder, tmp_path / "out", (1, 3), half_right())
    figures = tmp_path / "figures.json"
    code = main(
        ["--run", str(tmp_path / "out"), "--truth", f"clip={sequence_folder}/gt", "--json", str(figures)]
    )
    assert code == 0
    record = json.loads(figures.read_text())
    whole = record["sequences"]["clip"]["score"]["all_frames"]
    assert whole["two_label_f"] == pytest.approx((1 + 1 / 2) / 2)
    assert whole["j"] == pytest.approx((1 + 1 / 3) / 2)
    assert record["mean"]["two_label_f"] == pytest.approx(75)
    assert record["sequences"]["clip"]["ms_per_frame"] is None
    header, line = capsys.readouterr().out.splitlines()[:2]
    shown = dict(zip(header.split(), line.split(), strict=True))
    assert (shown["sequence"], shown["two_label_f"], shown["switches"], shown["ms"]) == (
        "clip",
        "75",
        "0",
        "-",
    )


def test_a_frame_with_truth_but_without_a_mask_is_reported(
    sequence_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(sequence_folder, tmp_path / "out", (1,), half_right()[:1])
    assert main(["--run", str(tmp_path / "out"), "--truth", f"clip={sequence_folder}/gt"]) == 1
    assert "1 frames with truth have no labels" in capsys.readouterr().err


def test_a_stream_that_is_not_in_the_run_fails_alone(
    sequence_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(sequence_folder, tmp_path / "out", (1, 3), half_right())
    truth = f"{sequence_folder}/gt"
    assert main(["--run", str(tmp_path / "out"), "--truth", f"other={truth}", f"clip={truth}"]) == 1
    printed = capsys.readouterr()
    assert "other" in printed.err
    assert "clip" in printed.out


def test_a_run_on_a_synthetic_scene_is_scored_against_its_exact_truth(tmp_path: Path) -> None:
    made = scene("crossing", frames=8, width=96, height=72)
    for index in range(8):
        write_label_map(tmp_path / "out" / "x" / "masks" / f"{index:05d}.png", made.labels(index))
    figures = tmp_path / "figures.json"
    assert main(["--run", f"{tmp_path}/out", "--truth", f"x={TINY_CROSSING}", "--json", str(figures)]) == 0
    assert json.loads(figures.read_text())["mean"]["object_f"] == 100


@pytest.mark.parametrize(
    "arguments",
    [
        ["--run", "out"],
        ["--run", "out", "--truth", "nonsense"],
        ["--run", "out", "--truth", "a=gt", "--lookahead", "2"],
        ["--run", "out", "--truth", "a=synthetic:nowhere"],
        ["--data", "/nowhere"],
        ["--sequences", "synthetic:nowhere"],
        ["--sequences", TINY_CROSSING, "--set", "no.such=1"],
        ["--sequences", TINY_CROSSING, "--jobs", "0"],
        ["--sequences", TINY_CROSSING, "--ablate", "--csv", "frames.csv"],
        ["--sequences", TINY_CROSSING, "--disturb", "--flow", "flow"],
        ["--sequences", TINY_CROSSING, "--truth", "a=gt"],
    ],
)
def test_wrong_usage_ends_with_code_2_and_a_sentence(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert "scripts/evaluate: error: " in capsys.readouterr().err


class TruthfulSubtractor:
    """Stands in for the engine: holds three frames, then labels each with the scene's truth, 10 higher."""

    def __init__(self, made: SyntheticScene) -> None:
        self.scene = made
        self.read = 0
        self.given = 0

    def apply(self, frame: Array) -> list[Segmentation]:
        assert np.array_equal(frame, self.scene.frame(self.read))
        self.read += 1
        return self._give(self.read) if self.read >= 3 else []

    def flush(self) -> list[Segmentation]:
        return self._give(self.read)

    def _give(self, until: int) -> list[Segmentation]:
        indices, self.given = range(self.given, until), until
        return [self._segmentation(index) for index in indices]

    def _segmentation(self, index: int) -> Segmentation:
        labels = self.scene.labels(index).astype(np.uint16)
        labels[labels > 0] += 10
        nothing = np.zeros(labels.shape, np.uint8)
        return Segmentation(index, labels, nothing, nothing.astype(np.int8), (), (0.0, 0.0), 0, {"cut": 2.0})


def test_the_engine_is_fed_every_frame_and_all_it_gives_is_scored() -> None:
    made = scene("demo", frames=12, width=160, height=120)
    sequence = SceneSequence("demo", made)
    labelling = EngineLabelling(sequence, TruthfulSubtractor(made))
    result = score_sequence(sequence, labelling)
    assert result.score is not None
    assert result.score.frames == 12
    assert result.missing == 0
    assert result.score.all_frames.multi_f == 1
    assert result.score.entry_delay
    assert set(result.score.entry_delay.values()) == {0}
    assert labelling.stage_ms == {"cut": 24.0}
    assert labelling.milliseconds > 0


def test_the_command_runs_the_engine_and_prints_its_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = scene("crossing", frames=8, width=96, height=72)
    lookaheads = []

    def engine(config: Config, flow: object, tracks: object) -> TruthfulSubtractor:
        lookaheads.append(config.layers.lookahead)
        return TruthfulSubtractor(made)

    monkeypatch.setattr(scoring, "MultilayerSubtractor", engine)
    figures = tmp_path / "figures.json"
    arguments = ["--sequences", TINY_CROSSING, "--lookahead", "2", "--json", str(figures)]
    assert main([*arguments, "--sheets", str(tmp_path / "sheets")]) == 0
    assert lookaheads == [2]
    record = json.loads(figures.read_text())
    assert record["parameters"] == {"layers": {"lookahead": 2}}
    assert record["versions"]["numpy"] == np.__version__
    result = record["sequences"][TINY_CROSSING]
    assert result["stage_ms"] == {"cut": 2.0}
    assert result["ms_per_frame"] > 0
    assert "100" in capsys.readouterr().out.splitlines()[1]
    assert [Path(sheet).exists() for sheet in result["sheets"]] == [True]


def test_parameters_are_given_as_to_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configs = []

    def engine(config: Config, flow: object, tracks: object) -> TruthfulSubtractor:
        configs.append(config)
        return TruthfulSubtractor(scene("crossing", frames=8, width=96, height=72))

    monkeypatch.setattr(scoring, "MultilayerSubtractor", engine)
    (tmp_path / "own.yaml").write_text("layers:\n  lookahead: 3\n  probation_frames: 7\n")
    changed = ["--set", "layers.lookahead=2", "posterior.motion=0.5", "--set", "posterior.prior=0.5"]
    assert main(["--sequences", TINY_CROSSING, "--config", f"{tmp_path}/own.yaml", *changed]) == 0
    (config,) = configs
    assert (config.layers.lookahead, config.layers.probation_frames) == (2, 7)
    assert (config.posterior.motion, config.posterior.prior) == (0.5, 0.5)


def test_sequences_are_chosen_by_globs(
    sequence_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = sequence_folder.parents[1]
    shutil.copytree(sequence_folder, root / "other" / "clip")
    monkeypatch.setattr(scoring, "MultilayerSubtractor", lambda config, flow, tracks: BrightSubtractor())
    assert main(["--data", str(root), "--sequences", "oth*", "--jobs", "1"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[:3] if line] == [
        "sequence",
        "other/clip",
    ]
    with pytest.raises(SystemExit):
        main(["--data", str(root), "--sequences", "none*"])
    assert "No sequence none*" in capsys.readouterr().err


def test_an_engine_that_fails_on_one_sequence_leaves_the_others_their_figures(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = scene("crossing", frames=8, width=96, height=72)
    engines = iter([TruthfulSubtractor(made)])

    def engine(config: object, flow: object, tracks: object) -> TruthfulSubtractor:
        for ready in engines:
            return ready
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(scoring, "MultilayerSubtractor", engine)
    other = TINY_CROSSING.replace("crossing", "pan")
    assert main(["--sequences", f"{TINY_CROSSING},{other}", "--jobs", "1"]) == 1
    printed = capsys.readouterr()
    assert TINY_CROSSING in printed.out
    assert "planted" in printed.err


@pytest.mark.long
def test_the_script_runs_the_engine_in_several_processes(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    names = [f"synthetic:static-empty?frames=6&width=96&height=72&seed={seed}" for seed in (1, 2)]
    command = [
        sys.executable,
        "-m",
        "orchestrator.evaluation",
        "--sequences",
        ",".join(names),
        "--json",
        str(figures),
    ]
    done = subprocess.run([*command, "--jobs", "2"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    record = json.loads(figures.read_text())["sequences"]
    assert list(record) == names  # in the order asked for, whichever ended first
    assert all(result["score"]["frames"] == 6 for result in record.values())


def test_labels_given_twice_or_late_are_refused() -> None:
    sequence = SceneSequence("pan", scene("pan", frames=4, width=96, height=72))
    empty = np.zeros((72, 96), np.uint16)
    with pytest.raises(FrameError, match="frame 1"):
        score_sequence(sequence, [(0, empty), (1, empty), (1, empty)])


def test_contact_sheets_show_labels_truth_and_differences(tmp_path: Path) -> None:
    image = np.full((60, 80, 3), 100, np.uint8)
    labels, truth = np.zeros((60, 80), np.uint16), np.zeros((60, 80), np.uint8)
    labels[20:40, 20:60] = 3  # left half right, right half false
    truth[20:40, 20:40] = 1
    truth[45:55, 20:60] = 1  # missed
    truth[20:40, 65:75] = 255
    sheet = contact_sheet([SheetFrame("a", image, labels, truth)])
    assert sheet.shape == (60 + 8, 3 * 80 + 16, 3)
    difference = sheet[4:64, 4 + 2 * 84 : 4 + 2 * 84 + 80]
    found, false, missed, open_ = (
        difference[y, x].astype(int) for y, x in ((30, 25), (30, 50), (50, 30), (30, 70))
    )
    assert found.argmax() == 1
    assert false.argmax() == 2
    assert missed.argmax() == 0
    assert np.ptp(open_) == 0
    tint = sheet[4 + 38, 4 + 22].astype(float) - image[0, 0]
    assert np.dot(tint, np.array(layer_colour(3), float) - 100) > 0
    assert (sheet[4 + 10, 4 + 84 + 70] == 100).all()  # where nothing is labelled the input stays


def test_a_contact_sheet_of_eight_large_frames_is_at_most_1800_px_wide() -> None:
    empty = np.zeros((480, 854), np.uint8)
    sheet = contact_sheet([SheetFrame("a", np.zeros((480, 854, 3), np.uint8), empty, empty)] * 8)
    assert sheet.shape[1] <= 1800
    assert sheet.shape[0] < sheet.shape[1]


def test_layers_off_the_truth_get_a_sheet_of_crops(sequence_folder: Path, tmp_path: Path) -> None:
    sequence = open_sequence("set/clip", tmp_path / "data")
    stray = np.zeros((6, 8), np.uint16)
    stray[0:2, 5:8] = 4
    result = score_sequence(sequence, [(index, stray) for index in range(3)], tmp_path / "sheets")
    assert [Path(path).name for path in result.sheets] == ["set-clip.png", "set-clip-extra-layers.png"]
    assert result.score is not None
    assert result.score.extras[0].region == Region(5, 0, 3, 2)
    assert all(cv2.imread(path) is not None for path in result.sheets)


def test_sheet_frames_are_spread_evenly_with_both_ends() -> None:
    assert spread_evenly(range(15), 8) == [0, 2, 4, 6, 8, 10, 12, 14]
    assert spread_evenly([3, 9], 8) == [3, 9]


def test_sequence_folders_are_found_at_any_depth(sequence_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "data" / "only-truth" / "gt").mkdir(parents=True)
    assert find_sequences(tmp_path / "data") == ["set/clip"]


def test_frames_without_truth_are_known_but_not_scored(sequence_folder: Path) -> None:
    sequence = FolderSequence("clip", sequence_folder / "gt", sequence_folder / "frames")
    assert sequence.stems == ("00001", "00002", "00003")
    assert [sequence.has_truth(index) for index in range(3)] == [True, False, True]
    assert sequence.truth(1) is None
    assert sequence.frame(1).shape == (6, 8, 3)


def test_truth_of_0_and_255_alone_is_one_object_and_this_is_told(
    sequence_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (sequence_folder / "gt").iterdir():
        write_label_map(path, 255 * (np.asarray(Image.open(path)) > 0))
    write_run(sequence_folder, tmp_path / "out", [1, 3], half_right())
    figures = tmp_path / "figures.json"
    truth = f"clip={sequence_folder}/gt"
    assert main(["--run", str(tmp_path / "out"), "--truth", truth, "--json", str(figures)]) == 0
    assert "clip: the truth holds 0 and 255 alone" in capsys.readouterr().out
    # The first frame is right; of the second two of the four pixels found are right, and of the four sought.
    assert json.loads(figures.read_text())["mean"]["two_label_f"] == pytest.approx(75)


def test_255_beside_an_object_is_not_judged(sequence_folder: Path) -> None:
    truth = np.asarray(Image.open(sequence_folder / "gt/00003.png")).copy()
    truth[:, :3] = 255
    write_label_map(sequence_folder / "gt/00003.png", truth)
    sequence = FolderSequence("clip", sequence_folder / "gt", sequence_folder / "frames")
    np.testing.assert_array_equal(sequence.truth(2), truth)
    assert sequence.remark is None


def test_truth_without_its_frame_is_refused(sequence_folder: Path) -> None:
    (sequence_folder / "frames" / "00003.jpg").unlink()
    with pytest.raises(SourceError, match="00003"):
        FolderSequence("clip", sequence_folder / "gt", sequence_folder / "frames")


def test_the_data_root_comes_from_the_argument_or_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLBS_DATA", str(tmp_path))
    assert data_root(None) == tmp_path
    assert data_root(Path("/")) == Path("/")
    monkeypatch.delenv("MLBS_DATA")
    with pytest.raises(ConfigError, match="MLBS_DATA"):
        data_root(None)


def test_label_maps_are_read_as_indices_whatever_their_palette(tmp_path: Path) -> None:
    labels = np.array([[0, 1, 2], [3, 254, 255]], np.uint8)
    write_label_map(tmp_path / "palette.png", labels)
    assert np.array_equal(read_label_map(tmp_path / "palette.png"), labels)
    wide = np.array([[0, 255, 300, 65_535]], np.uint16)
    cv2.imwrite(str(tmp_path / "wide.png"), wide)
    assert np.array_equal(read_label_map(tmp_path / "wide.png"), wide)


def test_a_colour_picture_is_no_label_map(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "colour.png"), np.array([[[0, 0, 0], [0, 0, 1]]], np.uint8))
    with pytest.raises(SourceError, match="colour"):
        read_label_map(tmp_path / "colour.png")


def test_the_mean_leaves_unknown_values_out() -> None:
    assert mean_of_sequences([1.0, float("nan"), 3.0]) == 2.0


def test_tables_align_names_left_and_figures_right() -> None:
    assert format_table(["a", "bb"], [["xyz", "1"]]) == "a    bb\nxyz   1"


@pytest.mark.data
@pytest.mark.skipif(not os.environ.get("MLBS_DATA"), reason="MLBS_DATA names no folder of real sequences")
def test_real_truth_scored_against_itself_is_perfect() -> None:
    root = data_root(None)
    for name in find_sequences(root):
        sequence = open_sequence(name, root)
        indices = [index for index in range(len(sequence.stems)) if sequence.has_truth(index)][:4]
        truths = [(index, sequence.truth(index)) for index in indices]
        label_maps = [
            (index, np.where(truth == 255, 0, truth)) for index, truth in truths if truth is not None
        ]
        score = score_sequence(sequence, label_maps).score
        assert score is not None
        assert score.all_frames.two_label_f == 1
        assert score.all_frames.object_f == 1
        assert score.extras == ()
