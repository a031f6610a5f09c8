"""The compiled solver: implicit steps of the rod and the choice of their lengths.

One step solves K θ + r = f (K tridiagonal, f torque laws) together with the law of each node (see `Rod`) at
the end of the step: a bounded linear complementarity problem with a P-matrix, for an active set {stuck,
slipping +, slipping −}. From the inside out:

- `layout`: rows of the arrays, records, how a run ends; `laws`: torque laws as addresses of machine code
- `tridiagonal`: the linear system of an active set; `active_set`: the complementarity problem
- `slip_limits`: limits with a memory; `step`: an implicit Euler step, the prediction of its active set and
  the projection to the admissible set
- `step_length`, `dense_output`: how far a step goes; the samples inside it
- `quasi_static`, `sdirk`, `extrapolated`: the three integrators; `run`: what Python calls
- `_compile`, `_cache`: how all of it becomes one piece of machine code, and how long that is kept

Importing `run` compiles; the package and its other modules do not.
"""
