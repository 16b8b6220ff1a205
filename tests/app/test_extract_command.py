"""torchid extract and torchid atlas from the outside."""

import json
from pathlib import Path

import pytest

from tests.marks import some

SMALL = ("--runs", "3", "--stages", "3", "--generations", "4")


@pytest.fixture(scope="session")
def identified(folder, tmp_path_factory):
    """The JSON of an identification of the 3R with friction."""
    from torchid.identification.identify import Settings, identify
    from torchid.log.readers import read_log
    from torchid.robot.library import load_robot

    settings = Settings(
        effects=("viscous_friction", "coulomb_friction", "torque_offset"), cutoff=8.0, reversal=0.05
    )
    result = identify(
        load_robot("3r_friction"), read_log([folder / "fit.parquet"]), settings=settings
    )
    path = tmp_path_factory.mktemp("result") / "identification.json"
    path.write_text(json.dumps(result.plain()))
    return path


def test_nominal_parameters_are_recovered_as_feasible_sets(command, tmp_path):
    shown = command("extract", "3r", *SMALL, "--out", tmp_path, "--pictures")
    assert shown.code == 0, shown.err
    data = json.loads((tmp_path / "extraction.json").read_text())
    assert data["schema"] == "torchid.extraction/1"
    assert data["certificate"]["phi_min"] < 1e-18
    assert [s["id"] for s in data["sets"]] == ["run_1", "run_2", "run_3"]
    assert all(s["phi"] < 1e-18 and s["gamma"] == 0 and s["feasible"] for s in data["sets"])
    assert (tmp_path / "search.png").read_bytes().startswith(b"\x89PNG")


NONE_MEETS = ("--total-mass", "100,200", "--search-anyway", "--runs", "2", "--stages", "1")


def test_conditions_that_no_set_meets_are_said_beside_the_least_loss_of_the_bounds(
    command, tmp_path
):
    target = tmp_path / "x.json"
    shown = command("extract", "3r", *NONE_MEETS, "--generations", "3", "--json", target)
    assert shown.code == 0, shown.err
    out = " ".join(shown.out.split())
    assert "No set within the bounds meets all conditions." in out
    assert "Some feasible set" not in out
    data = json.loads(target.read_text())
    assert not data["certificate"]["feasible"]
    assert not data["certificate"]["with_conditions"]
    assert data["certificate"]["conflict"] == ["total_mass"]
    assert "total_mass" in data["warnings"][0]


@pytest.mark.slow
@pytest.mark.parametrize("given", [("--total-mass", "100,200"), ("--bounds", "loose")])
def test_no_convex_optimum_where_no_set_is_feasible(command, tmp_path, given):
    robot = "3r" if given[0] == "--total-mass" else "kuka_lwr4"
    target = tmp_path / "x.json"
    options = ("--method", "sdp", "--penalty", "partial", "--json", target)
    shown = command("extract", robot, *given, *options)
    assert shown.code == 1
    assert "no feasible set" in shown.err
    assert not target.exists()


RELAXED = """
name: relaxed
gravity: [0, -9.81, 0]
dh: {convention: classical, joints: [{type: R, a: 0, alpha: 0, d: 0, theta: 0}]}
parameters: {mass: [2], com: [[-0.1, 0.01, 0.02]], inertia_about_com: [[0.02, 0, 0, 0.02, 0, 0.02]]}
bounds:
  normal:
    lower: {mass: [1.4], com: [[-0.25, -0.05, -0.05]], inertia: [[0, -0.01, -0.01, 0, -0.01, 0]]}
    upper:
      mass: [2.6]
      com: [[0.05, 0.05, 0.05]]
      inertia: [[0.005, 0.01, 0.01, 0.005, 0.01, 0.005]]
"""


