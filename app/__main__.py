"""`python3 -m app`: the same commands as `piezomat`."""

from piezomat.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
