"""Who may publish: one at a time, whoever was away has lost it."""

from __future__ import annotations

from pathlib import Path

import pytest
from memory_store import MemoryStore

from mlbs_actors.errors import ConfigError
from orchestrator.object_storage import ledger as ledger_module
from orchestrator.object_storage.held_files import HeldFiles
from orchestrator.object_storage.ledger import FencedError, Ledger, await_holder, read_standing
from orchestrator.object_storage.manifest import MANIFESTS, OBJECTS, Manifest, Part, manifest_key
from orchestrator.object_storage.publisher import Publisher
from orchestrator.object_storage.store import StoreError

ONE, TWO = (Part("published/1.1/a", 0, 1, "00"),), (Part("published/1.2/a", 0, 2, "11"),)


def take(store: MemoryStore, me: str) -> Ledger:
    found = await_holder(store, me, "memory", lambda text: None, sleep=lambda seconds: None)
    return Ledger(store, found, me, "memory")


def test_a_holder_that_was_away_is_fenced_and_publishes_nothing_more(tmp_path: Path) -> None:
    store = MemoryStore()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "status.json").write_text("of the first")
    first = take(store, "first")
    held = HeldFiles(tmp_path / "run", tmp_path / "held")
    publisher = Publisher(store, first, held, "memory", lambda text: None, {})
    publisher.publish()
    second = take(store, "second")
    before = read_standing(store)
    (tmp_path / "run" / "status.json").write_text("of the first, later")
    for _ in range(2):
        with pytest.raises(FencedError):
            publisher.publish()
    assert read_standing(store) == before
    second.add({"b": TWO}, ())
    assert read_standing(store).owner == "second"
    assert read_standing(store).files["status.json"] == before.files["status.json"]
    first.close()
    second.close()


def test_a_dead_holder_is_waited_for_and_then_replaced() -> None:
    store, said, slept = MemoryStore(), list[str](), list[float]()
    first = take(store, "first")
    first.add({"a": ONE}, ())
    first.close()
    found = await_holder(store, "second", "s3://b/run", said.append, sleep=slept.append)
    assert found.files == {"a": ONE}
    assert sum(slept) == ledger_module.EXPIRY_SECONDS
    assert said == [
        "The run at s3://b/run was not ended by first; it is taken over unless something is published there "
        "within 30 s."
    ]


def test_a_holder_at_work_is_left_alone() -> None:
    store = MemoryStore()
    first = take(store, "first")

    def sleep(seconds: float) -> None:
        first.add({}, ())

    with pytest.raises(ConfigError, match=r"Another run is at work at s3://b/run \(first\)"):
        await_holder(store, "second", "s3://b/run", lambda text: None, sleep=sleep)
    first.close()


def test_nobody_waits_for_one_that_ended_nor_for_itself() -> None:
    store = MemoryStore()

    def never(seconds: float) -> None:
        raise AssertionError

    first = take(store, "first")
    assert await_holder(store, "first", "memory", print, never).owner == "first"
    first.add({}, (), ended=True)
    assert await_holder(store, "second", "memory", print, never).ended
    first.close()


def test_of_two_that_start_at_once_one_is_refused() -> None:
    store = MemoryStore()
    found = read_standing(store)
    first = Ledger(store, found, "first", "memory")
    with pytest.raises(ConfigError, match="Another run is at work at memory"):
        Ledger(store, found, "second", "memory")
    first.close()


def test_a_store_that_ignores_conditions_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    store = MemoryStore()

    def create(key: str, content: bytes) -> bool:
        store.put(key, content)
        return True

    monkeypatch.setattr(store, "create", create)
    with pytest.raises(ConfigError, match="knows no conditional writes"):
        take(store, "first")


