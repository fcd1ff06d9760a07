"""What readers deliver: pixels, times and names of whole sources; an honest end of damaged ones."""

from __future__ import annotations

import os
import pickle
import re
import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from PIL import Image

from mlbs_actors.errors import SourceError
from mlbs_actors.messages import Array
from mlbs_actors.scenes.synthetic import scene
from mlbs_actors.source import FrameReader, SourceFrame
from orchestrator.sources.address import parse_address
from orchestrator.sources.images import FRAME_RATE, decode_image
from orchestrator.sources.opening import open_reader
from orchestrator.sources.presence import require_source


def opened(uri: str | Path) -> FrameReader:
    return open_reader(parse_address(str(uri), Path("/")))


def read_all(reader: FrameReader) -> list[SourceFrame]:
    frames = []
    while (frame := reader.read()) is not None:
        assert isinstance(frame, SourceFrame)
        frames.append(frame)
    assert reader.read() is None
    reader.close()
    reader.close()
    assert [frame.index for frame in frames] == list(range(len(frames)))
    return frames


def image_of(frame: SourceFrame) -> Array:
    assert frame.image is not None
    assert frame.image.dtype == np.uint8
    assert frame.image.ndim == 3
    assert frame.image.shape[2] == 3
    return frame.image


def write_video(path: Path, pictures: list[Array], codec: str, **options: str) -> Path:
    with av.open(str(path), "w", options=options) as container:
        stream = container.add_stream(codec, rate=20)
        assert isinstance(stream, VideoStream)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "bgr0" if codec == "ffv1" else "yuv420p"
        stream.codec_context.thread_count = 1
        for picture in pictures:
            container.mux(stream.encode(VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    return path


@pytest.fixture(scope="module")
def pictures() -> list[Array]:
    demo = scene("demo", frames=40, width=160, height=120)
    return [demo.frame(index) for index in range(40)]


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "mpeg4"), ("a.mkv", "ffv1"), ("a.webm", "libvpx")])
def test_a_video_tells_how_many_frames_it_has(
    tmp_path: Path, pictures: list[Array], name: str, codec: str
) -> None:
    reader = opened(write_video(tmp_path / name, pictures, codec))
    frame = reader.read()
    assert isinstance(frame, SourceFrame)
    assert frame.length == 40
    reader.close()


# Image folders and globs


def test_a_folder_is_read_in_natural_order_and_masks_keep_its_stems(tmp_path: Path) -> None:
    for number in (10, 9, 1):
        cv2.imwrite(str(tmp_path / f"f{number}.png"), np.full((4, 6, 3), number, np.uint8))
    (tmp_path / "notes.txt").write_text("no image")
    (tmp_path / ".hidden.png").write_bytes(b"")
    frames = read_all(opened(tmp_path))
    assert [frame.name for frame in frames] == ["f1", "f9", "f10"]
    assert [int(image_of(frame)[0, 0, 0]) for frame in frames] == [1, 9, 10]
    assert [frame.pts for frame in frames] == [0.0, 1 / FRAME_RATE, 2 / FRAME_RATE]


@pytest.mark.parametrize(
    "stems",
    [
        ["1700000000.0", "1700000000.12", "1700000000.9", "1700000001.0417"],  # of time.time()
        ["cam0_9.5", "cam0_10.25", "cam0_10.3"],
        ["1.1", "1.9", "1.10", "1.11"],  # scene and frame
        ["take1.5_2", "take1.5_10"],
    ],
)
def test_digits_behind_a_point_are_a_fraction_where_the_names_are_those_of_floats(
    tmp_path: Path, stems: list[str]
) -> None:
    for stem in reversed(stems):
        cv2.imwrite(str(tmp_path / f"{stem}.png"), np.zeros((4, 6, 3), np.uint8))
    assert [frame.name for frame in read_all(opened(tmp_path))] == stems


def test_a_glob_takes_only_what_matches(tmp_path: Path) -> None:
    for name in ("a1.png", "a2.png", "b1.png"):
        cv2.imwrite(str(tmp_path / name), np.zeros((4, 6, 3), np.uint8))
    assert [frame.name for frame in read_all(opened(f"{tmp_path}/a*.png"))] == ["a1", "a2"]


