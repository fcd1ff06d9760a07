"""Score one sequence: the label maps of the engine in this process, or those of a finished run."""

from __future__ import annotations

import re
import traceback
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import cv2

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.config import load_config
from mlbs_actors.errors import FrameError, MlbsError, SinkError
from mlbs_actors.messages import Array
from mlbs_actors.stored_motion import StoredMotion
from mlbs_actors.warm_up import warm_coordinator, warm_segmenter
from orchestrator.evaluation import datasets, sequences
from orchestrator.evaluation.contact_sheet import SheetFrame, contact_sheet, extra_layer_sheet, spread_evenly
from orchestrator.evaluation.labelling import EngineLabelling, ResizingSubtractor, Subtractor
from orchestrator.evaluation.sequence_scorer import SequenceScore, SequenceScorer

__all__ = [
    "EngineSetup",
    "ScoredMask",
    "SequenceResult",
    "engine_result",
    "score_sequence",
    "scored_masks",
    "warm_engine",
]

SHEET_FRAMES = 8


class ScoredMask(NamedTuple):
    """A mask with its score, its quality and its object's score, each in [0, 1].

    ``iou`` is its intersection over union with the truth object that it fits best, ``object_score`` the mean
    score of all masks of its label in the sequence.
    """

    score: float
    iou: float
    object_score: float


@dataclass(frozen=True, slots=True)
class SequenceResult:
    """The outcome of one sequence.

    Attributes
    ----------
    name : str
    score : SequenceScore or None
        None: it could not be scored, ``error`` says why.
    missing : int
        Frames with truth that got no label map.
    ms_per_frame : float or None
        Wall time in the engine, ms; None when the masks were read.
    cpu_ms_per_frame : float or None
        CPU time, ms.
    stage_ms : dict of str to float
        Mean wall time a frame by stage, ms.
    sheets : tuple of str
        Pictures written.
    remark : str or None
        A sentence on how the truth was read, or why there is no contact sheet.
    error : str or None
    stems : tuple of str
        Names of the frames, by index.
    masks : tuple of ScoredMask
        Those of the frames with truth, where their scores are known.
    """

    name: str
    score: SequenceScore | None = None
    missing: int = 0
    ms_per_frame: float | None = None
    cpu_ms_per_frame: float | None = None
    stage_ms: dict[str, float] = field(default_factory=dict)
    sheets: tuple[str, ...] = ()
    remark: str | None = None
    error: str | None = None
    stems: tuple[str, ...] = ()
    masks: tuple[ScoredMask, ...] = ()


@dataclass(frozen=True, slots=True)
class EngineSetup:
    """What the engine runs with, on every sequence.

    Attributes
    ----------
    root : Path or None
        The data root.
    config : Path or None
        YAML file with parameters.
    flow, tracks : Path or None
        Folders of stored flow and tracks; see :mod:`mlbs_actors.stored_motion`.
    sheets : Path or None
        Folder for contact sheets.
    """

    root: Path | None = None
    config: Path | None = None
    flow: Path | None = None
    tracks: Path | None = None
    sheets: Path | None = None


def score_sequence(
    sequence: sequences.Sequence, label_maps: Iterable[tuple[int, Array]], sheet_folder: Path | None = None
) -> SequenceResult:
    """Score a sequence's label maps as they come; write contact sheets when a folder is given.

    Parameters
    ----------
    sequence : Sequence
    label_maps : iterable of (int, (H, W) integer)
        Frame index and label map, in ascending index.
    sheet_folder : Path or None
        Gets ``<name>.png`` and, where layers lie off the truth, ``<name>-extra-layers.png``.

    Raises
    ------
    MlbsError
        If a mask or truth cannot be read or differs in size, or frames come out of order. What a contact
        sheet lacks is a remark of the result.
    """
    with_truth = [index for index in range(len(sequence.stems)) if sequence.has_truth(index)]
    shown = set(spread_evenly(with_truth, SHEET_FRAMES)) if sheet_folder else set()
    scorer = SequenceScorer()
    shown_labels: dict[int, tuple[Array, Array]] = {}
    labelled: set[int] = set()
    for index, labels in label_maps:
        if labelled and index <= max(labelled):
            raise FrameError(
                f"{sequence.name}: frame {index} was labelled twice or late; give each once, in order."
            )
        labelled.add(index)
        truth = sequence.truth(index)
        scorer.add(index, labels, truth, sequence.motion(index) if index else None)
        if index in shown and truth is not None:
            shown_labels[index] = labels, truth
    score = scorer.score()
    sheets: tuple[str, ...] = ()
    remarks = [sequence.remark] if sequence.remark else []
    if sheet_folder:
        try:
            sheets = _write_sheets(sheet_folder, sequence, score, shown_labels)
        except MlbsError as error:
            remarks.append(f"there is no contact sheet: {error}")
    return SequenceResult(
        name=sequence.name,
        score=score,
        missing=sum(index not in labelled for index in with_truth),
        sheets=sheets,
        remark=" ".join(remarks) or None,
        stems=sequence.stems,
    )


