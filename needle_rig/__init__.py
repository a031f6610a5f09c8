"""needle-rig: takes the torsion windup out of steerable needles, and holds its model against measurements.

`import needle_rig` gives what a notebook needs; see `needle_rig.notebook`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from needle_rig.version import VERSION

if TYPE_CHECKING:
    from needle_rig.notebook import (
        BadInput,
        NeedleRigError,
        SolverError,
        add_effect,
        adopt,
        compare,
        diagnose,
        effects,
        experiment,
        export,
        fit,
        identify,
        import_recording,
        learn,
        parameters,
        plan,
        read_dataset,
        read_model,
        read_run,
        simulate,
        strategies,
    )

__version__ = VERSION
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


def __getattr__(name: str) -> Any:
    # the daemon's start must not wait for the workbench
    if name in __all__:
        from needle_rig import notebook

        return getattr(notebook, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
