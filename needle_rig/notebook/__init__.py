"""The workbench for notebooks and scripts: `import needle_rig as nr`, and results that show themselves.

Results have `table()`, a NumPy structured array that `pandas.DataFrame` takes as it is, `to_pandas()`,
`plot()`, a Matplotlib figure, and a picture of themselves in Jupyter. Angles are in degrees and torques in
N·mm here, as in files and commands. Errors are `needle_rig.BadInput` and its like: one sentence with place,
value and next step.
"""

from needle_rig.errors import BadInput, NeedleRigError, SolverError
from needle_rig.notebook.catalogue import effects, parameters
from needle_rig.notebook.questions import (
    add_effect,
    adopt,
    compare,
    diagnose,
    experiment,
    fit,
    identify,
    learn,
    plan,
    strategies,
)
from needle_rig.notebook.sources import (
    export,
    import_recording,
    read_dataset,
    read_model,
    read_run,
    simulate,
)

__all__ = [
    "BadInput",
    "NeedleRigError",
    "SolverError",
    "add_effect",
    "adopt",
    "compare",
    "diagnose",
    "effects",
    "experiment",
    "export",
    "fit",
    "identify",
    "import_recording",
    "learn",
    "parameters",
    "plan",
    "read_dataset",
    "read_model",
    "read_run",
    "simulate",
    "strategies",
]
