"""Run the engine, and what one could use instead, in this process and in one thread.

Read in this order:

- :mod:`~benchmark.in_process.engine_run`: time every call of the engine alone
- :mod:`~benchmark.in_process.peers`: subtractors made of OpenCV in a few lines each
- :mod:`~benchmark.in_process.comparison`: the engine and the peers on the same frames, timed and scored
"""
