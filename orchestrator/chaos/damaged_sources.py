"""Sources that are missing, damaged or odd, and lists that mean ill."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.video.stream import VideoStream
from PIL import Image

from mlbs_actors.messages import Array
from orchestrator.chaos.observed_run import ObservedRun, content, expect
from orchestrator.chaos.place import BESIDE, LINES, Fault, Place, expect_end, expect_identical
from orchestrator.sources.address import parse_address
from orchestrator.sources.synthetic import scene
from orchestrator.sources.video import VideoReader

__all__ = ["FAULTS", "write_video"]

_RATE = 25
_NO_PNG = b"\x89PNG damaged"


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
        Of the pictures, in frames; only of a codec of key frames alone may they be in disorder.
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
                packet.pts = time  # the order of the file is that of decoding, whatever the times say
            container.mux(packet)


def _missing_sources(place: Place) -> None:
    place.folder.mkdir()
    (place.folder / "text.mp4").write_text("no video")
    (place.folder / "empty").mkdir()
    bad = ["missing none.mp4", "text text.mp4", "empty empty/"]
    with ObservedRun([*bad, *LINES], place.folder) as run:
        expect_end(run, 1)
        states = {name: stream["state"] for name, stream in run.status().items()}
        expect(
            states
            == dict.fromkeys(("missing", "text", "empty"), "failed") | dict.fromkeys(place.expected, "done"),
            f"the states are {states}",
        )
        expect_identical(place, run)


def _odd_video(name: str, make: Callable[[Path, Place], None]) -> Callable[[Place], None]:
    """A video that is not as it should be: labelled like the pictures that can be decoded of it."""

    def bring_about(place: Place) -> None:
        path = place.folder / name
        make(path, place)
        whole = _decode(path, place.folder / "same")
        with ObservedRun([f"odd {name}", "same same/", BESIDE], place.folder) as run:
            odd_state, same_state = ("done" if one else "partial" for one in whole)
            expect_end(run, 0 if all(whole) else 1)
            status = run.status()
            expect(
                (status["odd"]["state"], status["same"]["state"]) == (odd_state, same_state),
                f"the states are {status['odd']}, {status['same']}",
            )
            odd, same = content(run.output / "odd"), content(run.output / "same")
            expect(
                _without(odd, "stream", "pts") == _without(same, "stream", "pts"), "it is labelled otherwise"
            )
            expect_identical(place, run, "beside")

    return bring_about


def _decode(video: Path, folder: Path) -> tuple[bool, bool]:
    """Write what can be decoded of a video as pictures; tell whether it is undamaged, and so are they."""
    folder.mkdir()
    reader = VideoReader(parse_address(str(video), Path("/")))
    whole = True
    while (frame := reader.read()) is not None:
        path = folder / f"{frame.name}.png"
        if frame.image is None:
            path.write_bytes(_NO_PNG)
            whole = False
        else:
            cv2.imwrite(str(path), frame.image)
    reader.close()
    return reader.problem is None and whole, whole


def _without(record: dict[str, Any], *columns: str) -> dict[str, Any]:
    rows = {
        table: [{key: row[key] for key in row if key not in columns} for row in record[table]]
        for table in ("layers", "frames")
    }
    return record | rows


def _pictures(frames: int) -> list[Array]:
    made = scene("demo", frames=frames, width=160, height=120)
    return [made.frame(t) for t in range(frames)]


def _cut_off(path: Path, place: Place) -> None:
    write_video(path, _pictures(40))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * place.random.uniform(0.3, 0.9))])


def _flipped_bits(path: Path, place: Place) -> None:
    write_video(path, _pictures(40))
    data = bytearray(path.read_bytes())
    start, end = len(data) // 4, data.rfind(b"moov")  # of the pictures, not of the table that finds them
    for place_ in place.random.integers(start, end, 12):
        data[place_] ^= 1 << int(place.random.integers(8))
    path.write_bytes(data)


def _disordered_times(path: Path, place: Place) -> None:
    times = np.arange(30)
    times[8] = times[9] = 20  # ahead, then the same, then back
    times[15:] += int(place.random.integers(1_000, 100_000))
    times[22] += 7
    write_video(path, _pictures(30), "mjpeg", (int(time) for time in times))


def _changing_size(place: Place) -> None:
    sizes = [(160, 120), (120, 160)] if place.random.integers(2) else [(160, 120), (96, 72)]
    half = 20
    for number, (width, height) in enumerate(sizes):
        made = scene("demo", frames=half, width=width, height=height, seed=number)
        for folder in ("both", f"only{number}"):
            (place.folder / folder).mkdir(parents=True, exist_ok=True)
            for t in range(half):
                cv2.imwrite(str(place.folder / folder / f"{number}-{t:02d}.png"), made.frame(t))
    with ObservedRun(["both both/", "only0 only0/", "only1 only1/"], place.folder) as run:
        expect_end(run, 0)
        both = content(run.output / "both")["masks"]
        first, second = (content(run.output / f"only{number}")["masks"] for number in (0, 1))
        expect({name: both[name] for name in first} == first, "the frames before the change are otherwise")
        largest = max(_labels(mask).max() for mask in first.values())
        for name, alone in second.items():
            labels, there = _labels(both[name]), _labels(alone) > 0
            expect(np.array_equal(labels > 0, there), f"{name} is labelled otherwise")
            expect(bool((labels[there] > largest).all()), "an id from before the change is used again")


def _labels(mask: bytes) -> Array:
    return np.asarray(Image.open(BytesIO(mask)))


def _odd_pictures(place: Place) -> None:
    """An undecodable picture; black, white, constant, smooth ones; a cut; grey, 16 bits, alpha, odd sizes."""
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
        (place.folder / name).mkdir(parents=True)
        for index, picture in enumerate(pictures):
            cv2.imwrite(str(place.folder / name / f"{index}.png"), picture)
    (place.folder / "damaged" / f"{place.random.integers(8)}.png").write_bytes(_NO_PNG)
    with ObservedRun([f"{name} {name}/" for name in kinds], place.folder) as run:
        expect_end(run, 1)
        for name in kinds:
            expected = ("partial", 7) if name == "damaged" else ("done", 8)
            state = run.status()[name]
            expect((state["state"], state["committed"]) == expected, f"{name}: {state}")
            content(run.output / name)


def _hostile_list(place: Place) -> None:
    lines = ["../up a.mp4", "concat:a|b", "x http://user:hunter2@host/y"]
    lines += ["twin a.mp4", "twin b.mp4", "nul\0 a.mp4"]
    with ObservedRun(lines, place.folder) as run:
        words = expect_end(run, 2)
        expect(not run.output.exists(), "there is output")
        expect("hunter2" not in words, "a password is told")
        for number in (1, 2, 3, 5, 6):
            expect(f"line {number}:" in words, f"line {number} is not refused: {words}")
    with ObservedRun(["a.mp4"] * 1_000_000, place.folder) as run:
        words = expect_end(run, 2)
        expect(len(words) < 10_000 and not run.output.exists(), "a million lines are not refused in short")


FAULTS = (
    Fault("1", "sources that are missing, empty, no video", _missing_sources),
    Fault("2", "a video cut off in the middle of a frame", _odd_video("odd.mkv", _cut_off)),
    Fault("6 8 10", "odd and undecodable pictures", _odd_pictures),
    Fault("7", "an H.264 video with flipped bits", _odd_video("odd.mp4", _flipped_bits)),
    Fault("9", "another size in the middle", _changing_size),
    Fault("11", "times that go back, stand still, jump", _odd_video("odd.mkv", _disordered_times)),
    Fault("28", "hostile list", _hostile_list),
)
