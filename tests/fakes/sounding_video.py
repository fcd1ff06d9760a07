"""Video files with sound, made for the tests."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.audio.frame import AudioFrame
from av.audio.stream import AudioStream
from av.video.frame import VideoFrame

from mlbs_actors.messages import Array

RATE = 48_000  # samples a second
FRAME_RATE = Fraction(30_000, 1001)


def write_sounding_video(
    path: Path, codec: str, *, frames: int = 60, begin: float = 0.0, size: tuple[int, int] = (96, 64)
) -> None:
    """Frames that grow brighter, the first at ``begin`` s, and a tone that rises over the whole time."""
    length = begin + frames / float(FRAME_RATE)
    time = np.arange(round(length * RATE)) / RATE
    tone = (0.5 * np.sin(2 * np.pi * (300 + 200 * time) * time)).astype(np.float32)
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", rate=FRAME_RATE)
        video.width, video.height = size
        video.pix_fmt = "yuv420p"
        audio = cast(AudioStream, container.add_stream(codec, rate=RATE, layout="mono", bit_rate=96_000))
        for index in range(frames):
            shown = np.full((size[1], size[0], 3), 4 * index % 256, np.uint8)
            picture = VideoFrame.from_ndarray(shown, format="bgr24")
            picture.pts, picture.time_base = index + round(begin * FRAME_RATE), 1 / FRAME_RATE
            container.mux(video.encode(picture))
        for start in range(0, len(tone), 960):
            sound = AudioFrame.from_ndarray(tone[None, start : start + 960], format="fltp", layout="mono")
            sound.sample_rate, sound.pts, sound.time_base = RATE, start, Fraction(1, RATE)
            container.mux(audio.encode(sound))
        container.mux(video.encode(None))
        container.mux(audio.encode(None))


def heard(path: Path) -> tuple[float, Array]:
    """The time at which a file's sound begins, s, and its samples."""
    with av.open(str(path)) as container:
        frames = list(container.decode(audio=0))
    assert frames[0].time is not None
    return frames[0].time, np.concatenate([frame.to_ndarray() for frame in frames], axis=-1)[0]
