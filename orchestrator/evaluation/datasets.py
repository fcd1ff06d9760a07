"""Where sequences with truth are found: the folders of several data sets, as they come.

| layout | pictures | truth |
|---|---|---|
| this project's | ``NAME/frames/`` | ``NAME/gt/`` |
| DAVIS 2016, 2017, YouTube-VOS | ``JPEGImages/…/NAME/`` | ``Annotations/…/NAME/`` |
| BMS-26, FBMS-59 | ``NAME/`` | ``NAME/*Def.dat`` or ``NAME/GroundTruth/*Def.dat`` and what it lists |

Between ``Annotations`` and NAME may be a folder for the resolution; ``Annotations_unsupervised`` serves as
well. Truth has the stems of its pictures, and not every picture needs truth. A *data root* is searched at any
depth; a sequence's name is the path of its truth below the root without ``gt`` and ``Annotations``:
``mlbs/cars1``, ``480p/dog``.
"""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from mlbs_actors.errors import ConfigError
from mlbs_actors.scenes.synthetic import SCHEME, scene_from_uri
from orchestrator.evaluation.bms_truth import BmsSequence, definition_of
from orchestrator.evaluation.options import DATA_VARIABLE
from orchestrator.evaluation.sequences import FileSequence, FolderSequence, SceneSequence, Sequence

__all__ = [
    "chosen_sequences",
    "data_root",
    "find_sequences",
    "open_sequence",
    "open_truth",
    "truth_name",
]

_ANNOTATIONS = frozenset({"Annotations", "Annotations_unsupervised"})


def data_root(given: str | Path | None) -> Path:
    """Return the folder of the sequences: the one given, else the one that ``MLBS_DATA`` names.

    Raises
    ------
    ConfigError
        If neither is there, or it is no folder.
    """
    named = given or os.environ.get(DATA_VARIABLE)
    if not named:
        raise ConfigError(f"Give --data ROOT, or set {DATA_VARIABLE} to the folder of the sequences.")
    root = Path(named)
    if not root.is_dir():
        raise ConfigError(f"{root} is no folder; give the folder that holds the sequences.")
    return root


def find_sequences(root: Path) -> list[str]:
    """List the names of all sequences below the root, in order."""
    return [_name(truth, root) for truth in sorted(_truth_folders(root))]


def chosen_sequences(asked: Iterable[str], data: Path | None) -> list[str]:
    """List the sequences of names, globs of names and ``synthetic:`` URIs.

    Raises
    ------
    ConfigError
        If there is no data root, or a glob fits nothing below it.
    """
    return [name for text in asked for name in _names_of(text, data)]


def _names_of(text: str, data: Path | None) -> list[str]:
    if text.startswith(SCHEME) or not set(text) & set("*?["):
        return [text]
    root = data_root(data)
    names = fnmatch.filter(find_sequences(root), text)
    if not names:
        raise ConfigError(
            f"No sequence {text} is below {root}: there must be frames/ and gt/, JPEGImages/ and "
            "Annotations/, or pictures and a file …Def.dat."
        )
    return names


def open_sequence(name: str, root: str | Path | None) -> Sequence:
    """Open ``synthetic:NAME?…``, or the sequence of that name below the root.

    Parameters
    ----------
    name : str
    root : str or Path or None
        None for the folder that the environment variable ``MLBS_DATA`` names. Scenes need none.

    Raises
    ------
    ConfigError
        If there is no such scene or sequence, or no root to look below.
    SourceError
        If its folders cannot be used.
    """
    if name.startswith(SCHEME):
        return SceneSequence(name, scene_from_uri(name))
    truth = _truth_of(name, data_root(root))
    if truth is None:
        known = ", ".join(find_sequences(data_root(root))) or "none"
        raise ConfigError(f"There is no sequence {name} below {data_root(root)}; those there are: {known}.")
    return open_truth(name, truth)


def open_truth(name: str, truth: Path) -> FileSequence:
    """Open the sequence whose truth is in a folder, with its pictures if they are where they belong.

    Raises
    ------
    SourceError
        If the folder, or that of the pictures, cannot be used.
    """
    definition = definition_of(truth)
    if definition is not None:
        return BmsSequence(name, definition)
    pictures = _pictures_of(truth)
    return FolderSequence(name, truth, pictures if pictures.is_dir() else None)


def truth_name(truth: Path) -> str:
    """Return the name that a stream with this folder of truth has: that of the pictures' sequence."""
    return (truth.parent if truth.name in ("gt", "GroundTruth") else truth).name


def _truth_folders(root: Path) -> Iterator[Path]:
    """Yield the folders of truth of all sequences that have pictures."""
    for folder, _, _ in os.walk(root, followlinks=True):
        path = Path(folder)
        if path.name != "GroundTruth" and _is_truth(path):  # the former is found with the folder it is in
            yield path


def _truth_of(name: str, root: Path) -> Path | None:
    """Return the folder of truth of a sequence, the other way round than :func:`_name`."""
    parts = Path(name).parts
    places = [root / name / "gt", root / name]
    places += [root.joinpath(*parts[:depth], "Annotations", *parts[depth:]) for depth in range(len(parts))]
    return next((place for place in places if _is_truth(place)), None)


def _is_truth(path: Path) -> bool:
    """Whether a folder holds the truth of a sequence, with pictures where they belong."""
    if path.name == "gt" or not _ANNOTATIONS.isdisjoint(path.parts[:-1]):
        return _pictures_of(path).is_dir() and any(path.glob("*.png"))
    return definition_of(path) is not None


def _pictures_of(truth: Path) -> Path:
    """Return where the pictures of a folder of truth belong."""
    for place in reversed(range(len(truth.parts) - 1)):
        if truth.parts[place] in _ANNOTATIONS:
            return Path(*truth.parts[:place], "JPEGImages", *truth.parts[place + 1 :])
    return truth.parent / "frames"


def _name(truth: Path, root: Path) -> str:
    parts = truth.relative_to(root).parts
    return "/".join(part for part in parts if part not in ("gt", "Annotations")) or "."
