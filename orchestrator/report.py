"""``report.html``: how each stream of a run ended, in one file that needs no server."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from typing import Any
from urllib.parse import quote

from orchestrator.stream_state import StreamState

__all__ = ["render_report"]

_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>Run of {started}</title>
<style>
:root {{ color-scheme: light dark; font: 16px/1.5 system-ui, sans-serif; }}
body {{ max-width: 70rem; margin: 2rem auto; padding: 0 1rem; }}
table {{ border-collapse: collapse; width: 100%; }}
th, td {{ text-align: left; padding: .3rem .6rem; border-bottom: 1px solid #8886; vertical-align: top; }}
td.number, th.number {{ text-align: right; font-variant-numeric: tabular-nums; }}
pre {{ overflow-x: auto; }}
</style>
<h1>{whole} of {count} streams complete</h1>
<p>Started {started}; exit status {exit_status}.</p>
<table>
<thead><tr><th scope="col">stream</th><th scope="col">state</th>
<th scope="col" class="number">frames read</th>
<th scope="col" class="number">label maps</th><th scope="col" class="number">undecodable</th>
<th scope="col">files</th><th scope="col">note</th></tr></thead>
<tbody>
{rows}
</tbody>
</table>
<h2>Run</h2>
<pre>{description}</pre>
</html>
"""

_ROW = (
    '<tr><th scope="row">{name}</th><td>{state}</td><td class="number">{read}</td>'
    '<td class="number">{committed}</td><td class="number">{quarantined}</td>'
    '<td><a href="{link}/">{name}/</a></td><td>{error}</td></tr>'
)


def render_report(description: dict[str, Any], states: Sequence[StreamState], exit_status: int) -> str:
    """Make the page.

    Parameters
    ----------
    description : dict
        Content of ``run.json``.
    states : sequence of StreamState
    exit_status : int
    """
    rows = "\n".join(
        _ROW.format(
            name=escape(state.name),
            link=escape(quote(state.name)),
            state=state.state,
            read=state.read,
            committed=state.committed,
            quarantined=state.quarantined,
            error=escape(state.error or ""),
        )
        for state in states
    )
    return _PAGE.format(
        started=escape(str(description["started"])),
        whole=sum(state.state == "done" for state in states),
        count=len(states),
        exit_status=exit_status,
        rows=rows,
        description=escape(json.dumps(description, indent=2)),
    )
