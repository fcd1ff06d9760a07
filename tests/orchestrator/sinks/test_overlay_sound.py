"""The sound of a file in its overlay: copied, in time, and never at the cost of the pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from record_fakes import write_run
from sounding_video import FRAME_RATE, RATE, heard, write_sounding_video

from mlbs_actors.source import SourceFrame
from orchestrator.report.page import render_report
from orchestrator.run.stream_state import StreamState
from orchestrator.sinks.labelled_picture import LabelledPicture
from orchestrator.sinks.overlay import OverlayVideo
from orchestrator.sources.address import SourceAddress, parse_address
from orchestrator.sources.opening import open_reader
from orchestrator.sources.sound import SoundReader


def overlaid(source: Path, path: Path, first: int = 0, last: int = 1000) -> Path:
    """Draw frames of a video without objects."""
    address = parse_address(str(source), source.parent)
    reader, overlay = open_reader(address), OverlayVideo(path, address)
    while isinstance(frame := reader.read(), SourceFrame):
        if first <= frame.index < last and frame.image is not None:
            overlay.add(
                LabelledPicture(
                    frame.image, np.zeros(frame.image.shape[:2], np.uint16), frame.index, frame.pts
                )
            )
    overlay.close()
    return path


def pictures(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "aac"), ("b.mkv", "flac"), ("c.mov", "pcm_s16le")])
def test_the_overlay_has_the_sound_of_the_file_sample_by_sample(
    tmp_path: Path, name: str, codec: str
) -> None:
    write_sounding_video(tmp_path / name, codec)
    path = overlaid(tmp_path / name, tmp_path / "overlay.mp4")
    assert pictures(path) == 60
    (begin, samples), (begin_of_file, expected) = heard(path), heard(tmp_path / name)
    assert begin == begin_of_file == 0
    assert np.abs(expected).max() > 0.1 * np.iinfo(np.int16).max or expected.dtype == np.float32
    np.testing.assert_array_equal(samples, expected[: len(samples)])
    assert len(samples) / RATE == pytest.approx(60 / float(FRAME_RATE), abs=0.03)
    assert not path.with_suffix(".note").exists()


def test_sound_that_begins_before_the_picture_is_in_time_with_it(tmp_path: Path) -> None:
    write_sounding_video(tmp_path / "late.mkv", "flac", begin=0.5)
    begin, samples = heard(overlaid(tmp_path / "late.mkv", tmp_path / "overlay.mp4"))
    _, expected = heard(tmp_path / "late.mkv")
    shift = round((15 / float(FRAME_RATE) + begin) * RATE)
    # The file tells times in milliseconds.
    differences = [
        np.abs(samples[:20_000].astype(float) - expected[at : at + 20_000]).max()
        for at in range(shift - 60, shift + 61)
    ]
    assert begin < 0.1
    assert min(differences) == 0


def test_a_part_of_the_frames_has_its_part_of_the_sound(tmp_path: Path) -> None:
    write_sounding_video(tmp_path / "a.mp4", "aac")
    path = overlaid(tmp_path / "a.mp4", tmp_path / "overlay-00000020.mp4", 20, 40)
    with av.open(str(path)) as container:
        times = [
            packet.pts * packet.time_base for packet in container.demux(audio=0) if packet.pts is not None
        ]
    begin, end = 20 / float(FRAME_RATE), 40 / float(FRAME_RATE)
    assert begin - 0.03 < times[0] <= begin
    assert end - 0.03 < times[-1] < end


def test_sound_that_an_mp4_file_cannot_hold_is_left_out_and_the_report_says_so(tmp_path: Path) -> None:
    (tmp_path / "yard").mkdir()
    write_sounding_video(tmp_path / "old.wmv", "wmav2")
    path = overlaid(tmp_path / "old.wmv", tmp_path / "yard/overlay.mp4")
    assert pictures(path) == 60
    with av.open(str(path)) as container:
        assert not container.streams.audio
    write_run(tmp_path, [StreamState("yard", "done")])
    assert "The overlay has no sound: wmav2 cannot be put into an mp4 file." in render_report(tmp_path)


def test_a_source_whose_sound_cannot_be_read_has_an_overlay_without(tmp_path: Path) -> None:
    overlay = OverlayVideo(tmp_path / "overlay.mp4", parse_address("/nowhere/film.mp4", tmp_path))
    overlay.add(LabelledPicture(np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32), np.uint16), 0, 0.0))
    overlay.close()
    assert pictures(tmp_path / "overlay.mp4") == 1
    assert "The overlay has no sound. Cannot open" in (tmp_path / "overlay.note").read_text()


def test_sound_that_breaks_off_does_not_end_the_overlay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaking(self: SoundReader, seconds: float) -> Iterator[object]:
        if seconds > 1:
            raise OSError(5, "Input/output error")
        return iter(())

    write_sounding_video(tmp_path / "a.mp4", "aac")
    monkeypatch.setattr(SoundReader, "until", breaking)
    path = overlaid(tmp_path / "a.mp4", tmp_path / "overlay.mp4")
    assert pictures(path) == 60
    assert "The sound ends at 1.0 s: Input/output error." in path.with_suffix(".note").read_text()


@pytest.mark.parametrize("uri", ["synthetic:demo", "rtsp://cam/x", "/dev/video0", "."])
def test_what_is_no_file_has_no_sound(tmp_path: Path, uri: str) -> None:
    address: SourceAddress = parse_address(uri, tmp_path)
    assert SoundReader.of(address) is None
