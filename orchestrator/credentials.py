"""Keeps passwords and tokens of stream addresses out of everything that is shown or stored.

Every text that may hold an address goes through :func:`mask` where it leaves the code that needs the
secret: messages of libav, the run's files, the progress. It errs on the side of hiding too much.
"""

from __future__ import annotations

import re

__all__ = ["MASK", "PASSWORD_VARIABLE", "mask"]

#: Replacement of a secret.
MASK = "***"

#: Environment variable with the password of targets of events that name a user only.
PASSWORD_VARIABLE = "MLBS_EVENTS_PASSWORD"

# Greedy up to the last @ of the word: a password may itself hold "/", "@", ":" or a quote.
_USER_INFO = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*://)\S*@")

# "password=…" in a query, or in the path as some recorders want it; the value ends at & or white space,
# because a password may hold any other separator.
_SECRET_PARAMETER = re.compile(
    r"((?:password|passwd|passphrase|loginpas|pass|pwd|secret|token|api_?key|key|auth|authbasic|signature|sig"
    r"|streamid)=)[^\s&]+",
    re.IGNORECASE,
)


# Who knows the last part of such an address can send to it.
_STREAM_KEY = re.compile(r"(rtmps?://[^\s/]+/[^\s/]+/)\S+", re.IGNORECASE)


def mask(text: str) -> str:
    """Return ``text`` with the user information and secret parameters of all addresses hidden.

    Examples
    --------
    >>> mask("cannot open rtsp://bob:s3cret@10.0.0.7/door?token=abc&channel=1")
    'cannot open rtsp://***@10.0.0.7/door?token=***&channel=1'
    """
    without_user = _USER_INFO.sub(rf"\g<1>{MASK}@", text)
    without_parameters = _SECRET_PARAMETER.sub(rf"\g<1>{MASK}", without_user)
    return _STREAM_KEY.sub(rf"\g<1>{MASK}", without_parameters)
