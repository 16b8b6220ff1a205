"""A diagnosed robot carried out into the simulator: what the file is worth there, and what it keeps
of the effects that it has no field for."""

import runpy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from tests.arms import arm
from tests.documents import ROOT
from tests.export.arms import write_mjcf, write_urdf
from torchid.design.segments import Samples
from torchid.effects.registry import model_torque, nominal_effects
from torchid.errors import TorchidError
from torchid.excitation.synthetic import HonestNoise, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.export.correct import correct
from torchid.export.correction import CLAIMED, Correction
from torchid.export.engines import InMujoco, InPinocchio
from torchid.export.export import export_dynamics
from torchid.export.projection import Projector
from torchid.export.write_xml import xml_of
from torchid.extraction.entropic import Room
from torchid.gap.data import prepare
from torchid.gap.settings import GapSettings
from torchid.log.model import Log
from torchid.log.readers import write_log
from torchid.report.exported import correction_tables, report_of_correction
from torchid.robot.inertia import InertialParameters
from torchid.robot.knowledge import Knowledge
from torchid.robot.library import load_robot
from torchid.robot.model import Robot
from torchid.robot.writer import write_robot
from torchid.simulation.shooting import starts_of, windows_of
from torchid.simulation.two_models import errors_after, simulated

FIELDS = [
    {"effect": kind, "joint": j, name: value}
    for j in (1, 2, 3)
    for kind, name, value in (
        ("viscous_friction", "Fv", 0.5 * j),
        ("coulomb_friction", "Fc", 0.6),
        ("rotor_inertia", "Ia", 0.15),
    )
]
OTHERS = [
    {"effect": "stribeck_friction", "joint": 1, "Fs": 0.8, "vs": 0.3},
    {"effect": "load_dependent_friction", "joint": 2, "mu": 0.08},
    {"effect": "joint_spring", "joint": 3, "k": 2.0, "c0": -0.5},
    {"effect": "torque_offset", "joint": 2, "F0": 0.4},
]


def true_arm(*more: dict) -> Robot:  # type: ignore[type-arg]
    """The 3R with a heavier last link and effects."""
    robot = arm("3r")
    pi = robot.require_parameters("a test").pi.clone()
    pi[2] *= 1.3
    robot = robot.with_parameters(InertialParameters(pi))
    return replace(robot, effects=(*FIELDS, *more))


def log_of(robot: Robot, seed: int = 0) -> Log:
    motion = trajectory_log(random_trajectory(robot, seed, fill=True), 100.0)
    return synthetic_log(robot, motion, HonestNoise(torque_relative=1e-3), seed)


@pytest.fixture(scope="module", autouse=True)
def _few_simulations():  # type: ignore[no-untyped-def]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchid.export.correct_torque.STARTS", 12)
        patch.setattr("torchid.export.correct_torque.HORIZONS", (0.1, 0.5))
        yield


@pytest.fixture(scope="module")
def full() -> Robot:
    return true_arm(*OTHERS)


@pytest.fixture(scope="module")
def logs(full: Robot) -> tuple[Log, Log]:
    return log_of(full), log_of(full, 1)


@pytest.fixture(scope="module")
def done(full, logs, tmp_path_factory) -> Correction:
    folder = tmp_path_factory.mktemp("corrected")
    return correct(arm("3r"), full, logs[0], "mjcf", folder, held_out=logs[1], with_effects="mjlab")


@pytest.mark.slow
def test_fields_and_bodies_that_the_file_can_say_are_found(tmp_path):
    """Without other effects nothing is lost, and the engine has the log's own torque."""
    truth = true_arm()
    for to in ("mjcf", "urdf"):
        done = correct(
            arm("3r"), truth, log_of(truth), to, tmp_path / to, held_out=log_of(truth, 1)
        )
        judged = done.judged
        if to == "mjcf":
            assert not done.projection.kept
            values = {
                (e["effect"], e["joint"]): next(v for k, v in e.items() if k in ("Fv", "Fc", "Ia"))
                for e in done.projection.robot.effects
            }
            assert values["viscous_friction", 3] == pytest.approx(1.5, rel=0.05)
            assert values["coulomb_friction", 2] == pytest.approx(0.6, rel=0.1)
            assert bool((judged.claim < judged.full + 0.1).all())
            # Where a joint reverses MuJoCo's dry friction is its own.
            assert bool((judged.engine < judged.full + 2).all())
        else:
            assert {one.effect for one in done.projection.kept} == {"rotor_inertia"}
        assert float(judged.engine.mean()) < 0.2 * float(judged.nominal.mean())


