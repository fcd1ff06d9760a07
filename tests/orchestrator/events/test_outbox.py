"""The outbox against an obvious list, with streams that go back and lose their oldest lines, and kills."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from orchestrator.events.census import Census
from orchestrator.events.event_filter import EventFilter
from orchestrator.events.intake import Intake, lines_behind
from orchestrator.events.outbox import Outbox, Standing

FILTERS = (EventFilter(), EventFilter(kinds=("born", "entered")), EventFilter(zones=("yard",)))
KINDS = ("born", "entered", "left", "crossed")


def event_of(stream: str, number: int, name: object, kind: str = "entered") -> dict[str, Any]:
    event = {"id": f"{stream}/{name}", "stream": stream, "kind": kind, "number": number}
    return event | {"object": number % 3, "zone": "yard", "direction": "left"}


class Stream:
    """A stream's folder, written as its record writes it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.name
        self.events: list[dict[str, Any]] = []
        self.ever: list[dict[str, Any]] = []  # with those that have been deleted
        self.gone: list[dict[str, Any]] = []  # those that may come again
        self.final = self.ticks = 0
        folder.mkdir()
        self.commit(0)

    def append(self, *events: dict[str, Any]) -> None:
        self.events += events
        with (self.folder / "events.jsonl").open("a") as file:
            file.writelines(json.dumps(event) + "\n" for event in events)

    def replace(self, events: list[dict[str, Any]]) -> None:
        self.events = events
        (self.folder / "events.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))

    def commit(self, final: int) -> None:
        self.ever += [event for event in self.events if self.final < event["number"] <= final]
        self.final = final
        draft = self.folder / ".draft"
        draft.write_text(json.dumps([{"rows": final, "events": final, "state": {}}]))
        draft.replace(self.folder / ".events")

    def touch(self) -> None:
        """Show that the file has changed, which a clock that ticks slowly may not."""
        if (self.folder / "events.jsonl").exists():
            self.ticks += 1
            os.utime(self.folder / "events.jsonl", ns=(0, self.ticks))

    def census(self) -> Census:
        """Return what all events come to, those that have been deleted included."""
        census = Census()
        for event in self.ever:
            census.add(event, final=True)
        for event in self.events:
            if event["number"] > self.final:
                census.add(event, final=False)
        return census

    @property
    def newest(self) -> int:
        return self.events[-1]["number"] if self.events else self.final


class OutboxMachine(RuleBasedStateMachine):
    """Two streams and three targets; what waits for each is compared with a list after every step."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="outbox-"))
        self.streams = [Stream(self.folder / name) for name in ("gate", "lane")]
        self.wanted: dict[str, EventFilter] = {}
        self.due: dict[str, list[dict[str, Any]]] = {}
        self.done: dict[str, list[str]] = {}
        self.seen: set[str] = set()
        self.names = 0
        self.reopen()

    def teardown(self) -> None:
        self.outbox.close()
        shutil.rmtree(self.folder)

    def reopen(self) -> None:
        self.outbox = Outbox(self.folder / "outbox")
        self.intake = Intake(self.folder, self.outbox, print)

    @initialize(wanted=st.sampled_from(FILTERS))
    def begin(self, wanted: EventFilter) -> None:
        self.retarget({"a": wanted})

    @rule(which=st.integers(0, 1), kinds=st.lists(st.sampled_from(KINDS), max_size=4))
    def happen(self, which: int, kinds: list[str]) -> None:
        stream = self.streams[which]
        for kind in kinds:
            self.names += 1
            stream.append(event_of(stream.name, stream.newest + 1, self.names, kind))

    @rule(which=st.integers(0, 1), share=st.floats(0, 1))
    def commit(self, which: int, share: float) -> None:
        stream = self.streams[which]
        stream.commit(stream.final + round(share * (stream.newest - stream.final)))

    @rule(which=st.integers(0, 1))
    def go_back(self, which: int) -> None:
        """Cut the file off behind the commit; what is gone may come again."""
        stream = self.streams[which]
        stream.gone = [event for event in stream.events if event["number"] > stream.final]
        stream.replace([event for event in stream.events if event["number"] <= stream.final])

    @precondition(lambda self: any(stream.gone for stream in self.streams))
    @rule(many=st.integers(1, 3))
    def come_again(self, many: int) -> None:
        """Let events that were cut off come again, perhaps with other numbers."""
        for stream in self.streams:
            for event in stream.gone[:many]:
                stream.append(event | {"number": stream.newest + 1})
            stream.gone = stream.gone[many:]

    @rule(which=st.integers(0, 1), many=st.integers(1, 4))
    def delete_oldest(self, which: int, many: int) -> None:
        self.look()  # who deletes and who looks run together
        stream = self.streams[which]
        committed = [event for event in stream.events if event["number"] <= stream.final]
        stream.replace(stream.events[min(many, len(committed)) :])

    @rule()
    def look(self) -> None:
        for stream in self.streams:
            oldest = stream.events[0]["number"] if stream.events else 0
            for target, due in self.due.items():
                here = [one for one in due if one["stream"] != stream.name or one["number"] >= oldest]
                self.due[target] = here
            for event in stream.events:
                if event["id"] in self.seen:
                    continue
                self.seen.add(event["id"])
                for target, wanted in self.wanted.items():
                    if wanted.wants(event):
                        self.due[target].append(event)
            stream.touch()
        self.intake.look()
        for stream in self.streams:
            found, census = self.intake.censuses.get(stream.name, Census()), stream.census()
            assert found.crossed == census.crossed
            for zone in found.inside | census.inside:
                assert found.inside.get(zone, set()) == census.inside.get(zone, set())

    @precondition(lambda self: any(self.due.values()))
    @rule(data=st.data(), refused=st.booleans())
    def deliver(self, data: st.DataObject, refused: bool) -> None:
        target = data.draw(st.sampled_from(sorted(one for one, due in self.due.items() if due)))
        place, line = self.outbox.first(target) or (0, b"{}")
        self.outbox.done(target, place, refused=refused)
        self.done[target].append(json.loads(line)["id"])
        assert json.loads(line)["id"] == self.due[target].pop(0)["id"]

    @rule(wanted=st.dictionaries(st.sampled_from("abc"), st.sampled_from(FILTERS)))
    def retarget(self, wanted: dict[str, EventFilter]) -> None:
        self.look()
        self.outbox.retarget(wanted)
        due = {target: self.due.get(target, []) for target in wanted}
        self.due = {
            target: [one for one in events if wanted[target].wants(one)] for target, events in due.items()
        }
        self.done = {target: self.done.get(target, []) for target in wanted}
        self.wanted = wanted

    @rule()
    def kill(self) -> None:
        """Begin again with the files as they are."""
        self.outbox.close()
        self.reopen()
        self.look()

    @invariant()
    def waits_what_is_due(self) -> None:
        for target, due in self.due.items():
            assert self.outbox.standing(target).waiting == len(due)
            first = self.outbox.first(target)
            assert (first and json.loads(first[1])["id"]) == (due[0]["id"] if due else None)
        for done in self.done.values():
            assert len(set(done)) == len(done)


TestOutbox = OutboxMachine.TestCase
TestOutbox.settings = settings(
    max_examples=40, stateful_step_count=30, deadline=None, phases=[Phase.reuse, Phase.generate]
)


class Killed(BaseException):
    """A process ends here."""


def test_a_kill_at_every_step_loses_nothing_and_repeats_an_event_only_between_answer_and_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same life is lived with a kill before its first, second, third … statement to the database."""
    left = -1

    class Mortal(sqlite3.Connection):
        def execute(self, *given: Any) -> sqlite3.Cursor:
            nonlocal left
            left -= 1
            if left == 0:
                raise Killed
            return super().execute(*given)

        def executemany(self, *given: Any) -> sqlite3.Cursor:
            nonlocal left
            left -= 1
            if left == 0:
                raise Killed
            return super().executemany(*given)

    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda path, **more: connect(path, factory=Mortal, **more))

    def live(folder: Path) -> tuple[list[str], bool]:
        """Let two batches happen with a commit between; return what arrives, and whether it was killed."""
        nonlocal left
        arrived: list[str] = []
        stream = Stream(folder / "gate")
        batches = iter(([1, 2, 3], [4, 5, 6]))
        was_killed, is_over = False, False
        outbox: Outbox | None = None

        def write() -> None:
            for number in next(batches, ()):
                stream.append(event_of("gate", number, number))
            stream.commit(max(stream.newest - 1, 0))

        while not is_over:
            try:
                outbox = outbox or Outbox(folder / "outbox")
                intake = Intake(folder, outbox, print)
                outbox.retarget({"a": EventFilter()})
                for _ in range(2):
                    write()
                    intake.look()
                    while (found := outbox.first("a")) is not None:
                        arrived.append(json.loads(found[1])["id"])
                        outbox.done("a", found[0])
                is_over = True
            except Killed:
                was_killed = True
                if outbox is not None:
                    outbox.close()
                outbox = None
        left = -1
        assert outbox is not None
        assert outbox.standing("a").waiting == 0
        outbox.close()
        return arrived, was_killed

    expected = [f"gate/{number}" for number in range(1, 7)]
    step, was_killed = 0, True
    while was_killed:
        step += 1
        left = step
        folder = tmp_path / str(step)
        folder.mkdir()
        arrived, was_killed = live(folder)
        assert list(dict.fromkeys(arrived)) == expected
        assert arrived == sorted(arrived)
        assert len(arrived) <= len(expected) + 1
    assert step > 30


