"""Pictures to judge a result by eye: labels over the input, truth, and their difference.

A contact sheet shows some frames of a sequence, each as three cells: the input with the labels (outlined,
tinted, their ids written in), the same with the truth, and the difference on the darkened grey input: green
found, red false, blue missed, grey not judged. Layers that lie off the truth get a sheet of crops.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mlbs_actors.messages import Array
from mlbs_actors.pictures.drawing import draw_labels
from mlbs_actors.pictures.layer_colours import layer_colour
from orchestrator.evaluation.overlap import NOT_JUDGED
from orchestrator.evaluation.sequence_scorer import ExtraLayer

__all__ = ["SheetFrame", "contact_sheet", "extra_layer_sheet", "overlay", "spread_evenly"]

SHEET_WIDTH = 1800  # px, the widest a sheet gets
FRAMES_A_ROW = 2
GAP = 4  # px between cells
CROP = 220  # side of a crop, px
CROPS_A_ROW = 8
CAPTION = 18  # height of a caption line, px

FOUND, FALSE, MISSED, UNJUDGED = (80, 200, 60), (50, 50, 235), (235, 130, 40), (128, 128, 128)
WHITE, BLACK = (255, 255, 255), (0, 0, 0)


@dataclass(frozen=True, slots=True)
class SheetFrame:
    """One frame of a contact sheet.

    Attributes
    ----------
    title : str
    image : (H, W, 3) uint8 BGR
    labels : (H, W) integer
    truth : (H, W) uint8
        255 = not judged.
    """

    title: str
    image: Array
    labels: Array
    truth: Array


def spread_evenly(indices: Sequence[int], wanted: int) -> list[int]:
    """Pick at most ``wanted`` of the indices, evenly spread, including first and last."""
    if len(indices) <= wanted:
        return list(indices)
    positions = np.round(np.linspace(0, len(indices) - 1, wanted)).astype(int)
    return [indices[position] for position in positions]


def overlay(image: Array, labels: Array, width: int) -> Array:
    """Return the image at the given width with each label tinted, outlined and named.

    Parameters
    ----------
    image : (H, W, 3) uint8 BGR
    labels : (H, W) integer
        0 = background stays as it is.
    width : int
        Width of the result, px; its height keeps the proportions.

    Returns
    -------
    (h, width, 3) uint8 BGR
    """
    size = (width, round(image.shape[0] * width / image.shape[1]))
    picture = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    small = cv2.resize(labels.astype(np.uint16), size, interpolation=cv2.INTER_NEAREST)
    return draw_labels(picture, small)


def contact_sheet(frames: Sequence[SheetFrame]) -> Array:
    """Lay the frames out, two a row, each as input with labels, truth, difference.

    Returns
    -------
    (h, w, 3) uint8 BGR, w ≤ 1800
    """
    columns = 3 * min(FRAMES_A_ROW, len(frames))
    width = (SHEET_WIDTH - GAP * (columns + 1)) // columns
    width = min(width, frames[0].image.shape[1])
    cells = []
    for frame in frames:
        judged_truth = np.where(frame.truth == NOT_JUDGED, 0, frame.truth)
        pictures = [
            overlay(frame.image, frame.labels, width),
            overlay(frame.image, judged_truth, width),
            _difference(frame, width),
        ]
        for picture, title in zip(
            pictures, (frame.title, "truth", "green found, red false, blue missed"), strict=True
        ):
            _write(picture, title, (4, 12))
        cells += pictures
    return _grid(cells, columns)


def extra_layer_sheet(extras: Iterable[tuple[ExtraLayer, Array]]) -> Array:
    """Show crops of layers that lie off the truth, outlined, each with its id, life and share on truth
    objects.

    Parameters
    ----------
    extras : iterable of (ExtraLayer, (H, W, 3) uint8 BGR)
        Each with its example frame.

    Returns
    -------
    (h, w, 3) uint8 BGR, w ≤ 1800
    """
    cells = [_crop(extra, image) for extra, image in extras]
    return _grid(cells, min(CROPS_A_ROW, len(cells)))


def _difference(frame: SheetFrame, width: int) -> Array:
    grey = cv2.cvtColor(cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    picture = (grey * 0.5).astype(np.uint8)
    found, true, judged = frame.labels > 0, frame.truth > 0, frame.truth != NOT_JUDGED
    picture[found & true & judged] = FOUND
    picture[found & ~true & judged] = FALSE
    picture[~found & true & judged] = MISSED
    picture[~judged] = UNJUDGED
    size = (width, round(picture.shape[0] * width / picture.shape[1]))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def _crop(extra: ExtraLayer, image: Array) -> Array:
    """Crop a square around the layer, twice its size, with its outline."""
    region = extra.region
    height, width = image.shape[:2]
    side = min(max(2 * region.width, 2 * region.height, 64), height, width)
    x = min(max(region.x + region.width // 2 - side // 2, 0), width - side)
    y = min(max(region.y + region.height // 2 - side // 2, 0), height - side)
    mask = np.zeros((height, width), np.uint8)
    mask[region.slices] = extra.mask
    picture = cv2.resize(image[y : y + side, x : x + side], (CROP, CROP), interpolation=cv2.INTER_AREA)
    small = cv2.resize(mask[y : y + side, x : x + side], (CROP, CROP), interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(small, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outlines, -1, layer_colour(extra.layer), 1)
    framed = np.zeros((CROP + 2 * CAPTION, CROP, 3), np.uint8)
    framed[:CROP] = picture
    _write(framed, f"layer {extra.layer}, frame {extra.example_frame}", (4, CROP + 13))
    _write(framed, f"{extra.frames} frames, {100 * extra.on_truth:.0f} % on truth", (4, CROP + CAPTION + 13))
    return framed


def _grid(cells: Sequence[Array], columns: int) -> Array:
    height, width = cells[0].shape[:2]
    rows = -(-len(cells) // columns)
    sheet = np.zeros((rows * (height + GAP) + GAP, columns * (width + GAP) + GAP, 3), np.uint8)
    for position, cell in enumerate(cells):
        row, column = divmod(position, columns)
        y, x = GAP + row * (height + GAP), GAP + column * (width + GAP)
        sheet[y : y + height, x : x + width] = cell
    return sheet


def _write(picture: Array, text: str, origin: tuple[int, int]) -> None:
    """Write white text with a black rim, legible on anything."""
    x, y = origin
    # A thicker stroke would also be wider; so the rim is the same text, shifted.
    places = [(x + dx, y + dy, BLACK) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    for left, bottom, colour in [*places, (x, y, WHITE)]:
        cv2.putText(picture, text, (left, bottom), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
