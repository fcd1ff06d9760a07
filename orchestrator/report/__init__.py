"""``report.html``: what a run found and how it went, in one file that needs no server."""
