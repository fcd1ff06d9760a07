"""``report.html``: results and progress of a run, in one file that needs no server."""
