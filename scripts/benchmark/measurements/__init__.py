"""What can be measured, one module for each name that ``scripts/bench --measure`` takes.

In this process: :mod:`~benchmark.measurements.methods`, :mod:`~benchmark.measurements.sizes`. In this process
and through Ray: :mod:`~benchmark.measurements.layers`, :mod:`~benchmark.measurements.births`. Through Ray:
:mod:`~benchmark.measurements.ray_cost`, :mod:`~benchmark.measurements.memory`,
:mod:`~benchmark.measurements.streams`, the last against the simulation in
:mod:`~benchmark.measurements.node_model`.
"""
