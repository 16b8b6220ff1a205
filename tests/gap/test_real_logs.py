"""The diagnosis on logs of real arms, which are not part of the project."""

from dataclasses import replace

import pytest
import torch

from tests.real_logs import FOLDER, NEEDS_LOGS
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.log.model import Log
from torchid.log.readers import read_log
from torchid.robot.library import load_robot

UR10E_GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
FRICTION = ("viscous_friction", "coulomb_friction", "torque_offset")
LIKE_A_LOAD = (
    "payload",
    "link_inertia",
    "torque_gain",
    "joint_spring",
    "encoder_offset",
    "base_tilt",
)

pytestmark = [*NEEDS_LOGS, pytest.mark.usefixtures("types_unchecked")]


@pytest.mark.nightly
def test_a_pandas_wrist_slides_before_it_moves():
    """Its last 40 % take part in no choice; the effect on joint 7 is most of its gap."""
    found = diagnose_torque(
        load_robot(str(FOLDER / "panda_gaz" / "robot.yaml")),
        read_log(FOLDER / "panda_gaz" / "log_exciting_traj1.parquet"),
        settings=GapSettings(background=FRICTION, held_out_fraction=0.4),
    )
    assert ("presliding_hysteresis", (6,)) in [(f.effect, f.joints) for f in found.which]
    assert float(found.how_far.rms_after[6]) < 0.6 * float(found.how_far.rms_before[6])
    assert any("no inertial parameters" in w for w in found.warnings)


def test_a_payload_is_named_and_weighed():
    """The UR10e without and with 2.6 kg, three weeks apart: among what could pass for a load."""

    def log(name: str) -> Log:
        gains = torch.tensor(UR10E_GAINS, dtype=torch.float64)
        return read_log(FOLDER / "ur10e" / f"log_{name}.parquet").with_torque(gains)

    few = GapSettings(effects=(*FRICTION, *LIKE_A_LOAD))
    settings = replace(few, parameters="free", background=FRICTION)
    empty = diagnose_torque(
        load_robot(str(FOLDER / "ur10e" / "robot.urdf")), log("unloaded_dec23"), settings=settings
    )
    loaded = diagnose_torque(empty.corrected, log("loaded_2p6kg_jan13"), settings=few)
    best = max(loaded.which, key=lambda f: f.alone)
    assert best.effect == "payload"
    mass, std = best.parameters["m"], best.std["m"]
    assert abs(mass / 2.6 - 1) < 0.1
    assert 0 < std < 0.2
