"""What Home Assistant finds at a real broker, by its own rules, whatever happens to run and broker."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from home_assistant_client import HomeAssistantClient
from mosquitto import Mosquitto
from record_fakes import frame, segmentation

from orchestrator.events import carrier as carrier_module
from orchestrator.events import delivery as delivery_module
from orchestrator.events import mqtt as mqtt_module
from orchestrator.events.census import Census
from orchestrator.events.delivery import Deliveries
from orchestrator.events.event_filter import EventFilter
from orchestrator.events.home_assistant import Camera, HomeAssistant
from orchestrator.events.targets import EventTarget, parse_target
from orchestrator.events.zones import EventRules, Zone
from orchestrator.sinks.record import StreamRecord

YARD = Zone(name="yard", polygon=((0, 0), (1, 0), (1, 1), (0, 1)))
FENCE = Zone(name="fence", kind="line", polygon=((15, 0), (15, 36)))
RULES = EventRules((YARD, FENCE))


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("paho.mqtt.client")
    monkeypatch.setattr(carrier_module, "retry_seconds", lambda failures: 0.02)
    monkeypatch.setattr(delivery_module, "_GRACE_SECONDS", 200.0)
    monkeypatch.setattr(mqtt_module, "ANSWER_SECONDS", 200.0)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    folder = tmp_path / "broker"
    folder.mkdir()
    real = Mosquitto(folder, keeps=False)
    yield real
    real.end()


@pytest.fixture
def home(broker: Mosquitto) -> Iterator[HomeAssistantClient]:
    client = HomeAssistantClient(broker.port)
    yield client
    client.close()
    assert client.faults == []


def target_of(broker: Mosquitto, wanted: EventFilter | None = None) -> EventTarget:
    return replace(parse_target(broker.url), home_assistant="homeassistant", wanted=wanted or EventFilter())


def wait_until(there: Callable[[], bool]) -> None:
    while not there():
        time.sleep(0.01)


def line_of(number: int, kind: str, stream: str = "gate", **more: object) -> str:
    return json.dumps({"id": f"{number}", "stream": stream, "kind": kind, "number": number} | more) + "\n"


def append(folder: Path, *lines: str) -> None:
    folder.mkdir(exist_ok=True)
    with (folder / "events.jsonl").open("a") as file:
        file.writelines(lines)


def retained(broker: Mosquitto) -> list[str]:
    """Return the topics of all messages that a broker holds."""
    mqtt = pytest.importorskip("paho.mqtt.client")
    topics: list[str] = []
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.username_pw_set("bob", "s3cret")
    client.on_subscribe = lambda one, *_: one.publish("that is all")
    client.on_message = lambda _, __, message: topics.append(message.topic)
    client.on_connect = lambda one, *_: one.subscribe("#")
    client.connect("127.0.0.1", broker.port)
    client.loop_start()
    wait_until(lambda: "that is all" in topics)
    client.disconnect()
    client.loop_stop()
    return topics[:-1]


def test_all_names_give_valid_topics_and_ids_that_are_unique(tmp_path: Path) -> None:
    target = replace(parse_target("mqtt://host/yard/events"), home_assistant="homeassistant")
    names = ("a b", "ä/#+", "a_b", "a", "%2F", "/", "b")
    cameras = [Camera(name, names, names[:2], names) for name in names]
    messages = HomeAssistant(target, tmp_path).standing(cameras, {})
    configs = {topic: json.loads(text) for topic, text in messages.items() if topic.endswith("/config")}
    each = 2 * len(names) + 2 * 2 + len(names) + 1
    assert len(configs) == len({config["unique_id"] for config in configs.values()}) == each * len(names)
    assert not any(set("+#") & set(topic) for topic in messages)
    assert len({config["device"]["identifiers"][0] for config in configs.values()}) == len(names)


def test_entities_are_those_of_what_a_target_wants(tmp_path: Path) -> None:
    cameras = [Camera(name, ("yard", "road"), ("fence",), ("lurking",)) for name in ("gate", "lane")]

    def found(wanted: EventFilter) -> set[tuple[str, str]]:
        target = EventTarget("mqtt://host/x", wanted=wanted, home_assistant="ha")
        messages = HomeAssistant(target, tmp_path).standing(cameras, {}).items()
        configs = [json.loads(text) for topic, text in messages if topic.endswith("/config")]
        return {(one["device"]["name"], one["name"]) for one in configs}

    everything = found(EventFilter())
    assert len(everything) == 2 * (2 * 2 + 2 + 1 + 1)
    assert {camera for camera, _ in found(EventFilter(streams=("lane",)))} == {"lane"}
    some = {name for _, name in found(EventFilter(zones=("road",), kinds=("entered", "left")))}
    assert some == {"road occupancy", "road objects", "event picture"}


def test_zones_lines_and_pictures_of_a_camera_are_found_and_followed(
    tmp_path: Path, broker: Mosquitto, home: HomeAssistantClient
) -> None:
    gate = StreamRecord(tmp_path / "gate", "gate", frozenset(), rules=RULES)
    cameras = [Camera.of("gate", RULES)]
    with Deliveries([target_of(broker)], tmp_path, print, cameras=lambda: cameras):
        wait_until(lambda: home.states().get("gate: yard occupancy") == "off")
        for index in range(40):
            gate.write(segmentation(index, 3, *([5] if index < 20 else [])), frame(index))
        wait_until(lambda: home.states()["gate: yard objects"] == "2")
        assert home.states()["gate: yard occupancy"] == "on"
        newest = [
            event["picture"]
            for event in map(json.loads, (tmp_path / "gate/events.jsonl").read_text().splitlines())
            if event["picture"]
        ][-1]
        picture = (tmp_path / "gate" / newest).read_bytes()
        wait_until(lambda: home.image("gate") == picture)
        gate.close(whole=True)
        wait_until(lambda: home.states()["gate: yard objects"] == "0")
        lines = [json.loads(line) for line in (tmp_path / "gate/events.jsonl").read_text().splitlines()]
        for side in ("left", "right"):
            crossed = sum(one["direction"] == side for one in lines)
            wait_until(lambda: home.states()[f"gate: fence to the {side}"] == str(crossed))  # noqa: B023
    wait_until(lambda: set(home.states().values()) == {"unavailable"})  # it has said goodbye


def test_a_rule_fires_an_event_with_all_that_is_known_of_it(
    tmp_path: Path, broker: Mosquitto, home: HomeAssistantClient
) -> None:
    cameras = [Camera("gate", rules=("stays too long",))]
    with Deliveries([target_of(broker)], tmp_path, print, page="http://yard:9464", cameras=lambda: cameras):
        wait_until(lambda: len(home.entities) == 2)
        append(
            tmp_path / "gate",
            line_of(1, "crossed", zone="fence", direction="left"),
            line_of(2, "rule", rule="stays too long", zone="yard", objects=[7], clip="clips/a.mp4"),
        )
        wait_until(lambda: bool(home.fired))
    [fired] = home.fired
    assert fired["event_type"] == "met"
    assert fired["objects"] == [7]
    assert fired["clip_url"] == "http://yard:9464/records/gate/clips/a.mp4"


def test_a_camera_that_is_lost_is_not_available_and_the_others_are(
    tmp_path: Path, broker: Mosquitto, home: HomeAssistantClient
) -> None:
    cameras = [Camera("gate", ("yard",)), Camera("lane", ("yard",))]
    with Deliveries([target_of(broker)], tmp_path, print, cameras=lambda: cameras):
        wait_until(lambda: len(home.states()) == 4)
        append(tmp_path / "gate", line_of(1, "stream lost"))
        wait_until(lambda: home.states()["gate: yard objects"] == "unavailable")
        wait_until(lambda: home.states()["lane: yard objects"] == "0")
        append(tmp_path / "gate", line_of(2, "stream back"))
        wait_until(lambda: home.states()["gate: yard objects"] == "0")


def test_all_is_told_again_when_a_broker_has_lost_it(
    tmp_path: Path, broker: Mosquitto, home: HomeAssistantClient
) -> None:
    cameras = [Camera("gate", ("yard",))]
    with Deliveries([target_of(broker)], tmp_path, print, cameras=lambda: cameras):
        append(tmp_path / "gate", line_of(1, "entered", zone="yard", object=7))
        wait_until(lambda: home.states().get("gate: yard objects") == "1")
        broker.end()
        append(tmp_path / "gate", line_of(2, "entered", zone="yard", object=8))
        broker.begin()
        late = HomeAssistantClient(broker.port)  # which knows nothing of before
        wait_until(lambda: late.states().get("gate: yard objects") == "2")
        assert late.faults == []
        late.close()


def test_entities_of_what_is_gone_go_in_a_run_and_after_it(
    tmp_path: Path, broker: Mosquitto, home: HomeAssistantClient
) -> None:
    cameras = [Camera("gate", ("yard", "road")), Camera("lane", ("yard",))]
    with Deliveries([target_of(broker)], tmp_path, print, cameras=lambda: tuple(cameras)):
        wait_until(lambda: len(home.entities) == 5 + 3)
        cameras[0] = Camera("gate", ("yard",), rules=("stays",))
        wait_until(lambda: len(home.entities) == 4 + 3)
    del cameras[1]
    with Deliveries([target_of(broker)], tmp_path, print, cameras=lambda: tuple(cameras)) as deliveries:
        wait_until(lambda: set(home.states()) == {"gate: yard occupancy", "gate: yard objects"})
        deliveries.retarget([parse_target(broker.url)])
        wait_until(lambda: not home.entities)
        deliveries.retarget([target_of(broker)])
        wait_until(lambda: len(home.states()) == 2)
        deliveries.retarget([])
        wait_until(lambda: not home.entities)
    assert retained(broker) == []
    assert home.fired == []


PROGRAM = """
import sys
from pathlib import Path
from orchestrator.events.delivery import Deliveries
from orchestrator.events.home_assistant import Camera
from orchestrator.events.targets import TargetEntry, targets_of
targets = targets_of([TargetEntry(url=sys.argv[2], home_assistant="homeassistant")])
with Deliveries(targets, Path(sys.argv[1]), print, cameras=lambda: [Camera("gate", ("yard",), ("fence",))]):
    sys.stdin.read()
