"""A fleet's logs pass the doctor's decisive checks, as every other command's do."""

import pytest
import torch

from tests.gap.small_logs import ROBOT, Recording, logged
from torchid.fleet.factors import bodies_explain, reduce_log
from torchid.fleet.manifest import FleetLog
from torchid.fleet.model import FleetModel
from torchid.fleet.settings import FleetSettings
from torchid.fleet.tasks import LogTask, answer_log
from torchid.log.readers import write_log

FAULT = "torque sign of joint 2"


@pytest.mark.parametrize("force", [False, True])
def test_a_wrong_log_is_refused_in_the_same_words_or_used_by_force(tmp_path, force):
    sound = logged(ROBOT, Recording((0,), duration=12.0, noise=0.02))
    sign = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    write_log(sound.replace(tau=sound.tau * sign), tmp_path / "log.parquet")
    model = FleetModel(ROBOT, FleetSettings(force=force))
    log = FleetLog("arm", "monday", str(tmp_path / "log.parquet"))
    row = answer_log(LogTask(log, model, str(tmp_path / "store")))
    said = " ".join(row.evidence)
    assert row.verdict == ("doubtful" if force else "refused")
    assert (f"Wrong log: {FAULT}." if force else f"is not used, it looks wrong: {FAULT}.") in said


def signs(*factors: float) -> torch.Tensor:
    return torch.tensor(factors, dtype=torch.float64)


WRONG = {
    "as it is": lambda log: log,
    "a sign": lambda log: log.replace(tau=log.tau * signs(1.0, -1.0, 1.0)),
    "all signs": lambda log: log.replace(tau=-log.tau),
    "a position's sign": lambda log: log.replace(q=log.q * signs(1.0, -1.0, 1.0), dq=None),
    "order": lambda log: log.replace(tau=log.tau[:, [1, 0, 2]]),
    "unit": lambda log: log.replace(tau=1000 * log.tau),
    "time": lambda log: log.replace(tau=log.tau.roll(20, 0)),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_log_that_bodies_plainly_explain_has_no_fault_to_look_for(fault):
    """What the doctor takes seconds for is asked of the others alone."""
    sound = logged(ROBOT, Recording((0,), duration=12.0, noise=0.02))
    model = FleetModel(ROBOT, FleetSettings())
    reduced = reduce_log(model, iter([WRONG[fault](sound)]))
    assert bodies_explain(model, reduced) is (fault == "as it is")
