"""A run whose results are in an object store: ``--output s3://BUCKET/PREFIX`` instead of a folder.

The run works in a scratch folder of this machine, as any other; a publisher copies what a commit made certain
to the store, where one manifest after the other says what counts. Read in this order: ``address``, ``store``,
``manifest``, ``ledger`` (who may publish), ``held_files`` (a state of the folder that fits together),
``uploads``, ``publisher``, ``fetching``. :mod:`orchestrator.run.publication` puts it around a run.
"""