def test_no_memory_is_shared_as_the_folder_may_be_on_a_network(tmp_path: Path) -> None:
    outbox = Outbox(tmp_path / "outbox")
    outbox.retarget({"a": EventFilter()})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["outbox", "outbox-wal"]
    with (
        closing(sqlite3.connect(tmp_path / "outbox", timeout=0)) as other,
        pytest.raises(sqlite3.OperationalError, match="locked"),
    ):
        other.execute("SELECT * FROM targets")
    outbox.close()


def test_what_a_full_disk_does_not_allow_is_done_later(tmp_path: Path) -> None:
    stream = Stream(tmp_path / "gate")
    outbox = Outbox(tmp_path / "outbox")
    said: list[str] = []
    intake = Intake(tmp_path, outbox, said.append)
    outbox.retarget({"a": EventFilter()})
    stream.append(event_of("gate", 1, "one"))

    def fill(pages: int) -> None:
        outbox._db.execute(f"PRAGMA max_page_count = {pages}")

    fill(1)
    stream.append(*(event_of("gate", number, f"{number}" * 500) for number in range(2, 60)))
    assert not intake.look()
    assert not intake.look()
    assert len(said) == 1
    assert "database or disk is full" in said[0]
    assert outbox.standing("a") == Standing(0, 0, 0)
    fill(100_000)
    assert intake.look()
    assert outbox.standing("a") == Standing(59, 0, 0)
    outbox.close()


