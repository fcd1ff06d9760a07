"""Sequences of the Berkeley and Freiburg-Berkeley motion segmentation data sets (BMS-26, FBMS-59).

Their truth is defined by a file ``…Def.dat``, beside the pictures or in ``GroundTruth/``. Of it these lines
are read, each with its value in the line below: ``Scale of region N:`` is the value of a region in the truth,
``Frame number:`` (from 0), ``File name:`` and ``Input file name:`` are a frame with truth, its truth, and its
picture. A truth is a PGM of grey values, or a PPM whose value is red × 256² + green × 256 + blue.

No line says which region is the background. It is white in the colour pictures and black in the grey ones.
Values that are no region's are not judged. The ``PROB`` pictures, how sure a pixel's region is, are not used.
"""

from __future__ import annotations

import glob
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.evaluation.overlap import NOT_JUDGED
from orchestrator.evaluation.sequences import FileSequence
from orchestrator.sources.presence import images_of, is_image

__all__ = ["BmsSequence", "definition_of"]

_WHITE = 256**3 - 1
_BLACK = 0


@dataclass(frozen=True, slots=True)
class _LabelledFrame:
    number: int
    truth: str
    picture: str


def definition_of(folder: Path) -> Path | None:
    """Return the file that defines the truth of a sequence's folder, here or in ``GroundTruth``."""
    places = (folder, folder / "GroundTruth")
    return next((path for place in places for path in sorted(place.glob("*Def.dat"))), None)


class BmsSequence(FileSequence):
    """A sequence whose truth a ``…Def.dat`` defines.

    Parameters
    ----------
    name : str
    definition : Path

    Raises
    ------
    SourceError
        If the definition cannot be read, or a file that it lists is missing.
    """

    def __init__(self, name: str, definition: Path) -> None:
        truth_folder = definition.parent
        folder = truth_folder.parent if truth_folder.name == "GroundTruth" else truth_folder
        try:
            text = definition.read_text(encoding="latin-1")
        except OSError as error:
            raise SourceError(f"{definition} cannot be read: {error.strerror}.") from error
        try:
            frames = _labelled_frames(text)
            self._regions = [int(value) for value in _values(text, r"Scale of region\s+\d+:")]
        except ValueError as error:
            raise SourceError(f"{definition} is no definition of truth: {error}.") from error
        if not frames or not self._regions:
            raise SourceError(f"{definition} defines no regions, or no frames with truth.")
        pictures = _pictures(folder, {frame.truth for frame in frames})
        super().__init__(name, _by_stem(frames, truth_folder, pictures), pictures)

    @property
    def remark(self) -> str | None:
        """How the truth is read."""
        return "white of a PPM truth, or black of a PGM, is read as the background."

    def _read_truth(self, path: Path) -> Array:
        try:
            with Image.open(path) as image:
                pixels = np.asarray(image).astype(np.int32)
        except OSError as error:
            raise SourceError(f"{path} cannot be read as a label map: {error}.") from error
        background = _BLACK
        if pixels.ndim == 3:
            pixels, background = pixels[..., 0] * 256**2 + pixels[..., 1] * 256 + pixels[..., 2], _WHITE
        labels = np.full(pixels.shape, NOT_JUDGED, np.uint8)
        objects = (value for value in self._regions if value != background)
        for label, value in enumerate(objects, start=1):
            labels[pixels == value] = label
        labels[pixels == background] = 0
        return labels


def _values(text: str, heading: str) -> list[str]:
    """Return what stands in the line below each heading."""
    return re.findall(rf"^\s*{heading}\s*\n[ \t]*(\S+)", text, re.MULTILINE)


def _labelled_frames(text: str) -> list[_LabelledFrame]:
    numbers, truths, pictures = (
        _values(text, heading) for heading in ("Frame number:", "File name:", "Input file name:")
    )
    return [
        _LabelledFrame(int(number), truth, picture)
        for number, truth, picture in zip(numbers, truths, pictures, strict=True)
    ]


def _pictures(folder: Path, truths: Collection[str]) -> dict[str, Path]:
    """Map stems to the pictures of a folder that also holds truth: those of the commonest kind."""
    possible = [
        path
        for path in folder.iterdir()
        if is_image(str(path)) and path.suffix.lower() != ".pgm" and path.name not in truths
    ]
    possible = [path for path in possible if "PROB" not in path.name]
    if not possible:
        raise SourceError(f"There are no pictures in {folder}.")
    ((suffix, _),) = Counter(path.suffix for path in possible).most_common(1)
    of_kind = images_of(f"{glob.escape(str(folder))}/*{suffix}")
    return {path.stem: path for path in of_kind if path in possible}


def _by_stem(frames: Iterable[_LabelledFrame], folder: Path, pictures: Mapping[str, Path]) -> dict[str, Path]:
    """Map the stems of the pictures with truth to its files.

    A picture is found by its name, or, as it may be stored in another form, by its number.
    """
    stems = list(pictures)
    truths = {}
    for frame in frames:
        stem = Path(frame.picture).stem
        if stem not in pictures:
            if not 0 <= frame.number < len(stems):
                raise SourceError(
                    f"There is no picture {frame.picture} for the truth {folder / frame.truth}."
                )
            stem = stems[frame.number]
        truths[stem] = folder / frame.truth
        if not truths[stem].is_file():
            raise SourceError(f"There is no truth {truths[stem]}, which the definition lists.")
    return truths
