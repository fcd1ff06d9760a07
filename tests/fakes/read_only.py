"""Arrays as a stream passes them on."""

from __future__ import annotations

from mlbs_actors.messages import Array


def read_only(array: Array) -> Array:
    """A view that cannot be written to; a kernel that is compiled for a run then serves the test too."""
    view = array.view()
    view.setflags(write=False)
    return view
