"""The engine on Ray: thin shells around its parts, one process a part, one a layer."""

from mlbs_actors.actors.node.cluster import Cluster
from mlbs_actors.actors.node.pool import PoolCensus, PoolPolicy
from mlbs_actors.actors.pipeline import Node, StreamActors

__all__ = ["Cluster", "Node", "PoolCensus", "PoolPolicy", "StreamActors"]
