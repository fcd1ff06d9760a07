"""The masks of a finished run, scored: ``scripts/evaluate --run``."""

from __future__ import annotations

import glob
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mlbs_actors.errors import ConfigError, MlbsError
from mlbs_actors.record.recorded_stream import read_description
from mlbs_actors.scenes.synthetic import SCHEME, scene_from_uri
from orchestrator.evaluation import datasets
from orchestrator.evaluation.labelling import run_label_maps, run_scores
from orchestrator.evaluation.run_pictures import RunSequence
from orchestrator.evaluation.scoring import SequenceResult, score_sequence, scored_masks
from orchestrator.evaluation.sequences import SceneSequence
from orchestrator.evaluation.sequences import Sequence as TruthSequence
from orchestrator.pictures.privacy import is_private

__all__ = ["score_run"]


def score_run(run: Path, truths: Sequence[str], sheets: Path | None) -> tuple[SequenceResult, ...]:
    """Score the streams of a run that have truth.

    Parameters
    ----------
    run : Path
        The output folder.
    truths : sequence of str
        The values of ``--truth``.
    sheets : Path or None
        Folder for contact sheets.

    Raises
    ------
    ConfigError
        If there is no such run, or a value fits none of its streams.
    """
    if not truths:
        raise ConfigError(
            "--run needs --truth: NAME=GT_DIR for each stream to score, or folders of that name."
        )
    if not run.is_dir():
        raise ConfigError(f"There is no run {run}; check the path.")
    description = read_description(run) or {}
    # The pictures of a private run's sources are not for sheets.
    sources = {} if is_private(description) else description.get("sources", {})
    pairs = [pair for text in truths for pair in _streams_with_truth(run, text)]
    with_masks = {path.name for path in run.glob("*") if _has_masks(path)}
    unscored = with_masks - {name for name, _ in pairs}
    if unscored:
        print(f"Streams of the run without --truth: {', '.join(sorted(unscored))}.", file=sys.stderr)
    return tuple(_run_result(run, name, truth, sources.get(name), sheets) for name, truth in pairs)


def _streams_with_truth(run: Path, text: str) -> list[tuple[str, str]]:
    """Read one value of ``--truth``: NAME=GT_DIR, or folders that are named as streams of the run are."""
    name, equals, truth = text.partition("=")
    if equals and name and truth and "/" not in name:
        return [(name, truth)]
    folders = [Path(path) for path in sorted(glob.glob(text))]  # noqa: PTH207, also absolute patterns
    named = {datasets.truth_name(path): str(path) for path in folders if path.is_dir()}
    streams = [(name, truth) for name, truth in named.items() if _has_masks(run / name)]
    if not streams:
        raise ConfigError(
            f"Cannot use --truth {text!r}: no folder there has the name of a stream of {run}. "
            "Write NAME=GT_DIR, or a folder or glob of folders."
        )
    return streams


def _has_masks(stream: Path) -> bool:
    return (stream / "masks").is_dir() or any(stream.glob("*/masks.tar"))


def _run_result(run: Path, name: str, truth: str, source: str | None, sheets: Path | None) -> SequenceResult:
    try:
        sequence: TruthSequence
        if truth.startswith(SCHEME):
            sequence = SceneSequence(name, scene_from_uri(truth))
        else:
            sequence = datasets.open_truth(name, Path(truth))
            if source is not None:
                sequence = RunSequence(sequence, source)
        result = score_sequence(sequence, run_label_maps(sequence, run / name / "masks"), sheets)
        assert result.score is not None
        return replace(result, masks=scored_masks(result.score, run_scores(sequence, run / name)))
    except ConfigError:
        raise
    except MlbsError as error:
        return SequenceResult(name, error=str(error))
