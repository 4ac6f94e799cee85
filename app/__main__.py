"""`piezomat` and `python3 -m app`: the command line, after a look at what the process finds around it."""

from __future__ import annotations

import sys

from piezomat.environment import prepare


def main() -> int:
    """Exit status of the command line of this process. Collective over all ranks."""
    wrong = prepare(sys.argv[1:])
    if wrong is not None:
        print(f"piezomat: {wrong}", file=sys.stderr)
        return 2
    from piezomat import cli

    return cli.main()


if __name__ == "__main__":
    raise SystemExit(main())
