"""A state of a run's folder that fits together, taken while the run goes on.

It is one that a kill could have left, so that a run resumes from it as from that. A stream's files are taken
under the lock of its commits: between two of them. They are linked, not copied, so that lasts milliseconds,
and what is deleted or replaced meanwhile stays there. The files of the whole run are taken before those of
the streams: as after a kill, ``status.json`` may be behind the records, but never ahead of them.

A folder that has lost its run, by whatever deletes files, is no state of it: publishing that would delete the
only copy that is left.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from mlbs_actors.errors import SinkError
from mlbs_actors.record.commits import Commit, permanent, read_commits
from orchestrator.storage.commit_log import between_commits
from orchestrator.storage.segments import segment_folders
from orchestrator.storage.snapshot_folder import SNAPSHOTS

__all__ = ["HeldFile", "HeldFiles", "LostFolderError"]

#: In a stream's folder: locks, and a camera's own packets, which go within two minutes.
_NOT_KEPT = (".lock", ".packets")

#: File by which the folder of a stream's record is known.
_RECORD = ".generation"

#: File by which the folder of a run is known.
_RUN = "run.json"

#: How often a stream is taken anew because files went without the lock, as snapshots do at its end, and the
#: whole folder because a stream got another name.
_ATTEMPTS = 5


class LostFolderError(SinkError):
    """The folder does not hold the run any more that was in it."""


@dataclass(frozen=True, slots=True)
class HeldFile:
    """A file of the run, as it was.

    Attributes
    ----------
    size : int
        How many of its bytes count.
    inode, changed : int
        Which file it is, and when it was written last, ns: they tell that it is the same as before.
    growing : bool
        Whether it is only ever appended to, as long as it is the same one.
    cut : bool
        Of a growing one: whether a stream that goes back cuts it off, and goes on with other bytes.
    """

    size: int
    inode: int
    changed: int
    growing: bool = False
    cut: bool = False


class HeldFiles:
    """Takes the state of a run's folder again and again.

    Parameters
    ----------
    run : Path
        The run's folder.
    place : Path
        Folder on the same file system for the links; emptied.
    published : iterable of str
        Paths of files that are published of it.
    """

    def __init__(self, run: Path, place: Path, published: Iterable[str] = ()) -> None:
        self._run = run
        self._place = place
        names = frozenset(published)
        self._begun = _RUN in names
        self._generations = dict.fromkeys(_records_among(names), 0)
        shutil.rmtree(place, ignore_errors=True)

    def take(
        self, known: Mapping[str, HeldFile], copies: Mapping[str, Callable[[Path], bool]]
    ) -> dict[str, HeldFile]:
        """Return all files by their paths in the run's folder; those that are not known so are linked.

        Parameters
        ----------
        known : mapping of str to HeldFile
        copies : mapping of str to callable
            Names of hidden files of the whole run → what writes a copy to a path, if there is one.

        Raises
        ------
        OSError, SinkError
            If a stream does not let itself be taken, or the disk does not allow it; then nothing is held.
            LostFolderError if the run, or a stream that it had, is there no more.
        """
        try:
            for _ in range(_ATTEMPTS):
                self.drop()
                taken = self._whole(known, copies)
                generations = self._generations_of(_records_among(taken))
                missing = self._missing(taken, generations)
                if not missing:
                    self._begun, self._generations = _RUN in taken, generations
                    return taken
        except BaseException:
            self.drop()
            raise
        self.drop()
        raise self._lost(missing)

    def check(self) -> None:
        """Raise LostFolderError if the run, or a stream that it had, is there no more."""
        there = [name for name in (_RUN,) if (self._run / name).exists()]
        records = [path.parent.name for path in self._run.glob(f"*/{_RECORD}")]
        missing = self._missing(there, self._generations_of(records))
        if missing:
            raise self._lost(missing)

    def path(self, name: str) -> Path:
        """Return where the content of a file is that was linked; OSError in use if it was not."""
        return self._place / name

    def drop(self) -> None:
        """Hold nothing any more."""
        shutil.rmtree(self._place, ignore_errors=True)

    def _whole(
        self, known: Mapping[str, HeldFile], copies: Mapping[str, Callable[[Path], bool]]
    ) -> dict[str, HeldFile]:
        self._place.mkdir(parents=True)
        taken: dict[str, HeldFile] = {}
        for name, copy in copies.items():
            if copy(self._place / name):
                taken[name] = _as_it_is(self._place / name)
        for entry in sorted(self._run.glob("*")):
            with suppress(FileNotFoundError):  # deleted just now
                if entry.is_file() and not entry.name.startswith("."):
                    self._link(entry.name, _as_it_is(entry), known, taken)
        for folder in sorted(path.parent for path in self._run.glob(f"*/{_RECORD}")):
            taken |= self._stream(folder, known)
        return taken

    def _generations_of(self, records: Iterable[str]) -> dict[str, int]:
        """Return how often each stream has been opened, which only ever grows."""
        found = {}
        for name in records:
            with suppress(FileNotFoundError, ValueError):
                found[name] = int((self._run / name / _RECORD).read_text(encoding="ascii"))
        return found

    def _missing(self, there: Collection[str], generations: Mapping[str, int]) -> list[str]:
        """Return what the run had and has no more; a stream that got another name is not missing."""
        if self._begun and _RUN not in there:
            return [_RUN]
        before = self._generations
        missing = [name for name, number in before.items() if generations.get(name, -1) < number]
        return missing if len(missing) > len(generations.keys() - before.keys()) else []

    def _lost(self, missing: Sequence[str]) -> LostFolderError:
        return LostFolderError(
            f"{self._run} has lost {', '.join(missing)}, so nothing more is published from it, and what is "
            "published stays. See that its disk is there; if the files are gone, delete what is left of that "
            "folder: the same command with --resume then goes on with what is published."
        )

    def _stream(self, folder: Path, known: Mapping[str, HeldFile]) -> dict[str, HeldFile]:
        for _ in range(_ATTEMPTS):
            taken: dict[str, HeldFile] = {}
            with between_commits(folder), suppress(FileNotFoundError):
                for path, held in _files_of(folder):
                    self._link(path.relative_to(self._run).as_posix(), held, known, taken)
                return taken
            shutil.rmtree(self._place / folder.name, ignore_errors=True)
        raise SinkError(f"The files in {folder} go while they are looked at.")

    def _link(
        self, name: str, held: HeldFile, known: Mapping[str, HeldFile], taken: dict[str, HeldFile]
    ) -> None:
        if known.get(name) != held:
            target = self._place / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if held.cut:
                shutil.copyfile(self._run / name, target)
            else:
                os.link(self._run / name, target)
        taken[name] = held


def _records_among(names: Iterable[str]) -> list[str]:
    """Return the streams of which the record is among these files."""
    paths = map(PurePosixPath, names)
    return [path.parts[0] for path in paths if len(path.parts) == 2 and path.name == _RECORD]


def _as_it_is(path: Path, *, growing: bool = False) -> HeldFile:
    stat = path.stat()
    return HeldFile(stat.st_size, stat.st_ino, stat.st_mtime_ns, growing, cut=growing)


def _files_of(stream: Path) -> Iterator[tuple[Path, HeldFile]]:
    """Yield the files of a stream that a resumed run needs or a user wants."""
    commits = read_commits(stream)
    segments = {one.segment: one for one in commits if one.segment is not None}  # the last line of each
    closed = {one.segment for one in commits if one.merged}
    folders = {path.name for path in segment_folders(stream)}
    snapshot = _snapshot(commits)
    with os.scandir(stream) as entries:
        names = sorted(entry.name for entry in entries)
    for name in names:
        path = stream / name
        if name in _NOT_KEPT or _is_draft(name):
            continue
        if name == SNAPSHOTS:
            if snapshot is not None:
                yield from _below(path / snapshot)
        elif name in folders:
            if name in segments:
                yield from _of_segment(path, segments[name], is_closed=name in closed)
        elif path.is_dir():
            yield from _below(path)
        else:
            yield path, _as_it_is(path, growing=path.suffix == ".jsonl")


def _of_segment(folder: Path, last: Commit, *, is_closed: bool) -> Iterator[tuple[Path, HeldFile]]:
    for path, held in _below(folder):
        if path.suffix == ".tar" and not is_closed:
            counts = last.archived.get(path.stem, 0)
            yield path, HeldFile(counts, held.inode, held.changed, growing=True)
        elif path.suffix == ".mp4" and not is_closed:
            yield path, HeldFile(held.size, held.inode, held.changed, growing=True)
        else:
            yield path, held


def _below(folder: Path) -> Iterator[tuple[Path, HeldFile]]:
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not _is_draft(name))
        for name in sorted(names):
            if not _is_draft(name):
                yield Path(place, name), _as_it_is(Path(place, name))


def _snapshot(commits: list[Commit]) -> str | None:
    """Return the one that a run resumes from: older ones are for damage to the disk."""
    lasting = permanent(commits)
    return lasting[-1].snapshot if lasting else None


def _is_draft(name: str) -> bool:
    return name.startswith(".") and name.endswith(".part")