"""


def test_occupancy_is_right_after_a_kill_and_with_what_the_kill_has_taken_from_the_record(
    tmp_path: Path, broker: Mosquitto, home: HomeAssistantClient
) -> None:
    gate = StreamRecord(tmp_path / "gate", "gate", frozenset(), rules=EventRules((YARD, FENCE)))
    command = [sys.executable, "-c", PROGRAM, str(tmp_path), broker.url]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as run:
        for index in range(40):  # 32 of them are committed
            gate.write(segmentation(index, 3, *([5] if index > 33 else [])), frame(index))
        wait_until(lambda: home.states().get("gate: yard objects") == "2")
        run.send_signal(signal.SIGKILL)
        run.wait()
    wait_until(lambda: home.states()["gate: yard objects"] == "unavailable")  # by the last will
    again = StreamRecord(tmp_path / "gate", "gate", frozenset(), rules=EventRules((YARD, FENCE)))
    with subprocess.Popen(command, stdin=subprocess.PIPE) as run:
        wait_until(lambda: home.states()["gate: yard objects"] == "1")  # object 5 came after the commit
        for index in range(45):
            again.write(segmentation(index, 3, 6), frame(index))
        wait_until(lambda: home.states()["gate: yard objects"] == "2")
        assert home.states()["gate: yard occupancy"] == "on"
        again.close(whole=True)
        wait_until(lambda: home.states()["gate: yard occupancy"] == "off")
        run.communicate()


def test_a_census_counts_lines_only_when_they_are_final() -> None:
    census = Census()
    for final in (False, True, True):
        census.add({"kind": "crossed", "zone": "fence", "direction": "left"}, final=final)
        census.add({"kind": "entered", "zone": "yard", "object": 7}, final=final)
    assert census.crossed == {"fence": {"left": 2, "right": 0}}
    assert census.inside == {"yard": {7}}
    assert Census.read(census.text()) == census
