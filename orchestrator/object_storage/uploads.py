"""What has to be written so that a store has the files as they are held: which bytes, in which objects.

A request costs money, whatever its size. So the small files of a folder, as masks are, share one object, a
tar archive; tables and whatever is large have their own, under their own names. A file that only grows gets
its new bytes as another part, together with the parts before that are no longer than what follows them: so a
file of n bytes has about log n parts, and each byte is written about as often.
"""

from __future__ import annotations

import hashlib
import tarfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path, PurePosixPath

from orchestrator.object_storage.held_files import HeldFile
from orchestrator.object_storage.manifest import OBJECTS, Part
from orchestrator.object_storage.store import Content

__all__ = ["Changes", "Upload", "digest_of", "plan"]

#: Smaller files share an object, as far as it is not larger than the second figure, bytes.
_SMALL, _SHARED = 1 << 18, 1 << 24

#: Parts that are longer are not written again, bytes.
_LONG = 1 << 26

#: Larger objects are sent piece by piece, bytes.
_PIECE = 1 << 23

_END_OF_ARCHIVE = bytes(2 * tarfile.BLOCKSIZE)


@dataclass(frozen=True, slots=True)
class _Piece:
    """Bytes of a held file, and where they are going to be in an object."""

    name: str
    begin: int
    size: int
    digest: str
    place: int = 0


@dataclass(frozen=True, slots=True)
class Upload:
    """An object to be written: one piece, or an archive of several."""

    key: str
    pieces: tuple[_Piece, ...]

    @property
    def size(self) -> int:
        """Bytes of files in it."""
        return sum(piece.size for piece in self.pieces)

    def content(self, path: Callable[[str], Path]) -> Content:
        """Read the object from the held files, of which ``path`` tells where they are."""
        (piece, *others) = self.pieces
        if not piece.place:
            return (
                _bytes_of(path(piece.name), piece) if piece.size <= _PIECE else _read(path(piece.name), piece)
            )
        archive = bytearray()
        for one in (piece, *others):
            archive += _header(one)
            archive += _bytes_of(path(one.name), one)
            archive += bytes(-one.size % tarfile.BLOCKSIZE)
        return bytes(archive + _END_OF_ARCHIVE)


@dataclass(frozen=True, slots=True)
class Changes:
    """What makes a state of the folder count in the store.

    Attributes
    ----------
    taken : mapping of str to HeldFile
        That state.
    moment : float
        Of that state, s since 1970: all that was committed until then is in it.
    files : mapping of str to tuple of Part
        Of the files that are other ones than those that count.
    gone : tuple of str
    uploads : tuple of Upload
        What must be there before.
    """

    taken: Mapping[str, HeldFile]
    moment: float
    files: Mapping[str, Sequence[Part]]
    gone: tuple[str, ...]
    uploads: tuple[Upload, ...]


def plan(
    taken: Mapping[str, HeldFile],
    known: Mapping[str, HeldFile],
    published: Mapping[str, Sequence[Part]],
    path: Callable[[str], Path],
    number: str,
    moment: float,
) -> Changes:
    """Work out what is to be written.

    Parameters
    ----------
    taken : mapping of str to HeldFile
        The files as they are now.
    known : mapping of str to HeldFile
        As they were when they were published, as far as that was by this process.
    published : mapping of str to sequence of Part
        What counts in the store.
    path : callable
        Returns where the content of a file is; only asked for files that are not known so.
    number : str
        ``EPOCH.N``, not used before.
    moment : float
        When taking them began, s since 1970.
    """
    kept: dict[str, tuple[Part, ...]] = {}
    pieces: list[_Piece] = []
    for name, held in taken.items():
        if known.get(name) == held:
            continue
        before = published.get(name)
        is_same = name in known and known[name].inode == held.inode
        stays = _that_stay(path(name), held, before or (), trusted=is_same and not held.cut)
        begin = sum(part.size for part in stays)
        if begin < held.size:
            pieces.append(_digested(path(name), _Piece(name, begin, held.size - begin, "")))
        elif before is not None and tuple(before) == stays:
            continue
        kept[name] = stays
    uploads = tuple(_objects(pieces, f"{OBJECTS}/{number}"))
    for upload in uploads:
        for piece in upload.pieces:
            kept[piece.name] += (Part(upload.key, piece.place, piece.size, piece.digest),)
    return Changes(taken, moment, kept, tuple(published.keys() - taken.keys()), uploads)


