"""Store the golden files anew: `python -m tests.golden.write options schemas`."""

import json
import sys

from tests.golden.options import STORED, table


def write_options() -> None:
    STORED.write_text(json.dumps(table(), indent=1) + "\n")


if __name__ == "__main__":
    if "options" in sys.argv[1:]:
        write_options()
