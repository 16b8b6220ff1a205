"""One table of commands and bad inputs: each ends in one error that says what to type instead, exit
code 1, and nothing half-written."""

import json
import math
import os
import shlex
from pathlib import Path

import pytest
import torch

from tests.app.conftest import table_of, write_table
from tests.app.test_check_command import sets_file
from tests.excitation.shaped import shaped_arm
from tests.fleet.records import several
from tests.gap_files import hidden
from tests.gap_files import open_gap as diagnosis
from tests.position.planted import planted, true_servos
from tests.position.planted import robot as servo_robot
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.log.readers import read_log, write_log
from torchid.position.model import ServoArm
from torchid.robot.library import load_robot
from torchid.robot.writer import write_robot

ARM = '<robot name="arm"><link name="base"/>{}</robot>'
LINK = (
    '<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{p}"/><child link="l{k}"/>'
    '<origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" velocity="3" effort="9"/>'
    "</joint>"
)
BARE = ARM.format("".join(LINK.format(k=k, p=f"l{k - 1}" if k > 1 else "base") for k in (1, 2, 3)))
"""Three joints without bodies."""


def scaled(factor: float, *letters: str):
    """Columns whose names begin so, by a factor."""
    return lambda table: {k: factor * v if k.startswith(letters) else v for k, v in table.items()}


def milliseconds(table):
    return table | {"t": 1e3 * table["t"]}


def gripper(table):
    return table | {"q4": table["q1"] * 0.1, "tau4": table["tau1"] * 0.1}


def named(table):
    """In milliseconds, which is guessed and therefore asked."""
    new = {"t": "time", "q": "pos_j", "tau": "eff_j"}
    return {
        new[name.rstrip("123")] + name.lstrip("tqau"): v
        for name, v in milliseconds(table).items()
        if name.rstrip("123") in new
    }


def hole(table):
    column = table["q2"].clone()
    column[40] = float("nan")
    return table | {"q2": column}


def still(table):
    """Speeds are zero, positions the first one."""
    first = {k: v[:1].expand(len(v)) * (k[0] == "q") for k, v in table.items()}
    return {k: first[k] if k[0] in "qd" else v for k, v in table.items()}


LOGS = {
    "degrees": scaled(180 / math.pi, "q", "dq"),
    "ms": milliseconds,
    "gripper": gripper,
    "named": named,
    "hole": hole,
    "still": still,
    "currents": lambda table: {k.replace("tau", "i"): v for k, v in table.items()},
    "positions": lambda table: {k: v for k, v in table.items() if k[:3] != "tau"},
    "two": lambda table: {k: v for k, v in table.items() if not k.endswith("3")},
    "q4": lambda table: {k.replace("q3", "q4"): v for k, v in table.items()},
    "short": lambda table: {k: v[:12] for k, v in table.items()},
    "zeros": scaled(0.0, "tau"),
}
"""The check log with one mistake."""


@pytest.fixture(scope="module")
def place(folder, tmp_path_factory) -> Path:
    """A folder with all that the lines name."""
    place = tmp_path_factory.mktemp("place")
    good = (folder / "check.csv").read_bytes()
    (place / "good.csv").write_bytes(good)
    (place / "fit.parquet").write_bytes((folder / "fit.parquet").read_bytes())
    table = table_of(read_log(place / "good.csv"))
    for name, change in LOGS.items():
        write_table(change(table), place / f"{name}.csv")
    for unit in ("unit_a", "unit_b", "logs"):
        (place / unit).mkdir()
        if unit != "logs":
            (place / unit / "run.csv").write_bytes(good)
    robot = load_robot("3r")
    motion = trajectory_log(random_trajectory(robot, 0, duration=3.0), 100.0)
    write_log(motion, place / "motion.csv")
    texts = {
        "my_arm.urdf": BARE,
        "other_axis.urdf": BARE.replace('xyz="0 1 0"', 'xyz="1 0 0"'),
        "free.yaml": "name: free\ndh: {convention: classical, joints: [{a: 1}, {a: 1}]}\n",
        "odd.urdf": '<sdf version="1.6"/>',
        "odd.xml": "<html/>",
        "words.yaml": "just words",
        "empty.csv": "",
        "notes.ipynb": '{"cells": []}',
        "log.pkl": "\x80\x04.",
        "no.parquet": "t,q1\n0,0\n",
        "other.json": '{"a": 1}',
        "text.json": "not json",
        "robot.json": '{"schema": "torchid.robot/1"}',
        "study.json": '{"schema": "torchid.study/1"}',
        "gap0.json": '{"schema": "torchid.gap/0"}',
        "corrected.yaml": "name: arm\n",
    }
    for name, text in texts.items():
        (place / name).write_text(text)
    of_gaps(place)
    of_sets(place)
    of_servos(place)
    for arm in ("6r", "7r"):
        shaped_arm(arm, place)
    return place


