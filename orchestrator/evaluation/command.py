"""The command ``scripts/evaluate``: score a run, anybody's masks, or the engine, on sequences with truth."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.evaluation import datasets
from orchestrator.evaluation.comparison import compared, comparison_as_json, comparison_text
from orchestrator.evaluation.figure_files import (
    write_comparison_latex,
    write_csv,
    write_json,
    write_latex,
    write_summary,
)
from orchestrator.evaluation.figures import (
    COLUMNS,
    TABLES,
    format_number,
    format_table,
    mean_of_objects,
    mean_of_sequences,
    results_as_json,
)
from orchestrator.evaluation.mask_folders import mask_folders
from orchestrator.evaluation.mask_scoring import score_masks
from orchestrator.evaluation.options import COMPARED_COLUMNS, LATEX_COLUMNS, SCRIPT, evaluation_parser
from orchestrator.evaluation.paper_tables import paper_tables
from orchestrator.evaluation.plots import write_plots
from orchestrator.evaluation.precision_recall import precision_recall
from orchestrator.evaluation.published_figures import paper_sequences
from orchestrator.evaluation.questions import Question, question_of
from orchestrator.evaluation.reliability import reliability_table
from orchestrator.evaluation.run_scoring import score_run
from orchestrator.evaluation.scoring import EngineSetup, SequenceResult, warm_engine
from orchestrator.evaluation.variants import Variant, VariantResults, run_variants
from orchestrator.extra import require_matplotlib
from orchestrator.run.versions import installed_versions

__all__ = ["main"]

#: What only the engine can be given.
_FOR_ENGINE = ("set", "lookahead", "config", "flow", "tracks")


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
    unknown = [name for name in options.columns or () if name not in COLUMNS]
    if unknown:
        parser.error(f"There is no column {unknown[0]}; those of --columns are: {', '.join(COLUMNS)}.")
    question = question_of(options)
    try:
        if options.plots:
            require_matplotlib()
        ran = _what_ran(options)
        rows = _scored(options, question)
    except MlbsError as error:
        parser.error(str(error))
    _print(options, question, rows)
    try:
        _write_files(options, question, ran, rows)
    except MlbsError as error:
        parser.error(str(error))
    return int(any(result.error or result.missing for row in rows for result in row.results))


def _scored(options: argparse.Namespace, question: Question | None) -> list[VariantResults]:
    if options.run:
        _refuse(options, ("data", "sequences", *_FOR_ENGINE), "--run scores finished masks: leave {} out.")
        return [VariantResults(Variant(""), score_run(options.run, options.truth, options.sheets))]
    if options.truth:
        raise ConfigError("--truth belongs to --run; with --data the truth is found beside the pictures.")
    if options.masks:
        _refuse(options, _FOR_ENGINE, "--masks scores finished masks: leave {} out.")
        methods = mask_folders(options.masks)
        return score_masks(methods, _sequence_names(options), options.data, options.sheets)
    if question is not None:
        only_tables = ("sheets", "latex") if options.sweep else ("sheets", "latex", "csv", "plots")
        _refuse(
            options,
            only_tables,
            "--ablate, --disturb, --sizes and --sweep are compared by tables: leave {} out.",
        )
    return _score_engine(options, question)


def _refuse(options: argparse.Namespace, names: Sequence[str], sentence: str) -> None:
    """Raise ConfigError if one of these options is given."""
    given = [f"--{name}" for name in names if getattr(options, name) not in (None, [])]
    if given:
        raise ConfigError(sentence.format(", ".join(given)))


def _score_engine(options: argparse.Namespace, question: Question | None) -> list[VariantResults]:
    if question is not None and question.changes_frames:
        _refuse(
            options,
            ("flow", "tracks"),
            "--disturb and --sizes change the frames, which stored motion would not fit: leave {} out.",
        )
    if options.jobs < 1:
        raise ConfigError(f"--jobs is {options.jobs}; it must be 1 or more.")
    overrides = _overrides(options)
    names = _sequence_names(options)
    # Unusable parameters and sequences are reported before anything runs.
    variants = (Variant("", tuple(overrides)),) if question is None else tuple(question.variants(overrides))
    for variant in variants:
        load_config(options.config, variant.overrides)
    opened = [datasets.open_sequence(name, options.data) for name in names]
    for change in (variant.change for variant in variants if variant.change is not None):
        for sequence in opened:
            change(sequence)
    tells_time = options.paper or (question is not None and question.tells_time)
    setup = EngineSetup(options.data, options.config, options.flow, options.tracks, options.sheets)
    return run_variants(variants, names, setup, options.jobs, warm_engine if tells_time else None)


def _overrides(options: argparse.Namespace) -> list[str]:
    lookahead = [] if options.lookahead is None else [f"layers.lookahead={options.lookahead}"]
    return [*options.set, *lookahead]


def _sequence_names(options: argparse.Namespace) -> list[str]:
    names = datasets.chosen_sequences(options.sequences or ["*"], options.data)
    if not options.paper:
        return names
    selected = paper_sequences(names)
    others = set(names) - set(selected)
    if options.sequences and others:
        raise ConfigError(f"--paper knows the paper's sequences only: leave {', '.join(sorted(others))} out.")
    return selected


def _print(options: argparse.Namespace, question: Question | None, rows: Sequence[VariantResults]) -> None:
    if question is not None:
        print(question.table(rows))
    elif options.masks:
        print(comparison_text(compared(rows, options.columns or COMPARED_COLUMNS)))
        _print_remarks(rows)
    elif options.paper:
        print(paper_tables(rows[0].results))
        _print_remarks(rows)
    else:
        _print_figures(rows[0].results)
        if options.reliability:
            print(reliability_table([one for result in rows[0].results for one in result.masks]) + "\n")
        _print_remarks(rows)
    _print_failures(rows)


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


def _print_remarks(rows: Sequence[VariantResults]) -> None:
    remarks = (f"{one.name}: {one.remark}" for row in rows for one in row.results if one.remark)
    sheets = (f"{one.name}: see {path}" for row in rows for one in row.results for path in one.sheets)
    for line in dict.fromkeys([*remarks, *sheets]):  # each once, of whatever number of methods
        print(line)


def _print_failures(rows: Sequence[VariantResults]) -> None:
    for row in rows:
        for result in row.results:
            name = f"{row.variant.name}, {result.name}" if row.variant.name else result.name
            if result.error:
                print(f"{name}: {result.error}", file=sys.stderr)
            if result.missing:
                print(f"{name}: {result.missing} frames with truth have no labels.", file=sys.stderr)


def _write_files(
    options: argparse.Namespace,
    question: Question | None,
    ran: Mapping[str, Any],
    rows: Sequence[VariantResults],
) -> None:
    if options.json:
        write_json(options.json, dict(ran) | _as_json(options, question, rows))
    if options.csv:
        write_csv(options.csv, rows)
    if options.summary:
        write_summary(options.summary, rows)
    if options.latex and options.masks:
        write_comparison_latex(options.latex, compared(rows, options.columns or COMPARED_COLUMNS))
    elif options.latex:
        write_latex(options.latex, rows[0].results, options.columns or LATEX_COLUMNS)
    if options.plots:
        for path in write_plots(options.plots, rows):
            print(f"see {path}")
        for row in rows:
            if precision_recall(row.results) is None:
                name = f"{row.variant.name}: " if row.variant.name else ""
                print(
                    f"{name}no precision over recall is drawn: it needs objects in the truth, and the scores "
                    "of the masks, which the tables of a run have (parquet in --save)."
                )


def _what_ran(options: argparse.Namespace) -> dict[str, Any]:
    """Return whose labels were scored: those of folders, or of an engine of these parameters and versions."""
    if options.run:
        return {"run": str(options.run)}
    if options.masks:
        return {"masks": {one.name: str(one.folder) for one in mask_folders(options.masks)}}
    config = load_config(options.config, _overrides(options))
    changed = config.model_dump(mode="json", exclude_defaults=True)
    stored = {
        name: None if folder is None else str(folder)
        for name, folder in (("flow", options.flow), ("tracks", options.tracks))
    }
    return {"parameters": changed, **stored, "versions": installed_versions()}


def _as_json(
    options: argparse.Namespace, question: Question | None, rows: Sequence[VariantResults]
) -> dict[str, Any]:
    if question is not None:
        return question.as_json(rows)
    return comparison_as_json(rows) if options.masks else results_as_json(rows[0].results)
