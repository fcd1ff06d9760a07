"""Label maps that anybody has written: a folder for each method, and in it the masks of each sequence.

The masks of a sequence are PNG files with the names of its frames, in a folder of the sequence's name or in
``masks`` below that; ``.npy`` arrays of a frame each; or one ``.npy`` array of all frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mlbs_actors.array_files import load_array
from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import SCHEME
from orchestrator.evaluation import sequences

__all__ = ["MaskFolder", "MethodMasks", "mask_folders", "short_name"]

_SUFFIXES = (".png", ".npy")
_SHOWN = 6  # names listed in an error


@dataclass(frozen=True, slots=True)
class MethodMasks:
    """The label maps of one sequence by one method.

    Attributes
    ----------
    files : mapping of int to Path
        Frame index → its file. Empty if ``array`` has them.
    array : (T, H, W) integer or bool, or None
        All frames in one array, from the first.
    folder : Path
        Where they were found: that of the sequence.
    """

    files: Mapping[int, Path]
    array: Array | None
    folder: Path

    @property
    def frames(self) -> frozenset[int]:
        """Indices of the frames that have a label map."""
        return frozenset(self.files if self.array is None else range(len(self.array)))

    def label_maps(self, frames: Sequence[int]) -> Iterator[tuple[int, Array]]:
        """Read the label maps of some frames: index and (H, W) int32.

        Raises
        ------
        SourceError
            If one cannot be read as labels.
        """
        for index in frames:
            if self.array is not None:
                yield index, _as_labels(self.array[index], self.folder)
            elif self.files[index].suffix == ".npy":
                yield index, _as_labels(_loaded(self.files[index], 2), self.files[index])
            else:
                yield index, sequences.read_label_map(self.files[index])


@dataclass(frozen=True, slots=True)
class MaskFolder:
    """The folder of one method.

    Attributes
    ----------
    name : str
        The method's, in tables.
    folder : Path
    """

    name: str
    folder: Path

    def masks_of(self, sequence: sequences.Sequence, *, by_short_name: bool = True) -> MethodMasks:
        """Find the label maps of a sequence.

        Parameters
        ----------
        sequence : Sequence
        by_short_name : bool
            Whether they may be in a folder of the last part of its name.

        Raises
        ------
        SourceError
            If there are none, with the layout that is expected.
        """
        names = [sequence.name, short_name(sequence.name)] if by_short_name else [sequence.name]
        stranger: Path | None = None  # a file whose name is no frame's
        for place in (self.folder / name for name in dict.fromkeys(names)):
            for folder in (place / "masks", place):
                present = sorted(path for path in folder.glob("*") if path.suffix in _SUFFIXES)
                by_stem = {path.stem: path for path in present}
                files = {index: by_stem[stem] for index, stem in enumerate(sequence.stems) if stem in by_stem}
                if files:
                    return MethodMasks(files, None, place)
                stranger = stranger or next(iter(present), None)
            whole = place.with_name(f"{place.name}.npy")
            if whole.is_file():
                return MethodMasks({}, _whole(whole, len(sequence.stems)), place)
        raise SourceError(self._missing(sequence, names, stranger))

    def _missing(self, sequence: sequences.Sequence, names: Sequence[str], stranger: Path | None) -> str:
        stem, name = sequence.stems[0], names[-1]
        if stranger is not None:
            found = f"{stranger} has not the name of a frame of {sequence.name}"
        else:
            there = sorted(path.name for path in self.folder.iterdir())
            more = ", …" if len(there) > _SHOWN else ""
            found = f"{self.folder} has {', '.join(there[:_SHOWN]) or 'nothing'}{more}"
        return (
            f"There are no masks of {sequence.name}: {found}. Expected is, for its frames "
            f"{stem} … {sequence.stems[-1]}, one of\n"
            f"  {self.folder}/{name}/{stem}.png        indexed or grey, a pixel's value is its label; or in "
            "the colours of DAVIS\n"
            f"  {self.folder}/{name}/masks/{stem}.png  the same, as a run writes it\n"
            f"  {self.folder}/{name}/{stem}.npy        (height, width) integers\n"
            f"  {self.folder}/{name}.npy        (frames, height, width) integers"
        )


def mask_folders(given: Sequence[str]) -> tuple[MaskFolder, ...]:
    """Read the values of ``--masks``: DIR, or METHOD=DIR.

    Raises
    ------
    ConfigError
        If one is no folder, or two methods have the same name.
    """
    folders: dict[str, Path] = {}
    for text in given:
        name, equals, place = text.partition("=")
        named = bool(equals and name and "/" not in name and not Path(text).is_dir())
        folder = Path(place) if named else Path(text)
        method = name if named else folder.resolve().name
        if not folder.is_dir():
            raise ConfigError(f"--masks: {folder} is no folder; give one that holds NAME/FRAME.png.")
        if method in folders:
            raise ConfigError(
                f"--masks: two methods are called {method}; write METHOD=DIR, as in mine={folder}."
            )
        folders[method] = folder
    return tuple(MaskFolder(name, folder) for name, folder in folders.items())


def short_name(sequence: str) -> str:
    """Return the last part of a sequence's name; of a synthetic scene, what a run calls it."""
    if sequence.startswith(SCHEME):
        return sequence.removeprefix(SCHEME).partition("?")[0]
    return Path(sequence).name


def _whole(path: Path, frames: int) -> Array:
    array = _loaded(path, 3)
    if len(array) != frames:
        raise SourceError(f"{path} holds {len(array)} label maps; the sequence has {frames} frames.")
    return array


def _loaded(path: Path, dimensions: int) -> Array:
    try:
        array = load_array(path, mapped=True)
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} cannot be read as a label map: {error}.") from error
    if array.ndim != dimensions or array.dtype.kind not in "iub":
        shape = "(frames, height, width)" if dimensions == 3 else "(height, width)"
        raise SourceError(f"{path} holds {array.shape} {array.dtype}; label maps are {shape} integers.")
    return array


def _as_labels(array: Array, path: Path) -> Array:
    labels = array.astype(np.int32)
    if labels.min(initial=0) < 0:
        raise SourceError(f"{path} holds labels below 0; the background is 0, objects are 1 and more.")
    return labels
