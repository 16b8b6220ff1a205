"""Torchid beside its peers in one run: ratios, alternated, medians; what became slower is printed.

    python -m torchid_bench.benchmarks.ratios [--rounds N] [--save]

Every line is one thing that both can do, on one thread: they run in turn, and the ratio is the
median over the rounds of (processor time of the peer / of torchid), so above 1 torchid is faster. A
peer that is not installed is left out. `ratios.json` holds the ratios of the last release; one that
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
import torch

from tests.arms import arm, consistent_parameters, states
from torchid.design.bands import CUTOFF, WIDE_BAND
from torchid.design.columns import Columns, Model
from torchid.design.motion import measurements
from torchid.design.segments import Samples, segments_of
from torchid.dynamics.newton_euler import inverse_dynamics
from torchid.dynamics.regressor import RegressorChunk, regressor_chunks
from torchid.excitation.design import excite
from torchid.excitation.synthetic import simulate
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
from torchid_bench.benchmarks.gap_speed import case
from torchid_bench.benchmarks.runner import command, table

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
    """Newton-Euler and the regressor against Pinocchio's and MuJoCo's calls in a Python loop."""
    robot = load_robot("kuka_lwr4")
    generator = torch.Generator().manual_seed(0)
    motion = tuple(
        torch.randn(SAMPLES, robot.n, generator=generator, dtype=torch.float64) for _ in range(3)
    )
    rows = list(zip(*(x[:LOOPED].numpy() for x in motion), strict=True))

    def torques() -> None:
        inverse_dynamics(robot, *motion)

    def rows_of_all() -> None:
        drain(regressor_chunks(robot, *motion))

    if find_spec("pinocchio"):
        from tests.oracles import PinocchioOracle

        oracle = PinocchioOracle(robot)
        pin, model, data = oracle.pin, oracle.model, oracle.data

        def rnea() -> None:
            for row in rows:
                pin.rnea(model, data, *row)

        def columns() -> None:
            for row in rows:
                pin.computeJointTorqueRegressor(model, data, *row)

        yield "inverse dynamics, eager / Pinocchio", rnea, LOOPED, torques, SAMPLES
        yield "torque regressor, eager / Pinocchio", columns, LOOPED, rows_of_all, SAMPLES
    from tests.oracles import MujocoOracle

    other = MujocoOracle(robot)
    mujoco, m, d = other.mujoco, other.model, other.data

    def inverse() -> None:
        for q, dq, ddq in rows:
            d.qpos[:], d.qvel[:], d.qacc[:] = q, dq, ddq
            mujoco.mj_inverse(m, d)

    yield "inverse dynamics, eager / MuJoCo", inverse, LOOPED, torques, SAMPLES


def wrenches() -> Iterator[Line]:
    """All joints' wrenches of many sets at many instants, and their errors against one of the sets,
    against Pinocchio's, which computes those of one set at one instant in the same pass as torques;
    its arithmetic is the same for any set."""
    if not find_spec("pinocchio"):
        return
    from tests.oracles import PinocchioOracle

    robot = load_robot("kuka_lwr4")
    oracle = PinocchioOracle(robot.with_parameters(consistent_parameters(robot.n, 1)))
    motion, sets = states(robot, INSTANTS), consistent_parameters(robot.n, 2, (SETS,))
    reference = InertialParameters(sets.pi[0].clone())
    rows = list(zip(*(x.numpy() for x in states(robot, LOOPED)), strict=True))

    def rnea() -> None:
        for row in rows:
            oracle.pin.rnea(oracle.model, oracle.data, *row)

    def errors() -> None:
        wrench_errors(robot, *motion, sets, reference)

    yield "internal wrenches, sets x instants / Pinocchio", rnea, LOOPED, errors, SETS * INSTANTS


def effects_in_mujoco(folder: Path) -> Iterator[Line]:
    """A plain mj_step against one with the effects of the file's sidecar: below 1, what they
    cost."""
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
    yield "mj_step with effects, 128 arms / plain", without, count, together, count


def evolution() -> Iterator[Line]:
    """A generation of 30 runs in 30 variables against pycma's."""
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
            for strategy, points, told in zip(peers, asked, values, strict=True):
                strategy.tell(points, told)

    def ours(generations: int) -> None:
        nonlocal state
        state = minimise(sphere, state, generations=generations, seed=0)

    yield "CMA-ES, 30 runs / pycma", lambda: peer(5), 5, lambda: ours(50), 50


