"""A contact sheet: some frames of a video on one picture."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from mlbs_actors.messages import Array
from mlbs_actors.pictures.drawing import draw_caption
from orchestrator.make.footage import Footage
from orchestrator.make.moments import clock
from orchestrator.pictures.content import Drawing

__all__ = ["write_sheet"]

_FRAMES, _COLUMNS = 20, 4
_WIDTH, _GAP = 400, 6  # of a cell, and between two, px
_JPEG_QUALITY = 88


def write_sheet(footage: Footage, path: Path, drawing: Drawing | None) -> None:
    """Lay 20 frames out, evenly spread over the footage, each with its time and number.

    Parameters
    ----------
    footage : Footage
    path : Path
        The picture.
    drawing : Drawing, optional
        What is drawn over the pictures; None for nothing.
    """
    number = min(_FRAMES, footage.count)
    wanted = set(np.linspace(0, footage.count - 1, number).round().astype(int).tolist())
    indices = {frame.index for place, frame in enumerate(footage.recorded()) if place in wanted}
    cells: list[Array] = []
    for shot in footage.shots(path.name):
        if shot.frame.index in indices:
            picture = shot.picture if drawing is None else shot.drawn(drawing)
            width = min(_WIDTH, picture.shape[1])
            height = max(1, round(picture.shape[0] * width / (picture.shape[1] * shot.frame.pixel_aspect)))
            cell = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))
            draw_caption(cell, f"{clock(shot.frame.pts)}  frame {shot.frame.index}")
            cells.append(cell)
    quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if path.suffix == ".jpg" else []
    _, data = cv2.imencode(path.suffix, _grid(cells), quality)
    path.write_bytes(data.tobytes())


def _grid(cells: list[Array]) -> Array:
    height, width = cells[0].shape[:2]
    columns = min(_COLUMNS, len(cells))
    rows = math.ceil(len(cells) / columns)
    sheet = np.full((rows * (height + _GAP) + _GAP, columns * (width + _GAP) + _GAP, 3), 255, np.uint8)
    for place, cell in enumerate(cells):
        row, column = divmod(place, columns)
        top, left = _GAP + row * (height + _GAP), _GAP + column * (width + _GAP)
        sheet[top : top + height, left : left + width] = cv2.resize(cell, (width, height))
    return sheet
