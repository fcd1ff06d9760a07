"""The address of the monitor's page, and the variable with the token that others need."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.loopback import is_loopback

__all__ = ["TOKEN_VARIABLE", "MonitorAddress"]

#: Environment variable that holds the token; a command line would show it to every user of the machine.
TOKEN_VARIABLE = "MLBS_MONITOR_TOKEN"


@dataclass(frozen=True, slots=True)
class MonitorAddress:
    """Address of the page.

    Attributes
    ----------
    host : str
        Name or IP address to listen on.
    port : int
        0 for any free one.
    """

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return is_loopback(self.host)
