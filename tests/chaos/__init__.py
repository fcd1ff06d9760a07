"""Inject faults into real runs of the command; report which are survived. Started by ``scripts/chaos``.

It is no part of the wheel. Read in this order:

- :mod:`chaos.options`, :mod:`chaos.command`: the options, and the table of what was survived
- :mod:`chaos.harness`: how a run is started, observed, disturbed and compared with an undisturbed one
- :mod:`chaos.scenarios`: the faults, one module for each kind
- :mod:`chaos.endurance`: long runs, and what being able to recover costs

``test_chaos.py`` tests this program itself, and brings a few quick faults about.
"""
