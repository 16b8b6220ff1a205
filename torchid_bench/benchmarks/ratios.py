"""Torchid beside its peers in one run: ratios, alternated, medians; what became slower is printed.

    python -m torchid_bench.benchmarks.ratios [--rounds N] [--save]

Every line is one thing that both can do, on one thread: they run in turn, and the ratio is the
median over the rounds of (processor time of the peer / of torchid), so above 1 torchid is faster. A
peer that is not installed is said. `ratios.json` holds the ratios of the last release; one that
has fallen by more than a fifth is printed. `--save` writes the file anew.
"""

import copy
import io
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import torch

from tests.arms import arm, consistent_parameters, states
from torchid.design.bands import CUTOFF, WIDE_BAND
from torchid.design.columns import Columns, Model
from torchid.design.motion import measurements
from torchid.design.segments import Samples, segments_of
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import RegressorChunk, regressor_chunks
from torchid.errors import TorchidError
from torchid.excitation.design import excite
from torchid.excitation.synthetic import simulate, synthetic_log
from torchid.excitation.trajectories import random_trajectory, trajectory_log
from torchid.export.export import export_dynamics
from torchid.gap.diagnose import diagnose
from torchid.identification.identify import identify
from torchid.identification.settings import Settings
from torchid.log.model import Log
from torchid.log.readers import read_log, write_log
from torchid.robot.inertia import InertialParameters
from torchid.robot.library import load_robot
from torchid.simulation.sensors import HonestNoise
from torchid.wrenches.deviation import wrench_errors
from torchid_bench.benchmarks.cpu_time import machine
from torchid_bench.benchmarks.runner import command, table
from torchid_bench.benchmarks.sysid_toolbox import sysid_toolbox

COMMITTED = Path(__file__).with_name("ratios.json")
SLOWER = 0.8
"""Share of the committed ratio below which a line is printed: the machines that this runs on differ
from one hour to the next by some ten per cent."""
LONGEST = 5.0
"""Processor time after which a line has no more rounds, but for three [s]."""
SAMPLES = 12327
"""As the report's log of the LWR; whole batches of torchid, a Python loop of a peer."""
LOOPED = 2000
"""Samples of a peer's loop in a round: its cost a sample does not depend on their number."""
SETS, INSTANTS = 1000, 1000
"""Of parameters, and of a motion, whose wrenches are computed."""
SIMULATIONS = 128
"""That are stepped together in MuJoCo."""
STEPS = 20
"""Of each simulation in a round."""

SAME = ("viscous_friction", "coulomb_friction", "torque_offset")
"""Effects that FIGAROH has columns of, too."""

Call = Callable[[], object]


def drain(chunks: "object") -> None:
    """Take every chunk and keep none."""
    for _chunk in chunks:  # type: ignore[attr-defined]
        assert isinstance(_chunk, RegressorChunk)


Line = tuple[str, Call, float, Call, float]
"""What it is; a peer's call and how often it does it; torchid's, and how often."""


class NotInstalledError(ImportError):
    """A line's peer is not installed: the line's name."""


def require(package: str, line: str) -> None:
    """Raise where a line's peer is not installed."""
    if not find_spec(package):
        raise NotInstalledError(line)


def seconds(call: Call) -> float:
    """Processor time of one call."""
    start = time.process_time()
    call()
    return time.process_time() - start


def ratio(line: Line, rounds: int) -> tuple[float, float, float]:
    """Microseconds of the peer's and of torchid's, medians of alternated rounds, and the median
    ratio."""
    _, peer, of_peer, ours, of_ours = line
    peer(), ours()
    pairs, begin = list[tuple[float, float]](), time.process_time()
    while len(pairs) < 3 or (len(pairs) < rounds and time.process_time() - begin < LONGEST):
        pairs.append((seconds(peer) / of_peer * 1e6, seconds(ours) / of_ours * 1e6))
    middle = (statistics.median(x) for x in zip(*pairs, strict=True))
    return (*middle, statistics.median(p / o for p, o in pairs))  # type: ignore[return-value]


