"""The frames of a video file, as OpenCV decodes them."""

from __future__ import annotations

from collections.abc import Generator
from os import PathLike
from pathlib import Path

import cv2

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array

__all__ = ["video_frames"]


def video_frames(path: str | PathLike[str]) -> Generator[Array, None, None]:
    """Yield the frames of a video, (H, W, 3) uint8 BGR; it is closed with the generator.

    Raises
    ------
    SourceError
        If there is no such file, or OpenCV decodes no frame of it.
    """
    if "://" in str(path):  # it may hold a password
        raise SourceError("Only files are opened here; give the frames of a camera or stream instead.")
    if Path(path).is_dir():
        raise SourceError(
            f"{path} is a folder; give its pictures as frames: "
            f"(cv2.imread(str(one)) for one in sorted(Path({str(path)!r}).iterdir()))."
        )
    if not Path(path).is_file():
        raise SourceError(f"There is no video {path}; check the path.")
    video = cv2.VideoCapture(str(path))
    try:
        there, frame = video.read()
        if not there:
            raise SourceError(f"OpenCV cannot decode {path}; decode it yourself and give the frames instead.")
        while there:
            yield frame
            there, frame = video.read()
    finally:
        video.release()