def test_the_claim_is_what_the_engine_says(done):
    judged = done.judged
    assert judged.by.startswith("MuJoCo")
    assert judged.held_out == "trajectory"
    assert bool((judged.engine < CLAIMED * judged.claim + 1).all())
    assert bool((judged.claim < CLAIMED * judged.engine + 1).all())
    assert bool((judged.full < judged.engine + 0.1).all())
    assert float(judged.engine.mean()) < 0.3 * float(judged.nominal.mean())
    # Forwards, too: the file follows the arm better than the robot as given does.
    assert [one.horizon for one in judged.forward] == [0.1, 0.5]
    for one in judged.forward:
        assert one.engine is not None
        assert float(one.engine.norm()) < 0.5 * float(one.nominal.norm())


def test_an_actuator_adds_what_the_file_cannot_say(done):
    _, beside, actuator = done.exports
    assert [one.format for one in done.exports] == ["mjcf", "mjcf", "mjlab"]
    assert actuator.files[0].suffix == ".py"
    # The same effects: in the sidecar for MuJoCo, at run time for mjlab.
    assert set(actuator.in_file) | set(actuator.left_out) == set(beside.beside)
    assert actuator.in_file


def test_a_file_with_its_effects_has_the_full_models_error(done):
    assert float((done.judged.run_time - done.judged.full).abs().max()) < 0.3
    main, side = done.exports[1].files
    assert (main.name, side.name) == (
        "3r_corrected_effects.xml",
        "3r_corrected_effects.xml.effects.yaml",
    )
    beside = {e["effect"] for e in load_robot(main).effects}
    assert {"stribeck_friction", "load_dependent_friction", "torque_offset"} <= beside


def test_loads_at_run_time_are_those_of_the_bodies_in_the_file(tmp_path):
    """A first link of 8 kg more, which no torque tells, presses the thrust bearing of the diagnosed
    arm: the file has bodies near the nominal ones, and its friction is fitted to their loads."""
    nominal = arm("3r")
    pi = nominal.require_parameters("a test").pi.clone()
    pi[0, 0] += 8.0
    friction = {"effect": "axial_load_friction", "joint": 1, "r_a": 0.02}
    full = replace(nominal.with_parameters(InertialParameters(pi)), effects=(*FIELDS, friction))
    logs = [log_of(full, seed) for seed in (0, 1)]
    done = correct(nominal, full, logs[0], "mjcf", tmp_path, held_out=logs[1], with_effects=True)
    assert float(done.judged.full.max()) < 1.0
    assert float(done.judged.run_time.max()) < 2.0
    written = done.exports[1].dynamics.robot
    masses = [float(r.require_parameters("a test").mass.sum()) for r in (full, written)]
    assert masses[1] < 0.9 * masses[0]


def test_the_example_replays_a_log(done, logs, tmp_path, monkeypatch, capsys):
    """With the effects the arm is nearer to the log on each of the joints that have them."""
    write_log(logs[1], tmp_path / "run.csv")
    script = ROOT / "docs" / "examples" / "effects_in_mujoco.py"
    words = [str(done.exports[0].files[0]), str(tmp_path / "run.csv"), "--seconds", "0.2"]
    monkeypatch.setattr("sys.argv", [str(script), *words, "--starts", "8"])
    runpy.run_path(str(script), run_name="__main__")
    *_, alone, beside = capsys.readouterr().out.strip().splitlines()
    errors = [[float(x) for x in line.partition(":")[2].split()] for line in (alone, beside)]
    assert sum(errors[1]) < 0.7 * sum(errors[0])


def test_every_effect_without_a_field_is_named_with_what_is_kept(done):
    kept = {one.effect: one for one in done.projection.kept}
    assert set(kept) == {"stribeck_friction", "load_dependent_friction", "torque_offset"}
    assert all(0 <= one.share <= 1 for one in kept.values())
    assert (kept["stribeck_friction"].field, kept["stribeck_friction"].joint) == ("frictionloss", 0)
    assert done.exports[0].files[0].name == "3r_corrected.xml"
    # A constant torque is its own RMS; what is lost of it is what is not kept, at most all.
    offset = kept["torque_offset"]
    assert offset.made == pytest.approx(0.4, rel=1e-6)
    for one in kept.values():
        assert one.lost / one.made == pytest.approx(1 - one.share)
    text = done.exports[0].files[0].read_text()
    assert f"torque_offset of joint 2 ({offset.lost:.2g} of 0.4 RMS are lost)" in text
    assert done.warnings[0].startswith("of the sensor, not of the arm: torque offset;")