def dynamics() -> Iterator[Line]:
    """Newton-Euler and the regressor against MuJoCo's and Pinocchio's calls in a Python loop."""
    robot = load_robot("kuka_lwr4")
    generator = torch.Generator().manual_seed(0)
    motion = tuple(
        torch.randn(SAMPLES, robot.n, generator=generator, dtype=torch.float64) for _ in range(3)
    )
    rows = list(zip(*(x[:LOOPED].numpy() for x in motion), strict=True))

    def torques() -> object:
        return inverse_dynamics(robot, *motion)

    def rows_of_all() -> None:
        drain(regressor_chunks(robot, *motion))

    from tests.oracles import MujocoOracle, PinocchioOracle

    other = MujocoOracle(robot)
    mujoco, m, d = other.mujoco, other.model, other.data

    def inverse() -> None:
        for q, dq, ddq in rows:
            d.qpos[:], d.qvel[:], d.qacc[:] = q, dq, ddq
            mujoco.mj_inverse(m, d)

    yield "inverse dynamics, eager / MuJoCo", inverse, LOOPED, torques, SAMPLES
    require("pinocchio", "inverse dynamics and torque regressor, eager / Pinocchio")
    oracle = PinocchioOracle(robot)
    pin, model, data = oracle.pin, oracle.model, oracle.data

    def each(call: Callable[..., object]) -> Call:
        return lambda: [call(model, data, *row) for row in rows]

    yield "inverse dynamics, eager / Pinocchio", each(pin.rnea), LOOPED, torques, SAMPLES
    regressor = each(pin.computeJointTorqueRegressor)
    yield "torque regressor, eager / Pinocchio", regressor, LOOPED, rows_of_all, SAMPLES


def wrenches() -> Iterator[Line]:
    """All joints' wrenches of many sets at many instants, and their errors against one of the sets,
    against Pinocchio's, which computes those of one set at one instant in the same pass as torques;
    its arithmetic is the same for any set."""
    line = "internal wrenches, sets x instants / Pinocchio"
    require("pinocchio", line)
    from tests.oracles import PinocchioOracle

    robot = load_robot("kuka_lwr4")
    oracle = PinocchioOracle(robot.with_parameters(consistent_parameters(robot.n, 1)))
    motion, sets = states(robot, INSTANTS), consistent_parameters(robot.n, 2, (SETS,))
    reference = InertialParameters(sets.pi[0].clone())
    rows = list(zip(*(x.numpy() for x in states(robot, LOOPED)), strict=True))

    def rnea() -> None:
        for row in rows:
            oracle.pin.rnea(oracle.model, oracle.data, *row)

    yield (
        line, rnea, LOOPED,
        lambda: wrench_errors(robot, *motion, sets, reference), SETS * INSTANTS,
    )  # fmt: skip


def effects_in_mujoco(folder: Path) -> Iterator[Line]:
    """A plain mj_step against one with the effects of the file's sidecar: below 1, what they
    cost."""
    line = "mj_step with effects, 128 arms / plain"
    require("mujoco", line)
    import mujoco

    from torchid.simulators.mujoco import Effects

    bare = arm("panda")
    laws = [
        {"effect": name, "joint": j + 1, coefficient: value}
        for j in range(bare.n)
        for name, coefficient, value in (
            ("viscous_friction", "Fv", 0.5),
            ("coulomb_friction", "Fc", 0.3),
            ("load_dependent_friction", "mu", 0.05),
        )
    ]
    robot = replace(bare, effects=tuple(laws))
    file = export_dynamics(robot, "mjcf", folder, nominal=bare, geometry="none").files[0]
    model = mujoco.MjModel.from_xml_path(str(file))
    plain = [(m, mujoco.MjData(m)) for m in (copy.copy(model) for _ in range(SIMULATIONS))]
    moved = [(m, mujoco.MjData(m)) for m in (copy.copy(model) for _ in range(SIMULATIONS))]
    effects = Effects(load_robot(file), moved)
    torque = torch.zeros(SIMULATIONS, bare.n, dtype=torch.float64)

    def without() -> None:
        for _ in range(STEPS):
            for m, d in plain:
                mujoco.mj_step(m, d)

    def together() -> None:
        for _ in range(STEPS):
            effects.step(torque)

    count = SIMULATIONS * STEPS
    yield line, without, count, together, count