def digest_of(pieces: Iterator[bytes]) -> str:
    """Return what tells bytes from others, as manifests have it."""
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()[:32]


def _that_stay(path: Path, held: HeldFile, before: Sequence[Part], *, trusted: bool) -> tuple[Part, ...]:
    """Return the parts of a file that its content begins with, and that need not be written again."""
    ends = list(accumulate(part.size for part in before))
    size = ends[-1] if ends else 0
    if size > held.size or (size < held.size and not held.growing):
        return ()
    if not (trusted and held.growing):
        for part, end in zip(before, ends, strict=True):
            if digest_of(_read(path, _Piece("", end - part.size, part.size, ""))) != part.digest:
                return ()
    stays = list(before)
    while size < held.size and stays and stays[-1].size <= min(held.size - size, _LONG):
        size -= stays.pop().size
    return tuple(stays)


def _objects(pieces: Sequence[_Piece], folder: str) -> Iterator[Upload]:
    """Yield the objects for these pieces."""
    groups: defaultdict[str, list[_Piece]] = defaultdict(list)
    for piece in pieces:
        if piece.size < _SMALL and not piece.name.endswith(".parquet"):
            groups["/".join(PurePosixPath(piece.name).parts[:-1][:2])].append(piece)
        else:
            yield Upload(_key(folder, piece), (piece,))
    # What lies in the folders of run and streams themselves is replaced again and again.
    replaced = [piece for group in list(groups) if "/" not in group for piece in groups.pop(group)]
    for group, small in [("", replaced), *groups.items()]:
        if len(small) == 1:
            yield Upload(_key(folder, small[0]), (small[0],))
            continue
        for number, shared in enumerate(_shared(small)):
            mark = f"-{number + 1}" if number else ""
            yield Upload(f"{folder}/{group}{mark}.tar" if group else f"{folder}{mark}.tar", shared)


def _shared(pieces: Sequence[_Piece]) -> Iterator[tuple[_Piece, ...]]:
    """Divide pieces into archives of some megabytes, with the place of each in its own."""
    archive: list[_Piece] = []
    end = 0
    for piece in pieces:
        place = end + len(_header(piece))
        archive.append(replace(piece, place=place))
        end = place + piece.size + -piece.size % tarfile.BLOCKSIZE
        if end > _SHARED:
            yield tuple(archive)
            archive, end = [], 0
    if archive:
        yield tuple(archive)


def _key(folder: str, piece: _Piece) -> str:
    return f"{folder}/{piece.name}" + (f".from-{piece.begin}" if piece.begin else "")


def _header(piece: _Piece) -> bytes:
    entry = tarfile.TarInfo(PurePosixPath(piece.name).name + (f".from-{piece.begin}" if piece.begin else ""))
    entry.size = piece.size
    return entry.tobuf(tarfile.GNU_FORMAT)


def _digested(path: Path, piece: _Piece) -> _Piece:
    return replace(piece, digest=digest_of(_read(path, piece)))


def _bytes_of(path: Path, piece: _Piece) -> bytes:
    return b"".join(_read(path, piece))


def _read(path: Path, piece: _Piece) -> Iterator[bytes]:
    """Yield the bytes of a piece; OSError if the file has fewer."""
    left = piece.size
    with path.open("rb") as file:
        file.seek(piece.begin)
        while left:
            found = file.read(min(left, _PIECE))
            if not found:
                raise OSError(f"{path} is shorter than it was")
            left -= len(found)
            yield found
