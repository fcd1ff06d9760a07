"""The coordinator actor, which conducts the other processes of its stream.

It fetches the frames, computes the evidence for each layer, and has the segmenter label them with the layers,
so that no picture passes through it twice and none through the driver. It runs ahead of the layers by at most
two frames: it tracks and clusters frame t+1 while they work on t−1 and t, and then waits for the label map of
t−1, which decides which layers live.
"""

from __future__ import annotations

import logging
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from ray.exceptions import GetTimeoutError, RayError

from mlbs_actors.actors.ipc.channels import ChannelClosedError
from mlbs_actors.actors.ipc.shared_memory import Shared, SharedMemory, SlotPool
from mlbs_actors.actors.ipc.wakeup import WakeupHandle, wait_until_woken
from mlbs_actors.actors.node.failures import explain, first_failure, is_loss, reader_lost, source_failure
from mlbs_actors.actors.node.host import Reference
from mlbs_actors.actors.node.idle_threads import relax_thread_timers
from mlbs_actors.actors.node.processes import get
from mlbs_actors.actors.node.usage import StreamUsage
from mlbs_actors.actors.parts import PartFactory
from mlbs_actors.actors.stream.account import StreamAccount
from mlbs_actors.actors.stream.links import StreamLinks
from mlbs_actors.actors.stream.live_layers import LiveLayers
from mlbs_actors.actors.stream.live_reader import LiveReadAhead
from mlbs_actors.actors.stream.protocol import StreamProgress, StreamSpec
from mlbs_actors.actors.stream.reader import ReadAhead
from mlbs_actors.actors.stream.segmenter_actor import Labelling
from mlbs_actors.actors.stream.sink import Record
from mlbs_actors.actors.stream.snapshots import StreamSnapshots
from mlbs_actors.determinism import limit_process
from mlbs_actors.errors import ActorLostError, MlbsError, SourceError
from mlbs_actors.messages import Array, FrameEvidence, Segmentation
from mlbs_actors.source import FrameReader, SourceFrame, SourceSilence

__all__ = ["CoordinatorActor"]

_log = logging.getLogger(__name__)

#: A burst takes no more frames after this time, s: the driver checks for streams that have ended, or hang.
_BURST_SECONDS = 1.5

#: A burst ends where its source takes longer for a frame, s: another stream may have one ready.
_SOURCE_SECONDS = 0.01

#: Most frames between two queries of what the sink has kept.
_COLLECT_FRAMES = 8

#: Frames that are skipped in one burst on the way back to a snapshot.
_SKIPPED_FRAMES = 64

#: Timeout for a snapshot without which frames would be lost, s.
_SNAPSHOT_SECONDS = 30.0