def evolution() -> Iterator[Line]:
    """A generation of 30 runs in 30 variables against pycma's."""
    require("cma", "CMA-ES, 30 runs / pycma")
    import cma

    from torchid.extraction.cma.batched import minimise
    from torchid.extraction.cma.search import default_population, start

    def sphere(x: torch.Tensor) -> torch.Tensor:
        return (x - 0.4).square_().sum(-1)

    runs = n = 30
    options = {"bounds": [0, 1], "verbose": -9, "popsize": default_population(n)}
    peers = [
        cma.CMAEvolutionStrategy(n * [0.5], 0.3, options | {"seed": r + 1}) for r in range(runs)
    ]
    state = start(torch.full((runs, n), 0.5, dtype=torch.float64), 0.3)

    def peer(generations: int) -> None:
        # Strategies that live from round to round; all their samples are evaluated in one call.
        for _ in range(generations):
            asked = [strategy.ask() for strategy in peers]
            values = sphere(torch.as_tensor(np.asarray(asked))).numpy()
            for strategy, points, losses in zip(peers, asked, values, strict=True):
                strategy.tell(points, losses)

    def ours(generations: int) -> None:
        nonlocal state
        state = minimise(sphere, state, generations=generations, seed=0)

    yield "CMA-ES, 30 runs / pycma", lambda: peer(5), 5, lambda: ours(50), 50


def identification() -> Iterator[Line]:
    """Base parameters and friction from a log against boosted trees of each joint's torque; of the
    motion as it is, by plain least squares, against Pinocchio's regressor and one QR of all rows,
    and against FIGAROH's regressor, elimination and double QR."""
    robot = load_robot("kuka_lwr4_friction")
    motion = excite(robot, duration=20.0, seed=0, restarts=1, iterations=0).log(250.0)
    log = simulate(robot, motion, noise=HonestNoise(), seed=0)
    assert motion.dq is not None
    assert motion.ddq is not None
    assert log.tau is not None
    state = [x.numpy() for x in (motion.q, motion.dq, motion.ddq)]
    torques = log.tau.T.numpy()
    name = "identify, 20 s / scikit-learn's boosting"
    require("sklearn", name)
    from sklearn.ensemble import HistGradientBoostingRegressor

    features = np.concatenate(state, 1)

    def boosted() -> None:
        for torque in torques:
            HistGradientBoostingRegressor(random_state=0).fit(features, torque)

    yield name, boosted, 1, lambda: identify(robot, log), 1
    given = log.replace(dq=motion.dq, ddq=motion.ddq)
    plain = Settings(effects=SAME, cutoff=None, reversal=0.0, rows="all", method="ols")
    name = "identify by plain least squares / Pinocchio and one QR"
    require("pinocchio", name)
    from tests.oracles import PinocchioOracle

    oracle = PinocchioOracle(replace(robot, effects=()))
    measured, rows = torques.reshape(-1), list(zip(*state, strict=True))
    rigid, one = oracle.pin.computeJointTorqueRegressor, np.eye(robot.n)
    model, data = oracle.model, oracle.data

    def pinocchio() -> None:
        each = [(rigid(model, data, *x), one * x[1], one * np.sign(x[1]), one) for x in rows]
        whole = np.column_stack([np.concatenate([np.hstack(x) for x in each]), torques.T.ravel()])
        scipy.linalg.qr(whole, mode="r", pivoting=True, overwrite_a=True)

    yield name, pinocchio, 1, lambda: identify(robot, given, settings=plain), 1
    name = "identify by plain least squares / FIGAROH"
    require("figaroh", name)
    from figaroh.tools import qrdecomposition, regressor

    asked = {"act_idxv": range(robot.n), "has_friction": True, "has_joint_offset": True}
    names = {f"{k}": 0.0 for k in range(13 * robot.n)}

    def figaroh() -> None:
        columns = regressor.build_regressor_basic(oracle, *state, asked)
        left_out, kept = regressor.get_index_eliminate(columns, names)
        reduced = regressor.build_regressor_reduced(columns, left_out)
        qrdecomposition.QRDecomposer().double_decomposition(measured, reduced, kept)

    yield name, figaroh, 1, lambda: identify(robot, given, settings=plain), 1


