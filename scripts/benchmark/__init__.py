"""Measure what frames cost: the benchmark, started by ``scripts/bench``. It is no part of the wheel.

Read in this order:

- :mod:`benchmark.options`, :mod:`benchmark.command`: the options, and which measurement each name stands for
- :mod:`benchmark.settings`, :mod:`benchmark.result`, :mod:`benchmark.plots`: what a measurement is given and
  what it returns
- :mod:`benchmark.in_process`: the engine, and OpenCV's subtractors beside it, in this process
- :mod:`benchmark.through_ray`: whole streams through Ray, and the processes that they consist of
- :mod:`benchmark.measurements`: the measurements themselves
"""
