"""Sequences with truth: folders of pictures, and synthetic scenes.

Truth is a label map: 0 = background, 1 … 254 = objects. 255 is "not judged", but the one object of a truth
that holds 0 and 255 alone, as DAVIS 2016's does.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from PIL import Image

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SyntheticScene
from orchestrator.evaluation.overlap import NOT_JUDGED
from orchestrator.sinks.label_image import davis_palette, voc_colours
from orchestrator.sources.images import decode_image
from orchestrator.sources.presence import images_of

__all__ = ["FileSequence", "FolderSequence", "SceneSequence", "Sequence", "SequenceChange", "read_label_map"]

#: One number for each colour.
_RGB_CODE = np.array([1 << 16, 1 << 8, 1], np.int32)


class Sequence(Protocol):
    """Frames by index, with truth where there is one."""

    @property
    def name(self) -> str:
        """Name in tables and files."""

    @property
    def stems(self) -> tuple[str, ...]:
        """One a frame, in order: the stem of its mask file."""

    @property
    def remark(self) -> str | None:
        """A sentence on how the truth is read, if that needs explaining."""

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""

    def has_truth(self, index: int) -> bool:
        """Whether frame ``index`` has truth."""

    def truth(self, index: int) -> Array | None:
        """Truth of frame ``index``, (H, W) uint8 with 0 = background and 255 = not judged, or None."""

    def motion(self, index: int) -> Array | None:
        """Exact backward motion of frame ``index``, (H, W, 2) float32 px, or None where it is not known."""


#: Derives another sequence from a sequence; a function or class of a module, so that it can be pickled.
SequenceChange = Callable[[Sequence], Sequence]


class FileSequence:
    """Pictures with label maps for some or all of them, each in a file.

    Parameters
    ----------
    name : str
    truth, frames : mapping of str to Path
        Stem of a frame → its label map, and its picture. Without pictures only the frames with truth are
        known, and none can be shown.

    Raises
    ------
    SourceError
        If a truth map has no frame.
    """

    def __init__(self, name: str, truth: Mapping[str, Path], frames: Mapping[str, Path]) -> None:
        self.name = name
        self._truth, self._frames = truth, frames
        strays = sorted(truth.keys() - frames.keys()) if frames else []
        if strays:
            raise SourceError(
                f"{truth[strays[0]].parent} has truth for {strays[0]!r}, but there is no such picture in "
                f"{next(iter(frames.values())).parent}; give truth and pictures the same stems."
            )
        self.stems = tuple(frames or truth)

    @property
    def remark(self) -> str | None:
        """How the truth is read, if it holds 0 and 255 alone."""
        if not self._is_binary:
            return None
        return "the truth holds 0 and 255 alone, as DAVIS 2016 does; 255 is read as one object."

    @functools.cached_property
    def _is_binary(self) -> bool:
        values = set().union(*(np.unique(self._read_truth(path)).tolist() for path in self._truth.values()))
        return NOT_JUDGED in values and values <= {0, NOT_JUDGED}

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        path = self._frames.get(self.stems[index])
        if path is None:
            raise SourceError("there are no pictures beside the truth.")
        picture = decode_image(path.read_bytes())
        if picture is None:
            raise SourceError(f"{path} cannot be decoded as a picture; replace or remove it.")
        return picture

    def has_truth(self, index: int) -> bool:
        """Whether frame ``index`` has truth."""
        return self.stems[index] in self._truth

    def truth(self, index: int) -> Array | None:
        """Truth of frame ``index``, (H, W) uint8, or None."""
        path = self._truth.get(self.stems[index])
        if path is None:
            return None
        labels = self._read_truth(path)
        if self._is_binary:
            labels = (labels == NOT_JUDGED).astype(np.uint8)
        return labels

    def motion(self, index: int) -> Array | None:
        """Return None: the exact motion of a real video is not known."""
        return None

    def _read_truth(self, path: Path) -> Array:
        labels = read_label_map(path)
        if labels.max(initial=0) > NOT_JUDGED:
            raise SourceError(f"{path} holds labels above 255; truth is 0 … 254, and 255 for not judged.")
        return labels.astype(np.uint8)


class FolderSequence(FileSequence):
    """A folder of PNG label maps, with a folder of pictures of the same stems or without.

    Parameters
    ----------
    name : str
    truth_folder : Path
    frames_folder : Path or None

    Raises
    ------
    SourceError
        If a folder is missing or holds nothing of use, or a truth map has no frame.
    """

    def __init__(self, name: str, truth_folder: Path, frames_folder: Path | None) -> None:
        super().__init__(name, _by_stem(truth_folder), _by_stem(frames_folder) if frames_folder else {})


class SceneSequence:
    """A synthetic scene, whose truth and motion are exact."""

    def __init__(self, name: str, scene: SyntheticScene) -> None:
        self.name = name
        self._scene = scene
        self.stems = tuple(f"{index:05d}" for index in range(len(scene)))
        self.remark = None

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        return self._scene.frame(index)

    def has_truth(self, index: int) -> bool:
        """Return True: every frame of a scene has truth."""
        return True

    def truth(self, index: int) -> Array | None:
        """Truth of frame ``index``, (H, W) uint8."""
        return self._scene.labels(index)

    def motion(self, index: int) -> Array | None:
        """Exact backward motion of frame ``index``, (H, W, 2) float32 px."""
        return self._scene.flow(index)


def read_label_map(path: Path | BinaryIO) -> Array:
    """Read a label map: palette indices, or 8- or 16-bit grey values, also written as equal colours.

    A colour picture is read as well if all its colours are of the palette of DAVIS.

    Returns
    -------
    (H, W) int32

    Raises
    ------
    SourceError
        If the file cannot be decoded or is a colour picture.
    """
    try:
        with Image.open(path) as image:
            pixels = np.asarray(image)
            if image.mode in ("RGB", "RGBA") and (pixels[..., :3] == pixels[..., :1]).all():
                return pixels[..., 0].astype(np.int32)  # such as bear/00077.png of DAVIS 2016
            if image.mode in ("RGB", "RGBA") and (labels := _labels_of_colours(pixels)) is not None:
                return labels
            if image.mode not in ("P", "L", "1", "I;16", "I"):
                raise SourceError(
                    f"{path} is a colour picture ({image.mode}); a label map is an indexed or grey PNG "
                    "whose values are labels."
                )
            return pixels.astype(np.int32)
    except OSError as error:
        raise SourceError(f"{path} cannot be read as a label map: {error}.") from error


def _labels_of_colours(pixels: Array) -> Array | None:
    """Look the colours of DAVIS's palette up, (H, W) int32; None if there are others."""
    codes = pixels[..., :3].astype(np.int32) @ _RGB_CODE
    labels = np.full(codes.shape, -1, np.int32)
    # That of PASCAL VOC differs by 192 for 191, and from label 22 on.
    for palette in (voc_colours(), davis_palette()):
        known = palette.astype(np.int32) @ _RGB_CODE
        order = np.argsort(known, kind="stable")
        place = np.minimum(np.searchsorted(known[order], codes), len(known) - 1)
        labels = np.where(known[order][place] == codes, order[place], labels)
    return labels.astype(np.int32) if (labels >= 0).all() else None


def _by_stem(folder: Path) -> dict[str, Path]:
    """Map stems to the pictures of a folder, in the order in which a run reads them."""
    if not folder.is_dir():
        raise SourceError(f"{folder} is no folder; check the path.")
    return {path.stem: path for path in images_of(str(folder))}
