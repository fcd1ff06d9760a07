"""Objects cut out in full size: videos with opacity, or a picture a frame."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import Array
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.ground import Ground
from orchestrator.make.video_file import VideoFile
from orchestrator.sources.address import SourceAddress

__all__ = ["cut_out", "write_cutout", "write_over"]

#: How far around objects a video has the colours of its source, px: its codec mixes neighbours, and black
#: ones would darken outlines.
_RIM = 16


def cut_out(shot: Shot, mask: Array, rim: int = 0) -> Array:
    """Cut a picture out along a mask.

    Parameters
    ----------
    shot : Shot
    mask : (H, W) bool
    rim : int
        How far around the mask colours are kept, with no opacity, px.

    Returns
    -------
    (H, W, 4) uint8
        BGR and opacity: 255 on the mask, 0 elsewhere.
    """
    coloured = mask.view(np.uint8)
    if rim:
        coloured = np.asarray(cv2.dilate(coloured, np.ones((2 * rim + 1, 2 * rim + 1), np.uint8)))
    picture = np.zeros_like(shot.picture)
    cv2.copyTo(shot.picture, coloured, picture)
    return np.dstack([picture, np.where(mask, np.uint8(255), np.uint8(0))])


def write_cutout(footage: Footage, path: Path, suffix: str, *, each: bool) -> list[str]:
    """Cut out the chosen objects.

    Parameters
    ----------
    footage : Footage
    path : Path
        The video, or a folder, with ``each`` of a video or a folder for each object, named by its id. Such a
        video begins and ends with its object.
    suffix : {".mov", ".webm", ".png"}
    each : bool

    Returns
    -------
    list of str
        Remarks.
    """
    return _write_each(footage, path, suffix) if each else _write_all(footage, path, suffix)


def write_over(footage: Footage, path: Path, ground: SourceAddress) -> list[str]:
    """Lay the chosen objects over another video, which begins with the footage; return remarks."""
    begin: float | None = None
    with closing(Ground(ground)) as below, VideoFile(path, footage.sound) as video:
        for shot in footage.shots(path.name):
            chosen, pts = shot.masks()[0], shot.frame.pts
            begin = pts if begin is None else begin
            picture = below.at(pts - begin, chosen.shape, shot.frame.pixel_aspect)
            cv2.copyTo(shot.picture, chosen.view(np.uint8), picture)
            video.add(picture, pts, shot.frame.pixel_aspect)
    return video.remarks


def _write_all(footage: Footage, path: Path, suffix: str) -> list[str]:
    if suffix == ".png":
        path.mkdir()
        for shot in footage.shots(path.name):
            _write_picture(path, shot, shot.masks()[0])
        return []
    with VideoFile(path, footage.sound) as video:
        for shot in footage.shots(path.name):
            video.add(cut_out(shot, shot.masks()[0], _RIM), shot.frame.pts, shot.frame.pixel_aspect)
    return video.remarks


def _write_each(footage: Footage, path: Path, suffix: str) -> list[str]:
    path.mkdir()
    videos: dict[int, tuple[VideoFile, ExitStack]] = {}
    remarks: list[str] = []
    with ExitStack() as unfinished:
        for shot in footage.shots(path.name):
            labels, index = shot.frame.labels(), shot.frame.index
            for layer, (first, last) in footage.chosen.seen.items():
                if not first <= index <= last:
                    continue
                mask = np.asarray(labels == layer)
                if suffix == ".png":
                    if mask.any():
                        _write_picture(path / str(layer), shot, mask)
                    continue
                if layer not in videos:
                    opened = unfinished.enter_context(ExitStack())
                    video = opened.enter_context(VideoFile(path / f"{layer}{suffix}", footage.sound))
                    videos[layer] = video, opened
                video, opened = videos[layer]
                video.add(cut_out(shot, mask, _RIM), shot.frame.pts, shot.frame.pixel_aspect)
                if index == last:  # an encoder holds many frames
                    opened.close()
                    remarks += video.remarks
    return remarks


def _write_picture(folder: Path, shot: Shot, mask: Array) -> None:
    folder.mkdir(exist_ok=True)
    _, png = cv2.imencode(".png", cut_out(shot, mask))
    (folder / f"{shot.frame.name}.png").write_bytes(png.tobytes())
