"""The engine on Ray: thin shells around its parts, one process a part, one a layer."""

from mlbs_actors.actors.cluster import Cluster
from mlbs_actors.actors.pipeline import Node, StreamActors
from mlbs_actors.actors.pool import PoolCensus, PoolPolicy

__all__ = ["Cluster", "Node", "PoolCensus", "PoolPolicy", "StreamActors"]
