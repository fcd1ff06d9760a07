"""Dense flow that another program has computed and stored, for the engine to use in place of its own.

A folder of flow holds ``forward/NAME/STEM.flo``, the displacement of each pixel of the frame STEM to the next
frame, and ``backward/NAME/STEM.flo``, that to the frame before. NAME is the sequence's, STEM that of its
picture. A ``.flo`` file is Middlebury's; ``.npy`` holds (H, W, 2) float instead.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from orchestrator.evaluation.sequences import Sequence

__all__ = ["StoredFlow", "read_flow"]

_FLO_MAGIC = 202021.25
_UNKNOWN = 1e9


class StoredFlow:
    """A flow function that looks up the frames it is given, and reads their flow.

    Parameters
    ----------
    folder : Path
    sequence : Sequence

    Raises
    ------
    SourceError
        If the folder has no flow of the sequence.
    """

    def __init__(self, folder: Path, sequence: Sequence) -> None:
        self._folders = {1: folder / "forward" / sequence.name, -1: folder / "backward" / sequence.name}
        for path in self._folders.values():
            if not path.is_dir():
                raise SourceError(f"There is no flow in {path}; --flow needs forward/NAME and backward/NAME.")
        self._stems = sequence.stems
        self._places: dict[bytes, int] = {}

    def follow(self, index: int, frame: Array) -> None:
        """Note a frame before the engine gets it: it asks for the flow of pictures, not of indices."""
        self._places[_digest(frame)] = index  # of equal pictures the latest is meant

    def __call__(self, first: Array, second: Array) -> Array:
        """Return the displacement of each pixel from the first frame to the second: (H, W, 2) float32, px."""
        start, end = self._places[_digest(first)], self._places[_digest(second)]
        if abs(end - start) != 1:
            # Equal frames, or a pair across a damaged one: no motion is known.
            return np.zeros((*first.shape[:2], 2), np.float32)
        folder, stem = self._folders[end - start], self._stems[start]
        path = next((one for one in (folder / f"{stem}.flo", folder / f"{stem}.npy") if one.exists()), None)
        if path is None:
            raise SourceError(f"There is no {stem}.flo and no {stem}.npy in {folder}.")
        flow = read_flow(path)
        if flow.shape[:2] != first.shape[:2]:
            raise SourceError(
                f"{path} is of {flow.shape[:2]} px (rows, columns), the frame {first.shape[:2]}."
            )
        return flow


def _digest(frame: Array) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(frame).data, digest_size=16).digest()


def read_flow(path: Path) -> Array:
    """Read a ``.flo`` or ``.npy`` file.

    Returns
    -------
    (H, W, 2) float32
        px; 0 where the file says that the motion is unknown.

    Raises
    ------
    SourceError
        If it is not readable as flow.
    """
    try:
        flow = np.load(path) if path.suffix == ".npy" else _read_flo(path.read_bytes())
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} cannot be read as flow: {error}.") from error
    if flow.ndim != 3 or flow.shape[2] != 2 or not np.issubdtype(flow.dtype, np.floating):
        raise SourceError(f"{path} holds {flow.shape} {flow.dtype}; flow is (height, width, 2) float.")
    # Middlebury's format marks unknown motion by values above 1e9, others by NaN.
    known = (np.abs(flow) < _UNKNOWN).all(axis=2, keepdims=True)
    return np.where(known, flow, 0).astype(np.float32)


def _read_flo(data: bytes) -> Array:
    if len(data) < 12 or np.frombuffer(data, "<f4", 1)[0] != _FLO_MAGIC:
        raise ValueError("it does not begin as a .flo file does")
    width, height = np.frombuffer(data, "<i4", 2, 4).tolist()
    return np.frombuffer(data, "<f4", offset=12).reshape(height, width, 2)
