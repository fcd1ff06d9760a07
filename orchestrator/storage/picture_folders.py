"""The pictures of a record as files: ``masks/FRAME.png`` and folders for other parts like it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from orchestrator.storage.durable_files import remove_temporary, temporary_path

__all__ = ["PictureFolders"]

_PARTS = ("masks", "background", "cutouts")


class PictureFolders:
    """The pictures of one stream, not in segments; see :class:`orchestrator.storage.segments.Segments`.

    Parameters
    ----------
    folder : Path
        Of the stream.
    save : collection of str
        Parts of the record; those that are pictures get a folder.

    Attributes
    ----------
    name : None
        There is no segment.
    folder : Path
    """

    name = None

    def __init__(self, folder: Path, save: Collection[str]) -> None:
        self.folder = folder
        self._unpublished: list[tuple[int, Path]] = []  # with their frames
        self._withdrawn: list[Path] = []
        for part in _PARTS:
            if part in save:
                (folder / part).mkdir(exist_ok=True)
            remove_temporary(folder / part)
        self._cutouts: dict[str, list[Path]] = {}  # of an earlier run, by the names of their frames
        for path in (folder / "cutouts").glob("*.png"):
            self._cutouts.setdefault(path.stem.rpartition("-")[0], []).append(path)

    def begin(self, frame: str) -> None:
        """Begin a frame: cut-outs of it from before the run was resumed go with its commit."""
        self._withdrawn += self._cutouts.pop(frame, [])

    def put(self, frame: int, part: str, name: str, content: bytes, time: float) -> None:
        """Write a picture of a frame, which counts once that is committed."""
        path = self.folder / part / name
        temporary_path(path).write_bytes(content)
        self._unpublished.append((frame, path))

    def drafts(self, before: float) -> list[Path]:
        """Return the pictures of the frames before a number, to be published; delete what they replace."""
        for path in self._withdrawn:
            path.unlink(missing_ok=True)
        return [path for frame, path in self._unpublished if frame < before]

    def append(self, before: float) -> dict[str, int]:
        """Append to no archive."""
        return {}

    def committed(self, before: float, archived: Mapping[str, int]) -> None:
        """Note that the pictures of the frames before a number count."""
        self._unpublished = [(frame, path) for frame, path in self._unpublished if frame >= before]
        self._withdrawn = []

    def discard(self) -> None:
        """Delete what was not committed."""
        for _, path in self._unpublished:
            temporary_path(path).unlink(missing_ok=True)
