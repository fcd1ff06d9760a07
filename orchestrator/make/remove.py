"""A video without the objects that were chosen: what was behind them, from the frames that show it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, count
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.errors import ConfigError, FrameError
from mlbs_actors.messages import Array
from orchestrator.make.completed_masks import KnownObjects, completed_masks
from orchestrator.make.footage import Footage, Shot
from orchestrator.make.masks import SMALL_WIDTH, packed, unpacked, whole_mask, widened
from orchestrator.make.masks_around import mask_at, masks_around
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
    removal = _Removal(footage)
    try:
        removal.complete(path.name)
        with VideoFile(path, footage.sound) as video, VideoFile(matte) as marks:
            for shot, plate in _plates(footage, removal, path.name):
                area = removal.area(shot)
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
    return [
        *video.remarks,
        f"{path.name}: of the area that was filled in, {share:.1f} % is made up, as no frame shows what is "
        f"there (white in {matte.name}). What the masks miss of an object may still be seen.",
    ]


class _Removal:
    """What is removed of each frame: what was found of the chosen objects, and what else belongs to them."""

    def __init__(self, footage: Footage) -> None:
        self._footage = footage
        self._completed: dict[int, bytes] = {}  # PNG pictures: where all objects are, and where chosen ones
        self._chosen: dict[int, bytes] = {}

    def complete(self, doing: str) -> None:
        """Complete the masks of all frames."""

        looks = count(1)

        def frames() -> Iterator[KnownObjects]:
            around = masks_around(self._footage.whole(), SMALL_WIDTH)
            # The first is read beside the others, the second alone and to its end before any mask comes.
            for shot in self._footage.shots(f"{doing}, part 1 of 4" if next(looks) == 2 else None):
                chosen, others = shot.masks()
                yield KnownObjects(shot.picture, chosen | others, mask_at(shot.frame.index, around))

        masks = completed_masks(frames)
        first = next(masks)  # after part 1, as only one progress can be shown at once
        shots = self._footage.shots(f"{doing}, part 2 of 4")
        around = masks_around(self._footage.recorded(), SMALL_WIDTH)
        for shot, mask in zip(shots, chain([first], masks), strict=True):
            self._completed[shot.frame.index] = packed(mask)
            self._chosen[shot.frame.index] = packed(mask_at(shot.frame.index, around))

    def covered(self, shot: Shot) -> Array:
        """Return where objects cover the background, (H, W) bool, those that stay included."""
        chosen, others = shot.masks()
        return chosen | others | whole_mask(unpacked(self._completed[shot.frame.index]), chosen.shape)

    def area(self, shot: Shot) -> Array:
        """Return what is replaced: the chosen objects and the plate's margin, without others, (H, W) bool."""
        chosen, others = shot.masks()
        _, parts = cv2.connectedComponents((self.covered(shot) & ~others).view(np.uint8))
        chosen = chosen | whole_mask(unpacked(self._chosen[shot.frame.index]), chosen.shape)
        whole = np.isin(parts, np.setdiff1d(parts[chosen], 0))
        return widened(whole, round(MARGIN * chosen.shape[1]) + 1) & ~others


def _plates(footage: Footage, removal: _Removal, doing: str) -> Iterator[tuple[Shot, BackgroundFrame]]:
    """Yield each frame of the footage, and the same without any object."""
    looked = False

    def frames() -> Iterator[CoveredFrame]:
        nonlocal looked
        words, looked = None if looked else f"{doing}, part 3 of 4", True
        for shot in footage.shots(words):
            yield shot.picture, removal.covered(shot)

    plates = fill_background(frames)
    first = next(plates)  # after part 3, as only one progress can be shown at once
    yield from zip(footage.shots(f"{doing}, part 4 of 4"), chain([first], plates), strict=True)


def _removed(shot: Shot, plate: BackgroundFrame, area: Array) -> Array:
    picture = shot.picture.copy()
    cv2.copyTo(plate.picture, area.view(np.uint8), picture)
    return picture
