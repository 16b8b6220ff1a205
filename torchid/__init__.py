"""torchid: what a robot arm's dynamics really are, and why the simulator disagrees.

The public names load on first use, so that `import torchid` is quick and thread settings can
still be made before torch loads. Their types are in __init__.pyi.
"""

from importlib import import_module

from torchid.other_packages import PUBLIC

__version__ = "0.3.0"

_PUBLIC = PUBLIC | {
    "Robot": "torchid.robot.model",
    "InertialParameters": "torchid.robot.inertia",
    "load_robot": "torchid.robot.library",
    "write_robot": "torchid.robot.writer",
    "tool_pose": "torchid.robot.model",
    "Log": "torchid.log.model",
    "read_log": "torchid.log.readers",
    "write_log": "torchid.log.readers",
    "examine": "torchid.doctor.examine",
    "inverse_dynamics": "torchid.effects.model",
    "joint_wrenches": "torchid.dynamics.newton_euler",
    "mass_matrix": "torchid.dynamics.forward",
    "forward_dynamics": "torchid.effects.model",
    "regressor": "torchid.dynamics.regressor",
    "excite": "torchid.excitation.design",
    "simulate": "torchid.excitation.synthetic",
    "HonestNoise": "torchid.simulation.sensors",
    "PaperNoise": "torchid.excitation.synthetic",
    "identify": "torchid.identification.identify",
    "Settings": "torchid.identification.settings",
    "payload": "torchid.identification.payload",
    "problem_of": "torchid.extraction.from_identification",
    "extract": "torchid.extraction.extract",
    "best_set": "torchid.extraction.found",
    "near_set": "torchid.extraction.methods",
    "SearchSettings": "torchid.extraction.settings",
    "atlas": "torchid.extraction.convex.atlas",
    "ParameterSets": "torchid.feasibility.sets",
    "read_sets": "torchid.feasibility.sets",
    "check": "torchid.feasibility.record",
    "export_dynamics": "torchid.export.export",
    "load_model": "torchid.export.model",
    "correct": "torchid.export.correct",
    "randomise": "torchid.export.randomise",
    "diagnose": "torchid.gap.diagnose",
    "Diagnosis": "torchid.results.answer",
    "GapSettings": "torchid.gap.settings",
    "ServoArm": "torchid.position.model",
    "replay": "torchid.position.replay",
    "compare_pair": "torchid.pair.pair",
    "calibrate": "torchid.withheld.planted",
    "compare_results": "torchid.fleet.compare",
    "excite_for": "torchid.next_motion.design",
    "load": "torchid.results.files",
    "draw": "torchid.report.plots",
    "TorchidError": "torchid.errors",
}

__all__ = [*_PUBLIC, "__version__"]  # noqa: PLE0604


def __getattr__(name: str) -> object:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'torchid' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
