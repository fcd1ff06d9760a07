"""The interface between a stream's actors and the program that drives them.

The driver builds a :class:`StreamSpec`, gives it to a :class:`StreamHost` and gets a
:class:`RunningStream`; it then asks for one bounded burst of frames after the other::

    running = host.start(spec)                  # returns at once; the actors come up in the background
    while not (progress := running.advance().result()).done:
        ...
    running.stop(drain=False)

Frames come from a :class:`~mlbs_actors.source.FrameReader`, built inside the stream's reader process; results
go to a :class:`StreamSink`, built inside the node's sink process. Neither passes through the driver.

A stream resumes where its record ends: :attr:`StreamSink.opening` names the snapshot that all its parts go
back to. Frames and rows after it come a second time; the record skips those that it already has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from mlbs_actors.config import Config
from mlbs_actors.messages import Array, LayerAppearance, Segmentation
from mlbs_actors.source import FrameReader, GapStatus, SourceFrame, SourceSilence
from mlbs_actors.stored_motion import StoredMotion

__all__ = [
    "Opening",
    "RunningStream",
    "Snapshot",
    "StreamHost",
    "StreamProgress",
    "StreamSink",
    "StreamSpec",
]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The states of all parts of a stream after the same frame, one file each in a folder.

    Attributes
    ----------
    folder : Path
    rows : int
        Rows of the record before it.
    label_maps : int
        Those of them that have a label map.
    parts : tuple of str
        Names of the files.
    """

    folder: Path
    rows: int
    label_maps: int
    parts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Opening:
    """State of a record when it is opened.

    Attributes
    ----------
    snapshots : Path, optional
        Folder for snapshots, each a subfolder named by its rows; None for no snapshots.
    resume_from : Snapshot, optional
        Where the stream resumes; None for its start. The next row is the one after it.
    """

    snapshots: Path | None = None
    resume_from: Snapshot | None = None


class StreamSink(Protocol):
    """The open record of one stream, in the node's sink process.

    Rows come in the order of their source indices; rows after the snapshot to which a stream went back come
    twice. In the record of a live source only rows covered by a snapshot count, as others cannot be read
    again. Every method raises SinkError if the record cannot be written; the stream then fails.
    """

    @property
    def opening(self) -> Opening:
        """State of the record when it was opened."""

    def write(
        self, segmentation: Segmentation, frame: SourceFrame, background: LayerAppearance | None = None
    ) -> int:
        """Write one result; return the number of label maps of this stream committed so far.

        The arrays are valid until the second label map after this one: copy what must stay longer.
        ``background`` has the background's remembered colours at that frame, if requested by
        :attr:`StreamSpec.wants_background`. A label map is committed once it would survive a kill, which may
        be some frames later.
        """

    def gap(self, index: int, pts: float, status: GapStatus) -> int:
        """Record source frame ``index`` as one without a label map; return as :meth:`write` does."""

    def silent(self) -> None:
        """Note that a camera sends nothing at present; a gap may follow, or the next picture."""

    def configure(self, settings: object) -> None:
        """Follow other settings from the next row on; they are those of whoever has opened the record."""

    def keep(self, snapshot: Snapshot) -> bool:
        """Register a snapshot to go back to; False if its files are not complete yet."""

    def provisional(self) -> None:
        """Mark the label maps from here on as provisional: an interrupted stream lacked later frames.

        They are kept to be looked at; a stream that resumes replaces them.
        """

    def close(self, *, whole: bool) -> int:
        """Commit the rest and close all files; return the final count. May be called twice.

        Parameters
        ----------
        whole : bool
            Whether the stream came to its end, so that its snapshots can be removed.
        """


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """All that is needed to run one stream; picklable, and cheap to pickle.

    Attributes
    ----------
    name : str
        The stream's name in the record and in every message.
    config : Config
    open_reader : callable
        Picklable; called once, in the reader process. Raises SourceError if there is no such source.
    open_sink : callable
        Picklable; called once, in the sink process. Raises SinkError.
    max_frames : int, optional
        The stream ends after this many label maps; frames of the source without one do not count.
    wants_background : callable, optional
            Picklable; returns for a source index whether the sink wants the background's appearance with
            that frame. By default it never does.
    source : str
        What ``open_reader`` opens, for messages: without credentials.
    line : int, optional
        Line number in the list of streams, from 1.
    live : bool
        Whether it is a camera; any other source gives the same frames again when it is opened again.
    last_try : bool
        Whether this is the last start: if the reader of a file dies, the stream ends with the frames before.
    snapshot_rows : int
        Least number of rows of the record between snapshots; of a live source label maps.
    snapshot_seconds : float
        Least time between snapshots of a file, s: quick streams would spend a tenth of their time on
        snapshots. A live reader keeps its frames for a limited number of rows only.
    path : Path, optional
        The file or folder that ``open_reader`` reads; None if it can be read from every machine.
    ignored : (h, w) bool, optional
        Mask of what is fixed in the picture, not in the scene; scaled to the frames.
    motion : StoredMotion, optional
        Of the frames by their names; takes the place of what the engine would compute.
    """

    name: str
    config: Config
    open_reader: Callable[[], FrameReader]
    open_sink: Callable[[], StreamSink]
    max_frames: int | None = None
    wants_background: Callable[[int], bool] | None = None
    source: str = "the source"
    line: int | None = None
    live: bool = False
    last_try: bool = False
    snapshot_rows: int = 32
    snapshot_seconds: float = 3.0
    path: Path | None = None
    ignored: Array | None = None
    motion: StoredMotion | None = None