def of_gaps(place: Path) -> None:
    """Results that are compared, and that a motion is designed for."""
    several(place, 2)
    data = json.loads((place / "b.json").read_text())
    for name, change in (
        ("shorter", {"base_values": data["base_values"][:-1]}),
        ("null", {"base_values": [None, *data["base_values"][1:]]}),
    ):
        (place / f"{name}.json").write_text(json.dumps(data | change))
    three = load_robot("3r_friction")
    vertical = [hidden("encoder_offset", 1)]
    for name, found in {
        "gap": diagnosis(load_robot("3r")),
        "kuka": diagnosis(load_robot("kuka_lwr4")),
        "closed": diagnosis(three, which=[]),
        "vertical": diagnosis(three, which=[], not_testable=vertical),
    }.items():
        (place / f"{name}.json").write_text(json.dumps(found))


def of_sets(place: Path) -> None:
    """Files of sets."""
    sets_file(place / "sets.json")
    sets_file(place / "bare.json", change=lambda d: (d.pop("robot"), d.pop("robot_source")))
    nan = {"mass": [1.0, float("nan"), 1.0]}
    sets_file(place / "nan.json", change=lambda d: d["sets"][0].update(nan))


def of_servos(place: Path) -> None:
    """Logs of commands and positions, and the arm's model."""
    servos = true_servos(3)
    ServoArm(servo_robot(), servos, torch.ones(3, dtype=torch.float64)).write(place / "model.yaml")
    write_robot(servo_robot(), place / "plain.yaml")
    run = planted(servos, motions=1, seconds=6.0)
    for name, log in {
        "run": run,
        "run_degrees": run.replace(u=57.3 * run.u),
        "run_zeros": run.replace(tau=0 * run.q),
        "run_bare": run.replace(u=None),
        "run_torque": run.replace(tau=run.q, u=None),
    }.items():
        write_log(log, place / f"{name}.csv")


