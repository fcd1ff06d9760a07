"""Sequences with truth: folders of pictures, and synthetic scenes.

A *sequence folder* holds ``frames/`` (pictures in name order) and ``gt/`` (PNG label maps with the stems of
their frames; frames without one are not scored). 255 is "not judged", but the one object of a truth that
holds 0 and 255 alone, as DAVIS 2016's does. A *data root* is searched for such folders at any depth.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
from PIL import Image

from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array
from orchestrator.evaluation.metrics import NOT_JUDGED
from orchestrator.sources.images import decode_image
from orchestrator.sources.presence import images_of
from orchestrator.sources.synthetic import SCHEME, SyntheticScene, scene_from_uri

__all__ = [
    "DATA_VARIABLE",
    "FolderSequence",
    "SceneSequence",
    "Sequence",
    "SequenceChange",
    "data_root",
    "find_sequences",
    "open_sequence",
    "read_label_map",
]

#: Environment variable that names the default data root.
DATA_VARIABLE = "MLBS_DATA"


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


class FolderSequence:
    """A folder of pictures with a folder of label maps of the same stems.

    Parameters
    ----------
    name : str
    truth_folder : Path
        PNG label maps.
    frames_folder : Path or None
        The pictures. None: only the frames with truth are known, and none can be shown.

    Raises
    ------
    SourceError
        If a folder is missing or holds nothing of use, or a truth map has no frame.
    """

    def __init__(self, name: str, truth_folder: Path, frames_folder: Path | None) -> None:
        self.name = name
        self._truth = _by_stem(truth_folder)
        self._frames: dict[str, Path] = {}
        if frames_folder is not None:
            self._frames = _by_stem(frames_folder)
            strays = sorted(self._truth.keys() - self._frames.keys())
            if strays:
                raise SourceError(
                    f"{truth_folder} has truth for {strays[0]!r}, but {frames_folder} has no such picture; "
                    "give truth and pictures the same stems."
                )
        self.stems = tuple(self._frames or self._truth)

    @property
    def remark(self) -> str | None:
        """How the truth is read, if it holds 0 and 255 alone."""
        if not self._is_binary:
            return None
        return "the truth holds 0 and 255 alone, as DAVIS 2016 does; 255 is read as one object."

    @functools.cached_property
    def _is_binary(self) -> bool:
        values = set().union(*(np.unique(_truth_map(path)).tolist() for path in self._truth.values()))
        return NOT_JUDGED in values and values <= {0, NOT_JUDGED}

    def frame(self, index: int) -> Array:
        """Frame ``index``, (H, W, 3) uint8 BGR."""
        path = self._frames.get(self.stems[index])
        if path is None:
            raise SourceError(f"{self.name}: there are no pictures; put them in frames/ beside the truth.")
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
        labels = _truth_map(path)
        if self._is_binary:
            labels = (labels == NOT_JUDGED).astype(np.uint8)
        return labels

    def motion(self, index: int) -> Array | None:
        """Return None: the exact motion of a real video is not known."""
        return None


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


def _truth_map(path: Path) -> Array:
    labels = read_label_map(path)
    if labels.max(initial=0) > NOT_JUDGED:
        raise SourceError(f"{path} holds labels above 255; truth is 0 … 254, and 255 for not judged.")
    return labels.astype(np.uint8)


def read_label_map(path: Path) -> Array:
    """Read a label map: palette indices, or 8- or 16-bit grey values.

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
            if image.mode not in ("P", "L", "1", "I;16", "I"):
                raise SourceError(
                    f"{path} is a colour picture ({image.mode}); a label map is an indexed or grey PNG "
                    "whose values are labels."
                )
            return np.asarray(image).astype(np.int32)
    except OSError as error:
        raise SourceError(f"{path} cannot be read as a label map: {error}.") from error


def data_root(given: Path | None) -> Path:
    """Return the folder of the sequences: the one given, else the one that ``MLBS_DATA`` names.

    Raises
    ------
    ConfigError
        If neither is there, or it is no folder.
    """
    root = given or (Path(os.environ[DATA_VARIABLE]) if os.environ.get(DATA_VARIABLE) else None)
    if root is None:
        raise ConfigError(f"Give --data ROOT, or set {DATA_VARIABLE} to the folder of the sequences.")
    if not root.is_dir():
        raise ConfigError(f"{root} is no folder; give the folder that holds the sequences.")
    return root


def find_sequences(root: Path) -> list[str]:
    """List all folders below the root with ``frames/`` and ``gt/``: relative names, in order."""
    folders = (truth.parent for truth in sorted(root.rglob("gt")) if truth.is_dir())
    return [folder.relative_to(root).as_posix() for folder in folders if (folder / "frames").is_dir()]


def open_sequence(name: str, root: Path | None) -> Sequence:
    """Open ``synthetic:NAME?…``, or the sequence folder of that name below the root.

    Raises
    ------
    ConfigError
        If there is no such scene or folder.
    SourceError
        If the folder cannot be used.
    """
    if name.startswith(SCHEME):
        return SceneSequence(name, scene_from_uri(name))
    folder = data_root(root) / name
    if not (folder / "gt").is_dir() or not (folder / "frames").is_dir():
        known = ", ".join(find_sequences(data_root(root))) or "none"
        raise ConfigError(f"{folder} does not hold frames/ and gt/; the sequences there are: {known}.")
    return FolderSequence(name, folder / "gt", folder / "frames")


def _by_stem(folder: Path) -> dict[str, Path]:
    """Map stems to the pictures of a folder, in the order in which a run reads them."""
    if not folder.is_dir():
        raise SourceError(f"{folder} is no folder; check the path.")
    return {path.stem: path for path in images_of(str(folder))}
