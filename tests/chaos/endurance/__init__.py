"""Long runs, and what being able to recover costs.

Read :mod:`~chaos.endurance.soak` first: memory, processes and open files over time. Then
:mod:`~chaos.endurance.recovery_cost`: the rate of records that survive a kill beside that of others.
"""
