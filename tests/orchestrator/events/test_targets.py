"""Addresses of targets, what an operator writes of them, and the ways there: webhook and broker."""

from __future__ import annotations

import base64
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from mosquitto import Mosquitto
from pydantic import ValidationError

from chaos.harness.broker import Broker
from chaos.harness.webhook import Webhook as WebhookServer
from mlbs_actors.errors import ConfigError
from orchestrator.command_line import command_again, parse
from orchestrator.credentials import PASSWORD_VARIABLE
from orchestrator.events import mqtt as mqtt_module
from orchestrator.events import senders as senders_module
from orchestrator.events.event_filter import EventFilter
from orchestrator.events.mqtt import Mqtt
from orchestrator.events.senders import DeliveryError, RefusedEventError, Webhook
from orchestrator.events.targets import EventTarget, TargetEntry, parse_target, targets_of


@pytest.fixture
def webhook() -> Iterator[WebhookServer]:
    server = WebhookServer()
    yield server
    server.stop()


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (senders_module, mqtt_module):
        monkeypatch.setattr(module, "ANSWER_SECONDS", 200.0)


def test_a_webhook_on_this_machine_is_not_asked_for_at_the_proxy(
    webhook: WebhookServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9/")
    monkeypatch.delenv("no_proxy", raising=False)
    Webhook(parse_target(webhook.url)).send(b'{"id": "a"}')
    assert webhook.ids == ["a"]


def test_a_password_is_sent_and_shown_nowhere(
    tmp_path: Path, webhook: WebhookServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = webhook.url.replace("http://", "http://bob:s3cr%40t@").replace(
        "/hook", "/api/webhook/hidden?token=k"
    )
    target = parse_target(url)
    Webhook(target).send(b'{"id": "1"}')
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
    webhook: WebhookServer, status: int, kind: type[DeliveryError]
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
        sender = Webhook(parse_target(f"http://127.0.0.1:{server.server_address[1]}/x"))
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
        ("mqtt://bob:s3cret[x@host/t", "is no address.*%5B"),
        ("mqtt://bob:s3cret x@host:port/t", "no number up to 65535"),
        ("bob:s3cret@host/t", r"not '\*\*\*@host/t'"),
        ("//bob:s3cret@host/t", "takes mqtt://"),
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
    sender = Mqtt(parse_target(f"mqtt://bob:s3cret@127.0.0.1:{port}/yard/events"))
    sender.send(b'{"id": "1"}')
    broker.stop()
    with monkeypatch.context() as patch:
        patch.setattr(mqtt_module, "ANSWER_SECONDS", 0.1)
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
        Mqtt(target).send(b"{}")
    broker.stop()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho leaves its socket open
def test_a_broker_without_a_known_certificate_gets_nothing(tmp_path: Path) -> None:
    pytest.importorskip("paho.mqtt.client")
    broker = Mosquitto(tmp_path, tls=True)
    target = parse_target(broker.url)
    with pytest.raises(DeliveryError, match="certificate"):
        Mqtt(target).send(b"{}")
    broker.end()


def test_what_an_operator_writes_of_a_target_becomes_the_target() -> None:
    broker = {"url": "mqtt://bob:s3cret@host/yard", "kinds": ["rule"], "home_assistant": "homeassistant"}
    hook = {"url": "https://host/hook", "zones": ["yard"], "score": 0.5}
    first, second = targets_of([TargetEntry.model_validate(entry) for entry in (broker, hook)])
    wanted = EventFilter(kinds=("rule",))
    assert first == EventTarget("mqtt://host/yard", "bob", "s3cret", wanted, "homeassistant")
    assert second.wanted == EventFilter(zones=("yard",), score=0.5)
    plain = targets_of([TargetEntry(url="http://host/hook")])[0]
    assert plain == parse_target("http://host/hook")
    assert not plain.wanted.wants({"kind": "born", "stream": "gate"})


def test_a_target_is_told_from_others_by_its_address_without_user_and_password() -> None:
    urls = ["mqtt://bob:one@host/yard", "mqtt://eve@host/yard", "mqtt://host/gate"]
    first, same, other = (parse_target(url).key for url in urls)
    assert first == same != other
    entries = [TargetEntry(url=url) for url in urls[:2]]
    with pytest.raises(ConfigError, match=r"mqtt://host/yard stands there twice"):
        targets_of(entries)


def test_a_fault_in_what_an_operator_writes_is_told_without_the_password() -> None:
    for entry in (
        {"url": "mqtt://host/x", "kind": ["born"]},
        {"url": "mqtt://host/x", "kinds": ["bron"]},
        {"kinds": ["born"]},
        {"url": "mqtt://host/x", "home_assistant": "#"},
    ):
        with pytest.raises(ValidationError):
            TargetEntry.model_validate(entry)
    with pytest.raises(ConfigError, match="home_assistant needs an mqtt:// address") as refused:
        targets_of([TargetEntry(url="http://bob:s3cret@host/x", home_assistant="homeassistant")])
    assert "s3cret" not in str(refused.value)
    assert "s3cret" not in repr(TargetEntry(url="http://bob:s3cret@host/x"))


def test_a_webhook_may_have_a_path_in_any_letters(webhook: WebhookServer) -> None:
    Webhook(parse_target(webhook.url.replace("/hook", "/hook/Süd x?a=ü%20"))).send(b'{"id": "a"}')
    assert webhook.ids == ["a"]


def test_a_host_that_cannot_be_is_one_that_does_not_take_the_event() -> None:
    for host in ("a..b", "ü" * 70, "a b"):
        with pytest.raises(DeliveryError) as refused:
            Webhook(parse_target(f"http://{host}/hidden")).send(b"{}")
        assert "hidden" not in str(refused.value)