def test_a_generation_of_which_nothing_was_heard_counts_once() -> None:
    store = MemoryStore()
    ledger = take(store, "first")

    def lose_the_answer(request: str) -> None:
        raise StoreError("timeout")

    store.after = lose_the_answer
    with pytest.raises(StoreError):
        ledger.add({"a": ONE}, ())
    store.be_there()
    ledger.add({"b": TWO}, ())
    assert read_standing(store).files == {"a": ONE, "b": TWO}
    assert read_standing(store).generation == 3
    store.after = lose_the_answer
    with pytest.raises(StoreError):
        ledger.add({}, ["a"])
    store.be_there()
    ledger.add({}, ["a"])
    assert read_standing(store).files == {"b": TWO}
    assert read_standing(store).generation == 4
    ledger.close()


def test_a_start_of_which_the_first_answer_was_lost_has_the_address(monkeypatch: pytest.MonkeyPatch) -> None:
    store, answers = MemoryStore(), list[bool]()
    create = store.create

    def ask_twice(key: str, content: bytes) -> bool:
        answers.append(create(key, content))
        return len(answers) > 1 and answers[-1]

    monkeypatch.setattr(store, "create", ask_twice)
    ledger = take(store, "first")
    assert answers == [True, False]
    assert read_standing(store).owner == "first"
    ledger.close()


def test_a_manifest_is_read_as_it_was_written() -> None:
    for manifest in (
        Manifest(1, 1, "me", False, 1),
        Manifest(3, 2, "me", True, 2, {"a": ONE + TWO}, ("b", "c")),
    ):
        assert Manifest.read(manifest.content()) == manifest


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_damaged_manifest_is_named(number: int) -> None:
    store = MemoryStore()
    ledger = take(store, "first")
    ledger.add({"a": ONE}, ())
    ledger.add({"b": TWO}, ())
    ledger.close()
    store.objects[manifest_key(number)] = b"{"
    with pytest.raises(StoreError, match=f"manifests/00000000000{number}.json cannot be read"):
        read_standing(store)


def test_deleting_many_of_many_files_compares_each_once() -> None:
    compared = [0]

    class Name(str):
        __slots__ = ()
        __hash__ = str.__hash__

        def __eq__(self, other: object) -> bool:
            compared[0] += 1
            return str.__eq__(self, other)

    ledger = take(MemoryStore(), "first")
    ledger.add({f"{number}": ONE for number in range(300)}, ())
    ledger.add({}, [Name(number) for number in range(200)])
    assert sorted(ledger.files) == [f"{number}" for number in range(200, 300)]
    assert compared[0] <= 400
    ledger.close()


def test_a_holder_with_nothing_to_publish_shows_that_it_is_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_module, "_LOOK_SECONDS", 0.01)
    monkeypatch.setattr(ledger_module, "BEAT_SECONDS", 0.02)
    store = MemoryStore()
    ledger = take(store, "first")
    while read_standing(store).generation < 4:
        assert not read_standing(store).ended
    ledger.close()


def test_what_counts_is_read_from_a_hundred_manifests_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_module, "_FULL_EVERY", 5)
    store = MemoryStore()
    ledger = take(store, "first")
    expected: dict[str, tuple[Part, ...]] = {}
    for number in range(1, 40):
        gone = [f"{number - 7}"] if number % 3 == 0 and number > 7 else []
        expected |= {f"{number}": ONE}
        for path in gone:
            expected.pop(path, None)
        ledger.add({f"{number}": ONE}, gone)
        assert read_standing(store).files == expected
        assert len(store.keys(MANIFESTS)) <= 10
    ledger.close()


def test_leftovers_are_objects_of_earlier_holders_that_nothing_names() -> None:
    store = MemoryStore()
    for key in ("1.1/a", "1.2/a", "7.1/x", "note", "1.3.tar", "1.3-2.tar"):
        store.put(f"{OBJECTS}/{key}", b"")
    first = take(store, "first")
    first.add({"a": ONE}, (), ended=True)
    first.close()
    second = take(store, "second")
    expected = ["manifests/000000000001.json", "manifests/000000000002.json"]
    expected += [f"{OBJECTS}/{key}" for key in ("1.2/a", "1.3-2.tar", "1.3.tar")]
    assert sorted(second.leftovers()) == sorted(expected)
    second.close()
