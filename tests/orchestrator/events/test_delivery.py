"""Events on their way to targets that are away, refuse some, come and go; and a run that is killed."""

from __future__ import annotations

import json
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
from mosquitto import Mosquitto
from record_fakes import frame, segmentation

from chaos.harness.webhook import Webhook
from mlbs_actors.errors import ConfigError
from orchestrator.events import carrier as carrier_module
from orchestrator.events import delivery as delivery_module
from orchestrator.events import mqtt as mqtt_module
from orchestrator.events import senders as senders_module
from orchestrator.events.delivery import OUTBOX, Deliveries
from orchestrator.events.event import EventKind
from orchestrator.events.event_filter import EventFilter
from orchestrator.events.home_assistant import Camera
from orchestrator.events.outbox import Outbox
from orchestrator.events.senders import RefusedEventError
from orchestrator.events.targets import EventTarget, parse_target
from orchestrator.events.zones import EventRules, Zone
from orchestrator.sinks.record import StreamRecord

ALL = EventFilter(kinds=get_args(EventKind))
EVERYWHERE = Zone(name="yard", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))


@pytest.fixture
def webhook() -> Iterator[Webhook]:
    server = Webhook()
    yield server
    server.stop()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(carrier_module, "retry_seconds", lambda failures: 0.02)
    # However busy the machine is, what is there answers in time.
    monkeypatch.setattr(delivery_module, "_GRACE_SECONDS", 200.0)
    for module in (senders_module, mqtt_module):
        monkeypatch.setattr(module, "ANSWER_SECONDS", 200.0)


def target_of(url: str, wanted: EventFilter = ALL) -> EventTarget:
    return replace(parse_target(url), wanted=wanted)


