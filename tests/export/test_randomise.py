"""How wide to randomise: what is drawn is what a diagnosis leaves open, and can exist."""

import csv
import json
import runpy
import sys
import types
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

import torchid
from tests.gap.small_logs import ONCE, ROBOT, Recording, arm, carrying, friction, logged
from torchid.errors import TorchidError
from torchid.export.randomise import randomise
from torchid.gap.record import GapRecord
from torchid.gap.settings import GapSettings
from torchid.gap.torque import diagnose_torque
from torchid.identification.base_parameters import base_parameters
from torchid.robot.inertia import InertialParameters

KNOWN = ("coulomb_friction", "viscous_friction", "payload")
TRUE = {("friction", "joint_1"): 1.0, ("friction", "joint_2"): 2.0, ("damping", "joint_2"): 1.5}


@pytest.fixture(scope="module")
def found() -> GapRecord:
    robot = carrying(0.3, (0.05, 0.02, 0.04), 0.002)
    true = arm(friction(1, Fc=1.0), friction(2, Fc=2.0), friction(2, Fv=1.5), robot=robot)
    settings = GapSettings(effects=KNOWN)
    return diagnose_torque(
        ROBOT, logged(true, Recording(ONCE, duration=5.0)), settings=settings
    ).record


@pytest.mark.slow
def test_a_diagnosis_holds_the_covariance_of_all_that_it_names(found: GapRecord) -> None:
    told = found.covariance
    assert told is not None
    std = dict(
        zip(
            [(c.effect, c.names[0]) for c in told.coefficients],
            told.matrix.diagonal().sqrt().tolist(),
            strict=True,
        )
    )
    # The same standard deviations as coefficient by coefficient, and a covariance beside them.
    for one in found.which:
        for name, value in one.std.items():
            place = f"{name}{one.joints[0] + 1}" if one.effect != "payload" else name
            assert std.pop((one.effect, place)) == pytest.approx(value, rel=1e-9)
    assert not std
    values, _ = torch.linalg.eigh(told.matrix)
    assert float(values.min()) > -1e-12 * float(values.max())
    size = told.matrix.diagonal().sqrt()
    assert float((told.matrix / size / size[:, None]).tril(-1).abs().max()) > 0.3


@pytest.mark.slow
def test_draws_have_the_covariance_of_the_fit(found: GapRecord) -> None:
    """Of friction, whose signs and bodies nothing cuts."""
    fields = randomise(friction_alone(found), draws=1024)
    drawn = torch.tensor(
        [[v[0] for e, v in pairs if e.name in KNOWN[:2]] for pairs in fields.draws.effects],
        dtype=torch.float64,
    )
    names = [
        (e.name, e.coefficient_names()[0])
        for e, _ in fields.draws.effects[0]
        if e.name in KNOWN[:2]
    ]
    fit = friction_alone(found).covariance
    order = [[(c.effect, c.names[0]) for c in fit.coefficients].index(n) for n in names]
    expected = fit.matrix[order][:, order]
    got = drawn.T.cov()
    scale = expected.diagonal().sqrt()
    assert float(((got - expected) / scale / scale[:, None]).abs().max()) < 0.1


def friction_alone(found: GapRecord) -> GapRecord:
    """The same fit, of which only friction is not known."""
    told = found.covariance
    assert told is not None
    keep = [k for k, c in enumerate(told.coefficients) if c.effect in KNOWN[:2]]
    fit = msgspec.structs.replace(
        told,
        coefficients=tuple(told.coefficients[k] for k in keep),
        matrix=told.matrix[keep][:, keep],
    )
    return msgspec.structs.replace(found, covariance=fit)


def test_all_bodies_exist_and_vary_as_the_torque_says(found: GapRecord) -> None:
    wide = randomise(found, seed=3)
    bodies = InertialParameters(wide.draws.pi)
    assert len(wide) == 256
    assert wide.draws.nearest == 0
    assert bool((torch.linalg.eigvalsh(bodies.pseudo_inertia) > 0).all())
    # The load's mass is told by the torque; that of the first link by nothing, and stays.
    spread = bodies.mass.std(0) / bodies.mass.mean(0)
    assert float(spread[2]) > 10 * float(spread[0])
    assert torch.equal(wide.draws.pi, randomise(found, seed=3).draws.pi)
    base = base_parameters(ROBOT)
    drawn = base.project(bodies.to_paper_order())
    truth = carrying(0.3, (0.05, 0.02, 0.04), 0.002).require_parameters("a test")
    apart = (drawn.mean(0) - base.project(truth.to_paper_order())) / drawn.std(0)
    varies = drawn.std(0) > 1e-9 * drawn.abs().amax(0)
    assert float(apart[varies].abs().median()) < 2


