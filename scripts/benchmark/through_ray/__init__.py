"""Run streams through Ray as users do, and observe their processes from the driver.

Read in this order:

- :mod:`~benchmark.through_ray.process_costs`: CPU time and memory of a process tree, by kind of process
- :mod:`~benchmark.through_ray.recording_parts`: parts of a stream that record what they are, and when
- :mod:`~benchmark.through_ray.pipeline`: a Ray session with streams, and windows of their steady state
- :mod:`~benchmark.through_ray.endless_video`: a source that does not end
- :mod:`~benchmark.through_ray.empty_parts`: parts that send the engine's messages and compute nothing
"""