@pytest.mark.parametrize(("power", "within"), [(1.5, 0.02), (2.0, 0.04)])
def test_friction_over_speed_is_the_files_damping(power, within, tmp_path):
    """Lubricant that thins: MuJoCo's own passive torque at the speeds of the log is the law's, and
    beyond them, where the law would drive, the file resists."""
    still = log_of(arm("3r"))
    fastest = float(still.q[:, 0].diff().abs().max()) * 100.0
    bend = -3.0 * fastest ** (1 - power)
    others = [e for e in FIELDS if (e["effect"], e["joint"]) != ("viscous_friction", 1)]
    law = [
        {"effect": "viscous_friction", "joint": 1, "Fv": 6.0},
        {"effect": "power_law_friction", "joint": 1, "F2": bend, "a": power},
    ]
    truth = replace(arm("3r"), effects=(*others, *law))
    data = prepare(arm("3r"), log_of(truth), None, widest=20.0)
    robot = Projector(arm("3r"), truth, data, "mjcf").projection().robot
    done = export_dynamics(robot, "mjcf", tmp_path, nominal=arm("3r"), geometry="none")
    model = mujoco.MjModel.from_xml_path(str(done.files[0]))
    simulated = mujoco.MjData(model)

    def damper(speed: float) -> float:
        simulated.qvel[:] = speed, 0, 0
        mujoco.mj_forward(model, simulated)
        return -float(simulated.qfrc_damper[0])

    assert min(damper(speed) for speed in fastest * np.linspace(0.1, 16, 300)) > 0
    for speed in fastest * np.linspace(0.1, 1, 10):
        expected = 0.6 + 6.0 * speed + bend * speed**power
        found = damper(speed) + model.dof_frictionloss[0]
        assert found == pytest.approx(expected, abs=within * 6.0 * fastest)


@pytest.mark.slow
@pytest.mark.usefixtures("types_unchecked")
def test_a_file_is_as_sure_as_the_diagnosis_and_off_by_what_it_cannot_say(full, logs):
    names = ("viscous_friction Fv1", "coulomb_friction Fc2", "stribeck_friction Fs1")
    root = 100 * torch.eye(33, dtype=torch.float64)
    known = Knowledge(3, names, root, ("log",), torch.full((3,), 0.1, dtype=torch.float64))
    data = prepare(arm("3r"), logs[0], None, widest=20.0)
    sure = replace(full, knowledge=known)
    robot = Projector(arm("3r"), sure, data, "mjcf").projection().robot
    assert robot.knowledge is not None
    own = {
        f"{e['effect']} {k}{e['joint']}": v
        for e in robot.effects
        for k, v in e.items()
        if k in ("Fv", "Fc")
    }
    # The file has no Stribeck curve, whose torque its friction has to carry.
    assert set(robot.knowledge.coefficients) == set(names[:2])
    for name, true in ((names[0], 0.5), (names[1], 0.6)):
        expected = (0.01**2 + (own[name] - true) ** 2) ** 0.5
        assert robot.knowledge.std(name) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("types_unchecked")
def test_what_is_kept_is_what_the_fit_itself_makes_of_the_effect(full, logs):
    """Against two whole projections, one of a log without a tenth of the effect: what the file
    takes over of that tenth."""
    data = prepare(arm("3r"), logs[0], None, widest=20.0)
    projector = Projector(arm("3r"), full, data, "mjcf")
    kept = {one.effect: one for one in projector.projection().kept}
    every = torch.ones(len(data.samples), dtype=torch.bool)
    before = projector.without(every)
    for effect, values in nominal_effects(full):
        if effect.name not in kept or effect.name == "torque_offset":
            continue
        small = [0.02 * v for v in values]
        segments = tuple(
            replace(s, tau=s.tau - effect.all_torques(
                s.motion._replace(torque=model_torque(full, nominal_effects(full), s.motion)),
                small, full))
            for s in data.segments
        )  # fmt: skip
        less = replace(data, samples=Samples(segments, data.samples.cutoff))
        other = Projector(arm("3r"), full, less, "mjcf")
        other.weight = projector.weight
        other.fields, other.room, other.found = projector.fields, projector.room, projector.found
        after = other.without(every)
        samples, count = data.samples, data.keep.sum(1, keepdim=True)
        taken, whole = (
            samples.of([x.T for x in parts]) * data.keep / count.sqrt()
            for parts in (
                [torque(before, s.motion) - torque(after, s.motion) for s in data.segments],
                [a.tau - b.tau for a, b in zip(data.segments, segments, strict=True)],
            )
        )
        share = max(0.0, 1 - float((whole - taken).norm() / whole.norm()))
        assert kept[effect.name].share == pytest.approx(share, abs=0.05), effect.name


