"""What a stream's failures are called."""

from __future__ import annotations

import pytest
from ray.exceptions import ActorDiedError, GetTimeoutError, OutOfMemoryError

from mlbs_actors.actors.ipc.channels import ChannelClosedError
from mlbs_actors.actors.node.failures import explain, is_loss, reader_lost, source_failure
from mlbs_actors.errors import ActorLostError, SourceError

#: What calls raise once Ray has ended the actor's process because memory ran out; it knows no actor.
OUT_OF_MEMORY = OutOfMemoryError(  # type: ignore[no-untyped-call]
    "1 worker(s) were killed due to the node running low on memory."
)


@pytest.mark.parametrize(("frames", "words"), [(1, "after 1 frame"), (2, "after 2 frames")])
def test_a_single_frame_is_not_called_frames(frames: int, words: str) -> None:
    assert str(reader_lost("yard", frames)).endswith(f" {words}.")
    assert f" {words} with ValueError" in str(source_failure(ValueError("secret"), "a.mp4", frames))


def test_a_process_ended_for_want_of_memory_or_that_closed_its_channel_is_lost_like_any_other() -> None:
    assert is_loss(OUT_OF_MEMORY)
    assert is_loss(ActorDiedError())
    assert is_loss(ChannelClosedError())
    assert not is_loss(GetTimeoutError("late"))


def test_want_of_memory_is_told_as_what_it_is() -> None:
    told = explain(OUT_OF_MEMORY, "yard", {})
    assert isinstance(told, ActorLostError)
    assert "'yard'" in str(told)
    assert "ran out of memory" in str(told)


def test_a_reader_that_memory_ended_has_died() -> None:
    told = source_failure(OUT_OF_MEMORY, "a.mp4", 3)
    assert isinstance(told, SourceError)
    assert "a.mp4 died after 3 frames" in str(told)
