"""Opens the source of a checked address, in the process that reads it."""

from __future__ import annotations

from pathlib import Path

from mlbs_actors.actors.stream_protocol import FrameReader, SourceFrame
from mlbs_actors.errors import SourceError
from orchestrator.sources.address import GLOB_CHARACTERS, SourceAddress, SourceKind
from orchestrator.sources.images import FRAME_RATE, IMAGE_SUFFIXES, ImageSequenceReader
from orchestrator.sources.synthetic import SyntheticScene, scene_from_uri
from orchestrator.sources.video import VideoReader

__all__ = ["SceneReader", "open_reader"]


def open_reader(address: SourceAddress) -> FrameReader:
    """Open a source.

    Raises
    ------
    SourceError
        If it is not there, or cannot be read.
    """
    if address.kind is SourceKind.SYNTHETIC:
        return SceneReader(scene_from_uri(address.location))
    if address.kind is not SourceKind.PATH:
        return VideoReader(address)
    path = Path(address.location)
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES:
        return ImageSequenceReader(address.location)
    if path.is_file():
        return VideoReader(address)
    if path.exists():
        # A pipe would keep its reader waiting for ever.
        raise SourceError(f"{address} is no regular file; name a video file or a folder of images.")
    if any(mark in address.location for mark in GLOB_CHARACTERS):
        return ImageSequenceReader(address.location)
    raise SourceError(f"There is no file or folder {address}; correct its line in the list of streams.")


class SceneReader:
    """Reads a synthetic scene as if it were a video."""

    problem: str | None = None

    def __init__(self, scene: SyntheticScene) -> None:
        self._scene = scene
        self._next = 0

    def read(self) -> SourceFrame | None:
        """Return the next frame, or None at the end."""
        if self._next == len(self._scene):
            return None
        index, self._next = self._next, self._next + 1
        return SourceFrame(index, self._scene.frame(index), index / FRAME_RATE, f"{index:05d}")

    def close(self) -> None:
        """Nothing is held open."""
