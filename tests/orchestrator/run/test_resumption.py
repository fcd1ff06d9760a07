"""A run that is resumed with a list that has changed since."""

from __future__ import annotations

from pathlib import Path

from orchestrator.run.identity import other_source
from orchestrator.run.listed_stream import ListedStream
from orchestrator.run.resumption import gone_from_list
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.status_file import StatusFile
from orchestrator.run.stream_state import StreamState, has_ended
from orchestrator.sources.address import parse_address
from orchestrator.storage.commit_log import CommitLog


def listed(name: str, uri: str) -> ListedStream:
    return ListedStream(name, parse_address(uri, Path("/")), 1)


RECORDED = {"door": "rtsp://***@cam/door", "yard": "/yard.mp4", "gate": "/gate.mp4", "lane": "/lane.mp4"}


def test_a_file_is_its_path_and_a_camera_its_name() -> None:
    streams = [
        listed("door", "rtsp://bob:new@other/lane"),
        listed("yard", "other.mp4"),
        listed("new", "new.mp4"),
    ]
    faults = {one.name: other_source(one, RECORDED[one.name]) for one in streams if one.name in RECORDED}
    assert faults.keys() == {"door", "yard"}
    assert faults["door"] is None
    assert "'yard' stands for /yard.mp4 in this run" in str(faults["yard"])


def test_streams_that_the_list_does_not_name_any_more_have_ended_and_may_come_back(tmp_path: Path) -> None:
    for name in RECORDED:
        (tmp_path / name).mkdir()
        log = CommitLog(tmp_path / name)
        with log.exclusive():
            log.add(8, None, provisional=False)
    killed = [StreamState(name, "running", read=20, committed=8) for name in ("door", "yard", "lane")]
    over = StreamState("gate", "done", read=9, committed=9)
    StatusFile(tmp_path / "status.json").finish([*killed, over], 143)
    gone = gone_from_list(
        RunFolder(tmp_path), RECORDED, [listed("lane", "lane.mp4")], {"yard": "It stands for another source."}
    )
    assert sorted(gone) == ["door", "gate", "yard"]
    assert (gone["door"].state, gone["door"].committed, gone["door"].error) == ("done", 9, None)
    assert not has_ended(gone["door"])
    assert gone["gate"] == over
    assert (gone["yard"].state, gone["yard"].error) == ("failed", "It stands for another source.")
