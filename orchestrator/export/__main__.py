"""``python -m orchestrator.export FORMAT RUN_DIR OUT``."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from mlbs_actors.errors import ConfigError
from orchestrator.export.coco import write_coco
from orchestrator.export.csv_table import write_csv
from orchestrator.export.mot import write_mot
from orchestrator.export.mots import write_mots
from orchestrator.export.overlay import write_overlays
from orchestrator.export.palette_masks import write_davis, write_youtube_vos
from orchestrator.storage.durable_files import temporary_path

__all__ = ["FORMATS", "main"]


def _write_rerun(run: Path, out: Path, *, internals: bool = False) -> None:
    try:
        from orchestrator.export.rerun_recording import write_rerun
    except ImportError:
        raise ConfigError(
            "The export to rerun needs the package rerun-sdk; pip install 'mlbs-actors[rerun]'."
        ) from None
    for remark in write_rerun(run, out, internals=internals):
        print(remark, file=sys.stderr)


def _write_overlays(run: Path, out: Path) -> None:
    for remark in write_overlays(run, out):
        print(remark, file=sys.stderr)


#: Formats by name.
FORMATS: dict[str, Callable[[Path, Path], None]] = {
    "csv": write_csv,
    "coco": write_coco,
    "mot": write_mot,
    "mots": write_mots,
    "davis": write_davis,
    "youtube-vos": write_youtube_vos,
    "overlay": _write_overlays,
    "rerun": _write_rerun,
}

#: Those that are one file; the others are folders.
_FILES = ("csv", "coco", "rerun")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 written, 1 a disk error, 2 impossible."""
    parser = argparse.ArgumentParser(
        prog="python -m orchestrator.export",
        description="Write what a run has committed in the format of other tools.",
        epilog="csv: one table, a row per frame and object; coco: one JSON file; mot, mots: a text file a "
        "stream, of boxes or masks; davis, youtube-vos: indexed PNG masks; overlay: videos with the labels, "
        "drawn anew; rerun: a recording for the viewer of rerun.io",
        allow_abbrev=False,
    )
    parser.add_argument("format", choices=FORMATS)
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="the run's output folder")
    parser.add_argument("out", type=Path, metavar="OUT", help="what to write; must not be there yet")
    parser.add_argument(
        "--internals",
        action="store_true",
        help="rerun only: segment the streams once more, which takes its time, and record the trajectories, "
        "motion fields and posteriors of every layer too; not of cameras",
    )
    given = parser.parse_args(argv)
    write = FORMATS[given.format]
    try:
        if given.internals:
            if given.format != "rerun":
                raise ConfigError("--internals goes with the format rerun only; leave it out.")
            write = partial(_write_rerun, internals=True)
        _export(write, given.format in _FILES, given.run, given.out)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{given.out} cannot be written: {error.strerror}.", file=sys.stderr)
        return 1
    print(given.out)
    return 0


def _export(write: Callable[[Path, Path], None], is_file: bool, run: Path, out: Path) -> None:
    """Write under a temporary name, so that ``out`` is complete or missing."""
    if out.exists():
        raise ConfigError(f"{out} is there already; name another place to write to.")
    draft = temporary_path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    if draft.is_dir():  # of an export that was killed
        shutil.rmtree(draft)
    if not is_file:
        draft.mkdir()
    try:
        write(run, draft)
        draft.rename(out)
    finally:
        if draft.is_dir():
            shutil.rmtree(draft)
        draft.unlink(missing_ok=True)


if __name__ == "__main__":
    sys.exit(main())
