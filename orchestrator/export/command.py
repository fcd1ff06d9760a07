"""Writes what a run has committed in the format of another tool: ``mlbs-actors export``."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

from mlbs_actors.errors import ConfigError
from orchestrator.export.coco import write_coco
from orchestrator.export.csv_table import write_csv
from orchestrator.export.mot import write_mot
from orchestrator.export.mots import write_mots
from orchestrator.export.overlay import write_overlays
from orchestrator.export.palette_masks import write_davis, write_youtube_vos
from orchestrator.storage.durable_files import temporary_path

__all__ = ["WRITERS", "export"]

#: Writes a run's record into a file or an existing folder; may return remarks for the user.
_Writer: TypeAlias = Callable[[Path, Path], Sequence[str] | None]


def _write_rerun(run: Path, out: Path, *, internals: bool = False) -> Sequence[str]:
    try:
        from orchestrator.export.rerun_recording import write_rerun
    except ImportError:
        raise ConfigError(
            "The export to rerun needs the package rerun-sdk; pip install 'mlbs-actors[rerun]'."
        ) from None
    return write_rerun(run, out, internals=internals)


#: By the name of the format.
WRITERS: dict[str, _Writer] = {
    "csv": write_csv,
    "coco": write_coco,
    "mot": write_mot,
    "mots": write_mots,
    "davis": write_davis,
    "youtube-vos": write_youtube_vos,
    "overlay": write_overlays,
    "rerun": _write_rerun,
}

#: Those that are one file; the others are folders.
_FILES = ("csv", "coco", "rerun")


def export(form: str, run: Path, out: Path, *, internals: bool = False) -> int:
    """Write a run in a format; return the exit status: 0 written, 1 a disk error, 2 impossible.

    Parameters
    ----------
    form : str
        Key of :data:`WRITERS`.
    run : Path
        The run's output folder.
    out : Path
        Must not be there yet.
    internals : bool
        Of ``rerun`` only: with all that is inside the layers.
    """
    write = WRITERS[form]
    try:
        if internals:
            if form != "rerun":
                raise ConfigError("--internals goes with the format rerun only; leave it out.")
            write = partial(_write_rerun, internals=True)
        _write(write, form in _FILES, run, out)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{out} cannot be written: {error.strerror}.", file=sys.stderr)
        return 1
    print(out)
    return 0


def _write(write: _Writer, is_file: bool, run: Path, out: Path) -> None:
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
        for remark in write(run, draft) or ():
            print(remark, file=sys.stderr)
        draft.rename(out)
    finally:
        if draft.is_dir():
            shutil.rmtree(draft)
        draft.unlink(missing_ok=True)
