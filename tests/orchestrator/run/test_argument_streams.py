"""Sources named as arguments: how each becomes a stream, and what a mistaken one is told."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from mlbs_actors.errors import ConfigError
from orchestrator.run.argument_streams import DEMO, argument_streams
from orchestrator.run.listed_stream import MAX_NAME_BYTES, ListedStream
from orchestrator.run.stream_list import missing_sources, read_stream_list, refuse_if_all

REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def touch(*names: str) -> None:
    for name in names:
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()


def named(*words: str) -> list[tuple[str, str]]:
    return [(stream.name, str(stream.source)) for stream in argument_streams(words)]


def refusal(*words: str) -> str:
    with pytest.raises(ConfigError) as caught:
        argument_streams(words)
    return str(caught.value)


@pytest.mark.parametrize(
    "name", ["my clip #1.mp4", 'it\'s "a".mp4', "12:30.mp4", "C:\\a.mp4", "rtsp:.mp4", "[x]*.mp4"]
)
def test_a_file_is_taken_by_its_name_whatever_it_looks_like(folder: Path, name: str) -> None:
    touch(name)
    ((_, source),) = named(name)
    assert source == str(folder / name)


def refuse_missing(streams: Sequence[ListedStream]) -> None:
    refuse_if_all(None, streams, missing_sources(streams))


def test_a_folder_or_glob_of_videos_is_a_stream_for_each(folder: Path) -> None:
    touch("clips/b.MP4", "clips/a.mov", "clips/notes.txt")
    expected = [("a", str(folder / "clips/a.mov")), ("b", str(folder / "clips/b.MP4"))]
    assert named("clips") == named("clips/") == named("clips/*.[mM]*") == expected


def test_a_folder_or_glob_of_images_is_one_stream() -> None:
    touch("yard/1.png", "yard/2.png")
    assert [name for name, _ in named("yard", "yard/*.png")] == ["yard", "yard-2"]


def test_sources_of_one_name_are_numbered_beside_those_of_the_list() -> None:
    touch("a/clip.mp4", "b/Clip.mp4", "b/clip-2.mp4", "c/clip.mov")
    streams = argument_streams(["a/clip.mp4", "b", "c/clip.mov"], taken=["clip"])
    assert [stream.name for stream in streams] == ["clip-2", "Clip-3", "clip-2-2", "clip-4"]
    assert {stream.line for stream in streams} == {None}


@pytest.mark.parametrize(
    ("word", "name"),
    [
        ("rtsp://bob:hunter2@host/door", "door"),
        ("rtsp://host/user=bob&password=hunter2", "user=bob&password=-"),
        ("./-rf.mp4", "rf"),
        (".hidden.mp4", "hidden"),
        ("run.json.mp4", "run.json-2"),
        ("a\\b\n.mp4", "a-b-"),
        ("./12:30 gate.mp4", "12-30 gate"),
        ("gate. .mp4", "gate"),
        ("/dev/video0", "video0"),
        ("synthetic:crossing", "crossing"),
        ("é" * 80 + ".mp4", "é" * ((MAX_NAME_BYTES - 6) // 2)),
    ],
)
def test_a_name_is_made_one_that_a_list_would_accept(folder: Path, word: str, name: str) -> None:
    (stream,) = argument_streams([word])
    assert stream.name == name
    assert "hunter2" not in f"{stream!r} {stream.source}"
    (folder / "list.txt").write_text(f"'{stream.name}' a.mp4\n")
    assert [listed.name for listed in read_stream_list(folder / "list.txt").streams] == [name]


def test_demo_is_the_built_in_scene_of_the_demo_list_unless_there_is_such_a_file(folder: Path) -> None:
    assert named("demo") == [("street", DEMO)]
    assert [
        (one.name, str(one.source)) for one in read_stream_list(REPOSITORY / "configs/streams.txt").streams
    ] == named("demo")
    touch("demo")
    assert named("demo") == [("demo", str(folder / "demo"))]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["My", "Clips/DJI 1.MP4"], "put it in quotes: python -m orchestrator 'My Clips/DJI 1.MP4'"),
        (["My", "Clips/*.MP4"], "put it in quotes: python -m orchestrator 'My Clips/*.MP4'"),
        (["x.mp4", "My", "Clips/DJI", "1.MP4"], "python -m orchestrator x.mp4 'My Clips/DJI 1.MP4'"),
        (["rtsp://bob:it's@host/x", "My", "Clips"], "'rtsp://***@host/x' 'My Clips'"),
        (["yard/1.png", "yard/2.png"], "name the folder, yard, or put the glob in quotes: 'yard/*.png'"),
        (["list.txt"], "; python -m orchestrator --streams list.txt would read it as a list of streams."),
        (["mixed 1"], "name one kind by a glob such as '{}/mixed 1/*.mp4'."),
        (["C:\\Me\\a.mp4"], "C: is a drive of Windows; write /mnt/c/Me/a.mp4, where WSL has its files."),
        (["https://host/a.mp4?x=1"], "download the video and name its file."),
        (["s3://bucket/a.mp4"], "'s3' is no known kind of source"),
        ([""], "A source is named by 1 to"),
        ([os.fsdecode(b"\xff.mp4")], "is not UTF-8 text; rename the file."),
    ],
)
def test_a_mistaken_argument_is_told_what_to_type(folder: Path, words: list[str], expected: str) -> None:
    touch("My Clips/DJI 1.MP4", "yard/1.png", "yard/2.png", "list.txt", "mixed 1/a.mp4", "mixed 1/a.png")
    assert expected.format(folder) in refusal(*words)


def test_a_path_with_spaces_is_told_to_be_quoted_also_where_its_first_word_is_a_file() -> None:
    touch("My Clips/a.mp4", "My/b.mp4")
    assert "'My Clips/a.mp4'" in refusal("My", "Clips/a.mp4")


def test_missing_files_are_named_and_fail_alone_unless_nothing_is_left(folder: Path) -> None:
    Path("a.mp4").write_text("a")
    assert list(missing_sources(argument_streams(["a.mp4", "b.mp4"]))) == ["b"]
    with pytest.raises(ConfigError) as caught:
        refuse_missing(argument_streams(["b.mp4", "c.mp4"]))
    assert str(caught.value).splitlines() == [
        f"There is no file or folder {folder / name}; check the path." for name in ("b.mp4", "c.mp4")
    ]


def test_a_folder_of_folders_of_videos_is_told_how_to_be_named(folder: Path) -> None:
    touch("DCIM/100/a.MP4", "DCIM/101/a.MP4")
    with pytest.raises(ConfigError, match=r"for those in its folders write '.*DCIM/\*/\*\.MP4'"):
        refuse_missing(argument_streams(["DCIM"]))
    assert [name for name, _ in named("DCIM/*/*.MP4")] == ["a", "a-2"]


def test_a_folder_without_pictures_is_told_which_are_read(folder: Path) -> None:
    touch("empty/notes.doc")
    with pytest.raises(ConfigError, match=r"There are no videos and no images at .*empty; .* mp4, .* png,"):
        refuse_missing(argument_streams(["empty"]))
