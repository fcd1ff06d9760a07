"""What Home Assistant is told by MQTT: which entities there are, and their states.

All messages but those of rules are retained, and made of the events' census: so they are right again with the
next connection, whatever the broker or the run has lost. Each camera is a device.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlbs_actors import __version__
from orchestrator.events.census import Census
from orchestrator.events.event_filter import EventFilter
from orchestrator.events.targets import EventTarget
from orchestrator.events.zones import EventRules

__all__ = ["OFFLINE", "Camera", "HomeAssistant", "states_of"]

#: The two messages of availability.
_ONLINE, OFFLINE = b"online", b"offline"

#: What a rule's entity says happened.
_MET = "met"

_Entities = Iterator[tuple[str, str, dict[str, object]]]


@dataclass(frozen=True, slots=True)
class Camera:
    """What there is to be told of a stream.

    Attributes
    ----------
    name : str
        Of the stream.
    zones, lines, rules : tuple of str
        Their names.
    """

    name: str
    zones: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()
    rules: tuple[str, ...] = ()

    @classmethod
    def of(cls, name: str, rules: EventRules) -> Camera:
        """Return that of a stream whose events follow these rules."""
        zones = tuple(zone.name for zone in rules.zones if zone.kind == "zone")
        lines = tuple(zone.name for zone in rules.zones if zone.kind == "line")
        return cls(name, zones, lines, tuple(rule.name for rule in rules.rules))

    def wanted(self, by: EventFilter) -> Camera:
        """Return what of it a target's filter names."""
        zones, lines = (_named(names, by.zones) for names in (self.zones, self.lines))
        rules = _named(self.rules, by.rules) if "rule" in by.wanted_kinds else ()
        return Camera(self.name, zones, lines, rules)