@pytest.mark.parametrize("write", [write_mjcf, write_urdf])
def test_a_copy_of_the_users_file_is_edited(write, tmp_path):
    """Class defaults, included files, shapes and the like are the user's; the original stays."""
    path = write(tmp_path)
    robot = load_robot(path)
    before = path.read_text()
    limits = {"velocity": 1.5, "acceleration": 5.0}
    bare = replace(robot, effects=()).with_limits(**limits)
    dry = [{"effect": "coulomb_friction", "joint": j + 1, "Fc": 2.0} for j in range(robot.n)]
    slow = [{"effect": "viscous_friction", "joint": j + 1, "Fv": 3.0} for j in range(robot.n)]
    true = replace(bare, effects=(*dry, *slow))
    to = "mjcf" if path.suffix == ".xml" else "urdf"
    done = correct(robot, true, log_of(true), to, tmp_path / "out")
    assert path.read_text() == before
    assert done.exports[0].original == path
    assert float(done.judged.engine.mean()) < 0.2 * float(done.judged.nominal.mean())
    again = load_robot(done.exports[0].files[0])
    friction = {e["joint"]: e["Fc"] for e in again.effects if e["effect"] == "coulomb_friction"}
    assert friction[1] == pytest.approx(2.0, rel=0.1)


def test_a_file_that_an_engine_refuses_is_no_traceback(tmp_path):
    """A body off the chain that cannot exist: Pinocchio reads it, MuJoCo does not."""
    pytest.importorskip("pinocchio")
    path = write_urdf(tmp_path)
    robot = load_robot(path)
    base = path.read_text().split('<parent link="')[1].split('"')[0]
    bad = f"""<link name="antenna"><inertial><mass value="0.1"/>
      <inertia ixx="-1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="aerial" type="fixed"><parent link="{base}"/><child link="antenna"/></joint>
    </robot>"""
    path.write_text(path.read_text().replace("</robot>", bad))
    robot = load_robot(path).with_limits(velocity=1.5, acceleration=5.0)
    dry = [{"effect": "coulomb_friction", "joint": j + 1, "Fc": 2.0} for j in range(robot.n)]
    true = replace(robot, effects=tuple(dry))
    with pytest.raises(TorchidError, match="cannot load the corrected file"):
        InMujoco(path, robot)
    done = correct(robot, true, log_of(true), "urdf", tmp_path / "out")
    assert done.judged.forward[0].engine is None
    assert any("refuses the file" in words for words in done.warnings)


def torque(robot: Robot, motion):  # type: ignore[no-untyped-def]
    return model_torque(robot, nominal_effects(robot), motion)


@pytest.mark.parametrize("kind", [InMujoco, InPinocchio])
def test_an_engine_has_torchids_torque(kind, full, logs, tmp_path):
    """Away from reversals, where MuJoCo's dry friction is its own."""
    robot = true_arm()
    if kind is InPinocchio:
        pytest.importorskip("pinocchio")
        rotors = [e for e in robot.effects if e["effect"] != "rotor_inertia"]
        robot = replace(robot, effects=tuple(rotors))
    path = tmp_path / ("a.urdf" if kind is InPinocchio else "a.xml")
    written, file, _, rest = xml_of(robot, path, None, "urdf" if kind is InPinocchio else "mjcf")
    assert not rest
    path.write_bytes(file.to_bytes())
    data = prepare(robot, logs[0], None)
    engine = kind(path, written)
    for s in data.segments:
        found, expected = engine.torque(s, data.samples), torque(robot, s.motion)
        sure = (s.motion.dq.abs() > 0.1) & (torch.sign(s.motion.dq) == s.motion.sign)
        assert float((found - expected)[sure].abs().max()) < 1e-9 * float(expected.abs().max())