def test_a_folder_whose_name_holds_wildcards_is_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "take [1]"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), np.zeros((4, 6, 3), np.uint8))
    (tmp_path / "take 1").mkdir()
    for place in (folder, folder / "*.png", folder / "a.png"):
        assert len(read_all(opened(place))) == 1


def test_grey_16_bit_alpha_and_narrow_images_become_8_bit_bgr(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1_grey.png"), np.full((5, 7), 90, np.uint8))
    cv2.imwrite(str(tmp_path / "2_grey16.png"), np.full((5, 7), 0x1234, np.uint16))
    cv2.imwrite(str(tmp_path / "3_colour16.png"), np.full((5, 7, 3), 0xFE00, np.uint16))
    cv2.imwrite(str(tmp_path / "4_alpha.png"), np.full((5, 7, 4), (10, 20, 30, 0), np.uint8))
    cv2.imwrite(str(tmp_path / "5_narrow.png"), np.full((9, 1, 3), 7, np.uint8))
    images = [image_of(frame) for frame in read_all(opened(tmp_path))]
    assert [image[0, 0].tolist() for image in images] == [
        [90, 90, 90],
        [0x12, 0x12, 0x12],
        [0xFE, 0xFE, 0xFE],
        [10, 20, 30],
        [7, 7, 7],
    ]
    assert images[4].shape == (9, 1, 3)


@pytest.mark.parametrize(
    ("suffix", "store"),
    [
        (".png", lambda shade: (shade * 16).astype(np.uint16)),  # 12 bits
        (".tif", lambda shade: (29_300 + 2 * shade).astype(np.uint16)),  # a thermal camera's hundredths of K
        (".tif", lambda shade: (20 + shade / 25).astype(np.float32)),  # °C
        (".tif", lambda shade: (-300 + shade).astype(np.int16)),
    ],
)
def test_values_of_more_than_8_bits_are_stretched_alike_over_the_whole_sequence(
    tmp_path: Path, suffix: str, store: Callable[[Array], Array]
) -> None:
    shades = np.linspace(0, 255, 40 * 50).reshape(40, 50).round()
    for number, part in enumerate((1.0, 0.5, 1.0)):  # the one in the middle is darker
        cv2.imwrite(str(tmp_path / f"{number}{suffix}"), store((shades * part).round()))
    images = [image_of(frame) for frame in read_all(opened(tmp_path))]
    for image, part in zip(images, (1.0, 0.5, 1.0), strict=True):
        assert np.abs(image - (shades * part)[..., None]).max() <= 2


def test_a_dead_pixel_does_not_take_the_contrast_of_a_thermal_picture(tmp_path: Path) -> None:
    warm = np.linspace(29_300, 29_800, 40 * 50).reshape(40, 50).astype(np.uint16)
    warm[7, 7] = 0
    cv2.imwrite(str(tmp_path / "a.tif"), warm)
    assert image_of(read_all(opened(tmp_path))[0]).std() > 60


def test_images_are_the_pixels_that_cv2_imread_gives(tmp_path: Path, pictures: list[Array]) -> None:
    cv2.imwrite(str(tmp_path / "a.jpg"), pictures[3])
    (frame,) = read_all(opened(tmp_path))
    np.testing.assert_array_equal(image_of(frame), cv2.imread(str(tmp_path / "a.jpg")))


def test_undecodable_images_are_quarantined_in_their_place(tmp_path: Path, pictures: list[Array]) -> None:
    for number in range(5):
        cv2.imwrite(str(tmp_path / f"{number}.jpg"), pictures[number])
    (tmp_path / "1.jpg").write_bytes((tmp_path / "1.jpg").read_bytes()[:1500])
    (tmp_path / "3.jpg").write_text("no image")
    reader = opened(tmp_path)
    frames = read_all(reader)
    assert [frame.status for frame in frames] == ["ok", "quarantined", "ok", "quarantined", "ok"]
    assert [frame.image is None for frame in frames] == [False, True, False, True, False]
    assert reader.problem == "2 of 5 images could not be decoded, the first is 1.jpg."


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_cut_off_image_is_never_taken_for_a_whole_one(pictures: list[Array], suffix: str) -> None:
    whole = cv2.imencode(suffix, pictures[0])[1].tobytes()
    assert decode_image(whole) is not None
    for length in range(0, len(whole) - 8, len(whole) // 17):
        assert decode_image(whole[:length]) is None


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("tail", [bytes(200), b"MotionPhoto_Data" + bytes(range(256))])
def test_data_behind_the_end_of_an_image_changes_nothing(
    pictures: list[Array], suffix: str, tail: bytes
) -> None:
    whole = cv2.imencode(suffix, pictures[0])[1].tobytes()
    with_tail = decode_image(whole + tail)
    assert with_tail is not None
    np.testing.assert_array_equal(with_tail, cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_COLOR))


def test_the_end_of_a_thumbnail_is_not_that_of_its_picture(pictures: list[Array]) -> None:
    thumbnail = cv2.imencode(".jpg", pictures[0][:24, :32])[1].tobytes()
    note = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    whole = cv2.imencode(".jpg", pictures[0], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    whole = whole[:2] + note + whole[2:]
    assert decode_image(whole) is not None
    assert decode_image(whole[: len(whole) * 3 // 4]) is None


@pytest.mark.parametrize("name", ["a.webp", "a.png", "a.apng", "a.tif"])
def test_every_frame_of_an_animation_or_of_a_stack_is_read(
    tmp_path: Path, pictures: list[Array], name: str
) -> None:
    first, *others = (Image.fromarray(picture[..., ::-1]) for picture in pictures[:7])
    options = {"duration": 50, "lossless": True} if name == "a.webp" else {"duration": 50}
    kind = "PNG" if name.endswith("png") else None
    first.save(tmp_path / name, kind, save_all=True, append_images=others, **options)
    reader = opened(tmp_path / name)
    frames = read_all(reader)
    assert reader.problem is None
    assert [frame.name for frame in frames] == [f"{index:05d}" for index in range(7)]
    assert {frame.length for frame in frames} == {7}
    for frame, picture in zip(frames, pictures, strict=False):
        np.testing.assert_array_equal(image_of(frame), picture)
    frame_time = 1 / FRAME_RATE if name == "a.tif" else 0.05
    np.testing.assert_allclose([frame.pts for frame in frames], np.arange(7) * frame_time)


def test_a_cut_off_animation_gives_what_is_there_and_says_so(tmp_path: Path, pictures: list[Array]) -> None:
    first, *others = (Image.fromarray(picture[..., ::-1]) for picture in pictures[:7])
    first.save(tmp_path / "a.png", save_all=True, append_images=others)
    whole = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(whole[: len(whole) * 2 // 3])
    reader = opened(tmp_path / "a.png")
    assert 2 <= len(read_all(reader)) < 7
    assert reader.problem is not None
    assert "damaged: reading broke off" in reader.problem


def test_two_images_of_one_stem_are_refused_since_their_masks_would_collide(tmp_path: Path) -> None:
    for name in ("a.png", "a.jpg"):
        cv2.imwrite(str(tmp_path / name), np.zeros((4, 6, 3), np.uint8))
    with pytest.raises(SourceError, match=r"a\.png"):
        opened(tmp_path)


# Videos


def test_a_lossless_video_gives_its_pictures_times_and_counted_names(
    tmp_path: Path, pictures: list[Array]
) -> None:
    reader = opened(write_video(tmp_path / "a.mkv", pictures[:10], "ffv1"))
    frames = read_all(reader)
    assert reader.problem is None
    assert [frame.name for frame in frames][:2] == ["00000", "00001"]
    np.testing.assert_allclose([frame.pts for frame in frames], np.arange(10) / 20, atol=1e-3)
    for frame, picture in zip(frames, pictures, strict=False):
        np.testing.assert_array_equal(image_of(frame), picture)


def test_reading_a_video_twice_gives_the_same_bytes(tmp_path: Path, pictures: list[Array]) -> None:
    path = write_video(tmp_path / "a.mp4", pictures, "libx264")
    first, second = ([image_of(f).tobytes() for f in read_all(opened(path))] for _ in range(2))
    assert len(first) == 40
    assert first == second


def test_what_a_dahua_recorder_exports_is_read(tmp_path: Path, pictures: list[Array]) -> None:
    stream = write_video(tmp_path / "a.mkv", pictures[:10], "mpeg4")
    with av.open(str(stream)) as video:
        header = bytes(video.streams.video[0].codec_context.extradata or b"")
        packets = [(packet.is_keyframe, bytes(packet)) for packet in video.demux() if packet.size]
    size = struct.pack("<B3xHH", 0x82, 160, 120)
    described = struct.pack("<4B", 0x81, 0, 1, 20) + size  # MPEG-4, 20 frames/s
    chunks = []
    for number, (is_key, data) in enumerate(packets):
        payload = described + (header if is_key else b"") + data
        length = 24 + len(payload) + 8
        kind, date = 0xFD if is_key else 0xFC, 1 << 26 | 1 << 22 | 1 << 17
        head = struct.pack("<4sB3xIIIHBx", b"DHAV", kind, number, length, date, number * 50, len(described))
        chunks.append(head + payload + struct.pack("<4sI", b"dhav", length))
    (tmp_path / "a.dav").write_bytes(b"".join(chunks))
    frames = read_all(opened(tmp_path / "a.dav"))
    np.testing.assert_allclose([frame.pts for frame in frames], np.arange(10) / 20, atol=1e-3)
    assert np.abs(image_of(frames[9]).astype(int) - pictures[9]).mean() < 12


def _rotate_in_header(path: Path, matrix: tuple[int, int, int, int]) -> None:
    """Overwrite the track's display matrix: (a, b, c, d) of x' = a·x + c·y, y' = b·x + d·y."""
    one = 0x10000
    identity = np.array([one, 0, 0, 0, one, 0, 0, 0, 0x40000000], ">i4").tobytes()
    a, b, c, d = (value * one for value in matrix)
    rotated = np.array([a, b, 0, c, d, 0, 0, 0, 0x40000000], ">i4").tobytes()
    content = path.read_bytes()
    start = content.index(identity, content.index(b"tkhd"))
    path.write_bytes(content[:start] + rotated + content[start + len(rotated) :])


@pytest.mark.parametrize(
    ("matrix", "bright_corner"),
    [
        ((1, 0, 0, 1), (0, 0)),
        ((0, 1, -1, 0), (0, -1)),  # a quarter turn clockwise takes top left to top right
        ((-1, 0, 0, -1), (-1, -1)),
        ((0, -1, 1, 0), (-1, 0)),
        ((-1, 0, 0, 1), (0, -1)),  # mirrored, as by the front camera of a phone
        ((1, 0, 0, -1), (-1, 0)),
        ((0, 1, 1, 0), (0, 0)),
        ((0, -1, -1, 0), (-1, -1)),
    ],
)
def test_the_turn_or_mirror_that_a_file_states_is_applied(
    tmp_path: Path, matrix: tuple[int, int, int, int], bright_corner: tuple[int, int]
) -> None:
    picture = np.zeros((48, 64, 3), np.uint8)
    picture[:16, :16] = 255
    path = write_video(tmp_path / "a.mp4", [picture] * 3, "libx264")
    _rotate_in_header(path, matrix)
    image = image_of(read_all(opened(path))[0])
    assert image.shape == ((48, 64, 3) if matrix[0] else (64, 48, 3))
    corners = {corner: int(image[corner][0]) for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1))}
    assert max(corners, key=lambda corner: corners[corner]) == bright_corner


def test_pixels_that_are_not_square_are_told_also_when_they_are_turned(
    tmp_path: Path, pictures: list[Array]
) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=20)
        assert isinstance(stream, VideoStream)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(64, 45)
        container.mux(stream.encode(VideoFrame.from_ndarray(pictures[0], format="bgr24")))
        container.mux(stream.encode(None))
    (frame,) = read_all(opened(path))
    assert frame.pixel_aspect == pytest.approx(64 / 45)
    _rotate_in_header(path, (0, 1, -1, 0))
    (frame,) = read_all(opened(path))
    assert frame.pixel_aspect == pytest.approx(45 / 64)


def test_a_video_whose_picture_changes_its_size_is_read_to_its_end(
    tmp_path: Path, pictures: list[Array]
) -> None:
    wide = write_video(tmp_path / "a.ts", pictures[:8], "libx264").read_bytes()
    turned = [np.ascontiguousarray(np.rot90(picture)) for picture in pictures[:8]]
    high = write_video(tmp_path / "b.ts", turned, "libx264").read_bytes()
    (tmp_path / "c.ts").write_bytes(wide + high + wide)
    reader = opened(tmp_path / "c.ts")
    shapes = [image_of(frame).shape[:2] for frame in read_all(reader)]
    assert shapes == [(120, 160)] * 8 + [(160, 120)] * 8 + [(120, 160)] * 8
    assert reader.problem is None


def test_a_recording_without_its_end_is_told_as_one(tmp_path: Path, pictures: list[Array]) -> None:
    path = write_video(tmp_path / "a.mp4", pictures[:6], "libx264")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])  # the index comes last
    with pytest.raises(SourceError, match=r"a\.mp4: it is no video, or one whose recording was cut off"):
        opened(path)


@pytest.mark.parametrize("frames_each", [6, 40])
def test_times_go_on_where_videos_were_joined(
    tmp_path: Path, pictures: list[Array], frames_each: int
) -> None:
    once = write_video(tmp_path / "a.ts", pictures[:frames_each], "libx264").read_bytes()
    (tmp_path / "b.ts").write_bytes(once + once)
    frames = read_all(opened(tmp_path / "b.ts"))
    np.testing.assert_allclose([frame.pts for frame in frames], np.arange(2 * frames_each) / 20, atol=1e-3)
    assert frames[-1].length == 2 * frames_each


def test_times_that_a_file_tells_out_of_order_are_put_in_order(tmp_path: Path, pictures: list[Array]) -> None:
    # AVI has no times of presentation, so B-frames come with those of decoding.
    frames = read_all(opened(write_video(tmp_path / "a.avi", pictures, "libx264")))
    times = np.array([frame.pts for frame in frames])
    assert len(frames) == 40
    assert np.diff(times).min() > 0.04
    assert np.abs(times - np.arange(40) / 20).max() < 0.16


def test_a_video_of_variable_frame_rate_keeps_its_times(tmp_path: Path, pictures: list[Array]) -> None:
    times = np.array([0.0, 0.04, 0.4, 0.41, 1.5, 1.6])
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        assert isinstance(stream, VideoStream)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for picture, time in zip(pictures, times, strict=False):
            frame = VideoFrame.from_ndarray(picture, format="bgr24")
            frame.pts, frame.time_base = round(time * 1000), Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    frames = read_all(opened(tmp_path / "a.mp4"))
    np.testing.assert_allclose([frame.pts for frame in frames], times, atol=1e-3)


def test_images_of_odd_sizes_and_palettes_are_read_as_they_are(tmp_path: Path) -> None:
    shapes = [(1, 1), (1, 9), (7, 1), (33, 47)]
    for number, (height, width) in enumerate(shapes):
        palette = Image.fromarray(np.full((height, width), 3, np.uint8))
        palette.putpalette([0] * 9 + [10, 20, 30] + [0] * 756)
        palette.save(tmp_path / f"{number}.png")
    images = [image_of(frame) for frame in read_all(opened(tmp_path))]
    assert [image.shape[:2] for image in images] == shapes
    assert all((image == (30, 20, 10)).all() for image in images)


def _cut(content: bytes) -> bytes:
    return content[: len(content) * 2 // 3]


def _cut_early(content: bytes) -> bytes:
    """Where libav still looks what it has before it: it comes to the end of the file when it opens it."""
    return content[: len(content) // 3]


def _flip(content: bytes) -> bytes:
    flipped = bytearray(content)
    rng = np.random.default_rng(1)
    for position in rng.integers(len(content) // 4, len(content) * 3 // 4, 60):
        flipped[position] ^= 1 << int(rng.integers(8))
    return bytes(flipped)


@pytest.mark.parametrize(
    ("name", "codec", "damage", "complete"),
    [
        ("a.mp4", "libx264", _cut, False),
        ("a.avi", "mpeg4", _cut, False),
        ("a.mkv", "libx264", _cut_early, False),
        ("a.ts", "mpeg2video", _flip, None),
        ("a.avi", "mpeg4", _flip, None),
    ],
)
def test_of_a_damaged_video_all_that_decodes_is_kept_and_the_damage_stated(
    tmp_path: Path,
    pictures: list[Array],
    name: str,
    codec: str,
    damage: Callable[[bytes], bytes],
    complete: bool | None,
) -> None:
    options = {"movflags": "faststart"} if name.endswith("mp4") else {}
    path = write_video(tmp_path / name, pictures, codec, **options)
    path.write_bytes(damage(path.read_bytes()))
    reader = opened(path)
    frames = read_all(reader)
    assert frames
    if complete is False:
        assert len(frames) < len(pictures)
    assert reader.problem is not None
    assert "damaged or cut off" in reader.problem


def test_a_frame_of_which_the_decoder_made_up_a_part_is_told(tmp_path: Path, pictures: list[Array]) -> None:
    path = write_video(tmp_path / "a.ts", pictures, "mpeg2video")
    assert not any(frame.concealed for frame in read_all(opened(path)))
    content = path.read_bytes()
    place = len(content) * 6 // 10
    path.write_bytes(
        content[:place] + bytes(byte ^ 0x55 for byte in content[place : place + 12]) + content[place + 12 :]
    )
    frames = read_all(opened(path))
    assert [frame.concealed for frame in frames].count(True) == 1
    assert {frame.status for frame in frames} == {"ok"}


def _text_file(folder: Path) -> Path:
    (folder / "a.mp4").write_text("not a video")
    return folder / "a.mp4"


def _empty_file(folder: Path) -> Path:
    (folder / "a.mp4").touch()
    return folder / "a.mp4"


def _empty_folder(folder: Path) -> Path:
    return folder


def _missing(folder: Path) -> Path:
    return folder / "none.mp4"


def _sound_only(folder: Path) -> Path:
    with av.open(str(folder / "a.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 4096), np.float32), format="fltp", layout="mono")
        sound.rate = 44100
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    return folder / "a.mp4"


def _header_without_frames(folder: Path) -> Path:
    path = write_video(folder / "a.avi", [np.zeros((32, 32, 3), np.uint8)] * 3, "mpeg4")
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"movi") + 4])
    return path


def _playlist(folder: Path) -> Path:
    write_video(folder / "secret.mkv", [np.zeros((32, 32, 3), np.uint8)] * 3, "ffv1")
    (folder / "a.ffconcat").write_text("ffconcat version 1.0\nfile secret.mkv\n")
    return folder / "a.ffconcat"


def _pipe(folder: Path) -> Path:
    os.mkfifo(folder / "a.mp4")
    return folder / "a.mp4"


@pytest.mark.parametrize(
    "make",
    [
        _text_file,
        _empty_file,
        _empty_folder,
        _missing,
        _sound_only,
        _header_without_frames,
        _playlist,
        _pipe,
    ],
)
def test_what_holds_no_video_fails_with_a_sentence_that_names_it(
    tmp_path: Path, make: Callable[[Path], Path]
) -> None:
    path = make(tmp_path)
    with pytest.raises(SourceError) as caught:
        read_all(opened(path))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("make", [_empty_file, _empty_folder, _missing, _pipe])
def test_a_source_that_is_not_there_is_told_without_opening_it(
    tmp_path: Path, make: Callable[[Path], Path]
) -> None:
    path = make(tmp_path)
    with pytest.raises(SourceError, match=re.escape(str(path))):
        require_source(parse_address(str(path), Path("/")))


@pytest.mark.parametrize(
    ("name", "advice"), [("strete.mp4", "did you mean 'Street.mp4'?"), ("walk.mp4", "check the path.")]
)
def test_a_misspelt_name_is_answered_with_the_one_that_is_there(
    tmp_path: Path, name: str, advice: str
) -> None:
    (tmp_path / "Street.mp4").touch()
    with pytest.raises(SourceError, match=re.escape(advice)):
        require_source(parse_address(name, tmp_path))


@pytest.mark.parametrize(
    "uri", ["rtsp://127.0.0.1:9/door", "/dev/video999", "synthetic:demo", "x" * 300 + "/a.mp4"]
)
def test_what_cannot_be_known_without_opening_it_is_left_to_the_reader(uri: str, tmp_path: Path) -> None:
    if uri.startswith("x"):
        with pytest.raises(SourceError, match="cannot be read"):
            require_source(parse_address(uri, tmp_path))
    else:
        require_source(parse_address(uri, tmp_path))


# Synthetic scenes


def test_a_synthetic_scene_is_read_frame_by_frame() -> None:
    frames = read_all(opened("synthetic:demo?frames=3&seed=5&width=64&height=48"))
    expected = scene("demo", frames=3, seed=5, width=64, height=48)
    assert [frame.name for frame in frames] == ["00000", "00001", "00002"]
    assert {frame.length for frame in frames} == {3}
    for frame in frames:
        np.testing.assert_array_equal(image_of(frame), expected.frame(frame.index))


def test_an_address_can_be_sent_to_the_process_that_reads_it() -> None:
    address = parse_address("rtsp://a:b@c/d", Path("/"))
    assert pickle.loads(pickle.dumps(address)) == address