def scored_masks(score: SequenceScore, scores: Mapping[int, Mapping[int, float]]) -> tuple[ScoredMask, ...]:
    """Pair the masks of a sequence with their quality.

    Parameters
    ----------
    score : SequenceScore
    scores : mapping of int to mapping of int to float
        Frame index → label → score.
    """
    of_label: defaultdict[int, list[float]] = defaultdict(list)
    for of_frame in scores.values():
        for label, one in of_frame.items():
            of_label[label].append(one)
    return tuple(
        ScoredMask(scores[frame.index][label], iou, sum(of_label[label]) / len(of_label[label]))
        for frame in score.per_frame
        for label, iou in frame.ious.items()
        if label in scores.get(frame.index, ())
    )


def warm_engine() -> None:
    """Compile or load the engine's kernels in this process, so that no frame's time includes it."""
    warm_coordinator()
    warm_segmenter()


def engine_result(
    name: str,
    setup: EngineSetup,
    overrides: Sequence[str],
    change: sequences.SequenceChange | None = None,
    longer_side: int | None = None,
) -> SequenceResult:
    """Open a sequence, run the engine over it, score it. A failure is reported in the result.

    Parameters
    ----------
    name : str
        As for :func:`orchestrator.evaluation.datasets.open_sequence`.
    setup : EngineSetup
    overrides : sequence of str
        ``section.key=value`` for the engine's parameters.
    change : SequenceChange or None
        Change to the sequence.
    longer_side : int or None
        Of the pictures that the engine is given, px; None: as they are.
    """
    try:
        sequence = datasets.open_sequence(name, setup.root)
        if change is not None:
            sequence = change(sequence)
        config = load_config(setup.config, list(overrides))
        motion = _stored_motion(sequence.name, setup)
        flow, tracks = (None, None) if motion is None else (motion.flow, motion.tracks)
        subtractor: Subtractor = MultilayerSubtractor(config, flow=flow, tracks=tracks)
        if longer_side is not None:
            subtractor = ResizingSubtractor(subtractor, longer_side)
        labelling = EngineLabelling(sequence, subtractor, motion)
        result = score_sequence(sequence, labelling, setup.sheets)
    except MlbsError as error:
        return SequenceResult(name, error=str(error))
    except Exception:  # a defect on one sequence must not lose the figures of the others
        return SequenceResult(name, error=traceback.format_exc())
    frames = max(labelling.frames, 1)
    return replace(
        result,
        masks=() if result.score is None else scored_masks(result.score, labelling.scores),
        ms_per_frame=labelling.milliseconds / frames,
        cpu_ms_per_frame=labelling.cpu_milliseconds / frames,
        stage_ms={stage: total / frames for stage, total in labelling.stage_ms.items()},
    )


def _stored_motion(name: str, setup: EngineSetup) -> StoredMotion | None:
    if setup.flow is None and setup.tracks is None:
        return None
    return StoredMotion(name, setup.flow, setup.tracks)


def _write_sheets(
    folder: Path, sequence: sequences.Sequence, score: SequenceScore, shown: Mapping[int, tuple[Array, Array]]
) -> tuple[str, ...]:
    frames = [
        SheetFrame(f"{sequence.name} {sequence.stems[index]}", sequence.frame(index), labels, truth)
        for index, (labels, truth) in shown.items()
    ]
    for frame in frames:
        if frame.image.shape[:2] != frame.labels.shape:
            raise FrameError(f"the picture {frame.title} is of another size than its labels.")
    stem = re.sub(r"[^\w.-]", "-", sequence.name)
    pictures = {}
    if frames:
        pictures[folder / f"{stem}.png"] = contact_sheet(frames)
    if score.extras:
        crops = [(extra, sequence.frame(extra.example_frame)) for extra in score.extras]
        pictures[folder / f"{stem}-extra-layers.png"] = extra_layer_sheet(crops)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SinkError(f"the folder given with --sheets cannot be made: {error}.") from error
    for path, picture in pictures.items():
        if not cv2.imwrite(str(path), picture):
            raise SinkError(f"{path} cannot be written; check the folder given with --sheets.")
    return tuple(str(path) for path in pictures)
