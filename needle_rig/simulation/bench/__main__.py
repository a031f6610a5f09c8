"""`python -m needle_rig.simulation.bench`: the bench as a process of its own."""

import sys

from needle_rig.simulation.bench.process import main

if __name__ == "__main__":
    sys.exit(main())