def write(record: StreamRecord, begin: int, end: int) -> None:
    """Object 5 comes and goes."""
    for index in range(begin, end):
        record.write(segmentation(index, 3, *([5] if index // 5 % 2 else [])), frame(index))


def recorded(folder: Path, *zones: Zone, name: str = "gate") -> StreamRecord:
    return StreamRecord(folder / name, name, frozenset(), rules=EventRules(zones))


def events(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def ids(folder: Path) -> list[object]:
    return [event["id"] for event in events(folder)]


def wait_until(there: Callable[[], bool]) -> None:
    while not there():
        time.sleep(0.01)


def test_every_event_arrives_once_and_in_order_though_the_webhook_is_away(
    tmp_path: Path, webhook: Webhook
) -> None:
    said: list[str] = []
    gate = recorded(tmp_path)
    with Deliveries([target_of(webhook.url)], tmp_path, said.append) as deliveries:
        write(gate, 0, 20)
        wait_until(lambda: webhook.ids == ids(tmp_path / "gate"))  # live, before a commit
        webhook.away = True
        began = time.time()
        write(gate, 20, 70)  # which waits for no answer, or it would not return
        wait_until(lambda: bool(said))
        wait_until(lambda: deliveries.backlogs()[0].waiting == len(ids(tmp_path / "gate")) - len(webhook.ids))
        [backlog] = deliveries.backlogs()
        assert backlog.waiting > 0
        assert 0 < backlog.away_seconds < time.time() - began
        assert "hook" not in backlog.target
        webhook.away = False
        write(gate, 70, 90)
        gate.close(whole=True)
    [backlog] = deliveries.backlogs()
    assert (backlog.waiting, backlog.away_since) == (0, None)
    assert webhook.ids == ids(tmp_path / "gate")
    assert len(set(webhook.ids)) == len(webhook.ids) > 20
    assert said[0].endswith("it answers 503 Service Unavailable. It is tried again.")
    assert said[1:] == [f"Events are delivered to {backlog.target} again."]


def test_an_event_that_a_webhook_refuses_is_set_aside_and_the_others_arrive(
    tmp_path: Path, webhook: Webhook
) -> None:
    said: list[str] = []
    webhook.refused = {5}
    gate = recorded(tmp_path)
    with Deliveries([target_of(webhook.url)], tmp_path, said.append) as deliveries:
        write(gate, 0, 60)
        gate.close(whole=True)
    lines = [json.loads(line) for line in (tmp_path / "events-refused.jsonl").read_text().splitlines()]
    aside = [line["event"]["id"] for line in lines]
    assert sorted([*webhook.ids, *aside]) == sorted(map(str, ids(tmp_path / "gate")))
    assert webhook.ids == [one for one in ids(tmp_path / "gate") if one not in aside]
    assert len(aside) > 2
    assert {line["event"]["object"] for line in lines} == {5}
    assert all(line["answer"].startswith("it answers 422 ") for line in lines)
    assert len(said) == 1
    assert "refuses an event: it answers 422 Unprocessable" in said[0]
    assert "It is set aside" in said[0]
    [backlog] = deliveries.backlogs()
    assert (backlog.waiting, backlog.away_since, backlog.refused) == (0, None, len(aside))
    with Deliveries([target_of(webhook.url)], tmp_path, said.append) as again:
        assert again.backlogs()[0].refused == len(aside)  # they count after a restart, too


def test_an_event_that_is_bad_waits_until_others_have_been_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Bad(senders_module.Webhook):
        """Accepts nothing, then some."""

        asked, accepts = 0, False

        def send(self, event: bytes) -> None:
            Bad.asked += 1
            if not Bad.accepts or json.loads(event)["object"] == 5:
                raise RefusedEventError("it answers 400 Bad Request", is_certain=False)

    monkeypatch.setattr(carrier_module, "Webhook", Bad)
    gate = recorded(tmp_path)
    with Deliveries([target_of("http://host/hook")], tmp_path, print) as deliveries:
        write(gate, 0, 20)
        gate.close(whole=True)
        wait_until(lambda: Bad.asked > 2)
        assert deliveries.backlogs()[0].refused == 0
        Bad.accepts = True
    [backlog] = deliveries.backlogs()
    assert backlog.waiting == 0
    assert backlog.refused > 0


def test_targets_that_look_alike_without_their_secrets_have_names_of_their_own(tmp_path: Path) -> None:
    urls = ["http://bob:1@127.0.0.1:9/one", "http://127.0.0.1:9/", "http://bob:2@127.0.0.1:9/two"]
    with Deliveries([parse_target(url) for url in urls], tmp_path, print) as deliveries:
        assert len({backlog.target for backlog in deliveries.backlogs()}) == 3


def test_a_line_that_is_just_replaced_is_no_backlog(tmp_path: Path, webhook: Webhook) -> None:
    (tmp_path / "gate").mkdir()
    file = tmp_path / "gate/events.jsonl"
    file.write_bytes(b'{"id": "a", "num{"id": "b", "number": 2}\n')
    with Deliveries([target_of(webhook.url)], tmp_path, print) as deliveries:
        assert deliveries.backlogs()[0].waiting == 0
        file.write_bytes(b'{"id": "a", "number": 1, "kind": "born", "stream": "gate"}\n')
        wait_until(lambda: webhook.ids == ["a"])


def test_a_run_that_is_resumed_goes_on_where_the_target_was(
    tmp_path: Path, webhook: Webhook, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    url, port = webhook.url, webhook.server_address[1]
    gate = recorded(tmp_path)
    with Deliveries([target_of(url)], tmp_path, said.append):
        write(gate, 0, 40)
    first = webhook.ids
    assert first == ids(tmp_path / "gate")
    webhook.stop()
    # Killed, and opened again: the lines after the last commit come again, with the same ids.
    again = recorded(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(delivery_module, "_GRACE_SECONDS", 0.1)
        with Deliveries([target_of(url)], tmp_path, said.append) as deliveries:
            write(again, 0, 90)
            again.close(whole=True)
    left = len(ids(tmp_path / "gate")) - len(first)
    assert deliveries.backlogs()[0].waiting == left
    assert said[-1].startswith(f"{left} events could not be delivered to http://127.0.0.1:{port}/***")
    late = Webhook(port)
    with Deliveries([target_of(url)], tmp_path, said.append):
        wait_until(lambda: len(late.events) == left)
    late.stop()
    assert [*first, *late.ids] == ids(tmp_path / "gate")


def test_births_and_what_only_hides_are_written_and_not_sent_unless_they_are_asked_for(
    tmp_path: Path, webhook: Webhook
) -> None:
    gate = recorded(tmp_path, EVERYWHERE)
    targets = [parse_target(webhook.url), target_of(f"{webhook.url}/born", EventFilter(kinds=("born",)))]
    with Deliveries(targets, tmp_path, print) as deliveries:
        write(gate, 0, 60)
        gate.close(whole=True)
    kinds = [event["kind"] for event in events(tmp_path / "gate")]
    assert {"born", "hidden", "back", "ended", "entered", "left"} <= set(kinds)
    sent = [event["kind"] for event in webhook.events]
    assert set(sent) == {"entered", "left", "camera moving", "born"}
    assert len(sent) == sum(kinds.count(kind) for kind in set(sent))
    assert [backlog.waiting for backlog in deliveries.backlogs()] == [0, 0]


def test_targets_can_be_replaced_while_a_run_goes_on(tmp_path: Path) -> None:
    stays, goes, comes = Webhook(), Webhook(), Webhook()
    goes.away = True
    gate = recorded(tmp_path)
    said: list[str] = []
    with Deliveries([target_of(stays.url), target_of(goes.url)], tmp_path, said.append) as deliveries:
        write(gate, 0, 40)
        wait_until(lambda: stays.ids == ids(tmp_path / "gate") and bool(said))
        first, stays.away = len(stays.ids), True
        write(gate, 40, 60)
        births = EventFilter(kinds=("born", "hidden"))
        deliveries.retarget([target_of(stays.url, births), target_of(comes.url)])
        goes.away = stays.away = False
        second = len(ids(tmp_path / "gate"))
        write(gate, 60, 90)
        gate.close(whole=True)
        wait_until(lambda: comes.ids == ids(tmp_path / "gate")[second:])
        assert len(deliveries.backlogs()) == 2
    assert len(goes.ids) <= 1  # what was on its way
    behind = [event["id"] for event in events(tmp_path / "gate")[first:] if births.wants(event)]
    assert stays.ids[first:] == behind
    assert len(behind) < second - first + len(comes.ids)
    for server in (stays, goes, comes):
        server.stop()


def test_a_corrected_password_is_taken_up_at_once_and_nothing_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(carrier_module, "retry_seconds", lambda failures: 1e6)
    broker = Mosquitto(tmp_path)
    gate, said = recorded(tmp_path), list[str]()
    with Deliveries([target_of(broker.url.replace("s3cret", "old"))], tmp_path, said.append) as deliveries:
        write(gate, 0, 20)
        wait_until(lambda: bool(said))
        assert "Not authorized" in said[0]
        deliveries.retarget([target_of(broker.url)])
        gate.close(whole=True)
    assert deliveries.backlogs()[0].waiting == 0
    assert said[1:] == [f"Events are delivered to {deliveries.backlogs()[0].target} again."]
    assert "s3cret" not in " ".join(said)
    broker.end()


def test_a_real_broker_gets_every_event_by_tls_though_it_was_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mqtt = pytest.importorskip("paho.mqtt.client")
    broker = Mosquitto(tmp_path, tls=True)
    monkeypatch.setenv("SSL_CERT_FILE", str(broker.certificate))
    received: list[str] = []
    subscriber = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, "subscriber", clean_session=False)
    subscriber.username_pw_set("bob", "s3cret")
    subscriber.tls_set(str(broker.certificate))
    subscriber.reconnect_delay_set(0.1, 0.1)
    subscriber.on_connect = lambda client, *_: client.subscribe("yard/events", qos=1)
    subscriber.on_message = lambda _, __, message: received.append(json.loads(message.payload)["id"])
    subscriber.connect("127.0.0.1", broker.port)
    subscriber.loop_start()
    said: list[str] = []
    gate = recorded(tmp_path)
    with Deliveries([target_of(broker.url)], tmp_path, said.append):
        write(gate, 0, 20)
        wait_until(lambda: received == ids(tmp_path / "gate"))
        broker.end()
        write(gate, 20, 60)
        wait_until(lambda: bool(said))
        broker.begin()
        gate.close(whole=True)
        wait_until(lambda: len(received) >= len(ids(tmp_path / "gate")))
    subscriber.disconnect()
    subscriber.loop_stop()
    broker.end()
    assert list(dict.fromkeys(received)) == ids(tmp_path / "gate")
    assert "s3cret" not in " ".join(said)


def test_a_run_without_targets_keeps_no_outbox_and_a_later_one_sends_what_happens_from_then_on(
    tmp_path: Path, webhook: Webhook
) -> None:
    gate = recorded(tmp_path)
    with Deliveries([], tmp_path, print) as deliveries:
        write(gate, 0, 40)
        assert deliveries.backlogs() == []
        assert not (tmp_path / OUTBOX).exists()
        deliveries.retarget([target_of(webhook.url)])
        first = len(ids(tmp_path / "gate"))
        gate.close(whole=True)
    assert webhook.ids == ids(tmp_path / "gate")[first:]
    assert webhook.ids


def test_an_event_has_the_addresses_of_its_picture_and_clip(tmp_path: Path, webhook: Webhook) -> None:
    folder = tmp_path / "north gate"
    folder.mkdir()
    line = {"id": "a", "stream": "north gate", "kind": "entered", "number": 1}
    files = {"picture": "events/00000032-1.jpg", "clip": "clips/00000032.mp4"}
    lines = [line | files, line | {"id": "b", "number": 2, "picture": None}]
    with Deliveries([target_of(webhook.url)], tmp_path, print, page="http://yard:9464/cameras/"):
        (folder / "events.jsonl").write_text("".join(json.dumps(one) + "\n" for one in lines))
    records = "http://yard:9464/cameras/records/north%20gate"
    assert webhook.events[0]["picture_url"] == f"{records}/events/00000032-1.jpg"
    assert webhook.events[0]["clip_url"] == f"{records}/clips/00000032.mp4"
    assert not {"picture_url", "clip_url"} & webhook.events[1].keys()


def test_a_thousand_events_a_minute_wait_and_arrive_in_order(tmp_path: Path, webhook: Webhook) -> None:
    """Three cameras' minute, at once: nothing is lost or twice, and each stream is in order."""
    webhook.away = True
    with Deliveries([target_of(webhook.url)], tmp_path, print) as deliveries:
        for stream in ("a", "b", "c"):
            (tmp_path / stream).mkdir()
        for number in range(1, 335):
            for stream in ("a", "b", "c"):
                event = {"id": f"{stream}/{number}", "stream": stream, "kind": "crossed", "number": number}
                with (tmp_path / stream / "events.jsonl").open("a") as file:
                    file.write(json.dumps(event) + "\n")
        wait_until(lambda: deliveries.backlogs()[0].waiting == 1002)
        webhook.away = False
    for stream in ("a", "b", "c"):
        arrived = [one for one in webhook.ids if one.startswith(stream)]
        assert arrived == [f"{stream}/{number}" for number in range(1, 335)]


def test_a_damaged_outbox_is_put_aside_and_the_run_goes_on(tmp_path: Path, webhook: Webhook) -> None:
    (tmp_path / OUTBOX).write_bytes(b"no database at all " * 1000)
    said: list[str] = []
    gate = recorded(tmp_path)
    with Deliveries([target_of(webhook.url)], tmp_path, said.append):
        write(gate, 0, 20)
        gate.close(whole=True)
    assert webhook.ids == ids(tmp_path / "gate")
    assert "is damaged and was renamed" in said[0]
    (tmp_path / OUTBOX).unlink()
    (tmp_path / OUTBOX).mkdir()
    with (
        pytest.raises(ConfigError, match="cannot be used"),
        Deliveries([parse_target(webhook.url)], tmp_path, print),
    ):
        pass


PROGRAM = """
import sys
from pathlib import Path
from orchestrator.events import carrier
from orchestrator.events.delivery import Deliveries
from orchestrator.events.targets import parse_target
carrier.retry_seconds = lambda failures: 0.02
with Deliveries([parse_target(sys.argv[2])], Path(sys.argv[1]), print):
    sys.stdin.read()
"""


class Killer(Webhook):
    """Kills who has sent it so many events, as soon as the last of them is answered."""

    def __init__(self) -> None:
        self.victim: subprocess.Popen[bytes] | None = None
        self.events_left = 0
        super().__init__()

    def shutdown_request(self, request: Any) -> None:
        """Close the connection of an event that was answered."""
        super().shutdown_request(request)
        self.events_left -= 1
        if self.victim is not None and self.events_left == 0:
            self.victim.send_signal(signal.SIGKILL)


def test_a_kill_just_after_an_answer_loses_nothing_and_repeats_that_event_at_most(tmp_path: Path) -> None:
    server, number, kills = Killer(), 0, (1, 4, 9, 2)
    folder = tmp_path / "gate"
    folder.mkdir()
    with Deliveries([parse_target(server.url)], tmp_path, print):
        pass  # from now on events are for it
    for server.events_left in kills:
        command = [sys.executable, "-c", PROGRAM, str(tmp_path), server.url]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as server.victim:
            for _ in range(10):
                number += 1
                event = {"id": f"{number:03}", "stream": "gate", "kind": "crossed", "number": number}
                with (folder / "events.jsonl").open("a") as file:
                    file.write(json.dumps(event) + "\n")
            assert server.victim.wait() == -signal.SIGKILL
    server.victim = None
    with Deliveries([parse_target(server.url)], tmp_path, print):
        pass
    server.stop()
    assert list(dict.fromkeys(server.ids)) == [f"{one:03}" for one in range(1, number + 1)]
    assert server.ids == sorted(server.ids)  # what comes again comes at once
    assert len(server.ids) - number <= len(kills)


def test_an_end_waits_for_all_targets_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delivery_module, "_GRACE_SECONDS", 0.2)
    away = [Webhook() for _ in range(3)]
    for server in away:
        server.away = True
    gate, said = recorded(tmp_path), list[str]()
    with Deliveries([target_of(server.url) for server in away], tmp_path, said.append):
        write(gate, 0, 20)
    assert sum("could not be delivered" in words for words in said) == 3
    for server in away:
        server.stop()


def test_a_disk_that_is_gone_leaves_the_figures_as_they_were(
    tmp_path: Path, webhook: Webhook, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    webhook.away = True
    gate = recorded(tmp_path)
    with Deliveries([target_of(webhook.url)], tmp_path, print) as deliveries:
        write(gate, 0, 20)
        wait_until(lambda: deliveries.backlogs()[0].waiting == len(ids(tmp_path / "gate")))
        with monkeypatch.context() as patch:
            patch.setattr(Outbox, "standing", gone)
            assert deliveries.backlogs()[0].waiting == len(ids(tmp_path / "gate"))
        webhook.away = False


def test_a_disk_that_is_full_at_the_start_is_reported_with_what_to_do(
    tmp_path: Path, webhook: Webhook, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    deliveries = Deliveries([target_of(webhook.url)], tmp_path, print)
    with monkeypatch.context() as patch:
        patch.setattr(Outbox, "retarget", full)
        with pytest.raises(ConfigError, match=r"database or disk is full.* has room"), deliveries:
            pass
    with Deliveries([target_of(webhook.url)], tmp_path, print):
        pass  # the one before has let the outbox go


@pytest.mark.parametrize("at_work", [True, False])
def test_a_stream_that_cannot_be_renamed_is_not_sent_again(
    tmp_path: Path, webhook: Webhook, at_work: bool
) -> None:
    gate = recorded(tmp_path)
    (tmp_path / "road").write_bytes(b"in the way")
    targets = [target_of(webhook.url)]
    with Deliveries(targets, tmp_path, print) as deliveries:
        write(gate, 0, 20)
        wait_until(lambda: webhook.ids == ids(tmp_path / "gate"))
        if at_work:
            with pytest.raises(NotADirectoryError):
                deliveries.rename("gate", "road")
    if not at_work:
        deliveries = Deliveries(None, tmp_path, print)
        with pytest.raises(NotADirectoryError):
            deliveries.rename("gate", "road")
    with Deliveries(targets, tmp_path, print):
        write(gate, 20, 60)
        gate.close(whole=True)
    assert webhook.ids == ids(tmp_path / "gate")


class Slow:
    """A sender whose events take until they are let go; ``held`` is what its broker holds."""

    asked, let_go = threading.Event(), threading.Event()
    held: dict[str, bytes]

    def __init__(self, *_: object) -> None:
        self.told: dict[str, bytes] = {}

    def send(self, event: bytes) -> None:
        Slow.asked.set()
        Slow.let_go.wait()

    def hold(self, messages: Mapping[str, bytes]) -> None:
        for topic in self.told.keys() - messages.keys():
            Slow.held.pop(topic, None)
        Slow.held |= messages.items() - self.told.items()
        self.told = dict(messages)

    def close(self) -> None:
        pass


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> type[Slow]:
    Slow.asked.clear()
    Slow.let_go.clear()
    Slow.held = {}
    for name in ("Mqtt", "Webhook"):
        monkeypatch.setattr(carrier_module, name, Slow)
    return Slow


def test_an_answer_that_comes_after_the_end_is_no_fault(
    tmp_path: Path, slow: type[Slow], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(delivery_module, "_GRACE_SECONDS", 0.05)
    said: list[str] = []
    gate = recorded(tmp_path)
    with Deliveries([target_of("http://host/hook")], tmp_path, said.append) as deliveries:
        write(gate, 0, 20)
        slow.asked.wait()
        [carrier] = deliveries._carriers.values()
    slow.let_go.set()
    carrier._thread.join()
    assert len(said) == 1
    assert "could not be delivered" in said[0]


def test_a_target_that_comes_back_while_it_is_sent_to_keeps_what_it_is_told(
    tmp_path: Path, slow: type[Slow]
) -> None:
    target = replace(target_of("mqtt://host/yard"), home_assistant="homeassistant")
    gate = recorded(tmp_path)
    cameras = [Camera("gate", ("yard",))]
    with Deliveries([target], tmp_path, print, cameras=lambda: cameras) as deliveries:
        write(gate, 0, 20)
        slow.asked.wait()
        deliveries.retarget([])
        deliveries.retarget([target])
        time.sleep(0.2)  # for one that would not wait
        slow.let_go.set()
        gate.close(whole=True)
    assert any(topic.endswith("/config") for topic in slow.held)
