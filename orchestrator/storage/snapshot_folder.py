"""The snapshots of a stream on disk: which are complete, which one to go back to, which can be removed.

``snapshots/GENERATION/READ/`` holds a file for each part, after that many rows read. The parts' processes
write them; once all are complete a list of them is added, which makes the snapshot valid. Generations have
separate folders, so files that a killed run's processes still write are not mistaken for those of this run.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass
from pathlib import Path

from mlbs_actors.actors.stream.protocol import Snapshot
from mlbs_actors.errors import SnapshotError
from mlbs_actors.state_file import capture, check_file, read_state

__all__ = ["SNAPSHOTS", "SnapshotFolder"]

#: Folder in a stream's folder.
SNAPSHOTS = "snapshots"

#: File that completes a snapshot.
_LIST = "parts"

_KEPT = 2

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Parts:
    """Content of that file."""

    rows: int
    label_maps: int
    names: tuple[str, ...]


class SnapshotFolder:
    """The snapshots of one stream.

    Parameters
    ----------
    path : Path
    generation : int
        Of the opened record.
    rows : int
        Rows of the record that count: later snapshots are useless.

    Attributes
    ----------
    place : Path
        Folder of new snapshots.
    newest : Snapshot or None
        Newest complete one found on opening.
    """

    def __init__(self, path: Path, generation: int, rows: int) -> None:
        self._path = path
        self.place = path / str(generation)
        self._whole: list[Snapshot] = []
        for folder in path.glob("*/*"):
            snapshot = _found(folder)
            if snapshot is not None and snapshot.rows <= rows:
                self._whole.append(snapshot)
        # Of those after the same row the last one, compared as numbers: the longer is the greater.
        self._whole.sort(key=lambda one: (one.rows, len(str(one.folder)), one.folder))
        self.newest = self._whole[-1] if self._whole else None
        self._forget_all_but(self._whole[-_KEPT:])

    def keep(self, snapshot: Snapshot) -> bool:
        """Complete a snapshot if all its files are there.

        Raises
        ------
        OSError
            As the disk says.
        """
        if not all((snapshot.folder / name).exists() for name in snapshot.parts):
            return False
        capture(_Parts(snapshot.rows, snapshot.label_maps, snapshot.parts)).write(snapshot.folder / _LIST)
        self._whole.append(snapshot)
        return True

    def name_after(self, rows: int) -> str | None:
        """Return the name of the newest snapshot to go back to once ``rows`` rows count."""
        usable = [snapshot for snapshot in self._whole if snapshot.rows <= rows]
        return str(usable[-1].folder.relative_to(self._path)) if usable else None

    def forget_before(self, rows: int) -> None:
        """Delete all snapshots but the newest two of a record of ``rows`` rows and later ones."""
        usable = [snapshot for snapshot in self._whole if snapshot.rows <= rows]
        for snapshot in usable[:-_KEPT]:
            shutil.rmtree(snapshot.folder, ignore_errors=True)
            self._whole.remove(snapshot)

    def forget_all(self) -> None:
        """Delete all, as the stream has come to its end."""
        shutil.rmtree(self._path, ignore_errors=True)

    def _forget_all_but(self, kept: list[Snapshot]) -> None:
        folders = {snapshot.folder for snapshot in kept}
        for folder in self._path.glob("*/*"):
            if folder not in folders:
                shutil.rmtree(folder, ignore_errors=True)
        self._whole = kept


def _found(folder: Path) -> Snapshot | None:
    """Return the snapshot in a folder, if it is complete and undamaged."""
    if not (folder / _LIST).exists():
        return None
    try:
        parts = read_state(folder / _LIST, _Parts)
        for name in parts.names:
            check_file(folder / name)
    except SnapshotError as error:
        _log.warning("A snapshot is passed over: %s", error)
        return None
    return Snapshot(folder, parts.rows, parts.label_maps, parts.names)
