"""``python -m orchestrator.export FORMAT RUN_DIR OUT``."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from mlbs_actors.errors import ConfigError
from orchestrator.durable_files import temporary_path
from orchestrator.export.coco import write_coco
from orchestrator.export.mots import write_mots
from orchestrator.export.palette_masks import write_davis, write_youtube_vos

__all__ = ["FORMATS", "main"]


def _write_rerun(run: Path, out: Path) -> None:
    try:
        from orchestrator.export.rerun_recording import write_rerun
    except ImportError:
        raise ConfigError(
            "The export to rerun needs the package rerun-sdk; pip install 'mlbs-actors[rerun]'."
        ) from None
    write_rerun(run, out)


#: Formats by name.
FORMATS: dict[str, Callable[[Path, Path], None]] = {
    "coco": write_coco,
    "mots": write_mots,
    "davis": write_davis,
    "youtube-vos": write_youtube_vos,
    "rerun": _write_rerun,
}

#: Those that are one file; the others are folders.
_FILES = ("coco", "rerun")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 written, 1 the disk refused, 2 it cannot be done."""
    parser = argparse.ArgumentParser(
        prog="python -m orchestrator.export",
        description="Write what a run has committed in the format of other tools.",
        epilog="coco: one JSON file; mots: a text file a stream; davis, youtube-vos: indexed PNG masks; "
        "rerun: a recording for the viewer of rerun.io",
        allow_abbrev=False,
    )
    parser.add_argument("format", choices=FORMATS)
    parser.add_argument("run", type=Path, metavar="RUN_DIR", help="the run's output folder")
    parser.add_argument("out", type=Path, metavar="OUT", help="what to write; must not be there yet")
    given = parser.parse_args(argv)
    try:
        _export(given.format, given.run, given.out)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{given.out} cannot be written: {error.strerror}.", file=sys.stderr)
        return 1
    print(given.out)
    return 0


def _export(name: str, run: Path, out: Path) -> None:
    """Write under a temporary name, so that ``out`` is whole or not there."""
    if out.exists():
        raise ConfigError(f"{out} is there already; name another place to write to.")
    draft = temporary_path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    if draft.is_dir():  # of an export that was killed
        shutil.rmtree(draft)
    if name not in _FILES:
        draft.mkdir()
    try:
        FORMATS[name](run, draft)
        draft.rename(out)
    finally:
        if draft.is_dir():
            shutil.rmtree(draft)
        draft.unlink(missing_ok=True)


if __name__ == "__main__":
    sys.exit(main())
