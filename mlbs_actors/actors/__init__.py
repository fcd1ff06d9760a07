"""The engine on Ray: thin shells around its parts, one process a part, one a layer.

``pipeline`` starts the streams of one node, ``node.cluster`` those of many. ``stream`` has the processes of a
stream, ``node`` those of a node, ``ipc`` how they communicate; the shells know the engine through ``parts``.

Nothing is imported here: ``stream.protocol``, the interface to the orchestrator, needs no Ray.
"""
