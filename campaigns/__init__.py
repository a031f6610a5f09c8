"""Questions that take longer than a test, each asked many times: `python -m campaigns NAME`."""

from pathlib import Path

from needle_rig.workbench.parallel import one_thread_each

ROOT = Path(__file__).resolve().parents[1]
one_thread_each()  # before NumPy is imported: a campaign runs one process a core
