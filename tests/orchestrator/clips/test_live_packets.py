"""Clips of a real camera: what is read of it and what is cut out of its packets are the same pictures."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from camera_server import PASSWORD, camera, free_port, needs_rtsp_server

from mlbs_actors.messages import Array
from mlbs_actors.source import SourceFrame
from orchestrator.clips.cutting import CutRequest, cut
from orchestrator.clips.packet_ring import PacketRing, ring_files
from orchestrator.sources.address import parse_address
from orchestrator.sources.opening import open_reader


def _ball(image: Array) -> float:
    """Where the moving ball is, px from the left."""
    return float(np.argmax(image[..., :3].mean(axis=(0, 2))))


@pytest.mark.long
@needs_rtsp_server
def test_a_clip_shows_each_frame_at_the_time_at_which_it_was_taken(tmp_path: Path) -> None:
    port, taken = free_port(), dict[float, float]()
    ring = PacketRing(tmp_path / "ring", 60)
    with camera(port):
        address = parse_address(f"rtsp://bob:{PASSWORD}@127.0.0.1:{port}/door", tmp_path)
        reader = open_reader(address, packets=ring)
        while len(taken) < 200:  # ten seconds
            frame = reader.read()
            if isinstance(frame, SourceFrame) and frame.image is not None and frame.taken is not None:
                taken[frame.taken] = _ball(frame.image)
        reader.close()
    times = sorted(taken)[60:140]
    begin, end = times[0], times[-1]
    assert cut(CutRequest(begin, end, (str(tmp_path / "clip.mp4"),), str(ring.folder)))
    with av.open(str(tmp_path / "clip.mp4")) as container:
        shown = [(float(one.time or 0), _ball(one.to_ndarray(format="bgr24"))) for one in container.decode()]
    # The clip begins with the key frame before; the offset that fits best says when that was.
    key = next(file.begin for file in reversed(ring_files(ring.folder)) if file.begin <= begin)
    assert shown[-1][0] > end - begin - 0.2
    clip_times = np.array([time for time, _ in shown])
    places = np.array([place for _, place in shown])
    starts = np.arange(key, begin + 0.05, 0.01)
    read = np.array([taken[time] for time in times])

    def misfit(start: float) -> float:
        nearest = np.abs(clip_times[None] + start - np.array(times)[:, None]).argmin(1)
        return float(np.median(np.abs(places[nearest] - read)))

    best = float(min(starts, key=misfit))
    assert misfit(best) <= 2
    assert begin - 0.6 <= best <= begin + 0.05  # a key frame every half second
    assert end - 0.15 < best + shown[-1][0] < end + 0.05  # the last one before the end
