"""Events on their way to a webhook or a broker that is away for a while."""

from __future__ import annotations

import base64
import json
import os
import pwd
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from record_fakes import frame, segmentation

from chaos.harness.broker import Broker
from chaos.harness.webhook import Webhook
from mlbs_actors.errors import ConfigError
from orchestrator.command_line import command_again, parse
from orchestrator.credentials import PASSWORD_VARIABLE
from orchestrator.events import delivery as delivery_module
from orchestrator.events import targets as targets_module
from orchestrator.events.delivery import Deliveries
from orchestrator.events.targets import (
    DeliveryError,
    EventTarget,
    RefusedEventError,
    open_sender,
    parse_target,
)
from orchestrator.sinks.record import StreamRecord


@pytest.fixture
def webhook() -> Iterator[Webhook]:
    server = Webhook()
    yield server
    server.stop()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delivery_module, "retry_seconds", lambda failures: 0.02)
    # However busy the machine is, what is there answers in time.
    monkeypatch.setattr(delivery_module, "_GRACE_SECONDS", 200.0)
    monkeypatch.setattr(targets_module, "_ANSWER_SECONDS", 200.0)


def write(record: StreamRecord, begin: int, end: int) -> None:
    """Object 5 comes and goes."""
    for index in range(begin, end):
        record.write(segmentation(index, 3, *([5] if index // 5 % 2 else [])), frame(index))


def ids(folder: Path) -> list[str]:
    return [json.loads(line)["id"] for line in (folder / "events.jsonl").read_text().splitlines()]


def wait_until(there: Callable[[], bool]) -> None:
    while not there():
        time.sleep(0.01)


def test_every_event_arrives_once_and_in_order_though_the_webhook_is_away(
    tmp_path: Path, webhook: Webhook
) -> None:
    said: list[str] = []
    gate = StreamRecord(tmp_path / "gate", "gate", frozenset())
    with Deliveries([parse_target(webhook.url)], tmp_path, said.append) as deliveries:
        write(gate, 0, 20)
        wait_until(lambda: webhook.ids == ids(tmp_path / "gate"))  # live, before a commit
        webhook.away = True
        began = time.time()
        write(gate, 20, 70)  # which waits for no answer, or it would not return
        wait_until(lambda: bool(said))
        [backlog] = deliveries.backlogs()
        assert backlog.waiting == len(ids(tmp_path / "gate")) - len(webhook.ids) > 0
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
    assert said[1:] == ["Events are delivered to http://127.0.0.1:" + said[1].split(":")[2]]


def test_an_event_that_a_webhook_refuses_is_set_aside_and_the_others_arrive(
    tmp_path: Path, webhook: Webhook
) -> None:
    said: list[str] = []
    webhook.refused = {5}
    gate = StreamRecord(tmp_path / "gate", "gate", frozenset())
    with Deliveries([parse_target(webhook.url)], tmp_path, said.append) as deliveries:
        write(gate, 0, 60)
        gate.close(whole=True)
    lines = [json.loads(line) for line in (tmp_path / "events-refused.jsonl").read_text().splitlines()]
    aside = [line["event"]["id"] for line in lines]
    assert sorted([*webhook.ids, *aside]) == sorted(ids(tmp_path / "gate"))
    assert webhook.ids == [one for one in ids(tmp_path / "gate") if one not in aside]
    assert len(aside) > 2
    assert {line["event"]["object"] for line in lines} == {5}
    assert all(line["answer"].startswith("it answers 422 ") for line in lines)
    assert len(said) == 1
    assert "refuses an event: it answers 422 Unprocessable" in said[0]
    assert "It is set aside" in said[0]
    [backlog] = deliveries.backlogs()
    assert (backlog.waiting, backlog.away_since, backlog.refused) == (0, None, len(aside))
    with Deliveries([parse_target(webhook.url)], tmp_path, said.append) as again:
        assert again.backlogs()[0].refused == len(aside)  # they count after a restart, too


def test_an_event_that_is_bad_waits_until_others_have_been_accepted(tmp_path: Path) -> None:
    class Bad:
        """Accepts nothing, then some."""

        asked, accepts = 0, False

        def send(self, event: bytes) -> None:
            self.asked += 1
            if not self.accepts or json.loads(event)["object"] == 5:
                raise RefusedEventError("it answers 400 Bad Request", is_certain=False)

        def close(self) -> None:
            return

    sender, said = Bad(), list[str]()
    delivery = delivery_module.Delivery("hook", "key", lambda: sender, tmp_path, said.append)
    gate = StreamRecord(tmp_path / "gate", "gate", frozenset())
    delivery.start()
    write(gate, 0, 20)
    gate.close(whole=True)
    wait_until(lambda: sender.asked > 2)
    assert delivery.backlog().refused == 0
    (tmp_path / "events-refused.jsonl").write_text('{"target": "ho')  # torn by a full disk
    sender.accepts = True
    delivery.close()
    assert delivery.backlog().waiting == 0
    assert delivery.backlog().refused > 0
    again = delivery_module.Delivery("hook", "key", lambda: sender, tmp_path, said.append)
    again.start()
    again.close()
    assert again.backlog().waiting == 0


def test_a_webhook_on_this_machine_is_not_asked_for_at_the_proxy(
    webhook: Webhook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9/")
    monkeypatch.delenv("no_proxy", raising=False)
    open_sender(parse_target(webhook.url)).send(b'{"id": "a"}')
    assert webhook.ids == ["a"]


def test_targets_that_look_alike_without_their_secrets_have_names_of_their_own(tmp_path: Path) -> None:
    urls = ["http://bob:1@host/one", "http://host:80/", "http://bob:2@host/two"]
    deliveries = Deliveries([parse_target(url) for url in urls], tmp_path, print)
    assert len({backlog.target for backlog in deliveries.backlogs()}) == 3


def test_a_line_that_is_just_replaced_is_no_backlog(tmp_path: Path, webhook: Webhook) -> None:
    (tmp_path / "gate").mkdir()
    (tmp_path / "gate/events.jsonl").write_bytes(b'{"id": "a", "num{"id": "b", "number": 2}\n')
    [backlog] = Deliveries([parse_target(webhook.url)], tmp_path, print).backlogs()
    assert backlog.waiting == 0


def test_a_run_that_is_resumed_goes_on_where_the_target_was(
    tmp_path: Path, webhook: Webhook, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    url, port = webhook.url, webhook.server_address[1]
    gate = StreamRecord(tmp_path / "gate", "gate", frozenset())
    with Deliveries([parse_target(url)], tmp_path, said.append):
        write(gate, 0, 40)
    first = webhook.ids
    assert first == ids(tmp_path / "gate")
    webhook.stop()
    # Killed, and opened again: the lines after the last commit come again, with the same ids.
    again = StreamRecord(tmp_path / "gate", "gate", frozenset())
    with monkeypatch.context() as patch:
        patch.setattr(delivery_module, "_GRACE_SECONDS", 0.1)
        with Deliveries([parse_target(url)], tmp_path, said.append) as deliveries:
            write(again, 0, 90)
            again.close(whole=True)
    left = len(ids(tmp_path / "gate")) - len(first)
    assert deliveries.backlogs()[0].waiting == left
    assert said[-1].startswith(f"{left} events could not be delivered to http://127.0.0.1:{port}/***")
    late = Webhook(port)
    with Deliveries([parse_target(url)], tmp_path, said.append):
        wait_until(lambda: len(late.events) == left)
    late.stop()
    assert [*first, *late.ids] == ids(tmp_path / "gate")
    [position] = tmp_path.glob(".delivered-*.json")
    assert json.loads(position.read_text()) == {"gate": {"number": len(first) + left, "ids": {}}}


def test_a_password_is_sent_and_shown_nowhere(
    tmp_path: Path, webhook: Webhook, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = webhook.url.replace("http://", "http://bob:s3cr%40t@").replace(
        "/hook", "/api/webhook/hidden?token=k"
    )
    target = parse_target(url)
    open_sender(target).send(b'{"id": "1"}')
    assert webhook.headers[0]["Authorization"] == f"Basic {base64.b64encode(b'bob:s3cr@t').decode()}"
    arguments = parse(["demo", "--events", url])
    shown = f"{target!r} {target.shown} {arguments!r} {command_again(arguments, 'out')}"
    assert not any(secret in shown for secret in ("s3cr", "hidden", "token=k"))
    monkeypatch.setenv(PASSWORD_VARIABLE, "from outside")
    assert parse_target("http://bob@host/x").password == "from outside"
    assert parse_target("http://host/x").password is None


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (302, DeliveryError),
        (401, DeliveryError),
        (404, DeliveryError),
        (400, RefusedEventError),
        (422, RefusedEventError),
    ],
)
def test_a_webhook_that_does_not_accept_has_not_taken_the_event(
    webhook: Webhook, status: int, kind: type[DeliveryError]
) -> None:
    class Other(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.send_response(status)
            self.send_header("Location", webhook.url)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            return

    with ThreadingHTTPServer(("127.0.0.1", 0), Other) as server:
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        sender = open_sender(parse_target(f"http://127.0.0.1:{server.server_address[1]}/x"))
        with pytest.raises(DeliveryError, match=f"it answers {status}") as refused:
            sender.send(b'{"id": "1"}')
        server.shutdown()
    assert type(refused.value) is kind
    assert getattr(refused.value, "is_certain", None) == {400: False, 422: True}.get(status)
    assert not webhook.ids


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("yard", "takes mqtt://"),
        ("ftp://bob:s3cret@host/x", "takes mqtt://"),
        ("http:///x", "takes mqtt://"),
        ("http://host:99999/x", "no number up to 65535"),
        ("mqtt://bob:s3cret@host", "needs a topic"),
        ("mqtt://bob:s3cret@host/yard/+", "without wildcards"),
    ],
)
def test_a_target_that_cannot_be_is_refused_without_its_password(url: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told) as refused:
        parse_target(url)
    assert "s3cret" not in str(refused.value)


def test_mqtt_without_its_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install paho-mqtt"):
        parse_target("mqtt://host/yard")


def test_a_broker_gets_every_event_though_it_was_away(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("paho.mqtt.client")
    broker = Broker()
    port = broker.server_address[1]
    sender = open_sender(parse_target(f"mqtt://bob:s3cret@127.0.0.1:{port}/yard/events"))
    sender.send(b'{"id": "1"}')
    broker.stop()
    with monkeypatch.context() as patch:
        patch.setattr(targets_module, "_ANSWER_SECONDS", 0.1)
        with pytest.raises(DeliveryError):
            sender.send(b'{"id": "2"}')
    again = Broker(port)
    sender.send(b'{"id": "2"}')
    sender.close()
    again.stop()
    assert broker.published == [("yard/events", b'{"id": "1"}')]
    assert again.published == [("yard/events", b'{"id": "2"}')]


def test_a_broker_that_refuses_the_password_is_reported() -> None:
    pytest.importorskip("paho.mqtt.client")
    broker = Broker()
    target = EventTarget(f"mqtt://127.0.0.1:{broker.server_address[1]}/yard", "bob", "wrong")
    with pytest.raises(DeliveryError, match="it refuses: Not authorized"):
        open_sender(target).send(b"{}")
    broker.stop()


class Mosquitto:
    """A real broker with TLS and a password, which keeps what a subscriber has not got."""

    def __init__(self, folder: Path) -> None:
        program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
        if program is None or shutil.which("openssl") is None:
            pytest.skip("no real broker on this machine: install the packages mosquitto and openssl")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        self.certificate, key = folder / "certificate.pem", folder / "key.pem"
        for_here = ("-days", "2", "-subj", "/CN=yard", "-addext", "subjectAltName=IP:127.0.0.1")
        files = ("-keyout", str(key), "-out", str(self.certificate))
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", *for_here, *files],
            check=True,
            capture_output=True,
        )
        passwords = folder / "passwords"
        subprocess.run(["mosquitto_passwd", "-b", "-c", str(passwords), "bob", "s3cret"], check=True)
        settings = {
            "listener": f"{self.port} 127.0.0.1",
            "certfile": self.certificate,
            "keyfile": key,
            "password_file": passwords,
            "persistence": "true",
            "persistence_location": f"{folder}/",
            "user": pwd.getpwuid(os.getuid()).pw_name,
        }
        configuration = folder / "mosquitto.conf"
        configuration.write_text("".join(f"{name} {value}\n" for name, value in settings.items()))
        self._command = [program, "-c", str(configuration)]
        self.begin()

    def begin(self) -> None:
        self._process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def end(self) -> None:
        self._process.terminate()
        self._process.wait()


def test_a_real_broker_gets_every_event_by_tls_though_it_was_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mqtt = pytest.importorskip("paho.mqtt.client")
    broker = Mosquitto(tmp_path)
    monkeypatch.setenv("SSL_CERT_FILE", str(broker.certificate))
    received: list[str] = []
    subscriber = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, "subscriber", clean_session=False)
    subscriber.username_pw_set("bob", "s3cret")
    subscriber.tls_set(str(broker.certificate))
    subscriber.reconnect_delay_set(0.1, 0.1)
    subscriber.on_connect = lambda client, *_: client.subscribe("yard/events", qos=1)
    subscriber.on_message = lambda _, __, message: received.append(json.loads(message.payload)["id"])
    wait_until(lambda: _connects(subscriber, broker.port))
    subscriber.loop_start()
    said: list[str] = []
    url = f"mqtts://bob:s3cret@127.0.0.1:{broker.port}/yard/events"
    gate = StreamRecord(tmp_path / "gate", "gate", frozenset())
    with Deliveries([parse_target(url)], tmp_path, said.append):
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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho leaves its socket open
def test_a_broker_without_a_known_certificate_gets_nothing(tmp_path: Path) -> None:
    pytest.importorskip("paho.mqtt.client")
    broker = Mosquitto(tmp_path)
    target = parse_target(f"mqtts://bob:s3cret@127.0.0.1:{broker.port}/yard/events")
    wait_until(lambda: _listens(broker.port))
    with pytest.raises(DeliveryError, match="certificate"):
        open_sender(target).send(b"{}")
    broker.end()


def _connects(subscriber: Any, port: int) -> bool:
    try:
        subscriber.connect("127.0.0.1", port)
    except OSError:
        return False
    return True


def _listens(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except OSError:
        return False
    return True