def test_a_lower_bound_of_zero_is_not_taken_for_a_set_without_loss(command, tmp_path):
    """J_zz and m c_x are known, so I_zz >= J_zz - (m c)^2 / m_min > its bound: no set fits, and the
    relaxed bounds of inertias do not see it."""
    robot, target = tmp_path / "relaxed.yaml", tmp_path / "x.json"
    robot.write_text(RELAXED)
    shown = command("extract", robot, *SMALL, "--json", target)
    assert shown.code == 0, shown.err
    data = json.loads(target.read_text())
    assert data["certificate"]["phi_min"] == 0
    assert not data["certificate"]["exact"]
    assert "bound_1zz" in data["certificate"]["relaxed"]
    assert min(s["phi"] for s in data["sets"]) > 1e-6
    out = " ".join(shown.out.split())
    assert "is not known" in out
    assert "Some feasible set" not in out
    least = min(data["certificate"]["phi_strict"], *(s["phi"] for s in data["sets"]))
    assert f"and {least:.5g}." in out


@pytest.mark.parametrize("options", [("extract", *SMALL), ("atlas",)])
def test_brackets_in_a_name_are_no_markup(command, tmp_path, options):
    robot = tmp_path / "relaxed.yaml"
    robot.write_text(RELAXED.replace("name: relaxed", "name: '[/b]x'"))
    shown = command(options[0], robot, *options[1:])
    assert shown.code == 0, shown.err
    assert "[/b]x" in shown.out


def test_an_atlas_says_where_the_bounds_of_inertias_are_relaxed(command, tmp_path):
    robot = tmp_path / "relaxed.yaml"
    robot.write_text(RELAXED)
    shown = command("atlas", robot)
    assert shown.code == 0, shown.err
    assert "count by a relaxation" in " ".join(shown.out.split())


@pytest.mark.slow
def test_an_atlas_says_what_the_fit_held(command, tmp_path, identified):
    data = json.loads(identified.read_text())
    k = data["base_names"].index("Fc1")
    for row in data["covariance"]:
        row[k] = 0.0
    data["covariance"][k] = [0.0] * len(data["base_names"])
    path, target = tmp_path / "held.json", tmp_path / "atlas.json"
    path.write_text(json.dumps(data))
    assert command("atlas", "3r_friction", path, "--json", target).code == 0
    assert any("exact" in w and "Fc1" in w for w in json.loads(target.read_text())["warnings"])


@pytest.mark.parametrize("loss", some(["two-step", "one-step"], slow=1))
def test_a_set_of_another_torque_is_said_to_be_one(command, tmp_path, identified, loss):
    """Coefficients that no body has: the least loss of coefficients is far off in torque."""
    pytest.importorskip("clarabel")
    data = json.loads(identified.read_text())
    for k, value in enumerate(data["base_values"][:3]):
        data["base_values"][k] = -value
    path = tmp_path / "identification.json"
    path.write_text(json.dumps(data))
    options = ("--method", "sdp", "--loss", loss, "--out", tmp_path)
    shown = command("extract", "3r_friction", path, *options)
    assert shown.code == 0, shown.err
    written = json.loads((tmp_path / "extraction.json").read_text())
    assert max(written["sets"][0]["torque_error_percent"]) > 5
    advice = "--loss one-step asks for the log's torque"
    assert (advice in " ".join(shown.out.split())) == (loss == "two-step")
    assert any(advice in w for w in written["warnings"]) == (loss == "two-step")
    # The export says so, too, from either file.
    for name in ("extraction.json", "sets.json"):
        done = command(
            "export", tmp_path / name, "--to", "yaml", "--out", tmp_path / name.split(".")[0],
            "--geometry", "none", "--json", tmp_path / "e.json",
        )  # fmt: skip
        assert done.code == 0, done.err
        said = [w for w in json.loads((tmp_path / "e.json").read_text())["warnings"] if "%" in w]
        assert len(said) == 1
        assert "from the one asked for (joint" in said[0]
        assert ("--loss one-step" in said[0]) == (loss == "two-step")


