"""Clips that are cut out of rings and videos."""

from __future__ import annotations

from pathlib import Path

import av
import pytest
from av.video.frame import VideoFrame
from coded_video import KEY_SECONDS, RATE, packets_of, record, write_video
from sounding_video import write_sounding_video

from orchestrator.clips.cutting import CutRequest, cut
from orchestrator.clips.packet_ring import PacketRing

BEGAN = 1_700_000_000.0
ENOUGH = 1e10


def request(folder: Path, begin: float, end: float, video: Path | None = None) -> CutRequest:
    paths = (str(folder / "clips/a.mp4"), str(folder / "clips/b.mp4"))
    return CutRequest(begin, end, paths, str(folder / "ring"), None if video is None else str(video))


def shown(path: Path) -> list[tuple[float, int]]:
    """The frames of a clip: time, and number of the frame of the made video."""
    with av.open(str(path)) as container:
        return [
            (float(frame.time or 0), round(float(frame.to_ndarray(format="rgb24").mean())) - 20)
            for frame in container.decode(video=0)
        ]


def codec(path: Path) -> str:
    with av.open(str(path)) as container:
        return str(container.streams.video[0].codec_context.name)


@pytest.mark.parametrize(
    ("coder", "expected"),
    [("libx264", "h264"), ("libx265", "hevc"), ("mjpeg", "h264"), ("libvpx", "h264")],
)
def test_a_clip_shows_what_lies_between_from_the_key_frame_before(
    tmp_path: Path, coder: str, expected: str
) -> None:
    record(write_video(tmp_path / "video.mkv", 20, coder), PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    assert cut(request(tmp_path, BEGAN + 7.1, BEGAN + 13.1))
    frames = shown(tmp_path / "clips/a.mp4")
    # Frames arrive a tenth of a second late, which counts as part of their way.
    first = 35 if coder == "mjpeg" else 3 * KEY_SECONDS * RATE
    assert [round(time * RATE) for time, _ in frames] == list(range(len(frames)))
    assert [number for _, number in frames] == pytest.approx(range(first, 65), abs=2)
    assert codec(tmp_path / "clips/a.mp4") == expected


def test_the_cameras_own_packets_are_in_it(tmp_path: Path) -> None:
    video = write_video(tmp_path / "video.mp4", 20)
    record(video, PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    assert cut(request(tmp_path, BEGAN + 7, BEGAN + 13))
    sent = [bytes(packet) for _, packet in packets_of(video)]
    kept = [bytes(packet) for _, packet in packets_of(tmp_path / "clips/a.mp4")]
    assert kept == sent[30:65]


def test_it_has_all_its_names_on_one_place_of_the_disk_and_nothing_else_is_left(tmp_path: Path) -> None:
    record(write_video(tmp_path / "video.mkv", 20), PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    assert cut(request(tmp_path, BEGAN + 7, BEGAN + 13))
    assert cut(request(tmp_path, BEGAN + 7, BEGAN + 13))  # again, after a kill
    assert sorted(path.name for path in (tmp_path / "clips").iterdir()) == ["a.mp4", "b.mp4"]
    assert (tmp_path / "clips/a.mp4").samefile(tmp_path / "clips/b.mp4")


def test_it_begins_and_ends_with_what_there_is(tmp_path: Path) -> None:
    record(write_video(tmp_path / "video.mkv", 10), PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    assert cut(request(tmp_path, BEGAN - 5, BEGAN + 3.1))
    assert [number for _, number in shown(tmp_path / "clips/a.mp4")] == pytest.approx(range(15), abs=2)
    assert cut(request(tmp_path, BEGAN + 9.1, BEGAN + 30))
    assert [number for _, number in shown(tmp_path / "clips/a.mp4")] == pytest.approx(range(40, 50), abs=2)


def test_without_packets_there_is_no_clip(tmp_path: Path) -> None:
    record(write_video(tmp_path / "video.mkv", 6), PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    assert not cut(request(tmp_path, BEGAN + 60, BEGAN + 70))
    assert not cut(request(tmp_path, BEGAN - 70, BEGAN - 60))
    assert not list((tmp_path / "clips").iterdir())


def test_while_the_camera_is_away_it_stands_still(tmp_path: Path) -> None:
    video, ring = write_video(tmp_path / "video.mkv", 6), PacketRing(tmp_path / "ring", ENOUGH)
    record(video, ring, BEGAN)
    record(video, ring, BEGAN + 16)
    assert cut(request(tmp_path, BEGAN + 4.1, BEGAN + 18.1))
    times = [time for time, _ in shown(tmp_path / "clips/a.mp4")]
    assert times == pytest.approx(
        [*(k / RATE for k in range(10)), *(12 + k / RATE for k in range(10))], abs=0.01
    )
    assert codec(tmp_path / "clips/a.mp4") == "h264"


def test_a_camera_that_comes_back_with_another_size_is_encoded_anew(tmp_path: Path) -> None:
    ring = PacketRing(tmp_path / "ring", ENOUGH)
    record(write_video(tmp_path / "video.mkv", 6), ring, BEGAN)
    record(write_video(tmp_path / "larger.mkv", 6, size=(96, 64)), ring, BEGAN + 6)
    assert cut(request(tmp_path, BEGAN + 4.1, BEGAN + 8.1))
    numbers = [number for _, number in shown(tmp_path / "clips/a.mp4")]
    assert numbers == pytest.approx([*range(20, 30), *range(10)], abs=2)


def test_a_file_that_was_cut_off_or_is_no_video_takes_nothing_else_with_it(tmp_path: Path) -> None:
    record(write_video(tmp_path / "video.mkv", 20), PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    files = sorted((tmp_path / "ring").iterdir())
    files[1].write_bytes(b"no video")
    files[2].write_bytes(files[2].read_bytes()[:-300])
    assert cut(request(tmp_path, BEGAN + 1, BEGAN + 15))
    numbers = [number for _, number in shown(tmp_path / "clips/a.mp4")]
    assert numbers[:20] == pytest.approx(range(20), abs=2)
    assert numbers[-1] == pytest.approx(75, abs=2)


@pytest.mark.parametrize("ending", ["mp4", "mkv", "avi"])
def test_a_clip_of_a_video_is_cut_out_of_it(tmp_path: Path, ending: str) -> None:
    video = write_video(tmp_path / f"video.{ending}", 20)
    assert cut(request(tmp_path, 7, 13, video))
    numbers = [number for _, number in shown(tmp_path / "clips/a.mp4")]
    assert numbers == pytest.approx(range(30, 65), abs=2)


@pytest.mark.parametrize("coder", ["aac", "libopus", "ac3"])
def test_the_sound_is_in_the_clip_beside_its_frames(tmp_path: Path, coder: str) -> None:
    write_sounding_video(tmp_path / "video.mkv", coder, frames=300)
    record(tmp_path / "video.mkv", PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    assert cut(request(tmp_path, BEGAN + 3.1, BEGAN + 8.1))
    with av.open(str(tmp_path / "clips/a.mp4")) as container:
        assert [stream.type for stream in container.streams] == ["video", "audio"]
        frames: dict[str, list[float]] = {"video": [], "audio": []}
        for frame in container.decode():
            frames["video" if isinstance(frame, VideoFrame) else "audio"].append(float(frame.time or 0))
    begin_and_end = pytest.approx((frames["video"][0], frames["video"][-1]), abs=0.5)
    assert (frames["audio"][0], frames["audio"][-1]) == begin_and_end
