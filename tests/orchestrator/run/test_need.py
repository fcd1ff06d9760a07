"""What a stream needs: by the size of its pictures, or as the user says."""

from __future__ import annotations

import pytest

from mlbs_actors.errors import ConfigError
from orchestrator.run.need import PLACE_BYTES, USUAL_NEED, Need, need_of, parse_reserve


def test_a_stream_of_small_pictures_needs_less_memory_than_one_of_large_ones() -> None:
    small, usual, large = (need_of(None, [size]).memory for size in ((120, 160), (480, 640), (1080, 1920)))
    assert small < usual < large
    assert usual == pytest.approx(PLACE_BYTES, rel=0.15)


def test_the_largest_pictures_of_a_run_count_and_the_default_where_one_is_not_known() -> None:
    assert need_of(None, [(120, 160), (1080, 1920)]) == need_of(None, [(1080, 1920)])
    assert need_of(None, [(120, 160), None]) == need_of(None, []) == USUAL_NEED


def test_what_the_user_says_takes_precedence_and_may_be_one_of_the_two() -> None:
    assert need_of(parse_reserve("cpu=0.25,memory=600MB"), [None]) == Need(0.25, 600_000_000)
    assert need_of(parse_reserve("memory=1.5GiB"), [None]) == Need(0.5, 3 * 2**29)
    assert need_of(parse_reserve("cpu=2"), [(120, 160)]).memory == need_of(None, [(120, 160)]).memory


@pytest.mark.parametrize(
    "text", ["", "0.5", "cpu=0", "cpu=1GB", "memory=600", "memory=-1GB", "cpu=1,cpu=2", "gpu=1", "cpu=1,"]
)
def test_other_words_are_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigError, match=r"such as cpu=0\.25,memory=600MB"):
        parse_reserve(text)
