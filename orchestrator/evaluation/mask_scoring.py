"""Label maps of several methods, scored on the same frames: ``scripts/evaluate --masks``."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.evaluation import datasets, sequences
from orchestrator.evaluation.labelling import run_scores
from orchestrator.evaluation.mask_folders import MaskFolder, MethodMasks, short_name
from orchestrator.evaluation.scoring import SequenceResult, score_sequence, scored_masks
from orchestrator.evaluation.variants import Variant, VariantResults

__all__ = ["score_masks"]


def score_masks(
    methods: Sequence[MaskFolder], names: Sequence[str], root: Path | None, sheets: Path | None
) -> list[VariantResults]:
    """Score every method on every sequence; report progress on stderr.

    A sequence is scored on the frames that all methods have which have masks of it at all, so that no method
    gains by leaving out what is difficult.

    Parameters
    ----------
    methods : sequence of MaskFolder
    names : sequence of str
        As for :func:`orchestrator.evaluation.datasets.open_sequence`.
    root : Path or None
        The data root.
    sheets : Path or None
        Folder for contact sheets, in a folder for each method.

    Returns
    -------
    list of VariantResults
        In the order of the methods.

    Raises
    ------
    ConfigError
        If a method has no masks of any of the sequences; it says where they are expected.
    """
    short = Counter(map(short_name, names))
    results: list[list[SequenceResult]] = [[] for _ in methods]
    for number, name in enumerate(names, start=1):
        sequence = datasets.open_sequence(name, root)
        found = [_found(method, sequence, short[short_name(name)] == 1) for method in methods]
        usable = [one.frames for one in found if isinstance(one, MethodMasks)]
        common = sorted(frozenset.intersection(*usable)) if usable else []
        for own, method, one in zip(results, methods, found, strict=True):
            if isinstance(one, MethodMasks):
                own.append(_scored(sequence, one, common, sheets and sheets / method.name))
            else:
                own.append(SequenceResult(name, error=one))
        print(f"{number} of {len(names)}: {name}: done", file=sys.stderr, flush=True)
    for method, own in zip(methods, results, strict=True):
        if own and all(result.score is None for result in own):
            raise ConfigError(f"{method.name} cannot be scored. {own[0].error}")
    return [
        VariantResults(Variant(method.name), tuple(own)) for method, own in zip(methods, results, strict=True)
    ]


def _found(method: MaskFolder, sequence: sequences.Sequence, by_short_name: bool) -> MethodMasks | str:
    """Find a sequence's masks, or say why there are none."""
    try:
        return method.masks_of(sequence, by_short_name=by_short_name)
    except MlbsError as error:
        return str(error)


def _scored(
    sequence: sequences.Sequence, masks: MethodMasks, common: Sequence[int], sheets: Path | None
) -> SequenceResult:
    with_truth = [index for index in range(len(sequence.stems)) if sequence.has_truth(index)]
    missing = len(frozenset(with_truth) - masks.frames)
    if frozenset(common).isdisjoint(with_truth):
        return SequenceResult(
            sequence.name,
            missing=missing,
            error="there is no frame with truth of which all methods have masks.",
        )
    try:
        result = score_sequence(sequence, masks.label_maps(common), sheets)
    except MlbsError as error:
        return SequenceResult(sequence.name, missing=missing, error=str(error))
    assert result.score is not None
    known = scored_masks(result.score, run_scores(sequence, masks.folder))
    return replace(result, missing=missing, masks=known)
