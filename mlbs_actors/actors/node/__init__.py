"""A node's processes: the pool of layer processes, turns between streams, clusters of nodes, failures.

``cluster`` chooses the node of a stream, ``pool`` owns its layer processes (``processes``), as many as the
``memory`` holds, ``turns`` has streams of files take turns, ``failures`` says why a process was lost.
``priority``, ``idle_threads`` and ``process_memory`` set up a process.
"""
