"""What happens before, beside and after a run whose output is an object store."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from memory_store import MemoryStore
from record_fakes import write_run, write_stream

from mlbs_actors.errors import ConfigError, SinkError
from orchestrator.command_line import parse
from orchestrator.events.delivery import OUTBOX, Deliveries
from orchestrator.events.outbox import Outbox
from orchestrator.interruption import StopAtOnce
from orchestrator.object_storage import ledger as ledger_module
from orchestrator.object_storage.fetching import fetch
from orchestrator.object_storage.ledger import Ledger, read_standing
from orchestrator.options import Arguments
from orchestrator.run import publication as publication_module
from orchestrator.run.publication import Publication
from orchestrator.run.run_folder import RunFolder
from orchestrator.run.stream_state import StreamState

ADDRESS = "s3://bucket/runs/one"


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> MemoryStore:
    """The store at every address."""
    store = MemoryStore()
    monkeypatch.setattr(publication_module, "open_store", lambda address: store)
    monkeypatch.setattr(publication_module, "_IMPATIENCE_SECONDS", 5.0)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    monkeypatch.setattr(os, "sync", lambda: None)
    monkeypatch.setattr(ledger_module, "_LOOK_SECONDS", 0.0)  # who is dead is not waited for long
    monkeypatch.setattr(ledger_module, "EXPIRY_SECONDS", 0.0)
    return store


def asked(disk: Path, *more: str) -> list[str]:
    return ["demo", "--output", ADDRESS, "--scratch", str(disk), *more]


def run(argv: list[str], work: Callable[[Arguments], None], *, start: bool = True) -> None:
    """A run that does this in its folder, where it publishes from the start."""
    with Publication() as publication:
        arguments = parse(argv, publication.begin)
        if start:
            publication.start({})
        work(arguments)


def ended(arguments: Arguments, *, interrupted: bool = False) -> None:
    state = write_stream(arguments.output / "street", frozenset({"masks", "parquet"}))
    if interrupted:
        state = StreamState("street", "partial", interrupted=True)
    write_run(arguments.output, [state])


def test_a_run_that_has_come_to_its_end_is_in_the_store_and_no_more_on_the_disk(
    store: MemoryStore, tmp_path: Path
) -> None:
    run(asked(tmp_path / "disk"), ended)
    assert not list((tmp_path / "disk").rglob("*.png"))
    fetch(store, tmp_path / "found")
    assert len(list((tmp_path / "found/street/masks").iterdir())) == 39
    assert read_standing(store).ended


def test_an_interrupted_run_stays_on_the_disk_and_goes_on_from_there(
    store: MemoryStore, tmp_path: Path
) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))
    store.requests.clear()

    def look(arguments: Arguments) -> None:
        assert (arguments.output / "street/masks/img000.png").exists()
        assert not [request for request in store.requests if request.startswith("get published")]

    run(asked(tmp_path / "disk", "--resume"), look)


def test_a_start_elsewhere_has_the_run_as_it_was_published(store: MemoryStore, tmp_path: Path) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))

    def look(arguments: Arguments) -> None:
        assert RunFolder(arguments.output).states()["street"].interrupted

    run(asked(tmp_path / "other", "--resume"), look)


def test_what_was_not_published_when_a_run_was_ended_at_once_is_still_there(
    store: MemoryStore, tmp_path: Path
) -> None:
    def die(arguments: Arguments) -> None:
        store.go_away()
        ended(arguments, interrupted=True)
        raise StopAtOnce(2)

    with pytest.raises(StopAtOnce):
        run(asked(tmp_path / "disk"), die)
    store.be_there()
    run(asked(tmp_path / "disk", "--resume"), lambda arguments: None)
    fetch(store, tmp_path / "found")
    assert (tmp_path / "found/street/masks/img000.png").exists()


def test_a_folder_that_somebody_else_has_gone_on_from_is_left_for_what_is_published(
    store: MemoryStore, tmp_path: Path
) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))

    def go_on(arguments: Arguments) -> None:
        (arguments.output / "report.html").write_text("of the other one")

    run(asked(tmp_path / "other", "--resume"), go_on)

    def look(arguments: Arguments) -> None:
        assert (arguments.output / "report.html").read_text() == "of the other one"

    run(asked(tmp_path / "disk", "--resume"), look)


def test_an_emptied_address_gets_the_run_that_is_still_on_the_disk(
    store: MemoryStore, tmp_path: Path
) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))
    store.objects.clear()
    run(asked(tmp_path / "disk", "--resume"), lambda arguments: None)
    fetch(store, tmp_path / "found")
    assert (tmp_path / "found/street/masks/img000.png").exists()


def test_a_folder_of_before_that_cannot_be_deleted_is_not_gone_on_with(
    store: MemoryStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))
    run(asked(tmp_path / "other", "--resume"), lambda arguments: None)
    before = dict(store.objects)

    def refuse(path: Path, target: Path) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(ConfigError, match=r"cannot be written to: Operation not permitted; .* --scratch"):
        run(asked(tmp_path / "disk", "--resume"), lambda arguments: None)
    assert store.objects == before


def test_a_folder_that_has_lost_its_run_is_refused_until_it_is_deleted(
    store: MemoryStore, tmp_path: Path
) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))
    (folder,) = (path.parent for path in (tmp_path / "disk").glob("*/run/street"))
    shutil.rmtree(folder / "street")
    with pytest.raises(ConfigError, match="has lost street"):
        run(asked(tmp_path / "disk", "--resume"), lambda arguments: None)
    shutil.rmtree(folder)
    run(asked(tmp_path / "disk", "--resume"), lambda arguments: None)
    fetch(store, tmp_path / "found")
    assert (tmp_path / "found/street/masks/img000.png").exists()


def test_what_a_kill_left_of_fetching_and_deleting_goes(store: MemoryStore, tmp_path: Path) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))
    (place,) = (path.parent for path in (tmp_path / "disk").glob("*/run"))
    for name in (".run.k3x.part", "gone"):
        shutil.copytree(place / "run", place / name)
    run(asked(tmp_path / "disk", "--resume"), lambda arguments: None)
    assert sorted(path.name for path in place.iterdir()) == [".lock", "holder", "run"]


def test_a_holder_of_which_a_power_cut_left_nothing_is_made_anew(store: MemoryStore, tmp_path: Path) -> None:
    run(asked(tmp_path / "disk"), lambda arguments: ended(arguments, interrupted=True))
    (holder,) = (tmp_path / "disk").glob("*/holder")
    holder.write_bytes(b"")
    run(asked(tmp_path / "disk", "--resume"), lambda arguments: None)
    assert read_standing(store).owner == holder.read_text() != ""


def test_an_address_that_holds_a_run_is_refused_without_resume(store: MemoryStore, tmp_path: Path) -> None:
    run(asked(tmp_path / "disk"), ended)
    before = dict(store.objects)
    with pytest.raises(
        ConfigError, match=f"{ADDRESS} holds a run already; .* continue that run with --resume"
    ):
        run(asked(tmp_path / "other"), ended)
    assert store.objects == before


def test_a_run_that_cannot_begin_lets_the_address_go(store: MemoryStore, tmp_path: Path) -> None:
    def fail(arguments: Arguments) -> None:
        assert not read_standing(store).ended
        raise ConfigError("no list")

    with pytest.raises(ConfigError, match="no list"):
        run(asked(tmp_path / "disk"), fail, start=False)
    assert read_standing(store).ended


def test_a_store_that_cannot_be_reached_at_the_start_is_said(store: MemoryStore, tmp_path: Path) -> None:
    store.go_away()
    with pytest.raises(ConfigError, match=f"--output {ADDRESS} cannot be used: no route to the store"):
        run(asked(tmp_path / "disk"), ended)


def test_a_second_run_on_the_same_machine_is_refused(store: MemoryStore, tmp_path: Path) -> None:
    def start_another(arguments: Arguments) -> None:
        with pytest.raises(ConfigError, match=f"Another run is at work at {ADDRESS}"):
            run(asked(tmp_path / "disk", "--resume"), ended)

    run(asked(tmp_path / "disk"), start_another)


def test_a_run_that_was_taken_over_ends(store: MemoryStore, tmp_path: Path) -> None:
    others = []

    def be_taken_over(arguments: Arguments) -> None:
        others.append(Ledger(store, read_standing(store), "other", ADDRESS))
        ended(arguments)

    with pytest.raises(SinkError, match=f"Another run has taken {ADDRESS} over"):
        run(asked(tmp_path / "disk"), be_taken_over)
    assert "run.json" not in read_standing(store).files
    others[0].close()


def test_a_folder_as_output_has_nothing_to_do_with_it(tmp_path: Path) -> None:
    with Publication() as publication:
        parse(["demo", "--output", str(tmp_path / "out")], publication.begin)
        publication.start({})
        publication.update(())
        assert publication.figures is None
    assert not any(tmp_path.iterdir())


def test_zones_of_before_hold_on_elsewhere(store: MemoryStore, tmp_path: Path) -> None:
    def keep(arguments: Arguments) -> None:
        ended(arguments, interrupted=True)
        (arguments.output / "zones-0001.yaml").write_text("streams:\n  street:\n    zones: []\n")

    run(asked(tmp_path / "disk"), keep)
    with Publication() as publication:
        arguments = parse(asked(tmp_path / "other", "--resume"), publication.begin)
    assert "The zones of before hold on" in (arguments.zones.fault or "")


def test_the_outbox_is_copied_whether_it_is_in_use_or_not(tmp_path: Path) -> None:
    deliveries = Deliveries((), tmp_path, print)
    assert not deliveries.copy_outbox(tmp_path / "none")
    Outbox(tmp_path / OUTBOX).close()
    with deliveries:
        assert deliveries.copy_outbox(tmp_path / "in use")
    assert deliveries.copy_outbox(tmp_path / "closed")
    for name in ("in use", "closed"):
        Outbox(tmp_path / name).close()
    (tmp_path / OUTBOX).write_bytes(b"no database, however long it is, and this is long enough" * 90)
    with pytest.raises(OSError, match="cannot be copied"):
        deliveries.copy_outbox(tmp_path / "damaged")
