"""Controls: of small simulated arms of which nothing has changed nothing new is named; what counts
as named, and the page of real arms."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

import torchid
from tests.gap.small_logs import NOISE, ROBOT, Recording, arm, friction, logged
from torchid.errors import LogError
from torchid.log.model import Log
from torchid.robot.model import Robot
from torchid.yaml_data import parsed_yaml
from torchid_bench.benchmarks import controls
from torchid_bench.benchmarks.controls import ALTERED, Control, new_names, said

pytestmark = pytest.mark.usefixtures("types_unchecked")

HEALTHY = arm(friction(1, Fc=0.5), friction(2, Fv=0.8))
ARMS = parsed_yaml(controls.TABLE.read_text())


def recording(seed: int) -> Recording:
    return Recording(runs=(seed,), seed=seed)


@pytest.fixture(scope="module")
def model_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """What a diagnosis of one motion leaves, saved with its log."""

    @cache
    def made(seed: int) -> Path:
        path = tmp_path_factory.mktemp("model") / "arm.yaml"
        torchid.diagnose(ROBOT, logged(HEALTHY, recording(seed))).write_corrected(path)
        return path

    return made


JITTER = pytest.mark.xfail(
    strict=True,
    reason="noise of 1e-3 of the way on positions becomes, differentiated twice, torque that is no "
    "noise of the torque channel: where it is large for a moment, a push is named",
)
ASKED: dict[str, Callable[[Log, Robot], Log]] = ALTERED | {
    "another motion": lambda log, robot: logged(HEALTHY, recording(7)),
}


@pytest.mark.parametrize(
    ("kind", "seed"),
    [*((kind, 0) for kind in ASKED), pytest.param("1e-3 noise", 2, marks=JITTER)],
)
def test_of_a_healthy_arm_nothing_new_is_named(
    kind: str, seed: int, model_of: Callable[[int], Path]
) -> None:
    model = model_of(seed)
    log = ASKED[kind](logged(HEALTHY, recording(seed)), torchid.load_robot(model))
    found = said(torchid.diagnose(model, log))
    assert found["since"]
    assert not new_names(found), found["headline"]


def test_of_a_healthy_arm_that_stands_nothing_can_be_named(model_of: Callable[[int], Path]) -> None:
    """It is held at its first pose, and nobody pushes it."""
    log = logged(HEALTHY, recording(0))
    q = log.q[:1].expand_as(log.q)
    noise = torch.randn(q.shape, generator=torch.Generator().manual_seed(0)).double()
    tau = torchid.inverse_dynamics(ROBOT, q, 0 * q, 0 * q) + NOISE * noise
    with pytest.raises(LogError, match="stands still"):
        torchid.diagnose(model_of(0), log.replace(q=q, tau=tau))


def in_mujoco(file: str) -> Log:
    """MuJoCo's own log of its file: positions, velocities and the force that it applies, without
    noise, while the arm follows sines that reach no limit."""
    model = mujoco.MjModel.from_xml_path(file)
    model.opt.timestep = 1e-3
    data, plan, random = mujoco.MjData(model), mujoco.MjData(model), np.random.default_rng(0)
    w = 2 * np.pi * random.uniform(0.1, 0.6, (2, model.nv))
    phase = random.uniform(0, 2 * np.pi, w.shape)

    def sines(t: float, k: int) -> np.ndarray:
        """Their k-th derivative."""
        return (0.4 * w**k * np.sin(w * t + phase + k * np.pi / 2)).sum(0)

    data.qpos[:], data.qvel[:], rows = sines(0.0, 0), sines(0.0, 1), []
    for _ in range(10_000):
        plan.qpos, plan.qvel = data.qpos, data.qvel
        # Computed torque: of a controller of 2 Hz.
        error = sines(data.time, 0) - data.qpos, sines(data.time, 1) - data.qvel
        plan.qacc = sines(data.time, 2) + 160 * error[0] + 25 * error[1]
        mujoco.mj_inverse(model, plan)
        data.qfrc_applied = plan.qfrc_inverse
        now = [[data.time] * model.nv, data.qpos, data.qvel, data.qfrc_applied]
        rows.append(np.array(now))
        mujoco.mj_step(model, data)
    t, q, dq, tau = torch.tensor(np.array(rows)[::10]).unbind(1)
    return Log(t[:, 0], q, dq=dq, tau=tau)


def test_of_mujocos_own_log_nothing_is_named(tmp_path: Path) -> None:
    done = torchid.export_dynamics(HEALTHY, "mjcf", tmp_path, nominal=ROBOT, geometry="none")
    found = said(torchid.diagnose(done.files[0], in_mujoco(str(done.files[0]))))
    assert not new_names(found), found["headline"]


SERVO = """<mujoco><compiler angle="radian" autolimits="true"/>
  <option timestep=".001" integrator="implicitfast"/><worldbody><body>
    <joint name="a" axis="0 1 0" damping=".04" frictionloss=".05" armature=".01"/>
    <inertial pos=".12 0 0" mass=".7" diaginertia=".002 .003 .003"/></body></worldbody>
  <actuator><position joint="a" kp="14" kv=".5" {}/></actuator></mujoco>"""


@pytest.mark.parametrize("limit", ["", 'forcerange="-9 9"'])
def test_of_mujocos_own_log_of_a_servo_nothing_is_named(limit: str, tmp_path: Path) -> None:
    """Commands jump, are held for 20 ms, and positions are counts of 4096 a turn."""
    (tmp_path / "arm.xml").write_text(SERVO.format(limit))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data, random, t = mujoco.MjData(model), np.random.default_rng(1), np.arange(500) / 50
    jumps = np.cumsum(random.uniform(0.5, 1.1, 60))
    u = 0.9 * random.uniform(-1, 1, 61)[np.searchsorted(jumps, t)] + 0.15 * np.sin(4 * t)
    data.qpos[:], q = u[0], np.empty((500, 1))
    for k in range(500):
        q[k], data.ctrl[:] = data.qpos, u[k]
        mujoco.mj_step(model, data, 20)
    count = 2 * np.pi / 4096
    log = Log(t, np.round(q / count) * count, u=u[:, None])  # type: ignore[arg-type]
    found = said(torchid.diagnose(tmp_path / "arm.xml", log))
    assert not new_names(found), found["headline"]


# The table, and the page that is made of it.


def test_pairs_are_of_other_motions_of_healthy_arms() -> None:
    every = list(controls.controls_of(ARMS))
    pairs = [c for c in every if c.kind == controls.PAIR]
    assert len({c.name for c in every}) == len(every)
    assert len(pairs) == 26
    assert all(c.model != c.asked for c in pairs)
    assert max(sum(c.arm == arm for c in pairs) for arm in ARMS) <= 6
    files = " ".join(f"{c.model} {c.asked}" for c in pairs)
    assert not [word for word in ("loaded_2", "_loaded", "sim", "pulses") if word in files]


def name(sure: float | None, new: bool = True, share: float = 0.25) -> dict[str, Any]:
    return {"name": "payload", "size": "1 kg", "sure": sure, "share": share, "new": new}


def answer(*names: dict[str, Any], since: str | None = "a", **more: Any) -> dict[str, Any]:
    base = {"status": "explained", "why": "", "seconds": 2.0, "headline": "Payload."}
    return base | {"since": since, "names": list(names)} | more


PAIR = Control("arm", controls.PAIR, "log_a", "log_b")
FAILED = {"why": "said why", "seconds": 240.0}


@pytest.mark.parametrize(
    ("result", "outcome", "cells"),
    [
        (answer(name(0.97)), "named", "| 1 | 1 | payload (1 kg; 0.97; 25 %) | 0 | 2 |"),
        (answer(name(0.97, share=1e-4)), "named", "payload (1 kg; 0.97; 0.01 %)"),
        (answer(name(0.6), name(0.99, False)), "named", "| 1 | 0 | payload (1 kg; 0.60; 25 %) |"),
        (answer(name(0.5), name(None)), "silent", "| 0 | 0 |  | 0 | 2 |"),
        (answer(name(0.97, False)), "silent", "| 0 | 0 |  | 1 | 2 |"),
        (answer(name(0.97), since=None), "named, no earlier log", "| 1 | 1 |"),
        (answer(*5 * [name(0.97)]), "named", "; 1 more | 0 |"),
        ({"status": "refused"} | FAILED, "refused", "| 0 | 0 | said why | 0 | 240 |"),
        ({"status": "error"} | FAILED, "exit 70", "| 0 | 0 | said why | 0 | 240 |"),
        ({"status": "out_of_time"} | FAILED, "out of time", "| 0 | 0 | said why | 0 | 240 |"),
    ],
)  # fmt: skip
def test_what_is_new_is_counted(result: dict[str, Any], outcome: str, cells: str) -> None:
    (row,) = (
        line
        for line in controls.page_of({PAIR: result}, [], 240.0).splitlines()
        if line.startswith("| arm: a, asked of b |")
    )
    assert row.startswith(f"| arm: a, asked of b | {outcome} |")
    assert cells in row


def test_a_line_sums_up() -> None:
    half = Control("arm", "half the rate", "log_a", "log_a")
    done = {PAIR: answer(name(0.97)), half: answer()}
    later = Control("leg", controls.PAIR, "log_a", "log_b")
    text = controls.page_of(done, [PAIR, half, later], 240.0)
    assert text.endswith("\nNot asked yet: leg: a, asked of b.\n")
    pairs, every = controls.summary(done)
    assert pairs.startswith(
        "**1 pairs of other motions: new names above 0.5 in 1, above 0.9 in 1; "
    )
    assert every == (
        "**2 controls: new names above 0.5 in 1, above 0.9 in 1; 0 exit 70, 0 refused, 0 out of "
        "time; CPU s median 2, worst 2.**"
    )


def test_an_arm_is_asked_once_and_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log that has no torque makes no model: what is asked of that is refused, and kept."""
    folder = tmp_path / "data" / "arm"
    folder.mkdir(parents=True)
    torchid.write_robot(ROBOT, folder / "robot.yaml")
    log = logged(HEALTHY, recording(0))
    for file in ("log_a", "log_b"):
        torchid.write_log(log.replace(tau=None), folder / f"{file}.parquet")
    table, page = tmp_path / "table.yaml", tmp_path / "page.md"
    table.write_text("arm: {robot: robot.yaml, pairs: [[log_a, log_b]], alone: log_a}")
    monkeypatch.setattr(controls, "TABLE", table)

    def run() -> int:
        return controls.main(data=tmp_path / "data", work=tmp_path / "work", page=page)

    assert run() == 0
    text = page.read_text()
    assert text.count("| refused | 0 | 0 | there is no model") == 1 + len(ALTERED)
    assert ": a, made a model: refused; " in capsys.readouterr().out
    assert "**6 controls: new names above 0.5 in 0, above 0.9 in 0; 0 exit 70, 6 refused" in text
    monkeypatch.setattr(torchid, "load_robot", None)  # nothing is asked again
    assert run() == 0
    assert page.read_text() == text
    kept = next(f for f in (tmp_path / "work").glob("arm-a-asked-of-b*.json"))
    kept.write_text(json.dumps(answer(name(0.97))))
    assert run() == 1
    assert controls.main(data=tmp_path / "data", rows=("leg",)) == 2
    assert "no arm leg; there are arm" in capsys.readouterr().out


def test_without_logs_it_says_so_and_ends_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert controls.main(data=tmp_path / "absent") == 0
    assert capsys.readouterr().out.startswith("Controls are skipped: no folder of real logs at")