class HomeAssistant:
    """The messages to one broker.

    Parameters
    ----------
    target : EventTarget
        With the prefix of the topics of discovery.
    folder : Path
        Of the run.
    page : str, optional
        Address of the live page, to which the devices link.
    """

    def __init__(self, target: EventTarget, folder: Path, page: str | None = None) -> None:
        self._wanted = target.wanted
        self._prefix = target.home_assistant
        self._base = target.topic
        self._folder = folder
        self._page = page
        self._node = f"mlbs_{_digest(self._base)}"
        self._picture: dict[str, tuple[str, bytes]] = {}

    @property
    def status(self) -> str:
        """Topic of whether the run is connected."""
        return f"{self._base}/status"

    @property
    def discovered(self) -> str:
        """Filter of the topics of all entities, those of earlier settings included."""
        return f"{self._prefix}/+/{self._node}/+/config"

    def standing(self, cameras: Sequence[Camera], censuses: Mapping[str, Census]) -> dict[str, bytes]:
        """Return all messages to be retained, by topic: first the states, then what they are states of."""
        wanted = self._wanted
        seen = [
            camera.wanted(wanted)
            for camera in cameras
            if wanted.streams is None or camera.name in wanted.streams
        ]
        messages = {self.status: _ONLINE}
        for camera in seen:
            messages |= self._states(camera, censuses.get(camera.name, Census()))
        for camera in seen:
            messages |= self._discovery(camera)
        return messages

    def messages(self, event: Mapping[str, Any]) -> list[tuple[str, bytes]]:
        """Return what is published of an event besides itself, by topic."""
        if event["kind"] != "rule" or not event.get("rule"):
            return []
        topic = self._topic(event["stream"], "rules", event["rule"])
        return [(topic, _json({"event_type": _MET, **event}))]

    def _topic(self, *names: str) -> str:
        return "/".join((self._base, *(re.sub(r"[/+#%\x00-\x1f]", _escaped, name) for name in names)))

    def _states(self, camera: Camera, census: Census) -> dict[str, bytes]:
        name = camera.name
        states = {self._topic(name, "status"): OFFLINE if census.lost else _ONLINE}
        for zone in camera.zones:
            states[self._topic(name, "zones", zone)] = _json({"objects": len(census.inside.get(zone, ()))})
        for line in camera.lines:
            states[self._topic(name, "lines", line)] = _json(
                {"left": 0, "right": 0} | census.crossed.get(line, {})
            )
        wanted = [one for kind, one in census.pictures.items() if kind in self._wanted.wanted_kinds]
        if (picture := self._newest_picture(name, max(wanted)[1] if wanted else None)) is not None:
            states[self._topic(name, "picture")] = picture
        return states

    def _newest_picture(self, camera: str, name: str | None) -> bytes | None:
        if name is None:
            return None
        if self._picture.get(camera, ("",))[0] != name:
            try:
                self._picture[camera] = name, (self._folder / camera / name).read_bytes()
            except OSError:  # it has been deleted
                return None
        return self._picture[camera][1]

    def _discovery(self, camera: Camera) -> dict[str, bytes]:
        common = {
            "availability": [{"topic": self.status}, {"topic": self._topic(camera.name, "status")}],
            "availability_mode": "all",
            "device": {
                "identifiers": [f"{self._node}_{_digest(camera.name)}"],
                "name": camera.name,
                "manufacturer": "mlbs-actors",
                "model": "camera",
                "sw_version": __version__,
            },
            "origin": {"name": "mlbs-actors", "sw_version": __version__},
        }
        if self._page is not None:
            common["device"] |= {"configuration_url": self._page}  # type: ignore[operator]
        configs = {}
        for component, topic, own in self._entities(camera):
            name = f"{re.sub(r'[^a-zA-Z0-9_-]', '_', camera.name)}_{_digest(topic, str(own['name']))}"
            config = common | own | {"unique_id": f"{self._node}_{name}"}
            configs[f"{self._prefix}/{component}/{self._node}/{name}/config"] = _json(config)
        return configs

    def _entities(self, camera: Camera) -> _Entities:
        """Yield the component, the topic and the own keys of each entity."""
        for zone in camera.zones:
            topic = self._topic(camera.name, "zones", zone)
            yield (
                "binary_sensor",
                topic,
                {
                    "name": f"{zone} occupancy",
                    "state_topic": topic,
                    "value_template": "{{ 'ON' if value_json.objects > 0 else 'OFF' }}",
                    "device_class": "occupancy",
                    "qos": 1,
                },
            )
            yield (
                "sensor",
                topic,
                {
                    "name": f"{zone} objects",
                    "state_topic": topic,
                    "value_template": "{{ value_json.objects }}",
                    "state_class": "measurement",
                    "qos": 1,
                },
            )
        for line in camera.lines:
            topic = self._topic(camera.name, "lines", line)
            for side in ("left", "right"):
                yield (
                    "sensor",
                    topic,
                    {
                        "name": f"{line} to the {side}",
                        "state_topic": topic,
                        "value_template": f"{{{{ value_json.{side} }}}}",
                        "state_class": "total_increasing",
                        "qos": 1,
                    },
                )
        for rule in camera.rules:
            topic = self._topic(camera.name, "rules", rule)
            yield "event", topic, {"name": rule, "state_topic": topic, "event_types": [_MET], "qos": 1}
        if camera.zones or camera.lines or camera.rules:
            topic = self._topic(camera.name, "picture")
            yield (
                "image",
                topic,
                {"name": "event picture", "image_topic": topic, "content_type": "image/jpeg"},
            )


def states_of(config: bytes) -> set[str]:
    """Return the topics of an entity's retained states, by the message by which it is discovered."""
    try:
        found = json.loads(config)
        key = "image_topic" if "image_topic" in found else "state_topic"
        states = set() if "event_types" in found else {found[key]}
        return states | {one["topic"] for one in found["availability"]}
    except (ValueError, KeyError, TypeError):  # somebody else's
        return set()


def _named(names: tuple[str, ...], wanted: tuple[str, ...] | None) -> tuple[str, ...]:
    return names if wanted is None else tuple(name for name in names if name in wanted)


def _escaped(found: re.Match[str]) -> str:
    return f"%{ord(found[0]):02X}"


def _digest(*names: str) -> str:
    return hashlib.sha256("\n".join(names).encode()).hexdigest()[:8]


def _json(content: object) -> bytes:
    return json.dumps(content).encode()