def test_files_hold_what_was_drawn_and_run_in_their_packages(
    found: GapRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = randomise(found, draws=16)
    files = {f.name: f for f in wide.write(tmp_path, "arm")}
    draws = np.load(files["arm_draws.npz"])
    assert draws["mass"].shape == (16, 3)
    assert draws["inertia_about_com"].shape == (16, 3, 6)
    first = torchid.Robot.require_parameters(wide.one(5), "a test")
    assert np.allclose(draws["com"][5], first.com)
    assert json.loads(str(draws["effects"][5])) == [dict(e) for e in wide.one(5).effects]
    with files["arm_ranges.csv"].open() as stream:
        rows = {(r["field"], r["name"]): r for r in csv.DictReader(stream)}
    for (field, joint), value in TRUE.items():
        row = rows["dof_frictionloss" if field == "friction" else "dof_damping", joint]
        assert float(row["low"]) == pytest.approx(value, abs=0.05)
        assert row["why"]

    # Packages that only note what they are given.
    calls: list[tuple[str, dict[str, object]]] = []

    class Noted:
        def __init__(self, *args: object, **kwargs: object) -> None:
            self.args, self.params = args, kwargs.get("params", {})

    class Asset:
        device = "cpu"

        def find_joints(self, names: list[str], preserve_order: bool) -> tuple[list[int], None]:
            return list(range(len(names))), None

        def write_joint_friction_coefficient_to_sim(self, dry: object, **kw: object) -> None:
            calls.append(("friction", {"dry": dry, **kw}))

        def write_joint_armature_to_sim(self, armature: object, **kw: object) -> None:
            calls.append(("armature", {"armature": armature, **kw}))

    for name in (
        "isaaclab.envs.mdp", "isaaclab.managers", "isaaclab.utils", "mjlab.envs.mdp",
        "mjlab.envs.mdp.dr", "mjlab.managers.event_manager", "mjlab.managers.scene_entity_config",
    ):  # fmt: skip
        parts = name.split(".")
        for k in range(1, len(parts) + 1):
            own = ".".join(parts[:k])
            module = sys.modules.get(own) or types.ModuleType(own)
            monkeypatch.setitem(sys.modules, own, module)
            if k > 1:
                monkeypatch.setattr(
                    sys.modules[".".join(parts[: k - 1])], parts[k - 1], module, raising=False
                )
        for key in ("EventTermCfg", "SceneEntityCfg"):
            monkeypatch.setattr(module, key, Noted, raising=False)
        monkeypatch.setattr(module, "configclass", lambda kind: kind, raising=False)
        for key in ("joint_damping", "joint_friction", "joint_armature", "pseudo_inertia"):
            monkeypatch.setattr(module, key, key, raising=False)
        monkeypatch.setattr(module, "randomize_rigid_body_mass", "mass", raising=False)
    events = runpy.run_path(str(files["arm_mjlab.py"]))["EVENTS"]
    low, high = events["friction_joint_2"].params["ranges"]
    assert low < 2.0 < high + 0.05
    lab = runpy.run_path(str(files["arm_isaaclab.py"]))
    scene = types.SimpleNamespace(num_envs=7)
    env = types.SimpleNamespace(scene={"robot": Asset()})
    env.scene = type("Scene", (dict,), {"num_envs": 7})(env.scene)
    lab["draw_joints"](env, None, types.SimpleNamespace(name="robot"))
    (_, dry), (_, armature) = calls
    assert tuple(dry["dry"].shape) == (7, 3)
    assert scene.num_envs == len(armature["env_ids"])
    # Each is one of the draws, in the digits of the file.
    apart = (dry["dry"][:, 1:2] - torch.tensor(draws["friction"][:, 1]).to(dry["dry"])).abs()
    assert float(apart.amin(1).max()) < 2e-5


def test_a_diagnosis_in_which_nothing_was_fitted_is_refused(found: GapRecord) -> None:
    with pytest.raises(TorchidError, match="holds no covariance"):
        randomise(msgspec.structs.replace(found, covariance=None))


def test_a_model_that_says_how_sure_it_is_is_drawn_from_alike(found: GapRecord) -> None:
    """After any number of sessions, with what all of them leave open."""
    model = found.corrected
    assert model is not None
    assert model.knowledge is not None
    wide = randomise(model, robot=ROBOT, draws=64)
    same = randomise(found, robot=ROBOT, draws=64)
    rows = {(r.field, r.name): r for r in wide.ranges}
    for (field, joint), value in TRUE.items():
        row, own = (
            rows[field, joint],
            next(r for r in same.ranges if (r.field, r.name) == (field, joint)),
        )
        assert row.low < value < row.high
        # The diagnosis holds that the sensor's scale may be wrong, which no session shows.
        assert row.high - row.low < own.high - own.low
    assert any("scale of the measured torque" in w for w in wide.warnings)
    torch.linalg.cholesky(InertialParameters(wide.draws.pi).pseudo_inertia)
    assert all(b.rms > 0 for b in wide.residual)
    with pytest.raises(TorchidError, match="does not say how sure it is"):
        randomise(ROBOT)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"level": 1.0}, "level is out of range"),
        ({"draws": 1}, "so many robots cannot be drawn"),
        ({"robot": torchid.load_robot("panda")}, "of another arm"),
    ],
)
def test_bad_input(found: GapRecord, bad: dict[str, object], words: str) -> None:
    with pytest.raises(TorchidError, match=words):
        randomise(found, **bad)  # type: ignore[arg-type]


@pytest.mark.slow
def test_ranges_hold_what_was_planted() -> None:
    """Of five arms with friction on all joints."""
    held = 0
    for seed in range(5):
        g = torch.Generator().manual_seed(seed)
        fc, fv = (0.5 + torch.rand(2, 3, generator=g, dtype=torch.float64)).tolist()
        pairs = [(friction(j + 1, Fc=fc[j]), friction(j + 1, Fv=fv[j])) for j in range(3)]
        true = arm(*(effect for pair in pairs for effect in pair))
        log = logged(true, Recording(ONCE, duration=4.0, seed=seed))
        settings = GapSettings(effects=KNOWN[:2])
        wide = randomise(diagnose_torque(ROBOT, log, settings=settings).record, seed=seed)
        ranges = {(r.field, r.name): r for r in wide.ranges}
        for field, values in (("friction", fc), ("damping", fv)):
            for j, value in enumerate(values):
                row = ranges[field, f"joint_{j + 1}"]
                held += row.low <= value <= row.high
    # Of 30 at 95 %; 25 or fewer come in one of two hundred such tests.
    assert held >= 26