class CoordinatorActor:
    """Runs one stream, a bounded burst of frames a call.

    Parameters
    ----------
    spec : StreamSpec
    parts : PartFactory
    links : StreamLinks
    run : int
        The stream's number in the pool.
    """

    def __init__(self, spec: StreamSpec, parts: PartFactory, links: StreamLinks, run: int) -> None:
        limit_process()
        relax_thread_timers()
        self._spec = spec
        self._links = links
        if spec.motion is not None:
            spec.motion.followed = ()  # until a snapshot says otherwise
        self._coordinator = parts.coordinator(spec.config, spec.ignored, spec.motion)
        self._slots, self._memory = SlotPool(), SharedMemory()
        self._source = (
            ReadAhead(links.reader, spec.max_frames, self._slots, self._memory)
            if not spec.live
            else LiveReadAhead(links.reader, spec.max_frames, self._slots, self._memory)
        )
        self._layers = LiveLayers(links.pool, run, spec.config, spec.name)
        self._labelling = Labelling(links.segmenter, self._slots, self._memory, spec.name)
        self._record = Record(links.sink, run, spec, self._slots)
        # Not yet labelled, in source order; a picture with its reference.
        self._waiting: deque[tuple[Shared[SourceFrame] | None, SourceFrame]] = deque()
        # The newest results, by the engine's frame index.
        self._segmentations: dict[int, Shared[Segmentation]] = {}
        self._account = StreamAccount(spec.max_frames)
        self._snapshots = StreamSnapshots(
            spec, self._coordinator, self._layers, self._labelling, self._account, self._record
        )
        self._usage = StreamUsage()
        self._ended: StreamProgress | MlbsError | None = None
        self._begun = self._interrupted = False
        self._to_skip = 0

    def advance(self, frames: int) -> StreamProgress:
        """Take up to ``frames`` more frames of the source, fewer if they or their source are slow.

        The label maps may follow a few frames later.

        Raises
        ------
        MlbsError
            If the stream failed, now or in an earlier call. What was labelled before is committed.
        """
        return self._guarded(frames)

    def reopen(self, open_reader: Callable[[], FrameReader]) -> None:
        """Read a live source from another place from now on."""
        assert isinstance(self._source, LiveReadAhead)
        if not self._begun:
            self._begin()
        if self._ended is None:
            self._source.reopen(open_reader)

    def wait_inside_a_call(self, handle: WakeupHandle) -> None:
        """Wait until woken: inside a call the process takes no CPU time between its bursts."""
        wait_until_woken(handle)

    def finish(self) -> StreamProgress:
        """Read no more, label and commit what was read, close the record; raises as :meth:`advance`."""
        self._interrupted = True
        self._to_skip = 0
        self._source.finish()
        while not (progress := self._guarded(1)).done:
            continue
        return progress

    def _guarded(self, frames: int) -> StreamProgress:
        if self._ended is None:
            try:
                progress = self._burst(frames)
            except Exception as error:
                # Any error ends this stream alone, with one sentence; unexpected ones are logged with their
                # traceback.
                if not isinstance(error, MlbsError | RayError | ChannelClosedError):
                    _log.exception("Stream %r failed unexpectedly.", self._spec.name)
                closed = isinstance(error, ChannelClosedError)
                cause = first_failure(self._served(), self._spec.name) if closed else error
                roles = self._links.roles() | dict(self._layers.roles())
                self._ended = explain(cause, self._spec.name, roles)
                self._close_after_failure()
            else:
                if not progress.done:
                    return progress
                self._ended = progress
        if isinstance(self._ended, MlbsError):
            raise self._ended
        return self._ended

    def _burst(self, frames: int) -> StreamProgress:
        if not self._begun:
            self._begin()
        if self._to_skip:
            self._skip()
            return self._progress(done=False)
        kept_waiting = False
        deadline = time.monotonic() + _BURST_SECONDS
        for taken in range(frames):
            if time.monotonic() > deadline:
                break
            # Not while a stream begins: its first burst may take long.
            if taken and self._segmentations and not self._source.keeps_up(_SOURCE_SECONDS):
                kept_waiting = True
                break
            if taken and taken % _COLLECT_FRAMES == 0:
                self._collect()
            if self._spec.live:
                self._hand_over_while_idle()
            delivered = self._next_frame()
            if delivered is None:
                return self._finish()
            shared, frame = delivered
            self._write_labelled()
            self._account.take(frame)
            if isinstance(frame, SourceSilence):
                if frame.state is not None and not self._waiting and not self._labelling.under_way:
                    self._record.silent()
                break
            self._waiting.append((shared, frame))
            if frame.image is None:
                self._write_gaps()
            else:
                self._track(frame, frame.image)
            if self._snapshots.are_due():
                self._save()
        self._record.send()
        self._collect()
        return self._progress(done=False, kept_waiting=kept_waiting)

    def _collect(self) -> None:
        """Query what the sink has kept by now; the source can forget that."""
        self._record.collect()
        self._source.forget(self._record.kept)

    def _begin(self) -> None:
        """Start, from the snapshot that the record names, if any."""
        opening = self._record.opening()
        if opening.resume_from is not None:
            self._restore(opening.resume_from.folder)
        self._labelling.begin()
        if self._snapshots.is_of_other_parameters:
            for evidence in self._coordinator.begin_anew():
                self._label(evidence)
        self._begin_reading()
        self._snapshots.begin(opening.snapshots)
        self._begun = True

    def _restore(self, folder: Path) -> None:
        """Go back to a snapshot, with the frames that were under way."""
        waiting, published = self._snapshots.restore(folder)
        self._segmentations |= published
        for frame in waiting:
            shared = None if frame.image is None else self._memory.share(frame, self._slots.acquire("frame"))
            self._waiting.append((shared, frame))

    def _begin_reading(self) -> None:
        pictures = self._account.counts["ok"]
        with self._reading():
            if isinstance(self._source, LiveReadAhead):
                self._source.go_on(self._account.position, pictures)
            else:
                self._source.begin(pictures)
                self._to_skip = 0 if self._interrupted else self._account.read

    def _skip(self) -> None:
        """Skip some of the frames before the snapshot: in bursts, so that the driver sees progress."""
        frames = min(self._to_skip, _SKIPPED_FRAMES)
        with self._reading():
            self._source.skip(frames)
        self._to_skip -= frames

    def _save(self) -> None:
        self._snapshots.save(tuple(frame for _, frame in self._waiting))

    def _save_where_it_stands(self) -> None:
        """Save the present state: frames of a live source cannot be read again."""
        if self._snapshots.are_wanted and self._spec.live:
            if not self._snapshots.are_current():
                self._save()
            self._await_labelled()
            self._record.await_snapshot(_SNAPSHOT_SECONDS)

    def _next_frame(self) -> tuple[Shared[SourceFrame] | None, SourceFrame | SourceSilence] | None:
        try:
            with self._reading():
                return self._source.next()
        except ActorLostError:
            self._save_where_it_stands()
            raise
        except SourceError as failure:
            if self._account.read == 0:
                raise
            self._account.problem = str(failure)
            self._source.stop()
            return None

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Translate what the reader raises: ActorLostError if it may succeed again, else SourceError."""
        try:
            yield
        except RayError as error:
            # Repeated aborts mean that a file is damaged; a live source cannot be read again.
            damaged = not self._spec.live and self._spec.last_try
            if not damaged and (is_loss(error) or isinstance(error, GetTimeoutError)):
                raise reader_lost(self._spec.name, self._account.read) from None
            raise source_failure(error, self._spec.source, self._account.read) from None

    def _track(self, frame: SourceFrame, image: Array) -> None:
        """Process the next picture, and start the work that it makes possible."""
        if self._spec.motion is not None:
            self._spec.motion.follow(frame.index, frame.name, image)
        index = self._account.counts["ok"] - 1  # the engine counts the frames it is given
        wanted = self._coordinator.feedback_index(index)
        feedback = None if wanted is None else cache(partial(self._labelled, wanted))
        ready = self._coordinator.step(index, image, feedback, frame.concealed)
        if feedback is not None:
            feedback()  # a frame that does not need it keeps the layers' pace, too
        for evidence in ready:
            self._label(evidence)

    def _labelled(self, frame_index: int) -> Segmentation:
        """Wait for a label map, which limits the coordinator to the pace of the layers."""
        while frame_index not in self._segmentations:
            self._write_next_labelled()
        # Older ones will not be needed any more.
        self._segmentations = {t: one for t, one in self._segmentations.items() if t >= frame_index}
        segmentation = self._memory.load(self._segmentations[frame_index])
        self._account.label(segmentation)
        return segmentation

    def _label(self, evidence: FrameEvidence) -> None:
        """Start labelling one frame whose evidence is complete."""
        frame, delivered = self._waiting.popleft()
        assert frame is not None  # a frame without picture is a gap
        if evidence.retired:
            self._labelling.retire(evidence.retired)
        wants = self._spec.wants_background
        background = bool(evidence.tracks) and wants is not None and wants(delivered.index)
        self._labelling.start(evidence, frame, self._layers.follow(evidence), background=background)
        self._record.expect(frame)
        self._write_gaps()

    def _write_labelled(self) -> None:
        """Send finished label maps to the sink, without waiting."""
        while self._labelling.has_answer():
            self._write_next_labelled()

    def _hand_over_while_idle(self) -> None:
        """Send label maps to the sink as they are finished while a camera has no picture ready.

        Else each would wait for the camera's next pictures.
        """
        while not (ready := self._source.is_ready(_SOURCE_SECONDS)) and self._labelling.under_way:
            self._write_labelled()
        if not ready:
            self._record.send_if_due()

    def _await_labelled(self) -> None:
        """Wait for all label maps under way, and send them to the sink."""
        while self._labelling.under_way:
            self._write_next_labelled()

    def _write_next_labelled(self) -> None:
        labelled = self._labelling.next()
        self._segmentations[labelled.frame_index] = labelled.segmentation
        self._record.write(labelled.segmentation, labelled.background)

    def _write_gaps(self) -> None:
        """Send the rows without a label map that follow the label maps sent so far."""
        while self._waiting and (status := self._waiting[0][1].status) != "ok":
            _, frame = self._waiting.popleft()
            self._record.gap(frame.index, frame.pts, status)

    def _finish(self) -> StreamProgress:
        self._account.silence = None  # no fault in a stream that ends
        if self._interrupted:
            self._save_where_it_stands()
            self._record.provisional()
        for evidence in self._coordinator.flush():
            self._label(evidence)
        self._await_labelled()
        self._labelling.close()
        # All snapshots must be written before the record is closed, which removes them.
        for served in self._served():
            get(served)
        self._snapshots.finish()
        self._layers.release_all()
        self._record.close(whole=not self._interrupted)
        if self._account.problem is None:
            try:
                self._account.problem = self._source.problem()
            except RayError as error:
                self._account.problem = str(source_failure(error, self._spec.source, self._account.read))
        return self._progress(done=True)

    def _close_after_failure(self) -> None:
        """Commit the label maps that are done or still under way."""
        self._source.stop()
        with suppress(ChannelClosedError, RayError):
            self._await_labelled()
        self._labelling.close()
        self._record.close_after_failure()

    def _served(self) -> list[Reference]:
        return [*self._layers.served(), self._labelling.served]

    def _progress(self, *, done: bool, kept_waiting: bool = False) -> StreamProgress:
        progress = self._account.progress(
            self._record.committed, len(self._layers), done=done, kept_waiting=kept_waiting
        )
        processes = (os.getpid(), self._source.process, self._labelling.process, *self._layers.processes())
        self._usage.measure(process for process in processes if process is not None)
        return replace(
            progress,
            without_process=self._layers.without_process,
            cpu_seconds=self._usage.cpu_seconds,
            memory=self._usage.memory,
        )
