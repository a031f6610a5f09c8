"""How long something takes, and what of a computer it needs: `python -m benchmarks NAME`."""

from needle_rig.workbench.parallel import one_thread_each

one_thread_each()  # before NumPy is imported: threads would be timed with it
