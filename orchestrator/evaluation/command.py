"""The command ``scripts/evaluate``: score a finished run, or the engine, on sequences with truth."""

from __future__ import annotations

import argparse
import fnmatch
import glob
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mlbs_actors.config import load_config
from mlbs_actors.errors import ConfigError, MlbsError
from orchestrator.command_line import LEAST_SIDE
from orchestrator.evaluation import datasets
from orchestrator.evaluation.ablation import ablation_table, ablation_variants
from orchestrator.evaluation.disturbance import disturbance_as_json, disturbance_table, disturbance_variants
from orchestrator.evaluation.figure_files import LATEX_COLUMNS, write_csv, write_json, write_latex
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
from orchestrator.run.run_folder import read_description
from orchestrator.sources.synthetic import SCHEME, scene_from_uri

__all__ = ["main"]

DESCRIPTION = """\
Score label maps against truth.

  scripts/evaluate --run out --truth cars1=data/cars1/gt    the masks a run wrote in out/cars1/masks
  scripts/evaluate --run out --truth 'DAVIS/Annotations/480p/*'
                                                            those of its streams that have a folder's name
  scripts/evaluate --data data                              the engine, in process, on every sequence below
                                                            data: frames/ and gt/, or as DAVIS, YouTube-VOS,
                                                            BMS-26 and FBMS come
  scripts/evaluate --sequences 'synthetic:demo?frames=60'   the engine on a scene with exact truth
  scripts/evaluate --data data --paper                      the tables of the paper, with our figures
  scripts/evaluate --data data --ablate                     what each stage of the method gives
  scripts/evaluate --data data --disturb                    how much accidents of parameters and input cost
  scripts/evaluate --data data --sizes 480,960              what the engine finds in smaller or larger
                                                            pictures, and what that costs

Truth maps are PNG: 0 = background, 1 ... 254 = objects, 255 = not judged (an
object where 0 and 255 are the only values, as in DAVIS 2016). Figures are percent, except
extra (layers off the truth per 100 frames), ids_on (labels that lie mostly on an object in at least three
frames, mean over the objects), switches (of identity), delay (median frames from an object's entry until it
is found; synthetic scenes only), ms and cpu_ms (wall and CPU time a frame). These matter most:

  two_label_f      moving against not moving: mean F of the frames;  j: the same with intersection over union
  f, j&f           F of DAVIS, of the boundaries of what moves; the mean of j and f
  object_f         every object of the truth on its own: mean F, 0 for a lost one
  track_j          one label for each object over all frames: mean intersection over union
  multi_f          the same, and a layer the truth does not know counts as a lost one too (the paper's text)
  multi_f_matlab   as the paper's table was made: the background takes part, surplus layers do not count
  first ten, after start, davis: of these frames only (davis: without the first and the last)
  davis17          one label for each object over all frames, as in DAVIS 2017's unsupervised task
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : sequence of str or None
        Without the program's name; None: those of this process.

    Returns
    -------
    int
        0: all scored; 1: some sequence could not be scored, or not all of its frames with truth had a mask;
        2: wrong usage.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    unknown = [name for name in options.columns if name not in COLUMNS]
    if unknown:
        parser.error(f"There is no column {unknown[0]}; those of --columns are: {', '.join(COLUMNS)}.")
    try:
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
        _write_files(options, rows)
    except MlbsError as error:
        parser.error(str(error))
    return int(any(result.error or result.missing for row in rows for result in row.results))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/evaluate", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--run", type=Path, metavar="OUT_DIR", help="score the masks of this finished run; needs --truth"
    )
    what.add_argument(
        "--paper",
        action="store_true",
        help="run the engine on those of the paper's ten sequences that are there, and print the paper's "
        "tables 1 to 4 with our figures beside the published ones; --jobs 1 for times without contention",
    )
    what.add_argument(
        "--ablate",
        action="store_true",
        help="run the engine once for each stage of the method: first with all stages off, then with one "
        "more each time; then once for each of some parts that the whole method is left without; prints "
        "means, and two_label_f of each sequence",
    )
    what.add_argument(
        "--disturb",
        action="store_true",
        help="run the engine as it is, then disturbed: parameters 20 %% off, frames left out, mirrored, "
        "cropped by 3 px, because there is no seed to change, a frame lost, in new light, and with a clock, "
        "a logo, a bonnet or bars drawn over; prints the same and names the worst run. "
        "Each run is judged on the frames it has",
    )
    what.add_argument(
        "--sizes",
        type=_sides,
        metavar="PX,...",
        help="run the engine on the pictures as they are, then shrunk or enlarged to each of these longer "
        "sides; prints means of figures in the size of the truth, and the CPU time; --jobs 1 for times "
        "without contention",
    )
    add(
        "--truth",
        nargs="+",
        default=[],
        metavar="NAME=GT_DIR",
        help="a stream of the run and its truth: a folder of PNG label maps with the masks' stems, a folder "
        "of BMS-26 or FBMS, or a synthetic: URI; or a folder or quoted glob of folders, each for the stream "
        "of its name",
    )
    add(
        "--data",
        type=Path,
        metavar="ROOT",
        help="run the engine on the sequences below this folder "
        f"(default: the environment variable {datasets.DATA_VARIABLE})",
    )
    add(
        "--sequences",
        type=lambda text: [name for name in text.split(",") if name],
        metavar="NAME,...",
        help="only these: by their folders below ROOT, as in mlbs/cars1, also globs such as '480p/*', or "
        "synthetic:NAME?frames=60&seed=1",
    )
    add("--lookahead", type=int, metavar="N", help="the same as --set layers.lookahead=N")
    add("--config", type=Path, metavar="FILE", help="YAML file with parameters of the engine")
    add(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="parameters of the engine, after those of --config",
    )
    add(
        "--flow",
        type=Path,
        metavar="FOLDER",
        help="use stored flow in place of the engine's own: forward/NAME/STEM.flo from a frame to the next, "
        "backward/NAME/STEM.flo to the one before, or .npy",
    )
    add(
        "--reliability",
        action="store_true",
        help="also print how well the score of a mask says its intersection over union with the truth",
    )
    add(
        "--jobs",
        type=int,
        default=2,
        metavar="N",
        help="runs of the engine at the same time (default 2)",
    )
    add("--json", type=Path, metavar="FILE", help="write all figures there, also by range of frames")
    add("--csv", type=Path, metavar="FILE", help="write a row for each frame with truth there")
    add("--latex", type=Path, metavar="FILE", help="write a table of the sequences there")
    add(
        "--columns",
        type=lambda text: text.split(","),
        default=LATEX_COLUMNS,
        metavar="NAME,...",
        help=f"of the LaTeX table, by their headings here (default {','.join(LATEX_COLUMNS)})",
    )
    add("--sheets", type=Path, metavar="DIR", help="write contact sheets there: labels, truth, difference")
    return parser


def _sides(text: str) -> list[int]:
    sides = [int(one) if one.isdecimal() else 0 for one in text.split(",")]
    if min(sides) < LEAST_SIDE:
        raise argparse.ArgumentTypeError(f"{text!r} must be px, {LEAST_SIDE} or more each, as in 480,960")
    return sides


def _score_run(options: argparse.Namespace) -> list[VariantResults]:
    if not options.truth:
        raise ConfigError(
            "--run needs --truth: NAME=GT_DIR for each stream to score, or folders of that name."
        )
    for_engine = ("data", "sequences", "set", "lookahead", "config", "flow")
    if any(getattr(options, one) not in (None, []) for one in for_engine):
        given = ", ".join(f"--{one}" for one in for_engine)
        raise ConfigError(f"--run scores finished masks: leave {given} out.")
    sources = (read_description(options.run) or {}).get("sources", {})
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
    overrides = list(options.set)
    if options.lookahead is not None:
        overrides.append(f"layers.lookahead={options.lookahead}")
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


def _write_files(options: argparse.Namespace, rows: Sequence[VariantResults]) -> None:
    if options.json:
        write_json(options.json, _as_json(options, rows))
    if options.csv:
        write_csv(options.csv, rows[0].results)
    if options.latex:
        write_latex(options.latex, rows[0].results, options.columns)


def _as_json(options: argparse.Namespace, rows: Sequence[VariantResults]) -> dict[str, Any]:
    if options.ablate or options.sizes:
        return variants_as_json(rows)
    if options.disturb:
        return disturbance_as_json(rows)
    return results_as_json(rows[0].results)
