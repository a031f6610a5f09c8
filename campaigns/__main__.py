"""Runs a campaign by its name; without one, lists them."""

import sys

from campaigns.command import by_name

if __name__ == "__main__":
    sys.exit(by_name("campaigns", sys.argv[1:]))
