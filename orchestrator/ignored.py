"""What users know to be fixed in the pictures of a stream: masks and polygons (``--ignore``)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.errors import ConfigError
from mlbs_actors.messages import Array

__all__ = ["Ignored", "IgnoredFile", "read_ignored"]

#: Sides of the mask that polygons are drawn into, px; masks are scaled to the frames.
_DRAWN = 2048


@dataclass(frozen=True, slots=True)
class IgnoredFile:
    """One file.

    Attributes
    ----------
    path : Path
        Absolute.
    mask : (h, w) bool
        What is fixed in the picture; of any size.
    digest : str
        SHA-256 of the file.
    fault : str, optional
        Why it cannot be used, a sentence; then nothing is fixed.
    """

    path: Path
    mask: Array
    digest: str
    fault: str | None = None


@dataclass(frozen=True, slots=True)
class Ignored:
    """The files of a run.

    Attributes
    ----------
    files : mapping of str or None to IgnoredFile
        By the name of the stream; None for all others.
    """

    files: Mapping[str | None, IgnoredFile]

    def file_of(self, stream: str) -> IgnoredFile | None:
        """Return the file of a stream, if it has one."""
        return self.files.get(stream, self.files.get(None))

    def mask_of(self, stream: str) -> Array | None:
        """Return the mask (h, w) bool of a stream, if it has one."""
        file = self.file_of(stream)
        return None if file is None else file.mask

    @property
    def faults(self) -> list[str]:
        """What is wrong with files that cannot be used, sentences."""
        return [file.fault for file in self.files.values() if file.fault is not None]

    @property
    def streams(self) -> set[str]:
        """The streams that have a file of their own."""
        return {name for name in self.files if name is not None}

    @property
    def digests(self) -> dict[str, str]:
        """The digest of each file, by ``NAME=FILE`` or ``FILE`` as :func:`read_ignored` takes them."""
        return {
            str(file.path) if name is None else f"{name}={file.path}": file.digest
            for name, file in self.files.items()
        }


def read_ignored(words: Sequence[str]) -> Ignored:
    """Read what the command line names; what cannot be used is in :attr:`Ignored.faults`.

    Parameters
    ----------
    words : sequence of str
        ``FILE`` or ``NAME=FILE`` each.

    Raises
    ------
    ConfigError
        If a stream has two.
    """
    files: dict[str | None, IgnoredFile] = {}
    for word in words:
        name, path = _split(word)
        if name in files:
            whose = "all streams" if name is None else f"the stream {name!r}"
            raise ConfigError(f"--ignore names two files for {whose}; draw both into one mask.")
        try:
            files[name] = _read(path)
        except ConfigError as error:
            files[name] = IgnoredFile(path.absolute(), np.zeros((1, 1), np.bool_), "", str(error))
    return Ignored(files)


def _split(word: str) -> tuple[str | None, Path]:
    name, sign, path = word.partition("=")
    # A name of a stream has no separator of folders in it.
    return (name, Path(path)) if sign and "/" not in name else (None, Path(word))


def _read(path: Path) -> IgnoredFile:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"--ignore: {path} cannot be read: {error.strerror}.") from None
    mask = None
    if content:
        mask = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    ignored = _polygons(path, content) if mask is None else mask > 0
    if ignored.all():
        raise ConfigError(f"--ignore: {path} covers the whole picture; what is not 0 in it is ignored.")
    return IgnoredFile(path.absolute(), ignored, hashlib.sha256(content).hexdigest())


def _polygons(path: Path, content: bytes) -> Array:
    """Draw a polygon a line, ``x1,y1,x2,y2,…`` as shares of the picture's width and height."""
    mask = np.zeros((_DRAWN, _DRAWN), np.uint8)
    try:
        lines = content.decode("utf-8").splitlines()
        for line in lines:
            if not (text := line.partition("#")[0].strip()):
                continue
            corners = np.array([float(number) for number in text.split(",")]).reshape(-1, 2)
            if len(corners) < 3 or not ((corners >= 0) & (corners <= 1)).all():
                raise ValueError
            cv2.fillPoly(mask, [np.rint(corners * (_DRAWN - 1)).astype(np.int32)], 255)
    except ValueError:
        raise ConfigError(
            f"--ignore: {path} is neither a picture nor a list of polygons; write a line for each polygon, "
            "x1,y1,x2,y2,x3,y3 and so on, from 0 to 1 of the picture's width and height."
        ) from None
    return mask > 0