def identification() -> Iterator[Line]:
    """Base parameters and friction from a log against boosted trees of each joint's torque, and
    against FIGAROH's regressor, elimination and double QR of the same motion."""
    robot = load_robot("kuka_lwr4_friction")
    motion = excite(robot, duration=20.0, seed=0, restarts=1, iterations=0).log(250.0)
    log = simulate(robot, motion, noise=HonestNoise(), seed=0)
    assert motion.dq is not None
    assert motion.ddq is not None
    assert log.tau is not None
    state = [x.numpy() for x in (motion.q, motion.dq, motion.ddq)]
    torques = log.tau.T.numpy()
    from sklearn.ensemble import HistGradientBoostingRegressor

    features = np.concatenate(state, 1)

    def boosted() -> None:
        for torque in torques:
            HistGradientBoostingRegressor(random_state=0).fit(features, torque)

    name = "identify, 20 s / scikit-learn's boosting"
    yield name, boosted, 1, lambda: identify(robot, log), 1
    try:
        from figaroh.tools.qrdecomposition import QRDecomposer
        from figaroh.tools.regressor import (
            build_regressor_basic,
            build_regressor_reduced,
            get_index_eliminate,
        )
    except ImportError:
        return
    from tests.oracles import PinocchioOracle

    oracle = PinocchioOracle(replace(robot, effects=()))
    asked = {"act_idxv": range(robot.n), "has_friction": True, "has_joint_offset": True}
    names = {f"{k}": 0.0 for k in range(13 * robot.n)}
    measured = torques.reshape(-1)

    def figaroh() -> None:
        columns = build_regressor_basic(oracle, *state, asked)
        left_out, kept = get_index_eliminate(columns, names)
        reduced = build_regressor_reduced(columns, left_out)
        QRDecomposer().double_decomposition(measured, reduced, kept)

    given = log.replace(dq=motion.dq, ddq=motion.ddq)
    plain = Settings(effects=SAME, cutoff=None, reversal=0.0, rows="all", method="ols")
    name = "identify by plain least squares / FIGAROH"
    yield name, figaroh, 1, lambda: identify(robot, given, settings=plain), 1


def toolbox(folder: Path) -> Iterator[Line]:
    """Armature of each joint, which mujoco.sysid fits to rollouts, against all parameters of the
    same log."""
    import mujoco
    from mujoco import rollout, sysid

    if not hasattr(sysid, "optimize"):  # its own extras are missing
        return
    robot = replace(arm("panda"), effects=())
    file = export_dynamics(robot, "mjcf", folder, nominal=robot, geometry="none").files[0]
    spec = mujoco.MjSpec.from_file(str(file))
    spec.option.timestep = 0.002
    for name in robot.joint_names:
        joint = spec.joint(name)
        joint.armature, joint.damping = 0.2, np.array([2.0, 0.0, 0.0])
        for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
            of_joint = mujoco.mjtObj.mjOBJ_JOINT
            spec.add_sensor(name=f"{name}_{int(kind)}", type=kind, objtype=of_joint, objname=name)
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
        for name in robot.joint_names:

            def change(s: Any, p: Any, name: str = name) -> None:
                s.joint(name).armature = p.value[0]

            guess.add(sysid.Parameter(name, 0.2, 1e-3, 1.0, modifier=change))
            guess[name].value[:] = 0.1
        with redirect_stdout(io.StringIO()):
            sysid.optimize(guess, residual, verbose=False)

    # After each step; the torque is that of the step before.
    q, dq = (torch.from_numpy(state[:-1, 1 + k * robot.n :][:, : robot.n].copy()) for k in (0, 1))
    log = Log(
        torch.from_numpy(t[1:-1]), q, dq=dq, tau=torch.from_numpy(np.stack(waves, 1)[1:-1].copy())
    )
    settings = Settings(effects=SAME, cutoff=20.0, reversal=0.0, method="ols")
    name = "identify, 3 s / mujoco.sysid, 7 armatures"
    yield name, fitted, 1, lambda: identify(robot, log, settings=settings), 1


def diagnosis(folder: Path) -> Iterator[Line]:
    """Ten seconds of log against what any diagnosis of them needs: they are read, filtered and
    differentiated; one regressor; one QR."""
    robot, log = case(10.0, 100.0)
    file = folder / "run.csv"
    write_log(log, file)

    def minimal() -> None:
        segments = segments_of(measurements(read_log(file), WIDE_BAND), WIDE_BAND)
        columns = Columns(Model.of(robot), Samples(segments, CUTOFF))
        torch.linalg.qr(columns.regressor.flatten(0, 1).flatten(1).T)

    name = "gap, 10 s at 100 Hz / one regressor and QR"
    yield name, minimal, 1, lambda: diagnose(robot, read_log(file)), 1


def slower(found: dict[str, float], committed: dict[str, float]) -> list[str]:
    """Sentences on the ratios that have fallen."""
    return [
        f"slower: {name}: {ratio:.2f}, and {committed[name]:.2f} before"
        for name, ratio in found.items()
        if ratio < SLOWER * committed.get(name, 0.0)
    ]


def main(*, rounds: int = 9, save: bool = False) -> None:
    """Print all lines; `save` writes the committed ratios anew."""
    committed = json.loads(COMMITTED.read_text()) if COMMITTED.exists() else {}
    print(machine())
    print(
        f"microseconds of processor time, medians of up to {rounds} alternated rounds", flush=True
    )
    found, rows = {}, []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        every = (
            dynamics(), wrenches(), effects_in_mujoco(place), evolution(), identification(),
            toolbox(place / "toolbox"), diagnosis(place),
        )  # fmt: skip
        for line in (line for some in every for line in some):
            peer, ours, times = ratio(line, rounds)
            found[line[0]] = float(f"{times:.3g}")
            before = committed.get(line[0], "")
            rows.append((line[0], f"{peer:.2f}", f"{ours:.2f}", f"{times:.3g}", before))
            print(*rows[-1], flush=True)
    table(("", "peer", "torchid", "ratio", "before"), rows)
    if save:
        COMMITTED.write_text(json.dumps(committed | found, indent=1) + "\n")
    else:
        print("\n".join(slower(found, committed)))


if __name__ == "__main__":
    command(main)
