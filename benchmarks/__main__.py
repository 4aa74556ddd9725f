"""Runs the benchmarks: `python -m benchmarks [NAME ...]`; `make bench` installs the peers first."""

from benchmarks.suite import main

if __name__ == "__main__":
    main()
