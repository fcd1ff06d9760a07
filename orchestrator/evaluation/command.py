"""The command ``scripts/evaluate``: score a finished run, or the engine, on sequences with truth."""

from __future__ import annotations

import argparse
import fnmatch
import glob
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from mlbs_actors.record.recorded_stream import read_description
from mlbs_actors.scenes.synthetic import SCHEME, scene_from_uri
from orchestrator.evaluation import datasets
from orchestrator.evaluation.ablation import ablation_table, ablation_variants
from orchestrator.evaluation.disturbance import disturbance_as_json, disturbance_table, disturbance_variants
from orchestrator.evaluation.figure_files import write_csv, write_json, write_latex
from orchestrator.evaluation.figures import (
    COLUMNS,
    TABLES,
    format_number,
    format_table,
    mean_of_objects,
    mean_of_sequences,
    results_as_json,
)
from orchestrator.evaluation.labelling import run_label_maps, run_scores
from orchestrator.evaluation.options import SCRIPT, evaluation_parser
from orchestrator.evaluation.paper_tables import paper_sequences, paper_tables
from orchestrator.evaluation.reliability import reliability_table
from orchestrator.evaluation.run_pictures import RunSequence
from orchestrator.evaluation.scoring import (
    EngineSetup,
    SequenceResult,
    score_sequence,
    scored_masks,
    warm_engine,
)
from orchestrator.evaluation.sequences import SceneSequence
from orchestrator.evaluation.sequences import Sequence as TruthSequence
from orchestrator.evaluation.sizes import size_variants, sizes_table
from orchestrator.evaluation.variants import Variant, VariantResults, run_variants, variants_as_json
from orchestrator.pictures.privacy import is_private
from orchestrator.run.versions import installed_versions

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None, program: str = SCRIPT) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str or None
        Without the program's name; None: those of this process.
    program : str
        What its user has typed before them.

    Returns
    -------
    int
        0: all scored; 1: some sequence could not be scored, or not all of its frames with truth had a mask;
        2: wrong usage.
    """
    parser = evaluation_parser(program)
    options = parser.parse_args(arguments)
    unknown = [name for name in options.columns if name not in COLUMNS]
    if unknown:
        parser.error(f"There is no column {unknown[0]}; those of --columns are: {', '.join(COLUMNS)}.")
    try:
        ran = _what_ran(options)
        rows = _score_run(options) if options.run else _score_engine(options)
    except MlbsError as error:
        parser.error(str(error))
    if options.ablate:
        print(ablation_table(rows))
    elif options.disturb:
        print(disturbance_table(rows))
    elif options.sizes:
        print(sizes_table(rows))
    elif options.paper:
        print(paper_tables(rows[0].results))
        _print_remarks(rows[0].results)
    else:
        _print_figures(rows[0].results)
        if options.reliability:
            print(reliability_table([one for result in rows[0].results for one in result.masks]) + "\n")
        _print_remarks(rows[0].results)
    _print_failures(rows)
    try:
        _write_files(options, ran, rows)
    except MlbsError as error:
        parser.error(str(error))
    return int(any(result.error or result.missing for row in rows for result in row.results))


def _score_run(options: argparse.Namespace) -> list[VariantResults]:
    if not options.truth:
        raise ConfigError(
            "--run needs --truth: NAME=GT_DIR for each stream to score, or folders of that name."
        )
    for_engine = ("data", "sequences", "set", "lookahead", "config", "flow")
    if any(getattr(options, one) not in (None, []) for one in for_engine):
        given = ", ".join(f"--{one}" for one in for_engine)
        raise ConfigError(f"--run scores finished masks: leave {given} out.")
    if not options.run.is_dir():
        raise ConfigError(f"There is no run {options.run}; check the path.")
    description = read_description(options.run) or {}
    # The pictures of a private run's sources are not for sheets.
    sources = {} if is_private(description) else description.get("sources", {})
    pairs = [pair for text in options.truth for pair in _streams_with_truth(options.run, text)]
    with_masks = {path.name for path in options.run.glob("*") if _has_masks(path)}
    unscored = with_masks - {name for name, _ in pairs}
    if unscored:
        print(f"Streams of the run without --truth: {', '.join(sorted(unscored))}.", file=sys.stderr)
    results = [
        _run_result(options.run, name, truth, sources.get(name), options.sheets) for name, truth in pairs
    ]
    return [VariantResults(Variant(""), tuple(results))]


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


def _score_engine(options: argparse.Namespace) -> list[VariantResults]:
    if (options.sheets or options.csv or options.latex) and _compares(options):
        raise ConfigError(
            "--ablate, --disturb and --sizes give tables only: leave --sheets, --csv and --latex out."
        )
    if options.flow and (options.disturb or options.sizes):
        raise ConfigError(
            "--disturb and --sizes change the frames, which stored flow would not fit: leave --flow out."
        )
    if options.truth:
        raise ConfigError("--truth belongs to --run; with --data the truth is found beside the pictures.")
    if options.jobs < 1:
        raise ConfigError(f"--jobs is {options.jobs}; it must be 1 or more.")
    overrides = _overrides(options)
    names = _sequence_names(options)
    # Unusable parameters and sequences are reported before anything runs.
    variants = _variants(options, overrides)
    for variant in variants:
        load_config(options.config, variant.overrides)
    opened = [datasets.open_sequence(name, options.data) for name in names]
    for change in (variant.change for variant in variants if variant.change is not None):
        for sequence in opened:
            change(sequence)
    prepare = warm_engine if options.paper or options.sizes else None  # their tables hold times
    setup = EngineSetup(options.data, options.config, options.flow, options.sheets)
    return run_variants(variants, names, setup, options.jobs, prepare)


def _overrides(options: argparse.Namespace) -> list[str]:
    lookahead = [] if options.lookahead is None else [f"layers.lookahead={options.lookahead}"]
    return [*options.set, *lookahead]


def _compares(options: argparse.Namespace) -> bool:
    """Whether several variants are run."""
    return bool(options.ablate or options.disturb or options.sizes)


def _sequence_names(options: argparse.Namespace) -> list[str]:
    asked: list[str] = options.sequences or ["*"]
    names = [name for text in asked for name in _names_of(text, options.data)]
    if not options.paper:
        return names
    selected = paper_sequences(names)
    others = set(names) - set(selected)
    if options.sequences and others:
        raise ConfigError(f"--paper knows the paper's sequences only: leave {', '.join(sorted(others))} out.")
    return selected


def _names_of(text: str, data: Path | None) -> list[str]:
    """List the sequences of a name, or of a glob of names."""
    if text.startswith(SCHEME) or not set(text) & set("*?["):
        return [text]
    root = datasets.data_root(data)
    names = fnmatch.filter(datasets.find_sequences(root), text)
    if not names:
        raise ConfigError(
            f"No sequence {text} is below {root}: there must be frames/ and gt/, JPEGImages/ and "
            "Annotations/, or pictures and a file …Def.dat."
        )
    return names


def _variants(options: argparse.Namespace, overrides: Sequence[str]) -> tuple[Variant, ...]:
    if options.ablate:
        return ablation_variants(overrides)
    if options.disturb:
        return disturbance_variants(overrides)
    if options.sizes:
        return size_variants(overrides, options.sizes)
    return (Variant("", tuple(overrides)),)


def _print_figures(results: Sequence[SequenceResult]) -> None:
    scored = [(result, result.score) for result in results if result.score is not None]
    for columns in TABLES:
        rows = [
            [result.name, *(format_number(value(result, score)) for _, value in columns)]
            for result, score in scored
        ]
        means = [mean_of_sequences(value(result, score) for result, score in scored) for _, value in columns]
        if len(rows) > 1:
            rows.append(["mean", *(format_number(mean) for mean in means)])
        if rows:
            print(format_table(["sequence", *(heading for heading, _ in columns)], rows) + "\n")
    overall = mean_of_objects(results)
    if overall["objects"]:
        figures = ", ".join(f"{name} {format_number(value)}" for name, value in overall.items())
        print(f"davis17, mean of all objects of all sequences: {figures}\n")


def _print_remarks(results: Sequence[SequenceResult]) -> None:
    for result in results:
        if result.remark:
            print(f"{result.name}: {result.remark}")
        for path in result.sheets:
            print(f"{result.name}: see {path}")


def _print_failures(rows: Sequence[VariantResults]) -> None:
    for row in rows:
        for result in row.results:
            name = f"{row.variant.name}, {result.name}" if row.variant.name else result.name
            if result.error:
                print(f"{name}: {result.error}", file=sys.stderr)
            if result.missing:
                print(f"{name}: {result.missing} frames with truth have no labels.", file=sys.stderr)


def _write_files(options: argparse.Namespace, ran: Mapping[str, Any], rows: Sequence[VariantResults]) -> None:
    if options.json:
        write_json(options.json, dict(ran) | _as_json(options, rows))
    if options.csv:
        write_csv(options.csv, rows[0].results)
    if options.latex:
        write_latex(options.latex, rows[0].results, options.columns)


def _what_ran(options: argparse.Namespace) -> dict[str, Any]:
    """Return whose labels were scored: the run's, or those of an engine of these parameters and versions."""
    if options.run:
        return {"run": str(options.run)}
    config = load_config(options.config, _overrides(options))
    changed = config.model_dump(mode="json", exclude_defaults=True)
    flow = None if options.flow is None else str(options.flow)
    return {"parameters": changed, "flow": flow, "versions": installed_versions()}


def _as_json(options: argparse.Namespace, rows: Sequence[VariantResults]) -> dict[str, Any]:
    if options.ablate or options.sizes:
        return variants_as_json(rows)
    if options.disturb:
        return disturbance_as_json(rows)
    return results_as_json(rows[0].results)
