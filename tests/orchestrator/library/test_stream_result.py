"""What a result of a stream shows of itself."""

from __future__ import annotations

from record_fakes import frame, segmentation

from orchestrator import StreamResult


def test_the_repr_of_a_result_of_a_stream_shows_where_it_is_from_and_no_array() -> None:
    result = StreamResult.of(segmentation(7, 3, 5), frame(7), "gate")
    assert repr(result) == "StreamResult(gate, frame 7, 0.70 s, 50×36, objects 3 5)"


def test_a_notebook_shows_a_result_of_a_stream_as_one_of_the_class() -> None:
    html = StreamResult.of(segmentation(7, 3, 5), frame(7), "<gate>")._repr_html_()
    assert html.startswith("<div>&lt;gate&gt;, frame 7, 0.70 s, 50×36, ok</div><img")
    assert html.count("<tr>") == 3
