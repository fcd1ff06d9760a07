"""``--monitor``: one page that shows a run live."""
