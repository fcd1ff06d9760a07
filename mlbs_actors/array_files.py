"""NumPy's files of other programs, of which anything may be damaged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.lib.npyio import NpzFile

from mlbs_actors.messages import Array

__all__ = ["load_array", "load_arrays"]


def load_array(path: Path, *, mapped: bool = False) -> Array:
    """Read a ``.npy`` file.

    Parameters
    ----------
    path : Path
    mapped : bool
        Whether it stays on the disk, and is read where it is used.

    Raises
    ------
    OSError
        If it cannot be opened.
    ValueError
        If it holds no array.
    """
    with _one_error():
        if mapped:
            return npy.open_memmap(path, mode="r")
        with path.open("rb") as file:
            return np.asarray(npy.read_array(file))


def load_arrays(path: Path, *names: str) -> tuple[Array, ...]:
    """Read arrays of a ``.npz`` file, by their names in it; raises as :func:`load_array` does."""
    with _one_error(), path.open("rb") as file:  # which NumPy leaves open if it is damaged
        archive = np.load(file)
        if not isinstance(archive, NpzFile):
            raise ValueError("it is a single array, as .npy files are")
        with archive:
            return tuple(np.asarray(archive[name]) for name in names)


@contextmanager
def _one_error() -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError):
        raise
    except Exception as error:  # NumPy, zipfile, zlib and tokenize say in many ways that a file is damaged
        raise ValueError(str(error) or type(error).__name__) from error
