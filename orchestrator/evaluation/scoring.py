"""Label one sequence and score it: with the engine in this process, or from the masks of a finished run."""

from __future__ import annotations

import re
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Protocol

import cv2

from mlbs_actors import MultilayerSubtractor
from mlbs_actors.actors.parts import EngineParts
from mlbs_actors.config import load_config
from mlbs_actors.errors import FrameError, MlbsError, SinkError, SourceError
from mlbs_actors.messages import Array, Segmentation
from orchestrator.evaluation import datasets, sequences
from orchestrator.evaluation.contact_sheet import SheetFrame, contact_sheet, extra_layer_sheet, spread_evenly
from orchestrator.evaluation.sequence_scorer import SequenceScore, SequenceScorer
from orchestrator.evaluation.stored_flow import StoredFlow
from orchestrator.sinks.segments import archived_masks

__all__ = [
    "EngineLabelling",
    "EngineSetup",
    "SequenceResult",
    "engine_result",
    "run_label_maps",
    "score_sequence",
    "warm_engine",
]

SHEET_FRAMES = 8


class Subtractor(Protocol):
    """Labels frames: the engine, or a similar object."""

    def apply(self, frame: Array) -> Sequence[Segmentation]:
        """Take the next frame; return the frames that are now labelled."""

    def flush(self) -> Sequence[Segmentation]:
        """Return the frames still held."""


@dataclass(slots=True)
class EngineLabelling:
    """Label maps of a sequence from the engine, by frame index, and their cost so far.

    Attributes
    ----------
    sequence : Sequence
    subtractor : Subtractor
        Fresh: no frame seen yet.
    flow : StoredFlow or None
        Is told of every frame before the subtractor is.
    frames : int
        Label maps so far.
    milliseconds : float
        Wall time spent in the engine so far, ms.
    stage_ms : defaultdict of str to float
        The same by stage, as reported by the segmentations.
    """

    sequence: sequences.Sequence
    subtractor: Subtractor
    flow: StoredFlow | None = None
    frames: int = 0
    milliseconds: float = 0.0
    stage_ms: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))

    def __iter__(self) -> Iterator[tuple[int, Array]]:
        for index in range(len(self.sequence.stems)):
            frame = self.sequence.frame(index)
            if self.flow is not None:
                self.flow.follow(index, frame)
            yield from self._timed(self.subtractor.apply, frame)
        yield from self._timed(self.subtractor.flush)

    def _timed(
        self, step: Callable[..., Sequence[Segmentation]], *frame: Array
    ) -> Iterator[tuple[int, Array]]:
        started = time.perf_counter()
        segmentations = step(*frame)
        self.milliseconds += 1000 * (time.perf_counter() - started)
        for segmentation in segmentations:
            self.frames += 1
            for stage, milliseconds in segmentation.stage_ms.items():
                self.stage_ms[stage] += milliseconds
            yield segmentation.frame_index, segmentation.labels


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
    stage_ms : dict of str to float
        Mean wall time a frame by stage, ms.
    sheets : tuple of str
        Pictures written.
    remark : str or None
        A sentence on how the truth was read, or why there is no contact sheet.
    error : str or None
    stems : tuple of str
        Names of the frames, by index.
    """

    name: str
    score: SequenceScore | None = None
    missing: int = 0
    ms_per_frame: float | None = None
    stage_ms: dict[str, float] = field(default_factory=dict)
    sheets: tuple[str, ...] = ()
    remark: str | None = None
    error: str | None = None
    stems: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class EngineSetup:
    """What the engine runs with, on every sequence.

    Attributes
    ----------
    root : Path or None
        The data root.
    config : Path or None
        YAML file with parameters.
    flow : Path or None
        Folder of stored flow; see :mod:`orchestrator.evaluation.stored_flow`.
    sheets : Path or None
        Folder for contact sheets.
    """

    root: Path | None = None
    config: Path | None = None
    flow: Path | None = None
    sheets: Path | None = None


def run_label_maps(sequence: sequences.Sequence, masks: Path) -> Iterator[tuple[int, Array]]:
    """Read the masks of a run, by frame index; skip frames without a mask.

    ``masks`` is the folder of that name in a stream's folder, which has segments instead if it was a camera.

    Raises
    ------
    SourceError
        If the folder is missing, no mask has the stem of a frame, or a mask cannot be read.
    """
    archived = archived_masks(masks.parent)
    if not masks.is_dir() and not archived:
        raise SourceError(f"{masks} is no folder; name the stream as the run's list did.")
    present = {path.stem for path in masks.glob("*.png")} | archived.keys()
    indices = [index for index, stem in enumerate(sequence.stems) if stem in present]
    if not indices:
        raise SourceError(
            f"No mask in {masks} has the stem of a frame of {sequence.name}; check the folder of the truth."
        )
    for index in indices:
        stem = sequence.stems[index]
        mask = BytesIO(archived[stem].read()) if stem in archived else masks / f"{stem}.png"
        yield index, sequences.read_label_map(mask)


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


def warm_engine() -> None:
    """Compile or load the engine's kernels in this process, so that no frame's time includes it."""
    EngineParts().warm_stream()


def engine_result(
    name: str,
    setup: EngineSetup,
    overrides: Sequence[str],
    change: sequences.SequenceChange | None = None,
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
    """
    try:
        sequence = datasets.open_sequence(name, setup.root)
        if change is not None:
            sequence = change(sequence)
        config = load_config(setup.config, list(overrides))
        flow = StoredFlow(setup.flow, sequence) if setup.flow is not None else None
        labelling = EngineLabelling(sequence, MultilayerSubtractor(config, flow=flow), flow)
        result = score_sequence(sequence, labelling, setup.sheets)
    except MlbsError as error:
        return SequenceResult(name, error=str(error))
    except Exception:  # a defect on one sequence must not lose the figures of the others
        return SequenceResult(name, error=traceback.format_exc())
    frames = max(labelling.frames, 1)
    return replace(
        result,
        ms_per_frame=labelling.milliseconds / frames,
        stage_ms={stage: total / frames for stage, total in labelling.stage_ms.items()},
    )


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
