"""Makes a folder of what counts in a store: for a run that goes on elsewhere, and for all that reads one."""

from __future__ import annotations

import os
import shutil
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from orchestrator.object_storage.ledger import read_standing
from orchestrator.object_storage.manifest import Part
from orchestrator.object_storage.store import MissingObjectError, ObjectStore, StoreError
from orchestrator.object_storage.uploads import digest_of

__all__ = ["fetch", "fetch_files"]

_REQUESTS_AT_ONCE = 8

#: Longer objects are read piece by piece, bytes.
_PIECE = 1 << 25

#: How often reading is begun anew, because a run that is at work has replaced what was to be read.
_ATTEMPTS = 10


def fetch(store: ObjectStore, folder: Path) -> int:
    """Make a folder of what counts now, even while a run is at work; return the number of files.

    Parameters
    ----------
    store : ObjectStore
    folder : Path
        Made; there is nothing under its name. It has ``.part`` behind that until it is complete.

    Raises
    ------
    StoreError
        If the store cannot be read, or what it has is damaged.
    OSError
        As the disk says.
    """
    for _ in range(_ATTEMPTS):
        files = read_standing(store).files
        try:
            fetch_files(store, files, folder)
        except MissingObjectError:
            continue
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
    draft = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(draft, ignore_errors=True)
    wanted: defaultdict[str, list[tuple[Path, int, Part]]] = defaultdict(list)
    draft.mkdir(parents=True)
    for name, parts in files.items():
        path = draft / name
        if not path.resolve().is_relative_to(draft.resolve()):
            raise StoreError(f"its manifest names {name!r}, which is not in the run's folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        place = 0
        for part in parts:
            wanted[part.key].append((path, place, part))
            place += part.size
    with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
        list(pool.map(lambda key: _fetch_object(store, key, wanted[key]), wanted))
    if durable:
        os.sync()
    draft.rename(folder)


def _fetch_object(store: ObjectStore, key: str, pieces: Sequence[tuple[Path, int, Part]]) -> None:
    """Read an object, and write what is wanted of it into files, at places in them."""
    if len(pieces) > 1:
        whole = store.get(key)
        for path, place, part in pieces:
            _write(path, place, part, iter((whole[part.begin : part.begin + part.size],)))
    else:
        ((path, place, part),) = pieces
        _write(path, place, part, _read(store, part))


def _read(store: ObjectStore, part: Part) -> Iterator[bytes]:
    end = part.begin + part.size
    for begin in range(part.begin, end, _PIECE):
        yield store.get(part.key, begin, min(_PIECE, end - begin))


def _write(path: Path, place: int, part: Part, content: Iterator[bytes]) -> None:
    def written() -> Iterator[bytes]:
        with path.open("r+b") as file:
            file.seek(place)
            for piece in content:
                file.write(piece)
                yield piece

    if digest_of(written()) != part.digest:
        raise StoreError(f"{part.key} is damaged: {path.name} is not what was published")
