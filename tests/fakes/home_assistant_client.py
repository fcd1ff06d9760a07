"""What Home Assistant does with the messages that it finds at a broker, as far as its documentation tells."""

from __future__ import annotations

import json
import re
from typing import Annotated, Any, Literal

from jinja2 import Environment, StrictUndefined
from pydantic import BaseModel, ConfigDict, Field, model_validator

_TOPIC = re.compile(r"(\w+)/(?:([a-zA-Z0-9_-]+)/)?([a-zA-Z0-9_-]+)/config")
_Topic = Annotated[str, Field(min_length=1, pattern=r"^[^+#\x00]+$")]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Availability(_Strict):
    topic: _Topic
    payload_available: str = "online"
    payload_not_available: str = "offline"
    value_template: str | None = None


class _Device(_Strict):
    identifiers: list[str] = []
    connections: list[list[str]] = []
    name: str | None = None
    manufacturer: str | None = None
    model: str | None = None
    sw_version: str | None = None
    configuration_url: Annotated[str, Field(pattern="^(https?|homeassistant)://")] | None = None

    @model_validator(mode="after")
    def _has_one(self) -> _Device:
        assert self.identifiers or self.connections
        return self


class _Origin(_Strict):
    name: str
    sw_version: str | None = None
    support_url: str | None = None


class _Entity(_Strict):
    """Keys that all components have; a device needs a unique id."""

    name: str | None
    unique_id: str
    device: _Device
    origin: _Origin
    availability: list[_Availability] = []
    availability_mode: Literal["all", "any", "latest"] = "latest"


class _BinarySensor(_Entity):
    state_topic: _Topic
    value_template: str | None = None
    payload_on: str = "ON"
    payload_off: str = "OFF"
    device_class: Literal["motion", "occupancy", "presence", "problem"] | None = None
    off_delay: int | None = None
    qos: Literal[0, 1, 2] = 0


class _Sensor(_Entity):
    state_topic: _Topic
    value_template: str | None = None
    state_class: Literal["measurement", "total", "total_increasing"] | None = None
    unit_of_measurement: str | None = None
    qos: Literal[0, 1, 2] = 0


class _Event(_Entity):
    state_topic: _Topic
    event_types: Annotated[list[str], Field(min_length=1)]
    device_class: Literal["button", "doorbell", "motion"] | None = None
    qos: Literal[0, 1, 2] = 0


class _Image(_Entity):
    image_topic: _Topic | None = None
    url_topic: _Topic | None = None
    content_type: str | None = None

    @model_validator(mode="after")
    def _has_one(self) -> _Image:
        assert (self.image_topic is None) != (self.url_topic is None)
        assert self.content_type is None or self.image_topic is not None
        return self


_COMPONENTS: dict[str, type[_Entity]] = {
    "binary_sensor": _BinarySensor,
    "sensor": _Sensor,
    "event": _Event,
    "image": _Image,
}


class HomeAssistantClient:
    """Finds entities below a prefix, and follows their states; keeps what is not valid as a fault.

    Attributes
    ----------
    entities : dict of str to _Entity
        By topic of discovery.
    faults : list of str
    fired : list of dict
        What the entities of kind ``event`` have got.
    """

    def __init__(self, port: int, prefix: str = "homeassistant") -> None:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self.entities: dict[str, _Entity] = {}
        self.faults: list[str] = []
        self.fired: list[dict[str, Any]] = []
        self._values: dict[str, bytes] = {}
        self._prefix = prefix
        self._templates = Environment(undefined=StrictUndefined, autoescape=False)
        self._client: Any = Client(CallbackAPIVersion.VERSION2)
        self._client.username_pw_set("bob", "s3cret")
        self._client.reconnect_delay_set(1, 1)
        self._client.on_connect = self._connected
        self._client.on_message = self._received
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def close(self) -> None:
        """End the connection."""
        self._client.disconnect()
        self._client.loop_stop()

    def states(self) -> dict[str, str]:
        """Return the state of each entity by device and name; those of images and events are none."""
        return {
            f"{one.device.name}: {one.name}": self._state(one)
            for one in list(self.entities.values())
            if isinstance(one, _BinarySensor | _Sensor)
        }

    def image(self, device: str) -> bytes | None:
        """Return what the device's image shows."""
        for one in list(self.entities.values()):
            if isinstance(one, _Image) and one.device.name == device and one.image_topic is not None:
                return self._values.get(one.image_topic)
        return None

    def available(self, entity: _Entity) -> bool:
        """Whether an entity is available."""
        assert entity.availability_mode == "all"
        return all(
            self._values.get(one.topic, b"").decode() == one.payload_available for one in entity.availability
        )

    def _state(self, entity: _BinarySensor | _Sensor) -> str:
        if not self.available(entity):
            return "unavailable"
        if entity.state_topic not in self._values:
            return "unknown"
        value = self._values[entity.state_topic].decode()
        if entity.value_template is not None:
            template = self._templates.from_string(entity.value_template)
            value = template.render(value=value, value_json=json.loads(value))
        if isinstance(entity, _BinarySensor):
            return {entity.payload_on: "on", entity.payload_off: "off"}[value]
        return value

    def _connected(self, client: Any, *_: object) -> None:
        client.subscribe([(f"{self._prefix}/+/+/config", 0), (f"{self._prefix}/+/+/+/config", 0)])
        for entity in self.entities.values():
            self._follow(entity)

    def _received(self, _client: object, _data: object, message: Any) -> None:
        if message.topic.startswith(f"{self._prefix}/"):
            self._found(message.topic, message.payload)
            return
        self._values[message.topic] = message.payload
        for entity in self.entities.values():
            if isinstance(entity, _Event) and entity.state_topic == message.topic:
                event = json.loads(message.payload or b"{}")
                if event.get("event_type") not in entity.event_types:
                    self.faults.append(f"{message.topic}: {event}")
                self.fired.append(event)

    def _found(self, topic: str, payload: bytes) -> None:
        if not payload:
            self.entities.pop(topic, None)
            return
        matched = _TOPIC.fullmatch(topic.removeprefix(f"{self._prefix}/"))
        try:
            assert matched, "no topic of discovery"
            entity = _COMPONENTS[matched[1]].model_validate_json(payload)
            others = [one for place, one in self.entities.items() if place != topic]
            assert entity.unique_id not in {one.unique_id for one in others}, "its id is not unique"
        except (AssertionError, KeyError, ValueError) as error:
            self.faults.append(f"{topic}: {error!r}")
            return
        self.entities[topic] = entity
        self._follow(entity)

    def _follow(self, entity: _Entity) -> None:
        topics = [one.topic for one in entity.availability]
        for key in ("state_topic", "image_topic"):
            if (topic := getattr(entity, key, None)) is not None:
                topics.append(topic)
        self._client.subscribe([(topic, 1) for topic in topics])
