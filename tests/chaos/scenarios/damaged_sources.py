"""Sources that are missing, damaged or odd, and hostile lists."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from itertools import count
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.video.stream import VideoStream

from chaos.harness.observed_run import ObservedRun, content, expect
from chaos.harness.scenario import (
    BYSTANDER,
    Fault,
    Scenario,
    ScenarioContext,
    Verdicts,
    expect_end,
    expect_identical,
    single_fault,
)
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import SourceFrame
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader

__all__ = ["SCENARIOS", "write_video"]

_RATE = 25
_NO_PNG = b"\x89PNG damaged"

#: Frames before a change of size, and after it.
_OF_A_SIZE = 20


def write_video(
    path: Path, pictures: Sequence[Array], codec: str = "libx264", times: Iterable[int] | None = None
) -> None:
    """Write a video; the container is that of the name.

    Parameters
    ----------
    path : Path
    pictures : sequence of (H, W, 3) uint8
    codec : str
    times : iterable of int, optional
        Of the pictures, in frames; only with a codec of key frames alone may they be out of order.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, _RATE)
        assert isinstance(stream, VideoStream)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.thread_count = 1
        frames = [av.VideoFrame.from_ndarray(picture, format="bgr24") for picture in pictures]
        for index, frame in enumerate(frames):
            frame.pts, frame.time_base = index, Fraction(1, _RATE)
        packets = [packet for frame in [*frames, None] for packet in stream.encode(frame)]
        for packet, time in zip(packets, count() if times is None else times, strict=False):
            if times is not None:
                packet.pts = time  # the order of the file is that of decoding, whatever the times are
            container.mux(packet)


def _pictures(frames: int) -> list[Array]:
    made = scene("demo", frames=frames, width=160, height=120)
    return [made.frame(t) for t in range(frames)]


def _cut_off(path: Path, context: ScenarioContext) -> None:
    write_video(path, _pictures(40))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * context.random.uniform(0.3, 0.9))])


def _flipped_bits(path: Path, context: ScenarioContext) -> None:
    write_video(path, _pictures(40))
    data = bytearray(path.read_bytes())
    start, end = len(data) // 4, data.rfind(b"moov")  # of the pictures, not of the table that finds them
    for position in context.random.integers(start, end, 12):
        data[position] ^= 1 << int(context.random.integers(8))
    path.write_bytes(data)


def _disordered_times(path: Path, context: ScenarioContext) -> None:
    times = np.arange(30)
    times[8] = times[9] = 20  # ahead, then the same, then back
    times[15:] += int(context.random.integers(1_000, 100_000))
    times[22] += 7
    write_video(path, _pictures(30), "mjpeg", (int(time) for time in times))


def _changing_size(folder: Path, context: ScenarioContext) -> None:
    sizes = [(160, 120), (120, 160)] if context.random.integers(2) else [(160, 120), (128, 96)]
    folder.mkdir()
    for number, (width, height) in enumerate(sizes):
        made = scene("demo", frames=_OF_A_SIZE, width=width, height=height, seed=number)
        for t in range(_OF_A_SIZE):
            cv2.imwrite(str(folder / f"{number}-{t:02d}.png"), made.frame(t))


def _odd_pictures(context: ScenarioContext) -> list[str]:
    """Write pictures: undecodable, black, white, constant, smooth, grey, 16 bits, alpha, odd sizes; a cut."""
    made = scene("demo", frames=8, width=97, height=73)
    colours = [made.frame(t) for t in range(8)]
    other = scene("pan", frames=4, width=97, height=73)
    grey = [cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in colours]
    kinds: dict[str, list[Array]] = {
        "grey": grey,
        "deep": [one.astype(np.uint16) * 257 for one in grey],
        "alpha": [cv2.cvtColor(one, cv2.COLOR_BGR2BGRA) for one in colours],
        "row": [one[:1] for one in colours],
        "black": [np.zeros_like(one) for one in colours],
        "white": [np.full_like(one, 255) for one in colours],
        "smooth": [cv2.GaussianBlur(one, (0, 0), 25) for one in colours],
        "cut": [*colours[:4], *(other.frame(t) for t in range(4))],
        "frozen": [colours[0]] * 8,
        "damaged": colours,
    }
    for name, pictures in kinds.items():
        (context.folder / name).mkdir(parents=True)
        for index, picture in enumerate(pictures):
            cv2.imwrite(str(context.folder / name / f"{index}.png"), picture)
    (context.folder / "damaged" / f"{context.random.integers(8)}.png").write_bytes(_NO_PNG)
    return list(kinds)


