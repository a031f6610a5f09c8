"""Runs a benchmark by its name; without one, lists them."""

import sys

from campaigns.command import by_name

if __name__ == "__main__":
    sys.exit(by_name("benchmarks", sys.argv[1:]))
