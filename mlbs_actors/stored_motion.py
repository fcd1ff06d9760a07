"""Motion that another program has computed and stored, for the engine to use in place of its own.

A folder of flow holds ``forward/NAME/STEM.flo``, the displacement of each pixel of the frame STEM to the next
frame, and ``backward/NAME/STEM.flo``, that to the frame before. NAME is the video's, STEM that of its
picture. A ``.flo`` file is Middlebury's; ``.npy`` holds (H, W, 2) float instead.

A folder of tracks holds ``NAME.npz`` with ``tracks``, (T, n, 2) float, the place (x, y) in px of each of n
points in each of T frames, and ``visible``, (T, n) bool, where it is seen. The engine begins trajectories
where it likes; each follows the stored point that is nearest, if one is near.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mlbs_actors.array_files import load_array, load_arrays
from mlbs_actors.errors import ConfigError, SourceError
from mlbs_actors.messages import Array

__all__ = ["FollowedFrame", "StoredMotion", "read_flow"]

_FLO_MAGIC = 202021.25
_UNKNOWN = 1e9
_NEAR = 4.0  # distance up to which a trajectory follows a stored point, px

#: Newest frames whose motion can be asked for. The engine asks for older ones only to compare a new frame
#: with what it showed long ago.
_REMEMBERED = 64


@dataclass(frozen=True, slots=True)
class FollowedFrame:
    """A frame that the engine was given.

    Attributes
    ----------
    index : int
        In its source, from 0.
    stem : str
        Of its name.
    digest : str
        Of its pixels: the engine asks for the motion of pictures, not of indices.
    """

    index: int
    stem: str
    digest: str


class StoredMotion:
    """Stored flow and tracks of one video, as the functions that the engine takes.

    Parameters
    ----------
    name : str
        Of the video, in the folders.
    flow, tracks : Path, optional
        Folders; see above. One of them at least.
    here : bool
        Whether the folders are looked at now; else with the first frame, by then in the process that reads
        them.

    Attributes
    ----------
    flow, tracks : callable or None
        For ``MultilayerSubtractor(flow=…, tracks=…)``; None without a folder.
    followed : tuple of FollowedFrame
        The newest frames, oldest first: all that it remembers.

    Raises
    ------
    ConfigError
        Without a folder.
    SourceError
        If a folder has nothing of this video, or its tracks cannot be read.

    Examples
    --------
    >>> stored = StoredMotion("street", flow=Path("flow"))
    >>> subtractor = MultilayerSubtractor(flow=stored.flow, tracks=stored.tracks)
    >>> for index, path in enumerate(sorted(Path("street").iterdir())):
    ...     frame = cv2.imread(str(path))
    ...     stored.follow(index, path.stem, frame)
    ...     results = subtractor.apply(frame)
    """

    def __init__(
        self,
        name: str,
        flow: str | Path | None = None,
        tracks: str | Path | None = None,
        *,
        here: bool = True,
    ) -> None:
        if flow is None and tracks is None:
            raise ConfigError("StoredMotion needs a folder to read from: give flow=, tracks= or both.")
        self._name = name
        self._flow = None if flow is None else Path(flow)
        self._tracks = None if tracks is None else Path(tracks)
        self._stored: tuple[Array, Array] | None = None
        self._followed = deque[FollowedFrame](maxlen=_REMEMBERED)
        if here:
            self._check()

    def __repr__(self) -> str:
        folders = (("flow", self._flow), ("tracks", self._tracks))
        given = "".join(f", {name} in {folder}" for name, folder in folders if folder is not None)
        last = f"the last {self._followed[-1].stem}" if self._followed else "no frame followed yet"
        return f"StoredMotion({self._name}{given}, {last})"

    @property
    def flow(self) -> Callable[[Array, Array], Array] | None:
        """For ``MultilayerSubtractor(flow=…)``; None without a folder of flow.

        It maps two frames, (H, W, 3) uint8, to the displacement of each pixel from the first to the second,
        (H, W, 2) float32, x before y, px. That is 0 where the file says that it is unknown, and everywhere if
        the frames are not neighbours or one of them is none of :attr:`followed`.

        It raises SourceError if neither is, or a file is missing, cannot be read as flow, or is of another
        size.
        """
        return None if self._flow is None else self._stored_flow

    @property
    def tracks(self) -> Callable[[Array, Array, Array], tuple[Array, Array]] | None:
        """For ``MultilayerSubtractor(tracks=…)``; None without a folder of tracks.

        It maps two frames, (H, W, 3) uint8, and points of the first, (n, 2) float32, (x, y) in px, to their
        places in the second, (n, 2) float32, and to whether they are seen there, (n,) bool: none is if one
        of the frames is not of :attr:`followed`, nor is a point with no stored one within 4 px.

        It raises SourceError if neither is, or the file is missing, cannot be read as tracks, or has fewer
        frames.
        """
        return None if self._tracks is None else self._stored_tracks

    @property
    def followed(self) -> tuple[FollowedFrame, ...]:
        """The newest 64 frames, oldest first. May be set, to go on from those that another one has followed.

        Of more than 64, the newest are kept. Frames that were set are not checked against the folders.
        """
        return tuple(self._followed)

    @followed.setter
    def followed(self, frames: Sequence[FollowedFrame]) -> None:
        self._followed = deque(frames, maxlen=_REMEMBERED)

    def follow(self, index: int, stem: str, frame: Array) -> None:
        """Note a frame before the engine gets it.

        Parameters
        ----------
        index : int
            In its source, from 0.
        stem : str
            Of its name.
        frame : (H, W, 3) uint8
            As the functions are given it: BGR.

        Raises
        ------
        SourceError
            At the first one, if a folder has nothing of this video, or its tracks cannot be read: with
            ``here=False`` that is seen only now.
        """
        if not self._followed:
            self._check()
        self._followed.append(FollowedFrame(index, stem, _digest(frame)))

    def _check(self) -> None:
        if self._flow is not None:
            for way in ("forward", "backward"):
                if not (self._flow / way / self._name).is_dir():
                    raise SourceError(
                        f"There is no flow in {self._flow / way / self._name}; a folder of flow needs "
                        f"forward/{self._name} and backward/{self._name}."
                    )
        if self._tracks is not None:
            self._read_tracks(self._tracks)

    def _pair(self, first: Array, second: Array) -> tuple[FollowedFrame, FollowedFrame] | None:
        """Return which frames two pictures are: of equal ones the newest; None if one is forgotten.

        The engine always asks for the motion from or to a picture that it was given just now.
        """
        start, end = self._frame(first), self._frame(second)
        if start is None and end is None:
            raise SourceError(
                f"It is not known which stored motion of {self._name} belongs to this frame: call "
                "follow(index, stem, frame) before each apply(frame), with the same picture, in BGR."
            )
        return None if start is None or end is None else (start, end)

    def _frame(self, picture: Array) -> FollowedFrame | None:
        digest = _digest(picture)
        return next((one for one in reversed(self._followed) if one.digest == digest), None)

    def _stored_flow(self, first: Array, second: Array) -> Array:
        """Return the displacement of each pixel from the first frame to the second: (H, W, 2) float32, px."""
        assert self._flow is not None
        pair = self._pair(first, second)
        if pair is None or abs(pair[1].index - pair[0].index) != 1:
            # Equal frames, or a pair across a damaged one: no motion is known.
            return np.zeros((*first.shape[:2], 2), np.float32)
        start, end = pair
        folder = self._flow / ("forward" if end.index > start.index else "backward") / self._name
        places = (folder / f"{start.stem}.flo", folder / f"{start.stem}.npy")
        path = next((one for one in places if one.exists()), None)
        if path is None:
            raise SourceError(f"There is no {start.stem}.flo and no {start.stem}.npy in {folder}.")
        flow = read_flow(path)
        if flow.shape[:2] != first.shape[:2]:
            raise SourceError(
                f"{path} is of {flow.shape[:2]} px (rows, columns), the frame {first.shape[:2]}."
            )
        return flow

    def _stored_tracks(self, first: Array, second: Array, points: Array) -> tuple[Array, Array]:
        """Return where points (n, 2) of the first frame are in the second, and which of them are seen."""
        from scipy.spatial import cKDTree

        assert self._tracks is not None
        places, visible = self._stored or self._read_tracks(self._tracks)
        pair = self._pair(first, second)
        lost = points.copy(), np.zeros(len(points), bool)
        if pair is None:
            return lost
        start, end = pair
        if max(start.index, end.index) >= len(places):
            raise SourceError(
                f"{self._tracks / self._name}.npz has tracks of {len(places)} frames; frame {end.index} is "
                "beyond them."
            )
        both = visible[start.index] & visible[end.index]
        if not both.any():
            return lost
        distance, nearest = cKDTree(places[start.index][both]).query(points)
        motion = (places[end.index] - places[start.index])[both][nearest]
        return (points + motion).astype(np.float32), np.asarray(distance < _NEAR)

    def _read_tracks(self, folder: Path) -> tuple[Array, Array]:
        path = folder / f"{self._name}.npz"
        expected = (
            "a folder of tracks needs NAME.npz with tracks (frames, points, 2) float and visible (frames, "
            "points) bool"
        )
        try:
            tracks, visible = load_arrays(path, "tracks", "visible")
        except FileNotFoundError:
            raise SourceError(f"There are no tracks in {path}; {expected}.") from None
        except (OSError, ValueError) as error:
            raise SourceError(f"{path} cannot be read as tracks: {error}; {expected}.") from error
        is_float = np.issubdtype(tracks.dtype, np.floating)
        if tracks.ndim != 3 or tracks.shape[2] != 2 or not is_float or visible.dtype != bool:
            raise SourceError(
                f"{path} holds tracks {tracks.shape} {tracks.dtype} and visible {visible.dtype}; {expected}."
            )
        if visible.shape != tracks.shape[:2]:
            raise SourceError(f"{path} holds visible {visible.shape} of tracks {tracks.shape}; {expected}.")
        self._stored = tracks, visible & np.isfinite(tracks).all(axis=2)
        return self._stored


def _digest(frame: Array) -> str:
    return hashlib.blake2b(np.ascontiguousarray(frame).data, digest_size=16).hexdigest()


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
        flow = load_array(path) if path.suffix == ".npy" else _read_flo(path.read_bytes())
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
