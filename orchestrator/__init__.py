"""Many streams: the command line, stream lists, sources, admission, sinks, the record and its reports.

``mlbs_actors`` processes the frames of one stream; this package delivers them and keeps the results. Programs
start streams with :func:`start`.
"""

import sys
from typing import TYPE_CHECKING, Any

from orchestrator.module_path import is_being_started, leave_working_folder

if TYPE_CHECKING:
    from orchestrator.library.result import StreamResult
    from orchestrator.library.run import Run
    from orchestrator.library.starting import start

__all__ = ["Run", "StreamResult", "start"]

#: Where they are: imported when they are asked for, as the command and its help start in no time.
_PLACES = {
    "Run": "orchestrator.library.run",
    "StreamResult": "orchestrator.library.result",
    "start": "orchestrator.library.starting",
}

if is_being_started(sys.argv, sys.orig_argv):
    leave_working_folder()


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_PLACES[name]), name)
