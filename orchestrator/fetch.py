"""Makes a folder of a run in an object store: ``mlbs-actors fetch s3://BUCKET/PREFIX DIR``.

All that reads a run's folder, such as the report and the exports, works on it. The run may be at work.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from orchestrator.program import program_name

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 fetched, 1 it failed, 2 it cannot be done."""
    parser = argparse.ArgumentParser(
        prog=f"{program_name()} fetch",
        description="Make a folder of what a run has published in an object store.",
        allow_abbrev=False,
    )
    parser.add_argument("address", metavar="ADDRESS", help="as given to --output, s3://BUCKET/PREFIX")
    parser.add_argument("folder", type=Path, metavar="DIR", help="a folder that is not there yet")
    given = parser.parse_args(argv)
    folder: Path = given.folder
    # Imported here: the help needs nothing that is installed.
    from mlbs_actors.errors import ConfigError
    from orchestrator.object_storage.address import parse_store_address
    from orchestrator.object_storage.fetching import fetch
    from orchestrator.object_storage.store import StoreError, open_store

    try:
        address = parse_store_address(given.address)
        if address is None:
            raise ConfigError(
                f"{given.address} is no address of an object store, such as s3://BUCKET/PREFIX."
            )
        if folder.exists():
            raise ConfigError(f"{folder} is there already; name another folder.")
        count = fetch(open_store(address), folder)
    except ValueError as error:
        print(f"ADDRESS {error}", file=sys.stderr)
        return 2
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except (StoreError, OSError) as error:
        print(f"{given.address} cannot be fetched: {error}.", file=sys.stderr)
        return 1
    if not count:
        folder.rmdir()
        print(f"There is no run at {address}.", file=sys.stderr)
        return 2
    print(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
