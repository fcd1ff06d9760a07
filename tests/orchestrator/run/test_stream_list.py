"""The list of streams: what is read, and how hostile or mistaken lists are refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mlbs_actors.errors import ConfigError
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.stream_list import (
    MAX_BYTES,
    MAX_STREAMS,
    missing_sources,
    read_stream_list,
    refuse_if_all,
)
from orchestrator.sources.address import SourceKind
from orchestrator.sources.presence import images_of


def read(folder: Path, text: str | bytes) -> tuple[ListedStream, ...]:
    path = folder / "list.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_stream_list(path).streams


def refusal(folder: Path, text: str | bytes) -> str:
    with pytest.raises(ConfigError) as caught:
        read(folder, text)
    return str(caught.value)


def test_a_line_is_a_uri_or_a_name_and_a_uri(tmp_path: Path) -> None:
    streams = read(tmp_path, "videos/street.mp4\nyard /data/yard/frames\n")
    assert [(s.name, s.source.location, s.line) for s in streams] == [
        ("street", str(tmp_path / "videos/street.mp4"), 1),
        ("yard", "/data/yard/frames", 2),
    ]


def test_relative_paths_count_from_the_folder_of_the_list_not_from_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lists").mkdir()
    (tmp_path / "lists/a.txt").write_text("../clips/a.mp4\n")
    monkeypatch.chdir(tmp_path)
    (stream,) = read_stream_list(Path("lists/a.txt")).streams
    assert Path(stream.source.location).resolve() == (tmp_path / "clips/a.mp4").resolve()


def test_quotes_comments_blank_lines_and_windows_line_ends_are_understood(tmp_path: Path) -> None:
    text = "\ufeff# my list\r\n\r\n'my yard' \"a b.mp4\"  # the yard\r\nc\\ d.mp4\r\n"
    assert [(s.name, Path(s.source.location).name) for s in read(tmp_path, text)] == [
        ("my yard", "a b.mp4"),
        ("c d", "c d.mp4"),
    ]


@pytest.mark.parametrize("uri", ["take#2.mp4", "'#take.mp4'", "\\#take.mp4", '"a #b.mp4"'])
def test_a_hash_inside_a_word_or_quoted_is_no_comment(tmp_path: Path, uri: str) -> None:
    (stream,) = read(tmp_path, f"x {uri}\n")
    assert "#" in stream.source.location


@pytest.mark.parametrize(
    ("uri", "kind", "name"),
    [
        ("a/street.v2.mp4", SourceKind.PATH, "street.v2"),
        ("a/frames/", SourceKind.PATH, "frames"),
        ("a/cars/*.jpg", SourceKind.PATH, "cars"),
        ("rtsp://10.0.0.7:554/door", SourceKind.NETWORK, "door"),
        ("rtsps://bob:pw@10.0.0.7/yard/live.sdp?token=x", SourceKind.NETWORK, "live"),
        ("rtsp://bob:pw@cam-3.lan:554", SourceKind.NETWORK, "cam-3.lan"),
        ("http://bob:pw@10.0.0.8:8080/?action=stream", SourceKind.NETWORK, "10.0.0.8"),
        ("https://cam/axis-cgi/mjpg/video.cgi?fps=5", SourceKind.NETWORK, "video"),
        ("/dev/video12", SourceKind.CAMERA, "video12"),
        ("synthetic:demo?frames=9&seed=2", SourceKind.SYNTHETIC, "demo"),
    ],
)
def test_each_kind_of_uri_is_known_and_names_its_stream(
    tmp_path: Path, uri: str, kind: SourceKind, name: str
) -> None:
    (stream,) = read(tmp_path, f"'{uri}'\n")
    assert (stream.source.kind, stream.name) == (kind, name)


@pytest.mark.parametrize(
    "uri",
    [
        "rtsp://bob:hunter2@10.0.0.7/door",
        "rtsp://bob:hun%2Fter2@10.0.0.7",
        "RTSP://bob:a@hunter2@10.0.0.7/door",
        "rtsp://10.0.0.7/user=bob&password=hunter2",
        "rtsp://10.0.0.7/door?pwd=hunter2",
        "http://10.0.0.7/mjpg?user=bob&password=hunter2",
        "rtsp://bob:a%23hunter2@10.0.0.7/door",
    ],
)
def test_no_name_message_or_repr_of_a_stream_shows_its_password(tmp_path: Path, uri: str) -> None:
    (stream,) = read(tmp_path, f"door {uri}\n")
    shown = f"{stream!r} {stream.source} {refusal(tmp_path, f'a {uri}' + chr(10) + f'a {uri}' + chr(10))}"
    shown += refusal(tmp_path, f"{uri} {uri} {uri}\n")
    try:
        shown += read(tmp_path, f"{uri}\n")[0].name
    except ConfigError as error:
        shown += str(error)
    assert "ter2" in stream.source.location
    assert "ter2" not in shown


@pytest.mark.parametrize("mark", "/?#")
def test_a_mark_in_a_password_that_would_end_the_host_is_refused_at_once(tmp_path: Path, mark: str) -> None:
    message = refusal(tmp_path, f"door rtsp://bob:hun{mark}ter2@10.0.0.7/door\n")
    assert "write them %2F, %3F and %23" in message
    assert "ter2" not in message
    assert "hun" not in message


@pytest.mark.parametrize(
    "line",
    [
        "concat:a.mp4|b.mp4",
        "ftp://example.org/a.mp4",
        "file:///etc/passwd",
        "subfile,,start,0,end,9,,:/etc/passwd",
        "x data:text/plain,abc",
        "../up a.mp4",
        ".. a.mp4",
        "a/b c.mp4",
        "'a\\b' c.mp4",
        ".hidden a.mp4",
        "-rf a.mp4",
        "'' a.mp4",
        "status.json a.mp4",
        "REPORT.HTML a.mp4",
        "/",
        "''",
        "a b c.mp4",
        "'unclosed.mp4",
        "rtsp://",
        "synthetic:nowhere",
        "synthetic:demo?frames=0",
        "synthetic:demo?frames=1e9",
        "synthetic:demo?speed=2",
        "synthetic:demo?objects=3",
        "synthetic:steady-crowd?objects=33",
        "synthetic:demo?seed=1&seed=2",
        "n" * 101 + " a.mp4",
        "a " + "n" * 5000,
    ],
)
def test_a_bad_line_is_refused_with_its_number(tmp_path: Path, line: str) -> None:
    assert "line 2:" in refusal(tmp_path, f"good.mp4\n{line}\n")


@pytest.mark.parametrize("raw", [b"a\x00b.mp4", b"a\x1b[2Jb.mp4", b"\xff\xfe.mp4"])
def test_control_characters_and_broken_text_are_refused_with_their_line(tmp_path: Path, raw: bytes) -> None:
    assert "line 2:" in refusal(tmp_path, b"good.mp4\n" + raw + b"\n")


def test_all_bad_lines_are_named_at_once_also_when_they_are_many(tmp_path: Path) -> None:
    message = refusal(tmp_path, "ftp://x/a\ngood.mp4\n" + "ftp://x/b\n" * 30 + "ok.mp4\nftp://x/c\n")
    assert "32 bad lines" in message
    assert "line 1:" in message
    assert "22–32, 34" in message


def test_a_list_with_bad_lines_tells_at_once_which_files_are_missing(tmp_path: Path) -> None:
    (tmp_path / "there.mp4").write_text("there")
    message = refusal(tmp_path, "there.mp4\nlost.mp4\nftp://x/c\n")
    bad, _, others = message.partition("Of the other lines")
    assert "1 bad line;" in bad
    assert "line 3:" in bad
    assert "line 2: There is no file" in others
    assert "line 1" not in message


def test_a_name_that_comes_twice_is_refused_and_says_where_it_was(tmp_path: Path) -> None:
    message = refusal(tmp_path, "a/frames\nb/frames\n")
    assert "line 2:" in message
    assert "line 1" in message
    assert "NAME SOURCE" in message


def test_names_that_differ_only_in_case_are_refused_as_some_disks_take_them_for_one(tmp_path: Path) -> None:
    message = refusal(tmp_path, "Gate synthetic:no-mover\ngate synthetic:pan\n")
    assert "line 2: the name 'gate' is taken by line 1 (upper and lower case are alike)" in message


@pytest.mark.parametrize("name", ["12:30", "gate?", "a|b", "'gate.'"])
def test_a_name_that_not_every_disk_can_store_is_refused_with_what_to_do(tmp_path: Path, name: str) -> None:
    message = refusal(tmp_path, f"{name} synthetic:no-mover\n")
    assert "which not every disk can store; choose another name" in message


@pytest.mark.parametrize("text", ["", "\n\n", "# nothing\n"])
def test_an_empty_list_is_refused(tmp_path: Path, text: str) -> None:
    assert "no stream" in refusal(tmp_path, text)


def test_a_missing_list_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--streams"):
        read_stream_list(tmp_path / "none.txt")


def test_a_list_past_its_limits_is_refused_without_reading_on(tmp_path: Path) -> None:
    assert "MiB" in refusal(tmp_path, b"a.mp4\n" * (MAX_BYTES // 6 + 1))
    assert str(MAX_STREAMS) in refusal(tmp_path, "".join(f"s{i} a.mp4\n" for i in range(MAX_STREAMS + 1)))


@given(st.binary(max_size=200))
def test_any_bytes_are_either_a_list_or_refused_in_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    folder = tmp_path_factory.mktemp("list")
    try:
        streams = read(folder, content)
    except ConfigError:
        return
    for stream in streams:
        assert Path(folder / stream.name).parent == folder


@pytest.mark.parametrize(
    "content", [b"\xff\xd8\xff\xe0rest", b"\x89PNG\r\n", b"\x00\x00\x00\x18ftypmp42", b"RIFF\x00\x00"]
)
def test_a_video_or_picture_given_for_the_list_is_told_in_one_sentence(
    content: bytes, tmp_path: Path
) -> None:
    given = tmp_path / "street.mp4"
    for length in (0, 9 * 2**20):
        given.write_bytes(content + bytes(length))
        with pytest.raises(ConfigError, match=f"not a list of streams; leave out --streams: .* {given}"):
            read_stream_list(given)


def test_a_folder_given_for_the_list_is_told_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is a folder, not a list of streams; leave out --streams"):
        read_stream_list(tmp_path)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("My Clips/DJI 1.MP4", "put it in quotes: 'My Clips/DJI 1.MP4'."),
        ("My Clips", "put it in quotes: 'My Clips'."),
        ("my My Clips  # all", "put it in quotes: my 'My Clips'."),
        ("My Clips/*.MP4", "put it in quotes: 'My Clips/*.MP4'."),
        ("no My Clip", "put a path that holds spaces in quotes: no 'My Clip'."),
        ("https://host/a.mp4", "download the video and name its file"),
        ("file:///My%20Clips/a.mp4", "write '/My Clips/a.mp4', its path alone"),
        (r"'C:\Me\a b.mp4'", "write '/mnt/c/Me/a b.mp4', where WSL"),
        (r"C:\Me\a.mp4", r"write the path with / for \ from /mnt/c/ on,"),
    ],
)
def test_a_mistaken_line_is_told_what_to_write(tmp_path: Path, line: str, words: str) -> None:
    (tmp_path / "My Clips").mkdir()
    (tmp_path / "My Clips/DJI 1.MP4").touch()
    assert words in refusal(tmp_path, f"{line}\n")


def test_a_folder_or_glob_of_videos_is_a_stream_for_each(tmp_path: Path) -> None:
    folder = tmp_path / "day 1"
    folder.mkdir()
    for name in ("b.mp4", "a10.MOV", "a9.mkv", "notes.txt", ".hidden.mp4"):
        (folder / name).touch()
    streams = read(tmp_path, "'day 1'\nnight 'day 1/a*'\n")
    assert [(stream.name, Path(stream.source.location).name, stream.line) for stream in streams] == [
        ("a9", "a9.mkv", 1),
        ("a10", "a10.MOV", 1),
        ("b", "b.mp4", 1),
        ("night-a9", "a9.mkv", 2),
        ("night-a10", "a10.MOV", 2),
    ]


def test_brackets_in_the_names_of_files_and_folders_stand_for_themselves(tmp_path: Path) -> None:
    for folder in ("takes [1]", "takes 1"):
        (tmp_path / folder).mkdir()
        for name in ("street [HD].mp4", "street H.mp4"):
            (tmp_path / folder / name).touch()
    streams = read(tmp_path, '"takes [1]/street [HD].mp4"\nall "takes [1]/*.mp4"\n')
    assert [stream.name for stream in streams] == ["street [HD]", "all-street H", "all-street [HD]"]
    assert {Path(stream.source.location).parent.name for stream in streams} == {"takes [1]"}
    assert [stream.source.path for stream in streams] == [Path(one.source.location) for one in streams]


def test_a_folder_of_videos_and_images_is_refused_and_two_videos_of_one_name_too(tmp_path: Path) -> None:
    for name in ("mixed/a.mp4", "mixed/a.png", "twins/a.mp4", "twins/a.avi"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    message = refusal(tmp_path, "mixed\ntwins\nmixed/*.png\n")
    assert "line 1: " in message
    assert "holds videos and images, such as a.mp4 and a.png" in message
    assert "line 2: the name 'a' is taken by line 2" in message
    assert "line 3" not in message


def test_a_glob_of_folders_of_images_is_a_stream_for_each(tmp_path: Path) -> None:
    for name in ("dog", "car10", "car9"):
        for kind in ("frames", "gt"):
            (tmp_path / "set" / name / kind).mkdir(parents=True)
            (tmp_path / "set" / name / kind / "00000.jpg").touch()
    (tmp_path / "set/empty/frames").mkdir(parents=True)
    expected = {name: str(tmp_path / f"set/{name}/frames") for name in ("car9", "car10", "dog")}
    streams = read(tmp_path, "set/*/frames\n")
    assert {one.name: one.source.location for one in streams} == expected
    assert [one.name for one in streams] == ["car9", "car10", "dog"]
    assert [one.name for one in read(tmp_path, "day 'set/car*/frames/'\n")] == ["day-car9", "day-car10"]
    assert [one.name for one in read(tmp_path, "x set/dog/*\n")] == ["x-frames", "x-gt"]
    assert "would have the same name" in refusal(tmp_path, "set/*/[fg]*/../frames\n")


def test_a_glob_of_images_in_many_folders_is_a_stream_for_each_folder(tmp_path: Path) -> None:
    for name in ("cars1", "cars[2]"):
        (tmp_path / "set" / name).mkdir(parents=True)
        for image in ("a_01.ppm", "a_02.ppm", "a_01.pgm"):
            (tmp_path / "set" / name / image).touch()
    streams = read(tmp_path, "'set/*/*.ppm'\n")
    assert [one.name for one in streams] == ["cars1", "cars[2]"]
    for one in streams:
        assert [path.name for path in images_of(one.source.location)] == ["a_01.ppm", "a_02.ppm"]
    assert [one.name for one in read(tmp_path, "mine 'set/cars1/*.ppm'\n")] == ["mine"]


def test_a_folder_of_folders_of_images_is_told_how_to_be_written(tmp_path: Path) -> None:
    (tmp_path / "480p/dog").mkdir(parents=True)
    (tmp_path / "480p/dog/00000.jpg").touch()
    streams = read(tmp_path, "480p\n")
    with pytest.raises(ConfigError, match=r"write '.*480p/\*'"):
        refuse_if_all(tmp_path / "list.txt", streams, missing_sources(streams))
    assert [one.name for one in read(tmp_path, "'480p/*'\n")] == ["dog"]
