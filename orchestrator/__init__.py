"""Many streams: the command line, stream lists, sources, admission, sinks, the record and its reports.

``mlbs_actors`` processes the frames of one stream; this package delivers them and keeps the results. The
command ``mlbs-actors`` is its face; for programs there is this:

=================================  ===================================================================
``Zones``                          events of zones, lines and rules from a program's own results
``Zone``, ``Minimum``, ``Rule``    what they are made of
``Event``                          something that happened
``start``, ``Run``                 streams at work, in a Ray session that exists or one of their own
``StreamResult``                   what they give
=================================  ===================================================================

:mod:`orchestrator.evaluation` has ``open_sequence`` for research. All else are parts of a run, which need the
extra ``run``.
"""

import sys

from orchestrator.module_path import is_being_started, leave_working_folder

if is_being_started(sys.argv, sys.orig_argv):
    leave_working_folder()

TYPE_CHECKING = False  # as of typing, which is not imported before the line above
if TYPE_CHECKING:
    from orchestrator.events.event import Event
    from orchestrator.events.result_zones import Zones
    from orchestrator.events.rules import Rule
    from orchestrator.events.zones import Minimum, Zone
    from orchestrator.library.result import StreamResult
    from orchestrator.library.run import Run
    from orchestrator.library.starting import start

__all__ = ["Event", "Minimum", "Rule", "Run", "StreamResult", "Zone", "Zones", "start"]

#: The modules of these names, which are imported when they are asked for.
_HOMES = {
    "Event": "orchestrator.events.event",
    "Minimum": "orchestrator.events.zones",
    "Rule": "orchestrator.events.rules",
    "Run": "orchestrator.library.run",
    "StreamResult": "orchestrator.library.result",
    "Zone": "orchestrator.events.zones",
    "Zones": "orchestrator.events.result_zones",
    "start": "orchestrator.library.starting",
}

if not TYPE_CHECKING:  # hidden from type checkers, which would accept every name

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        return getattr(import_module(_HOMES[name]), name)
