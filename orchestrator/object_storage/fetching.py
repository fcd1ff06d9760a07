"""Makes a folder of what counts in a store: for a run that goes on elsewhere, and for all that reads one."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory

from orchestrator.object_storage.ledger import read_standing
from orchestrator.object_storage.manifest import Part
from orchestrator.object_storage.store import MissingObjectError, ObjectStore, StoreError
from orchestrator.object_storage.uploads import digest_of

__all__ = ["fetch", "fetch_files"]

_REQUESTS_AT_ONCE = 8

#: Longer objects are read piece by piece, bytes.
_PIECE = 1 << 25

#: How often what counts is read anew, because a run that is at work has replaced what was to be read.
_ATTEMPTS = 10


def fetch(store: ObjectStore, folder: Path) -> int:
    """Make a folder of what counts now, even while a run is at work; return the number of files.

    A run deletes what it has replaced a minute ago. So what a long fetch does not find any more is looked up
    in what counts by then, and what it has of that already is not read again.

    Parameters
    ----------
    store : ObjectStore
    folder : Path
        Made when it is complete; there is nothing under its name.

    Raises
    ------
    StoreError
        If the store cannot be read, or what it has is damaged.
    OSError
        As the disk says.
    """
    with _draft_of(folder) as path:
        draft = _Draft(store, path)
        for _ in range(_ATTEMPTS):
            files = read_standing(store).files
            try:
                draft.fill(files)
            except MissingObjectError:
                continue
            path.rename(folder)
            return len(files)
    raise StoreError("what is to be read is replaced faster than it can be read")


def fetch_files(
    store: ObjectStore, files: Mapping[str, Sequence[Part]], folder: Path, *, durable: bool = False
) -> None:
    """Make a folder of files; it gets its name when it is complete, with ``durable`` also after a power cut.

    Raises
    ------
    StoreError
        MissingObjectError if the files do not count any more.
    OSError
        As the disk says.
    """
    with _draft_of(folder) as path:
        _Draft(store, path).fill(files)
        if durable:
            os.sync()
        path.rename(folder)


@contextmanager
def _draft_of(folder: Path) -> Iterator[Path]:
    """Make an empty folder beside another one, on the same disk; deleted, unless it has been renamed."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.", suffix=".part") as hidden:
        draft = Path(hidden, folder.name)  # the hidden one is for its owner alone
        draft.mkdir()
        yield draft


class _Draft:
    """A folder that is filled, if need be again and again as other files count."""

    def __init__(self, store: ObjectStore, folder: Path) -> None:
        self._store = store
        self._folder = folder
        # File → place in it → digest of the part that was written there.
        self._written: dict[str, dict[int, str]] = {}

    def fill(self, files: Mapping[str, Sequence[Part]]) -> None:
        """Make the folder hold these files alone; read what it does not have of them.

        Raises
        ------
        MissingObjectError
            If objects are missing; what is in all others has been read then.
        StoreError
        OSError
        """
        for name in self._written.keys() - files.keys():
            self._delete(name)
        wanted: defaultdict[str, list[tuple[str, int, Part]]] = defaultdict(list)
        for name, parts in files.items():
            places = [0, *accumulate(part.size for part in parts)]
            self._prepare(name, places[-1])
            written = self._written.get(name, {})
            self._written[name] = {}
            for place, part in zip(places, parts, strict=False):
                if written.get(place) == part.digest:
                    self._written[name][place] = part.digest
                else:
                    wanted[part.key].append((name, place, part))
        with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
            missing = [one for one in pool.map(lambda key: self._read(key, wanted[key]), wanted) if one]
        if missing:
            raise missing[0]

    def _prepare(self, name: str, size: int) -> None:
        path = self._folder / name
        if not path.resolve().is_relative_to(self._folder.resolve()):
            raise StoreError(f"its manifest names {name!r}, which is not in the run's folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab") as file:
            file.truncate(size)

    def _delete(self, name: str) -> None:
        """Delete a file, and the folders that are empty without it."""
        del self._written[name]
        path = self._folder / name
        path.unlink()
        with suppress(OSError):
            for parent in path.relative_to(self._folder).parents[:-1]:
                (self._folder / parent).rmdir()

    def _read(self, key: str, pieces: Sequence[tuple[str, int, Part]]) -> MissingObjectError | None:
        """Read an object, and write what is wanted of it; return the error if there is none."""
        try:
            if len(pieces) > 1:
                whole = self._store.get(key)
                for name, place, part in pieces:
                    self._write(name, place, part, iter((whole[part.begin : part.begin + part.size],)))
            else:
                ((name, place, part),) = pieces
                self._write(name, place, part, _read(self._store, part))
        except MissingObjectError as error:
            return error
        return None

    def _write(self, name: str, place: int, part: Part, content: Iterator[bytes]) -> None:
        def written() -> Iterator[bytes]:
            with (self._folder / name).open("r+b") as file:
                file.seek(place)
                for piece in content:
                    file.write(piece)
                    yield piece

        if digest_of(written()) != part.digest:
            raise StoreError(f"{part.key} is damaged: {Path(name).name} is not what was published")
        self._written[name][place] = part.digest


def _read(store: ObjectStore, part: Part) -> Iterator[bytes]:
    end = part.begin + part.size
    for begin in range(part.begin, end, _PIECE):
        yield store.get(part.key, begin, min(_PIECE, end - begin))