@pytest.mark.slow
def test_atlas(command, tmp_path, identified):
    shown = command("atlas", "3r_friction", identified, "--out", tmp_path, "--pictures")
    assert shown.code == 0, shown.err
    data = json.loads((tmp_path / "atlas.json").read_text())
    rows = {p["name"]: p for p in data["parameters"]}
    assert rows["m3"]["low"] < 1.2 < rows["m3"]["high"]
    assert rows["Fv1"]["low"] < 0.0665 < rows["Fv1"]["high"]
    assert rows["J2xy"]["share_of_bounds"] < 0.05
    assert (tmp_path / "atlas.png").read_bytes().startswith(b"\x89PNG")


def test_a_robot_of_known_kinematics_gets_bodies_and_a_file(command, folder, identified, tmp_path):
    """The 3R without its parameters: identified, extracted, exported, and MuJoCo's torque is that
    of the true parameters."""
    import mujoco
    import torch
    import yaml

    from tests.arms import states
    from tests.oracles import MujocoOracle
    from torchid.robot.library import load_robot

    true = load_robot("3r_friction")
    bare = yaml.safe_load((Path(true.source)).read_text())
    bare = {key: bare[key] for key in ("name", "dh", "gravity", "limits") if key in bare}
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(bare))
    record = json.loads(identified.read_text()) | {"robot": bare["name"]}
    record.pop("model", None)
    (tmp_path / "result.json").write_text(json.dumps(record))
    for bounds in ((), ("--bounds", "none", "--overwrite")):
        shown = command(
            "extract", tmp_path / "bare.yaml", tmp_path / "result.json", *bounds, "--out", tmp_path
        )
        assert shown.code == 0, shown.err
        data = json.loads((tmp_path / "extraction.json").read_text())
        assert (data["method"], data["loss"]) == ("near", "one-step")
        assert data["bounds"] == (bounds[1] if bounds else "wide")
        assert data["sets"][0]["feasible"]
    assert ("neither bounds nor inertial parameters" in shown.out) == (not bounds)
    made = command("export", tmp_path / "extraction.json", "--to", "mjcf", "--out", tmp_path / "m")
    assert made.code == 0, made.err
    (file,) = (tmp_path / "m").glob("*.xml")
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT  # limits of the joints
    data = mujoco.MjData(model)
    q, dq, ddq = states(true, 30)
    torque = []
    for row in zip(q.numpy(), 0 * dq.numpy(), ddq.numpy(), strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = row
        mujoco.mj_inverse(model, data)
        torque.append(torch.from_numpy(data.qfrc_inverse.copy()))
    expected = MujocoOracle(true).inverse_dynamics(q, 0 * dq, ddq)
    error = (torch.stack(torque) - expected).square().mean(0).sqrt()
    assert bool((error < 0.03 * expected.square().mean(0).sqrt() + 0.05).all()), error


@pytest.mark.nightly
def test_a_set_is_as_sure_as_what_it_was_extracted_from(command, identified, tmp_path):
    """From identification to sets to a robot's file, which another extraction takes without the
    identification."""
    from torchid.robot.library import load_robot

    asked = ("--method", "sdp", "--loss", "one-step", "--bounds", "none", "--no-certificate")
    done = command("extract", "3r_friction", identified, *asked, "--out", tmp_path)
    assert done.code == 0, done.err
    done = command("export", tmp_path / "extraction.json", "--to", "yaml", "--out", tmp_path)
    assert done.code == 0, done.err
    file = next(tmp_path.glob("3r*.yaml"))
    known = load_robot(file).knowledge
    assert known is not None
    first = json.loads(identified.read_text())["knowledge"]
    assert list(known.sources) == first["sources"]
    done = command("extract", file, *asked, "--out", tmp_path / "again")
    assert done.code == 0, done.err
    again = json.loads((tmp_path / "again" / "extraction.json").read_text())
    assert again["loss"] == "one-step"
    done = command("atlas", file, "--bounds", "none", "--json", tmp_path / "atlas.json")
    assert done.code == 0, done.err
