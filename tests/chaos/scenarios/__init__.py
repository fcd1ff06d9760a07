"""The faults that are injected, a module for each kind; :mod:`~chaos.scenarios.catalogue` lists them.

From the source to the machine: :mod:`~chaos.scenarios.damaged_sources`, :mod:`~chaos.scenarios.lost_frames`,
:mod:`~chaos.scenarios.lost_processes`, :mod:`~chaos.scenarios.lost_camera_processes`,
:mod:`~chaos.scenarios.ended_commands`, :mod:`~chaos.scenarios.scarce_resources`. Beside them
:mod:`~chaos.scenarios.kills`: each kind of process killed at each of its steps.
"""