@pytest.mark.parametrize("block", [1, 50, 300, 1 << 16])
def test_lines_behind_a_number_are_found_from_the_end(
    tmp_path: Path, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.events.intake._BLOCK", block)
    path = tmp_path / "events.jsonl"
    events = [{"number": number, "more": "x" * (number % 7 * 20)} for number in range(1, 40)]
    path.write_text("".join(json.dumps(event) + "\n" for event in events) + '{"number": 40')

    def numbers(behind: int) -> list[int]:
        return [json.loads(line)["number"] for line in lines_behind(path, behind)]

    for number in (0, 1, 17, 38, 39):
        found = numbers(number)
        assert found[-1] == 39
        assert found == list(range(found[0], 40))
        assert found[0] <= min(number + 1, 39)
    path.write_text("")
    assert numbers(3) == []


def test_an_event_that_comes_again_later_than_before_is_known(tmp_path: Path) -> None:
    stream = Stream(tmp_path / "gate")
    outbox = Outbox(tmp_path / "outbox")
    intake = Intake(tmp_path, outbox, print)
    outbox.retarget({"a": EventFilter()})
    once = event_of("gate", 1, "once")
    stream.append(once)
    intake.look()
    stream.replace([event_of("gate", number, number) for number in (1, 2, 3)])  # by other rules
    stream.commit(3)
    intake.look()
    stream.append(once | {"number": 4})
    intake.look()
    assert outbox.standing("a").waiting == 4
    outbox.close()


@pytest.mark.parametrize("at_work", [True, False])
def test_a_stream_that_gets_another_name_is_not_sent_again(tmp_path: Path, at_work: bool) -> None:
    lane = Stream(tmp_path / "lane")
    lane.append(*(event_of("lane", number, number) for number in range(1, 40)))
    lane.commit(30)
    outbox = Outbox(tmp_path / "outbox.sqlite")
    outbox.retarget({"hook": EventFilter()})
    Intake(tmp_path, outbox, print).look()
    for _ in range(5):
        found = outbox.first("hook")
        assert found is not None
        outbox.done("hook", found[0])
    if not at_work:
        outbox.close()
        outbox = Outbox(tmp_path / "outbox.sqlite")
    outbox.rename("lane", "road")
    (tmp_path / "lane").rename(tmp_path / "road")
    road = Stream.__new__(Stream)
    road.folder, road.final, road.ever, road.events = tmp_path / "road", 30, [], []
    intake = Intake(tmp_path, outbox, print)
    intake.look()
    assert outbox.standing("hook").waiting == 34
    road.append(event_of("road", 40, 40))
    intake.look()
    assert outbox.standing("hook").waiting == 35
    outbox.close()


def test_a_folder_that_cannot_be_listed_is_said_once_and_listed_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(path: Path, pattern: str) -> Any:
        raise OSError(errno.EIO, "Input/output error")

    stream = Stream(tmp_path / "gate")
    outbox = Outbox(tmp_path / "outbox")
    said: list[str] = []
    intake = Intake(tmp_path, outbox, said.append)
    outbox.retarget({"a": EventFilter()})
    stream.append(event_of("gate", 1, "one"))
    with monkeypatch.context() as patch:
        patch.setattr(Path, "glob", fails)
        assert [intake.look(), intake.look()] == [False, False]
    assert said == [f"Events of all streams wait: Input/output error ({tmp_path}). It is tried again."]
    assert intake.look()
    assert outbox.standing("a").waiting == 1
    outbox.close()


def test_a_filter_of_another_version_is_replaced_by_the_one_of_now(tmp_path: Path) -> None:
    stream = Stream(tmp_path / "gate")
    outbox = Outbox(tmp_path / "outbox")
    outbox.retarget({"a": EventFilter()})
    outbox._db.execute("""UPDATE targets SET wanted = '{"moods": ["born"]}'""")
    outbox._db.commit()
    outbox.close()
    stream.append(*(event_of("gate", number, number, kind) for number, kind in enumerate(KINDS, 1)))
    outbox = Outbox(tmp_path / "outbox")
    Intake(tmp_path, outbox, print).look()
    outbox.retarget({"a": EventFilter(kinds=("born", "left"))})
    assert outbox.standing("a").waiting == 2
    outbox.close()
