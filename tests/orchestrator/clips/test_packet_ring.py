"""The ring of a camera's packets on disk."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from coded_video import KEY_SECONDS, RATE, packets_of, record, write_video

from orchestrator.clips.packet_ring import JpegRecorder, PacketRecorder, PacketRing, ring_files

BEGAN = 1_700_000_000.0
ENOUGH = 1e10  # seconds: nothing is deleted


def packets_in(path: Path) -> list[tuple[bytes, bool, float]]:
    return [
        (bytes(packet), bool(packet.is_keyframe), float((packet.pts or 0) * packet.time_base))
        for _, packet in packets_of(path)
    ]


@pytest.mark.parametrize("codec", ["libx264", "libx265", "mjpeg", "libvpx"])
def test_the_packets_are_kept_as_they_came_in_files_that_begin_with_a_key_frame(
    tmp_path: Path, codec: str
) -> None:
    video = write_video(tmp_path / "video.mkv", 22, codec)
    record(video, PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    files = ring_files(tmp_path / "ring")
    assert len(files) == 6  # of four seconds
    kept = [(file, packets_in(file.path)) for file in files]
    assert all(packets[0][1] for _, packets in kept)
    taken = [file.begin + seconds for file, packets in kept for _, _, seconds in packets]
    assert [content for _, packets in kept for content, _, _ in packets] == [
        content for content, _, _ in packets_in(video)
    ]
    assert taken == pytest.approx([BEGAN + 0.1 + frame / RATE for frame in range(22 * RATE)], abs=0.01)


def test_what_a_killed_process_has_recorded_can_be_read_but_for_its_last_seconds(tmp_path: Path) -> None:
    video = write_video(tmp_path / "video.mkv", 11)
    program = (
        "import os, pathlib, signal, sys\n"
        "from coded_video import record\n"
        "from orchestrator.clips.packet_ring import PacketRing\n"
        "video, ring = map(pathlib.Path, sys.argv[1:])\n"
        f"record(video, PacketRing(ring, {ENOUGH}), {BEGAN}, close=False)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, video, tmp_path / "ring"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        check=False,
    )
    assert ended.returncode == -signal.SIGKILL
    last = ring_files(tmp_path / "ring")[-1]
    assert last.begin == pytest.approx(BEGAN + 8.1, abs=0.01)
    assert packets_in(last.path)[-1][2] > 1.0  # of three seconds


def test_the_oldest_files_go_when_enough_was_recorded_after_them_however_long_ago(tmp_path: Path) -> None:
    for begin, seconds in ((1000, 4), (1004, 4), (9000, 4), (9004, 2)):
        path = tmp_path / f"{begin * 1000:013d}.mkv"
        path.write_bytes(b"")
        os.utime(path, (begin + seconds, begin + seconds))
    PacketRing(tmp_path, 9.5).delete_oldest()
    assert [file.begin for file in ring_files(tmp_path)] == [1004, 9000, 9004]
    PacketRing(tmp_path, 5).delete_oldest()
    assert [file.begin for file in ring_files(tmp_path)] == [9000, 9004]


def test_a_ring_that_runs_keeps_as_much_as_it_is_to(tmp_path: Path) -> None:
    video = write_video(tmp_path / "video.mkv", 60)
    # Files are written just now, so those that began long ago count as long.
    record(video, PacketRing(tmp_path / "ring", 10), time.time() - 60)
    kept = ring_files(tmp_path / "ring")
    assert 1 < len(kept) < 10


def test_packets_that_waited_for_the_connection_have_the_times_at_which_they_were_taken(
    tmp_path: Path,
) -> None:
    video = write_video(tmp_path / "video.mkv", 8)
    record(video, PacketRing(tmp_path / "ring", ENOUGH), BEGAN, late=lambda seconds: max(2.5 - seconds, 0.1))
    assert [file.begin for file in ring_files(tmp_path / "ring")] == pytest.approx(
        [BEGAN + 0.1, BEGAN + 4.1], abs=0.11
    )


def test_a_jump_of_the_cameras_clock_begins_another_file_at_the_next_key_frame(tmp_path: Path) -> None:
    video = write_video(tmp_path / "video.mkv", 8)
    # From 3 s on the camera's clock is an hour behind.
    record(video, PacketRing(tmp_path / "ring", ENOUGH), BEGAN, late=lambda s: 0.0 if s < 3 else 3600.0)
    first, second = ring_files(tmp_path / "ring")
    assert (first.begin, second.begin) == (BEGAN, BEGAN + 2 * KEY_SECONDS + 3600)
    assert len(packets_in(first.path)) == 3 * RATE


def test_a_fault_of_the_disk_is_a_gap_and_nothing_else(tmp_path: Path) -> None:
    video = write_video(tmp_path / "video.mkv", 30)
    ring = PacketRing(tmp_path / "ring", ENOUGH)
    (tmp_path / "ring").write_bytes(b"in the way")
    recorder: PacketRecorder | None = None
    now = [BEGAN]
    for streams, packet in packets_of(video):
        now[0] = BEGAN + float((packet.pts or 0) * packet.time_base)
        recorder = recorder or PacketRecorder(ring, streams, lambda: now[0])
        if (tmp_path / "ring").is_file() and now[0] >= BEGAN + 9:
            (tmp_path / "ring").unlink()
        recorder.keep(packet)
    assert ring_files(tmp_path / "ring")[0].begin == BEGAN + 10


def test_pictures_that_are_not_compressed_are_not_kept(tmp_path: Path) -> None:
    video = write_video(tmp_path / "video.mkv", 4, "rawvideo")
    record(video, PacketRing(tmp_path / "ring", ENOUGH), BEGAN)
    assert ring_files(tmp_path / "ring") == []


def test_jpegs_that_libav_has_no_part_in_are_kept_with_the_times_at_which_they_came(tmp_path: Path) -> None:
    now = [BEGAN]
    recorder = JpegRecorder(PacketRing(tmp_path / "ring", ENOUGH), lambda: now[0])
    recorder.keep(b"a damaged one")
    jpegs = [
        cv2.imencode(".jpg", np.full((48, 64, 3), 5 * number, np.uint8))[1].tobytes() for number in range(30)
    ]
    for jpeg in jpegs:
        recorder.keep(jpeg)
        now[0] += 0.5
    recorder.close()
    kept = [(file, packets_in(file.path)) for file in ring_files(tmp_path / "ring")]
    assert [content for _, packets in kept for content, _, _ in packets] == jpegs
    taken = [file.begin + seconds for file, packets in kept for _, _, seconds in packets]
    assert taken == pytest.approx([BEGAN + number / 2 for number in range(30)], abs=0.002)
    assert len(kept) == 4
