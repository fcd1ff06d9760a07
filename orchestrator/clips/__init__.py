"""A clip of each event: the camera's own packets, from some seconds before it to some seconds after.

Read in this order: ``settings`` (of which events, how long, how many), ``packet_ring`` (written by the
process that reads a camera), ``wanted`` (events become cuts, purely), ``cutting`` and ``cutter`` (a process
that makes a clip), ``shelf`` (how many clips stay), ``clips`` (the thread beside the driver that sees to all
of it).
"""

from orchestrator.extra import require_run

require_run()
