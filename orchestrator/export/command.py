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
from orchestrator.export.made_folder import is_made, mark_made
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


def export(form: str, run: Path, out: Path, *, internals: bool = False, replace: bool = False) -> int:
    """Write a run in a format; return the exit status: 0 written, 1 a disk error, 2 impossible.

    Parameters
    ----------
    form : str
        Key of :data:`WRITERS`.
    run : Path
        The run's output folder.
    out : Path
        Must not be there yet, unless it may be replaced.
    internals : bool
        Of ``rerun`` only: with all that is inside the layers.
    replace : bool
        Whether a file that is there already is replaced, or a folder that an export has made.
    """
    write = WRITERS[form]
    try:
        if internals:
            if form != "rerun":
                raise ConfigError("--internals goes with the format rerun only; leave it out.")
            write = partial(_write_rerun, internals=True)
        _write(write, form in _FILES, run, out, replace=replace)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{out} cannot be written: {error.strerror}.", file=sys.stderr)
        return 1
    print(out)
    return 0


def _write(write: _Writer, is_file: bool, run: Path, out: Path, *, replace: bool) -> None:
    """Write under a temporary name, so that ``out`` is complete, as it was, or missing."""
    _refuse_if_there(is_file, run, out, replace=replace)
    draft = temporary_path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    if draft.is_dir():  # of an export that was killed
        shutil.rmtree(draft)
    if not is_file:
        draft.mkdir()
    try:
        for remark in write(run, draft) or ():
            print(remark, file=sys.stderr)
        _refuse_if_there(is_file, run, out, replace=replace)  # by now, as it may have taken hours
        if not is_file:
            mark_made(draft)
            if out.exists():
                shutil.rmtree(out)
        draft.replace(out)
    finally:
        if draft.is_dir():
            shutil.rmtree(draft)
        draft.unlink(missing_ok=True)


def _refuse_if_there(is_file: bool, run: Path, out: Path, *, replace: bool) -> None:
    """Raise ConfigError if anything is in the way that is not, or must not be, replaced."""
    if not out.exists():
        return
    if out.is_dir() if is_file else not is_made(out, run):
        raise ConfigError(f"{out} was not made by an export to this format, and stays; name another place.")
    if is_file and out.resolve().is_relative_to(run.resolve()):
        raise ConfigError(
            f"{out} is there already, in the run's own folder, in which no file is replaced; name a place "
            "outside of it."
        )
    if not replace:
        raise ConfigError(f"{out} is there already; name another place to write to, or add --replace.")
