"""Opens the source of a checked address, in the process that reads it."""

from __future__ import annotations

from mlbs_actors.scenes.synthetic import SyntheticScene, scene_from_uri
from mlbs_actors.source import FrameReader, SourceFrame
from orchestrator.sources.address import SourceAddress, SourceKind
from orchestrator.sources.animation import AnimationReader, is_animation
from orchestrator.sources.images import FRAME_RATE, ImageSequenceReader
from orchestrator.sources.live import LiveReader
from orchestrator.sources.packets import PacketStore
from orchestrator.sources.presence import holds_images, require_source
from orchestrator.sources.video import VideoReader

__all__ = ["SceneReader", "open_reader"]


def open_reader(
    address: SourceAddress, give_up_after: float | None = None, packets: PacketStore | None = None
) -> FrameReader:
    """Open a source.

    Parameters
    ----------
    address : SourceAddress
    give_up_after : float, optional
        Time without a picture after which a camera is given up, s.
    packets : PacketStore, optional
        Keeps what a camera sends.

    Raises
    ------
    SourceError
        If it is missing, or cannot be read.
    """
    require_source(address)
    if address.kind is SourceKind.SYNTHETIC:
        return SceneReader(scene_from_uri(address.location))
    if address.kind is not SourceKind.PATH:
        return LiveReader.of(address, give_up_after, packets)
    if is_animation(address.location):
        return AnimationReader(address.location)
    if holds_images(address):
        return ImageSequenceReader(address.location)
    return VideoReader(address)


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
        image, length = self._scene.frame(index), len(self._scene)
        return SourceFrame(index, image, index / FRAME_RATE, f"{index:05d}", length=length)

    def close(self) -> None:
        """Do nothing: no file is open."""
