"""A tar archive of pictures that grows: what is appended counts once a commit names the new length.

A kill leaves at most a tail behind that length, which is cut off before the next picture. Blocks of zeros, by
which tar ends, come when the archive is closed; programs that read tar need none.
"""

from __future__ import annotations

import os
import tarfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

__all__ = ["ArchivedPicture", "append_pictures", "archived_pictures", "cut_archive", "end_archive"]


@dataclass(frozen=True, slots=True)
class ArchivedPicture:
    """A picture in an archive.

    Attributes
    ----------
    name : str
        Of its file.
    archive : Path
    offset, size : int
        Its place there, bytes.
    """

    name: str
    archive: Path
    offset: int
    size: int

    def read(self) -> bytes:
        """Read the file."""
        with self.archive.open("rb") as file:
            file.seek(self.offset)
            return file.read(self.size)


def append_pictures(path: Path, length: int, pictures: Iterable[tuple[str, bytes, int]]) -> int:
    """Append pictures durably to an archive of which the first ``length`` bytes count.

    Parameters
    ----------
    path : Path
        The archive; created if missing.
    length : int
    pictures : iterable of (str, bytes, int)
        File name, content, and time, seconds since 1970.

    Returns
    -------
    int
        The new length.
    """
    with path.open("r+b" if path.exists() else "w+b") as file:
        file.truncate(length)
        file.seek(length)
        for name, content, time in pictures:
            entry = tarfile.TarInfo(name)
            entry.size, entry.mtime = len(content), time
            padding = -len(content) % tarfile.BLOCKSIZE
            file.write(entry.tobuf(tarfile.PAX_FORMAT) + content + bytes(padding))
        file.flush()
        os.fsync(file.fileno())
        return file.tell()


def cut_archive(path: Path, length: int) -> None:
    """Cut off what does not count; nothing is left of an archive without a picture that does."""
    if not length:
        path.unlink(missing_ok=True)
    elif path.stat().st_size > length:
        os.truncate(path, length)


def end_archive(path: Path, length: int) -> None:
    """Close an archive as tar demands; may be done twice."""
    with path.open("r+b") as file:
        file.truncate(length)
        file.seek(length)
        file.write(bytes(2 * tarfile.BLOCKSIZE))


def archived_pictures(path: Path, length: int) -> Iterator[ArchivedPicture]:
    """Yield the pictures in the first ``length`` bytes of an archive; none if it is not there."""
    with suppress(FileNotFoundError), tarfile.open(path, "r:") as archive:
        for entry in archive:
            if entry.offset_data + entry.size > length:
                return
            yield ArchivedPicture(entry.name, path, entry.offset_data, entry.size)