def toolbox(folder: Path) -> Iterator[Line]:
    """Armature of each joint, which mujoco.sysid fits to rollouts, against all parameters of the
    same log."""
    name = "identify, 3 s / mujoco.sysid, 7 armatures"
    require("mujoco", name)
    import mujoco
    from mujoco import rollout

    try:
        sysid = sysid_toolbox()
    except TorchidError as error:
        raise NotInstalledError(f"{name}: {error}") from error
    robot = replace(arm("panda"), effects=())
    file = export_dynamics(robot, "mjcf", folder, nominal=robot, geometry="none").files[0]
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep = 0.002
    for own in robot.joint_names:
        joint = spec.joint(own)
        joint.armature, joint.damping = 0.2, np.array([2.0, 0.0, 0.0])
        for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
            of_joint = mujoco.mjtObj.mjOBJ_JOINT
            spec.add_sensor(name=f"{own}_{int(kind)}", type=kind, objtype=of_joint, objname=own)
    model = spec.compile()
    data = mujoco.MjData(model)
    t = np.arange(1500) * model.opt.timestep
    waves = [8 * np.sin(2 * np.pi * (0.5 + 0.13 * j) * t + j) for j in range(robot.n)]
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    state, sensed = (x[0] for x in rollout.rollout(model, data, start, np.stack(waves, 1)[:-1]))
    control = sysid.TimeSeries(t, np.stack(waves, 1))
    seen = sysid.TimeSeries.from_names(state[:, 0], sensed, model)
    sequences = sysid.ModelSequences("arm", spec, "waves", start, control, seen)
    residual = sysid.build_residual_fn(models_sequences=[sequences])

    def fitted() -> None:
        guess = sysid.ParameterDict()
        for own in robot.joint_names:

            def change(s: Any, p: Any, own: str = own) -> None:
                s.joint(own).armature = p.value[0]

            guess.add(sysid.Parameter(own, 0.2, 1e-3, 1.0, modifier=change))
            guess[own].value[:] = 0.1
        with redirect_stdout(io.StringIO()):
            sysid.optimize(guess, residual, verbose=False)

    # After each step; the torque is that of the step before.
    q, dq = (torch.from_numpy(state[:-1, 1 + k * robot.n :][:, : robot.n].copy()) for k in (0, 1))
    log = Log(
        torch.from_numpy(t[1:-1]), q, dq=dq, tau=torch.from_numpy(np.stack(waves, 1)[1:-1].copy())
    )
    settings = Settings(effects=SAME, cutoff=20.0, reversal=0.0, method="ols")
    yield name, fitted, 1, lambda: identify(robot, log, settings=settings), 1


def diagnosis(folder: Path) -> Iterator[Line]:
    """Ten seconds of log against what any diagnosis of them needs: they are read, filtered and
    differentiated; one regressor; one QR."""
    robot = load_robot("kuka_lwr4")
    rubs = replace(
        robot, effects=(*robot.effects, {"effect": "coulomb_friction", "joint": 4, "Fc": 1.5})
    )
    plan = random_trajectory(robot, seed=0, duration=10.0, fill=True, usage=0.8)
    log = synthetic_log(rubs, trajectory_log(plan, 100.0), HonestNoise(), seed=1)
    file = folder / "run.csv"
    write_log(log, file)

    def minimal() -> None:
        segments = segments_of(measurements(read_log(file), WIDE_BAND), WIDE_BAND)
        columns = Columns(Model.of(robot), Samples(segments, CUTOFF))
        torch.linalg.qr(columns.regressor.flatten(0, 1).flatten(1).T)

    name = "gap, 10 s at 100 Hz / one regressor and QR"
    yield name, minimal, 1, lambda: diagnose(robot, read_log(file)), 1


def slower(ratios: dict[str, float], committed: dict[str, float]) -> list[str]:
    """Sentences on the ratios that have fallen."""
    return [
        f"slower: {name}: {ratio:.2f}, and {committed[name]:.2f} before"
        for name, ratio in ratios.items()
        if ratio < SLOWER * committed.get(name, 0.0)
    ]


def main(*, rounds: int = 9, save: bool = False) -> None:
    """Print all lines; `save` writes the committed ratios anew."""
    committed = json.loads(COMMITTED.read_text()) if COMMITTED.exists() else {}
    print(machine())
    print(
        f"microseconds of processor time, medians of up to {rounds} alternated rounds", flush=True
    )
    ratios, rows = {}, []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        every = (
            dynamics(), wrenches(), effects_in_mujoco(place), evolution(), identification(),
            toolbox(place / "toolbox"), diagnosis(place),
        )  # fmt: skip
        for some in every:
            try:
                for line in some:
                    peer, ours, times = ratio(line, rounds)
                    ratios[line[0]] = float(f"{times:.3g}")
                    before = committed.get(line[0], "")
                    rows.append((line[0], f"{peer:.2f}", f"{ours:.2f}", f"{times:.3g}", before))
                    print(*rows[-1], flush=True)
            except NotInstalledError as missing:
                print(f"not installed: {missing}", flush=True)
    table(("", "peer", "torchid", "ratio", "before"), rows)
    if save:
        COMMITTED.write_text(json.dumps(committed | ratios, indent=1) + "\n")
    else:
        print("\n".join(slower(ratios, committed)))


if __name__ == "__main__":
    command(main)