_MISSING = Fault("1", "sources that are missing, empty, no video")
_CUT_OFF = Fault("2", "a video cut off in the middle of a frame")
_PICTURES = Fault("6 8 10", "odd and undecodable pictures")
_FLIPPED = Fault("7", "an H.264 video with flipped bits")
_SIZES = Fault("9", "another size in the middle")
_TIMES = Fault("11", "times that go back, stand still, jump")


#: Odd sources of which each is one stream: the fault, the file or folder, and what makes it.
_ODD: tuple[tuple[Fault, str, Callable[[Path, ScenarioContext], None]], ...] = (
    (_CUT_OFF, "cut.mkv", _cut_off),
    (_FLIPPED, "flipped.mp4", _flipped_bits),
    (_TIMES, "times.mkv", _disordered_times),
    (_SIZES, "sizes", _changing_size),
)


def _odd_sources(context: ScenarioContext, verdicts: Verdicts) -> None:
    """Run all at once: each is labelled like what can be decoded of it, and the bystander as ever."""
    folder = context.folder
    folder.mkdir()
    lines = [BYSTANDER, "missing none.mp4", "text text.mp4", "empty empty/"]
    (folder / "text.mp4").write_text("no video")
    (folder / "empty").mkdir()
    odd = [(fault, path, make) for fault, path, make in _ODD if fault.name in verdicts]
    for _, path, make in odd:
        make(folder / path, context)
        lines.append(f"{path} {path}")
    kinds = _odd_pictures(context) if _PICTURES.name in verdicts else []
    lines += [f"{kind} {kind}" for kind in kinds]
    with ObservedRun(lines, folder) as run:
        stderr = expect_end(run, 1)
        status = run.status()
        with verdicts.check(_MISSING.name):
            failed = {name for name, stream in status.items() if stream["state"] == "failed"}
            expect(failed == {"missing", "text", "empty"}, f"failed: {failed}")
            expect(all(name in stderr for name in failed), f"they are not reported: {stderr}")
            expect_identical(context, run, BYSTANDER)
        for fault, path, _ in odd:
            with verdicts.check(fault.name):
                _expect_as_decoded(context, run, path)
                if fault == _CUT_OFF:
                    expect(status[path]["state"] == "partial", f"it is reported as {status[path]}")
                if fault == _SIZES:
                    _expect_new_ids(content(run.output / path))
        for kind in kinds:
            with verdicts.check(_PICTURES.name):
                _expect_as_decoded(context, run, kind)
                whole = ("partial", 7) if kind == "damaged" else ("done", 8)
                stream = status[kind]
                expect((stream["state"], stream["committed"]) == whole, f"{kind}: {stream}")


def _expect_as_decoded(context: ScenarioContext, run: ObservedRun, path: str) -> None:
    """Expect what another process has decoded to be labelled as in this one, and its state to be true."""
    expect_identical(context, run, f"{path} {path}")
    reader = open_reader(parse_address(path, context.folder))
    whole = True
    while isinstance(frame := reader.read(), SourceFrame):
        whole = whole and frame.status == "ok"
    state = run.status()[path]["state"]
    expect(
        state == ("done" if whole and reader.problem is None else "partial"), f"{path} is reported as {state}"
    )


def _expect_new_ids(record: dict[str, Any]) -> None:
    """Expect that no id from before the change of size is used after it."""
    ids = [
        {row["layer"] for row in record["layers"] if later == (row["frame"] >= _OF_A_SIZE)}
        for later in (0, 1)
    ]
    expect(bool(ids[0]) and bool(ids[1]), "no object was found")
    expect(max(ids[0]) < min(ids[1]), "an id from before the change is used again")


def _hostile_list(context: ScenarioContext) -> None:
    lines = ["../up a.mp4", "concat:a|b", "x ftp://user:hunter2@host/y"]
    lines += ["twin a.mp4", "twin b.mp4", "nul\0 a.mp4"]
    with ObservedRun(lines, context.folder) as run:
        stderr = expect_end(run, 2)
        expect(not run.output.exists(), "there is output")
        expect("hunter2" not in stderr, "a password is printed")
        for number in (1, 2, 3, 5, 6):
            expect(f"line {number}:" in stderr, f"line {number} is not refused: {stderr}")
    with ObservedRun(["a.mp4"] * 1_000_000, context.folder) as run:
        stderr = expect_end(run, 2)
        expect(len(stderr) < 10_000 and not run.output.exists(), "a million lines are not refused in short")


SCENARIOS = (
    Scenario(
        "odd and damaged sources",
        (_MISSING, _CUT_OFF, _PICTURES, _FLIPPED, _SIZES, _TIMES),
        _odd_sources,
    ),
    single_fault("28", "hostile list", _hostile_list),
)
