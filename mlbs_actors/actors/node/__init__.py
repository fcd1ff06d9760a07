"""A node's processes: the pool of layer processes, limits on bursts, clusters of nodes, failures.

``cluster`` chooses the node of a stream, whose share of it is a ``reservation``. ``pool`` owns its layer
processes (``processes``), as many as fit into ``memory``, ``burst_limiter`` bounds the streams of files at
work, ``failures`` explains why a process was lost. ``priority``, ``idle_threads`` and ``process_memory`` set
up a process; ``usage`` measures what a stream's processes take.
"""
