"""One stream in one process, without Ray: for notebooks, debugging and as the reference for the actors."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from os import PathLike
from threading import Lock
from typing import Any, Literal

import numpy as np

from mlbs_actors.appearance.own_appearance import Appearance, AppearanceFactory, made_by
from mlbs_actors.config import Config
from mlbs_actors.coordinator import Coordinator, CoordinatorState
from mlbs_actors.determinism import single_threaded
from mlbs_actors.errors import ConfigError, MlbsError
from mlbs_actors.flow.estimate import FlowFunction
from mlbs_actors.inspection import FrameInspection, inspect_frame
from mlbs_actors.kernels.machine_code import has_machine_code
from mlbs_actors.layer.layer import Layer
from mlbs_actors.layer.layer_state import LayerState
from mlbs_actors.messages import Array, FrameEvidence, LayerKind, Segmentation, readonly
from mlbs_actors.result import Result
from mlbs_actors.result_log import LOGGER, ResultLog
from mlbs_actors.segmentation.attached_parts import join_parts
from mlbs_actors.segmentation.segmenter import Segmenter, SegmenterState
from mlbs_actors.state_file import capture
from mlbs_actors.subtractor_arguments import (
    check_appearance,
    check_config,
    check_functions,
    check_ignored,
    check_video,
)
from mlbs_actors.tracking.trajectories import TrackFunction
from mlbs_actors.video_file import video_frames

__all__ = ["MultilayerSubtractor"]


@dataclass(frozen=True, slots=True)
class _LayerAtWork:
    kind: LayerKind
    state: LayerState


@dataclass(frozen=True, slots=True)
class _SubtractorState:
    """Everything that determines the next frame."""

    coordinator: CoordinatorState
    segmenter: SegmenterState
    layers: Mapping[int, _LayerAtWork]
    waiting: Mapping[int, Array]
    published: Mapping[int, Segmentation]
    known: tuple[int, ...]


@cache
def _say_if_it_compiles() -> None:
    """Warn, once, that the first frame takes long."""
    if not has_machine_code():
        LOGGER.warning(
            "This is the first use of this installation: it compiles for one to three minutes, once, or "
            "longer if the machine is busy. 'python -m mlbs_actors.warm_up', or the function "
            "mlbs_actors.compile_kernels, does that beforehand."
        )


class MultilayerSubtractor:
    """Labels every independently moving object of one moving-camera video, online.

    Parameters
    ----------
    config : Config, optional
        All parameters; the defaults serve every video.
    inspector : callable, optional
        Called with a :class:`~mlbs_actors.inspection.FrameInspection` for every frame that is labelled, in
        order: trajectories, motion fields and posteriors. The results are the same with it.
    flow : callable, optional
        Your own dense flow, in place of the configured one: maps two frames (H, W, 3) uint8 BGR to (H, W, 2)
        float, the displacement of each pixel from the first to the second, px. It is called twice a frame,
        once in each direction.
    ignored : (h, w) bool, optional
        Mask of what is no part of the scene, such as a logo or a bonnet; scaled to the frame. Most of it is
        found without.
    tracks : callable, optional
        Your own point tracker, which trajectories follow in place of the flow: maps two frames (H, W, 3)
        uint8 BGR and points of the first, (n, 2) float32, (x, y) in px, to their places in the second, (n, 2)
        float, and to whether they are seen there, (n,) bool. Where new ones begin is decided here.
    colour : {"bgr", "rgb"}
        Order of the channels of the frames that are given, and that ``segment`` yields. The label maps are
        the same. ``inspector``, ``flow`` and ``tracks`` are given BGR always.
    appearance : callable, optional
        Your own model of what a layer looks like, in place of its remembered colours: a class whose only
        argument is the layer's kind (``"background"``, ``"object"`` or ``"other"``), with the methods of
        :class:`~mlbs_actors.appearance.own_appearance.Appearance`. Each layer that is born gets one.

    Raises
    ------
    ConfigError
        If ``config`` is something else, such as a file's name, ``ignored`` is no mask, ``colour`` is
        neither, or one of the others cannot be called as it would be.

    Notes
    -----
    A subtractor belongs to one thread at a time: called while it is at work, it raises an
    :class:`~mlbs_actors.errors.MlbsError`. Several subtractors may run in several threads.
    It can be pickled between two frames, if the tags of the frames it holds can be. The copy continues as the
    original would have, to the byte, with the same versions of the packages on the same kind of CPU.
    The logger ``mlbs_actors`` gets records of cuts, frames of another size, and pictures that do not tell the
    camera's motion (``INFO``), and of ids that are born or end (``DEBUG``).

    Examples
    --------
    >>> for frame, result in MultilayerSubtractor().segment("street.mp4"):
    ...     show(frame, result.labels)                         # 0 = background

    Frame by frame:

    >>> subtractor = MultilayerSubtractor()
    >>> for frame in frames:                                   # (H, W, 3) uint8 BGR
    ...     for result in subtractor.apply(frame):
    ...         show(result.frame_index, result.labels)
    >>> for result in subtractor.flush():
    ...     show(result.frame_index, result.labels)
    """

    def __init__(
        self,
        config: Config | None = None,
        inspector: Callable[[FrameInspection], None] | None = None,
        flow: FlowFunction | None = None,
        ignored: Array | None = None,
        tracks: TrackFunction | None = None,
        colour: Literal["bgr", "rgb"] = "bgr",
        appearance: AppearanceFactory | None = None,
    ) -> None:
        check_config(config)
        check_functions(inspector, flow, tracks)
        check_ignored(ignored)
        check_appearance(appearance)
        if colour not in ("bgr", "rgb"):
            raise ConfigError(f'colour must be "bgr" or "rgb", not {colour!r}.')
        self.config = config or Config()
        self._inspector = inspector
        self._is_rgb = colour == "rgb"
        self._arguments = self.config, inspector, flow, ignored, tracks, colour, appearance  # to pickle
        self._appearance = appearance
        self._coordinator = Coordinator(self.config, flow=flow, ignored=ignored, tracks=tracks)
        self._segmenter = Segmenter(self.config)
        self._layers: dict[int, Layer] = {}
        self._waiting: dict[int, Array] = {}
        self._published: dict[int, Segmentation] = {}
        self._tags: dict[int, object] = {}
        self._known: set[int] = set()  # published ids that have not ended
        self._result_log = ResultLog()
        self._lock = Lock()

    def __repr__(self) -> str:
        frames = self._coordinator.state.next_frame
        if not frames:
            return "MultilayerSubtractor(no frame yet)"
        height, width = self._coordinator.state.epoch.shape
        objects = sum(one.kind != "background" for one in list(self._layers.values()))
        return f"MultilayerSubtractor({width}×{height}, frames {frames}, objects {objects})"

    def __getstate__(self) -> dict[str, Any]:
        with self._at_work():
            # Not the parts themselves: pickle forgets which arrays are read-only, and kernels are
            # compiled separately for those.
            state = _SubtractorState(
                self._coordinator.state,
                self._segmenter.state,
                {layer: _LayerAtWork(one.kind, one.state) for layer, one in self._layers.items()},
                self._waiting,
                self._published,
                tuple(self._known),
            )
            return {
                "arguments": self._arguments,
                "tags": self._tags,
                "state": capture(state),
                "own": {layer: one.own for layer, one in self._layers.items()},
            }

    def __setstate__(self, pickled: dict[str, Any]) -> None:
        self.__init__(*pickled["arguments"])  # type: ignore[misc]
        state = pickled["state"].state(_SubtractorState)
        self._coordinator.state = state.coordinator
        self._segmenter = Segmenter(self.config, state.segmenter)
        self._layers = {
            layer: Layer(self.config, layer, one.kind, one.state, pickled["own"][layer])
            for layer, one in state.layers.items()
        }
        self._waiting, self._published = state.waiting, state.published
        self._tags, self._known = pickled["tags"], set(state.known)

    def apply(self, frame: Array, *, tag: object = None, concealed: bool = False) -> list[Result]:
        """Take the next frame.

        Parameters
        ----------
        frame : (H, W, 3) uint8
            BGR, or RGB if ``colour`` says so. A frame of another size resets everything but the ids, which
            are never reused.
        tag : object
            Anything of yours, such as the frame's time or name; its result has it as ``tag``.
        concealed : bool
            Whether you know that it is damaged, as of a decoder that made up a part. Its result has the
            labels of the one before and the status ``"damaged"``, and nothing is learnt from it.

        Returns
        -------
        list of Result
            0, 1 or several results, in frame order: the first few frames are held until motion is known.

        Raises
        ------
        FrameError
            If the frame has another type, or a flow or tracks function returned something else.
        LayerError
            If an appearance returned something else.
        MlbsError
            If called by another thread, or the inspector, during a frame; that frame is finished.
        """
        return [result for _, result in self._step(frame, tag, concealed)]

    def flush(self) -> list[Result]:
        """Return the results of the frames still held; the stream has ended. Raises as :meth:`apply` does."""
        return [result for _, result in self._finish()]

    def segment(
        self, video: str | PathLike[str] | Iterable[Array]
    ) -> Generator[tuple[Array, Result], None, None]:
        """Segment a video to its end.

        Parameters
        ----------
        video : path or iterable of (H, W, 3) uint8
            A file that OpenCV decodes, which is closed at the end or when you stop, or frames as for
            :meth:`apply`.

        Yields
        ------
        frame : (H, W, 3) uint8
            A copy, which you may draw on; BGR, or RGB if ``colour`` says so.
        result : Result
            Of that frame. They come in order, as soon as they are known; only frames that still wait for
            their results are held.

        Raises
        ------
        SourceError
            If the file cannot be read, or this is neither a file nor frames.
        FrameError, MlbsError
            As :meth:`apply` does.
        """
        check_video(video)
        if isinstance(video, (str, PathLike)):
            with closing(video_frames(video)) as frames:
                yield from self.segment(self._recoloured(frame) for frame in frames)
            return
        for frame in video:
            for shown, result in self._step(frame):
                yield self._recoloured(shown).copy(), result
        for shown, result in self._finish():
            yield self._recoloured(shown).copy(), result

    def _recoloured(self, frame: Array) -> Array:
        """Change between BGR and the order of the caller's channels."""
        return frame[..., ::-1] if self._is_rgb else frame

    def _step(self, frame: Array, tag: object = None, concealed: bool = False) -> list[tuple[Array, Result]]:
        _say_if_it_compiles()
        if isinstance(frame, np.ndarray):  # the coordinator rejects anything else
            # The caller may reuse its buffer.
            frame = self._recoloured(frame).copy() if frame.ndim == 3 else frame.copy()
            frame.setflags(write=False)
        with self._at_work(), single_threaded():
            index = self._coordinator.state.next_frame
            wanted = self._coordinator.feedback_index(index)
            feedback = None if wanted is None else partial(self._published.__getitem__, wanted)
            evidence = self._coordinator.step(index, frame, feedback, concealed)
            self._waiting[index], self._tags[index] = frame, tag
            return self._results(evidence)

    def _finish(self) -> list[tuple[Array, Result]]:
        with self._at_work(), single_threaded():
            return self._results(self._coordinator.flush())

    def _results(self, evidence: Sequence[FrameEvidence]) -> list[tuple[Array, Result]]:
        results = []
        for place, one in enumerate(evidence):
            index = one.frame_index
            frame, tag = self._waiting.pop(index), self._tags.pop(index)
            published = join_parts(self._label(one, frame))
            possible = self._possible_ids(evidence[place + 1 :])
            result = Result.of(published, tag, self._known, possible)
            self._result_log.note(result)
            results.append((frame, result))
        return results

    def _possible_ids(self, later: Sequence[FrameEvidence]) -> set[int]:
        """Return a superset of the ids that frames after the one just labelled may have.

        Parameters
        ----------
        later : sequence of FrameEvidence
            What the coordinator has decided on already; it is ahead by so many frames.
        """
        # Parts have the id of their object even when that has ended.
        wholes = self._segmenter.state.parts.objects().values()
        return {
            *self._coordinator.possible_layers(),
            *(one.layer for frame in later for one in frame.tracks),
            *wholes,
        }

    @contextmanager
    def _at_work(self) -> Iterator[None]:
        if not self._lock.acquire(blocking=False):
            raise MlbsError(
                "This MultilayerSubtractor is at work on a frame; give each thread a subtractor of its own, "
                "or wait until apply has returned."
            )
        try:
            yield
        finally:
            self._lock.release()

    def _own(self, kind: LayerKind) -> Appearance | None:
        """Make the caller's model of a new-born layer, if there is one."""
        return None if self._appearance is None else made_by(self._appearance, kind)

    def _label(self, made: FrameEvidence, frame: Array) -> Segmentation:
        evidence = readonly(made)
        index = evidence.frame_index
        for retired in evidence.retired:
            del self._layers[retired]
        posteriors = []
        for one in evidence.tracks:
            if one.layer not in self._layers:
                self._layers[one.layer] = Layer(self.config, one.layer, one.kind, own=self._own(one.kind))
            layer = self._layers[one.layer]
            posteriors.append(readonly(layer.step(evidence, self._published.get(index - 1))))
        segmentation = self._segmenter.step(evidence, frame, posteriors)
        self._published = {known: result for known, result in self._published.items() if known > index - 3}
        self._published[index] = segmentation
        if self._inspector is not None:
            self._inspector(inspect_frame(self.config, evidence, self._layers, posteriors, segmentation))
        return segmentation
