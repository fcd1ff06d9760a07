"""What all scenarios share: runs of the command, faults in their processes, and expectations.

Read in this order:

- :mod:`~chaos.harness.observed_run`: a run of the command in a process of its own, and what it recorded
- :mod:`~chaos.harness.injection`: faults at a call of a function, in every process of a run
- :mod:`~chaos.harness.camera`: a network camera that stalls, hangs up and refuses by a script
- :mod:`~chaos.harness.reference`: what an undisturbed stream gives
- :mod:`~chaos.harness.scenario`: a scenario, its faults and verdicts, and what must hold of any run
- :mod:`~chaos.harness.fault_series`: many faults one after the other, and how long a recovery takes
- :mod:`~chaos.harness.loss_series`, :mod:`~chaos.harness.end_series`: such a series in one run, or in runs
  that resume each other
"""