def test_mujoco_moves_as_torchid_does(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot = true_arm()
    path = tmp_path / "a.xml"
    written, file, _, _ = xml_of(robot, path, None, "mjcf")
    path.write_bytes(file.to_bytes())
    data = prepare(robot, log_of(robot), None)
    windows = windows_of(data.segments, starts_of(data.segments, 0.1, 12, 0), 0.5)
    positions = InMujoco(path, written).positions(windows)
    step = round(0.5 / windows.dt)
    use = windows.steps >= step
    models = [positions, simulated(robot, windows)]
    _, (error, own) = errors_after(0.5, models, windows)
    moved = (windows.q[use, step] - windows.q[use, 0]).square().mean(0).sqrt()
    assert bool(((error - own).abs() < 0.03 * moved).all())
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


@pytest.mark.slow
@pytest.mark.slow
def test_bodies_at_the_end_of_what_is_believable_are_said(full, logs, tmp_path, monkeypatch):
    """In what is printed, and in the file's comment."""
    monkeypatch.setattr(Room, "touched", lambda *_: ("mass of link 2 (upper)",))
    found = correct(arm("3r"), full, logs[0], "mjcf", tmp_path, held_out=logs[1])
    said = "at a bound of what is believable: mass of link 2 (upper); the torque asks for more"
    assert said in found.warnings
    assert "(at a bound: mass of link 2 (upper))" in found.files[0].read_text()


@pytest.mark.slow
def test_a_joint_whose_torque_says_nothing_keeps_what_it_has(full, logs, tmp_path):
    """The sensor of joint 3 writes noise: no file can be fitted to it, or judged by it."""
    given = {"effect": "viscous_friction", "joint": 3, "Fv": 0.7}
    nominal = replace(arm("3r"), effects=(given,))
    g = torch.Generator().manual_seed(5)
    deaf = []
    for log in logs:
        tau = log.tau.clone()
        tau[:, 2] = 0.3 * float(tau[:, 2].std()) * torch.randn(len(tau), generator=g).double()
        deaf.append(replace(log, tau=tau))
    done = correct(nominal, full, deaf[0], "mjcf", tmp_path, held_out=deaf[1])
    wrist = [e for e in done.projection.robot.effects if e.get("joint") == 3]
    assert wrist == [given]
    assert "joint 3: the measured torque holds no signal" in done.warnings[0]
    assert [bool(x.isnan()) for x in done.judged.engine] == [False, False, True]
    assert all(bool(one.engine[2].isnan()) for one in done.judged.forward)
    text = "\n".join(str(row) for table in correction_tables(done) for row in table.rows)
    assert "nan" not in text
    assert "nan" not in report_of_correction(done).verdict
    assert done.plain()["judged"]["torque_error_percent"]["nominal"][2] is None


@pytest.mark.slow
def test_nothing_is_written_that_was_not_better(logs, tmp_path):
    # The log is the nominal robot's: whatever is refitted to another arm's model is no better.
    nominal = arm("3r")
    own = log_of(nominal)
    wrong = replace(logs[0], tau=-logs[0].tau)
    with pytest.raises(TorchidError, match="no better"):
        correct(nominal, nominal, wrong, "mjcf", tmp_path / "x", held_out=own)
    with pytest.raises(TorchidError, match="of another arm"):
        correct(nominal, arm("ur10e"), own, "mjcf", tmp_path / "x")
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
def test_a_yaml_is_corrected_in_the_file_that_it_was_made_from(tmp_path):
    """By names of files alone: a copy of the MJCF is edited, not a new one written."""
    saved = tmp_path / "corrected.yaml"
    file = export_dynamics("3r", "mjcf", tmp_path, "arm", nominal="3r").files[0]
    file.write_text(file.read_text().replace("<worldbody>", "<worldbody><!-- by hand -->"))
    real = replace(load_robot(file), effects=tuple(FIELDS))
    write_robot(real, saved)
    motion = trajectory_log(random_trajectory(arm("3r"), 1, duration=6.0, fill=True), 100.0)
    log = tmp_path / "run.parquet"
    write_log(synthetic_log(real, motion, HonestNoise(), 1), log)
    settings = GapSettings(cutoff=10.0)
    done = correct(saved, saved, log, "mjcf", tmp_path / "out", settings=settings)
    assert "by hand" in done.files[0].read_text()
    assert bool((done.judged.engine < 0.3 * done.judged.nominal).all())
