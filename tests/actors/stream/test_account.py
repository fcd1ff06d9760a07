"""How a stream stands, as its coordinator tells it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mlbs_actors import Segmentation
from mlbs_actors.actors.stream.account import StreamAccount
from mlbs_actors.actors.stream.protocol import StreamProgress
from mlbs_actors.messages import LayerSummary, Region
from mlbs_actors.source import SourceFrame, SourceSilence


def frame(index: int, status: str = "ok", length: int | None = None) -> SourceFrame:
    image = np.zeros((4, 6, 3), np.uint8) if status == "ok" else None
    return SourceFrame(index, image, index / 25, f"{index:05d}", status, length=length)  # type: ignore[arg-type]


def labelled(**stage_ms: float) -> Segmentation:
    maps = np.zeros((4, 6), np.uint16), np.zeros((2, 3), np.uint8), np.zeros((2, 3), np.int8)
    return Segmentation(0, *maps, (), (0.0, 0.0), 0, stage_ms)


def told(account: StreamAccount) -> StreamProgress:
    return account.progress(0, 1, done=False, kept_waiting=False)


def test_what_came_is_counted_by_its_status_and_a_gap_is_no_frame() -> None:
    account = StreamAccount(None)
    for index, status in enumerate(("ok", "quarantined", "gap", "dropped", "ok")):
        account.take(frame(index, status))
    progress = told(account)
    assert (progress.read, progress.quarantined, progress.gaps, progress.dropped) == (4, 1, 1, 1)
    assert (account.position.rows, account.position.pts) == (5, 4 / 25)


def test_silence_is_told_until_a_frame_comes() -> None:
    account = StreamAccount(None)
    account.take(SourceSilence("stalled", "nothing for 3 s"))
    assert told(account).silence == SourceSilence("stalled", "nothing for 3 s")
    account.take(frame(0))
    assert told(account).silence is None


def test_the_length_is_the_source_s_or_what_is_wanted_of_it() -> None:
    for most, length, expected in ((None, None, None), (None, 9, 9), (5, 9, 5), (5, None, 5), (12, 9, 9)):
        account = StreamAccount(most)
        account.take(frame(0, length=length))
        assert told(account).length == expected


def test_what_has_no_label_map_adds_to_the_length_if_a_number_of_label_maps_is_wanted() -> None:
    account = StreamAccount(5)
    for index, status in enumerate(("ok", "quarantined", "gap", "dropped", "ok")):
        account.take(frame(index, status, length=9))
    assert told(account).length == 7
    for index in range(5, 8):
        account.take(frame(index, "quarantined", length=9))
    assert told(account).length == 9


def test_stage_times_are_means_since_the_last_report() -> None:
    account = StreamAccount(None)
    account.label(labelled(cut=1.0))
    account.label(labelled(cut=2.0, flow=4.0))
    assert told(account).stage_ms == {"cut": 1.5, "flow": 2.0}
    assert told(account).stage_ms == {}
    account.label(labelled(cut=7.0))
    assert told(account).stage_ms == {"cut": 7.0}


def test_an_account_goes_on_from_a_snapshot() -> None:
    before, account = StreamAccount(None), StreamAccount(None)
    for index in range(3):
        before.take(frame(index))
    account.restore(before.counts, before.position)
    account.take(frame(3))
    before.take(frame(3))
    assert told(account) == told(before)
    assert replace(account.position, time=0.0) == replace(before.position, time=0.0)


def test_objects_are_the_layers_that_own_a_pixel_of_the_newest_label_map() -> None:
    account = StreamAccount(None)
    assert told(account).objects == 0
    for ids in ((3, 5), (5,)):
        account.label(replace(labelled(), layers=tuple(owner(layer) for layer in ids)))
    assert told(account).objects == 1
    assert account.progress(2, 4, done=True, kept_waiting=False).objects == 0


def test_parts_of_an_object_are_no_objects() -> None:
    account = StreamAccount(None)
    parts = owner(3), replace(owner(5), part_of=3), replace(owner(8), part_of=7)
    account.label(replace(labelled(), layers=parts))
    assert told(account).objects == 2


def owner(layer: int) -> LayerSummary:
    return LayerSummary(layer, "object", Region(0, 0, 2, 2), 4, (0.5, 0.5), (0.0, 0.0), 1.0)