BAD = """
gap my_amr.urdf good.csv | 'my_amr.urdf' does not exist | ./my_arm.urdf
gap my_arm good.csv | unknown robot 'my_arm' | ./my_arm.urdf
gap 3r goood.csv | 'goood.csv' does not exist | ./good.csv
gap good.csv 3r | comes first | torchid gap 3r good.csv
gap 3r degrees.csv | degrees | --columns "q=q{j} deg | --force
gap 3r ms.csv | milliseconds | --columns "t=t ms"
gap 3r short.csv | too short
gap kuka_lwr4 good.csv | got: 3 | expected: 7
gap 3r good.csv --effects coulom_friction | nearest: coulomb_friction
gap 3r good.csv --effects none | --effects | all
gap 3r good.csv --background backlas | backlas | available
gap 3r good.csv --background torque_offset,torque_offset | twice
gap 3r good.csv --cutoff x | --cutoff | auto
gap 3r good.csv --cutoff -3 | --cutoff | positive
gap 3r good.csv --cutoff 49 | cut-off | 49
gap 3r good.csv --gain 1,2 | --gain | 3
gap 3r good.csv --columns= | --columns | nothing
gap 3r good.csv --topic= | --topic | nothing
gap 3r good.csv --save-model nowhere/robot.yaml | --save-model | folder
gap 3r good.csv --save-model corrected.txt | --save-model | corrected.txt | .yaml
gap 3r good.csv --pictures | --pictures draws into a folder, and needs --out DIR.
gap 3r good.csv --held-out fit.parquet --held-out-fraction 0.2 | exclude each other
gap 3r good.csv --held-out-fraction 1.5 | held-out fraction
gap --simulated sim.csv --real arm.csv | ` is gone. | torchid pair
gap --real=arm.csv | ` is gone. | torchid pair
gap 3r run.csv --to urdf --out out | ` is gone. | torchid correct
gap 3r run.csv --for urdf --out out | ` is gone. | torchid correct
gap 3r run.csv --calibrate 3 | ` is gone. | torchid calibrate
study 3r --no-figures | ` is gone. | --report
gap 3r run_degrees.csv | commands look like degrees | u=u{j} deg
gap 3r run.csv --servo SG90 | there is no such servo | STS3215
gap 3r run_zeros.csv --servo SG90 | no such servo
gap 3r run.csv --cutoff 5 | commands and positions and no torques | --cutoff
gap 3r run.csv --effects viscous_friction | commands and positions
gap 3r run_bare.csv | has no torque | commands u1..
gap 3r run_torque.csv --servo MX-64 | --servo is for logs
calibrate 3r run.csv --causes 2 | causes are planted in torque | tau1..
correct 3r degrees.csv --to mjcf | --columns "q=q{j} deg | --force
correct 3r good.csv --to mjcf --effects none | --effects | all
correct 3r good.csv --to mjcf --held-out fit.parquet --held-out-fraction 0.2 | exclude
correct 3r good.csv --to mjcf --name ../x --effects coulomb_friction | name
identify 3r degrees.csv | degrees | --columns "q=q{j} deg
identify 3r ms.csv | seconds | --columns "t=t ms"
identify 3r gripper.csv | got: 4 | --columns "q=q{1..3},tau=tau{1..3}"
identify kuka_lwr4 good.csv | got: 3 | expected: 7 | --lock | --tip
identify 3r named.csv | no column t | "t=time ms,q=pos_j{j},tau=eff_j{j}"
identify 3r q4.csv | q
identify 3r currents.csv | no torque | --gain K1,K2,K3
identify 3r currents.csv --gain 10,10 | expected: 3
identify 3r positions.csv | no torque | tau1..
identify 3r hole.csv | q2 | row 41
identify 3r good.csv two.csv | different numbers | 'two.csv' | 'good.csv'
identify 3r good.csv good.csv | given twice
identify 3r good.csv --held-out two.csv | joints
identify 3r good.csv --held-out good.csv | held out | --held-out-fraction
identify 3r logs | is a folder | a log
identify 3r empty.csv | is empty | t, q1..
identify 3r notes.ipynb | to_csv
identify 3r log.pkl | to_csv
identify 3r no.parquet | not a parquet file
identify 3r short.csv --out one/two | too short | 12 samples
identify 3r short.csv --out logs | too short
identify 3r still.csv | no joint moves
identify 3r zeros.csv | all torques are zero
identify 3r good.csv --out good.csv | 'good.csv' is a file
identify 3r good.csv --out good.csv/below | cannot be made
identify 3r good.csv --json nowhere/x.json | does not exist
identify 3r good.csv --json logs | is a folder
identify 3r good.csv --report nowhere/page.html | nowhere/page.html | does not exist
identify 3r good.csv --report logs | --report | folder
identify 3r good.csv --report same.x --json same.x | --report | --json | same.x
identify 3r good.csv --report r.pdf | r.pdf | FILE.html | PDF
identify 3r good.csv --report page | FILE.html
identify 3r good.csv --cutoff 500 | band
identify 3r good.csv --error-cutoff nan | --error-cutoff
identify 3r good.csv --error-cutoff 900 | band
identify 3r good.csv --effects base_tilt | trusted parameters | gear_coupling
identify 3r good.csv --reversal 2 | fraction
identify 3r good.csv --device abacus | abacus | cpu
identify 3r good.csv --tip tool0 | --tip
identify 3r good.csv --columns "q=q{j} furlong" | q cannot be in this unit
payload 3r good.csv --loaded good.csv --columns "q=q{j} furlong" | q cannot be in this unit
payload 3r good.csv --loaded fit.parquet --effects magic | magic
pair --simulated good.csv --real fit.parquet --save-model x.yaml | needs its ROBOT
pair kuka_lwr4 --simulated good.csv --real fit.parquet | joint
robot odd.urdf | <sdf> | convert it to URDF
robot odd.xml | <html> | <mujoco>
robot words.yaml | words.yaml
robot 3r --tip link_1 | --tip chooses a part
check kuka_lwr4 --robot 3r | different numbers of links
check panda | no inertial parameters
check 3r --geometry huge | no bounds 'huge'
check 3r --bounds huge | no bounds 'huge'
check 3r --total-mass 9,5 | --total-mass
check 3r --total-mass 9 | --total-mass
check 3r --total-mass a,b | --total-mass
check kuka_lwr4 --shapes | no shapes
check bare.json | --robot
check sets.json --robot kuka_lwr4 | of another robot
check nan.json --robot 3r | is not JSON
check text.json --robot 3r | is not JSON
check robot.json --robot 3r | missing required field `sets`
check 3r --nearest none/x.json | does not exist
check 3r --out new --json other/mine.json | other
explain other.json | not a result | schema
explain corrected.yaml | is not JSON | torchid robot corrected.yaml
explain gap.json --report page.html | an index of a folder
export other.json --to urdf | no dynamics | torchid identify
export 3r --to yaml --name a/b --out new | without folder
export 3r --to yaml --name .x --out new | without folder
export none.json --to c | cannot be read
export gap.json --randomise 0.9 --to mjcf | for all simulators
export gap.json | nothing to write
extract kuka_lwr4 --bounds loose | com_7z
extract kuka_lwr4 --total-mass 200,300 | total_mass
extract 3r --bounds lose | available: loose, normal, tight
extract 3r --total-mass 6,5 | LO < HI
extract 3r --runs 0 | runs
extract 3r --stages 0 | stages
extract 3r --loss one-step | needs a log
extract kuka_lwr4 --shapes | shapes
extract panda | parameters
extract 3r no-such.json | cannot be read
extract 3r other.json | not a result of an identification
extract 3r_friction null.json | base_values
extract kuka_lwr4_friction a.json | another robot
excite --out o | which robot
excite 3r | nowhere to write
excite free.yaml --save m.csv | velocity | acceleration
excite kuka_lwr4 --kind paper --save m.csv | 3R
excite 3r --kind paper --floor 0 --save m.csv | table 5.1
excite 3r --duration -1 --save m.csv | positive
excite 3r --kind random --basis report --save m.csv | --basis | --kind random
excite 3r --max-velocity 1,2 --save m.csv | expected: 3
excite 3r --kind random --save m.doc | m.doc
excite 6r.urdf RANDOM --workspace 1,0,0,1,0,1 | a workspace is a box
excite 6r.urdf RANDOM --workspace 0,1,0,1,0 | a workspace is a box
excite 6r.urdf RANDOM --workspace a,1,0,1,0,1 | --workspace is not a number
excite 6r.urdf RANDOM --clearance -1 | a clearance is a distance
excite 6r.urdf RANDOM --speed 0 | --speed must be positive
excite 6r.urdf RANDOM --speed 1.5 | share of the designed speed
excite 6r.urdf RANDOM --speed 1e-6 | more than ten million samples
excite 6r.urdf RANDOM --count 2 --ros2 motion | hold one motion
excite 7r.urdf RANDOM --urscript motion | cannot run a URScript program
excite --for corrected.yaml --out o | is not JSON
excite --for a.json --out o --kind random | one optimised trajectory
excite --for a.json --out o --criterion condition | other criteria
excite --for study.json --out o | not a result that a motion can be designed for
excite --for gap0.json --out o | schema torchid.gap/0, of another version
excite --for missing.json --out o | cannot be read
excite 3r_friction --for kuka.json --out o | is of another robot
excite 3r_friction --for closed.json --out o | leaves nothing open
compare a.json | two results or more
compare a.json a.json | given twice
compare a.json gap.json | same kind
compare a.json nothing | cannot be read
compare a.json study.json | not a result that can be compared
compare a.json shorter.json | can be compared as torchid writes it
simulate my_arm.urdf good.csv --save a.csv | inertial parameters
simulate 3r motion.csv | nowhere to write
simulate kuka_lwr4 motion.csv --save a.csv | 3 | 7
simulate 3r motion.csv --save a.csv --effect coulom:joint=2 | unknown effect 'coulom'
simulate 3r motion.csv --save a.csv --effect coulomb_friction:joint=2 | is missing
simulate 3r motion.csv --save a.csv --effect coulomb_friction:Fc=1 | joint (1 to 3) is missing
simulate 3r motion.csv --save a.csv --effect coulomb_friction:joint=4,Fc=1 | does not exist
simulate 3r motion.csv --save a.csv --effect coulomb_friction:joint=1,Fc=high | Fc is not a number
simulate 3r motion.csv --save a.csv --effect coulomb_friction:joint=1,Fc=1,Fv=2 | not belong
simulate 3r motion.csv --save a.csv --effect coulomb_friction:joint=1,Fc | cannot be read at 'Fc'
simulate 3r motion.csv --save a.csv --effect saturation:joint=1,clip=1 | limit [N m]
simulate 3r motion.csv --save a.csv --rate 200 | expected: effects, or --closed-loop
simulate 3r motion.csv --save a.csv --closed-loop --noise paper | paper noise
simulate 3r motion.csv --save a.csv --closed-loop --rate 0 | sampling rate
simulate 3r motion.csv motion.csv --save a.csv | run{k}.parquet
simulate plain.yaml run.csv --replay --save out | has no servos
simulate model.yaml run.csv --replay | one file a log
simulate model.yaml run.csv run.csv --replay --save out | one name
simulate model.yaml run.csv --replay --save . | --save would overwrite the input
simulate model.yaml run.csv --replay --windows -1 --save out | is a time
simulate model.yaml run_bare.csv --replay --save out | has no commands
fleet identify 3r | logs of a fleet are needed
fleet identify 3r --manifest none.csv | cannot be read
fleet identify 3r unit_a unit_b --array 3/2 | --array is no part
fleet identify 3r unit_a unit_b --array 1/2 | a place that all of them see
fleet identify 3r unit_a unit_b --scheduler tcp://a:1 | a place that all of them see
fleet identify 3r unit_a unit_b --workers 2 --scheduler tcp://a:1 | exclude each other
fleet identify 3r unit_a unit_b --cutoff -1 | cut-off is out of range
fleet identify 3r unit_a unit_b --save-model x.txt | --save-model
fleet identify 3r unit_a unit_b --unit unit_a | --save-model
log doctor kuka_lwr4 good.csv | got: 3 | expected: 7
log show degrees.csv --columns "q=angle_{j}" | angle_{j}
"""
"""Command | what its error says | and further words of it."""
SLOW = """
excite 6r.urdf RANDOM --floor 0.8 | clear of the floor
excite 3r_friction --for vertical.json --out o | no motion settles
"""
RANDOM = "--kind random --duration 8 --max-acceleration 5 --save m.csv"


