"""A video without the objects that were chosen: what was behind them, from the frames that show it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.errors import ConfigError, FrameError
from mlbs_actors.messages import Array
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.plate import MARGIN, BackgroundFrame, CoveredFrame, fill_background
from orchestrator.make.video_file import VideoFile

__all__ = ["write_removed"]


def write_removed(footage: Footage, path: Path, matte: Path) -> list[str]:
    """Write the footage without the chosen objects, with its sound.

    Parameters
    ----------
    footage : Footage
    path : Path
        The video.
    matte : Path
        A second one, white where no frame shows what is behind an object, so that colours are made up.

    Returns
    -------
    list of str
        Remarks.

    Raises
    ------
    ConfigError
        If the footage has frames of several sizes.
    """
    removed = made_up = 0
    try:
        with VideoFile(path, footage.sound) as video, VideoFile(matte) as marks:
            for shot, plate in _plates(footage, path.name):
                area = _area(shot)
                picture, never_seen = _removed(shot, plate, area), plate.never_seen & area
                video.add(picture, shot.frame.pts, shot.frame.pixel_aspect)
                white = np.where(never_seen[..., None], np.uint8(255), np.zeros_like(picture))
                marks.add(white, shot.frame.pts, shot.frame.pixel_aspect)
                removed += int(area.sum())
                made_up += int(never_seen.sum())
    except FrameError as error:
        raise ConfigError(
            f"{path.name} cannot be made; choose a part with --from and --to. {error}"
        ) from None
    share = 100 * made_up / max(removed, 1)
    return [*video.remarks, f"{path.name}: {share:.1f} % of what was removed is made up, see {matte.name}."]


def _plates(footage: Footage, doing: str) -> Iterator[tuple[Shot, BackgroundFrame]]:
    """Yield each frame of the footage, and the same without any object."""
    looked = False

    def frames() -> Iterator[CoveredFrame]:
        nonlocal looked
        words, looked = None if looked else f"{doing}, first look", True
        for shot in footage.shots(words):
            chosen, others = shot.masks()
            # Others stay where they are, but nothing is taken from them.
            yield shot.picture, chosen | others

    plates = fill_background(frames)
    first = next(plates)  # after the first look, as only one progress can be shown at once
    yield from zip(footage.shots(doing), chain([first], plates), strict=True)


def _area(shot: Shot) -> Array:
    """Return what is replaced: the chosen objects and the plate's margin, without others, (H, W) bool."""
    chosen, others = shot.masks()
    margin = round(MARGIN * chosen.shape[1]) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * margin + 1, 2 * margin + 1))
    return np.asarray(cv2.dilate(chosen.view(np.uint8), disc)).view(np.bool_) & ~others


def _removed(shot: Shot, plate: BackgroundFrame, area: Array) -> Array:
    picture = shot.picture.copy()
    cv2.copyTo(plate.picture, area.view(np.uint8), picture)
    return picture
