"""What `needle-rig --help` shows: each command in its group with one line, and what people look for."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

GROUPS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "The rig": {
            "compensate": "Turn the needle to an angle, and take the windup out.",
            "status": "Show the daemon's phase, sensors and faults.",
            "stop": "Stop the drive.",
            "clear": "Leave a fault once its cause is gone.",
            "jog": "Turn the base by an angle, or to one.",
            "home": "Turn the base to 0°, or find its zero again.",
            "hold": "Let the drive keep the base where it is.",
            "release": "Let go of the base.",
            "runs": "List the recorded runs, or remove old ones.",
            "export": "Write a run as CSV, MCAP, picture or dataset.",
            "watch": "Say which parameter has left its range, run by run.",
        },
        "Data and models": {
            "demo": "Go round the whole circle on a simulated rig.",
            "simulate": "Write a dataset with an effect that you choose.",
            "import": "Bring in recordings of other laboratories.",
            "compare": "Show where a model fails on data, worst first.",
            "identify": "Fit rigidity, friction and damping, with intervals.",
            "diagnose": "Name the effect that the model lacks.",
            "learn": "Find a law that no effect holds.",
            "adopt": "Add what a diagnosis names to the model.",
            "history": "Show how a model's error fell, step by step.",
            "experiment": "Propose the trial that separates two effects.",
            "strategies": "Compare all strategies on one simulated rig.",
            "reproduce": "Show the paper's results beside ours.",
            "parameters": "List the parameter sets, or show one.",
        },
        "Your own": {
            "new": "Write an effect, strategy, device, dataset or rig file.",
            "effects": "List the effects, check your own, or show one.",
            "check-device": "Hold a device to what every device must do.",
            "layout": "Say, and draw, what was understood of a shaft.",
        },
        "Service and set-up": {
            "web": "Serve the page on this computer.",
            "daemon": "Own the rig and serve it on a socket.",
            "install-service": "Set up the service that owns a real rig.",
            "check": "Look at all that a rig needs.",
            "backup": "Pack rig file, calibration and models into one file.",
            "restore": "Put a backup in place.",
            "report": "Pack what an issue needs into one file.",
            "calibrate": "Calibrate a node, step by step.",
            "bench": "Run the plant behind the nodes' firmware.",
            "firmware": "Build the nodes' firmware.",
        },
    }
)

LOOKED_FOR: Mapping[str, str] = MappingProxyType(
    {
        "convert": "import",
        "fit": "identify",
        "init": "new",
        "plot": "compare",
        "run": "compensate",
        "validate": "check",
    }
)
"""What people type for a command that has another name."""
