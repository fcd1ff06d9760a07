"""Have the receiver of a run's events be away: a web server, an MQTT broker."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence

from chaos.harness.broker import Broker
from chaos.harness.observed_run import ObservedRun, expect
from chaos.harness.scenario import FRAMES, LINES, ScenarioContext, expect_end, expect_identical, single_fault
from chaos.harness.webhook import Webhook
from orchestrator.events.event_file import EVENTS
from orchestrator.events.event_filter import EventFilter

__all__ = ["SCENARIOS"]

_STREAMS = "victim", "bystander"


def _away(context: ScenarioContext) -> None:
    """Be away from some frame to the end of the run, and there again when it is resumed."""
    webhook = Webhook()
    flags = _flags(context, webhook.url)
    with ObservedRun(LINES, context.folder, *flags) as run:
        run.wait_for_frames("victim", int(context.random.integers(1, FRAMES // 2)))
        webhook.away = True
        expect("could not be delivered" in expect_end(run, 0), "undelivered events are not reported")
        expect_identical(context, run)
    webhook.away = False
    with ObservedRun(LINES, context.folder, *flags, "--resume") as run:
        expect_end(run, 0)
    webhook.stop()
    _expect_all(run, webhook.ids)


def _broker_away(context: ScenarioContext) -> None:
    """Be away from some frame to the end of the run, and at the start of the one that resumes it."""
    broker = Broker()
    port = broker.server_address[1]
    flags = _flags(context, f"mqtt://bob:s3cret@127.0.0.1:{port}/yard")
    with ObservedRun(LINES, context.folder, *flags) as run:
        run.wait_for_frames("victim", int(context.random.integers(1, FRAMES // 2)))
        broker.stop()
        expect("could not be delivered" in expect_end(run, 0), "undelivered events are not reported")
        expect_identical(context, run)
    with ObservedRun(LINES, context.folder, *flags, "--resume") as run:
        time.sleep(context.random.uniform(0, 3.0))
        again = Broker(port)
        expect_end(run, 0)
    again.stop()
    _expect_all(run, [json.loads(payload)["id"] for _, payload in broker.published + again.published])


def _flags(context: ScenarioContext, url: str) -> tuple[str, ...]:
    """Return those of a run that sends who enters and leaves the picture."""
    everywhere = {"name": "all", "polygon": [[0, 0], [1, 0], [1, 1], [0, 1]]}
    zones = context.folder / "zones.yaml"
    zones.parent.mkdir(parents=True, exist_ok=True)
    zones.write_text(json.dumps({"streams": {name: {"zones": [everywhere]} for name in _STREAMS}}))
    return "--events", url, "--zones", str(zones)


def _expect_all(run: ObservedRun, sent: Sequence[str]) -> None:
    """Expect that every event that is sent by default has arrived, in order and once."""
    for name in _STREAMS:
        lines = (run.output / name / EVENTS).read_text(encoding="utf-8").splitlines()
        events = [event for line in lines if EventFilter().wants(event := json.loads(line))]
        written = [event["id"] for event in events]
        expect(bool(written), f"{name}: nothing has happened")
        arrived = [one for one in sent if one.startswith(f"{name}/")]
        expect(arrived == written, f"{name}: {arrived} arrived instead of {written}")


SCENARIOS = (
    single_fault("29", "the receiver of events away", _away),
    single_fault("29", "the MQTT broker of events away", _broker_away),
)