def rows(text: str, *marks: pytest.MarkDecorator):
    for line in text.strip().splitlines():
        given, *words = line.split(" | ")
        yield pytest.param(given, words, marks=marks, id=given)


def seen(place: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in place.rglob("*") if path.is_file()}


@pytest.mark.parametrize(("line", "words"), [*rows(BAD), *rows(SLOW, pytest.mark.slow)])
def test_a_mistake_is_one_error_with_its_remedy(command, place, monkeypatch, line, words) -> None:
    monkeypatch.chdir(place)
    before, folders = seen(place), sorted(os.walk(place))
    done = command(*shlex.split(line.replace("RANDOM", RANDOM)))
    assert (done.code, done.out) == (1, "")
    assert f"\n{done.err}".count("\nerror: ") == 1
    error = done.err[done.err.index("error: ") :]
    assert len(error.splitlines()) <= 5, error
    for word in words:
        assert word in error or word in " ".join(error.split()), error
    assert (seen(place), sorted(os.walk(place))) == (before, folders)


WRONG_USAGE = """
identify
nonsense
identify 3r x.csv --no-such-option
identify 3r x.csv --method magic
gap 3r
gap 3r x.csv --max-effects 0
payload 3r good.csv
pair --real real.csv
pair 3r sim.csv --simulated sim.csv --real real.csv
export 3r --to sdf
extract 3r --seed -1
"""


@pytest.mark.parametrize("line", WRONG_USAGE.strip().splitlines())
def test_wrong_usage_exits_with_2(command, line) -> None:
    assert command(*line.split()).code == 2