@dataclass(frozen=True, slots=True)
class StreamProgress:
    """Progress of a stream after a burst of frames. All counts are totals since its start.

    Attributes
    ----------
    read : int
        Frames taken from the source, without gaps.
    committed : int
        Label maps committed by the sink.
    quarantined, dropped : int
        Frames without a label map. Once ``done``: read = committed + quarantined + dropped.
    gaps : int
        Times in which a camera sent nothing.
    layers : int
        Live layers, the background included.
    done : bool
        The source has ended, every result is committed and the sink is closed.
    problem : str, optional
        Why the stream is incomplete although it continued or ended: :attr:`FrameReader.problem`, or the death
        of the reader process after its first frame.
    stage_ms : mapping of str to float
        Mean wall time by stage over the last burst, ms.
    silence : SourceSilence, optional
        What ended the burst early.
    length : int, optional
        Final value of ``read``, as far as the source or :attr:`StreamSpec.max_frames` says.
    kept_waiting : bool
        Whether the burst ended early because the source had no frame ready.
    without_process : int
        Layers without a process of their own because the node's memory is too short.
    objects : int
        Objects in the newest label map: layers that own a pixel of it.
    cpu_seconds : float
        CPU time of the stream's own processes since this start, s.
    memory : int
        Their unique memory, bytes.
    """

    read: int
    committed: int
    quarantined: int
    dropped: int
    layers: int
    done: bool
    problem: str | None = None
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    gaps: int = 0
    silence: SourceSilence | None = None
    length: int | None = None
    kept_waiting: bool = False
    without_process: int = 0
    objects: int = 0
    cpu_seconds: float = 0.0
    memory: int = 0


class RunningStream(Protocol):
    """One stream's actors, as the driver sees them."""

    @property
    def node(self) -> str | None:
        """Where they are, in words; None on this machine."""

    def advance(self) -> Future[StreamProgress]:
        """Ask for one bounded burst of frames; do not call again before the future is done.

        The future carries an MlbsError with one sentence if the stream failed: the source could not be opened
        (SourceError), the record could not be written (SinkError), or a process was lost (ActorLostError);
        started again, it resumes from its record. Damage of the source after its first frame ends the stream
        instead: what was read is committed and the last progress is ``done`` with its ``problem``. So does,
        at the last try, the death of the reader; before the first frame that is a SourceError.
        """

    def reopen(self, open_reader: Callable[[], FrameReader]) -> None:
        """Have a live source read from another place soon; return at once.

        What comes from there follows a row ``gap``. A stream that is started again is to be given it, too.
        """

    def configure(self, settings: object) -> None:
        """Have the record follow other settings (:meth:`StreamSink.configure`) soon; return at once."""

    def stop(self, *, drain: bool, returns: bool = False) -> StreamProgress | None:
        """End the stream and release its processes; may be called twice, and after a failure.

        With ``drain`` no more frames are read, those read before are labelled and committed, the
        sink is closed and the final progress is returned. Without it the actors end at once, the
        sink keeps what is committed, and None is returned. Blocks until the stream's own actors
        are gone. Never raises for a stream that has already failed.

        With ``returns`` the reader of a live source, if it answers, lives on for the next start (see
        :meth:`StreamHost.start`), or until this object is dropped.
        """


class StreamHost(Protocol):
    """One node's pool of layer processes and its sink process, on which streams are started.

    ``mlbs_actors.actors.pipeline.Node`` implements it.
    """

    def start(self, spec: StreamSpec, before: RunningStream | None = None) -> RunningStream:
        """Create a stream's actors and return at once; errors are raised by ``advance``.

        Parameters
        ----------
        spec : StreamSpec
        before : RunningStream, optional
            An earlier start of this stream, or of one that had another name, stopped because it ``returns``.

        Raises
        ------
        NoPlaceError
            If no node can take it now.
        """

    def repair(self) -> None:
        """Replace the pool or the sink process if it is lost; their streams must be started again."""

    def close(self) -> None:
        """End the pool and the sink process. Streams must be stopped before. May be called twice."""
