"""Many streams: the command line, stream lists, sources, admission, sinks, the record and its reports.

``mlbs_actors`` processes the frames of one stream; this package delivers them and keeps the results.
"""

import sys

from orchestrator.module_path import is_being_started, leave_working_folder

if is_being_started(sys.argv, sys.orig_argv):
    leave_working_folder()
